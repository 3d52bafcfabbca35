"""Pictures of effects: residuals of equations on held-out runs, binned over the variable that the effect acts in.

`before` is the residual of a fit without the effect, `after` that of a fit with it. Both are fitted on the fitted runs
alone, except for nuisances of a held-out run itself, such as the position of its lock. Where other parameters absorb
the effect in the fit without it, as a filter does a lag, `before` is the partial residual of regression: the residual
of the fit with the effect, plus the effect.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.gap.binned_means import (
    DRAWN_POWER_SHARE,
    LEAST_FOLLOWED_SHARE,
    FollowedSign,
    best_sign,
    bin_count,
    bin_edges,
    bin_of,
    first_that_follows,
    fold_angle,
    means,
    periods_of,
    repeats,
)
from leactl.gap.diagnosis import Cause, Picture, ResidualBin
from leactl.gap.replay.comparison import Compared
from leactl.gap.search.confirm import transferred_fit
from leactl.gap.search.effect_regression import Evidence
from leactl.gap.search.regression import Candidate, Fit, Rows, residuals
from leactl.gap.signals.effect_variables import VARIABLE_FUNCTIONS
from leactl.gap.signals.record import Record
from leactl.gap.verdict.where import variable_of
from leactl.quantities import UNITS
from leactl.vocabulary.effect import effect_definition
from leactl.vocabulary.variable import VARIABLES, Variable

Array = npt.NDArray[np.float64]
Groups = npt.NDArray[np.intp]
FEWEST_EDGES = 3  # bin edges, for two bins: one bin shows no dependence on a variable
FEWEST_BINS_OFF = 2  # bins whose interval lies off zero without an effect, if the effect is visible
MOST_MEANS_LEFT = 0.4  # share of the root mean square of the bin means that may remain with a visible effect
MOST_STILL_VALUE = 1e-3  # share of a variable's largest value up to which it has no sign
SIGN_VARIABLES: tuple[Variable, ...] = ("velocity", "q_axis_current", "torque_rate")
"""Variables whose sign a residual may be multiplied by: a residual that reverses with them would cancel in a bin."""
EPSILON = float(np.finfo(np.float64).eps)  # relative precision of a channel's numbers
LEAST_SQUARABLE = 1e-150  # about the smallest number whose square does not underflow


class ResidualChannel(NamedTuple):
    """Channel, set-up and equation of a residual."""

    quantity: str
    role: str
    mechanical: str
    equation: str  # or `replay`, where measured is compared with simulated
    units: str


def channel_of(rows: Rows) -> ResidualChannel:
    """Return the channel of an equation's rows."""
    return ResidualChannel(rows.quantity, rows.role, rows.mechanical, rows.equation, rows.units)


@dataclass(frozen=True, eq=False)
class ActingResiduals:
    """Residuals of one channel in one set-up on all held-out runs, where the effect acts."""

    channel: ResidualChannel
    before: Array  # residual of each row without the effect
    after: Array  # residual of each row with the effect
    effect: Array  # part of the residual that the effect explains, by row
    groups: Groups  # stretch of a run that each row lies in
    values: dict[Variable, Array]  # variables at each row
    independent_rows: float  # number of independent rows
    gain: float  # weighted squares that the effect explains


@dataclass(frozen=True, eq=False)
class View:
    """Residuals of one channel in bins over one variable."""

    acting: ActingResiduals
    variable: Variable
    periods: float | None  # parts of a turn that an angle is folded by; None where it is not folded
    edges: Array  # edges of the bins
    bin_of_row: Groups  # -1 for a row outside the bins
    along: FollowedSign  # sign that the residuals are multiplied by


def draw_pictures(
    causes: Sequence[Cause],
    evidence: Evidence,
    hypothesis: Sequence[Candidate],
    alternatives: Sequence[Candidate],
    held_out: Sequence[Record],
) -> tuple[Cause, ...]:
    """Return the causes, with a picture of each that is fitted or indistinguishable from a fitted one.

    Parameters
    ----------
    evidence : evidence of the fitted runs.
    hypothesis : forms of the effects in the augmented model.
    alternatives : forms of effects that may be named instead of a fitted one.
    held_out : held-out runs, whose residuals are drawn.
    """
    set_of_cause = {cause.effect: set_for_cause(cause, hypothesis, alternatives) for cause in causes}
    all_candidates = list(dict.fromkeys(candidate for candidates in set_of_cause.values() for candidate in candidates))
    if not all_candidates or not held_out:
        return tuple(causes)
    held_out_evidence = evidence.on(held_out, all_candidates)
    if not held_out_evidence.stack.rows:
        return tuple(causes)
    held_out_evidence.settle(hypothesis)
    normal, with_pictures = held_out_evidence.normal(), []
    for cause in causes:
        drawing = None
        if candidates := set_of_cause[cause.effect]:
            without_cause = [candidate for candidate in candidates if candidate[0] != cause.effect]
            [form] = [candidate for candidate in candidates if candidate[0] == cause.effect]
            before, after = (
                transferred_fit(normal, evidence, evidence.settle(set_to_fit))
                for set_to_fit in (without_cause, candidates)
            )
            acting_by_channel = residuals_by_channel(held_out_evidence, form, before, after)
            if (drawing := picture(cause, acting_by_channel)) is not None:
                drawing = replace(drawing, refitted=True)
                if not shows_effect(drawing):
                    partial_drawing = picture(
                        cause, [replace(acting, before=acting.after + acting.effect) for acting in acting_by_channel]
                    )
                    drawing = (
                        replace(partial_drawing, refitted=False)
                        if partial_drawing is not None and shows_effect(partial_drawing)
                        else drawing
                    )
        with_pictures.append(replace(cause, picture=drawing))
    return tuple(with_pictures)


def shows_effect(drawing: Picture) -> bool:
    """Return whether the bin means differ from zero before the effect is added, and far less after."""
    return drawing.off_zero_before >= FEWEST_BINS_OFF and drawing.after_rms < MOST_MEANS_LEFT * drawing.before_rms


def draw_pictures_of_replays(
    causes: Sequence[Cause], applied: Sequence[Cause], records: Sequence[Record], channels: Sequence[Compared]
) -> tuple[Cause, ...]:
    """Return the causes; those of the augmented model without a picture get one from the residuals of replays.

    `before` is the replay of the calibrated model without any effect, `after` that of the augmented model.
    """
    applied_effects = {cause.effect for cause in applied}
    if all(cause.picture is not None for cause in causes if cause.effect in applied_effects):
        return tuple(causes)
    by_name = {record.name: record for record in records}
    runs_by_channel: dict[tuple[str, str, str], list[tuple[Record, Compared]]] = {}
    for channel in channels:
        runs_by_channel.setdefault((channel.quantity, channel.role, channel.mechanical), []).append(
            (by_name[channel.run], channel)
        )
    residuals_by_replay = [
        replayed_residuals(records_and_channels) for records_and_channels in runs_by_channel.values()
    ]
    return tuple(
        replace(cause, picture=picture(cause, residuals_by_replay))
        if cause.effect in applied_effects and cause.picture is None
        else cause
        for cause in causes
    )


def replayed_residuals(records_and_channels: Sequence[tuple[Record, Compared]]) -> ActingResiduals:
    """Return the residuals of the replays of one channel on several runs, weighted by its noise."""
    _, first_channel = records_and_channels[0]
    before, after = (
        np.concatenate([compared.measured - compared.replayed[k] for _, compared in records_and_channels])
        for k in (1, 2)
    )
    groups = np.concatenate([compared.block + (run << 32) for run, (_, compared) in enumerate(records_and_channels)])
    values: dict[Variable, Array] = {}
    for name in VARIABLE_FUNCTIONS:
        series = [
            variable_of(record, compared, name)
            for record, compared in records_and_channels
            if VARIABLES[name].quantity == name
        ]
        measured_series = [column for column in series if column is not None]
        if len(measured_series) == len(records_and_channels):
            # interpolation between samples gives a direction values between -1 and 1
            joined = np.concatenate(measured_series)
            values[name] = np.asarray(np.round(joined) if name == "direction" else joined, np.float64)
    # a channel without noise, as in a computed log, is known to the precision of its numbers
    precision = EPSILON * float(
        np.max(np.abs(np.concatenate([compared.measured for _, compared in records_and_channels])))
    )
    noise = max(
        float(np.sqrt(np.mean([compared.noise**2 for _, compared in records_and_channels]))), precision, LEAST_SQUARABLE
    )
    gain = float(np.sum(before**2 - after**2)) / noise**2
    channel = ResidualChannel(
        first_channel.quantity, first_channel.role, first_channel.mechanical, "replay", UNITS[first_channel.quantity]
    )
    return ActingResiduals(channel, before, after, before - after, groups, values, float(len(np.unique(groups))), gain)


def set_for_cause(
    cause: Cause, hypothesis: Sequence[Candidate], alternatives: Sequence[Candidate]
) -> tuple[Candidate, ...]:
    """Return the set to fit for a cause: the hypothesis, where needed with an indistinguishable effect replaced.

    Empty where neither the hypothesis nor the alternatives contain the effect.
    """
    if any(candidate[0] == cause.effect for candidate in hypothesis):
        return tuple(hypothesis)
    form = next((candidate for candidate in alternatives if candidate[0] == cause.effect), None)
    replaced = next((candidate for candidate in hypothesis if candidate[0] in cause.indistinguishable_from), None)
    if form is None or replaced is None:
        return ()
    return (*(candidate for candidate in hypothesis if candidate != replaced), form)


def residuals_by_channel(evidence: Evidence, candidate: Candidate, before: Fit, after: Fit) -> list[ActingResiduals]:
    """Return the residuals of each equation and set-up that has a column of the effect.

    before, after : fits without and with the effect.
    """
    groups_by_channel: dict[tuple[str, str], list[int]] = {}
    for index, rows in enumerate(evidence.stack.rows):
        if any(is_column_of(name, candidate) for name in rows.columns):
            groups_by_channel.setdefault((rows.equation, rows.mechanical), []).append(index)
    return [residuals_of_channel(evidence, candidate, indices, before, after) for indices in groups_by_channel.values()]


def residuals_of_channel(
    evidence: Evidence, candidate: Candidate, indices: Sequence[int], before: Fit, after: Fit
) -> ActingResiduals:
    """Return the residuals of one equation in one set-up over several runs, in the rows where the effect acts.

    indices : groups of rows of that equation in `evidence`.
    """
    stacked, rows_of_runs = evidence.stack, [evidence.stack.rows[index] for index in indices]
    coefficients = dict(zip((stacked.names[k] for k in after.columns), after.values.tolist(), strict=True))
    residual_before, residual_after = (
        np.concatenate([residuals(stacked, fit, index) for index in indices]) for fit in (before, after)
    )
    effect = np.concatenate(
        [
            np.sum(
                [coefficients[name] * c for name, c in rows.columns.items() if is_column_of(name, candidate)], axis=0
            )
            for rows in rows_of_runs
        ]
    )
    weight = np.concatenate([np.full(len(evidence.stack.rows[k].left_over), evidence.weights[k]) for k in indices])
    blocks = np.concatenate([rows.block for rows in rows_of_runs])
    runs = np.repeat(np.arange(len(rows_of_runs)), [len(rows.block) for rows in rows_of_runs])
    _, groups = np.unique(np.stack([runs, blocks]), axis=1, return_inverse=True)
    acts = acting_rows(effect, groups)
    values: dict[Variable, Array] = {}
    for variable, of_signals in VARIABLE_FUNCTIONS.items():
        series = [of_signals(rows.signals) for rows in rows_of_runs]
        if all(signal is not None for signal in series):
            series_and_rows = zip(series, rows_of_runs, strict=True)
            values[variable] = np.concatenate(
                [signal[rows.index] for signal, rows in series_and_rows if signal is not None]
            )[acts]
    gain = float(np.sum(weight * (residual_before**2 - residual_after**2)))
    independent_rows = int(acts.sum()) / float(np.mean([rows.dependence for rows in rows_of_runs]))
    return ActingResiduals(
        channel_of(rows_of_runs[0]),
        residual_before[acts],
        residual_after[acts],
        effect[acts],
        groups[acts],
        values,
        independent_rows,
        gain,
    )


def is_column_of(name: Sequence[str], candidate: Candidate) -> bool:
    """Return whether a column belongs to one form of an effect."""
    return name[0] == "effect" and (name[1], name[2]) == (candidate[0], repr(candidate[1]))


def acting_rows(effect: Array, groups: Groups) -> npt.NDArray[np.bool_]:
    """Return the mask of the rows in the fewest stretches that hold `DRAWN_POWER_SHARE` of the squares of an effect."""
    power = np.bincount(groups, weights=effect**2)
    order = np.argsort(-power, kind="stable")
    stretch_count = int(np.searchsorted(np.cumsum(power[order]), DRAWN_POWER_SHARE * float(power.sum()))) + 1
    is_chosen = np.zeros(len(power), np.bool_)
    is_chosen[order[:stretch_count]] = True
    return is_chosen[groups]


def picture(cause: Cause, acting_by_channel: Sequence[ActingResiduals]) -> Picture | None:
    """Return the picture of the equation in which the effect follows one of its variables and gains most.

    None where no equation has bins over one of the effect's variables.
    """
    periods = periods_of(cause)
    views = [
        view
        for acting in acting_by_channel
        if (view := view_of(acting, effect_definition(cause.effect).acts_over, periods))
    ]
    if not views:
        return None
    following = [view for view in views if view.along.explained >= LEAST_FOLLOWED_SHARE]
    return picture_of(max(following or views, key=lambda view: view.acting.gain * view.along.explained))


def picture_of(view: View) -> Picture:
    """Return the bin means of a view with their intervals, before and after the effect is added."""
    acting, bins = view.acting, len(view.edges) - 1
    sign = signs(acting).get(view.along.name, np.ones_like(acting.before))
    before, after = (
        means(sign * residual, view.bin_of_row, acting.groups, bins) for residual in (acting.before, acting.after)
    )
    counts = np.bincount(view.bin_of_row[view.bin_of_row >= 0], minlength=bins)
    columns = zip(
        view.edges[:-1].tolist(),
        view.edges[1:].tolist(),
        counts.tolist(),
        *(row.tolist() for binned in (before, after) for row in (binned.mean, binned.low, binned.high)),
        strict=True,
    )
    return Picture(
        view.variable,
        VARIABLES[view.variable].units,
        view.periods,
        view.along.name or None,
        *acting.channel,
        before.rms(counts),
        after.rms(counts),
        before.off_zero,
        after.off_zero,
        tuple(ResidualBin(*row) for row in columns),
    )


def view_of(acting: ActingResiduals, variables: Sequence[Variable], periods: float) -> View | None:
    """Return residuals over the first of an effect's variables that the effect follows; None with too few bins.

    periods : parts of a turn that an angle is folded by, if the effect repeats with them.
    """
    views = []
    for variable in variables:
        if variable not in acting.values:
            continue
        values, view_periods = acting.values[variable], None
        if variable == "angle" and repeats(values, periods, lambda angle: bins_over(acting, angle)[2].explained):
            values, view_periods = fold_angle(values, periods), periods
        edges, bin_of_row, along = bins_over(acting, values)
        if len(edges) >= FEWEST_EDGES:
            views.append(View(acting, variable, view_periods, edges, bin_of_row, along))
    return first_that_follows(views, lambda view: view.along.explained)


def bins_over(acting: ActingResiduals, values: Array) -> tuple[Array, Groups, FollowedSign]:
    """Return the edges of bins over a variable, the bin of each row, and the sign that the effect follows."""
    edges = bin_edges(values, acting.effect, bin_count(acting.independent_rows))
    bins = bin_of(values, edges)
    return edges, bins, best_sign(acting.effect, bins, signs(acting))


def signs(acting: ActingResiduals) -> dict[str, Array]:
    """Return the signs of variables (`SIGN_VARIABLES`) at each row, zero where a variable is almost zero."""
    by_variable: dict[str, Array] = {}
    for name in SIGN_VARIABLES:
        if name in acting.values:
            values = acting.values[name]
            has_sign = np.abs(values) > MOST_STILL_VALUE * np.max(np.abs(values), initial=0.0)
            by_variable[name] = np.where(has_sign, np.sign(values), 0.0)
    return by_variable
