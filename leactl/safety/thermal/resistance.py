"""Lowest winding temperature that voltage over current at two leads allows.

Copper gains resistance with temperature, and two leads of a star measure twice a phase. The highest resistance that the
motor file's tolerances allow at the reference temperature gives the lowest temperature that such a reading can mean.
"""

import math

from leactl.safety.thermal.box import Box

LEAST_CURRENT_A = 1.0  # below, offsets are a large part of the current reading
WINDOW_S = 1.0  # whose lowest reading counts: voltage and current are not read at one moment


class LeadResistance:
    """Resistance between one pair of leads, followed reading by reading."""

    def __init__(self, box: Box) -> None:
        self._cold = 2.0 * box.phase_resistance.high
        self._rise, self._reference = box.resistance_coefficient.high, box.reference_temperature
        self._since, self._least = math.nan, math.inf

    def least(self, voltage: float, current: float, now: float) -> float:
        """Take one reading [V, A, s]; return the lowest temperature that the last `WINDOW_S` allow [degC].

        NaN until that time has passed, and where the current is below `LEAST_CURRENT_A` or a reading is NaN.
        """
        if not abs(current) >= LEAST_CURRENT_A or voltage != voltage:
            self._since, self._least = math.nan, math.inf
            return math.nan
        if not self._since <= now:
            self._since = now
        warmth = (abs(voltage / current) / self._cold - 1.0) / self._rise
        self._least = min(self._least, self._reference + warmth)
        if now - self._since < WINDOW_S:
            return math.nan
        lowest, self._since, self._least = self._least, now, math.inf
        return lowest
