"""The mean response of several trials, and where it passes a level.

A drive may act anywhere within the sample in which its reference jumps. A response of few samples is not known between
the samples, so that each crossing of a level has a limit of its error.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from leactl.analysis.responses.step_trials import StepTrial
from leactl.analysis.statistics.regression import Array

RISE_START, RISE_END = 0.1, 0.9  # of the steady value: levels that begin and end the rise time
MOST_BEND = 0.5  # second difference over the rise between two bins; with more, no cubic is fitted to them
MOST_INTERVAL_DEVIATION = 0.01  # of the median interval; an interval that differs by more is uneven


class MeanStepResponse(NamedTuple):
    """A step response averaged in bins, from its jump on; values, noise and resolution are shares of the step."""

    time: Array  # s, of the bins; the first is 0
    value: Array  # means of the bins; the first is 0
    error: Array  # standard error of each bin by the noise of the readings
    noise: float  # standard deviation of one reading
    interval: float  # s, between samples
    quantum: float  # resolution of the readings
    steady_from: float  # s, at which the steady part begins


def mean_step_response(trials: Sequence[StepTrial], growth: float = 0.0) -> MeanStepResponse:
    """Return the mean response in bins of one sample, or of `growth` times the time since the jump if longer."""
    time = np.concatenate([trial.time for trial in trials])
    values = np.concatenate([trial.response for trial in trials])
    interval = float(np.median([np.median(np.diff(trial.time)) for trial in trials]))
    edges = [0.5 * interval]
    while edges[-1] < time.max():
        edges.append(edges[-1] + max(interval, growth * edges[-1]))
    bins = np.searchsorted(edges, time)
    counts = np.bincount(bins, minlength=len(edges))
    has_samples = counts > 0
    bin_means = [
        np.bincount(bins, column, minlength=len(edges))[has_samples] / counts[has_samples] for column in (time, values)
    ]
    noise = math.sqrt(np.mean([trial.noise**2 for trial in trials]))
    return MeanStepResponse(
        time=np.concatenate([[0.0], bin_means[0]]),
        value=np.concatenate([[0.0], bin_means[1]]),
        error=np.concatenate([[0.0], noise / np.sqrt(counts[has_samples])]),
        noise=noise,
        interval=interval,
        quantum=max(trial.quantum for trial in trials),
        steady_from=max(trial.steady_from for trial in trials),
    )


class LevelCrossing(NamedTuple):
    """The time at which a response passes a level, and its largest error."""

    time: float  # s
    limit: float  # s, largest error of `time`


def straight_crossing(curve: MeanStepResponse, index: int, level: float) -> float:
    """Return the time [s] at which the straight line from bin `index - 1` to bin `index` passes a level."""
    before, after = float(curve.value[index - 1]), float(curve.value[index])
    share = (level - before) / (after - before)
    return float(curve.time[index - 1] + share * (curve.time[index] - curve.time[index - 1]))


def crossing_with_limit(curve: MeanStepResponse, index: int, level: float) -> LevelCrossing:
    """Return when the response passes a level between bins `index - 1` and `index`.

    The crossing is that of a cubic through the neighbouring bins if these lie smoothly enough, else that of an
    exponential through three samples, else that of the straight line. The limit of a cubic or an exponential follows
    from its distance to the straight line; that of the straight line is the distance to the bin to whose side the
    response bends.
    """
    straight = straight_crossing(curve, index, level)
    neighbour_bins = slice(index - 1, index + 3)
    time = np.concatenate([[-curve.interval], curve.time])[neighbour_bins]
    values = np.concatenate([[0.0], curve.value])[neighbour_bins]
    rise, bends = float(values[2] - values[1]), np.diff(values, 2)
    relative_bend = float(np.max(np.abs(bends))) / rise
    if len(bends) == 2 and relative_bend < MOST_BEND:
        polynomial = np.polynomial.Polynomial.fit(time, values - level, 3)
        roots = [float(root.real) for root in polynomial.roots() if not root.imag and time[1] <= root.real <= time[2]]
        crossing = min(roots, key=lambda root: abs(root - straight), default=straight)
        return LevelCrossing(crossing, relative_bend * abs(crossing - straight))
    if (exponential := _exponential_crossing(curve, index, level)) is not None:
        return LevelCrossing(exponential, abs(exponential - straight))
    early_error = straight - float(time[1]) if np.min(bends) < 0.0 else 0.0
    late_error = float(time[2]) - straight if np.max(bends) > 0.0 else 0.0
    return LevelCrossing(straight, max(early_error, late_error))


def _exponential_crossing(curve: MeanStepResponse, index: int, level: float) -> float | None:
    """Return when a response of few samples passes a level [s], by the exponential through three samples.

    None if there are no three evenly spaced samples that begin below `RISE_END`, or the response does not slow down.
    """
    first = index - 1 if curve.value[index - 1] > RISE_START else index
    time, values = curve.time[first : first + 3], curve.value[first : first + 3]
    if (
        len(values) < 3
        or values[0] >= RISE_END
        or not np.allclose(np.diff(time), curve.interval, rtol=MOST_INTERVAL_DEVIATION)
    ):
        return None
    increments = np.diff(values)
    if not 0.0 < increments[1] < increments[0]:
        return None
    ratio = float(increments[1] / increments[0])
    remaining_rise = float(increments[0]) / (1.0 - ratio)
    samples = math.log(1.0 - (level - float(values[0])) / remaining_rise) / math.log(ratio)
    return float(np.clip(time[0] + samples * curve.interval, curve.time[index - 1], curve.time[index]))
