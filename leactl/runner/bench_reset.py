"""Release a tripped bench: all that holds it is told first, and nothing else is released; no run has it meanwhile."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from leactl.errors import SafetyTrip
from leactl.runner import latch, locks, runs_underway
from leactl.runner.latch import Latch, Trip, UnlatchedRun


@dataclass(frozen=True)
class Held:
    """All that holds a bench: its latches, and runs without a word for which none could be written."""

    latches: Mapping[Latch, Trip]
    unlatched: Sequence[UnlatchedRun]

    @property
    def trips(self) -> list[Trip]:
        """Each as a person reads it, what could not be written included."""
        return [*self.latches.values(), *(self._trip_of(run) for run in self.unlatched)]

    @staticmethod
    def _trip_of(run: UnlatchedRun) -> Trip:
        return Trip("", f"{run.lost.cause}; {run.fault}", run.lost.last_told, run.lost.recording)


def held_by(word: str, bench: str) -> Held:
    """What holds a bench, by the word that leads to its latches and its name.

    Raises
    ------
    DeviceError : a run drives it.
    """
    with locks.idle(bench):
        return _look(word, bench)


def release(word: str, bench: str, told: Held) -> None:
    """Release a bench from what was told of it.

    Raises
    ------
    DeviceError : a run drives it.
    SafetyTrip : something else holds it than was told; nothing is released.
    InputError : this user may not release a latch, or the file of a lost run can be neither removed nor written: that
        holds the bench.
    """
    with locks.idle(bench):
        if _look(word, bench) != told:
            raise SafetyTrip(f"what holds bench '{bench}' has changed meanwhile; nothing was released")
        for run in told.unlatched:
            runs_underway.forget(run.lost)
        for held in told.latches:
            held.release()


def _look(word: str, bench: str) -> Held:
    unlatched = latch.latch_lost_runs(bench)
    return Held(latch.tripped(word), unlatched)
