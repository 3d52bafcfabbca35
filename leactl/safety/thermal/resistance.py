"""The winding as its own thermometer: voltage over current at two leads, against the bound.

Copper gains resistance with temperature, and two leads of a star measure twice a phase. The highest resistance that the
motor file's tolerances allow at the reference temperature gives the lowest temperature that such a reading can mean.
"""

import math

from leactl.safety.thermal.box import Box

LEAST_A = 1.0  # below, offsets of the reading are a large part of it
LASTING_S = 1.0  # voltage and current are not read at the same moment: a change of either is none of resistance


class LeadResistance:
    """One pair of leads."""

    def __init__(self, box: Box) -> None:
        self._cold = 2.0 * box.phase_resistance.high
        self._rise, self._reference = box.resistance_coefficient.high, box.reference_temperature
        self._since, self._least = math.nan, math.inf

    def least(self, voltage: float, current: float, now: float) -> float:
        """Lowest temperature that the readings of the last `LASTING_S` can mean [degC]; NaN where they tell none."""
        if not abs(current) >= LEAST_A or voltage != voltage:
            self._since, self._least = math.nan, math.inf
            return math.nan
        if not self._since <= now:
            self._since = now
        warmth = (abs(voltage / current) / self._cold - 1.0) / self._rise
        self._least = min(self._least, self._reference + warmth)
        if now - self._since < LASTING_S:
            return math.nan
        lowest, self._since, self._least = self._least, now, math.inf
        return lowest
