"""What an actuator whose parameters are known can carry: the current that takes its hottest phase to the limit.

Three phases of a third of the winding each, and a housing, with copper heat R(T) i^2 of a constant power-invariant
q-axis current: linear in the temperatures, and so solved exactly. Turning, a phase takes a third of the heat; standing,
one takes two thirds, and each of the others a sixth.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.model.thermal_network import Conductances

Array = npt.NDArray[np.float64]
TURNING, STANDING = 1.0 / 3.0, 2.0 / 3.0  # share of the heat in the hottest phase
STEADY_STATE = np.inf  # s
RUNAWAY_RISE = 1e6  # K


@dataclass(frozen=True)
class Winding:
    """A winding's network and its resistance."""

    network: Conductances
    phase_resistance: float  # ohm, at the reference temperature
    resistance_coefficient: float  # 1/K
    reference_temperature: float  # degC


def current_held(winding: Winding, rise: float, ambient: float, duration: float, share: float = TURNING) -> float:
    """Return the constant q-axis current [A] that heats the hottest phase from ambient by `rise` in `duration`.

    Parameters
    ----------
    rise : of the hottest phase at the end [K].
    ambient : degC, of the air and of the actuator at the beginning.
    duration : s, `STEADY_STATE` for the continuous current.
    share : of the copper heat in the hottest phase, `TURNING` to `STANDING`.

    NaN if `rise` is not positive, or if a parameter of the winding is NaN.
    """
    from scipy.optimize import brentq

    def over(current: float) -> float:
        return hottest_rise(winding, current, ambient, duration, share) - rise

    if not over(0.0) < 0.0:
        return float("nan")
    most = 1.0
    while over(most) < 0.0:
        most *= 2.0
    return float(brentq(over, 0.0, most, xtol=1e-9 * most))


def hottest_rise(winding: Winding, current: float, ambient: float, duration: float, share: float) -> float:
    """Rise [K] of the hottest phase after `duration` from ambient: `RUNAWAY_RISE` if it runs away, NaN if not known."""
    from scipy.linalg import expm

    n = winding.network
    heat = winding.phase_resistance * current**2 * np.array([share, 1.0 - share, 0.0])  # others, as one body
    capacitances = np.array([n.winding_capacitance / 3, 2 * n.winding_capacitance / 3, n.housing_capacitance])
    thirds = np.array([1.0, 2.0]) / 3.0
    flows = np.diag([*(thirds * (n.winding_ambient + n.winding_housing)), n.winding_housing + n.housing_ambient])
    flows[:2, 2] = flows[2, :2] = -thirds * n.winding_housing
    warmer = 1.0 + winding.resistance_coefficient * (ambient - winding.reference_temperature)
    rates = (np.diag(winding.resistance_coefficient * heat) - flows) / capacitances[:, None]
    driven = heat * warmer / capacitances
    if not (np.isfinite(rates).all() and np.isfinite(driven).all()):
        return float("nan")
    if np.isinf(duration):
        stable = np.max(np.linalg.eigvals(rates).real) < 0.0
        return float(min(np.linalg.solve(-rates, driven)[0], RUNAWAY_RISE)) if stable else RUNAWAY_RISE
    whole = np.zeros((4, 4))
    whole[:3, :3], whole[:3, 3] = rates, driven
    with np.errstate(over="ignore", invalid="ignore"):
        hottest = float(expm(whole * duration)[0, 3])
    return min(hottest, RUNAWAY_RISE) if np.isfinite(hottest) else RUNAWAY_RISE  # beyond all numbers: it runs away
