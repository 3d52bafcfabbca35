"""Compute ties of two clocks from events at which one channel jumps and another channel begins to change.

Example: a current is switched on and a winding begins to warm. The two channels measure different quantities, so that
they do not correlate, but both show the moment of the switch.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from leactl.errors import InputError
from leactl.runfile.align.alignment import Array, Tie, autocorrelated_variance

FEWEST_AROUND = 8  # samples on either side of an onset
ONSET_SIGNIFICANCE = 5.0  # least distance of the slope after an onset from zero, in standard deviations

LARGEST_DISAGREEMENT = 10.0  # standard deviations; ties that differ by more are of different events
LARGEST_CLOCK_RATE = 1e-3  # largest drift, relative to the time between two ties; far above that of any clock


def jumps(time: Array, values: Array, least: float) -> list[Tie]:
    """Find the moments at which a channel jumps by `least` or more between two samples, as ties with equal times."""
    finite = np.isfinite(values)
    time, values = time[finite], values[finite]
    steps = np.flatnonzero(np.abs(np.diff(values)) >= least)
    # a jump that takes two samples is one jump
    first_steps = steps[np.diff(steps, prepend=-10) > 1]
    return [
        Tie(
            0.5 * (time[index] + time[index + 1]),
            0.5 * (time[index] + time[index + 1]),
            (time[index + 1] - time[index]) / math.sqrt(12.0),
        )
        for index in first_steps
    ]


def fit_onset(
    time: Array, values: Array, near: float, within: float, fit_s: float, rising: float
) -> tuple[float, float] | None:
    """Find the time at which a channel leaves a straight line, and its standard deviation [s]; None if there is none.

    A line is fitted before the onset, and after it a cubic that starts from the line: the temperature of a body into
    which a constant heat begins or ceases to flow. Least squares on a grid of onsets, refined by Gauss-Newton.

    Parameters
    ----------
    near, within : the onset is searched from near - within to near + within on the channel's clock [s].
    fit_s : length of the fitted part before and after the onset [s].
    rising : positive to seek the strongest upward bend, negative for the strongest downward one.
    """
    finite = np.isfinite(values) & (time > near - within - fit_s) & (time < near + within + fit_s)
    time, values = time[finite], values[finite]
    if len(time) < 2 * FEWEST_AROUND + 4:
        return None
    interval = float(np.median(np.diff(time)))
    best: tuple[float, float] | None = None
    for onset in np.arange(near - within, near + within, max(interval, within / 400.0)):
        fit = hinge(time, values, float(onset), fit_s)
        strength = math.copysign(1.0, rising) * fit[1] if fit is not None else 0.0
        if strength >= ONSET_SIGNIFICANCE and (best is None or strength > best[0]):
            best = strength, float(onset)
    if best is None:
        return None
    onset = best[1]
    for _ in range(20):
        fit = hinge(time, values, onset, fit_s)
        if fit is None:
            return None
        onset, step = onset + fit[2], fit[2]
        if abs(step) < 1e-3 * interval:
            break
    return (onset, fit[3]) if fit is not None and abs(onset - near) <= within + fit_s else None


def hinge(time: Array, values: Array, at: float, fit_s: float) -> tuple[float, float, float, float] | None:
    """Fit a line and, after the time `at`, a cubic that starts from it.

    Returns
    -------
    Slope after the onset, its ratio to its standard deviation, the correction of `at` [s], and the standard deviation
    of the correction [s]; None if there are too few samples.
    """
    inside = (time >= at - fit_s) & (time <= at + fit_s)
    elapsed, channel_values = time[inside] - at, values[inside]
    elapsed_after = np.maximum(elapsed, 0.0)
    if (elapsed < 0).sum() < FEWEST_AROUND or (elapsed > 0).sum() < FEWEST_AROUND:
        return None
    design = np.stack([np.ones_like(elapsed), elapsed, elapsed_after, elapsed_after**2, elapsed_after**3], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(design, channel_values, rcond=None)
    if rank < design.shape[1]:
        return None
    residual = channel_values - design @ solution
    # derivative of the model by the time of the onset
    onset_column = np.where(
        elapsed > 0.0, -(solution[2] + 2.0 * solution[3] * elapsed + 3.0 * solution[4] * elapsed * elapsed), 0.0
    )
    full_design = np.column_stack([design, onset_column])
    try:
        inverse = np.linalg.inv(full_design.T @ full_design)
        design_inverse = np.linalg.inv(design.T @ design)
    except np.linalg.LinAlgError:
        return None
    correction = inverse @ full_design.T @ residual
    variance = autocorrelated_variance(residual - full_design @ correction, least=1.0) / (
        len(elapsed) - full_design.shape[1]
    )
    slope, step = float(solution[2]), float(correction[5])
    distance = slope / math.sqrt(max(variance * design_inverse[2, 2], 1e-300))
    return slope, distance, max(-0.5 * fit_s, min(0.5 * fit_s, step)), math.sqrt(max(variance * inverse[5, 5], 1e-18))


def ties_by_onset(
    time: Array,
    values: Array,
    base: Array,
    reference: Array,
    least: float,
    near: float,
    within: float,
    fit_s: float,
) -> list[Tie]:
    """Compute ties of a channel that begins to change when the reference jumps.

    It is not known whether a jump raises or lowers the channel, so that both senses are tried. A sense counts if the
    times between its onsets equal those between the jumps; if both do, the one with more and sharper ties is returned.

    Parameters
    ----------
    time, values : stamps on the device's clock [s] and values of the channel.
    base, reference : stamps on the run's clock [s] and values of the reference.
    least : smallest jump of the reference, in its unit.
    near, within : offsets of the clocks from near - within to near + within are searched [s].
    fit_s : length of the fitted part before and after an onset [s].

    Raises
    ------
    InputError : the times between the onsets differ from those between the jumps.
    """
    senses = [
        _onset_at_each_jump(time, values, base, reference, least, near, within, fit_s, sense) for sense in (1.0, -1.0)
    ]
    sound = [ties for ties in senses if ties and _largest_disagreement(ties) <= LARGEST_DISAGREEMENT]
    ties = min(sound or senses, key=lambda ties: (-len(ties), sum(tie.sd for tie in ties)))
    if ties and not sound:
        offsets = ", ".join(f"{tie.run_time - tie.device_time:.1f}" for tie in ties)
        raise InputError(
            f"onsets do not lie as far apart as the jumps do: offsets of {offsets} s; near_s and a lower within_s tell"
            " which belong together"
        )
    return ties


def _onset_at_each_jump(
    time: Array,
    values: Array,
    base: Array,
    reference: Array,
    least: float,
    near: float,
    within: float,
    fit_s: float,
    sense: float,
) -> list[Tie]:
    """Fit the strongest onset near each jump; `sense` is 1 if the channel rises when the reference grows, else -1."""
    ties = []
    finite = np.isfinite(reference)
    size, stamps = np.abs(reference[finite]), base[finite]
    for jump in jumps(base, reference, least):
        behind = int(np.searchsorted(stamps, jump.run_time))
        grows = float(size[behind] - size[behind - 1])
        fitted_onset = fit_onset(time, values, jump.run_time - near, within, fit_s, sense * grows)
        if fitted_onset is not None:
            ties.append(Tie(fitted_onset[0], jump.run_time, math.hypot(jump.sd, fitted_onset[1])))
    return ties


def _largest_disagreement(ties: Sequence[Tie]) -> float:
    """Return the largest difference of the offsets of two ties, over their standard deviation and largest drift."""
    ratios = (
        abs((first.run_time - first.device_time) - (second.run_time - second.device_time))
        / (math.hypot(first.sd, second.sd) + LARGEST_CLOCK_RATE * abs(first.run_time - second.run_time))
        for first, second in itertools.combinations(ties, 2)
    )
    return max(ratios, default=0.0)
