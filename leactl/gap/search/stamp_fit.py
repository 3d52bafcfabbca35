"""Fitted stamps of unknown meaning, and the limit of their delay: a longer delay belongs to the machine."""

import math
from collections.abc import Collection, Sequence

import numpy as np
import numpy.typing as npt

from leactl.gap.search.regression import Candidate, Fit, Rows, Stack
from leactl.gap.signals.stamps import BETWEEN_SAMPLES, TAPS, lateness_of, tap_name

Array = npt.NDArray[np.float64]
# samples by which the sides of an equation may differ, early or late: by the stamps of each of two channels, by an
# input that is held, and by a loop that is sampled
STAMP_DELAY_BOUNDS = (1.0, 1.0, 0.5, 0.5)
MOST_STAMP_DELAY = sum(STAMP_DELAY_BOUNDS)  # samples
# samples, standard deviation of their sum, each uniform over its range
STAMP_DELAY_STD = math.sqrt(sum(bound**2 for bound in STAMP_DELAY_BOUNDS) / 3.0)
LEAST_OVERDUE_STDS = 2.0  # standard deviations beyond `MOST_STAMP_DELAY` from which an equation is overdue
PIVOT_SHIFT = 1  # samples; in an equation that is put on time, the others' weights determine this neighbour's


def stamp_weights(stack: Stack, fit: Fit) -> dict[str, tuple[Array, Array]]:
    """Return the fitted weights of neighbouring samples and their covariance, by equation with unknown stamps.

    Both are in the order of `TAPS`: shapes (taps,) and (taps, taps).
    """
    index_of = {stack.names[column]: index for index, column in enumerate(fit.columns)}
    suffix = tap_name("", int(TAPS[0]))
    by_equation = {}
    for name in index_of:
        if name[0] == "nuisance" and name[-1].endswith(suffix):
            equation = name[-1].removesuffix(suffix)
            index_of_shift = {
                shift: index_of.get(("nuisance", "", tap_name(equation, shift))) for shift in TAPS.tolist()
            }
            free_shifts = [shift for shift, index in index_of_shift.items() if index is not None]
            positions = [index for index in index_of_shift.values() if index is not None]
            full_from_free = np.eye(len(TAPS))[:, np.isin(TAPS, free_shifts)]
            if index_of_shift[PIVOT_SHIFT] is None:
                full_from_free[TAPS == PIVOT_SHIFT] = -np.array(free_shifts, np.float64) / PIVOT_SHIFT
            covariance = fit.covariance[np.ix_(positions, positions)]
            by_equation[equation] = (
                full_from_free @ fit.values[positions],
                full_from_free @ covariance @ full_from_free.T,
            )
    return by_equation


def overdue_equations(stack: Stack, fit: Fit) -> tuple[str, ...]:
    """Return the equations with a fitted delay between their sides beyond what stamps can explain."""
    return tuple(
        equation
        for equation, (weights, covariance) in stamp_weights(stack, fit).items()
        if abs(lateness_of(weights)) - LEAST_OVERDUE_STDS * float(np.sqrt(TAPS @ covariance @ TAPS)) > MOST_STAMP_DELAY
    )


def delay_of_stamps(stack: Stack, on_time: Collection[str], candidate: Candidate) -> float:
    """Return the delay [s] that stamps may explain in the equations where an effect acts; zero if they explain none.

    Stamps of unknown meaning may be up to `MOST_STAMP_DELAY` samples late. Where a servo inside the drive moves a
    reference between samples, the time of a setpoint is known to half an interval; the run with the shortest interval
    counts.

    on_time : overdue equations: their whole delay belongs to effects.
    """
    effect_and_form = (candidate[0], repr(candidate[1]))
    acting_rows = [rows for rows in stack.rows if any(name[1:3] == effect_and_form for name in rows.columns)]
    stamp_delays = [
        MOST_STAMP_DELAY * rows.signals.interval
        for rows in acting_rows
        if rows.equation not in on_time and ("nuisance", "", tap_name(rows.equation, PIVOT_SHIFT)) in rows.columns
    ]
    interval_delays = [rows.priors.get(("nuisance", rows.run, BETWEEN_SAMPLES), 0.0) for rows in acting_rows]
    return max(*stamp_delays, min(interval_delays, default=0.0), 0.0)


def put_on_time(rows: Sequence[Rows], equations: Collection[str]) -> None:
    """Remove the delay from the stamp weights of some equations; means and held inputs remain.

    Stamps may still explain a part of the delay, of either sign; no run determines that part, and its mean is zero.
    """
    for equation in equations:
        column_of_shift = {shift: ("nuisance", "", tap_name(equation, shift)) for shift in TAPS.tolist()}
        for group in rows:
            if column_of_shift[PIVOT_SHIFT] in group.columns:
                pivot_column = group.columns.pop(column_of_shift[PIVOT_SHIFT])
                group.priors.pop(column_of_shift[PIVOT_SHIFT])
                for shift, name in column_of_shift.items():
                    if shift != PIVOT_SHIFT:
                        group.columns[name] = group.columns[name] - shift / PIVOT_SHIFT * pivot_column
                group.gram = None
