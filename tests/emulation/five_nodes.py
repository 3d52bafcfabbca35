"""Three phases, housing and fixture as five plain equations, to judge the stepped network by."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from leactl.emulation.plant.parameters import ActuatorParameters

Array = NDArray[np.float64]
AT_REST = np.array([2.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0])  # shares of the heat with phase a on the q axis
EVEN = np.full(3, 1.0 / 3.0)
TWO_LEADS = np.array([1.0, 1.0, 0.0])


def conductances(p: ActuatorParameters, air: float = 1.0) -> Array:
    """Heat that leaves each node per kelvin of each [W/K]."""
    thermal = p.thermal
    matrix = np.zeros((5, 5))
    for k in range(3):
        matrix[k, k] += 1.0 / (3.0 * thermal.winding_ambient_resistance)
        _join(matrix, k, 3, 1.0 / (3.0 * thermal.winding_housing_resistance))
    matrix[3, 3] += 1.0 / (air * thermal.housing_ambient_resistance)
    if p.phases.fixture_capacitance:
        _join(matrix, 3, 4, 1.0 / p.phases.fixture_resistance)
    return matrix


def capacitances(p: ActuatorParameters) -> Array:
    """Of the five nodes [J/K]."""
    third = p.thermal.winding_capacitance / 3.0
    return np.array([third, third, third, p.thermal.housing_capacitance, p.phases.fixture_capacitance or 1.0])


def settled(p: ActuatorParameters, squares: Array, housing_heat: float = 0.0, ambient: float = 25.0) -> Array:
    """Temperatures under held squares of the phase currents [A^2] for ever: phases and housing [degC]."""
    matrix = conductances(p)[:4, :4]
    matrix[3, 3] = matrix[3, :3].sum() * -1.0 + 1.0 / p.thermal.housing_ambient_resistance  # a fixture takes nothing
    heat = np.append(squares * p.resistance(ambient), housing_heat)
    matrix[:3, :3] -= np.diag(squares) * p.phase_resistance * p.resistance_coefficient
    return ambient + np.linalg.solve(matrix, heat)


def integrated(
    p: ActuatorParameters,
    squares: Callable[[float], Array],
    times: Sequence[float],
    housing_heat: Callable[[float], float] = lambda _time: 0.0,
    ambient: float = 25.0,
) -> Array:
    """Temperatures of the five nodes at the times [degC], one row each; starts at ambient at 0 s."""
    free, blocked = conductances(p), conductances(p, p.phases.blocked_air_factor)

    def slope(time: float, rises: Array) -> Array:
        heat = np.zeros(5)
        heat[:3] = squares(time) * [p.resistance(ambient + rise) for rise in rises[:3]]
        heat[3] = housing_heat(time)
        matrix = blocked if time >= p.phases.blocked_air_from else free
        return (heat - matrix @ rises) / capacitances(p)

    result = solve_ivp(slope, (0.0, times[-1]), np.zeros(5), t_eval=times, rtol=1e-9, atol=1e-9, max_step=0.5)
    return np.asarray(ambient + result.y.T)


def _join(matrix: Array, first: int, second: int, conductance: float) -> None:
    matrix[first, first] += conductance
    matrix[second, second] += conductance
    matrix[first, second] -= conductance
    matrix[second, first] -= conductance
