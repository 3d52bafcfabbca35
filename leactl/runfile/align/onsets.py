"""Ties of two clocks by events: one channel jumps, and from then on another begins to change.

A current is switched on, and a winding grows warm: they do not measure the same, and still have a moment in common.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from leactl.errors import InputError
from leactl.runfile.align.alignment import Array, Tie, autocorrelated

FEWEST_AROUND = 8  # samples on either side of an onset
ONSET_SIGNIFICANCE = 5.0  # standard deviations that the slope behind an onset must be away from zero

MOST_APART = 10.0  # standard deviations: ties that differ by more are of events that do not belong together
GAINED = 1e-3  # of the time between two ties, far above what any clock gains


def jumps(time: Array, values: Array, least: float) -> list[Tie]:
    """Where a channel jumps by at least so much from one sample to the next; `own` and `run` are one clock here."""
    good = np.isfinite(values)
    time, values = time[good], values[good]
    far = np.flatnonzero(np.abs(np.diff(values)) >= least)
    # a jump that takes two samples is one jump
    first = far[np.diff(far, prepend=-10) > 1]
    return [
        Tie(0.5 * (time[k] + time[k + 1]), 0.5 * (time[k] + time[k + 1]), (time[k + 1] - time[k]) / math.sqrt(12.0))
        for k in first
    ]


def onset(
    time: Array, values: Array, near: float, within: float, fit_s: float, rising: float
) -> tuple[float, float] | None:
    """Where a channel leaves a straight line for another curve, and the standard deviation of that; None where nowhere.

    Before the onset a line, behind it a parabola from where the line ends: what a body shows that a constant heat
    begins or ceases to flow into. Least squares over the onset on a grid, then by Gauss and Newton.

    Parameters
    ----------
    near, within : s on the channel's clock, where the onset is sought.
    fit_s : how much of the channel counts before and after.
    rising : above zero for the strongest bend upwards, below zero for the strongest downwards.
    """
    good = np.isfinite(values) & (time > near - within - fit_s) & (time < near + within + fit_s)
    time, values = time[good], values[good]
    if len(time) < 2 * FEWEST_AROUND + 4:
        return None
    interval = float(np.median(np.diff(time)))
    best: tuple[float, float] | None = None
    for at in np.arange(near - within, near + within, max(interval, within / 400.0)):
        found = hinge(time, values, float(at), fit_s)
        strength = math.copysign(1.0, rising) * found[1] if found is not None else 0.0
        if strength >= ONSET_SIGNIFICANCE and (best is None or strength > best[0]):
            best = strength, float(at)
    if best is None:
        return None
    at = best[1]
    for _ in range(20):
        found = hinge(time, values, at, fit_s)
        if found is None:
            return None
        at, moved = at + found[2], found[2]
        if abs(moved) < 1e-3 * interval:
            break
    return (at, found[3]) if found is not None and abs(at - near) <= within + fit_s else None


def hinge(time: Array, values: Array, at: float, fit_s: float) -> tuple[float, float, float, float] | None:
    """A line and, behind `at`, a parabola on top of it.

    Returns
    -------
    Slope behind the onset, its distance from zero in standard deviations, by how much the onset is off `at` [s], and
    the standard deviation of that [s]; None where there are too few samples.
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
    variance = autocorrelated(residual - whole @ change, least=1.0) / (len(u) - whole.shape[1])
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
    """Ties of a channel that begins to change where the reference jumps.

    A current warms what is measured, or cools it, whenever it is switched on, and the other way where it is switched
    off: of both senses, where the onsets lie as far apart as the jumps, the one that ties more of them and finds
    sharper ones.

    Raises
    ------
    InputError : the onsets do not lie as far apart as the jumps.
    """
    senses = [_paired(time, values, base, reference, least, near, within, fit_s, sense) for sense in (1.0, -1.0)]
    sound = [ties for ties in senses if ties and _apart(ties) <= MOST_APART]
    ties = min(sound or senses, key=lambda ties: (-len(ties), sum(tie.sd for tie in ties)))
    if ties and not sound:
        offsets = ", ".join(f"{tie.run - tie.own:.1f}" for tie in ties)
        raise InputError(
            f"onsets do not lie as far apart as the jumps do: offsets of {offsets} s; near_s and a lower within_s tell"
            " which belong together"
        )
    return ties


def _paired(
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
    """The strongest onset near each jump, upwards (`sense` above zero) where the reference grows in size."""
    ties = []
    good = np.isfinite(reference)
    size, stamps = np.abs(reference[good]), base[good]
    for jump in jumps(base, reference, least):
        behind = int(np.searchsorted(stamps, jump.run))
        grows = float(size[behind] - size[behind - 1])
        found = onset(time, values, jump.run - near, within, fit_s, sense * grows)
        if found is not None:
            ties.append(Tie(found[0], jump.run, math.hypot(jump.sd, found[1])))
    return ties


def _apart(ties: Sequence[Tie]) -> float:
    """How far two ties disagree at the most, in their standard deviations and what a clock may gain meanwhile."""
    disagreements = (
        abs((one.run - one.own) - (other.run - other.own))
        / (math.hypot(one.sd, other.sd) + GAINED * abs(one.run - other.run))
        for one, other in itertools.combinations(ties, 2)
    )
    return max(disagreements, default=0.0)
