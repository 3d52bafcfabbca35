"""Fit sets of effects to a servo's free runs by simulation, and keep the effects without which the fit is worse.

A servo does not log its torque, and a balance of torques is linear in parameters that change by half where friction and
torque constant trade places; a simulation of the angle avoids both. Effects are fitted in sets, each from the fits of
smaller ones: friction that falls with speed does not show while friction that grows with load is missing. The evidence
for an effect is how much worse the final set fits without it, refitted.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from leactl.gap.search.effect_regression import rows_per_independent
from leactl.gap.search.regression import Candidate
from leactl.gap.servo.fit import FINAL_LEAST_GAIN, FittedServo, MeasuredServoRuns, cost, fit
from leactl.gap.servo.limits import DRIVE_EFFECTS, acts, drive_starts, to_effect_parameters, to_fit_parameters
from leactl.gap.servo.profile import PROFILE_PARAMETERS
from leactl.gap.servo.runs import ServoRuns, runs_at_common_rate, servo_runs
from leactl.gap.servo.simulation import Parameters, parts_of, table
from leactl.gap.signals.record import Record
from leactl.gap.verdict.decision import LISTED_PROBABILITY, NAMED_PROBABILITY
from leactl.gap.verdict.judge import UNCONFIRMED_FACTOR, presence
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
EffectSet = frozenset[str]
MODEL_PARAMETERS = ("torque_constant", "phase_resistance", "rotor_inertia", "viscous_damping", "coulomb_friction")
RIG_PARAMETERS = ("load_zero", "reference_delay", "voltage_delay")  # parameters that no model file holds
ALWAYS_TRIED: EffectSet = frozenset({"load_dependent_friction", "saturation", "stribeck"})
MOST_PROPOSED_EFFECTS = 2  # effects proposed by a balance that are tried in addition
COST_FORM_ERROR = 0.05  # relative gain in cost of an effect that only imitates another, or by chance of the search
"""On the XL330's logs, friction over the angle at any order gains 2 to 15 % beyond the others, by where a fit ends."""
DRIVE_FORM_ERROR = 0.01  # share of the cost removed by the drive's effects that their inexact forms may leave
IGNORED_RMS_COUNTS = 1.0  # RMS error in encoder counts below which a closer fit does not matter
START_LOSS = 0.1  # share of the torque lost at the largest current, from which fits of saturation begin
START_STRIBECK_SHARES = (0.03, 0.15)  # Stribeck velocities from which fits begin, as shares of the fast speeds
SIZE_ALWAYS_TRIED = 2  # effects; sets up to this size are tried even if smaller ones gain little
FEWEST_RUNS_FOR_SPREAD = 4  # runs; with fewer, standard errors do not include the spread between runs


@dataclass(frozen=True, eq=False)
class LikelyEffect:
    """An effect with its probability."""

    effect: str
    probability: float
    share: float  # of the set's reduction of the cost
    parameters: Mapping[str, tuple[float, float]]  # value and standard error
    peers: tuple[str, ...] = ()  # effects that would fit as well in its place


@dataclass(frozen=True, eq=False)
class FittedEffectSets:
    """Effects fitted to a servo's free runs, and the model with and without them."""

    standing: tuple[LikelyEffect, ...]  # effects that were tried, most probable first
    calibrated: FittedServo  # without fitted effects
    augmented: FittedServo  # with the effects that are named
    stds: Mapping[str, float]  # of the parameters of the augmented model
    sets: Mapping[EffectSet, FittedServo]  # best fit of every set that was tried
    reference_delay: float  # s, delay of the reference after its stamps


def fit_effect_sets(
    records: Sequence[Record], held_out: Sequence[Record], model: Model, proposed: Sequence[Candidate]
) -> FittedEffectSets:
    """Fit sets of the effects that the simulation includes to `records`, and return the effects that stand.

    Effects of the drive are fitted first, since they change all that follows. The candidates that a balance of torques
    proposed give the forms in which effects are tried; held-out runs only confirm or weaken effects.

    Raises
    ------
    InputError : a run without a position servo, or runs sampled at different rates.
    """
    runs = servo_runs(records, model)
    fixed_parameters = parameters_of_model_effects(model)
    model_effects = {name.partition(".")[0] for name in fixed_parameters}
    held_parameters = (*fixed_parameters, *unidentifiable(runs))
    start_parameters = (
        {name: float(getattr(model, name) or 0.0) for name in MODEL_PARAMETERS}
        | dict.fromkeys(RIG_PARAMETERS, 0.0)
        | fixed_parameters
    )
    (fit_without_effects,) = fit(runs, [start_parameters | {"reference_delay": runs.interval}], held_parameters)
    sets = FittedSets(runs, {frozenset(): fit_without_effects}, held_parameters)
    limit_starts = drive_starts(runs, [start_parameters, fit_without_effects.parameters])
    drive_effects = sets.grow(
        frozenset(), {name: starts for name, starts in limit_starts.items() if name not in model_effects}
    )
    starts = {name: start for name, start in starts_of(runs, model, proposed).items() if name not in model_effects}
    tried_effects: EffectSet = frozenset(ALWAYS_TRIED & starts.keys())
    members = sets.grow(drive_effects, {name: starts[name] for name in sorted(tried_effects)})
    for effect in [name for name, _ in proposed if name in starts.keys() - ALWAYS_TRIED][:MOST_PROPOSED_EFFECTS]:
        smaller_sets = [
            drive_effects.union(subset)
            for size in range(len(tried_effects) + 1)
            for subset in combinations(sorted(tried_effects), size)
        ]
        # sets are not tried beyond one that follows the runs closely
        smaller_sets = [subset for subset in smaller_sets if subset in sets]
        fits = fit(runs, [sets[subset].parameters | starts[effect][0] for subset in smaller_sets], held_parameters)
        sets.update({subset | {effect}: fitted for subset, fitted in zip(smaller_sets, fits, strict=True)})
        # a luckier search is no gain of the effect: fit again without it, from where the fit with it ended
        refits = fit(
            runs, [without_effects(fitted.parameters, frozenset({effect})) for fitted in fits], held_parameters
        )
        sets.update(
            {
                subset: refit
                for subset, refit in zip(smaller_sets, refits, strict=True)
                if refit.cost < sets[subset].cost
            }
        )
        members = sets.pruned(max(smaller_sets, key=len) | {effect})
        tried_effects = members - drive_effects
    held_out_servos = runs_at_common_rate(held_out, model)
    sets.fit_missing([members - {name} for name in sorted(members)], members)
    standing = likely_effects(sets, members, runs, servo_runs(held_out_servos, model) if held_out_servos else None)
    named = frozenset(item.effect for item in standing if item.probability >= NAMED_PROBABILITY)
    sets.fit_missing([named, frozenset()], members)
    final_fit = sets.settle(named)
    # a step of the simulation applies its reference half a step too early
    reference_delay = final_fit.parameters["reference_delay"] - 0.5 * runs.interval / parts_of(
        runs, table([final_fit.parameters])
    )
    return FittedEffectSets(
        standing, sets[frozenset()], final_fit, standard_errors_of(final_fit, runs), sets, reference_delay
    )


class FittedSets(dict[EffectSet, FittedServo]):
    """Best fit of every set of effects that was tried."""

    def __init__(self, runs: ServoRuns, fits: Mapping[EffectSet, FittedServo], held: Sequence[str]) -> None:
        super().__init__(fits)
        self._runs, self._held = runs, tuple(held)

    def grow(self, core_effects: EffectSet, starts: Mapping[str, Sequence[Parameters]]) -> EffectSet:
        """Fit sets of further effects beside a core, each from the fits of smaller sets, and prune the best.

        The profile parameters of a core stay as fitted. No larger set is tried once a set follows the runs so closely
        that no further effect could be named.
        """
        held = (*self._held, *(PROFILE_PARAMETERS if "reference_rate_limit" in core_effects else ()))
        judged_effects = DRIVE_EFFECTS & starts.keys()
        for size in range(len(starts)):
            fitted_sets = [
                members
                for members in self
                if members >= core_effects
                and members - core_effects <= starts.keys()
                and len(members) == size + len(core_effects)
            ]
            best_set = min(fitted_sets, key=lambda members: self[members].cost)
            # where two effects gain next to nothing, three gain nothing
            gains_little = (
                size >= SIZE_ALWAYS_TRIED and log_cost_ratio(self, core_effects, best_set, self._runs) < COST_FORM_ERROR
            )
            if gains_little or self.followed(best_set, judged_effects):
                return self.pruned(best_set)
            jobs: list[tuple[EffectSet, str, Parameters]] = []
            for members in fitted_sets:
                for effect in sorted(starts.keys() - members):
                    parameters = dict(self[members].parameters)
                    if effect == "load_dependent_friction":
                        parameters["coulomb_friction"] *= 0.5  # the effect replaces a part of it
                    jobs += [(members, effect, parameters | start) for start in starts_beside(starts, effect, size)]
            fitted_servos = fit(self._runs, [start for _, _, start in jobs], held)
            for (smaller_set, effect, _), fitted_servo in zip(jobs, fitted_servos, strict=True):
                # the fit without an effect replaces one in which it does not act
                candidate = fitted_servo if acts(effect, fitted_servo.parameters, self._runs) else self[smaller_set]
                members = smaller_set | {effect}
                if members not in self or candidate.cost < self[members].cost:
                    self[members] = candidate
        return self.pruned(core_effects.union(starts))

    def followed(self, members: EffectSet, judged_effects: EffectSet) -> bool:
        """Return whether a set's cost is so close to the open cost that no further effect could be named."""
        fitted = self[members]
        cost_left_open = open_cost(self, members, judged_effects, self._runs)
        largest_log_ratio = math.log((fitted.cost + cost_left_open) / cost_left_open) if cost_left_open else math.inf
        return presence(height(largest_log_ratio, fitted)) < NAMED_PROBABILITY

    def fit_missing(self, wanted_sets: Sequence[EffectSet], largest: EffectSet) -> None:
        """Fit the wanted sets that were not tried, each from the fit of the largest set."""
        missing = [members for members in dict.fromkeys(wanted_sets) if members not in self]
        largest_fit = (
            self[largest]
            if largest in self
            else self[max((members for members in self if members <= largest), key=len)]
        )
        starts = [without_effects(largest_fit.parameters, largest - members) for members in missing]
        if missing:
            self.update(zip(missing, fit(self._runs, starts, self._held), strict=True))

    def fit_back(self, members: EffectSet) -> None:
        """Refit the set without each member from the fit of all, so that no member gains by a luckier search."""
        smaller_sets = [members - {name} for name in sorted(members)]
        starts = [without_effects(self[members].parameters, members - subset) for subset in smaller_sets]
        for subset, refit in zip(smaller_sets, fit(self._runs, starts, self._held), strict=True):
            if subset not in self or refit.cost < self[subset].cost:
                self[subset] = refit

    def settle(self, members: EffectSet) -> FittedServo:
        """Fit a set once more, to the finer stopping limit of reported sets, and return the fit."""
        (self[members],) = fit(self._runs, [self[members].parameters], self._held, FINAL_LEAST_GAIN)
        return self[members]

    def pruned(self, members: EffectSet) -> EffectSet:
        """Return a set without weak members: the weakest is removed until all others are strong enough to be named."""
        while members:
            self.fit_back(members)
            heights = {
                name: height(log_cost_ratio(self, members - {name}, members, self._runs), self[members])
                for name in members
            }
            weakest = min(sorted(members), key=lambda name: heights[name])
            if presence(heights[weakest]) >= NAMED_PROBABILITY:
                break
            members = members - {weakest}
        return members


def starts_beside(starts: Mapping[str, Sequence[Parameters]], effect: str, other_count: int) -> Sequence[Parameters]:
    """Return the starts of an effect's fit; a drive's effect added to others starts with its own parameters only."""
    if other_count == 0 or effect not in DRIVE_EFFECTS:
        return starts[effect]
    return [{name: value for name, value in starts[effect][0].items() if name.startswith(f"{effect}.")}]


def unidentifiable(runs: ServoRuns) -> tuple[str, ...]:
    """Return parameters that the runs cannot identify: without a weight, all torques share one scale."""
    names = () if runs.hangs else ("load_zero", "phase_resistance")
    return names if runs.voltage_logged.any() else (*names, "voltage_delay")


def likely_effects(
    sets: Mapping[EffectSet, FittedServo], members: EffectSet, runs: ServoRuns, held_out: ServoRuns | None
) -> tuple[LikelyEffect, ...]:
    """Return members and further effects with their probabilities, most probable first.

    A member's probability grows with its log cost ratio in the fitted runs, and is reduced if unseen runs are worse
    with it by as much. Further effects that were tried beside all members stay below the probability of a named one.
    """
    fitted = sets[members]
    stds = standard_errors_of(fitted, runs)
    log_ratios = {name: log_cost_ratio(sets, members - {name}, members, runs) for name in members}
    held_out_loss = dict.fromkeys(members, 0.0)
    if held_out is not None and held_out.measured.any() and members:
        names = sorted(members)
        cost_with_all, *costs_without = costs_of(held_out, [fitted, *(sets[members - {name}] for name in names)])
        held_out_loss = {
            name: math.log(cost_with_all / cost_without)
            for name, cost_without in zip(names, costs_without, strict=True)
        }
    standings = [
        LikelyEffect(
            name,
            acts(name, fitted.parameters, runs)
            * presence(height(log_ratios[name], fitted))
            * (1.0 if held_out_loss[name] < log_ratios[name] else UNCONFIRMED_FACTOR),
            log_ratios[name] / sum(log_ratios.values()),
            parameters_of(name, fitted, stds),
            peers_of(sets, members, name, runs),
        )
        for name in members
    ]
    for larger in [larger for larger in sets if len(larger) == len(members) + 1 and larger > members]:
        (name,) = larger - members
        probability = min(
            presence(height(log_cost_ratio(sets, members, larger, runs), sets[larger])),
            NAMED_PROBABILITY - LISTED_PROBABILITY,
        )
        if probability >= LISTED_PROBABILITY:
            further_parameters = parameters_of(name, sets[larger], standard_errors_of(sets[larger], runs))
            standings.append(LikelyEffect(name, probability, 0.0, further_parameters))
    return tuple(sorted(standings, key=lambda item: (-item.probability, -item.share)))


def peers_of(sets: Mapping[EffectSet, FittedServo], members: EffectSet, name: str, runs: ServoRuns) -> tuple[str, ...]:
    """Return the effects that fit the runs as well in place of a member, within the error of their forms."""
    peer_by_set = {
        exchanged_set: next(iter(exchanged_set - members))
        for exchanged_set in sets
        if members - exchanged_set == {name} and len(exchanged_set - members) == 1
    }
    return tuple(
        sorted(
            effect
            for exchanged_set, effect in peer_by_set.items()
            if log_cost_ratio(sets, exchanged_set, members, runs) < COST_FORM_ERROR
        )
    )


def parameters_of_model_effects(model: Model) -> Parameters:
    """Return the parameters of a model's effects by their names in the simulation; no fit moves them."""
    parameters: Parameters = {}
    for entry in model.effects:
        values = dict(entry.parameters)
        if "phase" in values:
            amplitude, phase = values.pop("amplitude"), values.pop("phase")
            values |= {"cos": amplitude * math.cos(phase), "sin": -amplitude * math.sin(phase)}
        parameters |= {
            f"{entry.effect}.{name}": value for name, value in to_fit_parameters(entry.effect, values).items()
        }
    return parameters


def starts_of(runs: ServoRuns, model: Model, proposed: Sequence[Candidate]) -> dict[str, list[Parameters]]:
    """Return the start values of each effect, from the limits of the rig and the proposed forms."""
    forms = dict(proposed)
    largest_current = float(np.max(runs.limit)) / (model.phase_resistance or math.inf)
    exponent = forms.get("saturation", (1.0,))[0]
    angle_changes = np.abs(np.diff(runs.angle, axis=1))[runs.measured[:, 1:]]
    fast_speed = max(float(np.quantile(angle_changes, 0.95)) / runs.interval, 1e-3)
    shape = forms.get("stribeck", (1.0, 1.0))[1]
    starts_by_effect: dict[str, list[Parameters]] = {
        "load_dependent_friction": [{"coefficient": 0.1}],
        "saturation": [{"loss": START_LOSS, "exponent": exponent, "current": max(largest_current, 1e-3)}],
        "stribeck": [
            {"breakaway_ratio": 0.1, "stribeck_velocity": share * fast_speed, "shape": shape}
            for share in START_STRIBECK_SHARES
        ],
    }
    for name, form in proposed:
        if name == "position_dependent_friction":
            starts_by_effect[name] = [{"cos": 0.01, "sin": 0.01, "order": form[0]}]
        if name == "asymmetric_friction":
            starts_by_effect[name] = [{"asymmetry": 0.01}]
        if name == "quadratic_drag":
            starts_by_effect[name] = [{"coefficient": 0.1 * (model.viscous_damping or 0.0) / fast_speed}]
        if name == "dead_time":
            starts_by_effect[name] = [{"voltage": 0.01 * float(np.max(runs.limit)), "current": 0.1 * largest_current}]
    return {
        effect: [{f"{effect}.{name}": value for name, value in start.items()} for start in starts]
        for effect, starts in starts_by_effect.items()
    }


def without_effects(parameters: Parameters, effects: EffectSet) -> Parameters:
    """Return the parameters except those of some effects."""
    return {name: value for name, value in parameters.items() if name.partition(".")[0] not in effects}


def log_cost_ratio(
    sets: Mapping[EffectSet, FittedServo], fewer_effects: EffectSet, members: EffectSet, runs: ServoRuns
) -> float:
    """Return the log of the cost with fewer effects over the cost with all, each plus the open cost; at least 0."""
    fit_of_all, fit_of_fewer = sets[members], sets[fewer_effects]
    cost_left_open = open_cost(sets, members, members - fewer_effects, runs)
    return math.log(max((fit_of_fewer.cost + cost_left_open) / (fit_of_all.cost + cost_left_open), 1.0))


def open_cost(
    sets: Mapping[EffectSet, FittedServo], members: EffectSet, judged_effects: EffectSet, runs: ServoRuns
) -> float:
    """Return the cost [rad^2] that encoder counts and errors of the drive's forms leave open.

    A profile or a dead band takes most of the cost; a share of that is open because of their forms, unless they are
    judged themselves.
    """
    cost_left_open = len(sets[members].error) * (IGNORED_RMS_COUNTS * runs.encoder_resolution) ** 2
    drive_effects = members & DRIVE_EFFECTS
    if drive_effects and not judged_effects & DRIVE_EFFECTS and members - drive_effects in sets:
        cost_left_open += DRIVE_FORM_ERROR * max(sets[members - drive_effects].cost - sets[members].cost, 0.0)
    return cost_left_open


def height(log_ratio: float, fitted: FittedServo) -> float:
    """Return the log cost ratio of an effect over the ratio that noise and the errors of forms cause."""
    independent_count = len(fitted.error) / rows_per_independent(fitted.error)
    return log_ratio / math.hypot(COST_FORM_ERROR, math.sqrt(2.0) / independent_count)


def costs_of(runs: ServoRuns, fits: Sequence[FittedServo]) -> list[float]:
    """Return the cost of runs with the parameters of each fit, without fitting."""
    return [cost(error) for error in MeasuredServoRuns(runs).residuals([fitted.parameters for fitted in fits])]


def standard_errors_of(fitted: FittedServo, runs: ServoRuns) -> dict[str, float]:
    """Return standard errors of the fitted parameters, from autocorrelated residuals or the spread between runs.

    The larger of both is returned; the spread is the sandwich of Huber (1967) over whole runs. The error of a parameter
    that the runs do not show is its typical size.
    """
    sizes = np.array([runs.scales[name] for name in fitted.names])
    inverse = np.linalg.pinv(fitted.information, hermitian=True)
    variance = np.diag(inverse) * fitted.cost / len(fitted.error) * rows_per_independent(fitted.error)
    run_count = len(fitted.scores)
    if run_count >= FEWEST_RUNS_FOR_SPREAD:
        spread_covariance = inverse @ (fitted.scores.T @ fitted.scores) @ inverse * run_count / (run_count - 1)
        variance = np.maximum(variance, np.diag(spread_covariance))
    is_shown = np.diag(fitted.information) * sizes**2 > 1e-9 * fitted.cost
    stds = np.where(is_shown, np.sqrt(np.maximum(variance, 0.0)), sizes)
    return dict(zip(fitted.names, stds.tolist(), strict=True))


def parameters_of(effect: str, fitted: FittedServo, stds: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Return the parameters of an effect by the names of its definition, with standard errors."""
    parameters = {
        name.removeprefix(f"{effect}."): (value, stds.get(name, 0.0))
        for name, value in fitted.parameters.items()
        if name.startswith(f"{effect}.")
    }
    if effect in DRIVE_EFFECTS:
        return to_effect_parameters(effect, parameters)
    if "cos" not in parameters:
        return parameters
    (cosine, cosine_std), (sine, sine_std) = parameters.pop("cos"), parameters.pop("sin")
    amplitude, std = math.hypot(cosine, sine), max(cosine_std, sine_std)
    return parameters | {"amplitude": (amplitude, std), "phase": (math.atan2(-sine, cosine), std / amplitude)}
