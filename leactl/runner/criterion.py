"""Whether a channel meets the criterion of an `until`: a statistic over the latest window, judged as samples come."""

import math
from collections import deque
from typing import NamedTuple

from leactl.protocol.plan import LEAST_SAMPLES, Until

PARTS = 10  # of a window: its statistic is judged as each of them ends


class Moments(NamedTuple):
    """Number, means and sums of squares about the means of times [s] and values."""

    samples: int = 0
    time: float = 0.0
    value: float = 0.0
    time_time: float = 0.0
    time_value: float = 0.0
    value_value: float = 0.0

    def joined(self, other: "Moments") -> "Moments":
        """Those of both together (Chan, Golub and LeVeque 1983), which loses no digits to large means."""
        count = self.samples + other.samples
        if not count:
            return self
        share, weight = other.samples / count, self.samples * other.samples / count
        time, value = other.time - self.time, other.value - self.value
        return Moments(
            count,
            self.time + share * time,
            self.value + share * value,
            self.time_time + other.time_time + weight * time * time,
            self.time_value + other.time_value + weight * time * value,
            self.value_value + other.value_value + weight * value * value,
        )

    def statistic(self, name: str) -> float:
        """Mean, standard deviation, or slope [1/s]; NaN of too few samples."""
        if self.samples < LEAST_SAMPLES:
            return math.nan
        if name == "mean":
            return self.value
        if name == "std":
            return math.sqrt(self.value_value / (self.samples - 1))
        return self.time_value / self.time_time if self.time_time > 0.0 else math.nan


class Judge:
    """Takes the samples of one channel from a moment on and tells once the criterion is met.

    A window that holds a missing sample, or to which the channel gave too few, meets nothing.
    """

    def __init__(self, until: Until, start: float) -> None:
        self._until, self._start = until, start
        self._part, self._part_s = Moments(), until.window_s / PARTS
        self._parts: deque[Moments] = deque(maxlen=PARTS)
        self.latest = math.nan  # statistic of the last window that was judged

    def receive(self, time: float, value: float) -> None:
        """Take a sample; one from before the start is no part of any window."""
        if time >= self._start:
            self._part = self._part.joined(Moments(1, time, value))

    def met(self, time: float) -> bool:
        """Whether the window that has ended by this time meets the criterion."""
        ended = False
        while time >= self._start + self._part_s * (1.0 - 1e-9):  # a sum of periods may lack a rounding error
            ended = True
            self._start += self._part_s
            self._parts.append(self._part)
            self._part = Moments()
        if not ended or len(self._parts) < PARTS:
            return False
        window = Moments()
        for part in self._parts:
            window = window.joined(part)
        self.latest = window.statistic(self._until.statistic)
        return self._until.low <= self.latest <= self._until.high
