"""What tests ask of a bench's latch, by its name or its file."""

from leactl.bench.benchfile import load
from leactl.runner import latch


def trip_of(bench):
    """The trip that holds the bench; None where none does."""
    return next(iter(latch.tripped_latches(bench).values()), None)


def latch_of(bench, in_process=True):
    """The latch that a run on this bench meets."""
    file, _devices, document = load(bench)
    return latch.of(file, document.name, in_process)


def release(bench):
    """Take every latch of the bench away."""
    for held in latch.tripped_latches(bench):
        held.release()
