"""From a set of effects to what may be said of them: probabilities, classes that the data cannot tell apart, unknowns.

Evidence is a gain in weighted squares. How far apart two gains must be is set by model error as well as by noise: a
library form is right to within a share of what it explains (`FORM_ERROR`), so that a rival within that share of the
winner is named together with it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leactl.effects import library
from leactl.gap.replay.compared import Compared
from leactl.gap.search.evidence import Evidence
from leactl.gap.search.regression import Candidate, Rows
from leactl.gap.search.ringing import Line
from leactl.gap.search.sets import LOOSE, TIE, EffectSet, FurtherEffect, apart

EXACT_FORM_ERROR = 0.0005
SURE, HALF, SLOPE = 0.998, 3.8, 2.5  # height at which an effect is as likely there as not, and how fast that changes
CLASS = 0.2  # of the winner's weight, above which a rival is named together with it
COVERED_WIDTH = 0.02  # of the share that a set explains, over which trust changes
UNCONFIRMED = 0.4  # of a probability, left to an effect that makes held-out runs worse
SHARED_LEFT = 5e-4  # of an equation's largest part, below which a slow rest is no sign of anything
NOISE_BESIDE = 1.6  # noise of a row over that of its differences, squared, where rows overlap
FORM_LEFT = 0.01  # of what a set explains in a channel, that its forms may leave over there
UNREST, UNREST_SLOPE = 5.0, 2.5  # times what benches without an effect show, above which a channel is not explained
RUN_UNREST = 25.0  # the same of the worst of several runs, where the others are at rest
FAR_OFF, FAR_OFF_SLOPE = 20.0, 5.0  # floors, off which a replay is as likely unexplained as not
ONE_MACHINE = "are they of one machine in one state?"
LINE, LINE_SLOPE = 1.28, 30.0  # over its neighbourhood, of a line in a spectrum as likely there as not


Channel = tuple[str, str, str]
"""Equation, quantity and mechanical set-up."""


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


def unrest_of_runs(evidence: Evidence, result: EffectSet) -> dict[Channel, dict[str, float]]:
    """Of each channel, by run: what is left over, slow and unexplained, over what benches without an effect leave.

    Noise shows from one row to the next; what does not, and what makes neighbouring rows alike, is model error.
    """
    ratios: dict[Channel, dict[str, float]] = {}
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
        ratios.setdefault((rows.equation, rows.quantity, rows.mechanical), {})[rows.run] = value / expected
    return ratios


def unrest(by_run: Mapping[Channel, Mapping[str, float]]) -> dict[Channel, float]:
    """The unrest of each channel in the middle one of its runs."""
    return {channel: float(np.median(list(ratios.values()))) for channel, ratios in by_run.items()}


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


def unexplained_in_a_run(by_run: Mapping[Channel, Mapping[str, float]]) -> Unexplained:
    """Judge the run that stands farthest out of the others of its channel: it may be of another machine."""
    candidates = [Unexplained(0.0, "")]
    for (equation, quantity, mechanical), ratios in by_run.items():
        run, ratio = max(ratios.items(), key=lambda item: item[1])
        told = f"{ratio:.3g} times as far from noise as a sound model leaves it"
        middle = f"the middle one of {len(ratios)} runs {float(np.median(list(ratios.values()))):.3g} times"
        note = f"unexplained: {quantity} of {run} ({equation}) is {told}, {middle}; {ONE_MACHINE}"
        candidates.append(Unexplained(beyond_sound(ratio, RUN_UNREST), note, (equation, quantity, mechanical)))
    return max(candidates, key=lambda one: one.probability)


def far_from_held_out(compared: Sequence[Compared], calibrated: bool) -> Unexplained:
    """Judge the channel whose held-out run stands farthest from the last model, in floors.

    Held-out runs of another machine, or of the same in another state, show in no equation of the fitted runs. A drive's
    current does not count: it follows a reference of which a slow log holds a part.

    calibrated : whether the fitted runs tell any parameter of the model.
    """
    candidates = [Unexplained(0.0, "")]
    for one in compared:
        squares, floors = float(one.squares(-1).sum()), float(one.floor_squares().sum())
        if one.quantity != "q_axis_current" and floors > 0.0 and squares > 0.0:
            off = math.sqrt(squares / floors)
            told = f"{one.quantity} of {one.run} ({one.mechanical}) stands {off:.3g} floors off the model"
            asked = f"as the fitted runs have it; {ONE_MACHINE}" if calibrated else "and no fitted run tells it better"
            probability = 1.0 / (1.0 + (FAR_OFF / off) ** FAR_OFF_SLOPE)
            candidates.append(Unexplained(probability, f"unexplained: {told} {asked}"))
    return max(candidates, key=lambda one: one.probability)


def beyond_sound(ratio: float, even: float) -> float:
    """Probability that something acts where a channel leaves so many times what a sound machine leaves.

    even : ratio at which it is a half.
    """
    return 1.0 / (1.0 + (even / ratio) ** UNREST_SLOPE) if ratio > 0.0 else 0.0
