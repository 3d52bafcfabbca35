"""Find ringing: lines in the spectrum of the residuals that noise and a sound model do not have.

A swinging part of the bench, an oscillating loop or hum has little power, so that sums of squares hardly show it, but
its power lies at one frequency. Spectra of all runs are averaged (Welch, 1967), and each bin is compared with its
neighbours. That needs no reference: smoothing and slow model errors bend a spectrum but make no line.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d

from leactl.gap.search.effect_regression import Evidence
from leactl.gap.search.regression import Fit, Rows, residuals

Array = npt.NDArray[np.float64]
SEGMENT = 64  # rows of a segment, of which a spectrum is taken
LEAST_VALID_SHARE = 0.6  # smallest share of a segment's rows that are valid
NEIGHBOUR_BINS = 5  # bins on either side that a bin is compared with, without the adjacent one
LOWEST_BIN = 4  # lowest bin with neighbours on both sides; `unrest` judges slower residuals
MOST_STEADY_VARIATION = 0.05  # largest relative variation of a steady speed
FEWEST_SEGMENTS = 8  # segments of a channel; with fewer it has no line
CHANCE_STDS = 3.0  # standard deviations of a mean spectrum that chance may add
FOLLOWED_LAGS = 3  # samples on either side over which a command determines a current, or a motion its velocity
LEAP_RATIO = 6.0  # bend of a leap over a moving command's usual bend
LEAP_REACH = 7  # samples on either side of a leap that are left out
MOST_STILL_BEND = 1e-6  # share of a command's largest bend up to which the command counts as straight
MOST_EVEN_UNREST = 10.0  # largest unrest of a sound machine with which the spectrum is even enough to show a line


@dataclass(frozen=True)
class Line:
    """The highest line of a spectrum."""

    height: float  # ratio to its neighbourhood, less chance, in units of a sound machine's
    frequency: float  # Hz


def highest_lines(evidence: Evidence, fit: Fit, searched: Sequence[bool]) -> dict[tuple[str, str, str], Line]:
    """Return the highest spectral line of the residuals of a fit in each channel.

    Keys are equation, quantity and mechanical set-up. Channels with too few rows are left out.

    searched : by group of rows, whether it takes part.
    """
    spectra: dict[tuple[str, str, str], list[Array]] = {}
    rates: dict[tuple[str, str, str], float] = {}
    for index, rows in enumerate(evidence.stack.rows):
        if not searched[index] or not evidence.is_judged(rows) or len(rows.index) < SEGMENT:
            continue
        if evidence.expected_unrest(rows) > MOST_EVEN_UNREST:
            continue
        residual = without_followed_part(rows, residuals(evidence.stack, fit, index)) / rows.white_noise
        step = int(np.min(np.diff(rows.index)))
        grid_index = (rows.index - rows.index[0]) // step
        values_on_grid = np.full(grid_index[-1] + 1, np.nan)
        values_on_grid[grid_index] = np.where(
            steady_rows(rows, grid_index) | rows_below_one_count(rows), np.nan, residual
        )
        key = (rows.equation, rows.quantity, rows.mechanical)
        rates[key] = 1.0 / (step * rows.signals.interval)
        spectra.setdefault(key, []).extend(periodograms(values_on_grid))
    lines = {}
    for key, spectrum in spectra.items():
        if len(spectrum) >= FEWEST_SEGMENTS:
            bin_index, height = highest_line(spectrum)
            lines[key] = Line(height / max(evidence.lines.get(key, 1.0), 1.0), bin_index * rates[key] / SEGMENT)
    return lines


def steady_rows(rows: Rows, grid_index: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
    """Return the mask of the rows around which the speed is constant: encoder counts make lines there."""
    if rows.signals.velocity is None:
        return np.zeros(len(grid_index), bool)
    speed = rows.signals.velocity[rows.index]
    half_window = SEGMENT // 4
    begin, end = (np.searchsorted(grid_index, grid_index + side * half_window) for side in (-1, 1))
    count = np.maximum(end - begin, 1)
    sums, squares = (np.concatenate([[0.0], np.cumsum(series)]) for series in (speed, speed**2))
    mean = (sums[end] - sums[begin]) / count
    std = np.sqrt(np.maximum((squares[end] - squares[begin]) / count - mean**2, 0.0))
    return np.asarray(std < MOST_STEADY_VARIATION * np.abs(mean), np.bool_)


def without_followed_part(rows: Rows, residual: Array) -> Array:
    """Return the residual of a current or a velocity without its part that is linear in the lagged input of the filter.

    The input is the model's current, or the speed of the angle: a slightly wrong loop, filter or stamp leaves its
    spectral lines in the residual. Rows around leaps of the command become NaN. Other equations keep their residual.
    """
    filter_input = {"current": rows.signals.following, "velocity": rows.signals.velocity}.get(rows.equation)
    if filter_input is None:
        return residual
    is_far_from_leap = np.ones(len(residual), np.bool_)
    if rows.equation == "current":
        bends = np.zeros(len(filter_input))
        bends[1:-1] = np.abs(np.diff(filter_input, 2))
        moving_bends = bends[bends > MOST_STILL_BEND * np.max(bends, initial=0.0)]
        leaps = (
            maximum_filter1d(bends > LEAP_RATIO * np.median(moving_bends), 2 * LEAP_REACH + 1)
            if len(moving_bends)
            else bends > 0.0
        )
        is_far_from_leap = ~leaps[rows.index]
    lags = [
        filter_input[np.clip(rows.index + lag, 0, len(filter_input) - 1)]
        for lag in range(-FOLLOWED_LAGS, FOLLOWED_LAGS + 1)
    ]
    table = np.stack(lags, axis=1)
    is_usable = is_far_from_leap & np.isfinite(table).all(axis=1) & np.isfinite(residual)
    weights = np.linalg.lstsq(table[is_usable], residual[is_usable], rcond=None)[0]
    return np.where(is_usable, residual - table @ weights, np.nan)


def rows_below_one_count(rows: Rows) -> npt.NDArray[np.bool_]:
    """Return the mask of the rows of a velocity equation where the shaft moves by less than one count in a sample."""
    signals = rows.signals
    if signals.velocity is None or rows.quantity != "velocity":
        return np.zeros(len(rows.index), bool)
    return np.asarray(np.abs(signals.velocity[rows.index]) * signals.interval < signals.count, np.bool_)


def periodograms(values: Array) -> list[Array]:
    """Return the power of half-overlapping segments under a Hann window; missing values (NaN) count as zero."""
    window, powers = np.hanning(SEGMENT), []
    for start in range(0, len(values) - SEGMENT + 1, SEGMENT // 2):
        segment = values[start : start + SEGMENT]
        is_finite = np.isfinite(segment)
        if is_finite.mean() >= LEAST_VALID_SHARE:
            power = np.abs(np.fft.rfft(np.where(is_finite, segment, 0.0) * window)) ** 2
            powers.append(power / np.sum((window * is_finite) ** 2))
    return powers


def highest_line(spectra: Sequence[Array]) -> tuple[int, float]:
    """Return the highest bin of the mean of periodograms, and its height less what chance gives it.

    Each periodogram is divided by its median power: else a loud run of few segments would dominate.
    """
    relative_spectra = [power / level for power in spectra if (level := float(np.median(power))) > 0.0]
    if not relative_spectra:
        return 0, 0.0
    bin_index, ratio = highest_bin(np.mean(relative_spectra, axis=0))
    return bin_index, ratio * (1.0 - CHANCE_STDS / math.sqrt(len(relative_spectra)))


def highest_bin(power: Array) -> tuple[int, float]:
    """Return the bin with the highest ratio to its neighbours, and the ratio.

    The larger of the medians on either side counts, so that a slope makes no line.
    """
    ratios = np.zeros(len(power))
    for bin_index in range(LOWEST_BIN, len(power) - 2):
        below, above = (
            power[max(1, bin_index - NEIGHBOUR_BINS) : bin_index - 1],
            power[bin_index + 2 : bin_index + NEIGHBOUR_BINS + 1],
        )
        neighbour_power = max(float(np.median(below)), float(np.median(above)))
        ratios[bin_index] = (
            power[bin_index] / neighbour_power if neighbour_power > 0.0 else 0.0
        )  # neighbours without power give no noise to compare with
    return int(np.argmax(ratios)), float(np.max(ratios))
