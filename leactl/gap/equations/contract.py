"""An equation of the bench on one run: what the nominal model leaves over, and what may explain it.

`left_over = sum(calibration x relative change) + sum(nuisance) + what effects put into its places + noise`, sample by
sample at the run's rate; `width` and `step` say how it is smoothed and thinned before it becomes rows of a regression.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from leactl.effects.contract import Signals
from leactl.gap.signals.smoothing import thinned

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Place = Callable[[Array], Array]

FEWEST_ROWS = 20  # of an equation, that a run tells something with
MEMORY = 60  # rows, within which one may depend on another where an equation does not say
TOUCHED = 1e-3  # of a row's weight, from which it touches samples
STAMPED = 0.05  # of an interval, to which two channels of one sample are of one moment


@dataclass
class Equation:
    """One equation on one run."""

    name: str
    quantity: str  # the channel whose gap it is
    role: str
    units: str
    left_over: Array
    signals: Signals
    mask: Mask  # samples that may be used: a row touches no other
    places: dict[str, Place]
    calibration: dict[str, Array]
    nuisance: dict[str, tuple[Array, float]] = field(default_factory=dict)  # column and prior standard deviation
    shared: dict[str, tuple[Array, float]] = field(default_factory=dict)  # nuisances that all runs have in common
    rounding: float = 0.0  # standard deviation that a channel's rounding gives a row
    levels: float = math.inf  # that a rounded channel takes: no more independent values than that are in its rows
    kind: str = ""  # of the runs that its rows are weighed together with; the run's own where left out
    width: float = 4.0
    step: int = 8
    memory: int = MEMORY  # rows, within which one may depend on another
    around: Mask | None = None  # samples of which a row touches one, where not all rows count
    rough: bool = False  # whether it neglects so much that what it leaves over is no sign of anything


def usable(equation: Equation) -> Mask:
    """Which rows of an equation touch no sample but those of `mask`, and at least one of those of `around`."""
    rows = thinned(equation.mask.astype(float), equation.width, equation.step) > 1.0 - TOUCHED
    if equation.around is not None:
        rows &= thinned(equation.around.astype(float), equation.width, equation.step) >= TOUCHED
    return np.asarray(rows)
