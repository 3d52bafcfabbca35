"""Rise time, overshoot and settling time of the mean step response of several trials.

Samples of all trials are averaged in bins of one sample; for the settling time, bins grow to a fiftieth of the time
since the jump, which averages the noise of the late, slow part. Values between bins are interpolated by a straight
line, or by a curve if the bins lie smoothly enough. The samples of all trials are at the same positions of the
response, so that the scatter of the trials does not show the error of the interpolation, which counts separately.
"""

import math
from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import NAN
from leactl.analysis.responses.step_curve import (
    RISE_END,
    RISE_START,
    MeanStepResponse,
    crossing_with_limit,
    mean_step_response,
    straight_crossing,
)
from leactl.analysis.responses.step_trials import SETTLING_BAND, StepTrial, rounding_limit_of
from leactl.analysis.statistics.intervals import rounding_limit
from leactl.analysis.statistics.jackknife import LevelFigure
from leactl.analysis.statistics.regression import Array

BIN_GROWTH = 0.02  # width of a bin for the settling time, over the time since the jump
LEAST_OVERSHOOT_ERRORS = 4.5  # standard errors; a smaller overshoot counts as none
BAND_NOISE = 1 / 8  # of the band: bins are averaged to this noise to find when the band is entered
TOP_NOISE = 1 / 20  # of an overshoot: bins are averaged to this noise to find its top
LEAST_BINS_OVER_HALF_WIDTH = 4  # bins since the jump over the bins to either side that are averaged
UNDECIDED_ABOVE = 1 / 3  # of the band; larger noise or rounding hides when a response settles
SLOPE_QUANTA = 2.0  # resolutions to either side of a level over which the response's slope is taken
TOP_SHARES = 0.75, 0.9, 0.97  # of the overshoot; the curve is fitted to bins above the first share at which it fits
MOST_RESIDUAL_STDS = 3.0  # by which the residuals' spread may exceed noise and rounding if a curve fits
TOP_ORDER = 4  # of the polynomial through the top, in the logarithm of time
ENTRY_ORDER = 3  # of the polynomial through the last entry into the band
FEWEST_BINS = 8  # of either polynomial
BAND_NEAR, BAND_FAR = 0.4, 2.0  # distances over the band's, between which the curve through the last entry is fitted


def rise_time(trials: Sequence[StepTrial]) -> LevelFigure:
    """Return the time from 10 % to 90 % of the steady value [s]."""
    curve = mean_step_response(trials)
    half_index = int(np.argmax(curve.value >= 0.5))
    low_index = int(np.flatnonzero(curve.value[:half_index] < RISE_START)[-1]) + 1
    high_index = half_index + int(np.argmax(curve.value[half_index:] >= RISE_END))
    low_crossing, high_crossing = (
        crossing_with_limit(curve, low_index, RISE_START),
        crossing_with_limit(curve, high_index, RISE_END),
    )
    low_rounding, high_rounding = _rounding_at(curve, low_index, RISE_START), _rounding_at(curve, high_index, RISE_END)
    # rounding of the readings at both crossings, then before the jump and in the steady part, which shift both levels
    roundings = (
        low_rounding,
        high_rounding,
        (1 - RISE_START) * low_rounding - (1 - RISE_END) * high_rounding,
        RISE_START * low_rounding - RISE_END * high_rounding,
    )
    return LevelFigure(high_crossing.time - low_crossing.time, (low_crossing.limit, high_crossing.limit), roundings)


def overshoot(trials: Sequence[StepTrial]) -> LevelFigure:
    """Return the highest point above the steady value [%]; zero if noise and rounding hide it."""
    curve = mean_step_response(trials)
    excess = curve.value - 1.0
    bin_error = float(np.max(curve.error))
    top = int(np.argmax(excess))
    noise_and_rounding = math.hypot(bin_error, curve.quantum / math.sqrt(12.0))
    steady_rounding = 100.0 * rounding_limit_of(curve.noise, curve.quantum)
    if excess[top] < LEAST_OVERSHOOT_ERRORS * noise_and_rounding:
        return LevelFigure(0.0, per_level=(steady_rounding, max(steady_rounding, 100.0 * float(excess[top]))))
    smooth_excess = _averaged(curve, TOP_NOISE * float(excess[top])) - 1.0
    top = int(np.argmax(smooth_excess))
    for share in TOP_SHARES:
        start, stop = _bins_above(smooth_excess, top, share)
        if stop - start < FEWEST_BINS:
            break
        highest, residual_std, weights, fitted = _fitted_top(curve.time[start:stop], excess[start:stop])
        top_rounding = 100.0 * rounding_limit(fitted, curve.quantum if steady_rounding else 0.0, weights)
        local_noise = float(np.std(np.diff(excess[start:stop]))) / math.sqrt(2.0)  # may be larger near the top
        if residual_std <= (1.0 + MOST_RESIDUAL_STDS / math.sqrt(2.0 * (stop - start))) * max(
            noise_and_rounding, local_noise
        ):
            return LevelFigure(100.0 * highest, per_level=(steady_rounding, top_rounding))
    if stop - start >= FEWEST_BINS:  # no curve fits the bins: the last curve's residuals give a limit
        return LevelFigure(100.0 * highest, (100.0 * math.sqrt(3.0) * residual_std,), (steady_rounding, top_rounding))
    # too few bins for a curve: the highest bin, with a limit from the steps to its neighbours
    top = start + int(np.argmax(excess[start:stop]))
    step_to_neighbour = float(np.max(np.abs(np.diff(excess[top - 1 : top + 2]))))
    return LevelFigure(
        100.0 * float(excess[top]), (25.0 * step_to_neighbour, 100.0 * bin_error), (steady_rounding, steady_rounding)
    )


def _bins_above(smooth_excess: Array, top: int, share: float) -> tuple[int, int]:
    """Return start and stop of the bins around the top that stay above a share of the overshoot."""
    is_lower = smooth_excess < share * smooth_excess[top]
    stop = top + int(np.argmax(is_lower[top:])) if is_lower[top:].any() else len(smooth_excess)
    return int(np.flatnonzero(is_lower[:top])[-1]) + 1, stop


def _fitted_top(time: Array, excess: Array) -> tuple[float, float, Array, Array]:
    """Return the top of a curve through bins, the residuals' standard deviation, the top's weights, and the curve.

    `excess` is the response above the steady value, shape (bins,), as are the weights and the curve.
    """
    log_time = np.log(time)
    scaled_time = 2.0 * (log_time - log_time[0]) / (log_time[-1] - log_time[0]) - 1.0
    design, fine_design = (
        np.vander(abscissa, TOP_ORDER + 1) for abscissa in (scaled_time, np.linspace(-1.0, 1.0, 500))
    )
    solution = np.linalg.pinv(design)
    fitted, fine_curve = design @ solution @ excess, fine_design @ solution @ excess
    highest = int(np.argmax(fine_curve))
    return float(fine_curve[highest]), float(np.std(excess - fitted)), fine_design[highest] @ solution, fitted


def settling_time(trials: Sequence[StepTrial]) -> LevelFigure:
    """Return the time from the jump until the response stays within `SETTLING_BAND` [s]; NaN if noise hides it."""
    curve = mean_step_response(trials, BIN_GROWTH)
    bin_error = float(np.max(curve.error))
    half_widths = _averaging_half_widths(curve, BAND_NOISE * SETTLING_BAND)
    smooth = curve._replace(value=_averaged(curve, BAND_NOISE * SETTLING_BAND))
    last_outside = int(max(np.flatnonzero(np.abs(smooth.value - 1.0) > SETTLING_BAND), default=len(smooth.time)))
    if last_outside + 1 >= len(smooth.time) or smooth.time[last_outside] >= smooth.steady_from:
        return LevelFigure(NAN)
    if (
        max(bin_error / math.sqrt(2.0 * half_widths[last_outside] + 1.0), rounding_limit_of(curve.noise, curve.quantum))
        > UNDECIDED_ABOVE * SETTLING_BAND
    ):
        return LevelFigure(NAN)
    side = math.copysign(1.0, smooth.value[last_outside] - 1.0)
    unaveraged = mean_step_response(trials)
    entry_time = _entry_time(unaveraged, smooth, last_outside, side)
    # the time of the jump on the drive's clock and on the record's may differ by a sample
    limits = [curve.interval]
    if math.isnan(entry_time):  # too few bins for a curve: a straight line, which the averaging shifts
        entry_time = straight_crossing(smooth, last_outside + 1, 1.0 + side * SETTLING_BAND)
        limits.append(float(half_widths[last_outside]) * curve.interval)
    rounding = _rounding_at(unaveraged, int(np.searchsorted(unaveraged.time, entry_time)), 1.0 + side * SETTLING_BAND)
    # the readings at the entry and those in the steady part are rounded independently
    return LevelFigure(entry_time, tuple(limits), (rounding, rounding))


def _averaging_half_widths(curve: MeanStepResponse, standard_error: float) -> Array:
    """Return how many bins to either side of each bin are averaged to reach a standard error, shape (bins,).

    The averaging never reaches back to the jump.
    """
    half_width = math.ceil(0.5 * max((float(np.max(curve.error)) / standard_error) ** 2 - 1.0, 0.0))
    return np.minimum(half_width, np.arange(len(curve.value)) // LEAST_BINS_OVER_HALF_WIDTH)


def _averaged(curve: MeanStepResponse, standard_error: float) -> Array:
    """Return the response averaged over neighbouring bins until its noise is at most `standard_error`."""
    half_widths, index = _averaging_half_widths(curve, standard_error), np.arange(len(curve.value))
    cumulative_sum = np.concatenate([[0.0], np.cumsum(curve.value)])
    start, stop = index - half_widths, np.minimum(index + half_widths + 1, len(index))
    return np.asarray((cumulative_sum[stop] - cumulative_sum[start]) / (stop - start), np.float64)


def _entry_time(unaveraged: MeanStepResponse, smooth: MeanStepResponse, last_outside: int, side: float) -> float:
    """Return the time [s] at which the response enters the band for good, by a curve through its last entry.

    `last_outside` is the last bin of the averaged response `smooth` outside of the band, and `side` is 1 above the band
    and -1 below. NaN if the entry has fewer than `FEWEST_BINS` bins.
    """
    distance = side * (smooth.value - 1.0) / SETTLING_BAND
    inside_indices = np.flatnonzero(distance < BAND_NEAR)
    start = int(max(inside_indices[inside_indices < last_outside], default=-1)) + 1
    stop = int(inside_indices[inside_indices > last_outside][0])
    start += int(np.argmax(distance[start:stop]))
    start += int(np.count_nonzero(distance[start:stop] > BAND_FAR))
    in_entry = (unaveraged.time >= smooth.time[start]) & (unaveraged.time <= smooth.time[stop - 1])
    if np.count_nonzero(in_entry) < FEWEST_BINS:
        return NAN
    straight = straight_crossing(smooth, last_outside + 1, 1.0 + side * SETTLING_BAND)
    time, values = unaveraged.time[in_entry], side * (unaveraged.value[in_entry] - 1.0) / SETTLING_BAND - 1.0
    polynomial = np.polynomial.Polynomial.fit(time, values, ENTRY_ORDER)
    roots = [float(root.real) for root in polynomial.roots() if not root.imag and time[0] <= root.real <= time[-1]]
    return min(roots, key=lambda root: abs(root - straight), default=straight)


def _rounding_at(curve: MeanStepResponse, index: int, level: float) -> float:
    """Return the limit of the error [s] that rounded readings cause in the time at which a level is passed."""
    if not rounding_limit_of(curve.noise, curve.quantum):
        return 0.0
    is_near = np.abs(curve.value - level) <= SLOPE_QUANTA * curve.quantum
    is_near[index - 1 : index + 1] = True
    start = int(max(np.flatnonzero(~is_near[:index]), default=-1)) + 1
    stop = index + int(np.argmin(is_near[index:])) if not is_near[index:].all() else len(is_near)
    rise = abs(float(curve.value[stop - 1] - curve.value[start]))
    return (
        rounding_limit_of(curve.noise, curve.quantum)
        * float(curve.time[stop - 1] - curve.time[start])
        / max(rise, curve.quantum)
    )
