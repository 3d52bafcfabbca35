"""Time since earlier moments by the kernel's clock, which nobody can set: it counts from boot and during sleep.

People, time servers and flat batteries set the wall clock. It is stored for people to read. It counts only between two
boots, and then it can only shorten a time. The kernel takes the length of a hibernation from the battery's clock.
"""

import math
import secrets
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from leactl.errors import InputError

BOOT_ID_PATH = Path("/proc/sys/kernel/random/boot_id")
PROCESS_TOKEN = secrets.token_hex()  # replaces the identifier of the boot on systems without one


@dataclass(frozen=True)
class ClockReadings:
    """One moment by the wall clock and by the kernel's clock."""

    wall: float  # s since 1970
    boot: str  # the kernel's identifier of this boot
    since_boot: float  # s, sleep included

    @classmethod
    def now(cls) -> "ClockReadings":
        """Read both clocks.

        Raises
        ------
        InputError : the kernel's identifier of this boot cannot be read.
        """
        if not hasattr(time, "CLOCK_BOOTTIME"):  # a bench that is emulated on another system rests within one process
            return cls(time.time(), PROCESS_TOKEN, time.monotonic())
        return cls(time.time(), _boot(), time.clock_gettime(time.CLOCK_BOOTTIME))

    def surely_since(self, earlier: "ClockReadings") -> float:
        """Return the least time since an earlier moment [s].

        In the same boot it is the difference of the kernel's clock. A moment of another boot lies before this boot, if
        it is of this machine. It may be of another machine that shares the folder: the time is therefore no longer than
        the difference of the wall clocks, on which such machines must agree.

        Raises
        ------
        ValueError : a clock of the earlier moment is no finite number, or it is ahead of this moment in the same boot.
        """
        if not math.isfinite(earlier.wall):
            raise ValueError(f"it is of {earlier.wall:g} s since 1970, which is no time")
        if not (math.isfinite(earlier.since_boot) and earlier.since_boot >= 0.0):
            raise ValueError(f"it is of {earlier.since_boot:g} s after a boot, which is no time")
        if self.boot != earlier.boot:
            return max(0.0, min(self.since_boot, self.wall - earlier.wall))
        if earlier.since_boot > self.since_boot:
            raise ValueError(
                f"it is of the future, {earlier.since_boot - self.since_boot:.3g} s ahead of this boot's clock"
            )
        return self.since_boot - earlier.since_boot


@cache
def _boot() -> str:
    """Return the kernel's identifier of this boot, read once, so that the end of a run needs no descriptor for it."""
    try:
        return BOOT_ID_PATH.read_text(encoding="ascii").strip()
    except OSError as error:
        raise InputError(
            f"{BOOT_ID_PATH}: {error.strerror or error}; how long a winding rests is counted from boot"
        ) from None
