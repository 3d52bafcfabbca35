"""A supply that nobody switches off: what two leads carry for ever, and where a supply's own protection has to end it.

A supply waits for no sign of life: when every process is dead it keeps its levels. Its current limit bounds the heat by
R i^2, which rises with the winding. Both limits together bound it by voltage times current, whatever the resistance; no
more current flows than through the coldest winding of the lowest resistance. Where the bound settles under the most
heat that its limit allows is a ceiling: a winding that begins below it in every node stays below it under no more heat
than that, for the bound is a cooperative system.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from leactl.driver.contract import TripAccuracy
from leactl.safety.limits import LEADS
from leactl.safety.thermal.bound import HOTTEST, MEAN, OTHER_PHASES, ThermalBound
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.capability import at_limit, settled
from leactl.safety.thermal.turning import LED_LOOSE

# by which a supply may be above the voltage that it is set to; drivers call one that is further off out of regulation
ASTRAY, ASTRAY_V = 0.03, 0.1


@dataclass(frozen=True)
class Endured:
    """What two leads of an actuator carry for ever without passing a temperature."""

    current: float  # A, at any voltage
    power: float  # W, at any current
    gain: float  # true current over the one that is set, at the most
    coldest: float  # ohm, between the leads at the least
    nodes: tuple[float, ...]  # degC: the ceiling below which a winding has to begin, of the coolest cell

    def outlives(self, voltage: float, current: float, start: Sequence[float]) -> bool:
        """Whether a winding that begins below these bounds [degC] keeps below the limit with these levels [V, A]."""
        if not all(node <= ceiling for node, ceiling in zip(start, self.nodes, strict=True)):
            return False
        return current <= self.current or _heat(voltage, self.gain * current, self.coldest) <= self.power

    def most(self, voltage: float) -> float:
        """The highest current [A] that is outlived beside this voltage [V]; infinite where the voltage alone does."""
        highest = _highest(voltage)
        beside = math.inf if highest**2 <= self.power * self.coldest else self.power / (highest * self.gain)
        return max(self.current, beside)

    def voltage(self, current: float) -> float:
        """The highest level [V] beside this current [A] at which the supply itself holds the heat down."""
        highest = max(self.power / (self.gain * current), math.sqrt(self.power * self.coldest))
        return max(0.0, (highest - ASTRAY_V) / (1.0 + ASTRAY))


@lru_cache(maxsize=16)
def endured(box: Box, limit: float, ambient: float) -> Endured:
    """What two leads carry for ever; limit of the hottest phase and ambient in degC."""
    current = at_limit(box, limit, ambient, settled(ambient, LED_LOOSE, 0.0)) / LEADS**0.5
    bound = _left(box, ambient, current)
    ceiling = tuple(float(node) for node in bound.state.min(axis=1))
    return Endured(current, _power(box, bound, current), box.current_gain, _coldest(box, ambient), ceiling)


@lru_cache(maxsize=64)
def reached(box: Box, ambient: float, voltage: float, current: float) -> float:
    """What the hottest phase comes to at the most [degC] with these levels [V, A]; ambient in degC."""
    from scipy.optimize import brentq

    power = _heat(voltage, box.current_gain * current, _coldest(box, ambient))

    def over(amperes: float) -> float:
        return _power(box, _left(box, ambient, amperes), amperes) - power

    flowing = float(brentq(over, 0.0, current, xtol=1e-3)) if over(current) > 0.0 else current
    return float(_left(box, ambient, flowing).hottest()[0])


def trip_level(
    box: Box, limit: float, uneven: float, voltage: float, current: float, accuracy: TripAccuracy
) -> float | None:
    """The level [V] of a protection that ends a current before its winding passes the limit; None where there is none.

    The voltage of a constant current rises with the winding's resistance, by which the instrument sees the temperature:
    it has to end the current while the winding of the lowest resistance is below the limit, and before the supply is at
    its voltage and gives less current.

    Parameters
    ----------
    limit : degC, of the hottest phase.
    uneven : K, by which one of the two phases may be hotter than the other; equal currents let that fade.
    voltage, current : levels of the supply [V, A].
    """
    cold, rise = box.phase_resistance, box.resistance_coefficient
    resistance = LEADS * cold.low * (1.0 + rise.low * (limit - 0.5 * uneven - box.reference_temperature))
    highest = min(resistance * current / box.current_gain, voltage * (1.0 - ASTRAY) - ASTRAY_V)
    level = accuracy.level_below(highest)
    begins = 0.5 * LEADS * (cold.low + cold.high) * current  # a level below this would end it at once
    return level if level > begins else None


def _heat(voltage: float, most: float, coldest: float) -> float:
    """What a supply may feed at the most [W], set to a voltage [V]; of its current [A] no more than flows when cold."""
    highest = _highest(voltage)
    return highest * min(most, highest / coldest)


def _highest(voltage: float) -> float:
    """What a supply that is set to a voltage [V] may put out."""
    return voltage * (1.0 + ASTRAY) + ASTRAY_V


def _coldest(box: Box, ambient: float) -> float:
    """Resistance between two leads at the least [ohm]."""
    below = ambient - box.ambient_rise - box.reference_temperature
    rise = box.resistance_coefficient
    return LEADS * box.phase_resistance.low * (1.0 + min(rise.low * below, rise.high * below))


def _left(box: Box, ambient: float, current: float) -> ThermalBound:
    """Where the bound settles with a current [A] through two leads."""
    bound = ThermalBound([box], ambient)
    bound.settle(np.array([LEADS * current**2]), np.array([LED_LOOSE]), np.zeros(1), ambient)
    return bound


def _power(box: Box, bound: ThermalBound, current: float) -> float:
    """Heat [W] that the bound takes in there, of its coolest cell; the mean of the phases takes the least."""
    hottest, mean = bound.state[HOTTEST].min(), bound.state[MEAN].min()
    warm = OTHER_PHASES * hottest + (1.0 - OTHER_PHASES) * mean - box.reference_temperature
    squares = LEADS * (box.current_gain * current) ** 2
    return float(box.phase_resistance.high * squares * (1.0 + box.resistance_coefficient.high * warm))
