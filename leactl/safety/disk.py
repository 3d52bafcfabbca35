"""Free space on the disk of the run file: enough for the plan before a run starts, and never too little in it."""

import math
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from leactl.errors import InputError
from leactl.quantities import ChannelSpec
from leactl.safety.interlocks import DiskSpace
from leactl.safety.watching import Trip, Warn

BYTES_A_VALUE = 8
COPIES = 2  # the live file, and the packed one that replaces it at the end


class Disk:
    """Warns once while space is short, and trips when it is too little."""

    def __init__(self, settings: DiskSpace, trip: Trip, warn: Warn) -> None:
        self._settings, self._trip, self._warn = settings, trip, warn
        self._least_bytes, self._warned = 1e6 * settings.trip_MB, False

    def look(self, free: float) -> None:
        """Judge the free space [bytes]; warn once while it is short.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        if free < self._least_bytes:
            self._trip(f"disk: {free / 1e6:.0f} MB are free; {self._settings.trip_MB:g} MB at least are required")
        is_short = free < self._settings.warn_bytes
        if is_short and not self._warned:
            self._warn(f"disk: {free / 1e6:.0f} MB are free; below {self._settings.trip_MB:g} MB the run trips")
        self._warned = is_short


def free_bytes(path: Path) -> float:
    """Return the free space [bytes] of the disk where this file or directory is, or will be made."""
    existing = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    usage = shutil.disk_usage(existing)
    # if a file system reports no size, only a failed write shows that it is full
    return float(usage.free) if usage.total else math.inf


def planned_bytes(
    streams: Mapping[str, Sequence[ChannelSpec]],
    record_hz: float,
    rate_hz: float,
    duration_s: float,
    fast_hz: Mapping[str, float],
) -> float:
    """Return an upper bound of the space that a run takes [bytes].

    The stream of the loop counts at its recording rate; any other stream counts at one row per cycle, or at its own
    rate if that is higher.

    Parameters
    ----------
    record_hz, rate_hz : rate at which the loop is recorded, and rate of the loop itself.
    fast_hz : rate of each stream that is faster than the loop.
    """
    rates = {name: max(rate_hz, fast_hz.get(name, 0.0)) for name in streams} | {"loop": record_hz}
    values = duration_s * sum((1 + len(channels)) * rates[name] for name, channels in streams.items())
    return COPIES * BYTES_A_VALUE * values


def check_room(settings: DiskSpace, free: float, planned: float, purpose: str = "the run") -> None:
    """Raise InputError if a run may not fit on the disk.

    Parameters
    ----------
    free, planned : free space and upper bound of the space that the run takes [bytes].
    purpose : what takes the space, for the message.

    Raises
    ------
    InputError : the disk has too little free space.
    """
    needed = planned + 1e6 * settings.trip_MB
    if free < needed:
        raise InputError(
            f"disk: {free / 1e6:.0f} MB are free; {needed / 1e6:.0f} MB were expected, {planned / 1e6:.0f} MB for"
            f" {purpose} and {settings.trip_MB:g} MB to spare (interlocks.disk_space); free space, or choose --out"
        )
