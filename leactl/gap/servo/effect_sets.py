"""Which effects a servo's free runs ask for: every small set fitted by simulation, from the fits of smaller ones.

A balance of torques linearises what moves by half where friction and torque constant trade places, and a servo does not
log its torque; a simulation that follows the angle does without both. Sets are fitted and not effects one by one:
friction that falls with speed shows nothing where friction that grows with load is missing. An effect counts by how far
the set of all that stand is worse without it, refitted.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from leactl.gap.search.evidence import rows_per_independent
from leactl.gap.search.regression import Candidate
from leactl.gap.servo.fit import SETTLED, FittedServo, MeasuredServoRuns, cost, fit
from leactl.gap.servo.limits import DRIVE, acts, drive_starts, to_effect_parameters, to_fit_parameters
from leactl.gap.servo.profile import PROFILE
from leactl.gap.servo.runs import ServoRuns, runs_at_common_rate, servo_runs
from leactl.gap.servo.simulation import Parameters, parts_of, table
from leactl.gap.signals.record import Record
from leactl.gap.verdict.decision import LISTED, NAMED
from leactl.gap.verdict.judge import UNCONFIRMED, presence
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
Set = frozenset[str]
OWN = ("torque_constant", "phase_resistance", "rotor_inertia", "viscous_damping", "coulomb_friction")
RIG = ("load_zero", "reference_delay", "voltage_delay")  # what belongs to the rig and to no model
ALWAYS: Set = frozenset({"load_dependent_friction", "saturation", "stribeck"})
MOST_PROPOSED = 2  # effects of a balance that are tried besides
FORM_ERROR = 0.05  # relative change of a cost, that an effect makes by standing in for another or by luck of the search
"""On the XL330's logs, friction over the angle at any order gains 2 to 15 % beyond the others, by where a fit ends."""
FORM_LEFT = 0.01  # of what the drive's effects take from a cost, that their forms may leave over
COUNTS = 1.0  # of the encoder, root mean square, below which it does not matter how closely a run is followed
LOST = 0.1  # share of the torque at the largest current, that saturation begins with
FADES = (0.03, 0.15)  # of the fast speeds, at which friction may begin to fall
PAIRS = 2  # effects, that are always tried together
FEW_RUNS = 4  # below which runs do not tell how far they lie apart


@dataclass(frozen=True, eq=False)
class LikelyEffect:
    """An effect with its probability."""

    effect: str
    probability: float
    share: float  # of what the set takes from the cost
    parameters: Mapping[str, tuple[float, float]]  # value and standard error
    peers: tuple[str, ...] = ()  # that would do as well in its place


@dataclass(frozen=True, eq=False)
class FittedEffectSets:
    """The set that stands, and the model with and without it."""

    standing: tuple[LikelyEffect, ...]
    calibrated: FittedServo
    augmented: FittedServo
    stds: Mapping[str, float]  # of the parameters of the augmented model
    sets: Mapping[Set, FittedServo]
    late: float  # s, by which the reference acts after its stamps


def fit_effect_sets(
    records: Sequence[Record], held_out: Sequence[Record], model: Model, proposed: Sequence[Candidate]
) -> FittedEffectSets:
    """Fit every set of the effects that a simulation knows, and keep those that stand; by `records` alone.

    What the drive does to its reference and its error comes first: it is seen in all that follows. What a balance of
    torques proposed says in which form an effect is tried; held-out runs confirm or not.

    Raises
    ------
    InputError : runs that cannot be put side by side.
    """
    runs = servo_runs(records, model)
    fixed = effects_of(model)
    here = {name.partition(".")[0] for name in fixed}
    held = (*fixed, *unidentifiable(runs))
    begin = {name: float(getattr(model, name) or 0.0) for name in OWN} | dict.fromkeys(RIG, 0.0) | fixed
    (alone,) = fit(runs, [begin | {"reference_delay": runs.interval}], held)
    sets = Sets(runs, {frozenset(): alone}, held)
    drive = drive_starts(runs, [begin, alone.parameters])
    core = sets.grow(frozenset(), {name: starts for name, starts in drive.items() if name not in here})
    starts = {name: start for name, start in starts_of(runs, model, proposed).items() if name not in here}
    base: Set = frozenset(ALWAYS & starts.keys())
    members = sets.grow(core, {name: starts[name] for name in sorted(base)})
    for effect in [name for name, _ in proposed if name in starts.keys() - ALWAYS][:MOST_PROPOSED]:
        smaller = [core.union(one) for size in range(len(base) + 1) for one in combinations(sorted(base), size)]
        smaller = [one for one in smaller if one in sets]  # none of more effects where fewer follow the runs
        fits = fit(runs, [sets[one].parameters | starts[effect][0] for one in smaller], held)
        sets.update({one | {effect}: fitted for one, fitted in zip(smaller, fits, strict=True)})
        # a search that ends lower by a luckier way is no gain of the effect: without it, from there, as low again?
        again = fit(runs, [without(fitted.parameters, frozenset({effect})) for fitted in fits], held)
        sets.update({one: new for one, new in zip(smaller, again, strict=True) if new.cost < sets[one].cost})
        members = sets.pruned(max(smaller, key=len) | {effect})
        base = members - core
    unseen = runs_at_common_rate(held_out, model)
    sets.fit_missing([members - {name} for name in sorted(members)], members)
    standing = standing_of(sets, members, runs, servo_runs(unseen, model) if unseen else None)
    named = frozenset(item.effect for item in standing if item.probability >= NAMED)
    sets.fit_missing([named, frozenset()], members)
    final = sets.settle(named)
    # a step of the simulation takes what it follows as if it had come half a step earlier
    late = final.parameters["reference_delay"] - 0.5 * runs.interval / parts_of(runs, table([final.parameters]))
    return FittedEffectSets(standing, sets[frozenset()], final, errors_of(final, runs), sets, late)


class Sets(dict[Set, FittedServo]):
    """The best fit of every set of effects that was tried."""

    def __init__(self, runs: ServoRuns, known: Mapping[Set, FittedServo], held: Sequence[str]) -> None:
        super().__init__(known)
        self._runs, self._held = runs, tuple(held)

    def grow(self, core: Set, starts: Mapping[str, Sequence[Parameters]]) -> Set:
        """Fit every set of further effects beside a core, each from the fits of what it is made of, and prune.

        What the core's profile is stays as it was found. Where a set follows the runs so closely that no further effect
        could stand, none is tried.
        """
        held = (*self._held, *(PROFILE if "reference_rate_limit" in core else ()))
        judged = DRIVE & starts.keys()
        for size in range(len(starts)):
            made = [m for m in self if m >= core and m - core <= starts.keys() and len(m) == size + len(core)]
            best = min(made, key=lambda members: self[members].cost)
            # what takes next to nothing in twos takes nothing in threes
            hopeless = size >= PAIRS and relative(self, core, best, self._runs) < FORM_ERROR
            if hopeless or self.followed(best, judged):
                return self.pruned(best)
            jobs: list[tuple[Set, str, Parameters]] = []
            for members in made:
                for effect in sorted(starts.keys() - members):
                    base = dict(self[members].parameters)
                    if effect == "load_dependent_friction":
                        base["coulomb_friction"] *= 0.5  # of which it takes the place
                    jobs += [(members, effect, base | start) for start in beginnings(starts, effect, size)]
            fitted = fit(self._runs, [start for _, _, start in jobs], held)
            for (fewer, effect, _), result in zip(jobs, fitted, strict=True):
                # what does not act is as good as absent
                best_found = result if acts(effect, result.parameters, self._runs) else self[fewer]
                members = fewer | {effect}
                if members not in self or best_found.cost < self[members].cost:
                    self[members] = best_found
        return self.pruned(core.union(starts))

    def followed(self, members: Set, judged: Set) -> bool:
        """Whether a set leaves so little beside what is open to all that nothing could be named for taking the rest."""
        fitted = self[members]
        left_open = open_cost(self, members, judged, self._runs)
        most = math.log((fitted.cost + left_open) / left_open) if left_open else math.inf
        return presence(height(most, fitted)) < NAMED

    def fit_missing(self, wanted: Sequence[Set], largest: Set) -> None:
        """Fit those sets that were not tried, each from a larger one."""
        missing = [one for one in dict.fromkeys(wanted) if one not in self]
        full = self[largest] if largest in self else self[max((m for m in self if m <= largest), key=len)]
        starts = [without(full.parameters, largest - one) for one in missing]
        if missing:
            self.update(zip(missing, fit(self._runs, starts, self._held), strict=True))

    def fit_back(self, members: Set) -> None:
        """Fit every set with one member less from where the search with it ended: a luckier way is no member's gain."""
        fewer = [members - {name} for name in sorted(members)]
        starts = [without(self[members].parameters, members - one) for one in fewer]
        for one, result in zip(fewer, fit(self._runs, starts, self._held), strict=True):
            if one not in self or result.cost < self[one].cost:
                self[one] = result

    def settle(self, members: Set) -> FittedServo:
        """Fit a set that is told once more, with all that belongs to it and as closely as it goes."""
        (self[members],) = fit(self._runs, [self[members].parameters], self._held, SETTLED)
        return self[members]

    def pruned(self, members: Set) -> Set:
        """The members that stand: of all, the weakest goes first."""
        while members:
            self.fit_back(members)
            heights = {
                name: height(relative(self, members - {name}, members, self._runs), self[members]) for name in members
            }
            weakest = min(sorted(members), key=lambda name: heights[name])
            if presence(heights[weakest]) >= NAMED:
                break
            members = members - {weakest}
        return members


def beginnings(starts: Mapping[str, Sequence[Parameters]], effect: str, beside: int) -> Sequence[Parameters]:
    """Where an effect begins: a drive's with all parameters by itself, else with its own beside what was fitted."""
    if beside == 0 or effect not in DRIVE:
        return starts[effect]
    return [{name: value for name, value in starts[effect][0].items() if name.startswith(f"{effect}.")}]


def unidentifiable(runs: ServoRuns) -> tuple[str, ...]:
    """Parameters that runs of this kind tell nothing of: without a weight all torques share one scale."""
    none = () if runs.hangs else ("load_zero", "phase_resistance")
    return none if runs.voltage_logged.any() else (*none, "voltage_delay")


def standing_of(
    sets: Mapping[Set, FittedServo], members: Set, runs: ServoRuns, unseen: ServoRuns | None
) -> tuple[LikelyEffect, ...]:
    """How sure each effect is: what it gains where it was fitted, unless runs that nobody fitted lose as much by it."""
    fitted = sets[members]
    stds = errors_of(fitted, runs)
    worse = {name: relative(sets, members - {name}, members, runs) for name in members}
    lost = dict.fromkeys(members, 0.0)
    if unseen is not None and unseen.measured.any() and members:
        names = sorted(members)
        left, *others = unfollowed(unseen, [fitted, *(sets[members - {name}] for name in names)])
        lost = {name: math.log(left / other) for name, other in zip(names, others, strict=True)}
    standings = [
        LikelyEffect(
            name,
            acts(name, fitted.parameters, runs)
            * presence(height(worse[name], fitted))
            * (1.0 if lost[name] < worse[name] else UNCONFIRMED),
            worse[name] / sum(worse.values()),
            parameters_of(name, fitted, stds),
            in_place_of(sets, members, name, runs),
        )
        for name in members
    ]
    for more in [one for one in sets if len(one) == len(members) + 1 and one > members]:
        (name,) = more - members
        probability = min(presence(height(relative(sets, members, more, runs), sets[more])), NAMED - LISTED)
        if probability >= LISTED:
            further = parameters_of(name, sets[more], errors_of(sets[more], runs))
            standings.append(LikelyEffect(name, probability, 0.0, further))
    return tuple(sorted(standings, key=lambda item: (-item.probability, -item.share)))


def in_place_of(sets: Mapping[Set, FittedServo], members: Set, name: str, runs: ServoRuns) -> tuple[str, ...]:
    """Effects that follow the runs as well in the place of a member, as far as forms can tell."""
    others = {one: next(iter(one - members)) for one in sets if members - one == {name} and len(one - members) == 1}
    return tuple(sorted(q for one, q in others.items() if relative(sets, one, members, runs) < FORM_ERROR))


def effects_of(model: Model) -> Parameters:
    """Effects that a model has already, as the simulation names them; they stay as they are."""
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
    """Where each effect begins, from what the rig can do."""
    forms = dict(proposed)
    largest = float(np.max(runs.limit)) / (model.phase_resistance or math.inf)
    exponent = forms.get("saturation", (1.0,))[0]
    turned = np.abs(np.diff(runs.angle, axis=1))[runs.measured[:, 1:]]
    fast = max(float(np.quantile(turned, 0.95)) / runs.interval, 1e-3)
    shape = forms.get("stribeck", (1.0, 1.0))[1]
    by_effect: dict[str, list[Parameters]] = {
        "load_dependent_friction": [{"coefficient": 0.1}],
        "saturation": [{"loss": LOST, "exponent": exponent, "current": max(largest, 1e-3)}],
        "stribeck": [{"breakaway_ratio": 0.1, "stribeck_velocity": share * fast, "shape": shape} for share in FADES],
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


def without(parameters: Parameters, effects: Set) -> Parameters:
    """The same but for what belongs to some effects."""
    return {name: value for name, value in parameters.items() if name.partition(".")[0] not in effects}


def relative(sets: Mapping[Set, FittedServo], fewer: Set, members: Set, runs: ServoRuns) -> float:
    """Logarithm of how much worse a set is without a member, beside what is open to all."""
    fitted, lacking = sets[members], sets[fewer]
    left_open = open_cost(sets, members, members - fewer, runs)
    return math.log(max((lacking.cost + left_open) / (fitted.cost + left_open), 1.0))


def open_cost(sets: Mapping[Set, FittedServo], members: Set, judged: Set, runs: ServoRuns) -> float:
    """Cost that the encoder's counts leave open, and that forms may leave.

    What a profile or a dead band takes from the cost is most of it; what their forms leave of that is open as well,
    but where they are judged themselves.
    """
    left_open = len(sets[members].error) * (COUNTS * runs.encoder_resolution) ** 2
    drive = members & DRIVE
    if drive and not judged & DRIVE and members - drive in sets:
        left_open += FORM_LEFT * max(sets[members - drive].cost - sets[members].cost, 0.0)
    return left_open


def height(worse: float, fitted: FittedServo) -> float:
    """How far an effect stands above what noise and the forms of others would give it."""
    independent = len(fitted.error) / rows_per_independent(fitted.error)
    return worse / math.hypot(FORM_ERROR, math.sqrt(2.0) / independent)


def unfollowed(runs: ServoRuns, several: Sequence[FittedServo]) -> list[float]:
    """Cost of other runs with the parameters of each of several fits."""
    return [cost(error) for error in MeasuredServoRuns(runs).of([fitted.parameters for fitted in several])]


def errors_of(fitted: FittedServo, runs: ServoRuns) -> dict[str, float]:
    """Standard errors of what was fitted: by errors that hang together, or by how far runs lie apart if that is more.

    The second is the sandwich of Huber (1967) over whole runs; a parameter that nothing shows has its own size.
    """
    sizes = np.array([runs.scales[name] for name in fitted.names])
    inverse = np.linalg.pinv(fitted.information, hermitian=True)
    variance = np.diag(inverse) * fitted.cost / len(fitted.error) * rows_per_independent(fitted.error)
    count = len(fitted.scores)
    if count >= FEW_RUNS:
        apart = inverse @ (fitted.scores.T @ fitted.scores) @ inverse * count / (count - 1)
        variance = np.maximum(variance, np.diag(apart))
    shown = np.diag(fitted.information) * sizes**2 > 1e-9 * fitted.cost
    stds = np.where(shown, np.sqrt(np.maximum(variance, 0.0)), sizes)
    return dict(zip(fitted.names, stds.tolist(), strict=True))


def parameters_of(effect: str, fitted: FittedServo, stds: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """The parameters of an effect by the names of its definition, with standard errors."""
    parameters = {
        name.removeprefix(f"{effect}."): (value, stds.get(name, 0.0))
        for name, value in fitted.parameters.items()
        if name.startswith(f"{effect}.")
    }
    if effect in DRIVE:
        return to_effect_parameters(effect, parameters)
    if "cos" not in parameters:
        return parameters
    (cosine, one), (sine, other) = parameters.pop("cos"), parameters.pop("sin")
    amplitude, spread = math.hypot(cosine, sine), max(one, other)
    return parameters | {"amplitude": (amplitude, spread), "phase": (math.atan2(-sine, cosine), spread / amplitude)}
