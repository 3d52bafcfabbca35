"""Fitted stamps of unknown meaning, and the limit of their delay: a longer delay belongs to the machine."""

import math
from collections.abc import Collection, Sequence

import numpy as np
import numpy.typing as npt

from leactl.gap.search.regression import Candidate, Fit, Rows, Stack
from leactl.gap.signals.stamps import BETWEEN_SAMPLES, TAPS, lateness, tap_name

Array = npt.NDArray[np.float64]
# samples on either side: of each of two channels, of an input that is held, and of a loop that is sampled
SIDE_DELAYS = (1.0, 1.0, 0.5, 0.5)
MOST_STAMP_DELAY = sum(SIDE_DELAYS)
# samples, standard deviation of their sum, each uniform over its range
STAMP_DELAY_STD = math.sqrt(sum(each**2 for each in SIDE_DELAYS) / 3.0)
LEAST_OVERDUE_STDS = 2.0  # standard deviations beyond `MOST_STAMP_DELAY` from which an equation is overdue
PIVOT_SHIFT = 1  # neighbour whose weight follows from the weights of the others where neither side is late


def stamp_weights(stack: Stack, fit: Fit) -> dict[str, tuple[Array, Array]]:
    """Return the fitted weights of neighbours and their covariance, by equation with channels of unknown stamps."""
    index_of = {stack.names[column]: index for index, column in enumerate(fit.columns)}
    ending = tap_name("", int(TAPS[0]))
    by_equation = {}
    for name in index_of:
        if name[0] == "nuisance" and name[-1].endswith(ending):
            equation = name[-1].removesuffix(ending)
            index_of_shift = {
                shift: index_of.get(("nuisance", "", tap_name(equation, shift))) for shift in TAPS.tolist()
            }
            free = [shift for shift, index in index_of_shift.items() if index is not None]
            values = [index for index in index_of_shift.values() if index is not None]
            full_from_free = np.eye(len(TAPS))[:, np.isin(TAPS, free)]
            if index_of_shift[PIVOT_SHIFT] is None:
                full_from_free[TAPS == PIVOT_SHIFT] = -np.array(free, np.float64) / PIVOT_SHIFT
            covariance = fit.covariance[np.ix_(values, values)]
            by_equation[equation] = full_from_free @ fit.values[values], full_from_free @ covariance @ full_from_free.T
    return by_equation


def overdue_equations(stack: Stack, fit: Fit) -> tuple[str, ...]:
    """Return the equations with a fitted delay between their sides beyond what stamps can explain."""
    return tuple(
        equation
        for equation, (weights, covariance) in stamp_weights(stack, fit).items()
        if abs(lateness(weights)) - LEAST_OVERDUE_STDS * float(np.sqrt(TAPS @ covariance @ TAPS)) > MOST_STAMP_DELAY
    )


def delay_of_stamps(stack: Stack, on_time: Collection[str], candidate: Candidate) -> float:
    """Return the delay [s] that stamps may explain in the equations where an effect acts; zero where none.

    Stamps of unknown meaning may be up to `MOST_STAMP_DELAY` samples late. Where a servo inside the drive moves a
    reference between samples, the time of a setpoint is known to half an interval; the run that knows it best counts.

    on_time : overdue equations, whose whole delay belongs to effects.
    """
    form = (candidate[0], repr(candidate[1]))
    acting = [rows for rows in stack.rows if any(name[1:3] == form for name in rows.columns)]
    stamp_delays = [
        MOST_STAMP_DELAY * rows.signals.interval
        for rows in acting
        if rows.equation not in on_time and ("nuisance", "", tap_name(rows.equation, PIVOT_SHIFT)) in rows.columns
    ]
    interval_delays = [rows.priors.get(("nuisance", rows.run, BETWEEN_SAMPLES), 0.0) for rows in acting]
    return max(*stamp_delays, min(interval_delays, default=0.0), 0.0)


def put_on_time(rows: Sequence[Rows], equations: Collection[str]) -> None:
    """Remove the delay from the stamp weights of some equations; means and held inputs remain.

    Stamps may still explain a part of the delay, early or late; no run determines it, and zero is its mean.
    """
    for equation in equations:
        names = {shift: ("nuisance", "", tap_name(equation, shift)) for shift in TAPS.tolist()}
        for group in rows:
            if names[PIVOT_SHIFT] in group.columns:
                pivot = group.columns.pop(names[PIVOT_SHIFT])
                group.priors.pop(names[PIVOT_SHIFT])
                for shift, name in names.items():
                    if shift != PIVOT_SHIFT:
                        group.columns[name] = group.columns[name] - shift / PIVOT_SHIFT * pivot
                group.gram = None
