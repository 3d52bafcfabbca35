"""Sampled signals: smoothing and thinning by a Gaussian, derivatives, and directions of motion."""

import math

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d
from scipy.signal import upfirdn

Array = npt.NDArray[np.float64]
BASE_WIDTH = 2.0  # samples, standard deviation of the smoothing that every mechanical signal gets
KERNEL_REACH = 4.0  # standard deviations of the Gaussian on either side
LEAST_REVERSAL_SHIFT_STDS = 2.0  # standard errors by which a reversal of two lines differs from that of `mean_signs`
MOST_REVERSAL_SHIFT_SAMPLES = 1.5  # samples from the apparent reversal to where the lines around it reach zero
FAST_REVERSAL_SPEED = 4.0  # smallest speed on either side of a fast reversal, over the noise of the speed


def smooth(values: Array, width: float = BASE_WIDTH) -> Array:
    """Return values smoothed with a Gaussian of standard deviation `width` [samples]."""
    return np.asarray(gaussian_filter1d(values, width, mode="nearest", truncate=KERNEL_REACH), np.float64)


def slope(values: Array, interval: float) -> Array:
    """Return the derivative [1/s] by five-point differences, exact for cubics except at two samples of either end."""
    if len(values) < 5:
        return np.gradient(values, interval)
    derivative = np.gradient(values, interval)
    derivative[2:-2] = (8.0 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) / (12.0 * interval)
    return derivative


def speeds(angle: Array, interval: float) -> Array:
    """Return mean speeds over the interval that ends at each sample; the first equals the second."""
    return np.asarray(np.diff(angle, prepend=2.0 * angle[0] - angle[1]) / interval, np.float64)


def interval_means(values: Array) -> Array:
    """Return means over the interval that ends at each sample from values at the samples, exact for cubics inside."""
    means = np.concatenate([values[:1], 0.5 * (values[1:] + values[:-1])])
    if len(values) >= 4:
        means[2:-1] = (13.0 * (values[1:-2] + values[2:-1]) - values[:-3] - values[3:]) / 24.0
    return means


def mean_signs(speeds: Array) -> Array:
    """Return the mean sign of the speed, -1 to 1, over the interval that ends at each sample.

    In an interval with a reversal the speed is taken to change linearly.

    speeds : means over the same intervals.
    """
    if len(speeds) < 2:
        return np.sign(speeds)
    instants = 0.5 * (speeds[1:] + speeds[:-1])
    ends = np.concatenate([[2.0 * speeds[0] - instants[0]], instants, [2.0 * speeds[-1] - instants[-1]]])
    change, distance = np.diff(ends), np.diff(np.abs(ends))
    turns = ends[1:] * ends[:-1] < 0.0
    return np.where(turns, distance / np.where(turns, change, 1.0), np.sign(speeds))


def bent_mean_signs(speeds: Array, noise: float) -> Array:
    """Return `mean_signs` with reversals at the zero of the lines around them, since friction bends the speed.

    Friction brakes before the reversal and opposes the drive after it, so that the slope changes there. Each line goes
    through two speeds next to the bend; its zero is weighted by its slope squared, which is its precision. A reversal
    stays as `mean_signs` has it where the zero of the lines is far away, or differs by no more than noise.

    noise : standard deviation of the speeds.
    """
    signs = mean_signs(speeds)
    for sample in np.flatnonzero((np.abs(signs) < 1.0) & (speeds != 0.0)).tolist():
        if not 3 <= sample < len(speeds) - 2:
            continue
        speed_before, speed_after = float(speeds[sample - 2]), float(speeds[sample + 1])
        # change per interval, of the line on either side of the reversal
        change_before, change_after = (
            speed_before - float(speeds[sample - 3]),
            float(speeds[sample + 2]) - speed_after,
        )
        if (
            speed_before * speed_after >= 0.0
            or speed_before * change_before >= 0.0
            or speed_before * change_after >= 0.0
        ):
            continue
        # intervals from each inner speed to the zero of its line
        times_to_zero, slopes = (
            np.array([-speed_before / change_before, -speed_after / change_after]),
            np.array([change_before, change_after]),
        )
        weights = slopes**2 / np.sum(slopes**2)
        reversal = float(weights @ (np.array([sample - 2.5, sample + 0.5]) + times_to_zero))
        reversal_error = noise * float(
            np.sqrt(np.sum(weights**2 * ((1.0 + times_to_zero) ** 2 + times_to_zero**2) / slopes**2))
        )
        apparent_moment = sample - 0.5 + 0.5 * float(signs[sample]) * np.sign(speed_before)  # where `mean_signs` has it
        if (
            LEAST_REVERSAL_SHIFT_STDS * reversal_error < abs(reversal - apparent_moment)
            and abs(reversal - (sample - 0.5)) < MOST_REVERSAL_SHIFT_SAMPLES
        ):
            ends = np.arange(sample - 1, sample + 2)
            signs[ends] = np.sign(speed_before) * (2.0 * np.clip(reversal - (ends - 1), 0.0, 1.0) - 1.0)
    return signs


def sharp_mean_signs(speeds: Array, noise: float) -> Array:
    """Return the mean sign of noisy speeds: of the smoothed speeds, but of the raw ones at fast reversals.

    Friction bends a speed at its reversal, and the smoothed speed is zero at another time. At a fast reversal noise
    hardly matters.
    """
    smoothed = smooth(speeds)
    signs, reach = mean_signs(smoothed), int(KERNEL_REACH * BASE_WIDTH)
    if len(smoothed) <= 2 * reach:
        return signs
    earlier, later = smoothed[: -2 * reach], smoothed[2 * reach :]
    fast_reversals = (earlier * later < 0.0) & (
        np.minimum(np.abs(earlier), np.abs(later)) > FAST_REVERSAL_SPEED * noise
    )
    is_fast_reversal = np.zeros(len(smoothed), np.bool_)
    is_fast_reversal[reach:-reach] = fast_reversals
    return np.where(is_fast_reversal, bent_mean_signs(speeds, noise), signs)


def noise_of_acceleration(noise: float, interval: float, width: float) -> float:
    """Return the standard deviation of the second derivative of white angle noise after all smoothing.

    width : samples, smoothing in addition to `BASE_WIDTH`.
    """
    # the squares of the second derivative of a Gaussian add up to 3 / (8 sqrt(pi) total_width^5)
    total_width = math.hypot(BASE_WIDTH, width)
    return noise / interval**2 * math.sqrt(3.0 / (8.0 * math.sqrt(math.pi) * total_width**5))


def kernel(width: float) -> Array:
    """Return Gaussian weights that sum to one, for a standard deviation of `width` samples."""
    reach = max(int(KERNEL_REACH * width + 0.5), 1)
    offsets = np.arange(-reach, reach + 1)
    weights = np.exp(-0.5 * (offsets / width) ** 2)
    return np.asarray(weights / weights.sum(), np.float64)


def smoothed_and_thinned(columns: Array, width: float, step: int) -> Array:
    """Return smoothed columns with one row in `step`, of the rows whose whole kernel lies inside.

    width : samples, standard deviation of the Gaussian; zero for no smoothing.
    """
    if width <= 0.0:
        return columns[::step]
    weights = kernel(width)
    smoothed: Array = upfirdn(weights, columns, up=1, down=step, axis=0)
    begin = -(-(len(weights) - 1) // step)
    end = (len(columns) - 1) // step + 1
    return smoothed[begin:end]


def thinned_rows(length: int, width: float, step: int) -> npt.NDArray[np.intp]:
    """Return the sample that each row of `smoothed_and_thinned` is centred on."""
    if width <= 0.0:
        return np.arange(0, length, step)
    reach = len(kernel(width)) - 1
    begin = -(-reach // step)
    return np.arange(begin, (length - 1) // step + 1) * step - reach // 2
