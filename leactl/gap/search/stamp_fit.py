"""What a fit says of stamps that no file explains, and how late they can be: what is later is no matter of stamps."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from leactl.gap.search.regression import Fit, Rows, Stack
from leactl.gap.signals.stamps import TAPS, lateness, tap_name

Array = npt.NDArray[np.float64]
LATEST = 3.0  # samples: one of each channel, half of one each for an input that is held and a loop that is sampled
SURE = 2.0  # standard deviations beyond it


def stamping(stack: Stack, fit: Fit) -> dict[str, tuple[Array, Array]]:
    """Weights of the neighbours in each equation whose channels' stamps are not told, and their covariance."""
    at = {stack.names[place]: index for index, place in enumerate(fit.columns)}
    ending = tap_name("", int(TAPS[0]))
    found = {}
    for name in at:
        if name[0] == "nuisance" and name[-1].endswith(ending):
            equation = name[-1].removesuffix(ending)
            taps = [at["nuisance", "", tap_name(equation, by)] for by in TAPS.tolist()]
            found[equation] = fit.values[taps], fit.covariance[np.ix_(taps, taps)]
    return found


def overdue(stack: Stack, fit: Fit) -> dict[str, Array]:
    """Weights that stay for good, by equation: as late as stamps can be where a fit has one side later than that."""
    found = {}
    for equation, (weights, covariance) in stamping(stack, fit).items():
        late = lateness(weights)
        if abs(late) - SURE * float(np.sqrt(TAPS @ covariance @ TAPS)) > LATEST:
            found[equation] = weights * LATEST / abs(late)
    return found


def pin(rows: Sequence[Rows], pinned: Mapping[str, Array]) -> None:
    """Take what pinned weights explain out of rows, and their columns with it."""
    for equation, weights in pinned.items():
        names = [("nuisance", "", tap_name(equation, by)) for by in TAPS.tolist()]
        for one in rows:
            if names[0] in one.columns:
                for name, weight in zip(names, weights, strict=True):
                    one.left_over = one.left_over - weight * one.columns.pop(name)
                    one.priors.pop(name)
                one.gram = None
