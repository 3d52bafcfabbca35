"""Subtract effects that a simulator contains from the equations of a run: the remainder is beyond the simulator.

Each effect has the size and form fitted to the simulated runs. Its coefficients stay free within their errors and the
usual difference between two authors' forms of one law.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from leactl.effects import library
from leactl.gap.equations import Equation
from leactl.gap.search.effect_regression import Evidence
from leactl.gap.search.effect_sets import ENTRY_HEIGHT, FORM_ERROR
from leactl.gap.search.regression import Candidate, Fit, disagreement, effect_contributions
from leactl.gap.signals.record import Record

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class KnownEffect:
    """An effect with its fitted coefficients."""

    candidate: Candidate
    coefficients: tuple[str, ...]  # names
    values: Array  # of the coefficients, shape (coefficients,)
    covariance: Array  # shape (coefficients, coefficients)

    @property
    def name(self) -> str:
        """The effect's identifier."""
        return self.candidate[0]

    def differs_from(self, other: "KnownEffect") -> bool:
        """Return whether an effect's sizes in two sets of runs differ beyond both errors and the error of its form."""
        difference = self.values - other.values
        if float(np.linalg.norm(difference)) <= math.sqrt(FORM_ERROR) * self.size:
            return False
        squares = float(difference @ np.linalg.pinv(self.covariance + other.covariance) @ difference)
        return squares > ENTRY_HEIGHT**2

    @property
    def size(self) -> float:
        """Length of the vector of coefficients, which all have the same unit in one effect."""
        return float(np.linalg.norm(self.values))

    @property
    def shows(self) -> bool:
        """Whether the runs show the effect beyond the error of its size."""
        return float(self.values @ np.linalg.pinv(self.covariance) @ self.values) > ENTRY_HEIGHT**2


def known_effects(evidence: Evidence, fit: Fit, candidates: Sequence[Candidate]) -> tuple[KnownEffect, ...]:
    """Return the effects of a fitted hypothesis with their coefficients, without those that no run shows.

    Covariances are widened by how far runs and equations disagree.
    """
    normal, effects = evidence.normal(), []
    for candidate in candidates:
        columns = evidence.columns(candidate)
        positions = [int(np.flatnonzero(fit.columns == column)[0]) for column in columns]
        if not positions:
            continue
        widening = np.array([disagreement(normal, fit, index) for index in positions])
        covariance = fit.covariance[np.ix_(positions, positions)] * np.outer(widening, widening)
        coefficients = tuple(evidence.coefficient(column) for column in columns)
        if np.isfinite(covariance).all():
            effects.append(KnownEffect(candidate, coefficients, fit.values[positions], covariance))
    return tuple(effects)


@dataclass(frozen=True)
class Subtraction:
    """Subtraction of known effects from the equations of a run."""

    effects: tuple[KnownEffect, ...]

    def __call__(self, equations: list[Equation]) -> list[Equation]:
        """Return the equations less the effects; the effects' coefficients become nuisances that all runs share."""
        return [self._without(equation) for equation in equations]

    def _without(self, equation: Equation) -> Equation:
        """Return one equation less the effects."""
        left_over, shared = equation.left_over, dict(equation.shared)
        for effect in self.effects:
            name, form = effect.candidate
            columns = effect_contributions(equation, library()[name].terms(equation.signals, form))
            stds = np.sqrt(np.diag(effect.covariance) + FORM_ERROR * effect.values**2)
            for coefficient, value, std in zip(effect.coefficients, effect.values, stds, strict=True):
                if coefficient in columns:
                    left_over = left_over - value * columns[coefficient]
                    shared[f"{name} {coefficient}"] = columns[coefficient], float(std)
        return replace(equation, left_over=left_over, shared=shared)


def records_without(records: Sequence[Record], effects: Sequence[KnownEffect]) -> list[Record]:
    """Return the runs, with these effects subtracted from their equations."""
    subtraction = Subtraction(tuple(effects)) if effects else None
    return [replace(record, nominal_effects=subtraction) for record in records]
