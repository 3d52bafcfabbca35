"""Ties of two clocks by events: one channel jumps, and at that moment another channel begins to change.

Example: a current is switched on and a winding begins to warm. The two channels measure different quantities, so that
their correlation tells nothing, but they share the moment of the switch.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from leactl.errors import InputError
from leactl.runfile.align.alignment import Array, Tie, autocorrelated_variance

FEWEST_AROUND = 8  # samples on either side of an onset
ONSET_SIGNIFICANCE = 5.0  # standard deviations that the slope behind an onset must be away from zero

LARGEST_DISAGREEMENT = 10.0  # standard deviations: ties that differ by more are of events that do not belong together
LARGEST_CLOCK_RATE = 1e-3  # of the time between two ties, far above what any clock gains


def jumps(time: Array, values: Array, least: float) -> list[Tie]:
    """Moments at which a channel jumps by `least` or more between two samples; both times of the tie are the same."""
    finite = np.isfinite(values)
    time, values = time[finite], values[finite]
    steps = np.flatnonzero(np.abs(np.diff(values)) >= least)
    # a jump that takes two samples is one jump
    first = steps[np.diff(steps, prepend=-10) > 1]
    return [
        Tie(0.5 * (time[k] + time[k + 1]), 0.5 * (time[k] + time[k + 1]), (time[k + 1] - time[k]) / math.sqrt(12.0))
        for k in first
    ]


def fit_onset(
    time: Array, values: Array, near: float, within: float, fit_s: float, rising: float
) -> tuple[float, float] | None:
    """Time at which a channel leaves a straight line, and its standard deviation [s]; None if there is no such time.

    Before the onset a line is fitted, behind it a cubic that starts from the line: the temperature of a body into
    which a constant heat begins or ceases to flow. Least squares on a grid of onsets, refined by Gauss-Newton.

    Parameters
    ----------
    near, within : the onset is sought from near - within to near + within on the channel's clock [s].
    fit_s : length of the fitted part before and after the onset [s].
    rising : positive to seek the strongest upward bend, negative for the strongest downward one.
    """
    finite = np.isfinite(values) & (time > near - within - fit_s) & (time < near + within + fit_s)
    time, values = time[finite], values[finite]
    if len(time) < 2 * FEWEST_AROUND + 4:
        return None
    interval = float(np.median(np.diff(time)))
    best: tuple[float, float] | None = None
    for at in np.arange(near - within, near + within, max(interval, within / 400.0)):
        fit = hinge(time, values, float(at), fit_s)
        strength = math.copysign(1.0, rising) * fit[1] if fit is not None else 0.0
        if strength >= ONSET_SIGNIFICANCE and (best is None or strength > best[0]):
            best = strength, float(at)
    if best is None:
        return None
    at = best[1]
    for _ in range(20):
        fit = hinge(time, values, at, fit_s)
        if fit is None:
            return None
        at, moved = at + fit[2], fit[2]
        if abs(moved) < 1e-3 * interval:
            break
    return (at, fit[3]) if fit is not None and abs(at - near) <= within + fit_s else None


def hinge(time: Array, values: Array, at: float, fit_s: float) -> tuple[float, float, float, float] | None:
    """Fit a line and, after the time `at`, a cubic that starts from it.

    Returns
    -------
    Slope after the onset, its ratio to its standard deviation, the correction of `at` [s], and the standard deviation
    of the correction [s]; None if there are too few samples.
    """
    inside = (time >= at - fit_s) & (time <= at + fit_s)
    u, y = time[inside] - at, values[inside]
    behind = np.maximum(u, 0.0)
    if (u < 0).sum() < FEWEST_AROUND or (u > 0).sum() < FEWEST_AROUND:
        return None
    design = np.stack([np.ones_like(u), u, behind, behind**2, behind**3], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(design, y, rcond=None)
    if rank < design.shape[1]:
        return None
    residual = y - design @ solution
    # the onset's own column: d(model)/d(at)
    moved = np.where(u > 0.0, -(solution[2] + 2.0 * solution[3] * u + 3.0 * solution[4] * u * u), 0.0)
    whole = np.column_stack([design, moved])
    try:
        inverse = np.linalg.inv(whole.T @ whole)
        bread = np.linalg.inv(design.T @ design)
    except np.linalg.LinAlgError:
        return None
    change = inverse @ whole.T @ residual
    variance = autocorrelated_variance(residual - whole @ change, least=1.0) / (len(u) - whole.shape[1])
    slope, step = float(solution[2]), float(change[5])
    distance = slope / math.sqrt(max(variance * bread[2, 2], 1e-300))
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
    """Ties of a channel that begins to change when the reference jumps.

    Whether a current that is switched on raises or lowers the channel is not known, so both senses are tried. A sense
    counts if its onsets lie as far apart as the jumps; of two that do, the one with more and sharper ties is taken.

    Raises
    ------
    InputError : the onsets do not lie as far apart as the jumps.
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
    """Largest disagreement of any two ties, relative to their standard deviations and the largest clock drift."""
    disagreements = (
        abs((first.run_time - first.device_time) - (second.run_time - second.device_time))
        / (math.hypot(first.sd, second.sd) + LARGEST_CLOCK_RATE * abs(first.run_time - second.run_time))
        for first, second in itertools.combinations(ties, 2)
    )
    return max(disagreements, default=0.0)
