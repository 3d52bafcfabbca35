"""Judge a set of effects: their probabilities, classes that the data cannot tell apart, and unexplained residuals.

Evidence is a gain in weighted squares. The difference that two gains must have depends on noise and on model error: a
library form is right to within a share of what it explains (`FORM_ERROR`), so that a rival within that share of the
winner is named together with it.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leactl.effects import library
from leactl.gap.search.confirm import transferred_fit
from leactl.gap.search.effect_regression import Evidence
from leactl.gap.search.effect_sets import LOOSE_SHARE, TIE_SHARE, EffectSet, FurtherEffect, gain_tolerance
from leactl.gap.search.regression import Candidate, Fit, Rows, Stack, residuals
from leactl.gap.search.ringing import Line
from leactl.gap.signals.record import Record

EXACT_FORM_ERROR = 0.0005  # `RIVAL_FORM_ERROR` of two pure lags, whose forms are nearly exact
MOST_PROBABILITY = 0.998  # largest probability that an effect of any height is present
EVEN_HEIGHT = 3.8  # height of an effect that is as likely present as not
HEIGHT_SLOPE = 2.5  # e-folds of the odds for each unit of height
CLASS_WEIGHT = 0.2  # share of the winner's weight above which a rival is named together with it
COVERED_WIDTH = 0.02  # change of the explained share that changes the odds by an e-fold
UNCONFIRMED_FACTOR = 0.4  # factor on the probability of an effect that makes held-out runs worse
LEAST_SLOW_RESIDUAL = 5e-4  # share of an equation's largest part below which a slow residual shows nothing
OVERLAP_NOISE_RATIO = 1.6  # squared ratio of a row's noise to that of its differences, where rows overlap
FORM_LEFT_SHARE = 0.01  # share of the squares explained in a group of rows that inexact forms may leave there
EVEN_UNREST = 5.0  # unrest, over that of benches without effects, at even odds of something unexplained
UNREST_SLOPE = 2.5  # exponent with which the odds grow with that ratio
EVEN_RUN_UNREST = 25.0  # `EVEN_UNREST` for one run while the median run is quiet, and for a held-out run
ONE_MACHINE_QUESTION = "are they of one machine in one state?"
EVEN_LINE_HEIGHT = 1.28  # height of a spectral line over its neighbourhood at even odds
LINE_SLOPE = 30.0  # exponent with which the odds grow with that height
Channel = tuple[str, str, str]
"""Equation, quantity and mechanical set-up."""
RunRatios = dict[Channel, list[tuple[str, float]]]
"""By channel: runs with their unrest ratio; a run that is read in stretches occurs once for each stretch."""


@dataclass(frozen=True)
class Judged:
    """Judgement of one member of a set: its probability, its rivals and its class."""

    finding: FurtherEffect
    explained: float  # share of the residual beyond noise that the set explains where the member acts
    probability: float  # that the member or one of its peers is present
    rivals: tuple[tuple[FurtherEffect, float], ...]  # with the probability of each alone
    peers: tuple[str, ...]  # rivals that the data cannot tell apart from the member


def judge(evidence: Evidence, effect_set: EffectSet, held_out_gains: Mapping[Candidate, float]) -> list[Judged]:
    """Return the judgement of each member of a set, the most probable first.

    held_out_gains : gain of each member on runs that were not fitted.
    """
    judgements = []
    for index, (member, rivals) in enumerate(zip(effect_set.members, effect_set.rivals, strict=True)):
        explained = effect_set.explained(evidence, index)
        presence_probability = (
            presence(member.height)
            * coverage(explained - library()[member.effect].explains)
            * (UNCONFIRMED_FACTOR if held_out_gains.get(member.candidate, 0.0) < 0.0 else 1.0)
        )
        weights = [
            math.exp(
                min(
                    (rival.gain - member.gain) / (2.0 * pair_gain_tolerance(member, rival, effect_set.squares_missed)),
                    2.0,
                )
            )
            * presence(rival.height)
            for rival in rivals[1:]
        ]
        total_weight = presence(member.height) + sum(weights)
        member_share = presence(member.height) / total_weight if total_weight > 0 else 0.0
        peers = tuple(
            rival.effect
            for rival, weight in zip(rivals[1:], weights, strict=True)
            if weight > CLASS_WEIGHT * presence(member.height)
        )
        class_share = member_share + sum(
            weight / total_weight for rival, weight in zip(rivals[1:], weights, strict=True) if rival.effect in peers
        )
        rival_probabilities = tuple(
            (rival, presence_probability * weight / total_weight)
            for rival, weight in zip(rivals[1:], weights, strict=True)
        )
        judgements.append(Judged(member, explained, presence_probability * class_share, rival_probabilities, peers))
    return sorted(judgements, key=lambda judgement: -judgement.probability)


def pair_gain_tolerance(
    member: FurtherEffect, rival: FurtherEffect, squares_missed: Mapping[Candidate, float]
) -> float:
    """Return the difference of two gains that noise and inexact forms explain; forms of pure lags are nearly exact.

    A form misses a usual share of what it explains, but no more than free forms of both effects explain in addition.

    squares_missed : squares that free forms of an effect explain in addition to its own form.
    """
    is_exact = all(
        library()[item.effect].shaped and library()[item.effect].explains > LOOSE_SHARE for item in (member, rival)
    )
    usual_difference = 1.0 + EXACT_FORM_ERROR * member.gain if is_exact else gain_tolerance(member.gain)
    squares_of_both = sum(squares_missed.get(item.candidate, 0.0) for item in (member, rival))
    return min(usual_difference, 1.0 + TIE_SHARE * member.gain + squares_of_both)


def coverage(excess_share: float) -> float:
    """Return the probability that an effect is the right one.

    The right form, even by another author, leaves about one percent unexplained; a form that only correlates leaves
    tens of percent.

    excess_share : share that the set explains, less the least share that the right effect explains.
    """
    return 1.0 / (1.0 + math.exp(-excess_share / COVERED_WIDTH))


def presence(height: float) -> float:
    """Return the probability that an effect of this height is no model error."""
    return MOST_PROBABILITY / (1.0 + math.exp(-HEIGHT_SLOPE * (height - EVEN_HEIGHT)))


def unrest_of_runs(evidence: Evidence, effect_set: EffectSet) -> RunRatios:
    """Return the unrest of each run by channel: its slow unexplained power over that of machines without an effect.

    Noise changes from one row to the next. Power that does not, and that makes neighbouring rows alike, is model error.
    """
    ratios: RunRatios = {}
    for index, rows in enumerate(evidence.stack.rows):
        if not evidence.is_judged(rows):
            continue
        white_noise = evidence.white_noise_of(rows)
        unrest_ratio = (rows.noise / white_noise) ** 2 * rows.dependence
        expected_unrest = evidence.expected_unrest(rows, white_noise)
        slow_power = max(rows.noise**2 - white_noise**2 * OVERLAP_NOISE_RATIO, 0.0)
        # a slow residual far below the largest part of its equation shows nothing, either
        if is_left_by_form(effect_set, index) or slow_power < (LEAST_SLOW_RESIDUAL * largest_part(rows)) ** 2:
            unrest_ratio = min(unrest_ratio, expected_unrest)
        ratios.setdefault((rows.equation, rows.quantity, rows.mechanical), []).append(
            (rows.run, unrest_ratio / expected_unrest)
        )
    return ratios


def unrest(by_run: RunRatios) -> dict[Channel, float]:
    """Return the median unrest of each channel over its runs and stretches."""
    return {channel: median_of(ratio for _, ratio in ratios) for channel, ratios in by_run.items()}


def median_of(values: Iterable[float]) -> float:
    """Return the median of some values; NaN if one of them is NaN."""
    return float(np.median(list(values)))


def is_left_by_form(effect_set: EffectSet, index: int) -> bool:
    """Return whether a nearly right form of a large effect explains the residual of one group of rows."""
    return effect_set.squares_left[index] < FORM_LEFT_SHARE * effect_set.squares_taken[index]


def largest_part(rows: Rows) -> float:
    """Return the root mean square of the largest part of an equation that a calibrated parameter scales."""
    scaled_columns = (column for name, column in rows.columns.items() if name[0] == "calibration")
    return max((float(np.sqrt(np.mean(scaled_column**2))) for scaled_column in scaled_columns), default=0.0)


@dataclass(frozen=True)
class Unexplained:
    """Probability that something outside the set acts, and the channel that shows it."""

    probability: float
    note: str  # empty where nothing shows it
    channel: Channel | None = None  # channel that shows it


def unexplained_in_channels(unrest_by_channel: Mapping[Channel, float], lines: Mapping[Channel, Line]) -> Unexplained:
    """Return the likeliest sign of something unexplained: the unrest of a channel or a line in a spectrum."""
    candidates = [Unexplained(0.0, "")]
    for (equation, quantity, mechanical), ratio in unrest_by_channel.items():
        probability = unexplained_probability(ratio, EVEN_UNREST)
        evidence = f"{ratio:.3g} times as far from noise as a sound model leaves it"
        note = f"unexplained: {quantity}, {mechanical} ({equation}) is {evidence}"
        candidates.append(Unexplained(probability, note, (equation, quantity, mechanical)))
    for (equation, quantity, mechanical), line in lines.items():
        probability = 1.0 / (1.0 + (EVEN_LINE_HEIGHT / line.height) ** LINE_SLOPE) if line.height > 0.0 else 0.0
        evidence = f"rings at about {line.frequency:.3g} Hz"
        note = f"unexplained: what is left of {quantity}, {mechanical} ({equation}) {evidence}"
        candidates.append(Unexplained(probability, note, (equation, quantity, mechanical)))
    return max(candidates, key=lambda candidate: candidate.probability)


def unexplained_in_a_run(by_run: RunRatios) -> Unexplained:
    """Return the likeliest sign of a run that is of another machine: its unrest in a channel whose median run is quiet.

    The unrest of a run is the median over its stretches.
    """
    candidates = [Unexplained(0.0, "")]
    for (equation, quantity, mechanical), ratios in by_run.items():
        runs = {run: median_of(ratio for name, ratio in ratios if name == run) for run, _ in ratios}
        run, ratio = max(runs.items(), key=lambda item: item[1])
        median_ratio = median_of(runs.values())
        if median_ratio < EVEN_UNREST:
            excess = f"{ratio:.3g} times as far from noise as a sound model leaves it"
            comparison = f"the middle one of {len(runs)} runs {median_ratio:.3g} times"
            note = f"unexplained: {quantity} of {run} ({equation}) is {excess}, {comparison}; {ONE_MACHINE_QUESTION}"
            candidates.append(
                Unexplained(unexplained_probability(ratio, EVEN_RUN_UNREST), note, (equation, quantity, mechanical))
            )
    return max(candidates, key=lambda candidate: candidate.probability)


def unexplained_in_held_out(
    evidence: Evidence, hypothesis: Sequence[Candidate], held_out: Sequence[Record]
) -> Unexplained:
    """Return the likeliest sign of a held-out run of another machine: its residual over that of the worst fitted run.

    A held-out run of another machine, or of the same machine in another state, shows in no fitted run.

    hypothesis : effects of the augmented model.
    """
    candidates = [Unexplained(0.0, "")]
    held_out_evidence = evidence.on(held_out, hypothesis)
    if not held_out_evidence.stack.rows:
        return candidates[0]
    held_out_evidence.settle(hypothesis)
    fit = evidence.settle(hypothesis)
    fitted_squares = mean_squares_by_run(evidence.stack, fit)
    for key, runs in mean_squares_by_run(
        held_out_evidence.stack, transferred_fit(held_out_evidence.normal(), evidence, fit)
    ).items():
        worst_fitted = max((residual for residual, _ in fitted_squares.get(key, {}).values()), default=0.0)
        ratios = {
            run: (residual - noise) / worst_fitted for run, (residual, noise) in runs.items() if worst_fitted > 0.0
        }
        if ratios:
            run, ratio = max(ratios.items(), key=lambda item: item[1])
            equation, quantity, mechanical, _ = key
            ratio_text = f"{math.sqrt(max(ratio, 0.0)):.3g} times"
            comparison = f"is {ratio_text} as far off the fit as in the fitted runs of its kind"
            note = f"unexplained: {quantity} of {run} ({equation}) {comparison}; {ONE_MACHINE_QUESTION}"
            candidates.append(
                Unexplained(unexplained_probability(ratio, EVEN_RUN_UNREST), note, (equation, quantity, mechanical))
            )
    return max(candidates, key=lambda candidate: candidate.probability)


def mean_squares_by_run(stacked: Stack, fit: Fit) -> dict[tuple[str, str, str, str], dict[str, tuple[float, float]]]:
    """Return the mean squares of each run's residuals and of its noise from row to row.

    The keys are equation, quantity, mechanical set-up and kind of run, and below them the run. A run that is read in
    stretches has the medians over its stretches.
    """
    squares_by_kind: dict[tuple[str, str, str, str], dict[str, list[tuple[float, float]]]] = {}
    for index, rows in enumerate(stacked.rows):
        residual_and_noise = float(np.mean(residuals(stacked, fit, index) ** 2)), rows.white_noise**2
        squares_of_runs = squares_by_kind.setdefault((rows.equation, rows.quantity, rows.mechanical, rows.kind), {})
        squares_of_runs.setdefault(rows.run, []).append(residual_and_noise)
    return {
        key: {
            run: (
                median_of(square for square, _ in residuals_and_noises),
                median_of(square for _, square in residuals_and_noises),
            )
            for run, residuals_and_noises in runs.items()
        }
        for key, runs in squares_by_kind.items()
    }


def unexplained_probability(ratio: float, even_ratio: float) -> float:
    """Return the probability that something unexplained acts on a channel.

    ratio : residual power over that of a sound machine.
    even_ratio : ratio at which the probability is one half.
    """
    return 1.0 / (1.0 + (even_ratio / ratio) ** UNREST_SLOPE) if ratio > 0.0 else 0.0
