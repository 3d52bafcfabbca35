"""The picture of an effect: what equations leave over on held-out runs, over the variable that the effect acts in.

Before: everything else fitted without the effect. After: with it. Both are fitted on the fitted runs alone; what
belongs to a held-out run by itself, such as where its lock stands, is fitted there in both. Where what is fitted
without the effect stands in for it, as a filter for a lag, what is left follows nothing of it: before is then the
effect alone taken out of what is fitted with it, which is the partial residual of regression.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.gap.binned_means import (
    ACTS,
    FOLLOWED,
    Along,
    best_sign,
    bin_count,
    bin_edges,
    bin_of,
    first_that_follows,
    means,
    periods_of,
    repeats,
    turned,
)
from leactl.gap.diagnosis import Cause, Picture, ResidualBin
from leactl.gap.replay.compared import Compared
from leactl.gap.search.confirm import transferred
from leactl.gap.search.evidence import Evidence
from leactl.gap.search.regression import Candidate, Fit, Rows, residuals
from leactl.gap.signals.effect_variables import OF_SIGNALS
from leactl.gap.signals.record import Record
from leactl.gap.verdict.where import variable_of
from leactl.quantities import UNITS
from leactl.vocabulary.effect import effect_definition
from leactl.vocabulary.variable import VARIABLES, Variable

Array = npt.NDArray[np.float64]
Groups = npt.NDArray[np.intp]
LEAST_EDGES = 3  # of two bins: one says nothing of a variable
FEWEST_OFF, CLOSED = 2, 0.4  # bins off zero before, and share of their means left after, of an effect that shows
STILL = 1e-3  # of the largest value, below which a variable has no sign


SIGNS: tuple[Variable, ...] = ("velocity", "q_axis_current", "torque_rate")
"""Variables along whose sign a residual may be counted: what turns round with them would cancel in a bin."""
EPSILON = float(np.finfo(np.float64).eps)
SQUARED = 1e-150  # whose square is a number still


class ResidualChannel(NamedTuple):
    """What a residual is of."""

    quantity: str
    role: str
    mechanical: str
    equation: str  # or `replay`, where measured is compared with simulated
    units: str


def channel_of(rows: Rows) -> ResidualChannel:
    """The channel of an equation's rows."""
    return ResidualChannel(rows.quantity, rows.role, rows.mechanical, rows.equation, rows.units)


@dataclass(frozen=True, eq=False)
class Part:
    """A channel in one set-up on all held-out runs, where the effect acts."""

    channel: ResidualChannel
    before: Array
    after: Array
    effect: Array  # what the effect explains, row by row
    groups: Groups  # the stretch of a run that each row lies in
    values: dict[Variable, Array]
    independent: float  # how many rows carry information of their own
    gain: float  # weighted squares that the effect takes away


@dataclass(frozen=True, eq=False)
class View:
    """A part over one variable."""

    part: Part
    variable: Variable
    periods: float | None  # as `Picture` has them
    edges: Array
    place: Groups
    along: Along


def pictured(
    causes: Sequence[Cause],
    evidence: Evidence,
    hypothesis: Sequence[Candidate],
    alternatives: Sequence[Candidate],
    held_out: Sequence[Record],
) -> tuple[Cause, ...]:
    """Causes, each of them that is fitted with its picture, and each that cannot be told from such a one.

    Parameters
    ----------
    evidence : of the fitted runs.
    hypothesis : forms of the effects that stand in the augmented model.
    alternatives : forms of effects that may be named in the place of one of these.
    """
    sets = {cause.effect: in_place(cause, hypothesis, alternatives) for cause in causes}
    wanted = list(dict.fromkeys(candidate for several in sets.values() for candidate in several))
    if not wanted or not held_out:
        return tuple(causes)
    others = evidence.on(held_out, wanted)
    if not others.stack.rows:
        return tuple(causes)
    others.settle(hypothesis)
    normal, answered = others.normal(), []
    for cause in causes:
        drawn = None
        if several := sets[cause.effect]:
            rest = [candidate for candidate in several if candidate[0] != cause.effect]
            [form] = [candidate for candidate in several if candidate[0] == cause.effect]
            before, after = (transferred(normal, evidence, evidence.settle(tried)) for tried in (rest, several))
            parts = parts_of(others, form, before, after)
            if (drawn := picture(cause, parts)) is not None:
                drawn = replace(drawn, refitted=True)
                if not shows(drawn):
                    alone = picture(cause, [replace(part, before=part.after + part.effect) for part in parts])
                    drawn = replace(alone, refitted=False) if alone is not None and shows(alone) else drawn
        answered.append(replace(cause, picture=drawn))
    return tuple(answered)


def shows(drawn: Picture) -> bool:
    """Whether the means follow the variable before, and far less after."""
    return drawn.off_zero_before >= FEWEST_OFF and drawn.after_rms < CLOSED * drawn.before_rms


def pictured_by_replays(
    causes: Sequence[Cause], standing: Sequence[Cause], records: Sequence[Record], channels: Sequence[Compared]
) -> tuple[Cause, ...]:
    """Causes, each that stands in the augmented model and touches no equation with a picture of what replays miss.

    Before: the calibrated model without any effect. After: the augmented one.
    """
    names = {cause.effect for cause in standing}
    if all(cause.picture is not None for cause in causes if cause.effect in names):
        return tuple(causes)
    by_name = {record.name: record for record in records}
    grouped: dict[tuple[str, str, str], list[tuple[Record, Compared]]] = {}
    for one in channels:
        grouped.setdefault((one.quantity, one.role, one.mechanical), []).append((by_name[one.run], one))
    parts = [replayed_part(group) for group in grouped.values()]
    return tuple(
        replace(cause, picture=picture(cause, parts)) if cause.effect in names and cause.picture is None else cause
        for cause in causes
    )


def replayed_part(group: Sequence[tuple[Record, Compared]]) -> Part:
    """What replays of one channel miss on several runs, weighted by its noise."""
    first = group[0][1]
    before, after = (np.concatenate([one.measured - one.replayed[k] for _, one in group]) for k in (1, 2))
    groups = np.concatenate([one.block + (run << 32) for run, (_, one) in enumerate(group)])
    values: dict[Variable, Array] = {}
    for name in OF_SIGNALS:
        series = [variable_of(record, one, name) for record, one in group if VARIABLES[name].quantity == name]
        known = [one for one in series if one is not None]
        if len(known) == len(group):
            # a sign that is taken in between samples is neither
            whole = np.concatenate(known)
            values[name] = np.asarray(np.round(whole) if name == "direction" else whole, np.float64)
    # a channel without noise, as of a log that was computed, is known to as many digits as its numbers have
    digits = EPSILON * float(np.max(np.abs(np.concatenate([one.measured for _, one in group]))))
    noise = max(float(np.sqrt(np.mean([one.noise**2 for _, one in group]))), digits, SQUARED)
    gain = float(np.sum(before**2 - after**2)) / noise**2
    channel = ResidualChannel(first.quantity, first.role, first.mechanical, "replay", UNITS[first.quantity])
    return Part(channel, before, after, before - after, groups, values, float(len(np.unique(groups))), gain)


def in_place(cause: Cause, hypothesis: Sequence[Candidate], alternatives: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """The set that a cause is drawn in: its own, or that in which it stands for one that it cannot be told from."""
    if any(candidate[0] == cause.effect for candidate in hypothesis):
        return tuple(hypothesis)
    form = next((candidate for candidate in alternatives if candidate[0] == cause.effect), None)
    stood_for = next((c for c in hypothesis if c[0] in cause.indistinguishable_from), None)
    if form is None or stood_for is None:
        return ()
    return (*(candidate for candidate in hypothesis if candidate != stood_for), form)


def parts_of(others: Evidence, candidate: Candidate, before: Fit, after: Fit) -> list[Part]:
    """Every equation and set-up that an effect touches, on the runs that were not fitted."""
    touched: dict[tuple[str, str], list[int]] = {}
    for index, rows in enumerate(others.stack.rows):
        if any(belongs(name, candidate) for name in rows.columns):
            touched.setdefault((rows.equation, rows.mechanical), []).append(index)
    return [part_of(others, candidate, indices, before, after) for indices in touched.values()]


def part_of(others: Evidence, candidate: Candidate, indices: Sequence[int], before: Fit, after: Fit) -> Part:
    """One equation in one set-up, of several runs."""
    stacked, several = others.stack, [others.stack.rows[index] for index in indices]
    known = dict(zip((stacked.names[k] for k in after.columns), after.values.tolist(), strict=True))
    left = [np.concatenate([residuals(stacked, fit, index) for index in indices]) for fit in (before, after)]
    effect = np.concatenate(
        [np.sum([known[n] * c for n, c in rows.columns.items() if belongs(n, candidate)], axis=0) for rows in several]
    )
    weight = np.concatenate([np.full(len(others.stack.rows[k].left_over), others.weights[k]) for k in indices])
    blocks = np.concatenate([rows.block for rows in several])
    runs = np.repeat(np.arange(len(several)), [len(rows.block) for rows in several])
    _, groups = np.unique(np.stack([runs, blocks]), axis=1, return_inverse=True)
    acts = where_it_acts(effect, groups)
    values: dict[Variable, Array] = {}
    for variable, of_signals in OF_SIGNALS.items():
        series = [of_signals(rows.signals) for rows in several]
        if all(one is not None for one in series):
            pairs = zip(series, several, strict=True)
            values[variable] = np.concatenate([one[rows.index] for one, rows in pairs if one is not None])[acts]
    gain = float(np.sum(weight * (left[0] ** 2 - left[1] ** 2)))
    independent = int(acts.sum()) / float(np.mean([rows.dependence for rows in several]))
    return Part(
        channel_of(several[0]), left[0][acts], left[1][acts], effect[acts], groups[acts], values, independent, gain
    )


def belongs(name: Sequence[str], candidate: Candidate) -> bool:
    """Whether a column is one of a form of an effect."""
    return name[0] == "effect" and (name[1], name[2]) == (candidate[0], repr(candidate[1]))


def where_it_acts(effect: Array, groups: Groups) -> npt.NDArray[np.bool_]:
    """Rows of the stretches that hold nearly all of what an effect explains: elsewhere nothing of it is to be seen."""
    power = np.bincount(groups, weights=effect**2)
    order = np.argsort(-power, kind="stable")
    needed = int(np.searchsorted(np.cumsum(power[order]), ACTS * float(power.sum()))) + 1
    kept = np.zeros(len(power), np.bool_)
    kept[order[:needed]] = True
    return kept[groups]


def picture(cause: Cause, parts: Sequence[Part]) -> Picture | None:
    """Of the equations in which the effect's own part follows a variable of its, the one that gains most."""
    periods = periods_of(cause)
    views = [view for part in parts if (view := view_of(part, effect_definition(cause.effect).acts_over, periods))]
    if not views:
        return None
    following = [view for view in views if view.along.explained >= FOLLOWED]
    return picture_of(max(following or views, key=lambda view: view.part.gain * view.along.explained))


def picture_of(best: View) -> Picture:
    """Means in bins with intervals, before and after."""
    part, bins = best.part, len(best.edges) - 1
    sign = signs(part).get(best.along.name, np.ones_like(part.before))
    before, after = (means(sign * left, best.place, part.groups, bins) for left in (part.before, part.after))
    counts = np.bincount(best.place[best.place >= 0], minlength=bins)
    columns = zip(
        best.edges[:-1].tolist(),
        best.edges[1:].tolist(),
        counts.tolist(),
        *(row.tolist() for own in (before, after) for row in (own.mean, own.low, own.high)),
        strict=True,
    )
    return Picture(
        best.variable,
        VARIABLES[best.variable].units,
        best.periods,
        best.along.name or None,
        *part.channel,
        before.rms(counts),
        after.rms(counts),
        before.off_zero,
        after.off_zero,
        tuple(ResidualBin(*row) for row in columns),
    )


def view_of(part: Part, variables: Sequence[Variable], periods: float) -> View | None:
    """A part over that of an effect's variables which it follows."""
    views = []
    for variable in variables:
        if variable not in part.values:
            continue
        values, folds = part.values[variable], None
        if variable == "angle" and repeats(values, periods, lambda angle: bins_over(part, angle)[2].explained):
            values, folds = turned(values, periods), periods
        edges, place, along = bins_over(part, values)
        if len(edges) >= LEAST_EDGES:
            views.append(View(part, variable, folds, edges, place, along))
    return first_that_follows(views, lambda view: view.along.explained)


def bins_over(part: Part, values: Array) -> tuple[Array, Groups, Along]:
    """Edges of a part's bins over a variable, the bin of each row, and the sign along which its effect follows them."""
    edges = bin_edges(values, part.effect, bin_count(part.independent))
    place = bin_of(values, edges)
    return edges, place, best_sign(part.effect, place, signs(part))


def signs(part: Part) -> dict[str, Array]:
    """Signs of variables that a part has, zero where these stand still."""
    by_variable: dict[str, Array] = {}
    for name in SIGNS:
        if name in part.values:
            values = part.values[name]
            moving = np.abs(values) > STILL * np.max(np.abs(values), initial=0.0)
            by_variable[name] = np.where(moving, np.sign(values), 0.0)
    return by_variable
