"""Release a tripped bench from what was shown to its user, and from nothing else; no run can use it at either step."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from leactl.errors import SafetyTrip
from leactl.runner import latch, locks, runs_underway
from leactl.runner.latch import Latch, Trip, UnlatchedRun


@dataclass(frozen=True)
class Held:
    """All that holds a bench: its latches, and lost runs that could not be latched."""

    latches: Mapping[Latch, Trip]
    unlatched: Sequence[UnlatchedRun]

    @property
    def trips(self) -> list[Trip]:
        """One entry for each, as a person reads it, with what could not be written."""
        return [*self.latches.values(), *(self._trip_of(run) for run in self.unlatched)]

    @staticmethod
    def _trip_of(run: UnlatchedRun) -> Trip:
        return Trip("", f"{run.lost.cause}; {run.fault}", run.lost.last_told, run.lost.recording)


def held_by(word: str, bench: str) -> Held:
    """Latch a bench for its lost runs, then list what holds it.

    word : what the user typed, a name or a path of a bench file.

    Raises
    ------
    DeviceError : a run or another reset has it.
    """
    with locks.idle(bench):
        return _look(word, bench)


def release(word: str, bench: str, shown: Held) -> None:
    """Release a bench from what was shown of it; nothing if that has changed since.

    Raises
    ------
    DeviceError : a run or another reset has it.
    SafetyTrip : something else holds it than was shown; nothing is released.
    InputError : this user may not release a latch, or the file of a lost run can be neither removed nor written: that
        holds the bench.
    """
    with locks.idle(bench):
        if _look(word, bench) != shown:
            raise SafetyTrip(f"what holds bench '{bench}' has changed meanwhile; nothing was released")
        for run in shown.unlatched:
            runs_underway.forget(run.lost)
        for held in shown.latches:
            held.release()


def _look(word: str, bench: str) -> Held:
    # in this order: the latches that the first writes are read by the second
    unlatched = latch.latch_lost_runs(bench)
    return Held(latch.tripped(word), unlatched)
