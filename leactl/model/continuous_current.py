"""Compute the constant current that heats an actuator's hottest phase to a limit, in steady state or in a given time.

The model has three phases, each with a third of the winding, and a housing. A constant power-invariant q-axis current
makes the copper heat R(T) i^2, which is linear in the temperatures, so that the solution is exact. In a turning motor
each phase takes a third of the heat; at standstill one phase takes two thirds and the other two a sixth each.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.model.thermal_network import Conductances
from leactl.model.winding import resistance_ratio

Array = npt.NDArray[np.float64]
TURNING_HEAT_SHARE, STANDING_HEAT_SHARE = 1.0 / 3.0, 2.0 / 3.0  # of the copper heat, in the hottest phase
STEADY_STATE = np.inf  # s, duration of the continuous current
HIGHEST_CURRENT = 1e12  # A, up to which a current is searched; a millisecond in a milliohm needs below 1e6
RUNAWAY_RISE = 1e6  # K, returned for a winding whose temperature has no steady state


@dataclass(frozen=True)
class ThermalActuator:
    """Thermal network of winding and housing, and the resistance of a phase as a function of temperature."""

    network: Conductances
    phase_resistance: float  # ohm, at the reference temperature
    resistance_coefficient: float  # 1/K
    reference_temperature: float  # degC


def current_for_rise(
    actuator: ThermalActuator, rise: float, ambient: float, duration: float, hottest_share: float = TURNING_HEAT_SHARE
) -> float:
    """Return the constant q-axis current [A] that heats the hottest phase from ambient by `rise` in `duration`.

    Parameters
    ----------
    rise : temperature rise of the hottest phase above ambient at the end [K].
    ambient : temperature of the air, and of the actuator at the beginning [degC].
    duration : s, `STEADY_STATE` for the continuous current.
    hottest_share : share of the copper heat in the hottest phase, `TURNING_HEAT_SHARE` to `STANDING_HEAT_SHARE`.

    Returns
    -------
    The current; NaN if `rise` is not positive, if no current reaches it (zero resistance or duration), or if a
    parameter of the actuator is NaN.
    """
    from scipy.optimize import brentq

    def excess_rise(current: float) -> float:
        return hottest_rise(actuator, current, ambient, duration, hottest_share) - rise

    if not excess_rise(0.0) < 0.0:
        return float("nan")
    upper_current = 1.0
    while excess_rise(upper_current) < 0.0:
        upper_current *= 2.0
        if upper_current > HIGHEST_CURRENT:
            return float("nan")
    return float(brentq(excess_rise, 0.0, upper_current, xtol=1e-9 * upper_current))


def hottest_rise(
    actuator: ThermalActuator, current: float, ambient: float, duration: float, hottest_share: float
) -> float:
    """Return the rise [K] of the hottest phase above ambient, after `duration` [s] from ambient temperature.

    The rise is capped at `RUNAWAY_RISE`, which is also returned if the temperature has no steady state; it is NaN if a
    parameter is NaN.
    """
    from scipy.linalg import expm

    network = actuator.network
    # of the hottest phase, the other two as one node, and the housing
    heat_shares = np.array([hottest_share, 1.0 - hottest_share, 0.0])
    heat = actuator.phase_resistance * current**2 * heat_shares
    capacitances = np.array(
        [network.winding_capacitance / 3, 2 * network.winding_capacitance / 3, network.housing_capacitance]
    )
    node_shares = np.array([1.0, 2.0]) / 3.0  # of the winding: the hottest phase, and the other two
    conductance_matrix = np.diag(
        [
            *(node_shares * (network.winding_ambient + network.winding_housing)),
            network.winding_housing + network.housing_ambient,
        ]
    )
    conductance_matrix[:2, 2] = conductance_matrix[2, :2] = -node_shares * network.winding_housing
    resistance_factor = resistance_ratio(ambient, actuator.resistance_coefficient, actuator.reference_temperature)
    rates = (np.diag(actuator.resistance_coefficient * heat) - conductance_matrix) / capacitances[:, None]
    heating_at_ambient = heat * resistance_factor / capacitances
    if not (np.isfinite(rates).all() and np.isfinite(heating_at_ambient).all()):
        return float("nan")
    if np.isinf(duration):
        stable = np.max(np.linalg.eigvals(rates).real) < 0.0
        return float(min(np.linalg.solve(-rates, heating_at_ambient)[0], RUNAWAY_RISE)) if stable else RUNAWAY_RISE
    augmented = np.zeros((4, 4))
    augmented[:3, :3], augmented[:3, 3] = rates, heating_at_ambient
    with np.errstate(over="ignore", invalid="ignore"):
        hottest = float(expm(augmented * duration)[0, 3])
    # the exponential of a runaway overflows
    return min(hottest, RUNAWAY_RISE) if np.isfinite(hottest) else RUNAWAY_RISE
