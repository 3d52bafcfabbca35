"""Whoever wants to see an emulated bench itself, and not what its devices say of it, is told of each that is made.

A rehearsal judges by the plant whether a drive that was confirmed safe is.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from leactl.emulation.emulated_bench import EmulatedBench

_told: "list[Callable[[EmulatedBench], None]]" = []


@contextmanager
def witnessed(see: "Callable[[EmulatedBench], None]") -> Iterator[None]:
    """Have every emulated bench that this process makes until the block is left seen by this function."""
    _told.append(see)
    try:
        yield
    finally:
        _told.remove(see)


def show(bench: "EmulatedBench") -> None:
    """Let a new bench be seen."""
    for see in _told:
        see(bench)
