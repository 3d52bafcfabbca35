"""What a fit says of stamps that no file explains, and how late they can be: what is later is no matter of stamps."""

import math
from collections.abc import Collection, Sequence

import numpy as np
import numpy.typing as npt

from leactl.gap.search.regression import Candidate, Fit, Rows, Stack
from leactl.gap.signals.stamps import BETWEEN_SAMPLES, TAPS, lateness, tap_name

Array = npt.NDArray[np.float64]
EACH = (
    1.0,
    1.0,
    0.5,
    0.5,
)  # samples, to either side: of each channel, an input that is held and a loop that is sampled
LATEST = sum(EACH)
LATE_STD = math.sqrt(sum(each**2 for each in EACH) / 3.0)  # samples, of their sum where each may be any of its range
SURE = 2.0  # standard deviations beyond it
PIVOT = 1  # the neighbour whose weight follows from the others' where stamps are on time


def stamping(stack: Stack, fit: Fit) -> dict[str, tuple[Array, Array]]:
    """Weights of the neighbours in each equation whose channels' stamps are not told, and their covariance."""
    at = {stack.names[place]: index for index, place in enumerate(fit.columns)}
    ending = tap_name("", int(TAPS[0]))
    by_equation = {}
    for name in at:
        if name[0] == "nuisance" and name[-1].endswith(ending):
            equation = name[-1].removesuffix(ending)
            own = {by: at.get(("nuisance", "", tap_name(equation, by))) for by in TAPS.tolist()}
            free = [by for by, index in own.items() if index is not None]
            values = [index for index in own.values() if index is not None]
            spread = np.eye(len(TAPS))[:, np.isin(TAPS, free)]
            if own[PIVOT] is None:
                spread[TAPS == PIVOT] = -np.array(free, np.float64) / PIVOT
            covariance = fit.covariance[np.ix_(values, values)]
            by_equation[equation] = spread @ fit.values[values], spread @ covariance @ spread.T
    return by_equation


def overdue(stack: Stack, fit: Fit) -> tuple[str, ...]:
    """Equations of which a fit has one side later than stamps can be."""
    return tuple(
        equation
        for equation, (weights, covariance) in stamping(stack, fit).items()
        if abs(lateness(weights)) - SURE * float(np.sqrt(TAPS @ covariance @ TAPS)) > LATEST
    )


def delay_of_stamps(stack: Stack, on_time: Collection[str], candidate: Candidate) -> float:
    """Delay [s] that no run can tell from its samples in the equations where an effect acts; zero where none.

    Stamps that no file explains may be that late. Where a servo inside the drive moves a reference between samples, the
    moment of a setpoint is known to half an interval. The run that knows it best counts.

    on_time : equations one side of which is later than stamps can be, so that the whole of it is the effects'.
    """
    form = (candidate[0], repr(candidate[1]))
    acting = [rows for rows in stack.rows if any(name[1:3] == form for name in rows.columns)]
    late = [
        LATEST * rows.signals.interval
        for rows in acting
        if rows.equation not in on_time and ("nuisance", "", tap_name(rows.equation, PIVOT)) in rows.columns
    ]
    between = [rows.priors.get(("nuisance", rows.run, BETWEEN_SAMPLES), 0.0) for rows in acting]
    return max(*late, min(between, default=0.0), 0.0)


def put_on_time(rows: Sequence[Rows], equations: Collection[str]) -> None:
    """Leave to the stamps of some equations what makes neither side later: means, and inputs held or not.

    Some of the lateness may be the stamps' all the same; how much of it no run tells, and none is the middle of that.
    """
    for equation in equations:
        names = {by: ("nuisance", "", tap_name(equation, by)) for by in TAPS.tolist()}
        for one in rows:
            if names[PIVOT] in one.columns:
                pivot = one.columns.pop(names[PIVOT])
                one.priors.pop(names[PIVOT])
                for by, name in names.items():
                    if by != PIVOT:
                        one.columns[name] = one.columns[name] - by / PIVOT * pivot
                one.gram = None
