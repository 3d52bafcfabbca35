"""Rise time, overshoot and settling time of the mean step response of several trials.

Samples of all trials are averaged in bins of one sample; for the settling time, bins grow to a fiftieth of the time
since the jump, which averages the noise of the late, slow part. Values between bins are interpolated by a straight
line, or by a curve where the bins lie smoothly enough. The samples are at the same positions of the response in every
trial, so that the error of the interpolation is kept apart from the scatter of trials.
"""

import math
from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import NAN
from leactl.analysis.responses.step_curve import (
    HIGH,
    LOW,
    MeanStepResponse,
    crossing_with_limit,
    mean_step_response,
    straight_crossing,
)
from leactl.analysis.responses.step_trials import SETTLING_BAND, StepTrial, rounding_limit_of
from leactl.analysis.statistics.intervals import rounding_limit
from leactl.analysis.statistics.jackknife import TrialFigure
from leactl.analysis.statistics.regression import Array

BIN_GROWTH = 0.02  # width of a bin for the settling time, over the time since the jump
LEAST_OVERSHOOT_ERRORS = 4.5  # standard errors; a smaller overshoot counts as none
BAND_NOISE = 1 / 8  # of the band, to which noise is averaged to find when the band is entered
TOP_NOISE = 1 / 20  # of an overshoot, to which noise is averaged to find its top
AVERAGED_PART = 4  # bins since the jump over the bins to either side that are averaged at most
UNDECIDED_ABOVE = 1 / 3  # of the band; larger noise or rounding hides when a response settles
PACE_QUANTA = 2.0  # resolutions to either side of a level, over which the response's slope is taken
TOP_PARTS = 0.75, 0.9, 0.97  # of the overshoot; bins above the first that a curve fits are used
MOST_RESIDUAL_STDS = 3.0  # standard deviations, by which a curve's residuals may exceed noise and rounding
TOP_ORDER = 4  # of the polynomial through the top, in the logarithm of time
WAY_ORDER = 3  # of the polynomial through the last way into the band
FEWEST_BINS = 8  # for either polynomial
BAND_NEAR, BAND_FAR = 0.4, 2.0  # of the band, between which the last way into it counts for when it is entered


def rise_time(trials: Sequence[StepTrial]) -> TrialFigure:
    """Return the time from 10 % to 90 % of the steady value [s]."""
    curve = mean_step_response(trials)
    half = int(np.argmax(curve.value >= 0.5))
    low = int(np.flatnonzero(curve.value[:half] < LOW)[-1]) + 1
    high = half + int(np.argmax(curve.value[half:] >= HIGH))
    begins, ends = crossing_with_limit(curve, low, LOW), crossing_with_limit(curve, high, HIGH)
    slow, fast = _rounding_at(curve, low, LOW), _rounding_at(curve, high, HIGH)
    # what is read at each passing, and at rest and in the steady part, of which each level has its share
    roundings = (slow, fast, (1 - LOW) * slow - (1 - HIGH) * fast, LOW * slow - HIGH * fast)
    return TrialFigure(ends.time - begins.time, (begins.limit, ends.limit), roundings)


def overshoot(trials: Sequence[StepTrial]) -> TrialFigure:
    """Return the highest point above the steady value [%]; zero where noise and rounding hide it."""
    curve = mean_step_response(trials)
    above = curve.value - 1.0
    error = float(np.max(curve.error))
    top = int(np.argmax(above))
    blurred = math.hypot(error, curve.quantum / math.sqrt(12.0))
    steady = 100.0 * rounding_limit_of(curve.noise, curve.quantum)
    if above[top] < LEAST_OVERSHOOT_ERRORS * blurred:
        return TrialFigure(0.0, per_level=(steady, max(steady, 100.0 * float(above[top]))))
    calm = _averaged(curve, TOP_NOISE * float(above[top])) - 1.0
    top = int(np.argmax(calm))
    for part in TOP_PARTS:
        begin, end = _bins_above(calm, top, part)
        if end - begin < FEWEST_BINS:
            break
        highest, residual_std, weights, fitted = _fitted_top(curve.time[begin:end], above[begin:end])
        rounded = 100.0 * rounding_limit(fitted, curve.quantum if steady else 0.0, weights)
        moving = float(np.std(np.diff(above[begin:end]))) / math.sqrt(2.0)  # noise, that may be louder there
        if residual_std <= (1.0 + MOST_RESIDUAL_STDS / math.sqrt(2.0 * (end - begin))) * max(blurred, moving):
            return TrialFigure(100.0 * highest, per_level=(steady, rounded))
    if end - begin >= FEWEST_BINS:  # no curve that they lie on: how far they are off the last one is a limit
        return TrialFigure(100.0 * highest, (100.0 * math.sqrt(3.0) * residual_std,), (steady, rounded))
    # too few for a curve: the highest, and what may lie between it and its neighbours
    top = begin + int(np.argmax(above[begin:end]))
    beside = float(np.max(np.abs(np.diff(above[top - 1 : top + 2]))))
    return TrialFigure(100.0 * float(above[top]), (25.0 * beside, 100.0 * error), (steady, steady))


def _bins_above(calm: Array, top: int, part: float) -> tuple[int, int]:
    """Return the first bin and the end of the bins about the top that stay above a part of the overshoot."""
    lower = calm < part * calm[top]
    end = top + int(np.argmax(lower[top:])) if lower[top:].any() else len(calm)
    return int(np.flatnonzero(lower[:top])[-1]) + 1, end


def _fitted_top(time: Array, above: Array) -> tuple[float, float, Array, Array]:
    """Fit a curve through bins; return its top, the residuals' standard deviation, the top's weights, the curve."""
    log_time = np.log(time)
    scaled = 2.0 * (log_time - log_time[0]) / (log_time[-1] - log_time[0]) - 1.0
    table, finely = (np.vander(x, TOP_ORDER + 1) for x in (scaled, np.linspace(-1.0, 1.0, 500)))
    solution = np.linalg.pinv(table)
    fitted, fine = table @ solution @ above, finely @ solution @ above
    highest = int(np.argmax(fine))
    return float(fine[highest]), float(np.std(above - fitted)), finely[highest] @ solution, fitted


def settling_time(trials: Sequence[StepTrial]) -> TrialFigure:
    """Return the time from the jump until the response stays within `SETTLING_BAND` [s]; NaN where noise hides it."""
    curve = mean_step_response(trials, BIN_GROWTH)
    error = float(np.max(curve.error))
    halves = _averaging_half_widths(curve, BAND_NOISE * SETTLING_BAND)
    calm = curve._replace(value=_averaged(curve, BAND_NOISE * SETTLING_BAND))
    last = int(max(np.flatnonzero(np.abs(calm.value - 1.0) > SETTLING_BAND), default=len(calm.time)))
    if last + 1 >= len(calm.time) or calm.time[last] >= calm.steady_from:
        return TrialFigure(NAN)
    if (
        max(error / math.sqrt(2.0 * halves[last] + 1.0), rounding_limit_of(curve.noise, curve.quantum))
        > UNDECIDED_ABOVE * SETTLING_BAND
    ):
        return TrialFigure(NAN)
    side = math.copysign(1.0, calm.value[last] - 1.0)
    fine = mean_step_response(trials)
    entered = _entry_time(fine, calm, last, side)
    # a drive and the clock of its record agree to a sample on when the jump was
    limits = [curve.interval]
    if math.isnan(entered):  # too few bins for a curve: the straight line, which averaging has moved
        entered = straight_crossing(calm, last + 1, 1.0 + side * SETTLING_BAND)
        limits.append(float(halves[last]) * curve.interval)
    rounding = _rounding_at(fine, int(np.searchsorted(fine.time, entered)), 1.0 + side * SETTLING_BAND)
    return TrialFigure(entered, tuple(limits), (rounding, rounding))  # of what is read there, and in the steady part


def _averaging_half_widths(curve: MeanStepResponse, wanted: float) -> Array:
    """Return how many bins to either side of each are averaged to reach a standard error, never back to the jump."""
    half = math.ceil(0.5 * max((float(np.max(curve.error)) / wanted) ** 2 - 1.0, 0.0))
    return np.minimum(half, np.arange(len(curve.value)) // AVERAGED_PART)


def _averaged(curve: MeanStepResponse, wanted: float) -> Array:
    """Return the response averaged over neighbouring bins until its noise is as small as wanted."""
    halves, index = _averaging_half_widths(curve, wanted), np.arange(len(curve.value))
    total = np.concatenate([[0.0], np.cumsum(curve.value)])
    begin, end = index - halves, np.minimum(index + halves + 1, len(index))
    return np.asarray((total[end] - total[begin]) / (end - begin), np.float64)


def _entry_time(fine: MeanStepResponse, calm: MeanStepResponse, last: int, side: float) -> float:
    """Return when the response enters the band for good [s], by a curve through its last way in; NaN for few bins."""
    distance = side * (calm.value - 1.0) / SETTLING_BAND
    inside = np.flatnonzero(distance < BAND_NEAR)
    begin = int(max(inside[inside < last], default=-1)) + 1
    end = int(inside[inside > last][0])
    begin += int(np.argmax(distance[begin:end]))
    begin += int(np.count_nonzero(distance[begin:end] > BAND_FAR))
    part = (fine.time >= calm.time[begin]) & (fine.time <= calm.time[end - 1])
    if np.count_nonzero(part) < FEWEST_BINS:
        return NAN
    straight = straight_crossing(calm, last + 1, 1.0 + side * SETTLING_BAND)
    time, values = fine.time[part], side * (fine.value[part] - 1.0) / SETTLING_BAND - 1.0
    polynomial = np.polynomial.Polynomial.fit(time, values, WAY_ORDER)
    roots = [float(root.real) for root in polynomial.roots() if not root.imag and time[0] <= root.real <= time[-1]]
    return min(roots, key=lambda root: abs(root - straight), default=straight)


def _rounding_at(curve: MeanStepResponse, index: int, level: float) -> float:
    """Return the limit of the error that rounded readings cause in the time of passing a level [s]."""
    if not rounding_limit_of(curve.noise, curve.quantum):
        return 0.0
    near = np.abs(curve.value - level) <= PACE_QUANTA * curve.quantum
    near[index - 1 : index + 1] = True
    begin = int(max(np.flatnonzero(~near[:index]), default=-1)) + 1
    end = index + int(np.argmin(near[index:])) if not near[index:].all() else len(near)
    went = abs(float(curve.value[end - 1] - curve.value[begin]))
    return (
        rounding_limit_of(curve.noise, curve.quantum)
        * float(curve.time[end - 1] - curve.time[begin])
        / max(went, curve.quantum)
    )
