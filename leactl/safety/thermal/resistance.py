"""Lowest winding temperature that voltage over current at two leads allows.

Copper gains resistance with temperature, and two leads of a star measure twice a phase. The highest resistance at the
reference temperature and the highest temperature coefficient within the motor file's tolerances give, above that
temperature, the lowest temperature that such a reading can mean.
"""

import math

from leactl.safety.thermal.box import Box

LEAST_CURRENT_A = 1.0  # below, offsets are a large part of the current reading
# the lowest reading of a window counts: voltage and current are not read at the same moment
WINDOW_S = 1.0


class ResistanceThermometer:
    """Lowest winding temperature by the resistance between two leads, window by window."""

    def __init__(self, box: Box) -> None:
        self._highest_reference_resistance = 2.0 * box.phase_resistance.high
        self._highest_coefficient, self._reference_temperature = (
            box.resistance_coefficient.high,
            box.reference_temperature,
        )
        self._window_began, self._lowest_temperature = math.nan, math.inf

    def lowest_temperature(self, voltage: float, current: float, now: float) -> float:
        """Take one reading [V, A, s]; return the lowest temperature that the readings of a window allow [degC].

        The result is NaN except at the end of a window of `WINDOW_S`. A current below `LEAST_CURRENT_A`, or a reading
        that is NaN, discards the window.
        """
        if not abs(current) >= LEAST_CURRENT_A or voltage != voltage:
            self._window_began, self._lowest_temperature = math.nan, math.inf
            return math.nan
        if not self._window_began <= now:
            self._window_began = now
        temperature_rise = (
            abs(voltage / current) / self._highest_reference_resistance - 1.0
        ) / self._highest_coefficient
        self._lowest_temperature = min(self._lowest_temperature, self._reference_temperature + temperature_rise)
        if now - self._window_began < WINDOW_S:
            return math.nan
        lowest_of_window, self._window_began, self._lowest_temperature = self._lowest_temperature, now, math.inf
        return lowest_of_window
