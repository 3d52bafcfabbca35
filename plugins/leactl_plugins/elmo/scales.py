"""Scales of an Elmo drive: its current as q-axis current, and its encoder counts unwrapped."""

import math
from enum import StrEnum


class CurrentConvention(StrEnum):
    """Definition of the drive's current; each has a fixed factor to the power-invariant q-axis current."""

    AMPLITUDE = "amplitude"
    POWER_INVARIANT = "power_invariant"
    RMS = "rms"

    @property
    def to_q_axis(self) -> float:
        """Power-invariant q-axis amperes per ampere that the drive reports."""
        return {"amplitude": math.sqrt(1.5), "power_invariant": 1.0, "rms": math.sqrt(3.0)}[self.value]


class CountedPosition:
    """Encoder counts, unwrapped where the drive's own counts wrap: from `low` to below `high`."""

    def __init__(self, low: int, high: int) -> None:
        self._low, self._span = low, high - low
        self._unknown = low - 2 * self._span  # outside the range; the first reading is not unwrapped
        self.counts = self._unknown  # unwrapped
        self.located = False  # whether the shaft's angle was read since operation was commanded
        self.half_span = (high - low) // 2

    def nearest(self, counts: int) -> int:
        """Return the unwrapped position that is closest to the last one, for counts of the drive."""
        if self.counts == self._unknown:
            return counts
        return self.counts + (counts - self.counts + self.half_span) % self._span - self.half_span

    def wrapped(self, counts: int) -> int:
        """Return the drive's wrapped counts for an unwrapped position."""
        return (counts - self._low) % self._span + self._low
