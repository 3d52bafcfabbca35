"""What the laws of a set of effects miss of the machine, measured on the case itself.

A law is not the machine's to the last digit. What a member of a set explains may therefore be multiplied by a free
piecewise linear function of each variable in which the effect acts: its free forms. An effect that only stands in for
what another's law misses has little left to explain beside them.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from leactl.gap.search.regression import Candidate, Column, Fit, Normal, Rows, stack
from leactl.gap.signals.effect_variables import hats, variable_in
from leactl.vocabulary.effect import effect_definition
from leactl.vocabulary.variable import Variable

Array = npt.NDArray[np.float64]
KNOTS = 8  # of a free function
FEWEST_VALUES = 4  # a variable that takes fewer, as a direction does, tells nothing of a law's form
SMALLEST_PART = 1e-3  # of a member's largest part in a run; rows with less of it do not place the knots
TURN = 2.0 * np.pi
OUTDONE = 2.0  # times more that a further effect must explain than the free forms, each beside the other


def outdoes_free_forms(normal: Normal, hypothesis: Sequence[Candidate], candidate: Candidate) -> bool:
    """Whether a candidate explains `OUTDONE` times as much as the free forms of a set, each beside the other.

    What one explains is by how much the misfit of both together grows without it. Free forms count for no less than
    noise lets so many coefficients explain. Where a set has no free form, nothing is to be outdone.
    """
    if not hypothesis:
        return True
    wider = [*hypothesis, candidate]
    # The parts are those that members explain beside the candidate, with which alone the whole is right.
    free, count = with_free_forms(normal, wider, hypothesis)
    both = free.fit(wider).misfit
    by_candidate, by_forms = free.fit(hypothesis).misfit - both, normal.fit(wider).misfit - both
    return count == 0 or by_candidate > OUTDONE * max(by_forms, float(count))


def missed_by_form(normal: Normal, hypothesis: Sequence[Candidate], member: Candidate) -> float:
    """Weighted squares that a member of a set would explain further by its free forms, beyond noise.

    Infinite where it has none, or is fitted to nothing at all: nobody knows what its law misses then.
    """
    free, count = with_free_forms(normal, hypothesis, [member])
    return max(normal.fit(hypothesis).misfit - free.fit(hypothesis).misfit - count, 0.0) if count else math.inf


def with_free_forms(
    normal: Normal, hypothesis: Sequence[Candidate], members: Sequence[Candidate]
) -> tuple[Normal, int]:
    """Normal equations of a set's columns and the free forms of some members, and how many coefficients these have."""
    fit = normal.fit(hypothesis)
    several = [with_effects_alone(rows, hypothesis) for rows in normal.stack.rows]
    count = 0
    for member in members:
        parts = [part_of(rows, normal, fit, member) for rows in several]
        for variable in effect_definition(member[0]).acts_over:
            count += add_free_form(several, parts, member, variable)
            if variable == "angle":
                count += add_free_form(several, parts, member, variable, within_a_turn=True)
    places = {name[1]: place for name, place in normal.stack.place.items() if name[0] == "calibration"}
    priors = {parameter: float(normal.stack.priors[place]) for parameter, place in places.items()}
    return Normal(stack(several, priors), normal.weights), count


def with_effects_alone(rows: Rows, hypothesis: Sequence[Candidate]) -> Rows:
    """Rows with no other effects' columns than those of a set."""
    wanted = {(effect, repr(form)) for effect, form in hypothesis}
    columns = {name: column for name, column in rows.columns.items() if name[0] != "effect" or name[1:3] in wanted}
    return replace(rows, columns=columns, gram=None)


def part_of(rows: Rows, normal: Normal, fit: Fit, member: Candidate) -> Array:
    """What a member explains of some rows under a fit, row by row."""
    explained = np.zeros(len(rows.left_over))
    for place, value in zip(fit.columns, fit.values, strict=True):
        name = normal.stack.names[place]
        if name[:3] == ("effect", member[0], repr(member[1])) and name in rows.columns:
            explained += value * rows.columns[name]
    return explained


def add_free_form(
    several: Sequence[Rows],
    parts: Sequence[Array],
    member: Candidate,
    variable: Variable,
    within_a_turn: bool = False,
) -> int:
    """Put a member's parts, times functions of one variable, beside its columns as further coefficients of it.

    Where every run shows the variable, one function less than there are knots: all together are the member itself.

    Parameters
    ----------
    several : rows that get columns.
    parts : what the member explains of each.
    within_a_turn : whether an angle counts from turn to turn anew; no function of its own where no run turns so far.

    Returns
    -------
    int : how many coefficients; none where no run shows the variable, or it takes a few values only.
    """
    shown: dict[int, Array] = {}
    for index, (rows, part) in enumerate(zip(several, parts, strict=True)):
        values = variable_in(variable, rows.equation, rows.signals)
        if values is not None and part.any():
            shown[index] = values[rows.index]
    if within_a_turn:
        turns = any(np.ptp(values) > TURN for values in shown.values())
        shown = {index: values % TURN for index, values in shown.items()} if turns else {}
    if not shown:
        return 0
    knots = knots_where([values[acts_in(parts[index])] for index, values in shown.items()])
    if within_a_turn and knots.size and knots[0] + TURN - knots[-1] < 0.5 * TURN / KNOTS:
        knots = knots[:-1]  # the last is nearly the first again, a turn on
    if not knots.size:
        return 0
    elsewhere = any(part.any() for index, part in enumerate(parts) if index not in shown)
    free_over = f"{variable} within a turn" if within_a_turn else variable
    functions = range(0 if elsewhere else 1, len(knots))
    for index, values in shown.items():
        at_knots = hats(values, knots, TURN if within_a_turn else None)
        for number in functions:
            name: Column = ("effect", member[0], repr(member[1]), f"free over {free_over} {number}")
            several[index].columns[name] = parts[index] * at_knots[:, number]
    return len(functions)


def acts_in(part: Array) -> npt.NDArray[np.bool_]:
    """The rows in which a member's part is not negligible."""
    return np.asarray(np.abs(part) > SMALLEST_PART * np.abs(part).max(), np.bool_)


def knots_where(runs: Sequence[Array]) -> Array:
    """Knots of a free function of a variable, from its values in the rows of each run; none where these are few.

    Quantiles of the different values: one that many rows have to the last digit counts once.
    """
    values = np.unique(np.concatenate(runs))
    if len(values) < FEWEST_VALUES:
        return np.empty(0)
    if len(values) <= KNOTS:
        return values
    return np.quantile(values, np.linspace(0.0, 1.0, KNOTS))
