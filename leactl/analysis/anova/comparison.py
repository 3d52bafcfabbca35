"""Comparison of one result over conditions: test, pairs, effect size, assumptions, and a concluding sentence."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leactl.analysis.anova.assumptions import Check, checks
from leactl.analysis.anova.effect_size import EffectSize, omega_squared
from leactl.analysis.anova.one_way import Anova, FTest, anova
from leactl.analysis.anova.pairs import POWER, PairwiseDifference, pairs
from leactl.analysis.anova.values import Values, values_of_runs
from leactl.errors import InputError, NotIdentifiable


@dataclass(frozen=True)
class ConditionSummary:
    """Count, mean and standard deviation of the values under one condition."""

    condition: str
    count: int
    mean: float
    std: float  # of the values; NaN for a single value


@dataclass(frozen=True, eq=False)
class Comparison:
    """Comparison of one result between conditions."""

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
        """Return a sentence that states the effects that the data show, and how large an effect they would show."""
        test = self.anova.test
        statistics = (
            f"{in_words(test)}, omega squared {self.effect.value:.2f} [{self.effect.low:.2f}, {self.effect.high:.2f}]"
        )
        clear_pairs = [pair for pair in self.pairs if pair.shown]
        if test.shown != self.anova.shown and self.anova.unequal is not None:
            statistics += f"; with unequal scatter allowed for, by Welch's test, {in_words(self.anova.unequal)}"
        if not self.anova.shown:
            largest_difference = max(max(abs(pair.low), abs(pair.high)) for pair in self.pairs)
            return (
                f"No effect of the condition on {self.name} is shown ({statistics}). That does not show that there is"
                f" none: differences up to {largest_difference:.2g} {self.units} are compatible with these values, and"
                f" one of {self._visible_difference(self.pairs)} would have passed Tukey's test in {POWER:.0%} of such"
                " experiments."
            )
        text = f"{self.name} differs between conditions ({statistics})"
        if clear_pairs:
            text += ": " + "; ".join(self._ordered(pair) for pair in clear_pairs)
        unclear_pairs = [pair for pair in self.pairs if not pair.shown]
        if unclear_pairs:
            unclear_names = ", ".join(f"{pair.first} and {pair.second}" for pair in unclear_pairs)
            text += (
                f". Between {unclear_names} no difference is shown; one of {self._visible_difference(unclear_pairs)}"
                f" would have passed Tukey's test in {POWER:.0%} of such experiments"
            )
        return text + "."

    def as_json(self) -> dict[str, Any]:
        """Return the comparison as a JSON object."""
        anova = self.anova
        return {
            "name": self.name,
            "units": self.units,
            "conditions": [
                {"condition": item.condition, "count": item.count, "mean": item.mean, "std": _finite(item.std)}
                for item in self.groups
            ],
            "actuators": list(anova.design.actuators),
            "anova": _test_json(anova.test),
            "welch": _test_json(anova.unequal),
            "actuator": _test_json(anova.actuator),
            "actuator_std": anova.actuator_std,
            "interaction": _test_json(anova.interaction),
            "at_large": _test_json(anova.at_large),
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
                    "shown": anova.shown and pair.shown,
                    "smallest_seen": pair.smallest_seen,
                }
                for pair in self.pairs
            ],
            "assumptions": [
                {"name": item.name, "p": item.p, "doubtful": item.doubtful, "note": item.note} for item in self.checks
            ],
            "shown": anova.shown,
            "sentence": self.sentence,
            "notes": list(self.notes),
        }

    def _ordered(self, pair: PairwiseDifference) -> str:
        """Return a text that says which condition of a pair is higher, and by how much."""
        low, high = sorted((abs(pair.low), abs(pair.high)))
        higher, lower = (pair.second, pair.first) if pair.difference > 0.0 else (pair.first, pair.second)
        limits = f"[{_digits(low, 2)}, {_digits(high, 2)}]"
        return f"{higher} is above {lower} by {_digits(abs(pair.difference), 3)} {limits} {self.units}"

    def _visible_difference(self, candidates: Sequence[PairwiseDifference]) -> str:
        """Return a text with the largest of the smallest visible differences of pairs, also relative to the mean."""
        smallest = max(pair.smallest_seen for pair in candidates)
        mean = abs(
            float(np.average([group.mean for group in self.groups], weights=[group.count for group in self.groups]))
        )
        relative_text = f" ({100.0 * smallest / mean:.2g} % of the mean)" if mean > smallest else ""
        return f"{smallest:.2g} {self.units}{relative_text}"


def compare(values: Values) -> Comparison:
    """Compare the conditions of one result.

    Raises
    ------
    NotIdentifiable : see `anova`.
    """
    analysis = anova(values)
    groups = []
    for condition in analysis.design.conditions:
        group_values = values.value[values.condition == condition]
        std = float(group_values.std(ddof=1)) if len(group_values) > 1 else float("nan")
        groups.append(ConditionSummary(condition, len(group_values), float(group_values.mean()), std))
    assumptions = checks(values, analysis)
    return Comparison(
        values.name,
        values.units,
        tuple(groups),
        analysis,
        omega_squared(analysis.test),
        tuple(pairs(values, analysis)),
        tuple(assumptions),
        (*values.notes, *_remarks(values, analysis, groups), *_doubtful_notes(assumptions)),
    )


def compare_all(
    paths: Sequence[Path], names: Sequence[str] = (), by_run: bool = False, **options: Any
) -> tuple[str, list[Comparison], list[str]]:
    """Compare the results of runs of one experiment; return its name, the comparisons, and a line for each failure.

    Parameters
    ----------
    names : of the results; by default every result with an uncertainty.
    by_run, options : see `values_of_runs`.

    Raises
    ------
    InputError : see `values_of_runs`, or a name in `names` is no result.
    NotIdentifiable : no result can be compared.
    """
    values_by_result = values_of_runs(paths, by_run, **options)
    experiment, result_names = (
        values_by_result.experiment,
        list(dict.fromkeys([*values_by_result.runs, *values_by_result.trials])),
    )
    for name in names:
        if name not in result_names:
            raise InputError(
                f"{experiment} has no result '{name}' to compare; it has {', '.join(result_names) or 'none'}"
            )
    all_values = [*values_by_result.trials.values(), *values_by_result.runs.values()]
    conditions = {condition for values in all_values for condition in values.condition.tolist()}
    if len(conditions) == 1:
        raise NotIdentifiable(
            f"{experiment}: found one condition, '{conditions.pop()}'; two conditions or more are needed"
        )
    comparisons, refused = [], []
    for name in result_names:
        if not names or name in names:
            try:
                comparisons.append(_best(values_by_result.trials.get(name), values_by_result.runs.get(name)))
            except NotIdentifiable as fault:
                refused.append(str(fault))
    if not comparisons:
        no_result = (
            f"{experiment}: no result with an uncertainty to compare; `leactl analyze` of one run says what it lacks"
        )
        raise NotIdentifiable(refused or no_result)
    return experiment, comparisons, refused


def _best(trials: Values | None, runs: Values | None) -> Comparison:
    """Compare single trials if they cover every condition, else one value for each run, else trials of some conditions.

    Raises
    ------
    NotIdentifiable : neither trials nor runs can be compared.
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
    """Return a test as papers print it: F with its degrees of freedom, and p."""
    p = f"p = {test.p:.2g}" if test.p >= 1e-300 else "p < 1e-300"
    return f"F({test.between:g}, {test.within:.4g}) = {test.f:.2f}, {p}"


def _remarks(values: Values, anova: Anova, groups: list[ConditionSummary]) -> list[str]:
    """Return notes on unequal numbers, on the actuators that the result holds for, and on missing conditions."""
    notes = []
    if len({group.count for group in groups}) > 1:
        notes.append("numbers are unequal: " + ", ".join(f"{group.condition} {group.count}" for group in groups))
    actuators = anova.design.actuators
    if len(actuators) == 1:
        actuator_name = f"'{actuators[0]}'" if actuators[0] else "without a name"
        notes.append(f"one actuator ({actuator_name}): no random factor; what is found holds for it and for no other")
    elif anova.interaction is not None and anova.interaction.shown:
        notes.append(
            f"actuators answer to the conditions differently ({in_words(anova.interaction)}): conditions are judged by"
            " that, for actuators of this make at large"
        )
    elif anova.at_large is not None and anova.interaction is not None:
        notes.append(
            f"holds for these {len(actuators)} actuators, which answer alike as far as can be seen"
            f" ({in_words(anova.interaction)}); for actuators at large {in_words(anova.at_large)}"
        )
    cells = set(zip(values.actuator.tolist(), values.condition.tolist(), strict=True))
    missing_cells = [
        f"{actuator} {condition}"
        for actuator in actuators
        for condition in anova.design.conditions
        if (actuator, condition) not in cells
    ]
    if missing_cells:
        notes.append("not measured: " + ", ".join(missing_cells))
    if len(values.value) > len(np.unique(values.run)) == len(cells):
        notes.append(
            "each condition was set once an actuator: the scatter is that of trials, not that of setting it again"
        )
    return notes


def _doubtful_notes(checks: list[Check]) -> list[str]:
    """Return a note for each doubtful assumption."""
    return [
        f"{check.name}: doubtful (p = {check.p:.2g})" + (f"; {check.note}" if check.note else "")
        for check in checks
        if check.doubtful and check.p is not None
    ]


def _digits(value: float, count: int) -> str:
    """Return a value with `count` significant digits, trailing zeros included."""
    return f"{value:#.{count}g}".rstrip(".")


def _test_json(test: FTest | None) -> dict[str, float] | None:
    """Return a test as a JSON object; None if it was not made."""
    return None if test is None else {"F": test.f, "df": test.between, "df_error": test.within, "p": test.p}


def _finite(value: float) -> float | None:
    """Return a value, or None if it is not finite."""
    return value if np.isfinite(value) else None
