"""Two thermal nodes, winding and housing, stepped exactly for constant heat within a step."""

import math

from leactl.emulation.plant.parameters import ThermalParameters


class ExactThermalNetwork:
    """Temperatures of winding and housing [degC] under heat into each of them."""

    def __init__(self, parameters: ThermalParameters, ambient: float) -> None:
        p = parameters
        gwa, gwh, gha = (
            1.0 / p.winding_ambient_resistance,
            1.0 / p.winding_housing_resistance,
            1.0 / p.housing_ambient_resistance,
        )
        self.winding = self.housing = self._ambient = ambient
        self._gww, self._gwh, self._ghh = gwa + gwh, gwh, gwh + gha
        self._determinant = self._gww * self._ghh - gwh * gwh
        # d(rise)/dt = A (rise - rise_steady); eigenvalues of A are real, distinct and negative for a passive network
        self._a11, self._a12 = -self._gww / p.winding_capacitance, gwh / p.winding_capacitance
        self._a21, self._a22 = gwh / p.housing_capacitance, -self._ghh / p.housing_capacitance
        mean = 0.5 * (self._a11 + self._a22)
        spread = math.sqrt((0.5 * (self._a11 - self._a22)) ** 2 + self._a12 * self._a21)
        self._fast, self._slow = mean - spread, mean + spread
        self._transitions: dict[float, tuple[float, float, float, float]] = {}

    def steady_rise(self, winding_heat: float, housing_heat: float = 0.0) -> tuple[float, float]:
        """Return the steady rises of winding and housing above ambient [K] under constant heat [W]."""
        winding = (self._ghh * winding_heat + self._gwh * housing_heat) / self._determinant
        housing = (self._gwh * winding_heat + self._gww * housing_heat) / self._determinant
        return winding, housing

    def step(self, duration: float, winding_heat: float, housing_heat: float = 0.0) -> None:
        """Advance by a duration [s] under constant heat into winding and housing [W]."""
        transition = self._transitions.get(duration)
        if transition is None:
            transition = self._transition(duration)
        f11, f12, f21, f22 = transition
        steady_winding, steady_housing = self.steady_rise(winding_heat, housing_heat)
        steady_winding += self._ambient
        steady_housing += self._ambient
        winding_deviation, housing_deviation = self.winding - steady_winding, self.housing - steady_housing
        self.winding = steady_winding + f11 * winding_deviation + f12 * housing_deviation
        self.housing = steady_housing + f21 * winding_deviation + f22 * housing_deviation

    def _transition(self, duration: float) -> tuple[float, float, float, float]:
        """Return the rows of the transition matrix exp(A duration)."""
        # Sylvester's formula: exp(A t) = e_slow I + (e_fast - e_slow) / (fast - slow) (A - slow I)
        fast_decay, slow_decay = math.exp(self._fast * duration), math.exp(self._slow * duration)
        ratio = (fast_decay - slow_decay) / (self._fast - self._slow)
        matrix = (
            slow_decay + ratio * (self._a11 - self._slow),
            ratio * self._a12,
            ratio * self._a21,
            slow_decay + ratio * (self._a22 - self._slow),
        )
        if len(self._transitions) > 256:
            self._transitions.clear()
        self._transitions[duration] = matrix
        return matrix
