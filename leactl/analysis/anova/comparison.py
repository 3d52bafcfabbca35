"""One result over the conditions, whole: test, pairs, effect size, assumptions, and a sentence of what is supported."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leactl.analysis.anova.assumptions import Check, checks
from leactl.analysis.anova.effect_size import EffectSize, omega_squared
from leactl.analysis.anova.one_way import Anova, FTest, anova
from leactl.analysis.anova.pairs import SEEN, PairwiseDifference, pairs
from leactl.analysis.anova.values import Values, of_runs
from leactl.errors import InputError, NotIdentifiable


@dataclass(frozen=True)
class ConditionSummary:
    """Values under one condition as they are."""

    condition: str
    count: int
    mean: float
    std: float  # of the values, NaN for one


@dataclass(frozen=True, eq=False)
class Comparison:
    """What the data say of one result."""

    name: str
    units: str
    groups: tuple[ConditionSummary, ...]
    anova: Anova
    effect: EffectSize
    pairs: tuple[PairwiseDifference, ...]
    checks: tuple[Check, ...]
    notes: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """What the data support, and what they do not."""
        test = self.anova.test
        told = (
            f"{in_words(test)}, omega squared {self.effect.value:.2f} [{self.effect.low:.2f}, {self.effect.high:.2f}]"
        )
        shown = [pair for pair in self.pairs if pair.shown]
        if test.shown != self.anova.shown and self.anova.unequal is not None:
            told += f"; with unequal scatter allowed for, by Welch's test, {in_words(self.anova.unequal)}"
        if not self.anova.shown:
            most = max(max(abs(pair.low), abs(pair.high)) for pair in self.pairs)
            return (
                f"No effect of the condition on {self.name} is shown ({told}). That does not show that there is none:"
                f" differences up to {most:.2g} {self.units} are compatible with these values, and one of"
                f" {self._seen(self.pairs)} would have passed Tukey's test in {SEEN:.0%} of such experiments."
            )
        text = f"{self.name} differs between conditions ({told})"
        if shown:
            text += ": " + "; ".join(self._ordered(pair) for pair in shown)
        rest = [pair for pair in self.pairs if not pair.shown]
        if rest:
            which = ", ".join(f"{pair.first} and {pair.second}" for pair in rest)
            text += (
                f". Between {which} no difference is shown; one of {self._seen(rest)} would have passed Tukey's test in"
                f" {SEEN:.0%} of such experiments"
            )
        return text + "."

    def as_json(self) -> dict[str, Any]:
        """All of it for a script."""
        found = self.anova
        return {
            "name": self.name,
            "units": self.units,
            "conditions": [
                {"condition": one.condition, "count": one.count, "mean": one.mean, "std": _finite(one.std)}
                for one in self.groups
            ],
            "actuators": list(found.design.actuators),
            "anova": _test_json(found.test),
            "welch": _test_json(found.unequal),
            "actuator": _test_json(found.actuator),
            "actuator_std": found.actuator_std,
            "interaction": _test_json(found.interaction),
            "at_large": _test_json(found.at_large),
            "omega_squared": {"value": self.effect.value, "low": self.effect.low, "high": self.effect.high},
            "tukey": [
                {
                    "first": pair.first,
                    "second": pair.second,
                    "difference": pair.difference,
                    "std": pair.std,
                    "low": pair.low,
                    "high": pair.high,
                    "p": pair.p,
                    "shown": found.shown and pair.shown,
                    "smallest_seen": pair.smallest_seen,
                }
                for pair in self.pairs
            ],
            "assumptions": [
                {"name": one.name, "p": one.p, "doubtful": one.doubtful, "note": one.note} for one in self.checks
            ],
            "shown": found.shown,
            "sentence": self.sentence,
            "notes": list(self.notes),
        }

    def _ordered(self, pair: PairwiseDifference) -> str:
        low, high = sorted((abs(pair.low), abs(pair.high)))
        over, under = (pair.second, pair.first) if pair.difference > 0.0 else (pair.first, pair.second)
        limits = f"[{_digits(low, 2)}, {_digits(high, 2)}]"
        return f"{over} is above {under} by {_digits(abs(pair.difference), 3)} {limits} {self.units}"

    def _seen(self, among: Sequence[PairwiseDifference]) -> str:
        least = max(pair.smallest_seen for pair in among)
        mean = abs(float(np.average([one.mean for one in self.groups], weights=[one.count for one in self.groups])))
        part = f" ({100.0 * least / mean:.2g} % of the mean)" if mean > least else ""
        return f"{least:.2g} {self.units}{part}"


def compare(values: Values) -> Comparison:
    """Compare the conditions of one result.

    Raises
    ------
    NotIdentifiable : see `anova`.
    """
    found = anova(values)
    groups = []
    for condition in found.design.conditions:
        own = values.value[values.condition == condition]
        std = float(own.std(ddof=1)) if len(own) > 1 else float("nan")
        groups.append(ConditionSummary(condition, len(own), float(own.mean()), std))
    checked = checks(values, found)
    return Comparison(
        values.name,
        values.units,
        tuple(groups),
        found,
        omega_squared(found.test),
        tuple(pairs(values, found)),
        tuple(checked),
        (*values.notes, *_remarks(values, found, groups), *_broken(checked)),
    )


def compare_all(
    paths: Sequence[Path], names: Sequence[str] = (), by_run: bool = False, **options: Any
) -> tuple[str, list[Comparison], list[str]]:
    """Experiment, comparisons of its results, and why others cannot be compared.

    Parameters
    ----------
    names : of the results; every one with an uncertainty by default.
    by_run, options : see `values.of_runs`.

    Raises
    ------
    InputError : see `values.of_runs`, or a result that there is not.
    NotIdentifiable : no result can be compared.
    """
    taken = of_runs(paths, by_run, **options)
    experiment, known = taken.experiment, list(dict.fromkeys([*taken.runs, *taken.trials]))
    for name in names:
        if name not in known:
            raise InputError(f"{experiment} has no result '{name}' to compare; it has {', '.join(known) or 'none'}")
    every = [*taken.trials.values(), *taken.runs.values()]
    held = {condition for one in every for condition in one.condition.tolist()}
    if len(held) == 1:
        raise NotIdentifiable(f"{experiment}: found one condition, '{held.pop()}'; two conditions or more are needed")
    found, refused = [], []
    for name in known:
        if not names or name in names:
            try:
                found.append(_best(taken.trials.get(name), taken.runs.get(name)))
            except NotIdentifiable as fault:
                refused.append(str(fault))
    if not found:
        nothing = (
            f"{experiment}: no result with an uncertainty to compare; `leactl analyze` of one run says what it lacks"
        )
        raise NotIdentifiable(refused or nothing)
    return experiment, found, refused


def _best(trials: Values | None, runs: Values | None) -> Comparison:
    """Compare single trials where they tell every condition, or else one value a run, or else what trials there are.

    Raises
    ------
    NotIdentifiable : what was tried first cannot be compared, and what comes after it neither.
    """
    if runs is None or (trials is not None and set(runs.condition.tolist()) <= set(trials.condition.tolist())):
        assert trials is not None
        return compare(trials)
    try:
        return compare(runs)
    except NotIdentifiable as fault:
        if trials is not None and len(set(trials.condition.tolist())) > 1:
            return compare(trials)
        raise NotIdentifiable(f"{fault}; {runs.notes[0]}") from None


def in_words(test: FTest) -> str:
    """A test as papers print it."""
    p = f"p = {test.p:.2g}" if test.p >= 1e-300 else "p < 1e-300"
    return f"F({test.between:g}, {test.within:.4g}) = {test.f:.2f}, {p}"


def _remarks(values: Values, found: Anova, groups: list[ConditionSummary]) -> list[str]:
    notes = []
    if len({one.count for one in groups}) > 1:
        notes.append("numbers are unequal: " + ", ".join(f"{one.condition} {one.count}" for one in groups))
    actuators = found.design.actuators
    if len(actuators) == 1:
        whose = f"'{actuators[0]}'" if actuators[0] else "without a name"
        notes.append(f"one actuator ({whose}): no random factor; what is found holds for it and for no other")
    elif found.interaction is not None and found.interaction.shown:
        notes.append(
            f"actuators answer to the conditions differently ({in_words(found.interaction)}): conditions are judged by"
            " that, for actuators of this make at large"
        )
    elif found.at_large is not None and found.interaction is not None:
        notes.append(
            f"holds for these {len(actuators)} actuators, which answer alike as far as can be seen"
            f" ({in_words(found.interaction)}); for actuators at large {in_words(found.at_large)}"
        )
    cells = {(a, c) for a, c in zip(values.actuator.tolist(), values.condition.tolist(), strict=True)}
    lacking = [(a, c) for a in actuators for c in found.design.conditions if (a, c) not in cells]
    if lacking:
        notes.append("not measured: " + ", ".join(f"{a} {c}" for a, c in lacking))
    if len(values.value) > len(np.unique(values.run)) == len(cells):
        notes.append(
            "each condition was set once an actuator: the scatter is that of trials, not that of setting it again"
        )
    return notes


def _broken(checked: list[Check]) -> list[str]:
    return [
        f"{one.name}: doubtful (p = {one.p:.2g})" + (f"; {one.note}" if one.note else "")
        for one in checked
        if one.doubtful and one.p is not None
    ]


def _digits(value: float, count: int) -> str:
    """A value with so many digits, zeros at its end among them."""
    return f"{value:#.{count}g}".rstrip(".")


def _test_json(test: FTest | None) -> dict[str, float] | None:
    return None if test is None else {"F": test.f, "df": test.between, "df_error": test.within, "p": test.p}


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
