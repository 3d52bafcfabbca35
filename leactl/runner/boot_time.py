"""When something was, by a clock that nobody can set: the kernel's, which counts from boot and goes on through sleep.

People, time servers and flat batteries set the wall clock. It is kept for people to read. Only from one boot to another
does it count, and then it only shortens. The kernel takes the length of a hibernation from the battery's clock.
"""

import math
import secrets
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from leactl.errors import InputError

BOOT = Path("/proc/sys/kernel/random/boot_id")
PROCESS = secrets.token_hex()  # stands for a boot that the system does not tell


@dataclass(frozen=True)
class ClockReadings:
    """One moment by the wall clock and by the kernel's."""

    wall: float  # s since 1970
    boot: str  # the kernel's identifier of this boot
    since_boot: float  # s, sleep included

    @classmethod
    def now(cls) -> "ClockReadings":
        """This moment.

        Raises
        ------
        InputError : the kernel does not tell its boot.
        """
        if not hasattr(time, "CLOCK_BOOTTIME"):  # a bench that is emulated on another system rests within one process
            return cls(time.time(), PROCESS, time.monotonic())
        return cls(time.time(), _boot(), time.clock_gettime(time.CLOCK_BOOTTIME))

    def surely_since(self, other: "ClockReadings") -> float:
        """How long ago another moment was at the least [s].

        In one boot the kernel's clock tells. A moment of an earlier boot lies before this boot. Another machine that
        shares the folder has boots of its own, though: the time between both wall clocks caps what is told, so that
        machines which share a folder must agree on them.

        Raises
        ------
        ValueError : a clock of the other moment is no number, or ahead of this one in the same boot.
        """
        if not math.isfinite(other.wall):
            raise ValueError(f"it is of {other.wall:g} s since 1970, which is no time")
        if not (math.isfinite(other.since_boot) and other.since_boot >= 0.0):
            raise ValueError(f"it is of {other.since_boot:g} s after a boot, which is no time")
        if self.boot != other.boot:
            return max(0.0, min(self.since_boot, self.wall - other.wall))
        if other.since_boot > self.since_boot:
            raise ValueError(
                f"it is of the future, {other.since_boot - self.since_boot:.3g} s ahead of this boot's clock"
            )
        return self.since_boot - other.since_boot


@cache
def _boot() -> str:
    """The kernel's identifier of this boot, read once: the end of a run needs no descriptor for it."""
    try:
        return BOOT.read_text(encoding="ascii").strip()
    except OSError as error:
        raise InputError(f"{BOOT}: {error.strerror or error}; how long a winding rests is counted from boot") from None
