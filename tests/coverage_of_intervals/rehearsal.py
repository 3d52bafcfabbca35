"""Runs of the emulated bench, one for each seed, condition and experiment, by the path that `leactl run` takes.

A run that is there already is kept, so that an interrupted rehearsal goes on where it was, and a changed analysis can
be judged on the same runs.
"""

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from multiprocessing import Pool
from pathlib import Path
from typing import NamedTuple

from leactl.runner.operators import confirm_at_once
from leactl.runner.request import prepare
from leactl.runner.session import execute

EXPERIMENTS = ("torque-constant", "friction", "back-emf")
CONDITIONS = ("unloaded", "design", "loaded")


class Rehearsal(NamedTuple):
    """One run to be made or already there."""

    directory: Path
    experiment: str
    condition: str
    seed: int

    @property
    def path(self) -> Path:
        """Where the run is kept."""
        return self.directory / f"{self.experiment}_{self.condition}_{self.seed:04}.h5"


def wanted(
    directory: Path, seeds: Sequence[int], experiments: Sequence[str], conditions: Sequence[str]
) -> list[Rehearsal]:
    """All runs, seed by seed, so that those of an interrupted rehearsal are evenly spread."""
    return [Rehearsal(directory, name, label, seed) for seed in seeds for label in conditions for name in experiments]


def rehearse(rehearsals: Sequence[Rehearsal], processes: int) -> Iterator[Rehearsal]:
    """Make the runs that are not there yet; yields each when it is."""
    lacking = [rehearsal for rehearsal in rehearsals if not rehearsal.path.exists()]
    with Pool(processes) as pool:
        yield from pool.imap_unordered(_make, lacking)


def _make(rehearsal: Rehearsal) -> Rehearsal:
    unfinished = rehearsal.path.with_suffix("")
    shutil.rmtree(unfinished, ignore_errors=True)
    os.environ["LEACTL_STATE"] = str(unfinished / "state")
    sets = [f"seed={rehearsal.seed}"]
    request = prepare(rehearsal.experiment, "emulated", sets, "a1", rehearsal.condition, "", unfinished, False)
    outcome = execute(request, confirm_at_once, lambda _progress: nullcontext())
    if outcome.error is not None:
        raise outcome.error
    outcome.path.rename(rehearsal.path)
    shutil.rmtree(unfinished)
    return rehearsal
