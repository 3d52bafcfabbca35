"""The two-node thermal network, solved exactly: on an even clock for heat held between samples, and at any stamps for
heat that goes in straight lines between readings.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from leactl.model.motor_schema import Thermal

Array = npt.NDArray[np.float64]
ACTIVE_SHARE = 2.0 / 3.0  # of a wye winding: the phases that two leads feed; the third carries no direct current
DECAY = 200.0  # time constants that are summed up at a time: their exponentials stay far inside the range of floats
EVEN = 1e-6  # of a step, that steps may differ by and still count as one


@dataclass(frozen=True)
class Conductances:
    """The network by its conductances, which may be zero where a resistance is without end."""

    winding_ambient: float  # W/K
    winding_housing: float  # W/K
    housing_ambient: float  # W/K
    winding_capacitance: float  # J/K
    housing_capacitance: float  # J/K

    @classmethod
    def of(cls, thermal: Thermal) -> "Conductances":
        """Those of a motor file's network."""
        return cls(
            1 / thermal.winding_ambient_resistance,
            1 / thermal.winding_housing_resistance,
            1 / thermal.housing_ambient_resistance,
            thermal.winding_capacitance,
            thermal.housing_capacitance,
        )

    def modes(self) -> tuple[Array, Array, Array]:
        """Rates [1/s] of two responses that do not see each other, nodes from modes, and modes from nodes.

        With C dT/dt = q - K T and S the second matrix, m = inverse(S) T obeys dm/dt = rate m + transpose(S) q.
        """
        wa, wh, ha = self.winding_ambient, self.winding_housing, self.housing_ambient
        roots = np.sqrt([self.winding_capacitance, self.housing_capacitance])
        # C^-1/2 K C^-1/2 is symmetric: real rates, orthogonal modes
        rates, vectors = np.linalg.eigh(np.array([[wa + wh, -wh], [-wh, wh + ha]]) / np.outer(roots, roots))
        return -rates, vectors / roots[:, None], vectors.T * roots


class ThermalNetwork:
    """Winding and housing against ambient: Cw dTw/dt and Ch dTh/dt as in the paper."""

    def __init__(self, thermal: Thermal, interval: float) -> None:
        network = Conductances.of(thermal)
        self.to_ambient = network.winding_ambient, network.housing_ambient  # W/K of winding and housing
        rates, self._shapes, self._inverse = network.modes()
        self._decay = np.exp(rates * interval)
        self._gain = np.expm1(rates * interval) / rates

    def answer(self, winding_heat: Array, housing_heat: Array, start: tuple[float, float] = (0.0, 0.0)) -> Array:
        """Rises of winding and housing [K], shape (2, n).

        Heat [W] is held over the interval that begins at each sample; `start` is the rise at the first sample.
        """
        modes = self._shapes.T @ np.stack([winding_heat, housing_heat])
        first = self._inverse @ np.asarray(start, float)
        out = np.empty_like(modes)
        for k in range(2):
            driven = np.concatenate([[first[k]], self._gain[k] * modes[k, :-1]])
            out[k] = lfilter([1.0], [1.0, -self._decay[k]], driven)
        return np.asarray(self._shapes @ out, np.float64)

    def temperatures(self, heat: Array, ambient: Array, start: tuple[float, float]) -> Array:
        """Temperatures of winding and housing [degC], shape (2, n), for Joule heat in the winding [W]."""
        wa, ha = self.to_ambient
        return self.answer(heat + ambient * wa, ambient * ha, start)


@dataclass(frozen=True, eq=False)
class Drive:
    """Joule heat of the winding and the ambient, straight between the stamps at which they are known.

    `begin` and `end` are the heat [W] at both ends of each interval: equal where it is held, else those of a line.
    """

    time: Array  # s, n stamps
    begin: Array  # W, n - 1
    end: Array  # W, n - 1
    ambient: Array  # degC, n


def driven_at(network: Conductances, drive: Drive, stamps: Array) -> tuple[Array, Array]:
    """Temperatures [degC] at stamps within the drive, both nodes at zero at its first, and their rates [K/s].

    Shapes (2, stamps), winding first. Exact: what drives the network is straight between the drive's stamps.
    """
    rates, shapes, _ = network.modes()
    before = np.clip(np.searchsorted(drive.time, stamps, side="right") - 1, 0, len(drive.time) - 2)
    into = stamps - drive.time[before]
    share = into / np.diff(drive.time)[before]
    forced = np.empty((2, len(stamps)))
    modes, changes = np.empty_like(forced), np.empty_like(forced)
    for k, rate in enumerate(rates):
        by_heat = shapes[0, k]
        by_air = by_heat * network.winding_ambient + shapes[1, k] * network.housing_ambient
        air = by_air * drive.ambient
        begin, end = by_heat * drive.begin + air[:-1], by_heat * drive.end + air[1:]
        known = first_order(rate, drive.time, begin, end)
        now = begin[before] + share * (end - begin)[before]
        modes[k] = known[before] * np.exp(rate * into) + gained(rate, into, begin[before], now)
        changes[k] = rate * modes[k] + now
    # no matrix product: its threads wait for each other longer than so small a one takes
    first, second = shapes[:, :1], shapes[:, 1:]
    return first * modes[0] + second * modes[1], first * changes[0] + second * changes[1]


def left_of_start(network: Conductances, after: Array) -> Array:
    """What is left of a kelvin of either node after times [s]: shape (node, node it began in, times)."""
    rates, shapes, inverse = network.modes()
    return np.asarray(np.einsum("nm,mt,ms->nst", shapes, np.exp(np.outer(rates, after)), inverse), np.float64)


def first_order(rate: float, time: Array, begin: Array, end: Array) -> Array:
    """Solution of dm/dt = rate m + f from zero, f straight from `begin` to `end` between stamps; rate below zero."""
    steps = np.diff(time)
    out = np.zeros(len(time))
    if np.ptp(steps) < EVEN * steps[0]:
        step = float(np.mean(steps))
        out[1:] = lfilter([1.0], [1.0, -np.exp(rate * step)], gained(rate, np.array([step]), begin, end))
        return out
    added, left = gained(rate, steps, begin, end), 0
    while left < len(steps):
        right = max(left + 1, int(np.searchsorted(time, time[left] - DECAY / rate)) - 1)
        if right == left + 1:
            out[right] = np.exp(rate * steps[left]) * out[left] + added[left]
        else:
            decay = np.exp(rate * (time[left + 1 : right + 1] - time[left]))
            out[left + 1 : right + 1] = decay * (out[left] + np.cumsum(added[left:right] / decay))
        left = right
    return out


def gained(rate: float, duration: Array, begin: Array, end: Array) -> Array:
    """What a first-order response gains in a duration from a drive that goes straight from `begin` to `end`."""
    exponent = np.minimum(rate * duration, -1e-300)  # nothing is gained in no time
    level = np.expm1(exponent) / exponent
    slope = (level - 1.0) / exponent
    return np.asarray(duration * ((level - slope) * begin + slope * end), np.float64)
