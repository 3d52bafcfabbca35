"""From a set of effects to what may be said of them: probabilities, classes that the data cannot tell apart, unknowns.

Evidence is a gain in weighted squares. How far apart two gains must be is set by model error as well as by noise: a
library form is right to within a share of what it explains (`FORM_ERROR`), so that a rival within that share of the
winner is named together with it.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leactl.effects import library
from leactl.gap.search.confirm import transferred
from leactl.gap.search.evidence import Evidence
from leactl.gap.search.regression import Candidate, Fit, Rows, Stack, residuals
from leactl.gap.search.ringing import Line
from leactl.gap.search.sets import LOOSE, TIE, EffectSet, FurtherEffect, apart
from leactl.gap.signals.record import Record

EXACT_FORM_ERROR = 0.0005
SURE, HALF, SLOPE = 0.998, 3.8, 2.5  # height at which an effect is as likely there as not, and how fast that changes
CLASS = 0.2  # of the winner's weight, above which a rival is named together with it
COVERED_WIDTH = 0.02  # of the share that a set explains, over which trust changes
UNCONFIRMED = 0.4  # of a probability, left to an effect that makes held-out runs worse
SHARED_LEFT = 5e-4  # of an equation's largest part, below which a slow rest is no sign of anything
NOISE_BESIDE = 1.6  # noise of a row over that of its differences, squared, where rows overlap
FORM_LEFT = 0.01  # of what a set explains in a channel, that its forms may leave over there
UNREST, UNREST_SLOPE = 5.0, 2.5  # times what benches without an effect show, above which a channel is not explained
RUN_UNREST = 25.0  # the same of one run whose median neighbour is at rest; of a held-out run's squares over fitted ones
ONE_MACHINE = "are they of one machine in one state?"
LINE, LINE_SLOPE = 1.28, 30.0  # over its neighbourhood, of a line in a spectrum as likely there as not


Channel = tuple[str, str, str]
"""Equation, quantity and mechanical set-up."""
RunRatios = dict[Channel, list[tuple[str, float]]]
"""Of each channel, runs and how restless they are; a run that is looked at in stretches occurs once for each."""


@dataclass(frozen=True)
class Judged:
    """One member of the set with its probability and class."""

    finding: FurtherEffect
    explained: float
    probability: float
    rivals: tuple[tuple[FurtherEffect, float], ...]  # with their own probabilities
    peers: tuple[str, ...]


def judge(evidence: Evidence, result: EffectSet, held_out: Mapping[Candidate, float]) -> list[Judged]:
    """Probabilities of the members of a set, largest first; `held_out` has what each takes from runs not fitted."""
    judged = []
    for index, (member, rivals) in enumerate(zip(result.members, result.rivals, strict=True)):
        explained = result.explained(evidence, index)
        present = (
            presence(member.height)
            * coverage(explained - library()[member.effect].explains)
            * (UNCONFIRMED if held_out.get(member.candidate, 0.0) < 0.0 else 1.0)
        )
        weights = [
            math.exp(min((r.gain - member.gain) / (2.0 * spread(member, r, result.missed)), 2.0)) * presence(r.height)
            for r in rivals[1:]
        ]
        total = presence(member.height) + sum(weights)
        own = presence(member.height) / total if total > 0 else 0.0
        peers = tuple(r.effect for r, w in zip(rivals[1:], weights, strict=True) if w > CLASS * presence(member.height))
        together = own + sum(w / total for r, w in zip(rivals[1:], weights, strict=True) if r.effect in peers)
        others = tuple((r, present * w / total) for r, w in zip(rivals[1:], weights, strict=True))
        judged.append(Judged(member, explained, present * together, others, peers))
    return sorted(judged, key=lambda item: -item.probability)


def spread(member: FurtherEffect, rival: FurtherEffect, missed: Mapping[Candidate, float]) -> float:
    """How far apart two gains may be by noise and by what forms miss; pure lags miss next to nothing.

    A form misses a usual share of what it explains, but no more than shows where both are let free.
    """
    exact = all(library()[item.effect].shaped and library()[item.effect].explains > LOOSE for item in (member, rival))
    usual = 1.0 + EXACT_FORM_ERROR * member.gain if exact else apart(member.gain)
    shown = sum(missed.get(item.candidate, 0.0) for item in (member, rival))
    return min(usual, 1.0 + TIE * member.gain + shown)


def coverage(beyond: float) -> float:
    """Probability that an effect is the right one, from the share that the set explains beyond what it must.

    A right form, even of another author, leaves a percent or so; a wrong one that merely correlates leaves tens.
    """
    return 1.0 / (1.0 + math.exp(-beyond / COVERED_WIDTH))


def presence(height: float) -> float:
    """Probability that an effect of this height is no model error."""
    return SURE / (1.0 + math.exp(-SLOPE * (height - HALF)))


def unrest_of_runs(evidence: Evidence, result: EffectSet) -> RunRatios:
    """What is left over in each run, slow and unexplained, over what benches without an effect leave.

    Noise shows from one row to the next; what does not, and what makes neighbouring rows alike, is model error.
    """
    ratios: RunRatios = {}
    for index, rows in enumerate(evidence.stack.rows):
        if not evidence.is_judged(rows):
            continue
        white = evidence.sound_white(rows)
        value = (rows.noise / white) ** 2 * rows.dependence
        expected = evidence.expected(rows, white)
        slow = max(rows.noise**2 - white**2 * NOISE_BESIDE, 0.0)
        # what a shared parameter leaves of a large signal is no sign either
        if left_by_form(result, index) or slow < (SHARED_LEFT * largest(rows)) ** 2:
            value = min(value, expected)
        ratios.setdefault((rows.equation, rows.quantity, rows.mechanical), []).append((rows.run, value / expected))
    return ratios


def unrest(by_run: RunRatios) -> dict[Channel, float]:
    """The unrest of each channel in the middle one of its runs and stretches."""
    return {channel: middle(ratio for _, ratio in ratios) for channel, ratios in by_run.items()}


def middle(ratios: Iterable[float]) -> float:
    """The median."""
    return float(np.median(list(ratios)))


def left_by_form(result: EffectSet, index: int) -> bool:
    """Whether rows have no more left over than a form that is nearly right leaves of a large effect."""
    return result.left[index] < FORM_LEFT * result.taken[index]


def largest(rows: Rows) -> float:
    """Root mean square of the largest part of an equation that calibration scales."""
    parts = (column for name, column in rows.columns.items() if name[0] == "calibration")
    return max((float(np.sqrt(np.mean(part**2))) for part in parts), default=0.0)


@dataclass(frozen=True)
class Unexplained:
    """That something outside the set acts, and what tells it."""

    probability: float
    note: str  # empty where nothing does
    channel: Channel | None = None  # that tells it


def unexplained(restless: Mapping[Channel, float], lines: Mapping[Channel, Line]) -> Unexplained:
    """Judge the most restless channel and the highest line in a spectrum."""
    candidates = [Unexplained(0.0, "")]
    for (equation, quantity, mechanical), ratio in restless.items():
        probability = beyond_sound(ratio, UNREST)
        told = f"{ratio:.3g} times as far from noise as a sound model leaves it"
        note = f"unexplained: {quantity}, {mechanical} ({equation}) is {told}"
        candidates.append(Unexplained(probability, note, (equation, quantity, mechanical)))
    for (equation, quantity, mechanical), line in lines.items():
        probability = 1.0 / (1.0 + (LINE / line.height) ** LINE_SLOPE) if line.height > 0.0 else 0.0
        told = f"rings at about {line.frequency:.3g} Hz"
        note = f"unexplained: what is left of {quantity}, {mechanical} ({equation}) {told}"
        candidates.append(Unexplained(probability, note, (equation, quantity, mechanical)))
    return max(candidates, key=lambda one: one.probability)


def unexplained_in_a_run(by_run: RunRatios) -> Unexplained:
    """Judge the most restless run of a channel whose median run is at rest: it may be of another machine.

    A run counts by the median of its stretches.
    """
    candidates = [Unexplained(0.0, "")]
    for (equation, quantity, mechanical), ratios in by_run.items():
        runs = {run: middle(ratio for name, ratio in ratios if name == run) for run, _ in ratios}
        run, ratio = max(runs.items(), key=lambda item: item[1])
        typical = middle(runs.values())
        if typical < UNREST:
            ratios_told = f"{ratio:.3g} times as far from noise as a sound model leaves it"
            beside = f"the middle one of {len(runs)} runs {typical:.3g} times"
            note = f"unexplained: {quantity} of {run} ({equation}) is {ratios_told}, {beside}; {ONE_MACHINE}"
            candidates.append(Unexplained(beyond_sound(ratio, RUN_UNREST), note, (equation, quantity, mechanical)))
    return max(candidates, key=lambda one: one.probability)


def unlike_fitted(evidence: Evidence, standing: Sequence[Candidate], held_out: Sequence[Record]) -> Unexplained:
    """Judge the held-out run that the fit misses most, in multiples of the worst fitted run of its kind.

    No fitted run tells that a held-out run is of another machine, or of the same machine in another state.

    standing : effects of the augmented model.
    """
    candidates = [Unexplained(0.0, "")]
    others = evidence.on(held_out, standing)
    if not others.stack.rows:
        return candidates[0]
    others.settle(standing)
    fit = evidence.settle(standing)
    fitted = squares_left(evidence.stack, fit)
    for own, runs in squares_left(others.stack, transferred(others.normal(), evidence, fit)).items():
        worst_fitted = max((left for left, _ in fitted.get(own, {}).values()), default=0.0)
        ratios = {run: (left - noise) / worst_fitted for run, (left, noise) in runs.items() if worst_fitted > 0.0}
        if ratios:
            run, ratio = max(ratios.items(), key=lambda item: item[1])
            equation, quantity, mechanical, _ = own
            times = f"{math.sqrt(max(ratio, 0.0)):.3g} times"
            distance = f"is {times} as far off the fit as in the fitted runs of its kind"
            note = f"unexplained: {quantity} of {run} ({equation}) {distance}; {ONE_MACHINE}"
            candidates.append(Unexplained(beyond_sound(ratio, RUN_UNREST), note, (equation, quantity, mechanical)))
    return max(candidates, key=lambda one: one.probability)


def squares_left(stacked: Stack, fit: Fit) -> dict[tuple[str, str, str, str], dict[str, tuple[float, float]]]:
    """Mean squares of each run's residuals, and of its noise from row to row.

    The keys are equation, quantity, mechanical set-up and kind of run, and below them the run. A run that is looked at
    in stretches has the median of theirs.
    """
    left: dict[tuple[str, str, str, str], dict[str, list[tuple[float, float]]]] = {}
    for index, rows in enumerate(stacked.rows):
        squares = float(np.mean(residuals(stacked, fit, index) ** 2)), rows.white**2
        own = left.setdefault((rows.equation, rows.quantity, rows.mechanical, rows.kind), {})
        own.setdefault(rows.run, []).append(squares)
    return {
        key: {
            run: (middle(one for one, _ in several), middle(one for _, one in several)) for run, several in runs.items()
        }
        for key, runs in left.items()
    }


def beyond_sound(ratio: float, even: float) -> float:
    """Probability that something acts where a channel leaves so many times what a sound machine leaves.

    even : ratio at which it is a half.
    """
    return 1.0 / (1.0 + (even / ratio) ** UNREST_SLOPE) if ratio > 0.0 else 0.0
