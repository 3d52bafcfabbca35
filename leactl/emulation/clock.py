"""The time of the emulated bench: it passes only while someone waits for it, and the whole bench keeps step with it."""

import math
import time
from collections.abc import Callable


class EmulatedClock:
    """A clock that advances only while someone waits for it; the same waits give the same run.

    With `realtime` it advances no faster than the wall clock.
    """

    def __init__(self, realtime: bool = False) -> None:
        self._time = 0.0
        self._wall_clock_start = time.monotonic() if realtime else None
        self._followers: list[Callable[[float], None]] = []
        self._stops: list[Callable[[], float]] = []

    def follow(self, advance: Callable[[float], None]) -> None:
        """Call `advance` with the time [s] whenever time has passed."""
        self._followers.append(advance)

    def stop_at(self, next_stop: Callable[[], float]) -> None:
        """End each step at the time [s] that `next_stop` returns, if that is in the future; infinity means no stop."""
        self._stops.append(next_stop)

    def now(self) -> float:
        """Return the emulated time since the bench was made [s]."""
        return self._time

    def sleep_until(self, moment: float) -> None:
        """Advance the time to the moment [s]."""
        while moment > self._time:
            step_end = moment
            for next_stop in self._stops:
                stop_time = next_stop()
                if self._time < stop_time < step_end:
                    step_end = stop_time
            if self._wall_clock_start is not None:
                time.sleep(max(0.0, self._wall_clock_start + step_end - time.monotonic()))
            self._time = step_end
            for advance in self._followers:
                advance(step_end)


class HostClock:
    """Emulated time as the host's clock shows it: a jump changes the host's time, but not the bench's."""

    def __init__(self, time: EmulatedClock) -> None:
        self._time = time
        self.ahead = 0.0  # s, time of the host's clock minus the bench's time

    def now(self) -> float:
        """Return the time of the host's clock [s], which a jump may set back."""
        return self._time.now() + self.ahead

    def sleep_until(self, moment: float) -> None:
        """Advance the bench's time until the host's clock, as it runs now, shows the moment [s]."""
        bench_time = moment - self.ahead
        while bench_time + self.ahead < moment:  # rounded down, so that the host would wait for ever
            bench_time = math.nextafter(bench_time, math.inf)
        self._time.sleep_until(bench_time)
