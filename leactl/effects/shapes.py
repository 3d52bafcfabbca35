"""Curves that several effects are made of: hysteresis operators, lags and delays of sampled signals."""

import math

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
    """What stays as it is until a bound takes it along; zero at first. No low may exceed its high."""
    lows, highs = in_blocks(low), in_blocks(high)
    least, most = np.empty_like(lows), np.empty_like(highs)  # bounds of a block's steps so far, seen from its start
    bounds = np.array([np.full(lows.shape[1], -np.inf), np.full(lows.shape[1], np.inf)])
    for k in range(len(lows)):
        bounds = np.fmin(np.fmax(bounds, lows[k]), highs[k])
        least[k], most[k] = bounds
    kept, ends = 0.0, zip(least[-1].tolist(), most[-1].tolist(), strict=True)
    starts = [kept, *(kept := min(max(kept, lowest), highest) for lowest, highest in ends)][:-1]
    return one_after_another(np.fmin(np.fmax(starts, least), most), len(low))


def bristle(angle: Array, displacement: float) -> Array:
    """Friction over its Coulomb level that builds up exponentially over an angle (Dahl, 1968), in -1 .. 1."""
    steps = np.diff(angle, prepend=angle[0])
    decay = np.exp(-np.abs(steps) / displacement)
    decays, gains = in_blocks(decay), in_blocks(np.sign(steps) * (1.0 - decay))
    for k in range(1, len(decays)):  # of a block's steps so far, seen from its start
        gains[k] += gains[k - 1] * decays[k]
        decays[k] *= decays[k - 1]
    state, ends = 0.0, zip(decays[-1].tolist(), gains[-1].tolist(), strict=True)
    starts = [state, *(state := state * d + g for d, g in ends)][:-1]
    return one_after_another(starts * decays + gains, len(angle))


def in_blocks(values: Array) -> Array:
    """A signal cut into about as many blocks as each has steps, a column for each, its last value repeated to the end.

    A step of a curve with a memory is then worked out for all blocks at once; then each block takes up the end of the
    one before.
    """
    steps = math.isqrt(len(values)) + 1
    blocks = -(-len(values) // steps)
    return np.pad(values, (0, steps * blocks - len(values)), mode="edge").reshape(blocks, steps).T.copy()


def one_after_another(blocks: Array, samples: int) -> Array:
    """The signal whose blocks are these."""
    return blocks.T.reshape(-1)[:samples].copy()


def rate_limited(values: Array, step: float, begin: float | None = None) -> Array:
    """What follows values by no more than a step at a time, from a beginning; by default from the first value."""
    kept = float(values[0]) if begin is None else begin
    late = np.flatnonzero(np.abs(np.diff(values, prepend=kept)) > step).tolist()
    if not late:
        return values
    out, reached = values.tolist(), 0
    for k in late:
        if k < reached:
            continue
        kept, reached = out[k - 1] if k else kept, k
        while reached < len(out) and abs(change := out[reached] - kept) > step:
            kept += math.copysign(step, change)
            out[reached] = kept
            reached += 1
    return np.array(out, np.float64)


def ramp_shares(values: Array, step: float, begin: float) -> Array:
    """Share of each interval, up to 1, that a ramp of at most so much in an interval takes to the next value."""
    return np.minimum(np.abs(np.diff(values, prepend=begin)) / step, 1.0)


def ramp_means(ends: Array, shares: Array, begin: float) -> Array:
    """Mean over each interval of what ramps to its end over a share of it and then holds."""
    return np.asarray(ends - 0.5 * np.diff(ends, prepend=begin) * shares, np.float64)
