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
MOST_EFFECTS = 3  # effects in a set
ENTRY_HEIGHT = 3.2  # smallest height of an effect that enters a set: its size over its floor and uncertainty
EQUAL_FIT_DIFFERENCE = 1e-3  # difference of twice a log likelihood below which two fits are equally good
MOST_EXCHANGES = 4  # rounds of exchanging members
MOST_MOVES = 4  # moves of a form at each step size
STEP_SHARES = (1 / 3, 1 / 9, 1 / 27, 1 / 81)  # step sizes as shares of the grid's ratio, on a logarithmic scale
SCAN_STEPS = 8  # trials from one value of a narrow effect's grid to the next
MOST_ASCENTS = 8  # steps along a ridge from the best form of the last grid
LEAST_FORM_DIFFERENCE = 2.0  # difference in weighted squares below which forms cannot be told apart
NOISE_ROUNDS = (2, 0)  # rounds of estimating the noise from a set's residuals; 0 keeps the usual noise
MOST_SHORTLISTED = 4  # candidates of one ranking that are fitted
MOST_USUAL_POWER = 2.0  # largest residual power that counts as usual, in units of a sound machine's noise power
WHOLE_ROUNDS = 2  # rounds of bringing shaped effects to their whole form
WAVE_COEFFICIENTS = ("cos", "sin")  # coefficients that make one amplitude
OVERTONES = (2.0, 3.0)  # multiples of its order that a machine's wave also contains
LOOSE_SHARE = 0.8  # `explains` of an effect below which its columns count as loose
LOOSE_FORM_ERROR = 0.1  # `FORM_ERROR` for an effect with loose columns
TIE_SHARE = 1e-6  # share of its gain that the unusual one of two effects with equal columns loses; far above rounding
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
    gain: float  # weighted squares by which it lowers the misfit
    size: float  # in units of its leading parameter
    std: float
    values: tuple[float, ...]
    names: tuple[str, ...]
    covariance: Array
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
        """Ratio of the size, less what noise gives the best of many orders, to the error and floor in quadrature."""
        beyond = math.sqrt(max(self.size**2 - self.by_chance * self.std**2, 0.0))
        return beyond / math.hypot(self.std, self.floor)


def fit_further_effect(
    evidence: Evidence,
    normal: Normal,
    base: npt.NDArray[np.intp],
    candidate: Candidate,
    whole: bool = False,
    free: bool = False,
) -> FurtherEffect | None:
    """Fit one form of an effect in addition to a base; return None where the fit is no possible effect.

    That is where no run shows the form, where the sign is impossible, and where the whole interval of the size lies
    beyond the range in which the effect is met: so large a residual has another cause.

    base : columns of the base hypothesis.
    whole : whether a shaped effect counts at full strength, not at the fitted share of it.
    free : whether any sign and size is accepted.
    """
    columns = evidence.columns(candidate)
    if len(columns) == 0:
        return None
    gain, values, covariance = gain_of(normal, base, columns)
    effect = library()[candidate[0]]
    if not effect.is_usual(evidence.travel):
        gain *= 1.0 - TIE_SHARE
    if effect.one_sided and values[0] <= 0.0 and not free:
        return None
    if effect.shaped and not (
        covariance[0, 0] < STRENGTH_RANGE[1] ** 2 and (free or STRENGTH_RANGE[0] < values[0] < STRENGTH_RANGE[1])
    ):
        return None
    if effect.shaped and whole:
        gain = float((2.0 * values[0] - 1.0) / covariance[0, 0])  # at strength 1, not at the fitted one
    names = tuple(evidence.coefficient(column) for column in columns)
    coefficients = dict(zip(names, values.tolist(), strict=True))
    if not free and not effect.is_distinct(candidate[1], coefficients, evidence.visited):
        gain -= constant_torque_penalty(gain)
    if effect.shaped and free:
        coefficients[names[0]] = min(abs(coefficients[names[0]]), STRENGTH_RANGE[1])
    size = effect.size(candidate[1], coefficients, evidence.model)
    leading = leading_positions(names)
    leading_values, leading_covariance = values[leading], covariance[np.ix_(leading, leading)]
    length = max(float(np.linalg.norm(leading_values)), 1e-300)
    if not (np.isfinite(leading_values).all() and np.isfinite(leading_covariance).all()):
        return None
    direction = leading_values / length
    std = size / length * math.sqrt(max(float(direction @ leading_covariance @ direction), 0.0))
    floor = evidence.floor(candidate)
    if effect.delays:  # a delay within the uncertainty of stamps is no effect, however significant
        floor = max(floor, delay_of_stamps(evidence.stack, evidence.on_time, candidate) / ENTRY_HEIGHT)
    by_chance = 2.0 * math.log(effect.orders[1] - effect.orders[0] + 1) if effect.periodic else 0.0
    result = FurtherEffect(candidate, gain, size, std, tuple(values.tolist()), names, covariance, floor, by_chance)
    return result if whole or free or is_possible(evidence, result) else None


def leading_positions(names: Sequence[str]) -> list[int]:
    """Return the positions of the coefficients that define an effect's size: both of a wave, else the first."""
    return [k for k, name in enumerate(names) if name in WAVE_COEFFICIENTS] or [0]


def gain_tolerance(gain: float) -> float:
    """Return the difference of two effects' gains that noise and inexact forms explain."""
    return 1.0 + RIVAL_FORM_ERROR * gain


def constant_torque_penalty(gain: float) -> float:
    """Return the gain that an effect loses by prior odds where the runs show it only as a constant torque."""
    return -2.0 * gain_tolerance(gain) * math.log(UNSHOWN_SPRING_ODDS)


def fit_each_alone(evidence: Evidence) -> dict[str, list[FurtherEffect | None]]:
    """Fit every effect alone, with any sign, in each form of the grid; None for forms that no run shows."""
    normal, base = evidence.normal(), evidence.stack.columns_of([])
    tried: dict[str, list[FurtherEffect | None]] = {}
    for candidate in evidence.candidates:
        tried.setdefault(candidate[0], []).append(fit_further_effect(evidence, normal, base, candidate, free=True))
    return tried


def sizes_beyond_noise(name: str, items: Sequence[FurtherEffect | None]) -> list[float]:
    """Return the size of an effect beyond noise in each form of the grid; empty where no form gains.

    The size is measured in the form with the largest gain and scaled to the other forms by their standard errors: a
    form that the runs hardly show is large where one that they show well is small. A periodic effect has one size, that
    of its best order. Noise makes the best of many forms larger than a single one: the largest of n squares of unit
    variance is about 1 + 2 ln n.
    """
    effect = library()[name]
    best = max((item for item in items if item is not None), key=lambda item: item.gain, default=None)
    if best is None or best.gain <= 0.0:
        return []
    count = effect.orders[1] - effect.orders[0] + 1 if effect.periodic else len(effect.forms)
    beyond = math.sqrt(max(best.size**2 - best.std**2 * (1.0 + 2.0 * math.log(count)), 0.0))
    stds = [best.std if item is None or effect.periodic else item.std for item in items]
    most = MOST_SIZE_RATIO * effect_definition(name).largest
    sizes = [min(beyond * std / best.std, most) for std in stds]
    return sizes[:1] if effect.periodic else sizes


def standard_errors(name: str, items: Sequence[FurtherEffect | None]) -> list[float]:
    """Return the standard error of an effect by form, infinite where no run shows it; of a periodic one the least."""
    stds = [math.inf if item is None else item.std for item in items]
    return [min(stds)] if library()[name].periodic else stds


def is_possible(evidence: Evidence, item: FurtherEffect) -> bool:
    """Return whether an effect is met in the fitted size; a wave within noise is always possible."""
    if is_beyond_range(item) or item.size + INTERVAL_STDS * item.std < library()[item.effect].least:
        return False
    columns = evidence.columns(item.candidate)
    return item.height <= ENTRY_HEIGHT or not outweighs_equation(evidence.stack, columns, np.asarray(item.values))


def is_beyond_range(item: FurtherEffect) -> bool:
    """Return whether the whole interval of an effect's size lies beyond the range in which the effect is met."""
    return item.size - INTERVAL_STDS * item.std > MOST_SIZE_RATIO * effect_definition(item.effect).largest


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
    evidence: Evidence, normal: Normal, hypothesis: Sequence[Candidate], whole: bool = False
) -> list[FurtherEffect]:
    """Fit every effect that is not in a hypothesis in addition to it; return the best form of each, by falling gain."""
    base = evidence.stack.columns_of(hypothesis)
    effects_in_set = {effect for effect, _ in hypothesis}
    best: dict[str, FurtherEffect] = {}
    for candidate in evidence.candidates:
        if candidate[0] in effects_in_set:
            continue
        further = fit_further_effect(evidence, normal, base, candidate, whole)
        if further is not None and (candidate[0] not in best or further.gain > best[candidate[0]].gain):
            best[candidate[0]] = further
    return sorted(best.values(), key=lambda item: -item.gain)


@dataclass
class EffectSet:
    """Set of effects that a search ended with, and how well it explains each group of rows."""

    hypothesis: list[Candidate]
    members: list[FurtherEffect]  # each fitted in addition to the other members
    rivals: list[list[FurtherEffect]]  # for each member: itself, then every effect fitted in its place
    rest: list[FurtherEffect]  # effects fitted in addition to the whole set, by falling gain
    fit: Fit
    taken: list[float]  # by group of rows: weighted squares under usual noise explained by the set and its overtones
    left: list[float]  # by group of rows: weighted squares that remain beyond usual noise
    moved: list[list[float]]  # by member and group of rows: absolute change of the misfit without the member
    missed: dict[Candidate, float]  # squares that free forms of members and close rivals explain in addition

    def explained(self, evidence: Evidence, index: int) -> float:
        """Return the share of the calibrated residual beyond usual noise that the set explains where a member acts.

        It is the smaller of two shares: over the rows that hold a column of the member, and over the rows whose misfit
        the member changes. An effect that only balances a sound channel against an unexplained one compensates for
        what is missing there.
        """
        candidate = self.members[index].candidate
        squares_taken = sum_where_acting(evidence, candidate, self.taken)
        share_where_touched = (
            squares_taken / (squares_taken + sum_where_acting(evidence, candidate, self.left))
            if squares_taken > 0.0
            else 0.0
        )
        return min(share_where_touched, self._explained_where_moved(evidence, self.moved[index]))

    def _explained_where_moved(self, evidence: Evidence, moved: Sequence[float]) -> float:
        taken_by_channel: dict[tuple[str, str], float] = {}
        total_by_channel: dict[tuple[str, str], float] = {}
        channels = [(rows.equation, rows.mechanical) for rows in evidence.stack.rows]
        for channel, squares_taken, squares_left in zip(channels, self.taken, self.left, strict=True):
            taken_by_channel[channel] = taken_by_channel.get(channel, 0.0) + squares_taken
            total_by_channel[channel] = total_by_channel.get(channel, 0.0) + squares_taken + squares_left
        shares = [
            taken_by_channel[channel] / total_by_channel[channel] if total_by_channel[channel] > 0.0 else 1.0
            for channel in channels
        ]
        return sum(moved_misfit * share for moved_misfit, share in zip(moved, shares, strict=True)) / max(
            sum(moved), 1e-300
        )


def search(evidence: Evidence) -> EffectSet:
    """Find the set of effects that explains the runs."""
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
    present set leaves an effect on a quiet channel does. The best of both lists is found by fitting.
    """
    listed = shortlist(evidence, hypothesis)
    if len(listed) > 1:
        trials = []
        for candidate in listed:
            evidence.settle([*hypothesis, candidate])
            trials.append((evidence.surprise(), candidate))
        least = min(surprise for surprise, _ in trials)
        # the first of the list
        return next(candidate for surprise, candidate in trials if surprise < least + EQUAL_FIT_DIFFERENCE)
    return listed[0] if listed else None


def shortlist(evidence: Evidence, hypothesis: Sequence[Candidate]) -> list[Candidate]:
    """Return the effects worth fitting in addition to a set, the best of both rankings."""
    listed: list[Candidate] = []
    for rounds in NOISE_ROUNDS:
        test = CandidateTest(evidence, hypothesis, rounds)
        ranked = [
            item.candidate
            for item in best_of_each(evidence, test.normal, hypothesis)
            if item.height > ENTRY_HEIGHT and test.exceeds_form_error(item.candidate)
        ]
        listed += [candidate for candidate in ranked[:MOST_SHORTLISTED] if candidate not in listed]
    return listed


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
        self._wider = [*hypothesis, *overtones]
        self._fit = self.normal.fit(self._wider) if overtones else fit
        self._reductions = {name: self._reduction_by(fit, hypothesis, k) for k, (name, _) in enumerate(hypothesis)}

    def exceeds_form_error(self, candidate: Candidate) -> bool:
        """Return whether a candidate lowers the misfit by `ENTRY_HEIGHT` squared beyond the errors of the set's forms.

        In each equation a change of either sign up to the allowance counts as none; the cost of the parameters' priors
        counts in full.
        """
        larger = self.normal.fit([*self._wider, candidate])
        reduction = self._fit.misfit - larger.misfit
        for equation, change in sum_by_equation(self.normal, reduction_by_rows(self.normal, self._fit, larger)).items():
            allowance = sum(
                form_error(name, candidate[0]) * max(of_member[equation], 0.0)
                for name, of_member in self._reductions.items()
            )
            reduction -= min(max(change, -allowance), allowance)
        return reduction > ENTRY_HEIGHT**2 and outdoes_free_forms(self.normal, self._wider, candidate)

    def _reduction_by(self, fit: Fit, hypothesis: Sequence[Candidate], index: int) -> dict[str, float]:
        """Return by how much one member lowers the misfit of each equation in addition to the other members."""
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
        (name, (times * form[0], *form[1:]))
        for name, form in hypothesis
        for times in OVERTONES
        if form and times * form[0] <= library()[name].orders[1]
    ]


def sum_by_equation(normal: Normal, amounts: Sequence[float]) -> dict[str, float]:
    """Sum amounts, one for each group of rows, over each equation."""
    sums: dict[str, float] = {}
    for rows, amount in zip(normal.stack.rows, amounts, strict=True):
        sums[rows.equation] = sums.get(rows.equation, 0.0) + amount
    return sums


def reduction_by_rows(normal: Normal, before: Fit, after: Fit) -> list[float]:
    """Return by how much the misfit of each group of rows is lower after than before; negative where it is higher."""
    return [
        normal.weights[k] * len(rows.left_over) * (normal.residual(before, k) ** 2 - normal.residual(after, k) ** 2)
        for k, rows in enumerate(normal.stack.rows)
    ]


def sum_where_acting(evidence: Evidence, candidate: Candidate, explained: Sequence[float]) -> float:
    """Sum the squares explained over the groups of rows that hold a column of a candidate."""
    key = (candidate[0], repr(candidate[1]))
    return sum(
        amount
        for amount, rows in zip(explained, evidence.stack.rows, strict=True)
        if any(name[0] == "effect" and (name[1], name[2]) == key for name in rows.columns)
    )


def exchange(evidence: Evidence, hypothesis: list[Candidate]) -> list[Candidate]:
    """Replace each member by the best effect in its place, the other members held, until no effect changes."""
    for _ in range(MOST_EXCHANGES):
        evidence.settle(hypothesis)
        normal, changed = evidence.normal(), False
        for index in range(len(hypothesis)):
            others = hypothesis[:index] + hypothesis[index + 1 :]
            ranked = [item for item in best_of_each(evidence, normal, others) if item.height > ENTRY_HEIGHT]
            if ranked and ranked[0].candidate != hypothesis[index]:
                changed = changed or ranked[0].effect != hypothesis[index][0]
                hypothesis = [*hypothesis[:index], ranked[0].candidate, *hypothesis[index + 1 :]]
        if not changed:
            break
    return hypothesis


def refine(evidence: Evidence, hypothesis: list[Candidate], shapes: bool = True) -> list[Candidate]:
    """Refine the non-linear parameters of each member between the grid's values and slightly beyond.

    shapes : whether to refine the forms that a fitted strength determines, too.
    """
    for index, candidate in enumerate(hypothesis):
        if shapes or not strength_tells_form(*candidate):
            hypothesis[index] = refine_member(evidence, hypothesis[:index] + hypothesis[index + 1 :], candidate)
    return hypothesis


def refine_member(evidence: Evidence, others: list[Candidate], candidate: Candidate) -> Candidate:
    """Return the candidate in its best form beside other members; store that form's covariance in the evidence."""
    name, form = candidate
    effect = library()[name]
    if not form or effect.periodic or not effect.continuous:
        return candidate
    grids = [grid_values(position, form, evidence.forms.get(name, [])) for position in range(effect.refined)]
    ratios = [max((b / a for a, b in pairwise(grid)), default=1.0) for grid in grids]
    if effect.narrow:
        form = best_scanned_form(evidence, others, name, form, ratios[0])
    form = refined_form(evidence, others, name, form, ratios)
    if not strength_tells_form(name, form):
        if effect.refined > 1:
            form = nearest_summit(evidence, others, (name, form), ratios)
        evidence.form_spread[name, form] = spread_of_form(evidence, others, (name, form), ratios)
    return name, form


def replace_by_refined_rivals(evidence: Evidence, hypothesis: list[Candidate]) -> list[Candidate]:
    """Refine the close rivals of each member, then replace the member by the effect with the largest gain.

    The grid is coarse for a form with a threshold: the effect whose threshold lies nearer to a grid value gains more,
    whether or not it acts.
    """
    for index, candidate in enumerate(hypothesis):
        others = hypothesis[:index] + hypothesis[index + 1 :]
        ranked = best_of_each(evidence, evidence.normal(), others)
        gain = next((item.gain for item in ranked if item.effect == candidate[0]), math.inf)
        close = [
            item.candidate
            for item in ranked
            if item.height > ENTRY_HEIGHT
            and gain - item.gain < CLOSE_RIVAL_FACTOR * gain_tolerance(gain)
            and item.effect != candidate[0]
            and not strength_tells_form(*item.candidate)
        ]
        for rival in close[:MOST_SHORTLISTED]:
            refine_member(evidence, others, rival)  # its finer forms are among the candidates from here on
        if close:
            best = best_of_each(evidence, evidence.normal(), others)
            if best[0].height > ENTRY_HEIGHT:
                hypothesis[index] = best[0].candidate
    return hypothesis


def strength_tells_form(name: str, form: Form) -> bool:
    """Return whether a fraction of an effect in one form equals the whole effect in another form."""
    return library()[name].shaped and library()[name].whole(form, 0.5) != form


class LocalShape(NamedTuple):
    """Gain about a form to second order: gain(x) = gain(0) + slope @ x - x @ curvature @ x.

    x, shape (n,), moves the logarithms of n numbers of the form, in finest steps of the search. They are the refined
    numbers whose grid has two values or more. `curvature`, (n, n), is minus half the Hessian: positive about a summit.
    """

    free: list[int]  # positions of these numbers
    steps: list[float]  # finest step of each, as a natural logarithm
    slope: npt.NDArray[np.float64]
    curvature: npt.NDArray[np.float64]


def local_shape(
    evidence: Evidence, others: list[Candidate], candidate: Candidate, ratios: Sequence[float]
) -> LocalShape | None:
    """Measure slope and curvature of the gain about a form.

    None where no refined number has two grid values, or a neighbouring form is not possible.

    ratios : of neighbouring grid values of each number; 1 for one that is not refined.
    """
    name, form = candidate
    free = [index for index, ratio in enumerate(ratios) if ratio > 1.0]
    if not free:
        return None
    steps = [STEP_SHARES[-1] * math.log(ratios[index]) for index in free]
    # the form itself, each number by one step either way, and each pair of numbers by one step each
    moves = [move for move in product((-1, 0, 1), repeat=len(free)) if sum(map(abs, move)) <= 2]
    forms = {move: scaled_form(form, dict(zip(free, map(mul, move, steps), strict=True))) for move in moves}
    gains, all_possible = gains_of(evidence, others, [(name, forms[move]) for move in moves])
    if not all_possible:
        return None

    def both_ways(move: Sequence[int]) -> tuple[float, float]:
        """Return the slope of the gain along a move, and its fall from the form, on average over move and reverse."""
        there, back = (gains[forms[tuple(sign * part for part in move)]] for sign in (1, -1))
        return 0.5 * (there - back), gains[form] - 0.5 * (there + back)

    unit_moves = np.eye(len(free), dtype=int)
    along = [both_ways(row.tolist()) for row in unit_moves]
    curvature = np.diag([fall for _, fall in along])
    for i, j in combinations(range(len(free)), 2):
        together, opposed = (both_ways((unit_moves[i] + sign * unit_moves[j]).tolist())[1] for sign in (1, -1))
        # the fall is c_ii + c_jj + 2 c_ij together, and c_ii + c_jj - 2 c_ij opposed
        curvature[i, j] = curvature[j, i] = 0.25 * (together - opposed)
    return LocalShape(free, steps, np.array([rise for rise, _ in along]), curvature)


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
    for _ in range(MOST_ASCENTS):
        local = local_shape(evidence, others, (name, form), ratios)
        if local is None or np.linalg.eigvalsh(local.curvature)[0] <= 0.0:
            break
        ascent = 0.5 * np.linalg.solve(local.curvature, local.slope)
        longest = STEP_SHARES[0] / STEP_SHARES[-1]  # first steps, in finest ones
        ascent *= longest / max(float(np.max(np.abs(ascent))), longest)
        logs = dict(zip(local.free, (ascent * local.steps).tolist(), strict=True))
        further = scaled_form(form, logs)
        gains, _ = gains_of(evidence, others, [(name, form), (name, further)])
        if gains.get(further, -math.inf) <= gains[form] + EQUAL_FIT_DIFFERENCE:
            break
        form = further
    return form


def spread_of_form(
    evidence: Evidence, others: list[Candidate], candidate: Candidate, ratios: Sequence[float]
) -> npt.NDArray[np.float64]:
    """Return the covariance of the logarithms of a form's refined numbers, with all coefficients fitted again.

    The gain falls by the squared deviation in standard errors, so its curvature over the finest step of the search
    gives the covariance. It is infinite for all refined numbers where the gain is not curved downwards in every
    direction, or a neighbouring form is not possible, and zero for a number that is not refined.
    """
    spread = np.diag([math.inf if ratio > 1.0 else 0.0 for ratio in ratios])
    local = local_shape(evidence, others, candidate, ratios)
    if local is not None and np.linalg.eigvalsh(local.curvature)[0] > 0.0:
        spread[np.ix_(local.free, local.free)] = np.linalg.inv(local.curvature) * np.outer(local.steps, local.steps)
    return spread


def grid_values(position: int, form: Form, forms: Sequence[Form]) -> list[float]:
    """Return the grid values of the parameter at one position of a form, ascending.

    Only grid forms whose later parameters equal those of `form` count, or all of them where there is none.
    """
    matching_values = {grid_form[position] for grid_form in forms if grid_form[position + 1 :] == form[position + 1 :]}
    return sorted(matching_values or {grid_form[position] for grid_form in forms})


def best_scanned_form(evidence: Evidence, others: list[Candidate], name: str, form: Form, ratio: float) -> Form:
    """Return the best form between one form and its grid neighbours; a narrow effect may have several local optima.

    ratio : ratio of neighbouring grid values of the first parameter.
    """
    first_values = [form[0] * ratio ** (step / SCAN_STEPS) for step in range(-SCAN_STEPS, SCAN_STEPS + 1)]
    tails = sorted({grid_form[1:] for grid_form in evidence.forms.get(name, [])} | {form[1:]})
    gains, _ = gains_of(evidence, others, [(name, (value, *tail)) for value, tail in product(first_values, tails)])
    return max(gains, key=lambda tried_form: gains[tried_form], default=form)


def gains_of(evidence: Evidence, others: list[Candidate], tried: list[Candidate]) -> tuple[dict[Form, float], bool]:
    """Return the gain of each possible form beside other members, and whether every form is possible."""
    evidence.add(tried)
    normal, base = evidence.normal(), evidence.stack.columns_of(others)
    possible = [item for trial in tried if (item := fit_further_effect(evidence, normal, base, trial)) is not None]
    return {item.candidate[1]: item.gain for item in possible}, len(possible) == len(tried)


def refined_form(evidence: Evidence, others: list[Candidate], name: str, form: Form, ratios: Sequence[float]) -> Form:
    """Search for a better form in the neighbourhood of one form.

    Every combination of one step down, no step and one step up is tried for the first parameters together, since they
    can compensate each other. Steps become finer (`STEP_SHARES`); the search ends where all trials gain alike.

    ratios : the largest ratio of neighbouring grid values of each of these parameters.
    """
    # a fitted strength below one is equal to another form of such an effect, which `make_whole` finds at once: larger
    # moves would lead to a fraction of a longer delay
    strength_is_form = strength_tells_form(name, form)
    for part in STEP_SHARES[:2] if strength_is_form else STEP_SHARES:
        for _ in range(1 if strength_is_form else MOST_MOVES):
            steps = product(*((ratio**-part, 1.0, ratio**part) if ratio > 1.0 else (1.0,) for ratio in ratios))
            tried = [(name, (*map(mul, form, step), *form[len(step) :])) for step in steps]
            gains, all_possible = gains_of(evidence, others, tried)
            best = max(gains, key=lambda tried_form: gains[tried_form], default=form)
            if gains.get(best, -math.inf) <= gains.get(form, -math.inf) + EQUAL_FIT_DIFFERENCE:
                break
            form = best
        if all_possible and max(gains.values()) - min(gains.values()) < LEAST_FORM_DIFFERENCE:
            break
    return form


def prune(evidence: Evidence, hypothesis: list[Candidate]) -> list[Candidate]:
    """Remove members that fail the tests of entry beside the other members, one at a time, the lowest first."""
    while hypothesis:
        evidence.settle(hypothesis)
        normal = evidence.normal()
        members = [member(evidence, normal, hypothesis, k) for k in range(len(hypothesis))]
        heights = [item.height if item is not None else 0.0 for item in members]
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
    return any(CandidateTest(evidence, others, n).exceeds_form_error(hypothesis[index]) for n in NOISE_ROUNDS)


def member(evidence: Evidence, normal: Normal, hypothesis: Sequence[Candidate], index: int) -> FurtherEffect | None:
    """Fit one member of a set in addition to the other members."""
    others = [*hypothesis[:index], *hypothesis[index + 1 :]]
    return fit_further_effect(evidence, normal, evidence.stack.columns_of(others), hypothesis[index])


def describe(evidence: Evidence, hypothesis: list[Candidate]) -> EffectSet:
    """Return a set with its members, their rivals and the further effects, under the weights of the set."""
    hypothesis = make_whole(evidence, hypothesis)
    squares_taken, squares_left = squares_taken_and_left(evidence, hypothesis)
    fit = evidence.settle(hypothesis)
    normal = evidence.normal()
    members, rivals, moved, missed = [], [], [], dict[Candidate, float]()
    for index in range(len(hypothesis)):
        others = hypothesis[:index] + hypothesis[index + 1 :]
        moved.append([abs(amount) for amount in reduction_by_rows(normal, normal.fit(others), fit)])
        item = fit_further_effect(evidence, normal, evidence.stack.columns_of(others), hypothesis[index], whole=True)
        if item is None:  # at full strength the member is no possible effect
            return describe(evidence, others)
        members.append(item)
        ranked = best_of_each(evidence, normal, others, whole=True)
        rivals.append([item, *(r for r in ranked if r.effect != item.effect and is_possible(evidence, r))])
        close = [r.candidate for r in rivals[-1] if item.gain - r.gain < CLOSE_RIVAL_FACTOR * gain_tolerance(item.gain)]
        if len(close) > 1:
            missed |= {rival: missed_by_form(normal, [*others, rival], rival) for rival in close}
    further_effects = best_of_each(evidence, normal, hypothesis)
    return EffectSet(hypothesis, members, rivals, further_effects, fit, squares_taken, squares_left, moved, missed)


def make_whole(evidence: Evidence, hypothesis: list[Candidate]) -> list[Candidate]:
    """Bring shaped members and rivals to the form with a strength of one, so that their gains compare."""
    for index in range(len(hypothesis)):
        others = hypothesis[:index] + hypothesis[index + 1 :]
        for _ in range(WHOLE_ROUNDS):
            evidence.settle(hypothesis)
            best = best_of_each(evidence, evidence.normal(), others)
            shaped = [item for item in best if library()[item.effect].shaped and item.height > ENTRY_HEIGHT]
            whole_forms = [(item.effect, whole_form(item)) for item in shaped]
            evidence.add(whole_forms)
            for candidate in whole_forms:
                if candidate[0] == hypothesis[index][0]:
                    hypothesis[index] = candidate
        normal = evidence.normal()
        ranked = [r for r in best_of_each(evidence, normal, others, whole=True) if r.height > ENTRY_HEIGHT]
        if ranked and library()[ranked[0].effect].shaped and library()[hypothesis[index][0]].shaped:
            hypothesis[index] = ranked[0].candidate
    return hypothesis


def whole_form(item: FurtherEffect) -> tuple[float, ...]:
    """Return the form at which a shaped effect has a strength of one, to three digits."""
    form = library()[item.effect].whole(item.candidate[1], item.values[0])
    return tuple(float(f"{value:.3g}") for value in form)


def squares_taken_and_left(
    evidence: Evidence, hypothesis: Sequence[Candidate], sound: bool = False
) -> tuple[list[float], list[float]]:
    """Return, by group of rows, the weighted squares that a set with its overtones explains, and those that remain.

    Both are weighted by the usual noise; what remains counts beyond `MOST_USUAL_POWER`.

    sound : whether the usual noise is a sound machine's where that is lower.
    """
    overtones = overtones_of(hypothesis)
    evidence.add(overtones)
    evidence.weigh_as_usual(sound)
    normal = evidence.normal()
    fit_without, fit_with = normal.fit(), normal.fit([*hypothesis, *overtones])
    squares_taken = [max(amount, 0.0) for amount in reduction_by_rows(normal, fit_without, fit_with)]
    squares_left = [
        max(normal.weights[k] * normal.residual(fit_with, k) ** 2 - MOST_USUAL_POWER, 0.0) * len(rows.left_over)
        for k, rows in enumerate(normal.stack.rows)
    ]
    return squares_taken, squares_left
