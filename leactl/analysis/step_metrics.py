"""Rise time, overshoot and settling time of the step response that several trials make together.

Samples of all trials are averaged in bins of one sample; for the settling time they grow to a fiftieth of the time
since the jump, so that the noise of a late, slow part does not end in it. Values between bins are taken from the
straight line.
Where samples lie on the curve is the same in every trial: its uncertainty is told apart from the scatter of trials.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from leactl.analysis.estimate import NAN
from leactl.analysis.jackknife import Reading
from leactl.analysis.regression import Array
from leactl.analysis.step_trials import BAND, Trial

LOW, HIGH = 0.1, 0.9  # of the steady value, between which the rise time counts
GROWTH = 0.02  # of the time since the jump, bins for the settling time
CLEAR = 4.5  # standard errors that an overshoot stands out by, else there is none
TOP = 0.7  # of the overshoot, above which a curve is laid through its top
ORDER = 4  # of that curve in the logarithm of time
ENOUGH = 8  # bins, for such a curve and that of the settling
NEAR, FAR = 0.4, 2.0  # of the band, between which the last way into it counts for when it is entered


class Curve(NamedTuple):
    """A response averaged in bins, from its jump on."""

    time: Array  # s, the first one 0
    value: Array
    error: Array  # standard error of a bin from the noise of the readings
    noise: float  # standard deviation of one reading
    interval: float  # s, between samples
    quantum: float  # resolution of the readings
    steady_from: float  # s


def curve_of(trials: Sequence[Trial], growth: float = 0.0) -> Curve:
    """The response of trials together, in bins of a sample or of this part of the time since the jump."""
    time = np.concatenate([trial.time for trial in trials])
    values = np.concatenate([trial.response for trial in trials])
    interval = float(np.median([np.median(np.diff(trial.time)) for trial in trials]))
    edges = [0.5 * interval]
    while edges[-1] < time.max():
        edges.append(edges[-1] + max(interval, growth * edges[-1]))
    place = np.searchsorted(edges, time)
    counts = np.bincount(place, minlength=len(edges))
    filled = counts > 0
    means = [np.bincount(place, column, minlength=len(edges))[filled] / counts[filled] for column in (time, values)]
    noise = math.sqrt(np.mean([trial.noise**2 for trial in trials]))
    return Curve(
        time=np.concatenate([[0.0], means[0]]),
        value=np.concatenate([[0.0], means[1]]),
        error=np.concatenate([[0.0], noise / np.sqrt(counts[filled])]),
        noise=noise,
        interval=interval,
        quantum=max(trial.quantum for trial in trials),
        steady_from=max(trial.steady_from for trial in trials),
    )


def rise_time(trials: Sequence[Trial]) -> Reading:
    """From a tenth to nine tenths of the steady value [s]."""
    curve = curve_of(trials)
    half = int(np.argmax(curve.value >= 0.5))
    low = int(np.flatnonzero(curve.value[:half] < LOW)[-1]) + 1
    high = half + int(np.argmax(curve.value[half:] >= HIGH))
    crossings = [crossing(curve, index, level) for index, level in ((low, LOW), (high, HIGH))]
    doubt = math.hypot(*(_between(curve, index) for index in (low, high)))
    return Reading(crossings[1] - crossings[0], shared=doubt)


def overshoot(trials: Sequence[Trial]) -> Reading:
    """Highest point above the steady value [%]; zero where it does not stand out of noise and rounding."""
    curve = curve_of(trials)
    above = curve.value - 1.0
    top = int(np.argmax(above))
    blurred = math.hypot(float(curve.error[top]), curve.quantum / math.sqrt(12.0))
    rounding = 100.0 * math.sqrt(2.0) * _rounding(curve)
    if above[top] < CLEAR * blurred:
        return Reading(0.0, own=max(rounding, 100.0 * max(float(above[top]), 0.0) / math.sqrt(3.0)))
    lower = above < TOP * above[top]
    begin = int(np.flatnonzero(lower[:top])[-1]) + 1
    end = top + int(np.argmax(lower[top:])) if lower[top:].any() else len(above)
    if end - begin < ENOUGH:  # too few for a curve: the highest, and what may lie between it and its neighbours
        beside = float(np.max(np.abs(np.diff(above[top - 1 : top + 2]))))
        return Reading(100.0 * float(above[top]), shared=100.0 * beside / 8.0, own=rounding)
    at = np.log(curve.time[begin:end])
    through = np.polynomial.Polynomial.fit(at, above[begin:end], ORDER)
    fine = np.linspace(at[0], at[-1], 500)
    return Reading(100.0 * float(through(fine).max()), own=rounding)


def settling_time(trials: Sequence[Trial]) -> Reading:
    """From the jump until the response stays within `BAND` of its steady value [s]; NaN where noise leaves it open."""
    curve = curve_of(trials, GROWTH)
    calm = curve._replace(value=_calmed(curve))
    last = int(max(np.flatnonzero(np.abs(calm.value - 1.0) > BAND), default=len(calm.time)))
    if last + 1 >= len(calm.time) or calm.time[last] >= calm.steady_from:
        return Reading(NAN)
    side = math.copysign(1.0, calm.value[last] - 1.0)
    slope = abs(float(calm.value[last + 1] - calm.value[last]) / float(calm.time[last + 1] - calm.time[last]))
    # a clock and its drive agree to a sample on when the jump was
    shared = curve.interval / math.sqrt(12.0)
    return Reading(_way_in(curve, calm, last, side), shared=shared, own=_rounding(curve) / slope)


def _calmed(curve: Curve) -> Array:
    """The response averaged over neighbouring bins until noise is an eighth of the band; untouched where it is."""
    half = math.ceil(0.5 * ((8.0 * float(np.max(curve.error)) / BAND) ** 2 - 1.0))
    if half <= 0:
        return curve.value
    total = np.concatenate([[0.0], np.cumsum(curve.value)])
    place = np.arange(len(curve.value))
    begin, end = np.maximum(place - half, 0), np.minimum(place + half + 1, len(place))
    return np.asarray((total[end] - total[begin]) / (end - begin), np.float64)


def _way_in(curve: Curve, calm: Curve, last: int, side: float) -> float:
    """Where the response enters the band for good: by a parabola through its last way in, if that has bins enough."""
    distance = side * (calm.value - 1.0) / BAND
    inside = np.flatnonzero(distance < NEAR)
    begin = int(max(inside[inside < last], default=-1)) + 1
    end = int(inside[inside > last][0])
    begin += int(np.argmax(distance[begin:end]))
    begin += int(np.count_nonzero(distance[begin:end] > FAR))
    straight = crossing(calm, last + 1, 1.0 + side * BAND)
    if end - begin < ENOUGH:
        return straight
    time, values = curve.time[begin:end], side * (curve.value[begin:end] - 1.0) / BAND - 1.0
    through = np.polynomial.Polynomial.fit(time, values, 2, w=1.0 / np.maximum(curve.error[begin:end], 1e-9))
    roots = [float(root.real) for root in through.roots() if not root.imag and time[0] <= root.real <= time[-1]]
    return min(roots, key=lambda root: abs(root - straight), default=straight)


def crossing(curve: Curve, index: int, level: float) -> float:
    """Where the response passes a level between the bin before this one and this one."""
    before, after = float(curve.value[index - 1]), float(curve.value[index])
    share = (level - before) / (after - before)
    return float(curve.time[index - 1] + share * (curve.time[index] - curve.time[index - 1]))


def _between(curve: Curve, index: int) -> float:
    """Standard uncertainty of a crossing between two samples: how far a curve that bends as here is off its chord."""
    around = np.concatenate([[0.0], curve.value])[index - 1 : index + 3]
    bend = math.sqrt(math.prod(np.abs(np.diff(around, 2)).tolist()))
    rise = abs(float(curve.value[index] - curve.value[index - 1]))
    width = float(curve.time[index] - curve.time[index - 1])
    return width * min(0.5, bend / 8.0 / rise) / math.sqrt(3.0)


def _rounding(curve: Curve) -> float:
    """Standard uncertainty of a reading from its resolution, where noise does not average it out."""
    return 0.0 if curve.noise > 0.5 * curve.quantum else curve.quantum / math.sqrt(12.0)
