"""An equation of the bench on one run: the residual of the nominal model, and the columns that may explain it.

`left_over = sum(calibration x relative change) + sum(nuisance) + effects in its places + noise`, sample by sample at
the run's rate; `width` and `step` give its smoothing and thinning to rows of a regression.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from leactl.effects.contract import Signals
from leactl.gap.signals.smoothing import smoothed_and_thinned

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Place = Callable[[Array], Array]

FEWEST_ROWS = 20  # rows of an equation that a run needs
MEMORY_ROWS = 60  # rows over which residuals of an equation may be correlated, unless the equation says otherwise
LEAST_TOUCHED_SHARE = 1e-3  # share of a row's smoothing weight on some samples from which it depends on them
STAMP_TOLERANCE = 0.05  # intervals, prior standard deviation of the time between two channels of one sample


@dataclass
class Equation:
    """One equation on one run."""

    name: str
    quantity: str  # the channel whose gap it is
    role: str
    units: str
    left_over: Array  # residual of the nominal model at each sample
    signals: Signals
    mask: Mask  # usable samples: a row touches no other samples
    places: dict[str, Place]  # by place: the contribution of an effect's column there to the left-over
    calibration: dict[str, Array]  # by parameter: the column of its relative change
    nuisance: dict[str, tuple[Array, float]] = field(default_factory=dict)  # column and prior standard deviation
    shared: dict[str, tuple[Array, float]] = field(default_factory=dict)  # nuisances common to all runs
    rounding: float = 0.0  # standard deviation of a row due to the rounding of a channel
    levels: float = math.inf  # number of levels of a rounded channel: so many rows can be independent
    kind: str = ""  # kind of runs whose rows are weighted together; that of the run where empty
    width: float = 4.0  # samples, Gaussian width of the smoothing of rows
    step: int = 8  # samples from one row to the next
    memory: int = MEMORY_ROWS  # rows within which one may depend on another
    touched: Mask | None = None  # samples of which a row has to touch one; None where all rows count
    rough: bool = False  # whether the equation neglects so much that its residual cannot be judged


def usable_rows(equation: Equation) -> Mask:
    """Return the rows of an equation that touch only samples of `mask`, and at least one of `touched`."""
    is_usable = (
        smoothed_and_thinned(equation.mask.astype(float), equation.width, equation.step) > 1.0 - LEAST_TOUCHED_SHARE
    )
    if equation.touched is not None:
        is_usable &= (
            smoothed_and_thinned(equation.touched.astype(float), equation.width, equation.step) >= LEAST_TOUCHED_SHARE
        )
    return np.asarray(is_usable)
