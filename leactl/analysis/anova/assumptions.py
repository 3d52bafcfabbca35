"""Assumptions of an analysis of variance, checked on its residuals: normal, equal in scatter, without drift."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.analysis.anova.one_way import SIGNIFICANCE, Anova, FTest, f_test
from leactl.analysis.anova.values import Array, Values

DOUBTFUL_PROBABILITY = 0.01  # below which an assumption counts as broken; several are checked
FEWEST_VALUES = 3  # that a test of an assumption takes


@dataclass(frozen=True)
class Check:
    """One assumption; `p` is the probability of the data if it holds, None where it could not be checked."""

    name: str
    p: float | None
    note: str = ""

    @property
    def doubtful(self) -> bool:
        """Return whether the assumption is broken by more than chance."""
        return self.p is not None and self.p < DOUBTFUL_PROBABILITY


def checks(values: Values, anova: Anova) -> list[Check]:
    """Check every assumption; notes state the result of a test that does without a broken assumption."""
    by_condition = [anova.residuals[values.condition == condition] for condition in anova.design.conditions]
    raw = [values.value[values.condition == condition] for condition in anova.design.conditions]
    single = len(anova.design.actuators) == 1
    return [
        _normal(anova.residuals, raw if single else []),
        _equal_scatter(by_condition, anova.unequal),
        _without_drift(values, anova.residuals),
        _runs_alike(values),
    ]


def _normal(residuals: Array, raw: Sequence[Array]) -> Check:
    from scipy.stats import kruskal, shapiro

    if len(residuals) < FEWEST_VALUES:
        return Check("normal residuals (Shapiro-Wilk)", None)
    p = float(shapiro(residuals).pvalue)
    note = ""
    if p < DOUBTFUL_PROBABILITY and raw:
        note = f"by ranks (Kruskal-Wallis) conditions differ with p = {float(kruskal(*raw).pvalue):.2g}"
    return Check("normal residuals (Shapiro-Wilk)", p, note)


def _equal_scatter(groups: Sequence[Array], welch: FTest | None) -> Check:
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
    unexplained = deviations - slope * order
    error = math.sqrt(float(unexplained @ unexplained) / dof / float(order @ order))
    if error == 0.0:
        return Check("no drift over the trials", None)
    return Check("no drift over the trials", float(2.0 * t.sf(abs(slope) / error, dof)), f"{slope:+.2g} a trial")


def _runs_alike(values: Values) -> Check:
    """Test whether runs of one actuator under one condition differ by more than the scatter of their trials."""
    name = "runs of a condition alike"
    cell_of = np.unique(np.stack([values.actuator, values.condition], axis=1), axis=0, return_inverse=True)[1].reshape(
        -1
    )
    of_cells, of_runs = _groups(values.value, cell_of), _groups(values.value, values.run)
    between, within = len(of_runs) - len(of_cells), len(values.value) - len(of_runs)
    if between < 1 or within < 1:
        return Check(name, None)
    within_square = sum(float(np.sum((group - group.mean()) ** 2)) for group in of_runs)
    total_square = sum(float(np.sum((group - group.mean()) ** 2)) for group in of_cells)
    if within_square <= 0.0:
        return Check(name, None)
    p = f_test((total_square - within_square) / between, between, within_square / within, within).p
    return Check(name, p, "trials of a run are not independent of each other: --by-run" if p < SIGNIFICANCE else "")


def _groups(values: Array, labels: npt.NDArray[np.int64]) -> list[Array]:
    return [values[labels == label] for label in np.unique(labels)]
