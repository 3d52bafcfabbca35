"""Search for a small set of effects, each in one form, that leaves the smallest residual; works on Gram matrices.

A step adds the effect whose columns reduce the misfit most beyond what recalibration can imitate. Then every member is
tried against every other effect with the other members held, so that an early wrong choice is corrected. The size an
effect must reach is measured against the size that sound machines simulated through the same runs give it
(`leactl.gap.null`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product
from operator import mul
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.effects import library
from leactl.effects.contract import Form
from leactl.gap.search.effect_regression import Evidence
from leactl.gap.search.free_forms import missed_by_form, outdoes_free_forms
from leactl.gap.search.regression import Candidate, Fit, Normal, Stack, gain_of
from leactl.gap.search.stamp_fit import delay_of_stamps
from leactl.vocabulary.effect import effect_definition

Array = npt.NDArray[np.float64]
MOST_EFFECTS = 3  # largest number of effects in a set
ENTRY_HEIGHT = 3.2  # smallest height of an effect that enters a set: its size over its floor and uncertainty
EQUAL_FIT_DIFFERENCE = 1e-3  # difference of twice a log likelihood below which two fits are equally good
MOST_EXCHANGE_ROUNDS = 4  # largest number of rounds of exchanging members
MOST_FORM_MOVES = 4  # largest number of moves of a form at each step size
STEP_SHARES = (1 / 3, 1 / 9, 1 / 27, 1 / 81)  # step sizes as shares of the grid's ratio, on a logarithmic scale
SCAN_STEPS = 8  # trials from one value of a narrow effect's grid to the next
MOST_ASCENT_STEPS = 8  # largest number of Newton steps from the best form of the last grid
LEAST_FORM_DIFFERENCE = 2.0  # weighted squares; forms whose gains differ by less cannot be told apart
NOISE_ROUNDS = (2, 0)  # rounds of estimating the noise from a set's residuals; 0 keeps the usual noise
MOST_SHORTLISTED = 4  # largest number of candidates of one ranking, or of rivals of a member, that are fitted
MOST_USUAL_POWER = 2.0  # largest residual power that counts as usual, in units of the usual noise power
WHOLE_ROUNDS = 2  # rounds of bringing shaped effects to the form with a strength of one
WAVE_COEFFICIENTS = ("cos", "sin")  # coefficients that make one amplitude
OVERTONES = (2.0, 3.0)  # multiples of its order that a machine's wave also contains
LOOSE_SHARE = 0.8  # share that an effect explains at least (`explains`), below which its columns count as loose
LOOSE_FORM_ERROR = 0.1  # `FORM_ERROR` for an effect with loose columns
TIE_SHARE = 1e-6  # share of its gain that an unusual effect loses against one with equal columns; far above rounding
RIVAL_FORM_ERROR = 0.005  # standard deviation, as a share of the gain, of the difference of two nearly right forms
CLOSE_RIVAL_FACTOR = 10.0  # multiple of `gain_tolerance` within which a rival's gain is close
UNSHOWN_SPRING_ODDS = 0.05  # prior odds, against an effect of constant direction, of a spring whose rest no run passes
FORM_ERROR = 0.03  # share of the explained squares that a set's forms may miss; 17 % of the amplitude
FORM_ERROR_ELSEWHERE = 0.01  # `FORM_ERROR` for an effect that acts over other variables
MOST_SIZE_RATIO = 2.0  # largest possible size over the largest of an effect's definition; a geared servo has 1.5
INTERVAL_STDS = 1.96  # standard deviations on either side that hold 95 %
STRENGTH_RANGE = (0.3, 3.0)  # possible fitted strength of a shaped effect; neighbouring forms differ by up to 2.1 times


@dataclass(frozen=True)
class FurtherEffect:
    """One effect fitted in addition to a base hypothesis."""

    candidate: Candidate
    gain: float  # weighted squares by which the effect lowers the misfit
    size: float  # in units of its leading parameter
    std: float  # standard error of the size
    values: tuple[float, ...]  # coefficients
    names: tuple[str, ...]  # of the coefficients
    covariance: Array  # of the coefficients
    floor: float  # size fitted to a sound machine, which has no effect
    by_chance: float = 0.0  # squared standard errors by which noise raises the best of the orders tried

    @property
    def effect(self) -> str:
        """The effect's name."""
        return self.candidate[0]

    @property
    def directed(self) -> Array:
        """Signed size; for a wave, the vector (cos, sin) whose length is the size."""
        return self._scale * np.asarray(self.values)[leading_positions(self.names)]

    @property
    def directed_variance(self) -> float:
        """Variance of `directed`, summed over its coefficients."""
        leading = leading_positions(self.names)
        return self._scale**2 * float(np.trace(self.covariance[np.ix_(leading, leading)]))

    @property
    def _scale(self) -> float:
        """Ratio of the size to the length of the vector of leading coefficients."""
        leading_values = np.asarray(self.values)[leading_positions(self.names)]
        return self.size / max(float(np.linalg.norm(leading_values)), 1e-300)

    @property
    def height(self) -> float:
        """Ratio of the size, less what noise gives the best of many orders, to its error and floor in quadrature."""
        size_beyond_chance = math.sqrt(max(self.size**2 - self.by_chance * self.std**2, 0.0))
        return size_beyond_chance / math.hypot(self.std, self.floor)


def fit_further_effect(
    evidence: Evidence,
    normal: Normal,
    base: npt.NDArray[np.intp],
    candidate: Candidate,
    at_full_strength: bool = False,
    any_size: bool = False,
) -> FurtherEffect | None:
    """Return the fit of one form of an effect in addition to a base; None where the fit is no possible effect.

    That is where no run shows the form, where the sign is impossible, and where the whole interval of the size lies
    outside the range in which the effect is met: another cause makes such a residual.

    base : columns of the base hypothesis.
    at_full_strength : whether a shaped effect counts at full strength, not at the fitted share of it.
    any_size : whether any sign and size is accepted.
    """
    columns = evidence.columns(candidate)
    if len(columns) == 0:
        return None
    gain, values, covariance = gain_of(normal, base, columns)
    effect = library()[candidate[0]]
    if not effect.is_usual(evidence.travel):
        gain *= 1.0 - TIE_SHARE
    if effect.one_sided and values[0] <= 0.0 and not any_size:
        return None
    if effect.shaped and not (
        covariance[0, 0] < STRENGTH_RANGE[1] ** 2 and (any_size or STRENGTH_RANGE[0] < values[0] < STRENGTH_RANGE[1])
    ):
        return None
    if effect.shaped and at_full_strength:
        gain = float((2.0 * values[0] - 1.0) / covariance[0, 0])  # at strength 1, not at the fitted one
    coefficient_names = tuple(evidence.coefficient(column) for column in columns)
    coefficients = dict(zip(coefficient_names, values.tolist(), strict=True))
    if not any_size and not effect.is_distinct(candidate[1], coefficients, evidence.visited):
        gain -= constant_torque_penalty(gain)
    if effect.shaped and any_size:
        coefficients[coefficient_names[0]] = min(abs(coefficients[coefficient_names[0]]), STRENGTH_RANGE[1])
    size = effect.size(candidate[1], coefficients, evidence.model)
    leading = leading_positions(coefficient_names)
    leading_values, leading_covariance = values[leading], covariance[np.ix_(leading, leading)]
    vector_length = max(float(np.linalg.norm(leading_values)), 1e-300)
    if not (np.isfinite(leading_values).all() and np.isfinite(leading_covariance).all()):
        return None
    direction = leading_values / vector_length
    std = size / vector_length * math.sqrt(max(float(direction @ leading_covariance @ direction), 0.0))
    floor = evidence.floor(candidate)
    if effect.delays:  # a delay within the uncertainty of stamps is no effect, however significant
        floor = max(floor, delay_of_stamps(evidence.stack, evidence.on_time, candidate) / ENTRY_HEIGHT)
    by_chance = 2.0 * math.log(effect.orders[1] - effect.orders[0] + 1) if effect.periodic else 0.0
    further = FurtherEffect(
        candidate, gain, size, std, tuple(values.tolist()), coefficient_names, covariance, floor, by_chance
    )
    return further if at_full_strength or any_size or is_possible(evidence, further) else None


def leading_positions(coefficient_names: Sequence[str]) -> list[int]:
    """Return the positions of the coefficients that define an effect's size: both of a wave, else the first."""
    return [k for k, name in enumerate(coefficient_names) if name in WAVE_COEFFICIENTS] or [0]


def gain_tolerance(gain: float) -> float:
    """Return the difference of two effects' gains that noise and inexact forms explain."""
    return 1.0 + RIVAL_FORM_ERROR * gain


def constant_torque_penalty(gain: float) -> float:
    """Return the gain that an effect loses by prior odds where the runs show it only as a constant torque."""
    return -2.0 * gain_tolerance(gain) * math.log(UNSHOWN_SPRING_ODDS)


def fit_each_alone(evidence: Evidence) -> dict[str, list[FurtherEffect | None]]:
    """Return the fits of every effect alone, with any sign, in each form of the grid; None where no run shows it."""
    normal, base = evidence.normal(), evidence.stack.columns_of([])
    fits: dict[str, list[FurtherEffect | None]] = {}
    for candidate in evidence.candidates:
        fits.setdefault(candidate[0], []).append(fit_further_effect(evidence, normal, base, candidate, any_size=True))
    return fits


def sizes_beyond_noise(name: str, fits: Sequence[FurtherEffect | None]) -> list[float]:
    """Return the size of an effect beyond noise in each form of the grid; empty where no form lowers the misfit.

    The size is measured in the form with the largest gain and scaled to the other forms by their standard errors: a
    form that the runs hardly show is large where one that they show well is small. A periodic effect has one size, that
    of its best order. Noise makes the best of many forms larger than a single one: the largest of n squares of unit
    variance is about 1 + 2 ln n.
    """
    effect = library()[name]
    best_fit = max((fit for fit in fits if fit is not None), key=lambda fit: fit.gain, default=None)
    if best_fit is None or best_fit.gain <= 0.0:
        return []
    count = effect.orders[1] - effect.orders[0] + 1 if effect.periodic else len(effect.forms)
    size_beyond_noise = math.sqrt(max(best_fit.size**2 - best_fit.std**2 * (1.0 + 2.0 * math.log(count)), 0.0))
    stds = [best_fit.std if fit is None or effect.periodic else fit.std for fit in fits]
    largest_size = MOST_SIZE_RATIO * effect_definition(name).largest
    sizes = [min(size_beyond_noise * std / best_fit.std, largest_size) for std in stds]
    return sizes[:1] if effect.periodic else sizes


def standard_errors(name: str, fits: Sequence[FurtherEffect | None]) -> list[float]:
    """Return the standard error of an effect by form, infinite where no run shows it; for a periodic one the least."""
    stds = [math.inf if fit is None else fit.std for fit in fits]
    return [min(stds)] if library()[name].periodic else stds


def is_possible(evidence: Evidence, further: FurtherEffect) -> bool:
    """Return whether an effect is met in the fitted size; a wave within noise is always possible."""
    if is_beyond_range(further) or further.size + INTERVAL_STDS * further.std < library()[further.effect].least:
        return False
    columns = evidence.columns(further.candidate)
    return further.height <= ENTRY_HEIGHT or not outweighs_equation(evidence.stack, columns, np.asarray(further.values))


def is_beyond_range(further: FurtherEffect) -> bool:
    """Return whether the whole interval of an effect's size lies beyond the range in which the effect is met."""
    return further.size - INTERVAL_STDS * further.std > MOST_SIZE_RATIO * effect_definition(further.effect).largest


def outweighs_equation(stack: Stack, columns: npt.NDArray[np.intp], values: Array) -> bool:
    """Return whether a wave over the angle is larger than all other parts of an equation together.

    Where the shaft hardly turns, such a wave is a straight line over the angle, and another cause makes it.
    """
    if not all(stack.names[column][3] in WAVE_COEFFICIENTS for column in columns):
        return False
    for gram, local in zip(stack.grams, stack.local, strict=True):
        wave_parts = 1 + np.flatnonzero(np.isin(local, columns))
        other_parts = [0, *(1 + k for k, column in enumerate(local) if stack.names[column][0] == "calibration")]
        power = np.diag(gram)
        if (
            len(other_parts) > 1
            and values @ values * power[wave_parts].sum() / 2.0 > np.sqrt(power[other_parts]).sum() ** 2
        ):
            return True
    return False


def best_of_each(
    evidence: Evidence, normal: Normal, hypothesis: Sequence[Candidate], at_full_strength: bool = False
) -> list[FurtherEffect]:
    """Return every effect that is not in a hypothesis, fitted in addition to it in its best form, by falling gain."""
    base = evidence.stack.columns_of(hypothesis)
    effects_in_set = {effect for effect, _ in hypothesis}
    best_by_effect: dict[str, FurtherEffect] = {}
    for candidate in evidence.candidates:
        if candidate[0] in effects_in_set:
            continue
        further = fit_further_effect(evidence, normal, base, candidate, at_full_strength)
        if further is not None and (
            candidate[0] not in best_by_effect or further.gain > best_by_effect[candidate[0]].gain
        ):
            best_by_effect[candidate[0]] = further
    return sorted(best_by_effect.values(), key=lambda further_effect: -further_effect.gain)


@dataclass
class EffectSet:
    """Set of effects that a search ended with, and how well it explains each group of rows."""

    hypothesis: list[Candidate]
    members: list[FurtherEffect]  # each fitted in addition to the other members
    rivals: list[list[FurtherEffect]]  # for each member: itself, then every effect fitted in its place
    further_effects: list[FurtherEffect]  # effects fitted in addition to the whole set, by falling gain
    fit: Fit
    squares_taken: list[float]  # by group of rows: weighted squares that the set and its overtones explain
    squares_left: list[float]  # by group of rows: weighted squares that remain beyond the usual noise
    misfit_changes: list[list[float]]  # by member and group of rows: absolute change of the misfit without the member
    squares_missed: dict[Candidate, float]  # squares that free forms of members and close rivals explain in addition

    def explained(self, evidence: Evidence, index: int) -> float:
        """Return the share of the calibrated residual beyond usual noise that the set explains where a member acts.

        It is the smaller of two shares: over the rows that hold a column of the member, and over the rows whose misfit
        the member changes. An effect that only balances a sound channel against an unexplained one compensates for
        what is missing there.
        """
        candidate = self.members[index].candidate
        taken_where_acting = sum_where_acting(evidence, candidate, self.squares_taken)
        share_where_acting = (
            taken_where_acting / (taken_where_acting + sum_where_acting(evidence, candidate, self.squares_left))
            if taken_where_acting > 0.0
            else 0.0
        )
        return min(share_where_acting, self._explained_where_misfit_changes(evidence, self.misfit_changes[index]))

    def _explained_where_misfit_changes(self, evidence: Evidence, misfit_changes: Sequence[float]) -> float:
        """Return the mean share that the set explains of channels, weighted by a member's changes of their misfit."""
        taken_by_channel: dict[tuple[str, str], float] = {}
        total_by_channel: dict[tuple[str, str], float] = {}
        channels = [(rows.equation, rows.mechanical) for rows in evidence.stack.rows]
        for channel, squares_taken, squares_left in zip(channels, self.squares_taken, self.squares_left, strict=True):
            taken_by_channel[channel] = taken_by_channel.get(channel, 0.0) + squares_taken
            total_by_channel[channel] = total_by_channel.get(channel, 0.0) + squares_taken + squares_left
        shares = [
            taken_by_channel[channel] / total_by_channel[channel] if total_by_channel[channel] > 0.0 else 1.0
            for channel in channels
        ]
        return sum(misfit_change * share for misfit_change, share in zip(misfit_changes, shares, strict=True)) / max(
            sum(misfit_changes), 1e-300
        )


def search(evidence: Evidence) -> EffectSet:
    """Return the set of effects that explains the runs."""
    hypothesis: list[Candidate] = []
    while len(hypothesis) < MOST_EFFECTS:
        added = effect_to_add(evidence, hypothesis)
        if added is None:
            break
        hypothesis = exchange(evidence, [*hypothesis, added])
        hypothesis = replace_by_refined_rivals(evidence, refine(evidence, hypothesis))
    evidence.settle(hypothesis)  # finer forms leave less noise, which allows a further refinement
    return describe(evidence, prune(evidence, refine(evidence, hypothesis)))


def effect_to_add(evidence: Evidence, hypothesis: Sequence[Candidate]) -> Candidate | None:
    """Return the effect to add to a hypothesis, or None where no effect is above its floor.

    Effects are ranked twice. Under the usual noise an effect on all channels ranks first, under the noise that the
    present set leaves an effect on a quiet channel does. The shortlisted effects of both rankings are then fitted.
    """
    shortlisted = shortlist(evidence, hypothesis)
    if len(shortlisted) > 1:
        trials = []
        for candidate in shortlisted:
            evidence.settle([*hypothesis, candidate])
            trials.append((evidence.deviance(), candidate))
        least_deviance = min(deviance for deviance, _ in trials)
        # of equally good fits the first: both rankings are by falling gain
        return next(candidate for deviance, candidate in trials if deviance < least_deviance + EQUAL_FIT_DIFFERENCE)
    return shortlisted[0] if shortlisted else None


def shortlist(evidence: Evidence, hypothesis: Sequence[Candidate]) -> list[Candidate]:
    """Return the effects worth fitting in addition to a set, the best of both rankings."""
    shortlisted: list[Candidate] = []
    for rounds in NOISE_ROUNDS:
        test = CandidateTest(evidence, hypothesis, rounds)
        ranked = [
            further.candidate
            for further in best_of_each(evidence, test.normal, hypothesis)
            if further.height > ENTRY_HEIGHT and test.exceeds_form_error(further.candidate)
        ]
        shortlisted += [candidate for candidate in ranked[:MOST_SHORTLISTED] if candidate not in shortlisted]
    return shortlisted


class CandidateTest:
    """Test whether a further effect lowers the misfit by more than the inexact forms of a set could.

    A form is wrong by a share of what it explains (`form_error`), in rows that are not known. So that share of the
    misfit that a member removes from an equation is allowed for in all rows of the equation. Overtones are added to the
    waves of a set first: no machine's wave is a pure sine. The error of a member's law over its own variables is
    measured on the case in addition (`leactl.gap.search.free_forms`).
    """

    def __init__(self, evidence: Evidence, hypothesis: Sequence[Candidate], rounds: int) -> None:
        """Fit the set; `evidence` keeps the noise of this fit.

        rounds : rounds of estimating the noise from the residuals, one of `NOISE_ROUNDS`.
        """
        overtones = overtones_of(hypothesis)
        evidence.add(overtones)
        fit = evidence.settle(hypothesis, rounds)
        self.normal = evidence.normal()
        self._set_and_overtones = [*hypothesis, *overtones]
        self._fit = self.normal.fit(self._set_and_overtones) if overtones else fit
        self._reductions = {name: self._reduction_by(fit, hypothesis, k) for k, (name, _) in enumerate(hypothesis)}

    def exceeds_form_error(self, candidate: Candidate) -> bool:
        """Return whether a candidate lowers the misfit by `ENTRY_HEIGHT` squared beyond the errors of the set's forms.

        In each equation a change of either sign up to the allowance counts as none; the cost of the parameters' priors
        counts in full.
        """
        fit_with_candidate = self.normal.fit([*self._set_and_overtones, candidate])
        reduction = self._fit.misfit - fit_with_candidate.misfit
        for equation, change in sum_by_equation(
            self.normal, reduction_by_rows(self.normal, self._fit, fit_with_candidate)
        ).items():
            allowance = sum(
                form_error(name, candidate[0]) * max(reduction_of[equation], 0.0)
                for name, reduction_of in self._reductions.items()
            )
            reduction -= min(max(change, -allowance), allowance)
        return reduction > ENTRY_HEIGHT**2 and outdoes_free_forms(self.normal, self._set_and_overtones, candidate)

    def _reduction_by(self, fit: Fit, hypothesis: Sequence[Candidate], index: int) -> dict[str, float]:
        """Return by how much one member lowers the misfit of each equation beside the other members."""
        others = [*hypothesis[:index], *hypothesis[index + 1 :]]
        return sum_by_equation(self.normal, reduction_by_rows(self.normal, self.normal.fit(others), fit))


def form_error(effect: str, other: str) -> float:
    """Return the share of the misfit removed by `effect` that `other` could remove because the first form is inexact.

    `LOOSE_FORM_ERROR` for an effect whose columns are known to be loose; `FORM_ERROR` for two effects that act over a
    common variable and are both waves over the angle or neither; else `FORM_ERROR_ELSEWHERE`.
    """
    if library()[effect].explains < LOOSE_SHARE:
        return LOOSE_FORM_ERROR
    first_variables, second_variables = (set(effect_definition(name).acts_over) for name in (effect, other))
    both_or_neither_wave = (library()[effect].orders[1] > 0) == (library()[other].orders[1] > 0)
    return FORM_ERROR if first_variables & second_variables and both_or_neither_wave else FORM_ERROR_ELSEWHERE


def overtones_of(hypothesis: Sequence[Candidate]) -> list[Candidate]:
    """Return the overtones of a set's waves, up to the highest order that the library tries."""
    return [
        (name, (multiple * form[0], *form[1:]))
        for name, form in hypothesis
        for multiple in OVERTONES
        if form and multiple * form[0] <= library()[name].orders[1]
    ]


def sum_by_equation(normal: Normal, amounts: Sequence[float]) -> dict[str, float]:
    """Return the sums over each equation of amounts, one for each group of rows."""
    sums: dict[str, float] = {}
    for rows, amount in zip(normal.stack.rows, amounts, strict=True):
        sums[rows.equation] = sums.get(rows.equation, 0.0) + amount
    return sums


def reduction_by_rows(normal: Normal, fit_before: Fit, fit_after: Fit) -> list[float]:
    """Return by how much the misfit of each group of rows is lower in one fit than in another, or negative."""
    return [
        normal.weights[k]
        * len(rows.left_over)
        * (normal.residual_rms(fit_before, k) ** 2 - normal.residual_rms(fit_after, k) ** 2)
        for k, rows in enumerate(normal.stack.rows)
    ]


def sum_where_acting(evidence: Evidence, candidate: Candidate, amounts: Sequence[float]) -> float:
    """Return the sum of amounts, one for each group of rows, over those groups that hold a column of a candidate."""
    effect_and_form = (candidate[0], repr(candidate[1]))
    return sum(
        amount
        for amount, rows in zip(amounts, evidence.stack.rows, strict=True)
        if any(name[0] == "effect" and (name[1], name[2]) == effect_and_form for name in rows.columns)
    )


def exchange(evidence: Evidence, hypothesis: list[Candidate]) -> list[Candidate]:
    """Return a set with each member replaced by the best effect beside the other members, until no effect changes."""
    for _ in range(MOST_EXCHANGE_ROUNDS):
        evidence.settle(hypothesis)
        normal, changed = evidence.normal(), False
        for index in range(len(hypothesis)):
            others = hypothesis[:index] + hypothesis[index + 1 :]
            ranked = [further for further in best_of_each(evidence, normal, others) if further.height > ENTRY_HEIGHT]
            if ranked and ranked[0].candidate != hypothesis[index]:
                changed = changed or ranked[0].effect != hypothesis[index][0]
                hypothesis = [*hypothesis[:index], ranked[0].candidate, *hypothesis[index + 1 :]]
        if not changed:
            break
    return hypothesis


def refine(evidence: Evidence, hypothesis: list[Candidate], shapes: bool = True) -> list[Candidate]:
    """Return a set with the non-linear parameters of each member refined between grid values and slightly beyond.

    shapes : whether to refine the forms that a fitted strength determines, too.
    """
    for index, candidate in enumerate(hypothesis):
        if shapes or not strength_determines_form(*candidate):
            hypothesis[index] = refine_member(evidence, hypothesis[:index] + hypothesis[index + 1 :], candidate)
    return hypothesis


def refine_member(evidence: Evidence, others: list[Candidate], candidate: Candidate) -> Candidate:
    """Return the candidate in its best form beside other members; store that form's covariance in the evidence."""
    name, form = candidate
    effect = library()[name]
    if not form or effect.periodic or not effect.continuous:
        return candidate
    grids = [grid_values(position, form, evidence.forms.get(name, [])) for position in range(effect.refined)]
    ratios = [max((larger / smaller for smaller, larger in pairwise(grid)), default=1.0) for grid in grids]
    if effect.narrow:
        form = best_scanned_form(evidence, others, name, form, ratios[0])
    form = refined_form(evidence, others, name, form, ratios)
    if not strength_determines_form(name, form):
        if effect.refined > 1:
            form = nearest_summit(evidence, others, (name, form), ratios)
        evidence.form_spread[name, form] = spread_of_form(evidence, others, (name, form), ratios)
    return name, form


def replace_by_refined_rivals(evidence: Evidence, hypothesis: list[Candidate]) -> list[Candidate]:
    """Return a set with each member replaced by the effect with the largest gain, once its close rivals are refined.

    The grid is coarse for a form with a threshold: the effect whose threshold lies nearer to a grid value gains more,
    whether or not it acts.
    """
    for index, candidate in enumerate(hypothesis):
        others = hypothesis[:index] + hypothesis[index + 1 :]
        ranked = best_of_each(evidence, evidence.normal(), others)
        gain_of_member = next((further.gain for further in ranked if further.effect == candidate[0]), math.inf)
        close_rivals = [
            further.candidate
            for further in ranked
            if further.height > ENTRY_HEIGHT
            and gain_of_member - further.gain < CLOSE_RIVAL_FACTOR * gain_tolerance(gain_of_member)
            and further.effect != candidate[0]
            and not strength_determines_form(*further.candidate)
        ]
        for rival in close_rivals[:MOST_SHORTLISTED]:
            refine_member(evidence, others, rival)  # its finer forms are among the candidates from here on
        if close_rivals:
            refined_ranking = best_of_each(evidence, evidence.normal(), others)
            if refined_ranking[0].height > ENTRY_HEIGHT:
                hypothesis[index] = refined_ranking[0].candidate
    return hypothesis


def strength_determines_form(name: str, form: Form) -> bool:
    """Return whether a fraction of an effect in one form equals the whole effect in another form."""
    return library()[name].shaped and library()[name].whole(form, 0.5) != form


class LocalShape(NamedTuple):
    """Gain about a form to second order: gain(x) = gain(0) + slope @ x - x @ curvature @ x.

    x, shape (n,), moves the logarithms of n numbers of the form, in finest steps of the search. They are the refined
    numbers whose grid has two values or more. `curvature`, (n, n), is minus half the Hessian: positive about a summit.
    """

    varied: list[int]  # positions of these numbers
    steps: list[float]  # finest step of each number, as a natural logarithm
    slope: npt.NDArray[np.float64]  # (n,)
    curvature: npt.NDArray[np.float64]


def local_shape(
    evidence: Evidence, others: list[Candidate], candidate: Candidate, ratios: Sequence[float]
) -> LocalShape | None:
    """Return slope and curvature of the gain about a form.

    None where no refined number has two grid values, or a neighbouring form is not possible.

    ratios : ratio of neighbouring grid values of each number; 1 for a number that is not refined.
    """
    name, form = candidate
    varied = [index for index, ratio in enumerate(ratios) if ratio > 1.0]
    if not varied:
        return None
    steps = [STEP_SHARES[-1] * math.log(ratios[index]) for index in varied]
    # no move, each number by one step either way, and each pair of numbers by one step each
    moves = [move for move in product((-1, 0, 1), repeat=len(varied)) if sum(map(abs, move)) <= 2]
    forms = {move: scaled_form(form, dict(zip(varied, map(mul, move, steps), strict=True))) for move in moves}
    gains, all_possible = gains_of(evidence, others, [(name, forms[move]) for move in moves])
    if not all_possible:
        return None

    def slope_and_fall(move: Sequence[int]) -> tuple[float, float]:
        """Return the slope of the gain along a move, and its fall from the form, on average over move and reverse."""
        gain_ahead, gain_behind = (gains[forms[tuple(sign * step for step in move)]] for sign in (1, -1))
        return 0.5 * (gain_ahead - gain_behind), gains[form] - 0.5 * (gain_ahead + gain_behind)

    unit_moves = np.eye(len(varied), dtype=int)
    slopes_and_falls = [slope_and_fall(row.tolist()) for row in unit_moves]
    curvature = np.diag([fall for _, fall in slopes_and_falls])
    for i, j in combinations(range(len(varied)), 2):
        fall_together, fall_opposed = (
            slope_and_fall((unit_moves[i] + sign * unit_moves[j]).tolist())[1] for sign in (1, -1)
        )
        # the fall is c_ii + c_jj + 2 c_ij for steps of one sign, and c_ii + c_jj - 2 c_ij for steps of opposite sign
        curvature[i, j] = curvature[j, i] = 0.25 * (fall_together - fall_opposed)
    return LocalShape(varied, steps, np.array([slope for slope, _ in slopes_and_falls]), curvature)


def scaled_form(form: Form, logs: Mapping[int, float]) -> Form:
    """Return a form with some of its numbers multiplied by the exponentials of these logarithms, by position."""
    return tuple(number * math.exp(logs.get(index, 0.0)) for index, number in enumerate(form))


def nearest_summit(evidence: Evidence, others: list[Candidate], candidate: Candidate, ratios: Sequence[float]) -> Form:
    """Return the form of the largest gain nearby, by Newton steps.

    Where two numbers compensate each other, `refined_form` may end beside the ridge that leads to the summit. No number
    moves further in a step than in the first steps of `refined_form`. The climb ends where the gain is not curved
    downwards in every direction, or where a step gains nothing.
    """
    name, form = candidate
    for _ in range(MOST_ASCENT_STEPS):
        shape = local_shape(evidence, others, (name, form), ratios)
        if shape is None or np.linalg.eigvalsh(shape.curvature)[0] <= 0.0:
            break
        ascent = 0.5 * np.linalg.solve(shape.curvature, shape.slope)
        longest_step = STEP_SHARES[0] / STEP_SHARES[-1]  # first steps of `refined_form`, in finest steps
        ascent *= longest_step / max(float(np.max(np.abs(ascent))), longest_step)
        logs = dict(zip(shape.varied, (ascent * shape.steps).tolist(), strict=True))
        next_form = scaled_form(form, logs)
        gains, _ = gains_of(evidence, others, [(name, form), (name, next_form)])
        if gains.get(next_form, -math.inf) <= gains[form] + EQUAL_FIT_DIFFERENCE:
            break
        form = next_form
    return form


def spread_of_form(
    evidence: Evidence, others: list[Candidate], candidate: Candidate, ratios: Sequence[float]
) -> npt.NDArray[np.float64]:
    """Return the covariance of the logarithms of a form's refined numbers, with all coefficients fitted again.

    The gain falls by the squared deviation in standard errors, so its curvature over the finest step of the search
    gives the covariance. It is infinite for all refined numbers where the gain is not curved downwards in every
    direction, or a neighbouring form is not possible, and zero for a number that is not refined.
    """
    covariance = np.diag([math.inf if ratio > 1.0 else 0.0 for ratio in ratios])
    shape = local_shape(evidence, others, candidate, ratios)
    if shape is not None and np.linalg.eigvalsh(shape.curvature)[0] > 0.0:
        covariance[np.ix_(shape.varied, shape.varied)] = np.linalg.inv(shape.curvature) * np.outer(
            shape.steps, shape.steps
        )
    return covariance


def grid_values(position: int, form: Form, forms: Sequence[Form]) -> list[float]:
    """Return the grid values of the parameter at one position of a form, ascending.

    Only grid forms whose later parameters equal those of `form` count, or all grid forms where none matches.
    """
    matching_values = {grid_form[position] for grid_form in forms if grid_form[position + 1 :] == form[position + 1 :]}
    return sorted(matching_values or {grid_form[position] for grid_form in forms})


def best_scanned_form(evidence: Evidence, others: list[Candidate], name: str, form: Form, ratio: float) -> Form:
    """Return the best form between a form and its grid neighbours: a narrow effect may have several local optima.

    ratio : ratio of neighbouring grid values of the first parameter.
    """
    first_values = [form[0] * ratio ** (step / SCAN_STEPS) for step in range(-SCAN_STEPS, SCAN_STEPS + 1)]
    tails = sorted({grid_form[1:] for grid_form in evidence.forms.get(name, [])} | {form[1:]})
    gains, _ = gains_of(evidence, others, [(name, (value, *tail)) for value, tail in product(first_values, tails)])
    return max(gains, key=lambda tried_form: gains[tried_form], default=form)


def gains_of(
    evidence: Evidence, others: list[Candidate], candidates: list[Candidate]
) -> tuple[dict[Form, float], bool]:
    """Return the gain of each possible form beside other members, and whether every form is possible."""
    evidence.add(candidates)
    normal, base = evidence.normal(), evidence.stack.columns_of(others)
    possible = [
        further
        for candidate in candidates
        if (further := fit_further_effect(evidence, normal, base, candidate)) is not None
    ]
    return {further.candidate[1]: further.gain for further in possible}, len(possible) == len(candidates)


def refined_form(evidence: Evidence, others: list[Candidate], name: str, form: Form, ratios: Sequence[float]) -> Form:
    """Return the best form in the neighbourhood of a form.

    Every combination of one step down, no step and one step up is tried for the first parameters together, since they
    can compensate each other. Steps become finer (`STEP_SHARES`); the search ends where all trials gain about the same.

    ratios : largest ratio of neighbouring grid values of each of these parameters.
    """
    # a fitted strength below one is equal to another form of such an effect, which `make_whole` finds at once: larger
    # moves would lead to a fraction of a longer delay
    strength_is_form = strength_determines_form(name, form)
    for step_share in STEP_SHARES[:2] if strength_is_form else STEP_SHARES:
        for _ in range(1 if strength_is_form else MOST_FORM_MOVES):
            steps = product(
                *((ratio**-step_share, 1.0, ratio**step_share) if ratio > 1.0 else (1.0,) for ratio in ratios)
            )
            candidates = [(name, (*map(mul, form, step), *form[len(step) :])) for step in steps]
            gains, all_possible = gains_of(evidence, others, candidates)
            best_form = max(gains, key=lambda tried_form: gains[tried_form], default=form)
            if gains.get(best_form, -math.inf) <= gains.get(form, -math.inf) + EQUAL_FIT_DIFFERENCE:
                break
            form = best_form
        if all_possible and max(gains.values()) - min(gains.values()) < LEAST_FORM_DIFFERENCE:
            break
    return form


def prune(evidence: Evidence, hypothesis: list[Candidate]) -> list[Candidate]:
    """Return a set without members that fail the tests of entry beside the others, removed one by one, lowest first."""
    while hypothesis:
        evidence.settle(hypothesis)
        normal = evidence.normal()
        members = [fit_member(evidence, normal, hypothesis, k) for k in range(len(hypothesis))]
        heights = [further.height if further is not None else 0.0 for further in members]
        lowest_first = [int(k) for k in np.argsort(heights, kind="stable")]
        if heights[lowest_first[0]] <= ENTRY_HEIGHT:
            unsupported: int | None = lowest_first[0]
        else:
            unsupported = next((k for k in lowest_first if not is_supported(evidence, hypothesis, k)), None)
        if unsupported is None:
            break
        hypothesis = hypothesis[:unsupported] + hypothesis[unsupported + 1 :]
    return hypothesis


def is_supported(evidence: Evidence, hypothesis: Sequence[Candidate], index: int) -> bool:
    """Return whether a member lowers the misfit by more than form errors of the others could, under either noise."""
    others = [*hypothesis[:index], *hypothesis[index + 1 :]]
    return any(CandidateTest(evidence, others, rounds).exceeds_form_error(hypothesis[index]) for rounds in NOISE_ROUNDS)


def fit_member(evidence: Evidence, normal: Normal, hypothesis: Sequence[Candidate], index: int) -> FurtherEffect | None:
    """Return one member of a set, fitted in addition to the other members."""
    others = [*hypothesis[:index], *hypothesis[index + 1 :]]
    return fit_further_effect(evidence, normal, evidence.stack.columns_of(others), hypothesis[index])


def describe(evidence: Evidence, hypothesis: list[Candidate]) -> EffectSet:
    """Return a set with its members, their rivals and the further effects, under the weights of the set.

    A member that at full strength is no possible effect is removed.
    """
    hypothesis = make_whole(evidence, hypothesis)
    squares_taken, squares_left = squares_taken_and_left(evidence, hypothesis)
    fit = evidence.settle(hypothesis)
    normal = evidence.normal()
    members, rivals, misfit_changes, squares_missed = [], [], [], dict[Candidate, float]()
    for index in range(len(hypothesis)):
        others = hypothesis[:index] + hypothesis[index + 1 :]
        misfit_changes.append([abs(amount) for amount in reduction_by_rows(normal, normal.fit(others), fit)])
        item = fit_further_effect(
            evidence, normal, evidence.stack.columns_of(others), hypothesis[index], at_full_strength=True
        )
        if item is None:  # at full strength the member is no possible effect
            return describe(evidence, others)
        members.append(item)
        ranked = best_of_each(evidence, normal, others, at_full_strength=True)
        rivals.append([item, *(r for r in ranked if r.effect != item.effect and is_possible(evidence, r))])
        close_rivals = [
            r.candidate for r in rivals[-1] if item.gain - r.gain < CLOSE_RIVAL_FACTOR * gain_tolerance(item.gain)
        ]
        if len(close_rivals) > 1:
            squares_missed |= {rival: missed_by_form(normal, [*others, rival], rival) for rival in close_rivals}
    further_effects = best_of_each(evidence, normal, hypothesis)
    return EffectSet(
        hypothesis, members, rivals, further_effects, fit, squares_taken, squares_left, misfit_changes, squares_missed
    )


def make_whole(evidence: Evidence, hypothesis: list[Candidate]) -> list[Candidate]:
    """Return a set with shaped members and rivals in the form with a strength of one, so that their gains compare."""
    for index in range(len(hypothesis)):
        others = hypothesis[:index] + hypothesis[index + 1 :]
        for _ in range(WHOLE_ROUNDS):
            evidence.settle(hypothesis)
            ranked_by_share = best_of_each(evidence, evidence.normal(), others)
            shaped = [
                further
                for further in ranked_by_share
                if library()[further.effect].shaped and further.height > ENTRY_HEIGHT
            ]
            whole_forms = [(further.effect, whole_form(further)) for further in shaped]
            evidence.add(whole_forms)
            for candidate in whole_forms:
                if candidate[0] == hypothesis[index][0]:
                    hypothesis[index] = candidate
        normal = evidence.normal()
        ranked = [r for r in best_of_each(evidence, normal, others, at_full_strength=True) if r.height > ENTRY_HEIGHT]
        if ranked and library()[ranked[0].effect].shaped and library()[hypothesis[index][0]].shaped:
            hypothesis[index] = ranked[0].candidate
    return hypothesis


def whole_form(further: FurtherEffect) -> tuple[float, ...]:
    """Return the form at which a shaped effect has a strength of one, to three digits."""
    form = library()[further.effect].whole(further.candidate[1], further.values[0])
    return tuple(float(f"{value:.3g}") for value in form)


def squares_taken_and_left(
    evidence: Evidence, hypothesis: Sequence[Candidate], sound_noise: bool = False
) -> tuple[list[float], list[float]]:
    """Return, by group of rows, the weighted squares that a set with its overtones explains, and those that remain.

    Both are weighted by the usual noise; what remains counts beyond `MOST_USUAL_POWER`.

    sound_noise : whether the usual noise is a sound machine's where that is lower.
    """
    overtones = overtones_of(hypothesis)
    evidence.add(overtones)
    evidence.weigh_as_usual(sound_noise)
    normal = evidence.normal()
    fit_without, fit_with = normal.fit(), normal.fit([*hypothesis, *overtones])
    squares_taken = [max(amount, 0.0) for amount in reduction_by_rows(normal, fit_without, fit_with)]
    squares_left = [
        max(normal.weights[k] * normal.residual_rms(fit_with, k) ** 2 - MOST_USUAL_POWER, 0.0) * len(rows.left_over)
        for k, rows in enumerate(normal.stack.rows)
    ]
    return squares_taken, squares_left
