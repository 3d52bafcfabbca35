"""The one clock that everything on a bench asks; the emulated bench has another of the same shape."""

import time
from typing import Protocol


class Clock(Protocol):
    """Monotonic seconds."""

    def now(self) -> float:
        """Seconds since an arbitrary moment; never goes back."""

    def sleep_until(self, moment: float) -> None:
        """Return at the moment, or at once where it has passed."""


class MonotonicClock:
    """The host's monotonic clock."""

    now = staticmethod(time.monotonic)

    def sleep_until(self, moment: float) -> None:
        """Return at the moment, or at once where it has passed."""
        left = moment - time.monotonic()
        if left > 0:
            time.sleep(left)
