"""From a set of effects to what may be said of them: probabilities, classes that the data cannot tell apart, unknowns.

Evidence is a gain in weighted squares. How far apart two gains must be is set by model error as well as by noise: a
library form is right to within a share of what it explains (`FORM_ERROR`), so that a rival within that share of the
winner is named together with it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from leactl.effects import library
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
LINE, LINE_SLOPE = 1.28, 30.0  # over its neighbourhood, of a line in a spectrum as likely there as not


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


def unrest(evidence: Evidence, result: EffectSet) -> dict[tuple[str, str, str], float]:
    """Of each channel: what is left over, slow and unexplained, over what benches without an effect leave.

    Noise shows from one row to the next; what does not, and what makes neighbouring rows alike, is model error. Keys
    are equation, quantity and mechanical set-up.
    """
    ratios: dict[tuple[str, str, str], list[float]] = {}
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
        ratios.setdefault((rows.equation, rows.quantity, rows.mechanical), []).append(value / expected)
    return {key: float(np.median(values)) for key, values in ratios.items()}


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
    channel: tuple[str, str, str] | None = None  # equation, quantity and set-up that tell it


Channels = Mapping[tuple[str, str, str], float]


def unexplained(restless: Channels, lines: Mapping[tuple[str, str, str], Line]) -> Unexplained:
    """Judge the most restless channel and the highest line in a spectrum; keys as `unrest` has them."""
    candidates = [Unexplained(0.0, "")]
    for (equation, quantity, mechanical), ratio in restless.items():
        probability = 1.0 / (1.0 + (UNREST / ratio) ** UNREST_SLOPE) if ratio > 0.0 else 0.0
        told = f"{ratio:.3g} times as far from noise as a sound model leaves it"
        note = f"unexplained: {quantity}, {mechanical} ({equation}) is {told}"
        candidates.append(Unexplained(probability, note, (equation, quantity, mechanical)))
    for (equation, quantity, mechanical), line in lines.items():
        probability = 1.0 / (1.0 + (LINE / line.height) ** LINE_SLOPE) if line.height > 0.0 else 0.0
        told = f"rings at about {line.frequency:.3g} Hz"
        note = f"unexplained: what is left of {quantity}, {mechanical} ({equation}) {told}"
        candidates.append(Unexplained(probability, note, (equation, quantity, mechanical)))
    return max(candidates, key=lambda one: one.probability)
