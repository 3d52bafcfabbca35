"""Curves that several effects are made of: hysteresis operators, lags, delays, limited rates."""

import math

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

Array = npt.NDArray[np.float64]


def lagged(values: Array, time_constant: float, interval: float) -> Array:
    """Return values after a first-order lag, at rest at the first value.

    The filter is bilinear, so that slow signals are late by its time constant.
    """
    ratio = 2.0 * time_constant / interval
    numerator, denominator = [1.0 / (1.0 + ratio)] * 2, [1.0, (1.0 - ratio) / (1.0 + ratio)]
    start = [values[0] * (numerator[1] - denominator[1])]
    return np.asarray(lfilter(numerator, denominator, values, zi=start)[0], np.float64)


def delayed(values: Array, delay: float, interval: float) -> Array:
    """Return values delayed by a time [s], linear between samples; the first value before the start."""
    positions = np.arange(len(values)) - delay / interval
    return np.asarray(np.interp(positions, np.arange(len(values)), values), np.float64)


def play(values: Array, half_width: float) -> Array:
    """Return the output of Krasnosel'skii's play operator with this half width, in the unit of the values."""
    return stuck_between(values - half_width, values + half_width)


def stuck_between(low: Array, high: Array) -> Array:
    """Return a level that starts at zero and stays constant until a bound moves it; each low is at most its high."""
    lows, highs = in_blocks(low), in_blocks(high)
    # bounds of the level after a block's steps so far; the level at its start is clipped by them
    lower, upper = (
        np.empty_like(lows),
        np.empty_like(highs),
    )
    bounds = np.array([np.full(lows.shape[1], -np.inf), np.full(lows.shape[1], np.inf)])
    for k in range(len(lows)):
        bounds = np.fmin(np.fmax(bounds, lows[k]), highs[k])
        lower[k], upper[k] = bounds
    level, ends = 0.0, zip(lower[-1].tolist(), upper[-1].tolist(), strict=True)
    starts = [level, *(level := min(max(level, lowest), highest) for lowest, highest in ends)][:-1]
    return one_after_another(np.fmin(np.fmax(starts, lower), upper), len(low))


def bristle(angle: Array, displacement: float) -> Array:
    """Return friction over its Coulomb level, -1 to 1, that builds up exponentially over an angle (Dahl, 1968)."""
    steps = np.diff(angle, prepend=angle[0])
    decay = np.exp(-np.abs(steps) / displacement)
    decays, gains = in_blocks(decay), in_blocks(np.sign(steps) * (1.0 - decay))
    for k in range(1, len(decays)):  # decay and gain of all steps of a block so far
        gains[k] += gains[k - 1] * decays[k]
        decays[k] *= decays[k - 1]
    state, ends = 0.0, zip(decays[-1].tolist(), gains[-1].tolist(), strict=True)
    starts = [state, *(state := state * d + g for d, g in ends)][:-1]
    return one_after_another(starts * decays + gains, len(angle))


def in_blocks(values: Array) -> Array:
    """Return a signal cut into about as many blocks as steps in a block, (steps, blocks), padded with its last value.

    A step of a curve with memory is then computed for all blocks at once; afterwards each block continues from the end
    of the previous one.
    """
    steps = math.isqrt(len(values)) + 1
    blocks = -(-len(values) // steps)
    return np.pad(values, (0, steps * blocks - len(values)), mode="edge").reshape(blocks, steps).T.copy()


def one_after_another(blocks: Array, samples: int) -> Array:
    """Return blocks (steps, blocks) joined to a signal of `samples` samples."""
    return blocks.T.reshape(-1)[:samples].copy()


def rate_limited(values: Array, step: float, begin: float | None = None) -> Array:
    """Return values that change by at most `step` from sample to sample, from `begin`, by default the first value."""
    last_value = float(values[0]) if begin is None else begin
    too_fast = np.flatnonzero(np.abs(np.diff(values, prepend=last_value)) > step).tolist()
    if not too_fast:
        return values
    limited, next_index = values.tolist(), 0
    for k in too_fast:
        if k < next_index:
            continue
        last_value, next_index = limited[k - 1] if k else last_value, k
        while next_index < len(limited) and abs(change := limited[next_index] - last_value) > step:
            last_value += math.copysign(step, change)
            limited[next_index] = last_value
            next_index += 1
    return np.array(limited, np.float64)


def ramp_shares(values: Array, step: float, begin: float) -> Array:
    """Return the share of each interval, up to 1, that a ramp of `step` per interval takes to the interval's value."""
    return np.minimum(np.abs(np.diff(values, prepend=begin)) / step, 1.0)


def ramp_means(ends: Array, shares: Array, begin: float) -> Array:
    """Return the means over intervals of a signal that ramps to each end over a share of the interval, then holds."""
    return np.asarray(ends - 0.5 * np.diff(ends, prepend=begin) * shares, np.float64)
