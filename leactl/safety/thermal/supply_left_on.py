"""A supply that nobody switches off: levels that a winding endures for ever, and the trip level of the supply.

A supply expects no sign of life of the host: it keeps its levels when every process is dead. Its current limit bounds
the heat by R i^2, which rises with the temperature of the winding. Both limits together bound the heat by voltage times
current, whatever the resistance; no more current flows than through the coldest winding of the lowest resistance. The
steady state of the bound under the most heat that its limit allows is a ceiling: a winding that begins below it in
every node stays below it under no more heat than that, for the bound is a cooperative system.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from leactl.driver.contract import TripAccuracy
from leactl.safety.limits import LEADS
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.guarded_currents import current_at_limit, settled_temperature
from leactl.safety.thermal.temperature_bound import HOTTEST, MEAN, OTHER_PHASES, ThermalBound
from leactl.safety.thermal.turning import LEAD_LOOSE_SHARE

# the output voltage may differ from its setting by the sum of both; drivers report more as out of regulation
VOLTAGE_ERROR_SHARE, VOLTAGE_ERROR_V = 0.03, 0.1


@dataclass(frozen=True)
class Endurance:
    """Current and power that two leads of an actuator endure for ever without the winding passing its limit."""

    current: float  # A, at any voltage
    power: float  # W, at any current
    current_gain: float  # true current over the setting, at the most
    lowest_resistance: float  # ohm, between the leads
    start_ceilings: tuple[float, ...]  # degC, of hottest phase, mean and housing at the start, of the coolest cell

    def outlives(self, voltage: float, current: float, start: Sequence[float]) -> bool:
        """Return whether a winding that begins below the bounds `start` [degC] endures these levels [V, A] for ever."""
        if not all(node <= ceiling for node, ceiling in zip(start, self.start_ceilings, strict=True)):
            return False
        return (
            current <= self.current
            or _highest_heat(voltage, self.current_gain * current, self.lowest_resistance) <= self.power
        )

    def highest_current(self, voltage: float) -> float:
        """Return the highest current [A] that is endured at this voltage [V]; infinite if any current is endured."""
        output = _highest_output(voltage)
        if output**2 <= self.power * self.lowest_resistance:
            return math.inf
        return max(self.current, self.power / (output * self.current_gain))

    def highest_voltage(self, current: float) -> float:
        """Return the highest voltage setting [V] with which a supply limited to this current [A] may be left on."""
        highest_output = max(self.power / (self.current_gain * current), math.sqrt(self.power * self.lowest_resistance))
        return max(0.0, (highest_output - VOLTAGE_ERROR_V) / (1.0 + VOLTAGE_ERROR_SHARE))


@lru_cache(maxsize=16)
def endurance(box: Box, limit: float, ambient: float) -> Endurance:
    """Return what two leads of an actuator endure for ever; limit of the hottest phase and ambient in degC."""
    current = current_at_limit(box, limit, ambient, settled_temperature(ambient, LEAD_LOOSE_SHARE, 0.0)) / LEADS**0.5
    bound = _settled_bound(box, ambient, current)
    return Endurance(
        current=current,
        power=_absorbed_heat(box, bound, current),
        current_gain=box.current_gain,
        lowest_resistance=_lowest_resistance(box, ambient),
        start_ceilings=tuple(float(node) for node in bound.state.min(axis=1)),
    )


@lru_cache(maxsize=64)
def temperature_reached(box: Box, ambient: float, voltage: float, current: float) -> float:
    """Return an upper bound of the temperature [degC] at which the hottest phase settles with these levels [V, A].

    ambient : degC.
    """
    from scipy.optimize import brentq

    power = _highest_heat(voltage, box.current_gain * current, _lowest_resistance(box, ambient))

    def excess_power(amperes: float) -> float:
        return _absorbed_heat(box, _settled_bound(box, ambient, amperes), amperes) - power

    settled_current = float(brentq(excess_power, 0.0, current, xtol=1e-3)) if excess_power(current) > 0.0 else current
    return float(_settled_bound(box, ambient, settled_current).hottest()[0])


def trip_level(
    box: Box, limit: float, phase_difference: float, voltage: float, current: float, accuracy: TripAccuracy
) -> float | None:
    """Return the voltage [V] at which a supply's protection must end a current to keep the winding below its limit.

    The voltage at a constant current rises with the winding's resistance and thus with its temperature. The protection
    must end the current while a winding of the lowest resistance is below the limit, and before the supply reaches its
    voltage limit and gives less current. Return None if every level that does both ends the current at once.

    Parameters
    ----------
    limit : degC, of the hottest phase.
    phase_difference : how much hotter one of the two phases may be than the other [K]; it fades under equal currents.
    voltage, current : levels of the supply [V, A].
    accuracy : how far the protection may trip from its level.
    """
    reference_resistance, coefficient = box.phase_resistance, box.resistance_coefficient
    resistance = (
        LEADS
        * reference_resistance.low
        * (1.0 + coefficient.low * (limit - 0.5 * phase_difference - box.reference_temperature))
    )
    highest_level = min(
        resistance * current / box.current_gain, voltage * (1.0 - VOLTAGE_ERROR_SHARE) - VOLTAGE_ERROR_V
    )
    level = accuracy.level_below(highest_level)
    # a level below this voltage would end the current at once
    initial_voltage = 0.5 * LEADS * (reference_resistance.low + reference_resistance.high) * current
    return level if level > initial_voltage else None


def _highest_heat(voltage: float, highest_current: float, lowest_resistance: float) -> float:
    """Return the highest power of a supply [W] at this set voltage [V] into a resistance [ohm] no lower than this.

    highest_current : A, above its setting by the error of the supply.
    """
    highest_voltage = _highest_output(voltage)
    return highest_voltage * min(highest_current, highest_voltage / lowest_resistance)


def _highest_output(voltage: float) -> float:
    """Return the highest output of a supply that is set to a voltage [V]."""
    return voltage * (1.0 + VOLTAGE_ERROR_SHARE) + VOLTAGE_ERROR_V


def _lowest_resistance(box: Box, ambient: float) -> float:
    """Return the lowest resistance between two leads [ohm], that of a winding as cold as the coldest air."""
    coldest_rise = ambient - box.ambient_rise - box.reference_temperature
    coefficient = box.resistance_coefficient
    return (
        LEADS * box.phase_resistance.low * (1.0 + min(coefficient.low * coldest_rise, coefficient.high * coldest_rise))
    )


def _settled_bound(box: Box, ambient: float, current: float) -> ThermalBound:
    """Return the bound in its steady state with a current [A] through two leads."""
    bound = ThermalBound([box], ambient)
    bound.settle(np.array([LEADS * current**2]), np.array([LEAD_LOOSE_SHARE]), np.zeros(1), ambient)
    return bound


def _absorbed_heat(box: Box, bound: ThermalBound, current: float) -> float:
    """Return the copper heat [W] that a settled bound takes in, at the least.

    It is that of the mean of the phases, which takes less than the hottest phase, at the coolest cells.
    """
    hottest, mean = bound.state[HOTTEST].min(), bound.state[MEAN].min()
    temperature_rise = OTHER_PHASES * hottest + (1.0 - OTHER_PHASES) * mean - box.reference_temperature
    square_current = LEADS * (box.current_gain * current) ** 2
    return float(
        box.phase_resistance.high * square_current * (1.0 + box.resistance_coefficient.high * temperature_rise)
    )
