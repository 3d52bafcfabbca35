"""Reset of a tripped bench: list its trips, then release exactly those; no run can use the bench in either step."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from leactl.errors import SafetyTrip
from leactl.runner import latch, locks, runs_underway
from leactl.runner.latch import Latch, Trip, UnlatchedRun


@dataclass(frozen=True)
class Held:
    """What holds a bench: its latches, and lost runs that could not be latched."""

    latches: Mapping[Latch, Trip]
    unlatched: Sequence[UnlatchedRun]

    @property
    def trips(self) -> list[Trip]:
        """One trip for each latch and each lost run, the latter with the fault that kept its latch unwritten."""
        return [*self.latches.values(), *(self._trip_of(run) for run in self.unlatched)]

    @staticmethod
    def _trip_of(run: UnlatchedRun) -> Trip:
        return Trip("", f"{run.lost.cause}; {run.fault}", run.lost.last_written, run.lost.recording)


def held_by(word: str, bench: str) -> Held:
    """Latch a bench for its lost runs, then list what holds it.

    word : argument of the command, a name or a path of a bench file.

    Raises
    ------
    DeviceError : a run or another reset holds the bench.
    """
    with locks.idle(bench):
        return _what_holds(word, bench)


def release(word: str, bench: str, listed: Held) -> None:
    """Release a bench from the latches and lost runs in `listed`, or from nothing if these have changed.

    Raises
    ------
    DeviceError : a run or another reset holds the bench.
    SafetyTrip : what holds the bench has changed; nothing is released.
    InputError : this user may not release a latch, or the file of a lost run can be neither removed nor written; the
        bench stays held.
    """
    with locks.idle(bench):
        if _what_holds(word, bench) != listed:
            raise SafetyTrip(f"what holds bench '{bench}' has changed meanwhile; nothing was released")
        for run in listed.unlatched:
            runs_underway.forget(run.lost)
        for held_latch in listed.latches:
            held_latch.release()


def _what_holds(word: str, bench: str) -> Held:
    """Latch a bench for its lost runs, and return what holds it."""
    # in this order: `tripped_latches` reads the latches that `latch_lost_runs` writes
    unlatched = latch.latch_lost_runs(bench)
    return Held(latch.tripped_latches(word), unlatched)
