"""Curves that several effects are made of: hysteresis operators, lags and delays of sampled signals."""

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

Array = npt.NDArray[np.float64]


def lagged(values: Array, time_constant: float, interval: float) -> Array:
    """A first-order lag, at rest at the first value; bilinear, so that slow signals are late by its time constant."""
    ratio = 2.0 * time_constant / interval
    ahead, behind = [1.0 / (1.0 + ratio)] * 2, [1.0, (1.0 - ratio) / (1.0 + ratio)]
    start = [values[0] * (ahead[1] - behind[1])]
    return np.asarray(lfilter(ahead, behind, values, zi=start)[0], np.float64)


def delayed(values: Array, delay: float, interval: float) -> Array:
    """The values a delay earlier, linear in between, the first value before the start."""
    at = np.arange(len(values)) - delay / interval
    return np.asarray(np.interp(at, np.arange(len(values)), values), np.float64)


def play(values: Array, half_width: float) -> Array:
    """What follows a value with this much play on either side (Krasnosel'skii's play operator)."""
    return stuck_between(values - half_width, values + half_width)


def stuck_between(low: Array, high: Array) -> Array:
    """What stays as it is until a bound takes it along; zero at first."""
    kept, bounds = 0.0, zip(low.tolist(), high.tolist(), strict=True)
    return np.array([kept := least if kept < least else most if kept > most else kept for least, most in bounds])


def bristle(angle: Array, displacement: float) -> Array:
    """Friction over its Coulomb level that builds up exponentially over an angle (Dahl, 1968), in -1 .. 1."""
    steps = np.diff(angle, prepend=angle[0])
    decay = np.exp(-np.abs(steps) / displacement)
    gain = np.sign(steps) * (1.0 - decay)
    state = 0.0
    return np.array([state := state * d + g for d, g in zip(decay.tolist(), gain.tolist(), strict=True)], np.float64)


def rate_limited(values: Array, step: float, begin: float | None = None) -> Array:
    """What follows values by no more than a step at a time, from a beginning; by default from the first value."""
    kept, out = float(values[0]) if begin is None else begin, list[float]()
    if max(abs(float(values[0]) - kept), float(np.max(np.abs(np.diff(values)), initial=0.0))) <= step:
        return values
    for value in values.tolist():
        change = value - kept
        kept += step if change > step else -step if change < -step else change
        out.append(kept)
    return np.array(out, np.float64)
