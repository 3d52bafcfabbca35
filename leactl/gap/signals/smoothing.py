"""Sampled signals: a Gaussian that smooths and thins out, and derivatives taken on what is smoothed."""

import math

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d
from scipy.signal import upfirdn

Array = npt.NDArray[np.float64]
BASE = 2.0  # samples, standard deviation of the smoothing that every mechanical signal gets
REACH = 4.0  # standard deviations to either side
BEYOND_NOISE = 2.0  # times its error by noise, by which the reversal of two lines must differ from that of `senses`
MEETING = 1.5  # samples from where a reversal seems to be, within which the lines before and after it meet at zero
SWIFT = 4.0  # times the noise of a speed, that it has on either side of where it turns back fast


def smooth(values: Array, width: float = BASE) -> Array:
    """Gaussian of this standard deviation in samples."""
    return np.asarray(gaussian_filter1d(values, width, mode="nearest", truncate=REACH), np.float64)


def slope(values: Array, interval: float) -> Array:
    """Derivative per second, exact for cubics (five-point difference)."""
    if len(values) < 5:
        return np.gradient(values, interval)
    out = np.gradient(values, interval)
    out[2:-2] = (8.0 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) / (12.0 * interval)
    return out


def speeds(angle: Array, interval: float) -> Array:
    """Means over the interval that ends at each sample; the first as the second, for a run may begin while it turns."""
    return np.asarray(np.diff(angle, prepend=2.0 * angle[0] - angle[1]) / interval, np.float64)


def middle(values: Array) -> Array:
    """Instants as means over the interval that ends at each, exact for cubics."""
    out = np.concatenate([values[:1], 0.5 * (values[1:] + values[:-1])])
    if len(values) >= 4:
        out[2:-1] = (13.0 * (values[1:-2] + values[2:-1]) - values[:-3] - values[3:]) / 24.0
    return out


def senses(speeds: Array) -> Array:
    """Which way something goes, -1 to 1, as a mean over the interval that ends at each sample, as the speeds are.

    Where it turns back within an interval, its speed is taken to change evenly there.
    """
    if len(speeds) < 2:
        return np.sign(speeds)
    between = 0.5 * (speeds[1:] + speeds[:-1])
    ends = np.concatenate([[2.0 * speeds[0] - between[0]], between, [2.0 * speeds[-1] - between[-1]]])
    change, distance = np.diff(ends), np.diff(np.abs(ends))
    turns = ends[1:] * ends[:-1] < 0.0
    return np.where(turns, distance / np.where(turns, change, 1.0), np.sign(speeds))


def bent_senses(speeds: Array, noise: float) -> Array:
    """The same where friction bends the speed at a reversal: where the lines before and after it come to zero.

    Friction brakes before the reversal and opposes the drive after it, so that the slope changes there. Each line goes
    through two speeds beside the bend; both are weighted by their slopes squared, which is how finely they tell the
    moment. A reversal stays as `senses` has it where theirs is far away, or differs by no more than noise makes it.
    """
    signs = senses(speeds)
    for at in np.flatnonzero((np.abs(signs) < 1.0) & (speeds != 0.0)).tolist():
        if not 3 <= at < len(speeds) - 2:
            continue
        first, last = float(speeds[at - 2]), float(speeds[at + 1])
        before, after = first - float(speeds[at - 3]), float(speeds[at + 2]) - last  # what the speed changes by
        if first * last >= 0.0 or first * before >= 0.0 or first * after >= 0.0:
            continue
        reaches, steep = np.array([-first / before, -last / after]), np.array([before, after])  # intervals to zero
        share = steep**2 / np.sum(steep**2)
        moment = float(share @ (np.array([at - 2.5, at + 0.5]) + reaches))
        astray = noise * float(np.sqrt(np.sum(share**2 * ((1.0 + reaches) ** 2 + reaches**2) / steep**2)))
        even = at - 0.5 + 0.5 * float(signs[at]) * np.sign(first)  # where `senses` has it
        if BEYOND_NOISE * astray < abs(moment - even) and abs(moment - (at - 0.5)) < MEETING:
            ends = np.arange(at - 1, at + 2)
            signs[ends] = np.sign(first) * (2.0 * np.clip(moment - (ends - 1), 0.0, 1.0) - 1.0)
    return signs


def sharp_senses(speeds: Array, noise: float) -> Array:
    """The same of noisy speeds: as smoothed ones have it, but where they turn back so fast that noise hardly matters.

    Friction bends a speed where it turns back, and a smoothed one is zero at another time.
    """
    even = smooth(speeds)
    signs, reach = senses(even), int(REACH * BASE)
    if len(even) <= 2 * reach:
        return signs
    before, after = even[: -2 * reach], even[2 * reach :]
    swift = (before * after < 0.0) & (np.minimum(np.abs(before), np.abs(after)) > SWIFT * noise)
    turning = np.zeros(len(even), np.bool_)
    turning[reach:-reach] = swift
    return np.where(turning, bent_senses(speeds, noise), signs)


def noise_of_acceleration(noise: float, interval: float, width: float) -> float:
    """Standard deviation that white noise of an angle leaves in its second derivative under all smoothing.

    width : samples, of the smoothing beyond `BASE`.
    """
    # of the second derivative of a Gaussian: its squares add up to 3 / (8 sqrt(pi) spread^5)
    spread = math.hypot(BASE, width)
    return noise / interval**2 * math.sqrt(3.0 / (8.0 * math.sqrt(math.pi) * spread**5))


def kernel(width: float) -> Array:
    """Gaussian weights that sum to one."""
    reach = max(int(REACH * width + 0.5), 1)
    at = np.arange(-reach, reach + 1)
    weights = np.exp(-0.5 * (at / width) ** 2)
    return np.asarray(weights / weights.sum(), np.float64)


def thinned(columns: Array, width: float, step: int) -> Array:
    """Columns smoothed and every so manieth row kept; only rows whose whole kernel lies inside."""
    if width <= 0.0:
        return columns[::step]
    weights = kernel(width)
    full: Array = upfirdn(weights, columns, up=1, down=step, axis=0)
    first = -(-(len(weights) - 1) // step)
    last = (len(columns) - 1) // step + 1
    return full[first:last]


def thinned_index(length: int, width: float, step: int) -> npt.NDArray[np.intp]:
    """The sample that each row of `thinned` is centred on."""
    if width <= 0.0:
        return np.arange(0, length, step)
    reach = len(kernel(width)) - 1
    first = -(-reach // step)
    return np.arange(first, (length - 1) // step + 1) * step - reach // 2
