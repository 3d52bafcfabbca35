"""Checks of the loop's pace and of the bench's clock, from one check of the loop to the next."""

import math
from collections import deque

from leactl.safety.interlocks import ClockJump, LoopOverruns
from leactl.safety.watching import Trip

LEAST_JUMP_CYCLES = 5  # a step of the clock by less is no jump, however short the cycles


class Pace:
    """Trips on overruns, too many in a row or too large a share, and on a clock that goes back or leaps."""

    def __init__(self, overruns: LoopOverruns, clock_jump: ClockJump, trip: Trip, now: float) -> None:
        self._overruns, self._clock_jump, self._trip = overruns, clock_jump, trip
        self.period, self._longest_step = math.inf, math.inf
        # a check from previous_check to check_deadline is on time: the supervisor then moves both itself, and does not
        # call `judge_late`
        self.previous_check, self.check_deadline = now, math.inf
        self._in_a_row, self._last_overrun_at, self._most_overruns = 0, math.nan, math.inf
        self._overrun_times: deque[float] = deque()

    def begin(self, period: float, now: float) -> None:
        """Begin with cycles of `period` [s] at the time `now` [s]."""
        self.period, self.previous_check, self.check_deadline = period, now, now + period
        self._longest_step = max(self._clock_jump.jump_s, LEAST_JUMP_CYCLES * period)
        self._most_overruns = self._overruns.share_percent / 100 * self._overruns.window_s / period

    def judge_late(self, now: float) -> None:
        """Trip if the clock has jumped or too many checks are late.

        Call it for a check outside `previous_check` to `check_deadline`.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        self._judge(now)
        # the next check is due in one period and may be late by another
        self.check_deadline = now + 2 * self.period
        self.previous_check = now

    def _judge(self, now: float) -> None:
        """Trip on a step of the clock, or count an overrun and trip if there are too many."""
        step = now - self.previous_check
        if not step >= 0:
            self._trip(f"the bench's clock went back by {-step:.4g} s")
        if step > self._longest_step:
            self._trip(f"the bench's clock went on by {step:.4g} s in one cycle; {self._longest_step:g} s are allowed")
        # if the previous check was the last overrun, no check between the two overruns was on time
        self._in_a_row = self._in_a_row + 1 if self.previous_check == self._last_overrun_at else 1
        self._last_overrun_at = now
        self._overrun_times.append(now)
        while now - self._overrun_times[0] > self._overruns.window_s:
            self._overrun_times.popleft()
        if self._in_a_row >= self._overruns.in_a_row:
            self._trip(f"{self._in_a_row} loop overruns in a row; fewer than {self._overruns.in_a_row} are allowed")
        if len(self._overrun_times) > self._most_overruns:
            self._trip(
                f"{len(self._overrun_times)} loop overruns in {self._overruns.window_s:g} s;"
                f" {self._overruns.share_percent:g} % of the cycles are allowed"
            )
