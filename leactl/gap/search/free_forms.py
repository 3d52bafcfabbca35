"""Measure the errors of effects' laws on the case itself, by free forms.

A law does not describe a machine exactly. The part that a member of a set explains may therefore be multiplied by a
free piecewise linear function of each variable in which the effect acts: its free forms. An effect that only
compensates for the error of another's law explains little in addition to them.
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
KNOTS = 8  # largest number of knots of a free function
FEWEST_VALUES = 4  # distinct values of a variable; one with fewer, as a direction, shows nothing of a law's form
LEAST_PART_SHARE = 1e-3  # share of a member's largest part in a run below which a row does not place knots
TURN = 2.0 * np.pi  # rad
# ratio of what an effect explains to what free forms explain, each beside the other, above which it outdoes them
OUTDOING_RATIO = 2.0


def outdoes_free_forms(normal: Normal, hypothesis: Sequence[Candidate], candidate: Candidate) -> bool:
    """Return whether a candidate explains more than the free forms of a set by `OUTDOING_RATIO`, each beside the other.

    What either explains is the rise in misfit when it is removed from the fit with both; of the free forms, in the rows
    that hold a column of the candidate: it does not compensate for a law's error anywhere else. Free forms count at
    least as much as noise lets so many coefficients explain. True also for a set without a free form.
    """
    if not hypothesis:
        return True
    set_and_candidate = [*hypothesis, candidate]
    # the parts of the members are those fitted beside the candidate, since only the whole set may be right
    free_normal, count = with_free_forms(normal, set_and_candidate, hypothesis)
    fit_of_both, fit_without_forms = (equations.fit(set_and_candidate) for equations in (free_normal, normal))
    explained_by_candidate = free_normal.fit(hypothesis).misfit - fit_of_both.misfit
    explained_by_forms = sum(
        normal.weights[index]
        * len(rows.left_over)
        * (normal.residual_rms(fit_without_forms, index) ** 2 - free_normal.residual_rms(fit_of_both, index) ** 2)
        for index, rows in enumerate(normal.stack.rows)
        if any(name[:3] == ("effect", candidate[0], repr(candidate[1])) for name in rows.columns)
    )
    return count == 0 or explained_by_candidate > OUTDOING_RATIO * max(explained_by_forms, float(count))


def missed_by_form(normal: Normal, hypothesis: Sequence[Candidate], member: Candidate) -> float:
    """Return the weighted squares that free forms of a member explain in addition, beyond noise.

    They are infinite where the member has no free form: the error of its law is then unknown.
    """
    free_normal, count = with_free_forms(normal, hypothesis, [member])
    return max(normal.fit(hypothesis).misfit - free_normal.fit(hypothesis).misfit - count, 0.0) if count else math.inf


def with_free_forms(
    normal: Normal, hypothesis: Sequence[Candidate], members: Sequence[Candidate]
) -> tuple[Normal, int]:
    """Return the normal equations with the free forms of some members, and the number of their coefficients."""
    fit = normal.fit(hypothesis)
    groups = [with_effects_alone(rows, hypothesis) for rows in normal.stack.rows]
    count = 0
    for member in members:
        parts_of_groups = [explained_part(rows, normal, fit, member) for rows in groups]
        for variable in effect_definition(member[0]).acts_over:
            count += add_free_form(groups, parts_of_groups, member, variable)
            if variable == "angle":
                count += add_free_form(groups, parts_of_groups, member, variable, within_a_turn=True)
    positions = {name[1]: position for name, position in normal.stack.position_of.items() if name[0] == "calibration"}
    priors = {parameter: float(normal.stack.priors[position]) for parameter, position in positions.items()}
    return Normal(stack(groups, priors), normal.weights), count


def with_effects_alone(rows: Rows, hypothesis: Sequence[Candidate]) -> Rows:
    """Return rows without the columns of effects outside a set, and without a Gram matrix."""
    effects_and_forms = {(effect, repr(form)) for effect, form in hypothesis}
    columns = {
        name: column for name, column in rows.columns.items() if name[0] != "effect" or name[1:3] in effects_and_forms
    }
    return replace(rows, columns=columns, gram=None)


def explained_part(rows: Rows, normal: Normal, fit: Fit, member: Candidate) -> Array:
    """Return the part of some rows' left-over that a member explains under a fit."""
    explained = np.zeros(len(rows.left_over))
    for column, value in zip(fit.columns, fit.values, strict=True):
        name = normal.stack.names[column]
        if name[:3] == ("effect", member[0], repr(member[1])) and name in rows.columns:
            explained += value * rows.columns[name]
    return explained


def add_free_form(
    groups: Sequence[Rows],
    parts_of_groups: Sequence[Array],
    member: Candidate,
    variable: Variable,
    within_a_turn: bool = False,
) -> int:
    """Add columns to a member, its parts times hat functions of one variable; return the number of its coefficients.

    If every run shows the variable, the first hat function is left out, because the hat functions sum to one and their
    products with the member's part to that part itself.

    Parameters
    ----------
    groups : groups of rows that get columns.
    parts_of_groups : the part of each group that the member explains.
    within_a_turn : whether an angle is folded into one turn; no column is added where no run turns farther than that.

    Returns
    -------
    int : number of coefficients; 0 where no run shows the variable, or it has few values.
    """
    values_by_group: dict[int, Array] = {}
    for index, (rows, part_of_group) in enumerate(zip(groups, parts_of_groups, strict=True)):
        values = variable_in(variable, rows.equation, rows.signals)
        if values is not None and part_of_group.any():
            values_by_group[index] = values[rows.index]
    if within_a_turn:
        exceeds_a_turn = any(np.ptp(values) > TURN for values in values_by_group.values())
        values_by_group = {index: values % TURN for index, values in values_by_group.items()} if exceeds_a_turn else {}
    if not values_by_group:
        return 0
    knots = knots_where([values[acts_in(parts_of_groups[index])] for index, values in values_by_group.items()])
    if within_a_turn and knots.size and knots[0] + TURN - knots[-1] < 0.5 * TURN / KNOTS:
        knots = knots[:-1]  # the last knot nearly coincides with the first, one turn later
    if not knots.size:
        return 0
    acts_elsewhere = any(
        part_of_group.any() for index, part_of_group in enumerate(parts_of_groups) if index not in values_by_group
    )
    free_over = f"{variable} within a turn" if within_a_turn else variable
    hat_indices = range(0 if acts_elsewhere else 1, len(knots))
    for index, values in values_by_group.items():
        hat_values = hats(values, knots, TURN if within_a_turn else None)
        for hat_index in hat_indices:
            name: Column = ("effect", member[0], repr(member[1]), f"free over {free_over} {hat_index}")
            groups[index].columns[name] = parts_of_groups[index] * hat_values[:, hat_index]
    return len(hat_indices)


def acts_in(part: Array) -> npt.NDArray[np.bool_]:
    """Return the mask of the rows in which a member's part is not negligible."""
    return np.asarray(np.abs(part) > LEAST_PART_SHARE * np.abs(part).max(), np.bool_)


def knots_where(values_of_runs: Sequence[Array]) -> Array:
    """Return the knots of a free function of a variable; empty for fewer than `FEWEST_VALUES` distinct values.

    The knots are quantiles of the distinct values.

    values_of_runs : values of the variable in each run.
    """
    levels = np.unique(np.concatenate(values_of_runs))
    if len(levels) < FEWEST_VALUES:
        return np.empty(0)
    if len(levels) <= KNOTS:
        return levels
    return np.quantile(levels, np.linspace(0.0, 1.0, KNOTS))
