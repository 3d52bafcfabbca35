"""What was learnt from some runs, tried on others: does an effect still take something away where it was not fitted?"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.gap.search.evidence import Evidence
from leactl.gap.search.regression import Candidate, Column, Fit, Normal, residuals
from leactl.gap.signals.record import Record

Array = npt.NDArray[np.float64]
STRETCHES = 16  # of the rows of an equation and a run, drawn again as a whole
RESAMPLED = 2000
CHANCE = 0.025  # beyond one end of an interval; beyond both, 95 % are left


class HeldOutGain(NamedTuple):
    """Weighted squares that an effect takes away on held-out runs; NaN where these cannot tell."""

    gain: float  # with what the coefficients cost by their priors
    least: float  # lower end of the interval without that cost, from stretches of these runs that are drawn again


def held_out_gains(
    evidence: Evidence, hypothesis: Sequence[Candidate], held_out: Sequence[Record], seed: int = 0
) -> list[HeldOutGain]:
    """What each member takes away on held-out runs.

    The fitted runs are fitted with the member and without it. On the held-out runs the coefficients that all runs share
    stay as fitted; those of a single run, such as where its lock stands or what a member began with, are fitted there.
    The weights are those of a fit of all members to the held-out runs. `CHANCE` is divided by the number of members,
    for all are tried at once (Bonferroni).
    """
    cannot_tell = HeldOutGain(np.nan, np.nan)
    if not held_out or not hypothesis:
        return [cannot_tell] * len(hypothesis)
    on_held_out = evidence.on(held_out, hypothesis)
    if not on_held_out.stack.rows:
        return [cannot_tell] * len(hypothesis)
    on_held_out.settle(hypothesis)  # for its weights
    normal, random = on_held_out.normal(), np.random.default_rng(seed)
    fitted = evidence.settle(hypothesis)  # whose weights the fits without a member have too
    whole = transferred(normal, evidence, fitted)
    gains = []
    for index in range(len(hypothesis)):
        if len(on_held_out.columns(hypothesis[index])) == 0:
            gains.append(cannot_tell)
            continue
        rest = [*hypothesis[:index], *hypothesis[index + 1 :]]
        without = transferred(normal, evidence, evidence.normal().fit(rest))
        taken = taken_by_stretch(normal, without, whole)
        sums = taken[random.integers(0, len(taken), (RESAMPLED, len(taken)))].sum(axis=1)
        least = float(np.quantile(sums, CHANCE / len(hypothesis)))
        gains.append(HeldOutGain(without.misfit - whole.misfit, least))
    return gains


def taken_by_stretch(normal: Normal, without: Fit, whole: Fit) -> Array:
    """How much less `whole` leaves over than `without`, for each stretch of the rows of each equation and run."""
    taken = []
    for index, weight in enumerate(normal.weights):
        before, after = (residuals(normal.stack, fit, index) for fit in (without, whole))
        taken += [weight * float(part.sum()) for part in np.array_split(before**2 - after**2, STRETCHES)]
    return np.asarray(taken)


def transferred(normal: Normal, evidence: Evidence, fit: Fit) -> Fit:
    """A fit tried on other runs: the coefficients that all runs share stay, those of a single run are fitted anew.

    normal : of the other runs.
    evidence : of the runs that the fit was made to.
    """
    known: dict[Column, float] = {
        evidence.stack.names[place]: float(value) for place, value in zip(fit.columns, fit.values, strict=True)
    }
    names = normal.stack.names
    places = np.asarray([k for k, name in enumerate(names) if name in known and not own(name)], np.intp)
    free = np.asarray([k for k, name in enumerate(names) if own(name)], np.intp)
    coefficients = np.asarray([known[names[k]] for k in places])
    right = normal.right - normal.gram[:, places] @ coefficients
    misfit = normal.total - 2 * coefficients @ normal.right[places]
    misfit += coefficients @ normal.gram[np.ix_(places, places)] @ coefficients
    block = normal.gram[np.ix_(free, free)]
    values = np.linalg.solve(block + 1e-12 * np.diag(np.diag(block)), right[free])
    misfit -= right[free] @ values
    columns = np.concatenate([places, free])
    not_known = np.full((len(columns), len(columns)), np.nan)
    return Fit(columns, np.concatenate([coefficients, values]), not_known, float(misfit), {})


def own(name: Column) -> bool:
    """Whether a column belongs to one run alone."""
    return (name[0] == "nuisance" and name[1] != "") or (name[0] == "effect" and name[3].startswith("start of"))
