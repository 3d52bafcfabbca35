"""Rise time, overshoot and settling time of the mean step response of several trials.

Samples of all trials are averaged in bins of one sample; for the settling time, bins grow to a fiftieth of the time
since the jump, which averages the noise of the late, slow part. Values between bins are interpolated by a straight
line, or by a curve where the bins lie smoothly enough. The samples of all trials are at the same positions of the
response, so that the error of the interpolation is not in the scatter of the trials and counts separately.
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
BAND_NEAR, BAND_FAR = 0.4, 2.0  # of the band: distances between which the curve through the last way into it is fitted


def rise_time(trials: Sequence[StepTrial]) -> TrialFigure:
    """Return the time from 10 % to 90 % of the steady value [s]."""
    curve = mean_step_response(trials)
    half = int(np.argmax(curve.value >= 0.5))
    low = int(np.flatnonzero(curve.value[:half] < RISE_START)[-1]) + 1
    high = half + int(np.argmax(curve.value[half:] >= RISE_END))
    low_crossing, high_crossing = (
        crossing_with_limit(curve, low, RISE_START),
        crossing_with_limit(curve, high, RISE_END),
    )
    at_low, at_high = _rounding_at(curve, low, RISE_START), _rounding_at(curve, high, RISE_END)
    # rounding of the readings at both crossings, then before the jump and in the steady part, which shift both levels
    roundings = (
        at_low,
        at_high,
        (1 - RISE_START) * at_low - (1 - RISE_END) * at_high,
        RISE_START * at_low - RISE_END * at_high,
    )
    return TrialFigure(high_crossing.time - low_crossing.time, (low_crossing.limit, high_crossing.limit), roundings)


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
    for share in TOP_PARTS:
        start, stop = _bins_above(calm, top, share)
        if stop - start < FEWEST_BINS:
            break
        highest, residual_std, weights, fitted = _fitted_top(curve.time[start:stop], above[start:stop])
        rounded = 100.0 * rounding_limit(fitted, curve.quantum if steady else 0.0, weights)
        local_noise = float(np.std(np.diff(above[start:stop]))) / math.sqrt(2.0)  # may be larger near the top
        if residual_std <= (1.0 + MOST_RESIDUAL_STDS / math.sqrt(2.0 * (stop - start))) * max(blurred, local_noise):
            return TrialFigure(100.0 * highest, per_level=(steady, rounded))
    if stop - start >= FEWEST_BINS:  # no curve fits the bins: the residuals of the last curve are a limit
        return TrialFigure(100.0 * highest, (100.0 * math.sqrt(3.0) * residual_std,), (steady, rounded))
    # too few bins for a curve: the highest bin, with a limit from the steps to its neighbours
    top = start + int(np.argmax(above[start:stop]))
    step_to_neighbour = float(np.max(np.abs(np.diff(above[top - 1 : top + 2]))))
    return TrialFigure(100.0 * float(above[top]), (25.0 * step_to_neighbour, 100.0 * error), (steady, steady))


def _bins_above(calm: Array, top: int, share: float) -> tuple[int, int]:
    """Return start and stop of the bins about the top that stay above a share of the overshoot."""
    lower = calm < share * calm[top]
    stop = top + int(np.argmax(lower[top:])) if lower[top:].any() else len(calm)
    return int(np.flatnonzero(lower[:top])[-1]) + 1, stop


def _fitted_top(time: Array, above: Array) -> tuple[float, float, Array, Array]:
    """Fit a curve through bins; return its top, the residuals' standard deviation, the top's weights, the curve."""
    log_time = np.log(time)
    scaled = 2.0 * (log_time - log_time[0]) / (log_time[-1] - log_time[0]) - 1.0
    design, fine_design = (np.vander(abscissa, TOP_ORDER + 1) for abscissa in (scaled, np.linspace(-1.0, 1.0, 500)))
    solution = np.linalg.pinv(design)
    fitted, fine = design @ solution @ above, fine_design @ solution @ above
    highest = int(np.argmax(fine))
    return float(fine[highest]), float(np.std(above - fitted)), fine_design[highest] @ solution, fitted


def settling_time(trials: Sequence[StepTrial]) -> TrialFigure:
    """Return the time from the jump until the response stays within `SETTLING_BAND` [s]; NaN where noise hides it."""
    curve = mean_step_response(trials, BIN_GROWTH)
    error = float(np.max(curve.error))
    halves = _averaging_half_widths(curve, BAND_NOISE * SETTLING_BAND)
    calm = curve._replace(value=_averaged(curve, BAND_NOISE * SETTLING_BAND))
    last_outside = int(max(np.flatnonzero(np.abs(calm.value - 1.0) > SETTLING_BAND), default=len(calm.time)))
    if last_outside + 1 >= len(calm.time) or calm.time[last_outside] >= calm.steady_from:
        return TrialFigure(NAN)
    if (
        max(error / math.sqrt(2.0 * halves[last_outside] + 1.0), rounding_limit_of(curve.noise, curve.quantum))
        > UNDECIDED_ABOVE * SETTLING_BAND
    ):
        return TrialFigure(NAN)
    side = math.copysign(1.0, calm.value[last_outside] - 1.0)
    fine = mean_step_response(trials)
    entry_time = _entry_time(fine, calm, last_outside, side)
    # the time of the jump on the drive's clock and on the record's may differ by a sample
    limits = [curve.interval]
    if math.isnan(entry_time):  # too few bins for a curve: a straight line, which the averaging shifts
        entry_time = straight_crossing(calm, last_outside + 1, 1.0 + side * SETTLING_BAND)
        limits.append(float(halves[last_outside]) * curve.interval)
    rounding = _rounding_at(fine, int(np.searchsorted(fine.time, entry_time)), 1.0 + side * SETTLING_BAND)
    # the readings at the entry and those in the steady part are rounded independently
    return TrialFigure(entry_time, tuple(limits), (rounding, rounding))


def _averaging_half_widths(curve: MeanStepResponse, standard_error: float) -> Array:
    """Return how many bins to either side of each are averaged to reach a standard error, never back to the jump."""
    half = math.ceil(0.5 * max((float(np.max(curve.error)) / standard_error) ** 2 - 1.0, 0.0))
    return np.minimum(half, np.arange(len(curve.value)) // AVERAGED_PART)


def _averaged(curve: MeanStepResponse, standard_error: float) -> Array:
    """Return the response averaged over neighbouring bins until its noise is at most `standard_error`."""
    halves, index = _averaging_half_widths(curve, standard_error), np.arange(len(curve.value))
    total = np.concatenate([[0.0], np.cumsum(curve.value)])
    start, stop = index - halves, np.minimum(index + halves + 1, len(index))
    return np.asarray((total[stop] - total[start]) / (stop - start), np.float64)


def _entry_time(fine: MeanStepResponse, calm: MeanStepResponse, last_outside: int, side: float) -> float:
    """Return the time [s] at which the response enters the band for good, by a curve through its last way in.

    `last_outside` is the last bin of the averaged response `calm` outside of the band, and `side` is 1 above the band
    and -1 below. NaN for too few bins.
    """
    distance = side * (calm.value - 1.0) / SETTLING_BAND
    inside = np.flatnonzero(distance < BAND_NEAR)
    start = int(max(inside[inside < last_outside], default=-1)) + 1
    stop = int(inside[inside > last_outside][0])
    start += int(np.argmax(distance[start:stop]))
    start += int(np.count_nonzero(distance[start:stop] > BAND_FAR))
    way_in = (fine.time >= calm.time[start]) & (fine.time <= calm.time[stop - 1])
    if np.count_nonzero(way_in) < FEWEST_BINS:
        return NAN
    straight = straight_crossing(calm, last_outside + 1, 1.0 + side * SETTLING_BAND)
    time, values = fine.time[way_in], side * (fine.value[way_in] - 1.0) / SETTLING_BAND - 1.0
    polynomial = np.polynomial.Polynomial.fit(time, values, WAY_ORDER)
    roots = [float(root.real) for root in polynomial.roots() if not root.imag and time[0] <= root.real <= time[-1]]
    return min(roots, key=lambda root: abs(root - straight), default=straight)


def _rounding_at(curve: MeanStepResponse, index: int, level: float) -> float:
    """Return the limit of the error that rounded readings cause in the time of passing a level [s]."""
    if not rounding_limit_of(curve.noise, curve.quantum):
        return 0.0
    near = np.abs(curve.value - level) <= PACE_QUANTA * curve.quantum
    near[index - 1 : index + 1] = True
    start = int(max(np.flatnonzero(~near[:index]), default=-1)) + 1
    stop = index + int(np.argmin(near[index:])) if not near[index:].all() else len(near)
    rise = abs(float(curve.value[stop - 1] - curve.value[start]))
    return (
        rounding_limit_of(curve.noise, curve.quantum)
        * float(curve.time[stop - 1] - curve.time[start])
        / max(rise, curve.quantum)
    )
