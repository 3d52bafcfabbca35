"""Compute figures from marks: shares with intervals, the calibration of probabilities, and wrong answers."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from leactl.gap.blind.marks import Departure, Mark
from leactl.gap.blind.truth import BENCH_MACHINE

Z = 1.959964  # standard deviations on either side that hold 95 %
PROBABILITY_BINS = 10
MOST_MEDIAN_DISTANCE = 0.03  # from the share that the oracle closes, for half of the cases
MOST_USUAL_DISTANCE = 0.08  # the same for nine tenths of the cases
MOST_PARAMETER_STDS = 2.0  # standard errors by which a calibrated parameter may differ from the truth
Test = Callable[[Mark], bool]
CASE_KINDS = ("single", "pair", "none", "unknown")
PLAIN, FAINT = "one effect, plain or strong: first cause right", "one effect, faint: first cause right"
NOTHING, SOUND = "nothing but wrong parameters: an effect named", "nothing but wrong parameters: called sound"
OUTSIDE = "an effect outside the vocabulary: unknown, no cause named"
NOT_THERE = "any case: an effect named that is not there, further ones counted"
GREW = "an effect named: the held-out gap grew with it"
WORSE = "recalibrated: the held-out gap grew by that"
CHIEF_QUESTIONS = (PLAIN, FAINT, SOUND, OUTSIDE, NOT_THERE)  # questions that are also shown by group


@dataclass(frozen=True)
class Share:
    """Count of a total, with the 95 % interval of Wilson (1927)."""

    question: str
    target: str
    count: int
    total: int

    @property
    def share(self) -> float | None:
        """Count over total; None for a total of zero."""
        return self.count / self.total if self.total else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """The 95 % interval of the share."""
        if not self.total:
            return None
        n, p = self.total, self.count / self.total
        middle = (p + Z * Z / (2 * n)) / (1 + Z * Z / n)
        half = Z / (1 + Z * Z / n) * math.sqrt(p * (1 - p) / n + Z * Z / (4 * n * n))
        # rounding aside, all or none leave an end at one or zero
        return max(middle - half, 0.0) if self.count else 0.0, min(middle + half, 1.0) if self.count < n else 1.0


@dataclass(frozen=True)
class ProbabilityBin:
    """Cases whose first cause has a probability between two tenths."""

    low: float
    high: float
    count: int
    probability: float  # mean
    right: float  # share


@dataclass(frozen=True)
class Calibration:
    """Calibration of the probabilities of first causes."""

    bins: tuple[ProbabilityBin, ...]
    count: int
    base_rate: float
    error: float  # expected calibration error
    skill: float | None  # of Brier against the base rate; None where all or none were right


@dataclass(frozen=True)
class Miss:
    """A wrong answer: the case, the truth and the answer as text."""

    case: str
    question: str
    truth: str
    answer: str


@dataclass(frozen=True)
class Group:
    """The chief questions for some of the cases."""

    by: str  # simulator, machine, strength, effect
    name: str
    cases: int
    shares: tuple[Share, ...]


@dataclass(frozen=True)
class Score:
    """All figures of the report."""

    cases: int
    shares: tuple[Share, ...]
    set_size: float | None  # mean of the reported sets where one effect acts
    calibration: Calibration
    calibration_of_named: Calibration  # of the cases with a cause alone
    behind_oracle: tuple[float, float] | None  # median and 90 % quantile of the distance
    parameters: tuple[Share, ...]  # within two standard errors, by parameter
    misses: tuple[Miss, ...]
    groups: tuple[Group, ...] = ()


def score(marks: Sequence[Mark]) -> Score:
    """Return all figures of a set of marks."""
    questions = questions_about(marks)
    shares = [share_of(question) for question in questions]
    misses = [
        Miss(m.name, question.text, truth_text(m), answer_text(m))
        for question in questions
        for m in question.among
        if question.test(m) == question.target.startswith("<=")
    ]
    known = [m for m in marks if m.truth.kind != "unknown"]
    departures = [d for m in known for d in m.departures]
    shares.append(share_within_stds("calibrated parameters within 2 standard errors of the truth", departures))
    behind = [abs(m.closed - m.oracle_closed) for m in marks if m.closed is not None and m.oracle_closed is not None]
    names = sorted({d.parameter for d in departures})
    sets = [len(m.reported) for m in marks if m.truth.kind == "single" and m.reported]
    return Score(
        len(marks),
        (*shares, *oracle_shares(behind)),
        float(np.mean(sets)) if sets else None,
        calibration(marks),
        calibration([m for m in marks if m.causes]),
        (float(np.median(behind)), float(np.quantile(behind, 0.9))) if behind else None,
        tuple(share_within_stds(name, [d for d in departures if d.parameter == name]) for name in names),
        tuple(misses),
        tuple(groups(marks)),
    )


@dataclass(frozen=True)
class Question:
    """A question about some cases, and the share of them that has to pass."""

    text: str
    target: str
    among: Sequence[Mark]
    test: Test


def questions_about(marks: Sequence[Mark]) -> list[Question]:
    """Return every question about a set of cases; the targets for the bench are higher than for drawn machines."""
    bench = all(m.truth.machine == BENCH_MACHINE for m in marks)
    single, pair, none, unknown = ([m for m in marks if m.truth.kind == kind] for kind in CASE_KINDS)
    faint = [m for m in single if m.truth.strength == "faint"]
    plain = [m for m in single if m.truth.strength != "faint"]
    moved = [m for m in marks if m.moved_right is not None]
    with_residual = [m for m in marks if m.left_right is not None]
    named = [m for m in marks if m.effect_closes is not None]
    recalibrated = [m for m in marks if m.calibration_closes is not None]
    return [
        Question(text, on_bench if bench else on_machines, among, test)
        for text, on_bench, on_machines, among, test in (
            (PLAIN, ">= 98 %", ">= 95 %", plain, lambda m: m.first_right),
            (FAINT, ">= 92 %", ">= 85 %", faint, lambda m: m.first_right),
            ("one effect, any: in the reported set", ">= 98 %", ">= 95 %", single, lambda m: m.in_set),
            ("two effects: one of them first", ">= 98 %", ">= 95 %", pair, lambda m: m.first_right),
            ("two effects: both named", ">= 85 %", ">= 85 %", pair, lambda m: m.all_named),
            (NOTHING, "<= 2 %", "<= 2 %", none, lambda m: m.names_a_cause),
            (SOUND, ">= 98 %", ">= 98 %", none, lambda m: m.sound),
            (OUTSIDE, ">= 95 %", ">= 92 %", unknown, lambda m: m.owned_up),
            (NOT_THERE, "<= 1.5 %", "<= 2 %", marks, lambda m: m.names_what_is_not_there),
            (GREW, "<= 0 %", "<= 0 %", named, lambda m: m.effect_closes is False),
            (WORSE, "<= 0 %", "<= 0 %", recalibrated, lambda m: m.calibration_closes is False),
            ("first entry of `where`: what the effects move most", ">= 97 %", ">= 97 %", moved, moves_right),
            (
                "first entry of `where`: what calibration leaves most of",
                ">= 97 %",
                ">= 97 %",
                with_residual,
                leaves_right,
            ),
        )
    ]


def moves_right(m: Mark) -> bool:
    """Return whether `where` begins with the channel that the effects move most."""
    return m.moved_right is True


def leaves_right(m: Mark) -> bool:
    """Return whether `where` begins with the channel with the largest gap after recalibration."""
    return m.left_right is True


def share_of(question: Question) -> Share:
    """Return the share of cases that pass a question."""
    return Share(question.text, question.target, sum(map(question.test, question.among)), len(question.among))


def groups(marks: Sequence[Mark]) -> Iterator[Group]:
    """Yield the chief questions by simulator, machine, strength and effect, if there is more than one of them."""
    sorts: dict[str, Callable[[Mark], str]] = {
        "simulator": lambda m: m.truth.simulator,
        "machine": lambda m: m.truth.machine,
        "strength": lambda m: m.truth.strength or "nothing wrong",
        "effect": lambda m: " + ".join(m.truth.effects or m.truth.unlisted) if m.truth.kind != "pair" else "",
    }
    for property_name, name_of in sorts.items():
        named = sorted({name_of(m) for m in marks} - {""})
        for name in named if len(named) > 1 else []:
            members = [m for m in marks if name_of(m) == name]
            shares = tuple(
                share_of(question) for question in questions_about(members) if question.text in CHIEF_QUESTIONS
            )
            yield Group(property_name, name, len(members), shares)


def share_within_stds(question: str, departures: Sequence[Departure]) -> Share:
    """Return the share of calibrated parameters within two standard errors of the truth."""
    return Share(question, "92 to 98 %", sum(abs(d.stds) <= MOST_PARAMETER_STDS for d in departures), len(departures))


def oracle_shares(behind: Sequence[float]) -> tuple[Share, Share]:
    """Return the shares of cases whose closed share of the gap is close to that of an oracle."""
    median_case, most_cases = (
        (sum(b <= bound for b in behind), bound) for bound in (MOST_MEDIAN_DISTANCE, MOST_USUAL_DISTANCE)
    )
    text = "share closed within {:.2f} of an oracle that is told the effect"
    return (
        Share(text.format(median_case[1]), ">= 50 %", median_case[0], len(behind)),
        Share(text.format(most_cases[1]), ">= 90 %", most_cases[0], len(behind)),
    )


def calibration(marks: Sequence[Mark]) -> Calibration:
    """Return the calibration of the first cause's probability: whether an effect of its class acts."""
    stated = np.asarray([m.first_probability for m in marks], float)
    right = np.asarray([m.in_set for m in marks], float)
    bins, error = [], 0.0
    bin_of_case = np.minimum((stated * PROBABILITY_BINS).astype(int), PROBABILITY_BINS - 1)
    for k in range(PROBABILITY_BINS):
        inside = bin_of_case == k
        if inside.any():
            mean, share = float(stated[inside].mean()), float(right[inside].mean())
            bins.append(
                ProbabilityBin(k / PROBABILITY_BINS, (k + 1) / PROBABILITY_BINS, int(inside.sum()), mean, share)
            )
            error += float(inside.mean()) * abs(mean - share)
    rate = float(right.mean()) if len(right) else 0.0
    spread = rate * (1.0 - rate)
    skill = 1.0 - float(np.mean((stated - right) ** 2)) / spread if spread > 0.0 else None
    return Calibration(tuple(bins), len(marks), rate, error, skill)


def truth_text(m: Mark) -> str:
    """Return the truth of a case as text."""
    effects = " + ".join(m.truth.effects) or " + ".join(f"({name})" for name in m.truth.unlisted) or "nothing"
    return f"{effects}, {m.truth.strength}" if m.truth.strength else effects


def answer_text(m: Mark) -> str:
    """Return the answer to a case as text."""
    named_causes = ", ".join(f"{name} {probability:.2f}" for name, probability in m.causes[:4])
    return f"{m.verdict}: {named_causes}" if named_causes else m.verdict
