"""Compute figures from marks: shares with intervals, the calibration of probabilities, and wrong answers."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from leactl.gap.blind.marks import Departure, Mark
from leactl.gap.blind.truth import BENCH_MACHINE

Z = 1.959964  # standard deviations on either side that hold 95 %
PROBABILITY_BINS = 10
MOST_MEDIAN_DISTANCE = 0.03  # largest distance from the share that the oracle closes, in half of the cases
MOST_QUANTILE_90_DISTANCE = 0.08  # largest distance from the share that the oracle closes, in nine tenths of the cases
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
    """Share of cases that pass a question, with the 95 % interval of Wilson (1927)."""

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
        """The 95 % interval of the share; None for a total of zero."""
        if not self.total:
            return None
        n, p = self.total, self.count / self.total
        middle = (p + Z * Z / (2 * n)) / (1 + Z * Z / n)
        half_width = Z / (1 + Z * Z / n) * math.sqrt(p * (1 - p) / n + Z * Z / (4 * n * n))
        # without rounding errors, the interval of all or no cases ends at exactly one or zero
        return max(middle - half_width, 0.0) if self.count else 0.0, min(
            middle + half_width, 1.0
        ) if self.count < n else 1.0


@dataclass(frozen=True)
class ProbabilityBin:
    """Cases whose first cause has a probability between `low` and `high`."""

    low: float
    high: float
    count: int
    probability: float  # mean over the cases
    right: float  # share of the cases whose reported set has an effect that acts


@dataclass(frozen=True)
class Calibration:
    """Calibration of the probabilities of first causes."""

    bins: tuple[ProbabilityBin, ...]
    count: int
    base_rate: float
    error: float  # expected calibration error
    skill: float | None  # Brier skill score against the base rate; None if all or no first causes were right


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
    set_size: float | None  # mean size of the reported sets of cases in which one effect acts
    calibration: Calibration
    calibration_of_named: Calibration  # of only the cases whose answer has a cause
    behind_oracle: tuple[float, float] | None  # median and 90 % quantile of the distance from the oracle's share
    parameters: tuple[Share, ...]  # of calibrations within two standard errors of the truth, by parameter
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
    listed_marks = [m for m in marks if m.truth.kind != "unknown"]
    departures = [departure for m in listed_marks for departure in m.departures]
    shares.append(share_within_stds("calibrated parameters within 2 standard errors of the truth", departures))
    distances = [abs(m.closed - m.oracle_closed) for m in marks if m.closed is not None and m.oracle_closed is not None]
    parameters = sorted({departure.parameter for departure in departures})
    set_sizes = [len(m.reported) for m in marks if m.truth.kind == "single" and m.reported]
    return Score(
        len(marks),
        (*shares, *oracle_shares(distances)),
        float(np.mean(set_sizes)) if set_sizes else None,
        calibration(marks),
        calibration([m for m in marks if m.causes]),
        (float(np.median(distances)), float(np.quantile(distances, 0.9))) if distances else None,
        tuple(
            share_within_stds(name, [departure for departure in departures if departure.parameter == name])
            for name in parameters
        ),
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
    is_bench = all(m.truth.machine == BENCH_MACHINE for m in marks)
    single, pair, none, unknown = ([m for m in marks if m.truth.kind == kind] for kind in CASE_KINDS)
    faint = [m for m in single if m.truth.strength == "faint"]
    plain = [m for m in single if m.truth.strength != "faint"]
    with_move = [m for m in marks if m.moved_right is not None]
    with_residual = [m for m in marks if m.left_right is not None]
    named = [m for m in marks if m.effect_closes is not None]
    recalibrated = [m for m in marks if m.calibration_closes is not None]
    return [
        Question(text, on_bench if is_bench else on_machines, among, test)
        for text, on_bench, on_machines, among, test in (
            (PLAIN, ">= 98 %", ">= 95 %", plain, lambda m: m.first_right),
            (FAINT, ">= 92 %", ">= 85 %", faint, lambda m: m.first_right),
            ("one effect, any: in the reported set", ">= 98 %", ">= 95 %", single, lambda m: m.in_set),
            ("two effects: one of them first", ">= 98 %", ">= 95 %", pair, lambda m: m.first_right),
            ("two effects: both named", ">= 85 %", ">= 85 %", pair, lambda m: m.all_named),
            (NOTHING, "<= 2 %", "<= 2 %", none, lambda m: m.names_a_cause),
            (SOUND, ">= 98 %", ">= 98 %", none, lambda m: m.sound),
            (OUTSIDE, ">= 95 %", ">= 92 %", unknown, lambda m: m.says_unknown),
            (NOT_THERE, "<= 1.5 %", "<= 2 %", marks, lambda m: m.names_what_is_not_there),
            (GREW, "<= 0 %", "<= 0 %", named, lambda m: m.effect_closes is False),
            (WORSE, "<= 0 %", "<= 0 %", recalibrated, lambda m: m.calibration_closes is False),
            ("first entry of `where`: what the effects move most", ">= 97 %", ">= 97 %", with_move, moves_right),
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
    """Yield the chief questions by simulator, machine, strength and effect, for each of these that the cases vary."""
    name_functions: dict[str, Callable[[Mark], str]] = {
        "simulator": lambda m: m.truth.simulator,
        "machine": lambda m: m.truth.machine,
        "strength": lambda m: m.truth.strength or "nothing wrong",
        "effect": lambda m: " + ".join(m.truth.effects or m.truth.unlisted) if m.truth.kind != "pair" else "",
    }
    for property_name, name_of in name_functions.items():
        names = sorted({name_of(m) for m in marks} - {""})
        for name in names if len(names) > 1 else []:
            members = [m for m in marks if name_of(m) == name]
            shares = tuple(
                share_of(question) for question in questions_about(members) if question.text in CHIEF_QUESTIONS
            )
            yield Group(property_name, name, len(members), shares)


def share_within_stds(question: str, departures: Sequence[Departure]) -> Share:
    """Return the share of calibrated parameters within two standard errors of the truth."""
    return Share(
        question,
        "92 to 98 %",
        sum(abs(departure.stds) <= MOST_PARAMETER_STDS for departure in departures),
        len(departures),
    )


def oracle_shares(distances: Sequence[float]) -> tuple[Share, Share]:
    """Return the shares of cases whose closed share of the gap is close to that of an oracle."""
    (median_count, median_bound), (quantile_90_count, quantile_90_bound) = (
        (sum(distance <= bound for distance in distances), bound)
        for bound in (MOST_MEDIAN_DISTANCE, MOST_QUANTILE_90_DISTANCE)
    )
    text = "share closed within {:.2f} of an oracle that is told the effect"
    return (
        Share(text.format(median_bound), ">= 50 %", median_count, len(distances)),
        Share(text.format(quantile_90_bound), ">= 90 %", quantile_90_count, len(distances)),
    )


def calibration(marks: Sequence[Mark]) -> Calibration:
    """Return the calibration of the first cause's probability: whether an effect of its class acts."""
    stated = np.asarray([m.first_probability for m in marks], float)
    right = np.asarray([m.in_set for m in marks], float)
    bins, error = [], 0.0
    bin_of_case = np.minimum((stated * PROBABILITY_BINS).astype(int), PROBABILITY_BINS - 1)
    for k in range(PROBABILITY_BINS):
        in_bin = bin_of_case == k
        if in_bin.any():
            mean, share = float(stated[in_bin].mean()), float(right[in_bin].mean())
            bins.append(
                ProbabilityBin(k / PROBABILITY_BINS, (k + 1) / PROBABILITY_BINS, int(in_bin.sum()), mean, share)
            )
            error += float(in_bin.mean()) * abs(mean - share)
    base_rate = float(right.mean()) if len(right) else 0.0
    base_variance = base_rate * (1.0 - base_rate)
    skill = 1.0 - float(np.mean((stated - right) ** 2)) / base_variance if base_variance > 0.0 else None
    return Calibration(tuple(bins), len(marks), base_rate, error, skill)


def truth_text(m: Mark) -> str:
    """Return the truth of a case as text."""
    effects = " + ".join(m.truth.effects) or " + ".join(f"({name})" for name in m.truth.unlisted) or "nothing"
    return f"{effects}, {m.truth.strength}" if m.truth.strength else effects


def answer_text(m: Mark) -> str:
    """Return the answer to a case as text."""
    named_causes = ", ".join(f"{name} {probability:.2f}" for name, probability in m.causes[:4])
    return f"{m.verdict}: {named_causes}" if named_causes else m.verdict
