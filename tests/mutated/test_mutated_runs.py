"""Thousands of spoiled run files through the commands for runs: one clear refusal each, soon and in little memory.

    .venv/bin/pytest -m long tests/mutated/test_mutated_runs.py

Half of the spoiled trees are those of sealed files: `runs verify` must find each. The other half have neither seal nor
checksums, as files of other makers, so that what is spoiled reaches whoever reads it; some of them were cut off.
`MUTATED` in the environment is how many of bytes and how many of trees, 2,000 where it is not set.
"""

import random
import shutil

import h5py
import pytest

from leactl.runfile import layout
from leactl.runfile.summary import RECORDING
from tests.analysis.short_runs import short_run
from tests.mutated.child import MOST_MB, outcome
from tests.mutated.run_mutations import OF_BYTES, OF_TREE
from tests.mutated.test_mutated_files import COUNT, NOMINAL, command
from tests.runfile.specimen import unseal

EXPERIMENTS = ("current-step", "coast-down", "friction", "back-emf", "torque-pulses")
COMMANDS = {
    "runs verify": lambda path: ("runs", "verify", path),
    "runs show": lambda path: ("runs", "show", path),
    "runs show --json": lambda path: ("runs", "show", path, "--json"),
    "runs list": lambda path: ("runs", "list", path.parent),
    "runs list --json": lambda path: ("runs", "list", path.parent, "--json", "--sort", "duration"),
    "runs recover": lambda path: ("runs", "recover", path),
    "runs convert": lambda path: ("runs", "convert", path),
    "runs annotate": lambda path: ("runs", "annotate", path, "a note"),
    "runs export": lambda path: ("runs", "export", path, "--out", path.parent / "out"),
    "runs plot": lambda path: ("runs", "plot", path),
    "runs tail": lambda path: ("runs", "tail", path),
    "runs plot --html": lambda path: ("runs", "plot", path, "--html", path.parent / "plot.html"),
    "analyze": lambda path: ("analyze", path),
    "analyze --json": lambda path: ("analyze", path, "--json"),
    "analyze --as channels": lambda path: ("analyze", path, "--as", "channels"),
    "stats": lambda path: ("stats", path.parent),
    "report": lambda path: ("report", path, "--html", path.parent / "sheet.html"),
    "gap diagnose": lambda path: ("gap", "diagnose", path, "--model", path.parent.parent / "nominal.yaml"),
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Finished runs of several experiments, each accepted by every command."""
    return [short_run(experiment, tmp_path_factory.mktemp(experiment)) for experiment in EXPERIMENTS]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "nominal.yaml").write_text(NOMINAL)
    return tmp_path


def as_of_other_makers(rng, file):
    """Take away what tells of changes, and of some the orderly end."""
    unseal(file)
    for _, dataset in list(layout.datasets(file)):
        del dataset.attrs["sha256"]
    if rng.random() < 0.25:
        file.attrs["status"] = RECORDING


def spoiled_bytes(rng, number, sound, path):
    mutation = OF_BYTES[number % len(OF_BYTES)]
    path.write_bytes(mutation(rng, rng.choice(sound).read_bytes()))
    return mutation.__name__, False


def spoiled_tree(rng, number, sound, path):
    mutation, sealed = OF_TREE[number % len(OF_TREE)], number // len(OF_TREE) % 2 == 0
    shutil.copy(rng.choice(sound), path)
    with h5py.File(path, "r+", libver=layout.HDF5_FORMAT) as file:
        if not sealed:
            as_of_other_makers(rng, file)
        changed = mutation(rng, file)
    return mutation.__name__, sealed and changed


@pytest.mark.long
@pytest.mark.parametrize("spoiled", [spoiled_bytes, spoiled_tree])
def test_a_spoiled_run_is_refused_or_read(folder, sound, spoiled):
    rng, faults, statuses = random.Random(20261123), [], {}
    least = outcome(lambda: 0).megabytes
    for number in range(COUNT):
        path = folder / f"{number}" / "run.h5"
        path.parent.mkdir()
        name, sealed = spoiled(rng, number, sound, path)
        for title in ("runs verify", rng.choice([title for title in COMMANDS if title != "runs verify"])):
            ended = outcome(command(*COMMANDS[title](path)))
            statuses[ended.status] = statuses.get(ended.status, 0) + 1
            fault = ended._replace(megabytes=ended.megabytes - least).fault
            if sealed and title == "runs verify" and ended.status == 0:
                fault = "taken for sound"
            if fault:
                faults.append(f"{path} ({name}): {title}: {fault}: {ended.said[-400:]}")
        if not (faults and faults[-1].startswith(f"{path} ")):
            shutil.rmtree(path.parent)
    print(*faults, sep="\n")
    print(f"{spoiled.__name__}: {statuses}; {least:.0f} MB, of them at most {MOST_MB:.0f} more")
    assert faults == []


@pytest.mark.long
def test_a_sound_run_is_accepted(folder, sound):
    for number, run in enumerate(sound):
        path = folder / f"{number}" / "run.h5"
        path.parent.mkdir()
        shutil.copy(run, path)
        every = {title: outcome(command(*arguments(path))) for title, arguments in COMMANDS.items()}
        assert {title: ended.said for title, ended in every.items() if ended.fault} == {}
        # what repeats are compared in is not in every run, and none of these was cut off
        assert {title for title, ended in every.items() if ended.status} <= {"runs recover", "stats"}
