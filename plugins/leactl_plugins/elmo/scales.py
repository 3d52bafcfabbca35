"""What the numbers of an Elmo drive mean: its amperes on the q axis, and its counts where they go round."""

import math
from enum import StrEnum


class CurrentConvention(StrEnum):
    """What the drive means by its current; each is a fixed factor to the power-invariant q axis."""

    AMPLITUDE = "amplitude"
    POWER_INVARIANT = "power_invariant"
    RMS = "rms"

    @property
    def to_q_axis(self) -> float:
        """Power-invariant q-axis amperes per ampere that the drive reports."""
        return {"amplitude": math.sqrt(1.5), "power_invariant": 1.0, "rms": math.sqrt(3.0)}[self.value]


class CountedPosition:
    """Counts of the encoder, going on where the drive's own go round."""

    def __init__(self, low: int, high: int) -> None:
        self._low, self._span = low, high - low
        self._unmet = low - 2 * self._span  # further than any reading, which is taken as it is
        self.counts = self._unmet
        self.located = False  # the shaft's angle is known since operation was asked for
        self.half = (high - low) // 2

    def nearest(self, counts: int) -> int:
        """The position closest to the last one that the drive shows as these counts."""
        if self.counts == self._unmet:
            return counts
        return self.counts + (counts - self.counts + self.half) % self._span - self.half

    def shown(self, counts: int) -> int:
        """A position as the drive holds it."""
        return (counts - self._low) % self._span + self._low
