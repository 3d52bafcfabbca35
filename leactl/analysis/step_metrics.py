"""Rise time, overshoot and settling time of the step response that several trials make together.

Samples of all trials are averaged in bins of one sample; for the settling time they grow to a fiftieth of the time
since the jump, so that the noise of a late, slow part does not end in it. Values between bins are taken from the
straight line, or from a curve where they lie close enough on it.
Where samples lie on the curve is the same in every trial: its uncertainty is told apart from the scatter of trials.
"""

import math
from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import NAN
from leactl.analysis.jackknife import Reading
from leactl.analysis.regression import Array
from leactl.analysis.step_curve import HIGH, LOW, Curve, crossing, curve_of, passing
from leactl.analysis.step_trials import BAND, Trial

GROWTH = 0.02  # of the time since the jump, bins for the settling time
CLEAR = 4.5  # standard errors that an overshoot stands out by, else there is none
TOP = 0.75  # of the overshoot, above which a curve is laid through its top
TOP_ORDER = 4  # of that curve in the logarithm of time
WAY_ORDER = 3  # of the curve through the last way into the band
ENOUGH = 8  # bins, for such a curve and that of the settling
NEAR, FAR = 0.4, 2.0  # of the band, between which the last way into it counts for when it is entered


def rise_time(trials: Sequence[Trial]) -> Reading:
    """From a tenth to nine tenths of the steady value [s]."""
    curve = curve_of(trials)
    half = int(np.argmax(curve.value >= 0.5))
    low = int(np.flatnonzero(curve.value[:half] < LOW)[-1]) + 1
    high = half + int(np.argmax(curve.value[half:] >= HIGH))
    begins, ends = passing(curve, low, LOW), passing(curve, high, HIGH)
    rounding = math.sqrt(2.0 / 3.0) * _rounding(curve) * math.hypot(_pace(curve, low), _pace(curve, high))
    return Reading(ends.time - begins.time, shared=math.hypot(begins.limit, ends.limit), own=rounding)


def overshoot(trials: Sequence[Trial]) -> Reading:
    """Highest point above the steady value [%]; zero where it does not stand out of noise and rounding."""
    curve = curve_of(trials)
    above = curve.value - 1.0
    top = int(np.argmax(above))
    blurred = math.hypot(float(curve.error[top]), curve.quantum / math.sqrt(12.0))
    steady = 100.0 * _rounding(curve)
    if above[top] < CLEAR * blurred:
        return Reading(0.0, own=max(math.sqrt(2.0) * steady, 100.0 * max(float(above[top]), 0.0)))
    lower = above < TOP * above[top]
    begin = int(np.flatnonzero(lower[:top])[-1]) + 1
    end = top + int(np.argmax(lower[top:])) if lower[top:].any() else len(above)
    if end - begin < ENOUGH:  # too few for a curve: the highest, and what may lie between it and its neighbours
        beside = float(np.max(np.abs(np.diff(above[top - 1 : top + 2]))))
        return Reading(100.0 * float(above[top]), shared=100.0 * beside / 4.0, own=math.sqrt(2.0) * steady)
    at = np.log(curve.time[begin:end])
    through = np.polynomial.Polynomial.fit(at, above[begin:end], TOP_ORDER)
    fine = np.linspace(at[0], at[-1], 500)
    return Reading(100.0 * float(through(fine).max()), own=steady)  # on its way over the top it crosses many steps


def settling_time(trials: Sequence[Trial]) -> Reading:
    """From the jump until the response stays within `BAND` of its steady value [s]; NaN where noise leaves it open."""
    curve = curve_of(trials, GROWTH)
    calm = curve._replace(value=_calmed(curve))
    last = int(max(np.flatnonzero(np.abs(calm.value - 1.0) > BAND), default=len(calm.time)))
    if last + 1 >= len(calm.time) or calm.time[last] >= calm.steady_from:
        return Reading(NAN)
    side = math.copysign(1.0, calm.value[last] - 1.0)
    slope = abs(float(calm.value[last + 1] - calm.value[last]) / float(calm.time[last + 1] - calm.time[last]))
    # a drive and the clock of its record agree to a sample on when the jump was
    return Reading(_way_in(curve_of(trials), calm, last, side), shared=curve.interval, own=_rounding(curve) / slope)


def _calmed(curve: Curve) -> Array:
    """The response averaged over neighbouring bins until noise is an eighth of the band; untouched where it is."""
    half = math.ceil(0.5 * ((8.0 * float(np.max(curve.error)) / BAND) ** 2 - 1.0))
    if half <= 0:
        return curve.value
    total = np.concatenate([[0.0], np.cumsum(curve.value)])
    place = np.arange(len(curve.value))
    begin, end = np.maximum(place - half, 0), np.minimum(place + half + 1, len(place))
    return np.asarray((total[end] - total[begin]) / (end - begin), np.float64)


def _way_in(fine: Curve, calm: Curve, last: int, side: float) -> float:
    """Where the response enters the band for good: by a curve through its last way in, if that has bins enough."""
    distance = side * (calm.value - 1.0) / BAND
    inside = np.flatnonzero(distance < NEAR)
    begin = int(max(inside[inside < last], default=-1)) + 1
    end = int(inside[inside > last][0])
    begin += int(np.argmax(distance[begin:end]))
    begin += int(np.count_nonzero(distance[begin:end] > FAR))
    straight = crossing(calm, last + 1, 1.0 + side * BAND)
    part = (fine.time >= calm.time[begin]) & (fine.time <= calm.time[end - 1])
    if np.count_nonzero(part) < ENOUGH:
        return straight
    time, values = fine.time[part], side * (fine.value[part] - 1.0) / BAND - 1.0
    through = np.polynomial.Polynomial.fit(time, values, WAY_ORDER)
    roots = [float(root.real) for root in through.roots() if not root.imag and time[0] <= root.real <= time[-1]]
    return min(roots, key=lambda root: abs(root - straight), default=straight)


def _pace(curve: Curve, index: int) -> float:
    """Time that the response takes for its own whole at the pace it has before this bin [s]."""
    return float(curve.time[index] - curve.time[index - 1]) / float(curve.value[index] - curve.value[index - 1])


def _rounding(curve: Curve) -> float:
    """Limit of a reading's error from its resolution, where noise does not average it out."""
    return 0.0 if curve.noise > 0.5 * curve.quantum else 0.5 * curve.quantum
