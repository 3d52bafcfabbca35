"""The time of the emulated bench: it passes only while someone waits, and the whole bench keeps step with it."""

import math
import time
from collections.abc import Callable


class EmulatedClock:
    """A clock that advances only while someone waits on it; the same waits give the same run.

    With `realtime` it advances no faster than the wall clock.
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
        """Stop each time step at the moment that `due` returns, if that is in the future; infinity means no stop."""
        self._stops.append(due)

    def now(self) -> float:
        """Emulated time since the bench was made [s]."""
        return self._time

    def sleep_until(self, moment: float) -> None:
        """Advance the time to the moment [s]."""
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
    """Emulated time as the host's clock shows it: a jump changes the host's time, but not the bench's."""

    def __init__(self, time: EmulatedClock) -> None:
        self._time = time
        self.ahead = 0.0  # of the bench's time [s]

    def now(self) -> float:
        """Time of the host's clock [s]; a jump may set it back."""
        return self._time.now() + self.ahead

    def sleep_until(self, moment: float) -> None:
        """Advance the bench's time until the host's clock, as it runs now, shows the moment [s]."""
        until = moment - self.ahead
        while until + self.ahead < moment:  # rounded down: a host that waits for the moment would wait for ever
            until = math.nextafter(until, math.inf)
        self._time.sleep_until(until)
