"""Judge whether a channel meets the criterion of an `until`: a statistic over the latest window lies in a range."""

import math
from collections import deque
from typing import NamedTuple

from leactl.protocol.plan import FEWEST_WINDOW_SAMPLES, Until

WINDOW_PARTS = 10  # the statistic is judged at the end of each part


class Moments(NamedTuple):
    """Number, means and sums of squares about the means of times [s] and values."""

    samples: int = 0
    time: float = 0.0
    value: float = 0.0
    time_time: float = 0.0
    time_value: float = 0.0
    value_value: float = 0.0

    def joined(self, added: "Moments") -> "Moments":
        """Return the moments of two sets of samples together; no digits are lost where means are large.

        Source: Chan, Golub and LeVeque (1983).
        """
        count = self.samples + added.samples
        if not count:
            return self
        share, weight = added.samples / count, self.samples * added.samples / count
        time_shift, value_shift = added.time - self.time, added.value - self.value
        return Moments(
            count,
            self.time + share * time_shift,
            self.value + share * value_shift,
            self.time_time + added.time_time + weight * time_shift * time_shift,
            self.time_value + added.time_value + weight * time_shift * value_shift,
            self.value_value + added.value_value + weight * value_shift * value_shift,
        )

    def statistic(self, name: str) -> float:
        """Return the mean, standard deviation or slope over time [1/s] of the values; NaN if there are too few.

        Parameters
        ----------
        name : `mean`, `std` or `slope`.
        """
        if self.samples < FEWEST_WINDOW_SAMPLES:
            return math.nan
        if name == "mean":
            return self.value
        if name == "std":
            return math.sqrt(self.value_value / (self.samples - 1))
        return self.time_value / self.time_time if self.time_time > 0.0 else math.nan


class Judge:
    """Judges the samples of one channel, from a start time on, by one criterion.

    A window with a missing sample, or with fewer than `FEWEST_WINDOW_SAMPLES` samples, does not meet the criterion.
    """

    def __init__(self, until: Until, start: float) -> None:
        self._until, self._start = until, start
        self._part, self._part_s = Moments(), until.window_s / WINDOW_PARTS
        self._parts: deque[Moments] = deque(maxlen=WINDOW_PARTS)
        self.latest = math.nan  # statistic of the last window that was judged

    def receive(self, time: float, value: float) -> None:
        """Add a sample [time in s] to the present part of the window; an older sample is left out."""
        if time >= self._start:
            self._part = self._part.joined(Moments(1, time, value))

    def met(self, time: float) -> bool:
        """Return whether a part has ended since the last call, and the window up to its end meets the criterion.

        Parameters
        ----------
        time : now [s].
        """
        part_ended = False
        while time >= self._start + self._part_s * (1.0 - 1e-9):  # rounding may leave a sum of periods a little short
            part_ended = True
            self._start += self._part_s
            self._parts.append(self._part)
            self._part = Moments()
        if not part_ended or len(self._parts) < WINDOW_PARTS:
            return False
        window = Moments()
        for part in self._parts:
            window = window.joined(part)
        self.latest = window.statistic(self._until.statistic)
        return self._until.low <= self.latest <= self._until.high
