"""Whatever a rig logs, a diagnosis answers or refuses in words, in bounded time; it never fails by itself."""

import os
import time

import pytest

from leactl.errors import InputError
from leactl.gap.diagnose import diagnose
from tests.gap.rigs import drawn_rig

VERDICTS = ("none", "calibration", "effect", "unknown")
DRAWN = int(os.environ.get("RIGS", "2000"))
LONGEST_S = 60.0  # of processor time, for one of at most 48,000 samples


def answered(seed, folder):
    """The verdict on a drawn rig, or the faults it is refused with."""
    try:
        diagnosis = diagnose(drawn_rig(seed, folder))
    except InputError as error:
        assert error.faults
        assert all("\n" not in fault for fault in error.faults)
        return "refused"
    assert diagnosis.verdict in VERDICTS
    diagnosis.as_json()
    return diagnosis.verdict


@pytest.mark.parametrize("seed", [1001, 1006, 1038, 1039, 2195])
def test_a_drawn_rig_is_answered_or_refused(seed, tmp_path):
    assert answered(seed, tmp_path) in (*VERDICTS, "refused")


@pytest.mark.long
def test_of_thousands_of_drawn_rigs_none_fails(tmp_path):
    told, longest, failed = [], 0.0, []
    for seed in range(1000, 1000 + DRAWN):
        begin = time.process_time()
        try:
            told.append(answered(seed, tmp_path))
        except Exception as error:
            failed.append(f"{seed}: {type(error).__name__}: {error}")
        longest = max(longest, time.process_time() - begin)
    assert failed == []
    assert longest < LONGEST_S
    print(f"{longest:.0f} s", {verdict: told.count(verdict) for verdict in sorted(set(told))})
