"""Solve the two-node thermal network exactly.

`ThermalNetwork` takes heat that is constant between evenly spaced samples; `temperatures_and_rates_at` takes heat that
is linear between readings at any stamps.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from leactl.model.motor_schema import Thermal

Array = npt.NDArray[np.float64]
ACTIVE_SHARE = 2.0 / 3.0  # share of a wye winding that two leads feed; the third phase carries no direct current
BLOCK_TIME_CONSTANTS = 200.0  # time constants in one block of a cumulative sum: its exponentials do not overflow
EVEN_STEP_TOLERANCE = 1e-6  # relative difference up to which steps count as equal


@dataclass(frozen=True)
class Conductances:
    """The network in terms of conductances; a conductance is zero if the resistance is infinite."""

    winding_ambient: float  # W/K
    winding_housing: float  # W/K
    housing_ambient: float  # W/K
    winding_capacitance: float  # J/K
    housing_capacitance: float  # J/K

    @classmethod
    def of(cls, thermal: Thermal) -> "Conductances":
        """Return the conductances of a motor file's network."""
        return cls(
            1 / thermal.winding_ambient_resistance,
            1 / thermal.winding_housing_resistance,
            1 / thermal.housing_ambient_resistance,
            thermal.winding_capacitance,
            thermal.housing_capacitance,
        )

    def modes(self) -> tuple[Array, Array, Array]:
        """Return the rates of the two decoupled modes [1/s], the matrix of nodes from modes, and its inverse.

        With C dT/dt = q - K T and S the matrix of nodes from modes, m = inverse(S) T obeys
        dm/dt = rate m + transpose(S) q.
        """
        wa, wh, ha = self.winding_ambient, self.winding_housing, self.housing_ambient
        roots = np.sqrt([self.winding_capacitance, self.housing_capacitance])
        # C^-1/2 K C^-1/2 is symmetric, so that its rates are real and its modes orthogonal
        rates, vectors = np.linalg.eigh(np.array([[wa + wh, -wh], [-wh, wh + ha]]) / np.outer(roots, roots))
        return -rates, vectors / roots[:, None], vectors.T * roots


class ThermalNetwork:
    """Two-node network of the paper, winding and housing against ambient, at a constant interval [s]."""

    def __init__(self, thermal: Thermal, interval: float) -> None:
        network = Conductances.of(thermal)
        self.to_ambient = network.winding_ambient, network.housing_ambient  # W/K of winding and housing
        rates, self._shapes, self._inverse = network.modes()
        self._decay = np.exp(rates * interval)
        self._gain = np.expm1(rates * interval) / rates

    def answer(self, winding_heat: Array, housing_heat: Array, start: tuple[float, float] = (0.0, 0.0)) -> Array:
        """Return the rises of winding and housing [K], shape (2, n).

        Heats [W], shape (n,), are constant over the interval that begins at each sample; `start` has the rises of
        winding and housing at the first sample.
        """
        modes = self._shapes.T @ np.stack([winding_heat, housing_heat])
        start_modes = self._inverse @ np.asarray(start, float)
        mode_rises = np.empty_like(modes)
        for mode in range(2):
            inputs = np.concatenate([[start_modes[mode]], self._gain[mode] * modes[mode, :-1]])
            mode_rises[mode] = lfilter([1.0], [1.0, -self._decay[mode]], inputs)
        return np.asarray(self._shapes @ mode_rises, np.float64)

    def temperatures(self, heat: Array, ambient: Array, start: tuple[float, float]) -> Array:
        """Return the temperatures of winding and housing [degC], shape (2, n), for Joule heat in the winding [W]."""
        wa, ha = self.to_ambient
        return self.answer(heat + ambient * wa, ambient * ha, start)


@dataclass(frozen=True, eq=False)
class Drive:
    """Inputs of the network: Joule heat of the winding and ambient temperature, both linear between their stamps.

    `begin` and `end` are the heat [W] at both ends of each interval; they are equal where the heat is constant.
    """

    time: Array  # s, n stamps
    begin: Array  # W, n - 1
    end: Array  # W, n - 1
    ambient: Array  # degC, n


def temperatures_and_rates_at(network: Conductances, drive: Drive, stamps: Array) -> tuple[Array, Array]:
    """Return temperatures [degC] and their rates [K/s] at stamps [s] within the drive, each of shape (2, stamps).

    The winding comes first. Both nodes are at zero at the drive's first stamp.
    """
    rates, shapes, _ = network.modes()
    interval_of_stamp = np.clip(np.searchsorted(drive.time, stamps, side="right") - 1, 0, len(drive.time) - 2)
    elapsed = stamps - drive.time[interval_of_stamp]
    share_of_interval = elapsed / np.diff(drive.time)[interval_of_stamp]
    mode_buffer = np.empty((2, len(stamps)))
    modes, mode_rates = np.empty_like(mode_buffer), np.empty_like(mode_buffer)
    for index, rate in enumerate(rates):
        heat_gain = shapes[0, index]
        ambient_gain = heat_gain * network.winding_ambient + shapes[1, index] * network.housing_ambient
        ambient_drive = ambient_gain * drive.ambient
        drive_at_begin, drive_at_end = (
            heat_gain * drive.begin + ambient_drive[:-1],
            heat_gain * drive.end + ambient_drive[1:],
        )
        at_drive_stamps = first_order_response(rate, drive.time, drive_at_begin, drive_at_end)
        drive_at_stamps = (
            drive_at_begin[interval_of_stamp] + share_of_interval * (drive_at_end - drive_at_begin)[interval_of_stamp]
        )
        modes[index] = at_drive_stamps[interval_of_stamp] * np.exp(rate * elapsed) + first_order_gain(
            rate, elapsed, drive_at_begin[interval_of_stamp], drive_at_stamps
        )
        mode_rates[index] = rate * modes[index] + drive_at_stamps
    # no matrix product: for so small a matrix, its threads wait longer for each other than they compute
    first_mode, second_mode = shapes[:, :1], shapes[:, 1:]
    return first_mode * modes[0] + second_mode * modes[1], first_mode * mode_rates[0] + second_mode * mode_rates[1]


def remaining_rise(network: Conductances, after: Array) -> Array:
    """Return the rises of both nodes at times [s] after one node starts 1 K warmer: shape (node, warm node, times)."""
    rates, shapes, inverse = network.modes()
    return np.asarray(np.einsum("nm,mt,ms->nst", shapes, np.exp(np.outer(rates, after)), inverse), np.float64)


def first_order_response(rate: float, time: Array, begin: Array, end: Array) -> Array:
    """Solve dm/dt = rate m + f from zero at the first stamp, with f linear from `begin` to `end` in each interval.

    `rate` is below zero [1/s], `time` has n stamps [s]; returns the solution at the stamps, shape (n,).
    """
    steps = np.diff(time)
    response = np.zeros(len(time))
    if np.ptp(steps) < EVEN_STEP_TOLERANCE * steps[0]:
        step = float(np.mean(steps))
        response[1:] = lfilter([1.0], [1.0, -np.exp(rate * step)], first_order_gain(rate, np.array([step]), begin, end))
        return response
    gains, start = first_order_gain(rate, steps, begin, end), 0
    while start < len(steps):
        stop = max(start + 1, int(np.searchsorted(time, time[start] - BLOCK_TIME_CONSTANTS / rate)) - 1)
        if stop == start + 1:
            response[stop] = np.exp(rate * steps[start]) * response[start] + gains[start]
        else:
            decay = np.exp(rate * (time[start + 1 : stop + 1] - time[start]))
            response[start + 1 : stop + 1] = decay * (response[start] + np.cumsum(gains[start:stop] / decay))
        start = stop
    return response


def first_order_gain(rate: float, duration: Array, begin: Array, end: Array) -> Array:
    """Return the change of a first-order response from zero by a drive that is linear from `begin` to `end`.

    `rate` is below zero [1/s]; `duration` [s], `begin` and `end` have one entry for each interval.
    """
    exponent = np.minimum(rate * duration, -1e-300)  # avoids 0 / 0 for a duration of zero, whose change is zero
    total_weight = np.expm1(exponent) / exponent
    end_weight = (total_weight - 1.0) / exponent
    return np.asarray(duration * ((total_weight - end_weight) * begin + end_weight * end), np.float64)
