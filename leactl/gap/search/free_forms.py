"""What a set of effects misses over the variables that its members act over, measured on the case itself.

A member's law is not the machine's to the last digit. What a member explains may therefore be multiplied by a free
piecewise linear function of each variable that it acts over. Beside such free forms, an effect that only stands in for
what another's law misses has little left to explain.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from leactl.gap.search.regression import Candidate, Column, Fit, Normal, Rows, stack
from leactl.gap.signals.state import hats, variable_in
from leactl.vocabulary.effect import effect_definition
from leactl.vocabulary.variable import Variable

Array = npt.NDArray[np.float64]
KNOTS = 8  # of a free function, at quantiles of its variable where the member acts
FEWEST_KNOTS = 4  # with fewer a variable takes a few values only, as a direction does: no function of it says more
ACTS = 1e-3  # of a member's largest part in some rows, from which on it acts
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
    free, count = freed(normal, wider, hypothesis)
    both = free.fit(wider).misfit
    by_candidate, by_forms = free.fit(hypothesis).misfit - both, normal.fit(wider).misfit - both
    return count == 0 or by_candidate > OUTDONE * max(by_forms, float(count))


def missed_by_form(normal: Normal, hypothesis: Sequence[Candidate], member: Candidate) -> float:
    """Weighted squares that a member of a set would explain further by its free form, beyond noise.

    Infinite where it has none: nobody knows what its form misses then.
    """
    free, count = freed(normal, hypothesis, [member])
    return max(normal.fit(hypothesis).misfit - free.fit(hypothesis).misfit - count, 0.0) if count else math.inf


def freed(normal: Normal, hypothesis: Sequence[Candidate], members: Sequence[Candidate]) -> tuple[Normal, int]:
    """Normal equations of a set's columns with the free forms of some members, and how many coefficients these have."""
    fit = normal.fit(hypothesis)
    rows = [with_effects_alone(one, hypothesis) for one in normal.stack.rows]
    count = 0
    for member in members:
        parts = [part_of(one, normal, fit, member) for one in rows]
        for variable in effect_definition(member[0]).acts_over:
            count += add_free_form(rows, parts, member, variable)
            if variable == "angle":
                count += add_free_form(rows, parts, member, variable, within_a_turn=True)
    places = {name[1]: place for name, place in normal.stack.place.items() if name[0] == "calibration"}
    priors = {parameter: float(normal.stack.priors[place]) for parameter, place in places.items()}
    return Normal(stack(rows, priors), normal.weights), count


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

    One function less than there are knots, since all together are the member itself.

    Parameters
    ----------
    several : rows that get columns.
    parts : what the member explains of each.
    within_a_turn : whether an angle counts from turn to turn anew; no function of its own where no run turns that far.

    Returns
    -------
    int : how many coefficients; none where no run shows the variable, or it takes a few values only.
    """
    over: dict[int, Array] = {}
    for index, (rows, part) in enumerate(zip(several, parts, strict=True)):
        values = variable_in(variable, rows.equation, rows.signals)
        if values is not None and part.any():
            over[index] = values[rows.index]
    if within_a_turn:
        over = {index: values % TURN for index, values in over.items() if np.ptp(values) > TURN}
    if not over:
        return 0
    where_it_acts = [values[np.abs(parts[k]) > ACTS * np.abs(parts[k]).max()] for k, values in over.items()]
    knots = np.unique(np.quantile(np.concatenate(where_it_acts), np.linspace(0.0, 1.0, KNOTS)))
    if len(knots) < FEWEST_KNOTS:
        return 0
    called = f"{variable} within a turn" if within_a_turn else variable
    for index, values in over.items():
        for count, function in enumerate(hats(values, knots)[:, 1:].T):
            name: Column = ("effect", member[0], repr(member[1]), f"free over {called} {count}")
            several[index].columns[name] = parts[index] * function
    return len(knots) - 1
