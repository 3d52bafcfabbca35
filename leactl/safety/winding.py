"""Two-node estimate of the winding temperature (paper, thermal model): winding and housing, heated by R(T) i^2."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class ThermalParameters:
    """Network and resistance of one actuator, SI, temperatures in degC."""

    phase_resistance: float
    resistance_coefficient: float
    reference_temperature: float
    winding_ambient_resistance: float
    winding_housing_resistance: float
    housing_ambient_resistance: float
    winding_capacitance: float
    housing_capacitance: float


class WindingEstimate:
    """Temperatures of one actuator, advanced by the current that flows or is asked for, whichever heats more."""

    def __init__(
        self, parameters: ThermalParameters, ambient_degc: float = 25.0, start_degc: float | None = None
    ) -> None:
        p = self._parameters = parameters
        self.ambient = ambient_degc
        self.winding = self.housing = ambient_degc if start_degc is None else start_degc
        self._slope = p.phase_resistance * p.resistance_coefficient
        self._cold = p.phase_resistance - self._slope * p.reference_temperature
        # an explicit step beyond a fraction of the fastest time constant would overshoot
        self._longest = 0.05 * p.winding_capacitance * p.winding_housing_resistance

    def advance(self, duration: float, current: float) -> float:
        """Advance by a measured time step under a q-axis current; returns the winding temperature [degC].

        A current that is not a number counts as none was read: the caller passes the reference then.
        """
        p = self._parameters
        steps = max(1, math.ceil(duration / self._longest))
        h = duration / steps
        winding, housing, ambient = self.winding, self.housing, self.ambient
        square = current * current
        for _ in range(steps):
            to_housing = (winding - housing) / p.winding_housing_resistance
            heat = (self._cold + self._slope * winding) * square
            lost = (winding - ambient) / p.winding_ambient_resistance
            winding += h * (heat - lost - to_housing) / p.winding_capacitance
            housing += h * (to_housing - (housing - ambient) / p.housing_ambient_resistance) / p.housing_capacitance
        self.winding, self.housing = winding, housing
        return winding
