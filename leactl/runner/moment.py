"""A moment that nobody can move: the clock since boot and which boot it counts from, beside the wall clock to be read.

A wall clock is set by people, by time servers and by a flat battery. Within one boot the kernel's own clock tells how
long something has rested, sleep included. From one boot to another nothing tells for how long a machine was off: only
the time since the later boot is certain.
"""

import math
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

BOOT = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True)
class Moment:
    """One moment by the clock on the wall and by the kernel's."""

    wall: float  # s since 1970, to be told to people alone
    boot: str  # the kernel's identifier of this boot
    since_boot: float  # s, sleep included

    @classmethod
    def now(cls) -> "Moment":
        """This moment.

        Raises
        ------
        OSError : the kernel does not tell its boot, when it is asked for the first time.
        """
        return cls(time.time(), _boot(), time.clock_gettime(time.CLOCK_BOOTTIME))

    def surely_since(self, other: "Moment") -> float:
        """How long ago another moment was at the least [s].

        Raises
        ------
        ValueError : no such moment was: it is no number, or ahead of this one in the same boot.
        """
        if not (math.isfinite(other.since_boot) and other.since_boot >= 0.0):
            raise ValueError(f"it is of {other.since_boot:g} s after a boot, which is no time")
        if self.boot != other.boot:
            return self.since_boot
        if other.since_boot > self.since_boot:
            raise ValueError(
                f"it is of the future, {other.since_boot - self.since_boot:.3g} s ahead of this boot's clock"
            )
        return self.since_boot - other.since_boot


@cache
def _boot() -> str:
    """Read once: the end of a run needs no descriptor for it."""
    return BOOT.read_text(encoding="ascii").strip()
