"""Describe an unexplained residual: its variables, the share a function of state explains, and the nearest effects.

The residual is that of the equation farthest from a sound machine's. A free additive function of the logged state is
learnt on the fitted runs and tried on the held-out ones; its residual is tested for a slow change with time and for a
frequency.
"""

from collections.abc import Collection, Sequence

import numpy as np
import numpy.typing as npt

from leactl.effects import library
from leactl.gap.diagnosis import Near, Picture, Rest
from leactl.gap.search.angle_periodogram import can_show_waves, periodogram
from leactl.gap.search.confirm import transferred_fit
from leactl.gap.search.effect_regression import Evidence
from leactl.gap.search.effect_sets import ENTRY_HEIGHT, EffectSet, FurtherEffect
from leactl.gap.search.regression import Candidate, Fit, Rows, Stack, residuals
from leactl.gap.signals.effect_variables import state_in
from leactl.gap.signals.record import Record
from leactl.gap.verdict.decision import NAMED_PROBABILITY
from leactl.gap.verdict.judge import EVEN_HEIGHT, Channel, Judged, presence
from leactl.gap.verdict.picture import ActingResiduals, channel_of, picture_of, view_of
from leactl.gap.verdict.residual_frequency import ResidualCourse, gains, strongest_frequency
from leactl.gap.verdict.state_regression import (
    LEAST_CERTAINTY,
    Function,
    Groups,
    Sample,
    certainty,
    confirmed_variables,
    learn,
    slow_gain,
)
from leactl.protocol import protocolfile, shipped
from leactl.vocabulary.effect import effect_definition
from leactl.vocabulary.variable import Variable

Array = npt.NDArray[np.float64]
STRETCHES = 24  # stretches into which a run is cut
FEWEST_ROWS_IN_STRETCH = 4  # mean number of rows of a stretch; a run with fewer is left out
LOW_ORDERS, STRONG_ORDERS = 6, 4  # numbers of orders over the angle: of the lowest, and of the strongest
HIGHEST_ORDER = 250  # highest order over the angle that is tried
LEAST_CLOSED_SHARE = 0.05  # share of the gap that a function closes, below which no dependence is reported
LEAST_NEAR_HEIGHT = 1.0  # size over uncertainty and floor above which an effect is listed as near
MOST_NEAREST_EFFECTS = 4  # largest number of nearest effects that are listed
LEAST_SLOW_SHARE = 0.2  # share of the gap that neighbouring stretches or one sine explain if it depends on time


def describe(
    evidence: Evidence,
    hypothesis: Sequence[Candidate],
    channel: Channel | None,
    held_out: Sequence[Record],
    nearest: Sequence[Near],
) -> Rest | None:
    """Return the description of a channel's residual under a set; None where fitted or held-out runs have too few rows.

    Parameters
    ----------
    evidence : evidence of the fitted runs.
    hypothesis : effects of the augmented model.
    channel : channel whose residual is farthest from a sound machine's.
    held_out : held-out runs.
    nearest : effects that nearly explain the residual, as `nearest_effects` returns them.
    """
    held_out_evidence = evidence.on(held_out, hypothesis)
    fit = evidence.settle(hypothesis)
    fitted_rows = row_groups_of(evidence.stack, channel)
    held_out_rows = row_groups_of(held_out_evidence.stack, channel)
    if not fitted_rows or not held_out_rows:
        return None
    held_out_evidence.settle(hypothesis)
    fitted_sample = sample_of(evidence.stack, fit, fitted_rows)
    held_out_sample = sample_of(
        held_out_evidence.stack, transferred_fit(held_out_evidence.normal(), evidence, fit), held_out_rows
    )
    common_variables = fitted_sample.state.keys() & held_out_sample.state.keys()
    fitted_sample, held_out_sample = (
        Sample(sample.residual, {name: sample.state[name] for name in common_variables}, sample.stretch)
        for sample in (fitted_sample, held_out_sample)
    )
    orders = orders_of(evidence.stack, fit, fitted_rows)
    trial, chosen_bases, ridge = learn(
        fitted_sample, orders, squares_beyond_noise(evidence.stack, fitted_rows, fitted_sample)
    )
    confirmed_bases = confirmed_variables(trial, chosen_bases, ridge, held_out_sample)
    free_function = trial.function(confirmed_bases, ridge)
    gap = squares_beyond_noise(held_out_evidence.stack, held_out_rows, held_out_sample)
    closable, residual_after = closed_share(held_out_sample, free_function, trial.function([], ridge), gap)
    variables = free_function.variables if closable is not None and closable >= LEAST_CLOSED_SHARE else ()
    residual = residual_after if variables else held_out_sample.residual
    explained_residual = free_function.of(fitted_sample) if variables else 0.0
    slow_change = is_slow(residual, held_out_sample, gap)
    fitted_courses = courses(
        evidence.stack, fitted_rows, fitted_sample.residual - explained_residual, fitted_sample.stretch
    )
    frequency = (
        None
        if slow_change
        else common_frequency(
            fitted_courses, courses(held_out_evidence.stack, held_out_rows, residual, held_out_sample.stretch), gap
        )
    )
    depends_on = (*variables, "time") if slow_change or frequency else variables
    rows = held_out_evidence.stack.rows[held_out_rows[0]]
    effects_on_channel = {
        name[1] for index in fitted_rows for name in evidence.stack.rows[index].columns if name[0] == "effect"
    }
    nearest_on_channel = tuple(item for item in nearest if item.effect in effects_on_channel)[:MOST_NEAREST_EFFECTS]
    pictures = [
        shape_picture(rows, held_out_sample, free_function, name) for name in variables if name in held_out_sample.state
    ]
    return Rest(
        depends_on,
        frequency,
        closable,
        rows.quantity,
        rows.role,
        rows.mechanical,
        rows.equation,
        tuple(item for item in pictures if item is not None),
        nearest_on_channel,
        deciding_protocol(depends_on, nearest_on_channel, effects_on_channel),
    )


def row_groups_of(stacked: Stack, channel: Channel | None) -> list[int]:
    """Return the indices of the row groups of a channel that have enough rows."""
    keys = [(rows.equation, rows.quantity, rows.mechanical) for rows in stacked.rows]
    return [
        index
        for index, key in enumerate(keys)
        if key == channel and len(stacked.rows[index].index) >= FEWEST_ROWS_IN_STRETCH * STRETCHES
    ]


def sample_of(stacked: Stack, fit: Fit, indices: Sequence[int]) -> Sample:
    """Return the residuals of some row groups under a fit, with the state at each row.

    Stretches are numbered with a gap between runs, so that stretches of two runs are not neighbours.
    """
    rows_of_runs = [stacked.rows[index] for index in indices]
    states = [state_in(rows.equation, rows.signals) for rows in rows_of_runs]
    state = {
        name: np.concatenate(
            [state_of_run[name][rows.index] for state_of_run, rows in zip(states, rows_of_runs, strict=True)]
        )
        for name in states[0]
        if all(name in state_of_run for state_of_run in states)
    }
    stretch = [
        run * (STRETCHES + 1) + np.arange(len(rows.index)) * STRETCHES // len(rows.index)
        for run, rows in enumerate(rows_of_runs)
    ]
    residual = np.concatenate([residuals(stacked, fit, index) for index in indices])
    return Sample(residual, state, np.concatenate(stretch))


def squares_beyond_noise(stacked: Stack, indices: Sequence[int], sample: Sample) -> float:
    """Return the squares of a sample beyond the noise from row to row, at least zero."""
    noise_squares = sum(len(stacked.rows[index].left_over) * stacked.rows[index].white_noise ** 2 for index in indices)
    return max(float(np.sum(sample.residual**2)) - noise_squares, 0.0)


def orders_of(stacked: Stack, fit: Fit, indices: Sequence[int]) -> list[float]:
    """Return the orders over the angle for a free function: the lowest, and the strongest of a periodogram."""
    power = np.zeros(HIGHEST_ORDER + 1)
    for index in indices:
        rows = stacked.rows[index]
        if can_show_waves(rows, "drag") and rows.signals.velocity is not None:
            power += periodogram(rows, residuals(stacked, fit, index), "drag", HIGHEST_ORDER)
    strongest = [float(order) for order in np.argsort(-power)[:STRONG_ORDERS] if power[order] > 0.0]
    return sorted({float(order) for order in range(1, LOW_ORDERS + 1)} | set(strongest))


def closed_share(sample: Sample, free_function: Function, constant: Function, gap: float) -> tuple[float | None, Array]:
    """Return the share of a gap that a function closes on runs it was not learnt on, and the residual it leaves there.

    constant : constant learnt on the same runs, which closes nothing.
    gap : squares of the residual beyond noise; the share is None where it is zero.
    """
    residual = sample.residual - free_function.of(sample)
    if gap <= 0.0:
        return None, residual
    closed_squares = float(np.sum((sample.residual - constant.of(sample)) ** 2 - residual**2))
    return min(max(closed_squares / gap, 0.0), 1.0), residual


def is_slow(residual: Array, sample: Sample, gap: float) -> bool:
    """Return whether a residual changes slowly with time, so that stretches are like their neighbours."""
    explained_squares = slow_gain(residual, sample.stretch)
    return (
        float(explained_squares.sum()) > LEAST_SLOW_SHARE * gap > 0.0
        and certainty(explained_squares, sample.stretch) >= LEAST_CERTAINTY
    )


def courses(stacked: Stack, indices: Sequence[int], residual: Array, stretch: Groups) -> list[ResidualCourse]:
    """Return the residual of some row groups as courses over time, one for each run."""
    rows_of_runs = [stacked.rows[index] for index in indices]
    ends = np.cumsum([len(rows.index) for rows in rows_of_runs])[:-1]
    groups = zip(rows_of_runs, np.split(residual, ends), np.split(stretch, ends), strict=True)
    return [
        ResidualCourse(rows.signals.time[rows.index], residual_of_rows, stretch_of_rows)
        for rows, residual_of_rows, stretch_of_rows in groups
    ]


def common_frequency(fitted: Sequence[ResidualCourse], held_out: Sequence[ResidualCourse], gap: float) -> float | None:
    """Return the frequency [Hz] at which the residual repeats in fitted and held-out runs; None where it does not."""
    frequency = strongest_frequency(fitted)
    if frequency is None:
        return None
    explained_squares = np.concatenate([gains(course, frequency) for course in held_out])
    stretch = np.concatenate([course.stretch for course in held_out])
    is_repeated = (
        float(explained_squares.sum()) > LEAST_SLOW_SHARE * gap > 0.0
        and certainty(explained_squares, stretch) >= LEAST_CERTAINTY
    )
    return frequency if is_repeated else None


def shape_picture(rows: Rows, sample: Sample, free_function: Function, name: Variable) -> Picture | None:
    """Return the picture of the residual over one variable, before and after the free function of all variables.

    None where the variable has too few bins.
    """
    values = free_function.of(sample)
    independent_rows = len(sample) / rows.dependence
    residual = sample.residual - values
    gain = float(np.sum(sample.residual**2 - residual**2))
    periods = free_function.strongest_order() if name == "angle" else 1.0
    acting_residuals = ActingResiduals(
        channel_of(rows), sample.residual, residual, values, sample.stretch, dict(sample.state), independent_rows, gain
    )
    view = view_of(acting_residuals, [name], periods)
    return None if view is None else picture_of(view)


def deciding_protocol(
    depends_on: Sequence[str], nearest: Sequence[Near], effects_on_channel: Collection[str]
) -> str | None:
    """Return the name of the shipped protocol that separates most of the possible effects; None if none separates any.

    Possible are the nearest effects, and effects on the channel that act over a variable the residual depends on. Of
    equal protocols the one with most of the nearest effects counts, then the shortest.

    effects_on_channel : effects with a column in an equation of the channel.
    """
    near_effects = {effect.effect for effect in nearest}
    effects_over_variables = {
        name for name in effects_on_channel if set(effect_definition(name).acts_over) & set(depends_on)
    }
    plans = [protocolfile.load(name) for name in shipped.names()]
    best_plan = max(
        plans,
        key=lambda plan: (
            *(
                len(effects.intersection(plan.separates))
                for effects in (near_effects | effects_over_variables, near_effects)
            ),
            -plan.duration_s,
        ),
    )
    return best_plan.name if (near_effects | effects_over_variables).intersection(best_plan.separates) else None


def nearest_effects(effect_set: EffectSet, judgements: Sequence[Judged], refused: Sequence[Near]) -> tuple[Near, ...]:
    """Return the effects that are near but not named: first withdrawn ones, then improbable ones, then others.

    refused : withdrawn effects.
    """
    near_effects = {effect.effect: effect for effect in refused}
    for judgement in judgements:
        if judgement.probability < NAMED_PROBABILITY and judgement.finding.effect not in near_effects:
            near_effects[judgement.finding.effect] = Near(judgement.finding.effect, reason_for_doubt(judgement))
    for further in sorted(effect_set.further_effects, key=lambda effect: -effect.height):
        if further.effect not in near_effects and further.height > LEAST_NEAR_HEIGHT:
            near_effects[further.effect] = Near(further.effect, reason_kept_out(further))
    return tuple(near_effects.values())


def reason_for_doubt(member: Judged) -> str:
    """Return why a member of a set is not named."""
    needed_share = library()[member.finding.effect].explains
    if member.explained < needed_share:
        shares = (
            f"{100 * member.explained:.0f} % of the gap where it acts; a form of it explains {100 * needed_share:.0f} %"
        )
        return f"the set explains {shares} or more"
    if presence(member.finding.height) < NAMED_PROBABILITY:
        return (
            f"its size is {member.finding.height:.3g} times its uncertainty and floor; even odds need {EVEN_HEIGHT:g}"
        )
    if member.rivals:
        return f"{member.rivals[0][0].effect} explains as much"
    return "held-out runs do not bear it out"


def reason_kept_out(further: FurtherEffect) -> str:
    """Return why an effect did not enter a set."""
    if further.height <= ENTRY_HEIGHT:
        return f"its size is {further.height:.3g} times its uncertainty and floor; {ENTRY_HEIGHT:g} are needed"
    return "what it takes away is no more than the set's own forms may miss"
