"""Damaged camera exports give the same values, NaN, a refusal or a note; never another value without one."""

from collections import Counter

import pytest

from .camera_exports import EXPORTS
from .export_mutations import mutated, outcome

SEEDS = 15  # of each of 20 exports; the long run has 5,000 files


def outcomes(folder, seeds):
    """How many files have which outcome, and the first files that are misread."""
    counts, misread = Counter(), []
    for export in EXPORTS:
        right = export.read(folder)
        for seed in range(seeds):
            kinds, files = mutated(export, seed)
            result = outcome(export, folder, files, right)
            counts[result] += 1
            if result == "wrong":
                misread.append(f"{export.name} {seed}: {' and '.join(kinds)}")
    return counts, misread[:10]


def test_damaged_exports_are_never_misread_without_a_note(tmp_path):
    counts, misread = outcomes(tmp_path, SEEDS)
    assert misread == []
    assert {"refused", "same"} <= counts.keys()


@pytest.mark.long
def test_five_thousand_damaged_exports_are_never_misread_without_a_note(tmp_path):
    counts, misread = outcomes(tmp_path, 5000 // len(EXPORTS))
    print(dict(counts))
    assert misread == []
    assert sum(counts.values()) == 5000


def test_the_judge_of_damage_sees_a_number_that_differs(tmp_path):
    """A digit that changes is a wrong value without a note; it is the one damage that no reader can see."""
    export = next(export for export in EXPORTS if export.name == "irbis_csv")
    files = [content.replace(b"21,37", b"22,37") for content in export.files()]
    assert outcome(export, tmp_path, files, export.read(tmp_path)) == "wrong"
