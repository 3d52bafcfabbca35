"""Checks of the loop's pace and of the bench's clock, from one check of the loop to the next."""

import math
from collections import deque

from leactl.safety.interlocks import ClockJump, LoopOverruns
from leactl.safety.watching import Trip

LEAST_JUMP_CYCLES = 5


class Pace:
    """Trips on overruns, too many in a row or too large a share, and on a clock that goes back or leaps."""

    def __init__(self, overruns: LoopOverruns, clock: ClockJump, trip: Trip, now: float) -> None:
        self._overruns, self._clock, self._trip = overruns, clock, trip
        self.period, self._longest = math.inf, math.inf
        self.last, self.latest = now, math.inf  # a check between these times keeps the pace, and needs no `look`
        self._in_a_row, self._late_at, self._most = 0, math.nan, math.inf
        self._late: deque[float] = deque()

    def begin(self, period: float, now: float) -> None:
        """Begin with cycles of `period` [s] at the time `now` [s]."""
        self.period, self.last, self.latest = period, now, now + period
        self._longest = max(self._clock.jump_s, LEAST_JUMP_CYCLES * period)
        self._most = self._overruns.share_percent / 100 * self._overruns.window_s / period

    def look(self, now: float) -> None:
        """Judge a check whose time went back, or that came more than a period after it was due.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        self._judge(now)
        self.latest = now + 2 * self.period
        self.last = now

    def _judge(self, now: float) -> None:
        step = now - self.last
        if not step >= 0:
            self._trip(f"the bench's clock went back by {-step:.4g} s")
        if step > self._longest:
            self._trip(f"the bench's clock went on by {step:.4g} s in one cycle; {self._longest:g} s are allowed")
        self._in_a_row = self._in_a_row + 1 if self.last == self._late_at else 1
        self._late_at = now
        self._late.append(now)
        while now - self._late[0] > self._overruns.window_s:
            self._late.popleft()
        if self._in_a_row >= self._overruns.in_a_row:
            self._trip(f"{self._in_a_row} loop overruns in a row; fewer than {self._overruns.in_a_row} are allowed")
        if len(self._late) > self._most:
            self._trip(
                f"{len(self._late)} loop overruns in {self._overruns.window_s:g} s;"
                f" {self._overruns.share_percent:g} % of the cycles are allowed"
            )
