"""Test effects on held-out runs: the gain of each effect where it was not fitted."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.gap.search.effect_regression import Evidence
from leactl.gap.search.regression import Candidate, Column, Fit, Normal, residuals
from leactl.gap.signals.record import Record

Array = npt.NDArray[np.float64]
STRETCHES = 16  # stretches into which the rows of an equation on one run are cut; each is resampled as a whole
RESAMPLES = 2000  # number of random draws for an interval
TAIL_PROBABILITY = 0.025  # probability beyond one end of a 95 % interval


class HeldOutGain(NamedTuple):
    """Weighted squares that an effect explains on held-out runs; NaN where these do not show the effect."""

    gain: float  # with the cost of the coefficients by their priors
    least: float  # lower end of the 95 % interval of the gain without that cost, from resampled stretches


def held_out_gains(
    evidence: Evidence, hypothesis: Sequence[Candidate], held_out: Sequence[Record], seed: int = 0
) -> list[HeldOutGain]:
    """Return the gain of each member of a hypothesis on held-out runs.

    The fitted runs are fitted with the member and without it. On the held-out runs, coefficients that all runs share
    keep their fitted values; those of a single run, such as the angle of its lock or the initial state of a member, are
    fitted there. The weights are those of a fit of all members to the held-out runs. `TAIL_PROBABILITY` is divided by
    the number of members, since all are tested at once (Bonferroni).
    """
    cannot_tell = HeldOutGain(np.nan, np.nan)
    if not held_out or not hypothesis:
        return [cannot_tell] * len(hypothesis)
    held_out_evidence = evidence.on(held_out, hypothesis)
    if not held_out_evidence.stack.rows:
        return [cannot_tell] * len(hypothesis)
    held_out_evidence.settle(hypothesis)  # sets the weights of the held-out runs
    normal, random = held_out_evidence.normal(), np.random.default_rng(seed)
    fit = evidence.settle(hypothesis)  # sets the weights of the fits without a member, too
    transferred_with_all = transferred_fit(normal, evidence, fit)
    gains = []
    for index in range(len(hypothesis)):
        if len(held_out_evidence.columns(hypothesis[index])) == 0:
            gains.append(cannot_tell)
            continue
        others = [*hypothesis[:index], *hypothesis[index + 1 :]]
        transferred_without = transferred_fit(normal, evidence, evidence.normal().fit(others))
        gain_by_stretch = stretch_gains(normal, transferred_without, transferred_with_all)
        sums = gain_by_stretch[random.integers(0, len(gain_by_stretch), (RESAMPLES, len(gain_by_stretch)))].sum(axis=1)
        lower_end = float(np.quantile(sums, TAIL_PROBABILITY / len(hypothesis)))
        gains.append(HeldOutGain(transferred_without.misfit - transferred_with_all.misfit, lower_end))
    return gains


def stretch_gains(normal: Normal, fit_without: Fit, fit_with_all: Fit) -> Array:
    """Return the gain of one fit over another in weighted squares, by stretch of the rows of each equation and run."""
    gain_by_stretch = []
    for index, weight in enumerate(normal.weights):
        residual_without, residual_with_all = (
            residuals(normal.stack, fit, index) for fit in (fit_without, fit_with_all)
        )
        gain_by_stretch += [
            weight * float(gains_of_rows.sum())
            for gains_of_rows in np.array_split(residual_without**2 - residual_with_all**2, STRETCHES)
        ]
    return np.asarray(gain_by_stretch)


def transferred_fit(normal: Normal, evidence: Evidence, fit: Fit) -> Fit:
    """Return a fit on other runs: coefficients that all runs share are kept, those of single runs fitted again.

    normal : normal equations of the other runs.
    evidence : evidence of the runs that were fitted.
    """
    coefficient_of: dict[Column, float] = {
        evidence.stack.names[column]: float(value) for column, value in zip(fit.columns, fit.values, strict=True)
    }
    column_names = normal.stack.names
    shared_columns = np.asarray(
        [k for k, name in enumerate(column_names) if name in coefficient_of and not is_of_one_run(name)], np.intp
    )
    free_columns = np.asarray([k for k, name in enumerate(column_names) if is_of_one_run(name)], np.intp)
    shared_coefficients = np.asarray([coefficient_of[column_names[k]] for k in shared_columns])
    right = normal.right - normal.gram[:, shared_columns] @ shared_coefficients
    misfit = normal.total - 2 * shared_coefficients @ normal.right[shared_columns]
    misfit += shared_coefficients @ normal.gram[np.ix_(shared_columns, shared_columns)] @ shared_coefficients
    free_gram = normal.gram[np.ix_(free_columns, free_columns)]
    free_coefficients = np.linalg.solve(free_gram + 1e-12 * np.diag(np.diag(free_gram)), right[free_columns])
    misfit -= right[free_columns] @ free_coefficients
    columns = np.concatenate([shared_columns, free_columns])
    unknown_covariance = np.full((len(columns), len(columns)), np.nan)
    return Fit(columns, np.concatenate([shared_coefficients, free_coefficients]), unknown_covariance, float(misfit))


def is_of_one_run(name: Column) -> bool:
    """Return whether a column belongs to a single run."""
    return (name[0] == "nuisance" and name[1] != "") or (name[0] == "effect" and name[3].startswith("start of"))
