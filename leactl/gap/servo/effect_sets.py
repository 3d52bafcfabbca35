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
Set = frozenset[str]
MODEL_PARAMETERS = ("torque_constant", "phase_resistance", "rotor_inertia", "viscous_damping", "coulomb_friction")
RIG_PARAMETERS = ("load_zero", "reference_delay", "voltage_delay")  # of the rig; no model file holds them
ALWAYS_TRIED: Set = frozenset({"load_dependent_friction", "saturation", "stribeck"})
MOST_PROPOSED = 2  # most effects proposed by a balance that are tried in addition
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
    """Fitted effects, and the model with and without them."""

    standing: tuple[LikelyEffect, ...]
    calibrated: FittedServo
    augmented: FittedServo
    stds: Mapping[str, float]  # of the parameters of the augmented model
    sets: Mapping[Set, FittedServo]
    late: float  # s, delay of the reference after its stamps


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
    fixed = parameters_of_model_effects(model)
    in_model = {name.partition(".")[0] for name in fixed}
    held = (*fixed, *unidentifiable(runs))
    begin = (
        {name: float(getattr(model, name) or 0.0) for name in MODEL_PARAMETERS}
        | dict.fromkeys(RIG_PARAMETERS, 0.0)
        | fixed
    )
    (plain,) = fit(runs, [begin | {"reference_delay": runs.interval}], held)
    sets = Sets(runs, {frozenset(): plain}, held)
    drive = drive_starts(runs, [begin, plain.parameters])
    core = sets.grow(frozenset(), {name: starts for name, starts in drive.items() if name not in in_model})
    starts = {name: start for name, start in starts_of(runs, model, proposed).items() if name not in in_model}
    base: Set = frozenset(ALWAYS_TRIED & starts.keys())
    members = sets.grow(core, {name: starts[name] for name in sorted(base)})
    for effect in [name for name, _ in proposed if name in starts.keys() - ALWAYS_TRIED][:MOST_PROPOSED]:
        smaller = [core.union(subset) for size in range(len(base) + 1) for subset in combinations(sorted(base), size)]
        # sets are not tried beyond one that follows the runs closely
        smaller = [subset for subset in smaller if subset in sets]
        fits = fit(runs, [sets[subset].parameters | starts[effect][0] for subset in smaller], held)
        sets.update({subset | {effect}: fitted for subset, fitted in zip(smaller, fits, strict=True)})
        # a luckier search is no gain of the effect: fit again without it, from where the fit with it ended
        refits = fit(runs, [without_effects(fitted.parameters, frozenset({effect})) for fitted in fits], held)
        sets.update(
            {subset: refit for subset, refit in zip(smaller, refits, strict=True) if refit.cost < sets[subset].cost}
        )
        members = sets.pruned(max(smaller, key=len) | {effect})
        base = members - core
    unseen = runs_at_common_rate(held_out, model)
    sets.fit_missing([members - {name} for name in sorted(members)], members)
    standing = likely_effects(sets, members, runs, servo_runs(unseen, model) if unseen else None)
    named = frozenset(item.effect for item in standing if item.probability >= NAMED_PROBABILITY)
    sets.fit_missing([named, frozenset()], members)
    final = sets.settle(named)
    # a step of the simulation applies its reference half a step too early
    late = final.parameters["reference_delay"] - 0.5 * runs.interval / parts_of(runs, table([final.parameters]))
    return FittedEffectSets(standing, sets[frozenset()], final, standard_errors_of(final, runs), sets, late)


class Sets(dict[Set, FittedServo]):
    """Best fit of every set of effects that was tried."""

    def __init__(self, runs: ServoRuns, known: Mapping[Set, FittedServo], held: Sequence[str]) -> None:
        super().__init__(known)
        self._runs, self._held = runs, tuple(held)

    def grow(self, core: Set, starts: Mapping[str, Sequence[Parameters]]) -> Set:
        """Fit sets of further effects beside a core, each from the fits of smaller sets, and prune the best.

        The profile parameters of a core stay as fitted. No larger set is tried once a set follows the runs so closely
        that no further effect could be named.
        """
        held = (*self._held, *(PROFILE_PARAMETERS if "reference_rate_limit" in core else ()))
        judged = DRIVE_EFFECTS & starts.keys()
        for size in range(len(starts)):
            made = [m for m in self if m >= core and m - core <= starts.keys() and len(m) == size + len(core)]
            best = min(made, key=lambda members: self[members].cost)
            # where two effects gain next to nothing, three gain nothing
            hopeless = size >= SIZE_ALWAYS_TRIED and log_cost_ratio(self, core, best, self._runs) < COST_FORM_ERROR
            if hopeless or self.followed(best, judged):
                return self.pruned(best)
            jobs: list[tuple[Set, str, Parameters]] = []
            for members in made:
                for effect in sorted(starts.keys() - members):
                    base = dict(self[members].parameters)
                    if effect == "load_dependent_friction":
                        base["coulomb_friction"] *= 0.5  # the effect replaces a part of it
                    jobs += [(members, effect, base | start) for start in starts_beside(starts, effect, size)]
            fitted = fit(self._runs, [start for _, _, start in jobs], held)
            for (fewer, effect, _), result in zip(jobs, fitted, strict=True):
                # the fit without an effect replaces one in which it does not act
                candidate = result if acts(effect, result.parameters, self._runs) else self[fewer]
                members = fewer | {effect}
                if members not in self or candidate.cost < self[members].cost:
                    self[members] = candidate
        return self.pruned(core.union(starts))

    def followed(self, members: Set, judged: Set) -> bool:
        """Return whether the remaining cost is so close to the open cost that no further effect could be named."""
        fitted = self[members]
        left_open = open_cost(self, members, judged, self._runs)
        most = math.log((fitted.cost + left_open) / left_open) if left_open else math.inf
        return presence(height(most, fitted)) < NAMED_PROBABILITY

    def fit_missing(self, wanted: Sequence[Set], largest: Set) -> None:
        """Fit those sets that were not tried, each from a larger one."""
        missing = [members for members in dict.fromkeys(wanted) if members not in self]
        full = self[largest] if largest in self else self[max((m for m in self if m <= largest), key=len)]
        starts = [without_effects(full.parameters, largest - members) for members in missing]
        if missing:
            self.update(zip(missing, fit(self._runs, starts, self._held), strict=True))

    def fit_back(self, members: Set) -> None:
        """Refit the set without each member from the fit with it, so that no member gains by a luckier search."""
        fewer = [members - {name} for name in sorted(members)]
        starts = [without_effects(self[members].parameters, members - subset) for subset in fewer]
        for subset, result in zip(fewer, fit(self._runs, starts, self._held), strict=True):
            if subset not in self or result.cost < self[subset].cost:
                self[subset] = result

    def settle(self, members: Set) -> FittedServo:
        """Fit a set once more, to the finer stopping limit of sets that are reported."""
        (self[members],) = fit(self._runs, [self[members].parameters], self._held, FINAL_LEAST_GAIN)
        return self[members]

    def pruned(self, members: Set) -> Set:
        """Remove the weakest member until each remaining one is strong enough to be named."""
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


def starts_beside(starts: Mapping[str, Sequence[Parameters]], effect: str, beside: int) -> Sequence[Parameters]:
    """Return the starts of an effect's fit; a drive's effect added to others starts with its own parameters only."""
    if beside == 0 or effect not in DRIVE_EFFECTS:
        return starts[effect]
    return [{name: value for name, value in starts[effect][0].items() if name.startswith(f"{effect}.")}]


def unidentifiable(runs: ServoRuns) -> tuple[str, ...]:
    """Return parameters that the runs cannot identify: without a weight, all torques share one scale."""
    none = () if runs.hangs else ("load_zero", "phase_resistance")
    return none if runs.voltage_logged.any() else (*none, "voltage_delay")


def likely_effects(
    sets: Mapping[Set, FittedServo], members: Set, runs: ServoRuns, unseen: ServoRuns | None
) -> tuple[LikelyEffect, ...]:
    """Return members and further effects with their probabilities, most probable first.

    A member's probability grows with its log cost ratio in the fitted runs, and is reduced if unseen runs are worse
    with it by as much. Further effects that were tried beside all members stay below the probability of a named one.
    """
    fitted = sets[members]
    stds = standard_errors_of(fitted, runs)
    worse = {name: log_cost_ratio(sets, members - {name}, members, runs) for name in members}
    unseen_loss = dict.fromkeys(members, 0.0)
    if unseen is not None and unseen.measured.any() and members:
        names = sorted(members)
        with_all, *lacking = costs_of(unseen, [fitted, *(sets[members - {name}] for name in names)])
        unseen_loss = {
            name: math.log(with_all / without_member) for name, without_member in zip(names, lacking, strict=True)
        }
    standings = [
        LikelyEffect(
            name,
            acts(name, fitted.parameters, runs)
            * presence(height(worse[name], fitted))
            * (1.0 if unseen_loss[name] < worse[name] else UNCONFIRMED_FACTOR),
            worse[name] / sum(worse.values()),
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
            further = parameters_of(name, sets[larger], standard_errors_of(sets[larger], runs))
            standings.append(LikelyEffect(name, probability, 0.0, further))
    return tuple(sorted(standings, key=lambda item: (-item.probability, -item.share)))


def peers_of(sets: Mapping[Set, FittedServo], members: Set, name: str, runs: ServoRuns) -> tuple[str, ...]:
    """Return the effects that fit the runs as well in place of a member, within the error of their forms."""
    others = {
        other: next(iter(other - members)) for other in sets if members - other == {name} and len(other - members) == 1
    }
    return tuple(
        sorted(
            effect for other, effect in others.items() if log_cost_ratio(sets, other, members, runs) < COST_FORM_ERROR
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
    largest = float(np.max(runs.limit)) / (model.phase_resistance or math.inf)
    exponent = forms.get("saturation", (1.0,))[0]
    turned = np.abs(np.diff(runs.angle, axis=1))[runs.measured[:, 1:]]
    fast = max(float(np.quantile(turned, 0.95)) / runs.interval, 1e-3)
    shape = forms.get("stribeck", (1.0, 1.0))[1]
    by_effect: dict[str, list[Parameters]] = {
        "load_dependent_friction": [{"coefficient": 0.1}],
        "saturation": [{"loss": START_LOSS, "exponent": exponent, "current": max(largest, 1e-3)}],
        "stribeck": [
            {"breakaway_ratio": 0.1, "stribeck_velocity": share * fast, "shape": shape}
            for share in START_STRIBECK_SHARES
        ],
    }
    for name, form in proposed:
        if name == "position_dependent_friction":
            by_effect[name] = [{"cos": 0.01, "sin": 0.01, "order": form[0]}]
        if name == "asymmetric_friction":
            by_effect[name] = [{"asymmetry": 0.01}]
        if name == "quadratic_drag":
            by_effect[name] = [{"coefficient": 0.1 * (model.viscous_damping or 0.0) / fast}]
        if name == "dead_time":
            by_effect[name] = [{"voltage": 0.01 * float(np.max(runs.limit)), "current": 0.1 * largest}]
    return {
        effect: [{f"{effect}.{name}": value for name, value in start.items()} for start in starts]
        for effect, starts in by_effect.items()
    }


def without_effects(parameters: Parameters, effects: Set) -> Parameters:
    """Return the parameters except those of some effects."""
    return {name: value for name, value in parameters.items() if name.partition(".")[0] not in effects}


def log_cost_ratio(sets: Mapping[Set, FittedServo], fewer: Set, members: Set, runs: ServoRuns) -> float:
    """Return the log of the cost of fewer effects over that of all members, at least 0; both include the open cost."""
    fitted, lacking = sets[members], sets[fewer]
    left_open = open_cost(sets, members, members - fewer, runs)
    return math.log(max((lacking.cost + left_open) / (fitted.cost + left_open), 1.0))


def open_cost(sets: Mapping[Set, FittedServo], members: Set, judged: Set, runs: ServoRuns) -> float:
    """Return the cost [rad^2] that encoder counts and errors of the drive's forms leave open.

    A profile or a dead band takes most of the cost; a share of that is open because of their forms, unless they are
    judged themselves.
    """
    left_open = len(sets[members].error) * (IGNORED_RMS_COUNTS * runs.encoder_resolution) ** 2
    drive = members & DRIVE_EFFECTS
    if drive and not judged & DRIVE_EFFECTS and members - drive in sets:
        left_open += DRIVE_FORM_ERROR * max(sets[members - drive].cost - sets[members].cost, 0.0)
    return left_open


def height(worse: float, fitted: FittedServo) -> float:
    """Return the log cost ratio of an effect over that by noise and the errors of other forms."""
    independent = len(fitted.error) / rows_per_independent(fitted.error)
    return worse / math.hypot(COST_FORM_ERROR, math.sqrt(2.0) / independent)


def costs_of(runs: ServoRuns, fits: Sequence[FittedServo]) -> list[float]:
    """Return the cost of runs with the parameters of each fit, without fitting."""
    return [cost(error) for error in MeasuredServoRuns(runs).of([fitted.parameters for fitted in fits])]


def standard_errors_of(fitted: FittedServo, runs: ServoRuns) -> dict[str, float]:
    """Return standard errors of the fitted parameters, from autocorrelated residuals or the spread between runs.

    The larger one counts; the spread is the sandwich of Huber (1967) over whole runs. The error of a parameter that the
    runs do not show is its typical size.
    """
    sizes = np.array([runs.scales[name] for name in fitted.names])
    inverse = np.linalg.pinv(fitted.information, hermitian=True)
    variance = np.diag(inverse) * fitted.cost / len(fitted.error) * rows_per_independent(fitted.error)
    count = len(fitted.scores)
    if count >= FEWEST_RUNS_FOR_SPREAD:
        apart = inverse @ (fitted.scores.T @ fitted.scores) @ inverse * count / (count - 1)
        variance = np.maximum(variance, np.diag(apart))
    shown = np.diag(fitted.information) * sizes**2 > 1e-9 * fitted.cost
    stds = np.where(shown, np.sqrt(np.maximum(variance, 0.0)), sizes)
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
