"""What was learnt from some runs, tried on others: does an effect still take something away where it was not fitted?"""

from collections.abc import Sequence

import numpy as np

from leactl.gap.search.evidence import Evidence
from leactl.gap.search.regression import Candidate, Column, Fit, Normal
from leactl.gap.signals.record import Record


def held_out_gains(evidence: Evidence, hypothesis: Sequence[Candidate], held_out: Sequence[Record]) -> list[float]:
    """Weighted squares that each member takes away on held-out runs, its parameters and all others kept as fitted.

    What belongs to a run alone, such as where its lock stands, is fitted there. NaN where these runs cannot tell.
    """
    if not held_out or not hypothesis:
        return [np.nan] * len(hypothesis)
    others = Evidence(held_out, evidence.model, only=list(hypothesis), pinned=evidence.pinned)
    if not others.stack.rows:
        return [np.nan] * len(hypothesis)
    evidence.settle(hypothesis)
    whole = others_misfit(others, evidence, evidence.normal().fit(hypothesis), hypothesis, weigh=True)
    gains = []
    for index in range(len(hypothesis)):
        if len(others.columns(hypothesis[index])) == 0:
            gains.append(np.nan)
            continue
        rest = [*hypothesis[:index], *hypothesis[index + 1 :]]
        gains.append(others_misfit(others, evidence, evidence.normal().fit(rest), rest, weigh=False) - whole)
    return gains


def others_misfit(
    others: Evidence, evidence: Evidence, fit: Fit, hypothesis: Sequence[Candidate], weigh: bool
) -> float:
    """Misfit of other runs with the shared coefficients of a fit; the runs' own nuisances are free."""
    if weigh:
        others.settle(hypothesis)
    return transferred(others.normal(), evidence, fit).misfit


def transferred(normal: Normal, evidence: Evidence, fit: Fit) -> Fit:
    """The shared coefficients of a fit on other runs, whose own nuisances are free."""
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
