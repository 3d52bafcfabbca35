"""The two-node thermal network on an even clock, solved exactly for heat that is held between samples."""

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from leactl.model.sheet import Thermal

Array = npt.NDArray[np.float64]


class ThermalNetwork:
    """Winding and housing against ambient: Cw dTw/dt and Ch dTh/dt as in the paper."""

    def __init__(self, thermal: Thermal, interval: float) -> None:
        wa, wh = 1 / thermal.winding_ambient_resistance, 1 / thermal.winding_housing_resistance
        ha = 1 / thermal.housing_ambient_resistance
        self.to_ambient = (wa, ha)  # W/K of winding and housing
        self._capacities = np.array([thermal.winding_capacitance, thermal.housing_capacitance])
        rates = np.array([[-(wa + wh), wh], [wh, -(wh + ha)]]) / self._capacities[:, None]
        values, vectors = np.linalg.eig(rates)
        self._vectors, self._inverse = vectors.real, np.linalg.inv(vectors.real)
        self._decay = np.exp(values.real * interval)
        self._gain = (self._decay - 1.0) / values.real

    def answer(self, winding_heat: Array, housing_heat: Array, start: tuple[float, float] = (0.0, 0.0)) -> Array:
        """Rises of winding and housing [K], shape (2, n).

        Heat [W] is held over the interval that begins at each sample; `start` is the rise at the first sample.
        """
        modes = self._inverse @ (np.stack([winding_heat, housing_heat]) / self._capacities[:, None])
        first = self._inverse @ np.asarray(start, float)
        out = np.empty_like(modes)
        for k in range(2):
            driven = np.concatenate([[first[k]], self._gain[k] * modes[k, :-1]])
            out[k] = lfilter([1.0], [1.0, -self._decay[k]], driven)
        return np.asarray(self._vectors @ out, np.float64)

    def temperatures(self, heat: Array, ambient: Array, start: tuple[float, float]) -> Array:
        """Temperatures of winding and housing [degC], shape (2, n), for Joule heat in the winding [W]."""
        wa, ha = self.to_ambient
        return self.answer(heat + ambient * wa, ambient * ha, start)
