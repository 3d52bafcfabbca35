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
        p = parameters
        self.ambient = ambient_degc
        self.winding = self.housing = ambient_degc if start_degc is None else start_degc
        slope = p.phase_resistance * p.resistance_coefficient
        # worked out once, the estimate is advanced in every cycle: R = cold + slope T, conductances, 1 / capacitances
        self._coefficients = (
            p.phase_resistance - slope * p.reference_temperature,
            slope,
            1.0 / p.winding_housing_resistance,
            1.0 / p.winding_ambient_resistance,
            1.0 / p.housing_ambient_resistance,
            1.0 / p.winding_capacitance,
            1.0 / p.housing_capacitance,
        )
        # an explicit step beyond a fraction of the fastest time constant would overshoot
        self._longest = 0.05 * p.winding_capacitance * p.winding_housing_resistance

    def advance(self, duration: float, current: float) -> float:
        """Advance by a measured time step under a q-axis current; returns the winding temperature [degC].

        A current that is not a number counts as none was read: the caller passes the reference then.
        """
        cold, slope, to_housing, to_ambient, housing_to_ambient, per_winding, per_housing = self._coefficients
        steps = 1 if duration <= self._longest else math.ceil(duration / self._longest)
        h = duration / steps
        winding, housing, ambient = self.winding, self.housing, self.ambient
        square = current * current
        for _ in range(steps):
            passed = (winding - housing) * to_housing
            heat = (cold + slope * winding) * square
            winding += h * (heat - (winding - ambient) * to_ambient - passed) * per_winding
            housing += h * (passed - (housing - ambient) * housing_to_ambient) * per_housing
        self.winding, self.housing = winding, housing
        return winding
