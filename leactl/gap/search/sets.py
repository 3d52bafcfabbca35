"""Small sets of effects searched over Gram matrices: which effects, in which form, leave least over.

A step adds the effect whose columns take most away beyond what recalibration can imitate, then every member is tried
against every other effect with the rest held, so that an early wrong choice is taken back. What an effect must reach
is measured against the size that sound machines in the place of the case give it (`leactl.gap.null`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product
from operator import mul

import numpy as np
import numpy.typing as npt

from leactl.effects import library
from leactl.effects.contract import Form
from leactl.gap.search.evidence import Evidence
from leactl.gap.search.free_forms import missed_by_form, outdoes_free_forms
from leactl.gap.search.regression import Candidate, Fit, Normal, Stack, gain_of
from leactl.gap.search.stamp_fit import delay_of_stamps
from leactl.vocabulary.effect import effect_definition

Array = npt.NDArray[np.float64]
MOST = 3  # effects in a set
ENTRY = 3.2  # times its floor and uncertainty, that an effect must be large to enter a set
SAME = 1e-3  # of twice a log likelihood, by which fits are alike
EXCHANGES = 4
MOVES = 4  # of a form, at each of some steps:
FINER = (1 / 3, 1 / 9, 1 / 27, 1 / 81)  # of the grid's ratio, on a logarithmic scale
SCANNED = 8  # trials from one value of a narrow effect's grid to the next
ALIKE = 2.0  # weighted squares, by which forms may differ that nothing tells apart
NOISE_ROUNDS = (2, 0)  # times that the noise is taken from what a set leaves over; 0 keeps the usual noise
SHORTLIST = 4
USUAL_SPREAD = 2.0  # of a sound machine's noise, by which the next one may differ
WHOLE_ROUNDS = 2
WAVE = ("cos", "sin")  # coefficients that make one amplitude
OVERTONES = (2.0, 3.0)  # multiples of an order that a machine's wave has beside it
LOOSE, LOOSE_ERROR = 0.8, 0.1  # the same where an effect must explain less than that by its own account
TIE = 1e-6  # of a gain, by which the unusual one of two effects with the same columns stands behind; far above rounding
RIVAL_FORM_ERROR = 0.005  # of a gain, standard deviation of the difference of two forms that are both nearly right
CLOSE = 10.0  # times how far apart gains may be (`apart`), within which a rival's gain is close
UNSHOWN = 0.05  # prior odds of a spring whose rest no run comes by against an effect that pulls one way by its nature
FORM_ERROR = 0.03  # share of what a set explains, in squares, that its own forms may miss; 17 % of the amplitude
ERROR_ELSEWHERE = 0.01  # the same over variables in which none of it acts
BEYOND = 2.0  # times the largest size of an effect's definition: a geared servo has half more than benches of one stage
INTERVAL = 1.96  # standard deviations on either side that hold 95 %
SHAPE = (0.3, 3.0)  # how much of a shape may be there: neighbours in a grid stand 2.1 times apart at most


@dataclass(frozen=True)
class FurtherEffect:
    """One effect beyond a base hypothesis."""

    candidate: Candidate
    gain: float  # weighted squares that it takes away
    size: float  # in units of its leading parameter
    std: float
    values: tuple[float, ...]
    names: tuple[str, ...]
    covariance: Array
    floor: float  # size that a sound machine gives it
    by_chance: float = 0.0  # square of it in standard errors, by which the best of the orders tried is larger by noise

    @property
    def effect(self) -> str:
        """The effect's name."""
        return self.candidate[0]

    @property
    def directed(self) -> Array:
        """Signed size; of a wave, a vector (cos, sin) with that length."""
        return self._scale * np.asarray(self.values)[leading_of(self.names)]

    @property
    def directed_variance(self) -> float:
        """Variance of `directed`, summed over its coefficients."""
        leading = leading_of(self.names)
        return self._scale**2 * float(np.trace(self.covariance[np.ix_(leading, leading)]))

    @property
    def _scale(self) -> float:
        """Size over the length of the leading coefficients."""
        own = np.asarray(self.values)[leading_of(self.names)]
        return self.size / max(float(np.linalg.norm(own)), 1e-300)

    @property
    def height(self) -> float:
        """Size, beyond what the best of many has by noise, over what noise and model error alone would give it."""
        beyond = math.sqrt(max(self.size**2 - self.by_chance * self.std**2, 0.0))
        return beyond / math.hypot(self.std, self.floor)


def finding(
    evidence: Evidence,
    normal: Normal,
    base: npt.NDArray[np.intp],
    candidate: Candidate,
    whole: bool = False,
    free: bool = False,
) -> FurtherEffect | None:
    """What one form of an effect takes away beyond a base.

    None where no run shows it, where its sign makes no sense, and where its whole interval is beyond the range in which
    the effect is met: what would have to be so large is something else. A free one may have any sign and size.
    """
    added = evidence.columns(candidate)
    if len(added) == 0:
        return None
    gain, values, covariance = gain_of(normal, base, added)
    effect = library()[candidate[0]]
    if not effect.is_usual(evidence.travel):
        gain *= 1.0 - TIE
    if effect.one_sided and values[0] <= 0.0 and not free:
        return None
    if effect.shaped and not (covariance[0, 0] < SHAPE[1] ** 2 and (free or SHAPE[0] < values[0] < SHAPE[1])):
        return None
    if effect.shaped and whole:
        gain = float((2.0 * values[0] - 1.0) / covariance[0, 0])  # of the shape as it is, not of a share of it
    names = tuple(evidence.coefficient(place) for place in added)
    coefficients = dict(zip(names, values.tolist(), strict=True))
    if not free and not effect.is_distinct(candidate[1], coefficients, evidence.visited):
        gain -= behind(gain)
    if effect.shaped and free:
        coefficients[names[0]] = min(abs(coefficients[names[0]]), SHAPE[1])
    size = effect.size(candidate[1], coefficients, evidence.model)
    leading = leading_of(names)
    own, spread = values[leading], covariance[np.ix_(leading, leading)]
    length = max(float(np.linalg.norm(own)), 1e-300)
    if not (np.isfinite(own).all() and np.isfinite(spread).all()):
        return None
    direction = own / length
    std = size / length * math.sqrt(max(float(direction @ spread @ direction), 0.0))
    floor = evidence.floor(candidate)
    if effect.delays:  # a delay within what stamps may be is no effect, however surely it is there
        floor = max(floor, delay_of_stamps(evidence.stack, evidence.on_time, candidate) / ENTRY)
    by_chance = 2.0 * math.log(effect.orders[1] - effect.orders[0] + 1) if effect.periodic else 0.0
    result = FurtherEffect(candidate, gain, size, std, tuple(values.tolist()), names, covariance, floor, by_chance)
    return result if whole or free or is_possible(evidence, result) else None


def leading_of(names: Sequence[str]) -> list[int]:
    """Places of the coefficients that tell an effect's size: both of a wave, else the first."""
    return [k for k, name in enumerate(names) if name in WAVE] or [0]


def apart(gain: float) -> float:
    """How far apart the gains of two effects may be by noise and by what their forms miss."""
    return 1.0 + RIVAL_FORM_ERROR * gain


def behind(gain: float) -> float:
    """How far an effect stands behind its gain that the runs show as a constant torque only: by prior odds."""
    return -2.0 * apart(gain) * math.log(UNSHOWN)


def by_themselves(evidence: Evidence) -> dict[str, list[FurtherEffect | None]]:
    """Every effect by itself, whatever its sign, in each form that is tried; None in forms that no run shows."""
    normal, base = evidence.normal(), evidence.stack.columns_of([])
    tried: dict[str, list[FurtherEffect | None]] = {}
    for candidate in evidence.candidates:
        tried.setdefault(candidate[0], []).append(finding(evidence, normal, base, candidate, free=True))
    return tried


def sizes_by_chance(name: str, items: Sequence[FurtherEffect | None]) -> list[float]:
    """Size of an effect beyond what noise explains, in each form that is tried; empty where nothing is gained.

    It is measured in the form that takes most away and told in the others by their standard errors: a form that the
    runs hardly show is large where one that they show well is small. Of a periodic effect the best order stands for
    all. The best of many forms is larger by noise than one: the largest of n squares of unit variance is about
    1 + 2 ln n.
    """
    effect = library()[name]
    best = max((item for item in items if item is not None), key=lambda item: item.gain, default=None)
    if best is None or best.gain <= 0.0:
        return []
    count = effect.orders[1] - effect.orders[0] + 1 if effect.periodic else len(effect.forms)
    beyond = math.sqrt(max(best.size**2 - best.std**2 * (1.0 + 2.0 * math.log(count)), 0.0))
    stds = [best.std if item is None or effect.periodic else item.std for item in items]
    most = BEYOND * effect_definition(name).largest
    sizes = [min(beyond * std / best.std, most) for std in stds]
    return sizes[:1] if effect.periodic else sizes


def standard_errors(name: str, items: Sequence[FurtherEffect | None]) -> list[float]:
    """Standard error of an effect in each form that is tried, infinite where no run shows one; of orders the least."""
    stds = [math.inf if item is None else item.std for item in items]
    return [min(stds)] if library()[name].periodic else stds


def is_possible(evidence: Evidence, item: FurtherEffect) -> bool:
    """Whether an effect is met in such a size; nothing is said against what noise alone would give."""
    if is_beyond_range(item) or item.size + INTERVAL * item.std < library()[item.effect].least:
        return False
    places = evidence.columns(item.candidate)
    return item.height <= ENTRY or not outweighs(evidence.stack, places, np.asarray(item.values))


def is_beyond_range(item: FurtherEffect) -> bool:
    """Whether the whole interval of an effect's size is beyond the range in which the effect is met."""
    return item.size - INTERVAL * item.std > BEYOND * effect_definition(item.effect).largest


def outweighs(stack: Stack, added: npt.NDArray[np.intp], values: Array) -> bool:
    """Whether a wave over the angle is higher than all other parts of an equation together.

    Where the shaft hardly turns, what is seen of such a wave is a line, which something else makes.
    """
    if not all(stack.names[place][3] in WAVE for place in added):
        return False
    for gram, local in zip(stack.grams, stack.local, strict=True):
        touched = 1 + np.flatnonzero(np.isin(local, added))
        parts = [0, *(1 + k for k, place in enumerate(local) if stack.names[place][0] == "calibration")]
        power = np.diag(gram)
        if len(parts) > 1 and values @ values * power[touched].sum() / 2.0 > np.sqrt(power[parts]).sum() ** 2:
            return True
    return False


def best_of_each(
    evidence: Evidence, normal: Normal, hypothesis: Sequence[Candidate], whole: bool = False
) -> list[FurtherEffect]:
    """The best form of every effect beyond a hypothesis, by gain, largest first."""
    base = evidence.stack.columns_of(hypothesis)
    taken = {effect for effect, _ in hypothesis}
    best: dict[str, FurtherEffect] = {}
    for candidate in evidence.candidates:
        if candidate[0] in taken:
            continue
        shown = finding(evidence, normal, base, candidate, whole)
        if shown is not None and (candidate[0] not in best or shown.gain > best[candidate[0]].gain):
            best[candidate[0]] = shown
    return sorted(best.values(), key=lambda item: -item.gain)


@dataclass
class EffectSet:
    """The set that a search ended with."""

    hypothesis: list[Candidate]
    members: list[FurtherEffect]  # each beyond the others
    rivals: list[list[FurtherEffect]]  # for each member: every effect in its place, itself among them
    rest: list[FurtherEffect]  # what would come next
    fit: Fit
    taken: list[float]  # of each rows: weighted squares under usual noise that the set takes away, with its overtones,
    left: list[float]  # and what is left there beyond usual noise
    moved: list[list[float]]  # for each member, of each rows: misfit that leaving it out moves, either way
    missed: dict[Candidate, float]  # squares that the free forms of members and their close rivals explain further

    def explained(self, evidence: Evidence, index: int) -> float:
        """Share of what calibration leaves beyond usual noise that the whole set takes away, where a member acts.

        The smaller of two: in the rows that its columns touch, and in those whose misfit it moves. An effect that only
        balances a sound channel against one that nothing explains is owed to what is missing there.
        """
        candidate = self.members[index].candidate
        gone = shared_with(evidence, candidate, self.taken)
        touched = gone / (gone + shared_with(evidence, candidate, self.left)) if gone > 0.0 else 0.0
        return min(touched, self._explained_where_moved(evidence, self.moved[index]))

    def _explained_where_moved(self, evidence: Evidence, moved: Sequence[float]) -> float:
        taken: dict[tuple[str, str], float] = {}
        whole: dict[tuple[str, str], float] = {}
        places = [(rows.equation, rows.mechanical) for rows in evidence.stack.rows]
        for place, gone, left in zip(places, self.taken, self.left, strict=True):
            taken[place] = taken.get(place, 0.0) + gone
            whole[place] = whole.get(place, 0.0) + gone + left
        shares = [taken[place] / whole[place] if whole[place] > 0.0 else 1.0 for place in places]
        return sum(m * share for m, share in zip(moved, shares, strict=True)) / max(sum(moved), 1e-300)


def search(evidence: Evidence) -> EffectSet:
    """Find the set of effects that explains the runs."""
    hypothesis: list[Candidate] = []
    while len(hypothesis) < MOST:
        added = step(evidence, hypothesis)
        if added is None:
            break
        hypothesis = exchange(evidence, [*hypothesis, added])
        hypothesis = replace_by_refined_rivals(evidence, refine(evidence, hypothesis))
    evidence.settle(hypothesis)  # finer forms leave less noise, under which they are told more finely
    return describe(evidence, prune(evidence, refine(evidence, hypothesis)))


def step(evidence: Evidence, hypothesis: Sequence[Candidate]) -> Candidate | None:
    """The effect to add, or None where none stands above its floor.

    Ranked twice, under the noise that is usual and under what the present set leaves: the first sees an effect that
    touches everything, the second one that touches a quiet channel. The best of both lists is found by fitting.
    """
    listed = shortlist(evidence, hypothesis)
    if len(listed) > 1:
        trials = []
        for candidate in listed:
            evidence.settle([*hypothesis, candidate])
            trials.append((evidence.surprise(), candidate))
        least = min(surprise for surprise, _ in trials)
        return next(candidate for surprise, candidate in trials if surprise < least + SAME)  # the first of the list
    return listed[0] if listed else None


def shortlist(evidence: Evidence, hypothesis: Sequence[Candidate]) -> list[Candidate]:
    """The effects worth fitting beside a set."""
    listed: list[Candidate] = []
    for rounds in NOISE_ROUNDS:
        test = CandidateTest(evidence, hypothesis, rounds)
        ranked = [
            item.candidate
            for item in best_of_each(evidence, test.normal, hypothesis)
            if item.height > ENTRY and test.exceeds_form_error(item.candidate)
        ]
        listed += [candidate for candidate in ranked[:SHORTLIST] if candidate not in listed]
    return listed


class CandidateTest:
    """Tests whether a further effect lowers the misfit by more than the forms of a set could, which are inexact.

    A form explains its effect to within a share (`form_error`); nobody can say in which rows it is wrong. So that share
    of the misfit that a member removes from an equation is allowed for in all rows of the equation. Waves of a set are
    joined by their overtones first: no machine's wave is a pure sine. What a member's law misses over its own variables
    is measured on the case besides (`leactl.gap.search.free_forms`).
    """

    def __init__(self, evidence: Evidence, hypothesis: Sequence[Candidate], rounds: int) -> None:
        """Fit the set; the noise of `evidence` is that of this fit from here on.

        rounds : as `NOISE_ROUNDS` has them.
        """
        overtones = overtones_of(hypothesis)
        evidence.add(overtones)
        fit = evidence.settle(hypothesis, rounds)
        self.normal = evidence.normal()
        self._wider = [*hypothesis, *overtones]
        self._fit = self.normal.fit(self._wider) if overtones else fit
        self._reductions = {name: self._reduction_by(fit, hypothesis, k) for k, (name, _) in enumerate(hypothesis)}

    def exceeds_form_error(self, candidate: Candidate) -> bool:
        """Whether a candidate lowers the misfit by more than the errors of the set's forms could, by `ENTRY` squared.

        In each equation a change up to the allowance counts as none, whichever its sign; what the priors of the
        parameters cost counts in full.
        """
        larger = self.normal.fit([*self._wider, candidate])
        reduction = self._fit.misfit - larger.misfit
        for equation, change in by_equation(self.normal, reduction_by_rows(self.normal, self._fit, larger)).items():
            allowance = sum(
                form_error(name, candidate[0]) * max(of_member[equation], 0.0)
                for name, of_member in self._reductions.items()
            )
            reduction -= min(max(change, -allowance), allowance)
        return reduction > ENTRY**2 and outdoes_free_forms(self.normal, self._wider, candidate)

    def _reduction_by(self, fit: Fit, hypothesis: Sequence[Candidate], index: int) -> dict[str, float]:
        """By how much one member lowers the misfit of each equation beside the others."""
        others = [*hypothesis[:index], *hypothesis[index + 1 :]]
        return by_equation(self.normal, reduction_by_rows(self.normal, self.normal.fit(others), fit))


def form_error(effect: str, other: str) -> float:
    """Share of the misfit removed by an effect that another could remove because the first one's form is inexact.

    `LOOSE_ERROR` for an effect whose columns are known to be loose; `FORM_ERROR` for two effects that act over a common
    variable and are both waves over the angle or neither; else `ERROR_ELSEWHERE`.
    """
    if library()[effect].explains < LOOSE:
        return LOOSE_ERROR
    first, second = (set(effect_definition(name).acts_over) for name in (effect, other))
    both_or_neither_wave = (library()[effect].orders[1] > 0) == (library()[other].orders[1] > 0)
    return FORM_ERROR if first & second and both_or_neither_wave else ERROR_ELSEWHERE


def overtones_of(hypothesis: Sequence[Candidate]) -> list[Candidate]:
    """Multiples of the orders of a set's waves, as far as the library tries them."""
    return [
        (name, (times * form[0], *form[1:]))
        for name, form in hypothesis
        for times in OVERTONES
        if form and times * form[0] <= library()[name].orders[1]
    ]


def by_equation(normal: Normal, amounts: Sequence[float]) -> dict[str, float]:
    """Sums over the rows of each equation."""
    sums: dict[str, float] = {}
    for rows, amount in zip(normal.stack.rows, amounts, strict=True):
        sums[rows.equation] = sums.get(rows.equation, 0.0) + amount
    return sums


def reduction_by_rows(normal: Normal, before: Fit, after: Fit) -> list[float]:
    """By how much the misfit of each rows is lower with one fit than with another; negative where it is higher."""
    return [
        normal.weights[k] * len(rows.left_over) * (normal.residual(before, k) ** 2 - normal.residual(after, k) ** 2)
        for k, rows in enumerate(normal.stack.rows)
    ]


def shared_with(evidence: Evidence, candidate: Candidate, explained: Sequence[float]) -> float:
    """What a set explains in the rows that a candidate touches."""
    key = (candidate[0], repr(candidate[1]))
    return sum(
        amount
        for amount, rows in zip(explained, evidence.stack.rows, strict=True)
        if any(name[0] == "effect" and (name[1], name[2]) == key for name in rows.columns)
    )


def exchange(evidence: Evidence, hypothesis: list[Candidate]) -> list[Candidate]:
    """Try every member against every other effect, with the rest held, until nothing gains."""
    for _ in range(EXCHANGES):
        evidence.settle(hypothesis)
        normal, changed = evidence.normal(), False
        for index in range(len(hypothesis)):
            others = hypothesis[:index] + hypothesis[index + 1 :]
            ranked = [item for item in best_of_each(evidence, normal, others) if item.height > ENTRY]
            if ranked and ranked[0].candidate != hypothesis[index]:
                changed = changed or ranked[0].effect != hypothesis[index][0]
                hypothesis = [*hypothesis[:index], ranked[0].candidate, *hypothesis[index + 1 :]]
        if not changed:
            break
    return hypothesis


def refine(evidence: Evidence, hypothesis: list[Candidate], shapes: bool = True) -> list[Candidate]:
    """Find the non-linear parameters of each member between the grid's values and a little beyond.

    shapes : whether also those that their strength tells.
    """
    for index, candidate in enumerate(hypothesis):
        if shapes or not strength_tells_form(*candidate):
            hypothesis[index] = refined_beside(evidence, hypothesis[:index] + hypothesis[index + 1 :], candidate)
    return hypothesis


def refined_beside(evidence: Evidence, others: list[Candidate], candidate: Candidate) -> Candidate:
    """The candidate in its best form beside others; stores the covariance of that form in `evidence.form_spread`."""
    name, form = candidate
    effect = library()[name]
    if not form or effect.periodic or not effect.continuous:
        return candidate
    grids = [grid_values(place, form, evidence.forms.get(name, [])) for place in range(effect.refined)]
    ratios = [max((b / a for a, b in pairwise(grid)), default=1.0) for grid in grids]
    if effect.narrow:
        form = scanned(evidence, others, name, form, ratios[0])
    form = refined(evidence, others, name, form, ratios)
    if not strength_tells_form(name, form):
        evidence.form_spread[name, form] = spread_of_form(evidence, others, (name, form), ratios)
    return name, form


def replace_by_refined_rivals(evidence: Evidence, hypothesis: list[Candidate]) -> list[Candidate]:
    """Refine the close rivals of each member; then put whichever effect takes most away in its place.

    The grid's values are coarse for a form with a threshold: the effect whose value lies nearer to the grid gains more,
    whether or not it is the one that acts.
    """
    for index, candidate in enumerate(hypothesis):
        others = hypothesis[:index] + hypothesis[index + 1 :]
        ranked = best_of_each(evidence, evidence.normal(), others)
        gain = next((item.gain for item in ranked if item.effect == candidate[0]), math.inf)
        close = [
            item.candidate
            for item in ranked
            if item.height > ENTRY
            and gain - item.gain < CLOSE * apart(gain)
            and item.effect != candidate[0]
            and not strength_tells_form(*item.candidate)
        ]
        for rival in close[:SHORTLIST]:
            refined_beside(evidence, others, rival)  # its finer forms are among the candidates from here on
        if close:
            best = best_of_each(evidence, evidence.normal(), others)
            if best[0].height > ENTRY:
                hypothesis[index] = best[0].candidate
    return hypothesis


def strength_tells_form(name: str, form: Form) -> bool:
    """Whether a share of an effect in one form stands for all of it in another."""
    return library()[name].shaped and library()[name].whole(form, 0.5) != form


def spread_of_form(
    evidence: Evidence, others: list[Candidate], candidate: Candidate, ratios: Sequence[float]
) -> npt.NDArray[np.float64]:
    """Covariance of the logarithms of a form's refined numbers, all coefficients being fitted anew.

    The gain falls by the squared deviation in standard errors: its curvature, over the finest step of the search, tells
    them. Infinite where it does not fall to both sides, as at the edge of what is possible; zero for a number that is
    not refined.
    """
    name, form = candidate
    free = [index for index, ratio in enumerate(ratios) if ratio > 1.0]
    steps = [FINER[-1] * math.log(ratios[index]) for index in free]
    moves = {move for move in product((-1, 0, 1), repeat=len(free)) if sum(map(abs, move)) <= 2}

    def moved(move: Sequence[int]) -> Form:
        logs = dict(zip(free, map(mul, move, steps), strict=True))
        return tuple(number * math.exp(logs.get(index, 0.0)) for index, number in enumerate(form))

    gains, all_possible = gains_of(evidence, others, [(name, moved(move)) for move in sorted(moves)])
    spread = np.zeros((len(ratios), len(ratios)))
    at = np.ix_(free, free)
    spread[at] = np.diag(np.full(len(free), math.inf))
    if not all_possible or not free:
        return spread
    falls = {move: gains[form] - gains[moved(move)] for move in moves}

    def fall_along(move: Sequence[int]) -> float:
        """The mean of both directions, which is free of a slope."""
        return 0.5 * (falls[tuple(move)] + falls[tuple(-part for part in move)])

    own = np.eye(len(free), dtype=int)
    curvature = np.diag([fall_along(row.tolist()) for row in own])
    for i, j in combinations(range(len(free)), 2):
        together, opposed = fall_along((own[i] + own[j]).tolist()), fall_along((own[i] - own[j]).tolist())
        curvature[i, j] = curvature[j, i] = 0.25 * (together - opposed)
    if np.linalg.eigvalsh(curvature)[0] > 0.0:
        spread[at] = np.linalg.inv(curvature) * np.outer(steps, steps)
    return spread


def grid_values(place: int, form: Form, forms: Sequence[Form]) -> list[float]:
    """Values of one parameter of a form on the grid, in ascending order.

    Only grid forms count whose later parameters equal those of `form`; where there are none, all of them.
    """
    alike = {other[place] for other in forms if other[place + 1 :] == form[place + 1 :]}
    return sorted(alike or {other[place] for other in forms})


def scanned(evidence: Evidence, others: list[Candidate], name: str, form: Form, ratio: float) -> Form:
    """Search between one form and its neighbours on the grid, where a narrow effect may have several best forms.

    ratio : of neighbouring grid values of the first parameter.
    """
    near = [form[0] * ratio ** (step / SCANNED) for step in range(-SCANNED, SCANNED + 1)]
    later = sorted({other[1:] for other in evidence.forms.get(name, [])} | {form[1:]})
    gains, _ = gains_of(evidence, others, [(name, (value, *rest)) for value, rest in product(near, later)])
    return max(gains, key=lambda tried_form: gains[tried_form], default=form)


def gains_of(evidence: Evidence, others: list[Candidate], tried: list[Candidate]) -> tuple[dict[Form, float], bool]:
    """What each form gains beside other members, by form, and whether every one is possible there."""
    evidence.add(tried)
    normal, base = evidence.normal(), evidence.stack.columns_of(others)
    possible = [item for one in tried if (item := finding(evidence, normal, base, one)) is not None]
    return {item.candidate[1]: item.gain for item in possible}, len(possible) == len(tried)


def refined(evidence: Evidence, others: list[Candidate], name: str, form: Form, ratios: Sequence[float]) -> Form:
    """Search for a better form near one.

    Every combination of one step down, none or one step up is tried for the first parameters together, since they can
    compensate each other. Steps become finer (`FINER`); the search ends where all trials explain the runs alike.

    ratios : the largest ratio of neighbouring grid values of each of these parameters.
    """
    # a fitted strength below one stands for another form of such an effect (`whole`), which `make_whole` goes to at
    # once: larger moves would go to a longer delay of which a share is there
    strength_is_form = strength_tells_form(name, form)
    for part in FINER[:2] if strength_is_form else FINER:
        for _ in range(1 if strength_is_form else MOVES):
            steps = product(*((ratio**-part, 1.0, ratio**part) if ratio > 1.0 else (1.0,) for ratio in ratios))
            tried = [(name, (*map(mul, form, step), *form[len(step) :])) for step in steps]
            gains, all_possible = gains_of(evidence, others, tried)
            best = max(gains, key=lambda tried_form: gains[tried_form], default=form)
            if gains.get(best, -math.inf) <= gains.get(form, -math.inf) + SAME:
                break
            form = best
        if all_possible and max(gains.values()) - min(gains.values()) < ALIKE:
            break
    return form


def prune(evidence: Evidence, hypothesis: list[Candidate]) -> list[Candidate]:
    """Remove members that do not pass the tests of entry beside the others, one at a time, the lowest first."""
    while hypothesis:
        evidence.settle(hypothesis)
        normal = evidence.normal()
        members = [member(evidence, normal, hypothesis, k) for k in range(len(hypothesis))]
        heights = [item.height if item is not None else 0.0 for item in members]
        lowest_first = [int(k) for k in np.argsort(heights, kind="stable")]
        if heights[lowest_first[0]] <= ENTRY:
            unsupported: int | None = lowest_first[0]
        else:
            unsupported = next((k for k in lowest_first if not stands_beside(evidence, hypothesis, k)), None)
        if unsupported is None:
            break
        hypothesis = hypothesis[:unsupported] + hypothesis[unsupported + 1 :]
    return hypothesis


def stands_beside(evidence: Evidence, hypothesis: Sequence[Candidate], index: int) -> bool:
    """Whether a member lowers the misfit by more than the form errors of the others could, under either noise."""
    others = [*hypothesis[:index], *hypothesis[index + 1 :]]
    return any(CandidateTest(evidence, others, n).exceeds_form_error(hypothesis[index]) for n in NOISE_ROUNDS)


def member(evidence: Evidence, normal: Normal, hypothesis: Sequence[Candidate], index: int) -> FurtherEffect | None:
    """One member of a set beyond the others."""
    others = [*hypothesis[:index], *hypothesis[index + 1 :]]
    return finding(evidence, normal, evidence.stack.columns_of(others), hypothesis[index])


def describe(evidence: Evidence, hypothesis: list[Candidate]) -> EffectSet:
    """Members, rivals and what would come next, under the weights of the set."""
    hypothesis = make_whole(evidence, hypothesis)
    taken, left = taken_and_left(evidence, hypothesis)
    fit = evidence.settle(hypothesis)
    normal = evidence.normal()
    members, rivals, moved, missed = [], [], [], dict[Candidate, float]()
    for index in range(len(hypothesis)):
        others = hypothesis[:index] + hypothesis[index + 1 :]
        moved.append([abs(amount) for amount in reduction_by_rows(normal, normal.fit(others), fit)])
        item = finding(evidence, normal, evidence.stack.columns_of(others), hypothesis[index], whole=True)
        if item is None:  # brought to its whole form it has no place beside the others
            return describe(evidence, others)
        members.append(item)
        ranked = best_of_each(evidence, normal, others, whole=True)
        rivals.append([item, *(r for r in ranked if r.effect != item.effect and is_possible(evidence, r))])
        close = [r.candidate for r in rivals[-1] if item.gain - r.gain < CLOSE * apart(item.gain)]
        if len(close) > 1:
            missed |= {one: missed_by_form(normal, [*others, one], one) for one in close}
    rest = best_of_each(evidence, normal, hypothesis)
    return EffectSet(hypothesis, members, rivals, rest, fit, taken, left, moved, missed)


def make_whole(evidence: Evidence, hypothesis: list[Candidate]) -> list[Candidate]:
    """Bring every shape, of members and of their rivals, to the form at which it is whole, so that forms compare."""
    for index in range(len(hypothesis)):
        others = hypothesis[:index] + hypothesis[index + 1 :]
        for _ in range(WHOLE_ROUNDS):
            evidence.settle(hypothesis)
            best = best_of_each(evidence, evidence.normal(), others)
            shaped = [item for item in best if library()[item.effect].shaped and item.height > ENTRY]
            fresh = [(item.effect, whole_form(item)) for item in shaped]
            evidence.add(fresh)
            for candidate in fresh:
                if candidate[0] == hypothesis[index][0]:
                    hypothesis[index] = candidate
        normal = evidence.normal()
        ranked = [r for r in best_of_each(evidence, normal, others, whole=True) if r.height > ENTRY]
        if ranked and library()[ranked[0].effect].shaped and library()[hypothesis[index][0]].shaped:
            hypothesis[index] = ranked[0].candidate
    return hypothesis


def whole_form(item: FurtherEffect) -> tuple[float, ...]:
    """The form at which a shape would be whole, to three digits."""
    form = library()[item.effect].whole(item.candidate[1], item.values[0])
    return tuple(float(f"{value:.3g}") for value in form)


def taken_and_left(
    evidence: Evidence, hypothesis: Sequence[Candidate], sound: bool = False
) -> tuple[list[float], list[float]]:
    """Of each rows, under usual noise: weighted squares that a set and its overtones take away, and what they leave.

    sound : whether usual noise is a sound machine's where that is less.
    """
    overtones = overtones_of(hypothesis)
    evidence.add(overtones)
    evidence.weigh_as_usual(sound)
    normal = evidence.normal()
    before, after = normal.fit(), normal.fit([*hypothesis, *overtones])
    taken = [max(amount, 0.0) for amount in reduction_by_rows(normal, before, after)]
    left = [
        max(normal.weights[k] * normal.residual(after, k) ** 2 - USUAL_SPREAD, 0.0) * len(rows.left_over)
        for k, rows in enumerate(normal.stack.rows)
    ]
    return taken, left
