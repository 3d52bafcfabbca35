"""The emulated bench's time: it passes only while somebody waits, and everything that lives on the bench keeps step."""

import math
import time
from collections.abc import Callable


class EmulatedClock:
    """A clock whose seconds are produced by the waiting itself; the same waits give the same run.

    With `realtime` it produces them no faster than the wall clock.
    """

    def __init__(self, realtime: bool = False) -> None:
        self._time = 0.0
        self._wall = time.monotonic() if realtime else None
        self._followers: list[Callable[[float], None]] = []
        self._stops: list[Callable[[], float]] = []

    def follow(self, advance: Callable[[float], None]) -> None:
        """Call `advance(time)` whenever time has passed."""
        self._followers.append(advance)

    def stop_at(self, due: Callable[[], float]) -> None:
        """Let no time step go past the moment that this gives, in the future or infinity."""
        self._stops.append(due)

    def now(self) -> float:
        """Emulated seconds since the bench was made."""
        return self._time

    def sleep_until(self, moment: float) -> None:
        """Let time pass up to the moment."""
        while moment > self._time:
            until = moment
            for due in self._stops:
                stop = due()
                if self._time < stop < until:
                    until = stop
            if self._wall is not None:
                time.sleep(max(0.0, self._wall + until - time.monotonic()))
            self._time = until
            for advance in self._followers:
                advance(until)


class HostClock:
    """Emulated time as the host's clock shows it: a jump moves what it shows, and nothing on the bench."""

    def __init__(self, time: EmulatedClock) -> None:
        self._time = time
        self.ahead = 0.0  # of the bench's time [s]

    def now(self) -> float:
        """Seconds; a jump may take them back."""
        return self._time.now() + self.ahead

    def sleep_until(self, moment: float) -> None:
        """Let time pass for as long as the clock shows now that it should."""
        until = moment - self.ahead
        while until + self.ahead < moment:  # rounded down: a host that waits for the moment would wait for ever
            until = math.nextafter(until, math.inf)
        self._time.sleep_until(until)
