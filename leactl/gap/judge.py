"""From a set of effects to what may be said of them: probabilities, classes that the data cannot tell apart, unknowns.

Evidence is a gain in weighted squares. How far apart two gains must be is set by model error as well as by noise: a
library form is right to within a share of what it explains (`FORM_ERROR`), so that a rival within that share of the
winner is named together with it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from leactl.gap.evidence import Evidence, usual_unrest
from leactl.gap.regression import Candidate
from leactl.gap.search import Finding, Found

RIVAL_FORM_ERROR = 0.005  # of a gain, standard deviation of the difference of two forms that are both nearly right
SURE, HALF, SLOPE = 0.998, 4.5, 1.3  # height at which an effect is as likely there as not, and how fast that changes
CLASS = 0.2  # of the winner's weight, above which a rival is named together with it
UNCONFIRMED = 0.4  # of a probability, left to an effect that makes held-out runs worse
UNREST = 5.0  # times what benches without an effect show, above which a channel is not explained


@dataclass(frozen=True)
class Judged:
    """One member of the set with its probability and class."""

    finding: Finding
    probability: float
    rivals: tuple[tuple[Finding, float], ...]  # with their own probabilities
    peers: tuple[str, ...]


def judge(found: Found, held_out: Mapping[Candidate, float]) -> list[Judged]:
    """Probabilities of the members of a set, largest first; `held_out` has what each takes from runs not fitted."""
    judged = []
    for member, rivals in zip(found.members, found.rivals, strict=True):
        present = presence(member.height) * (UNCONFIRMED if held_out.get(member.candidate, 0.0) < 0.0 else 1.0)
        spread = 1.0 + RIVAL_FORM_ERROR * member.gain
        weights = [math.exp(min((r.gain - member.gain) / (2.0 * spread), 2.0)) * presence(r.height) for r in rivals[1:]]
        total = presence(member.height) + sum(weights)
        own = presence(member.height) / total if total > 0 else 0.0
        peers = tuple(r.effect for r, w in zip(rivals[1:], weights, strict=True) if w > CLASS * presence(member.height))
        together = own + sum(w / total for r, w in zip(rivals[1:], weights, strict=True) if r.effect in peers)
        others = tuple((r, present * w / total) for r, w in zip(rivals[1:], weights, strict=True))
        judged.append(Judged(member, present * together, others, peers))
    return sorted(judged, key=lambda item: -item.probability)


def presence(height: float) -> float:
    """Probability that an effect of this height is no model error."""
    return SURE / (1.0 + math.exp(-SLOPE * (height - HALF)))


def unrest(evidence: Evidence) -> dict[tuple[str, str, str], float]:
    """Of each channel: what is left over, slow and unexplained, over what benches without an effect leave.

    Noise shows from one row to the next; what does not, and what makes neighbouring rows alike, is model error. Keys
    are equation, quantity and mechanical set-up.
    """
    usual = usual_unrest()
    found: dict[tuple[str, str, str], list[float]] = {}
    for rows in evidence.stack.rows:
        white = max(rows.white, 1e-12)
        value = (rows.noise / white) ** 2 * rows.dependence
        expected = usual.get(rows.equation)
        if expected:
            found.setdefault((rows.equation, rows.quantity, rows.mechanical), []).append(value / expected)
    return {key: float(np.median(values)) for key, values in found.items()}


def unexplained(ratios: dict[tuple[str, str, str], float]) -> float:
    """Probability that something outside the set acts, from the most restless channel."""
    worst = max(ratios.values(), default=0.0)
    if worst <= 0.0:
        return 0.0
    return float(1.0 / (1.0 + (UNREST / worst) ** 2.5))
