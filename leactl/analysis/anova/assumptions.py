"""Assumptions of an analysis of variance, checked on its residuals: normal, equal in scatter, without drift."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.analysis.anova.one_way import SIGNIFICANCE, Anova, FTest, f_test
from leactl.analysis.anova.values import Array, Values

DOUBTFUL_PROBABILITY = 0.01  # a lower one makes an assumption doubtful; low, since several are checked
FEWEST_VALUES = 3  # that a test of an assumption needs


@dataclass(frozen=True)
class Check:
    """One assumption; `p` is the probability of the data if it holds, None if it could not be checked."""

    name: str
    p: float | None
    note: str = ""

    @property
    def doubtful(self) -> bool:
        """Return whether the assumption is broken by more than chance."""
        return self.p is not None and self.p < DOUBTFUL_PROBABILITY


def checks(values: Values, anova: Anova) -> list[Check]:
    """Return a check of every assumption; its note states the result of a test that does not need the assumption."""
    residuals_by_condition = [anova.residuals[values.condition == condition] for condition in anova.design.conditions]
    values_by_condition = [values.value[values.condition == condition] for condition in anova.design.conditions]
    has_one_actuator = len(anova.design.actuators) == 1
    return [
        _normal(anova.residuals, values_by_condition if has_one_actuator else []),
        _equal_scatter(residuals_by_condition, anova.unequal),
        _without_drift(values, anova.residuals),
        _runs_alike(values),
    ]


def _normal(residuals: Array, values_by_condition: Sequence[Array]) -> Check:
    """Test whether residuals are normal; if not, the note compares the conditions by ranks."""
    from scipy.stats import kruskal, shapiro

    if len(residuals) < FEWEST_VALUES:
        return Check("normal residuals (Shapiro-Wilk)", None)
    p = float(shapiro(residuals).pvalue)
    note = ""
    if p < DOUBTFUL_PROBABILITY and values_by_condition:
        note = f"by ranks (Kruskal-Wallis) conditions differ with p = {float(kruskal(*values_by_condition).pvalue):.2g}"
    return Check("normal residuals (Shapiro-Wilk)", p, note)


def _equal_scatter(groups: Sequence[Array], welch: FTest | None) -> Check:
    """Test whether the residuals of all conditions scatter alike; the note states the result of Welch's test."""
    from scipy.stats import levene

    name = "equal scatter (Brown-Forsythe)"
    if min(map(len, groups)) < FEWEST_VALUES:
        return Check(name, None)
    p = float(levene(*groups, center="median").pvalue)
    note = "" if welch is None else f"without it (Welch) conditions differ with p = {welch.p:.2g}"
    return Check(name, p if math.isfinite(p) else None, note)


def _without_drift(values: Values, residuals: Array) -> Check:
    """Test the slope of the residuals over the order of the trials within their runs."""
    from scipy.stats import t

    order = np.zeros(len(residuals))
    deviations = residuals.copy()
    for run in np.unique(values.run):
        in_run = values.run == run
        order[in_run] = np.arange(in_run.sum()) - 0.5 * (in_run.sum() - 1)
        deviations[in_run] -= deviations[in_run].mean()
    dof = len(residuals) - len(np.unique(values.run)) - 1
    if dof < 1 or not order.any():
        return Check("no drift over the trials", None)
    slope = float(order @ deviations / (order @ order))
    residuals_of_slope = deviations - slope * order
    slope_error = math.sqrt(float(residuals_of_slope @ residuals_of_slope) / dof / float(order @ order))
    if slope_error == 0.0:
        return Check("no drift over the trials", None)
    return Check("no drift over the trials", float(2.0 * t.sf(abs(slope) / slope_error, dof)), f"{slope:+.2g} a trial")


def _runs_alike(values: Values) -> Check:
    """Test whether runs of one actuator under one condition differ by more than the scatter of their trials."""
    name = "runs of a condition alike"
    cell_of_value = np.unique(np.stack([values.actuator, values.condition], axis=1), axis=0, return_inverse=True)[
        1
    ].reshape(-1)
    cell_groups, run_groups = _groups(values.value, cell_of_value), _groups(values.value, values.run)
    between_dof, within_dof = len(run_groups) - len(cell_groups), len(values.value) - len(run_groups)
    if between_dof < 1 or within_dof < 1:
        return Check(name, None)
    within_square = sum(float(np.sum((group - group.mean()) ** 2)) for group in run_groups)
    total_square = sum(float(np.sum((group - group.mean()) ** 2)) for group in cell_groups)
    if within_square <= 0.0:
        return Check(name, None)
    p = f_test((total_square - within_square) / between_dof, between_dof, within_square / within_dof, within_dof).p
    return Check(name, p, "trials of a run are not independent of each other: --by-run" if p < SIGNIFICANCE else "")


def _groups(values: Array, labels: npt.NDArray[np.int64]) -> list[Array]:
    """Return the values of each label; both arguments have shape (values,)."""
    return [values[labels == label] for label in np.unique(labels)]
