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

from leactl.gap.evidence import rows_per_independent
from leactl.gap.judge import UNCONFIRMED, presence
from leactl.gap.record import Record
from leactl.gap.regression import Candidate
from leactl.gap.servo.fit import Fitted, cost, fit
from leactl.gap.servo.runs import ServoRuns, servo_runs, side_by_side
from leactl.gap.servo.simulation import SCALES, Parameters, replay, table
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
Set = frozenset[str]
OWN = ("torque_constant", "phase_resistance", "rotor_inertia", "viscous_damping", "coulomb_friction")
RIG = {"load_zero": 0.0, "reference_delay": 0.005}  # what belongs to the rig and to no model
ALWAYS: Set = frozenset({"load_dependent_friction", "saturation", "stribeck"})
MOST_PROPOSED = 2  # effects of a balance that are tried besides
FORM_ERROR = 0.05  # relative change of a cost, that an effect makes by standing in for another or by luck of the search
"""On the XL330's logs, friction over the angle at any order gains 2 to 15 % beyond the others, by where a fit ends."""
COUNTS = 1.0  # of the encoder, root mean square, below which it does not matter how closely a run is followed
LOST = 0.1  # share of the torque at the largest current, that saturation begins with
FADES = (0.03, 0.15)  # of the fast speeds, at which friction may begin to fall
NAMED = 0.5
LEAST = 0.01  # probability below which an effect is not worth telling
FEW_RUNS = 4  # below which runs do not tell how far they lie apart


@dataclass(frozen=True, eq=False)
class Standing:
    """An effect with its probability."""

    effect: str
    probability: float
    share: float  # of what the set takes from the cost
    parameters: Mapping[str, tuple[float, float]]  # value and standard error
    peers: tuple[str, ...] = ()  # that would do as well in its place


@dataclass(frozen=True, eq=False)
class Ladder:
    """The set that stands, and the model with and without it."""

    standing: tuple[Standing, ...]
    calibrated: Fitted
    augmented: Fitted
    stds: Mapping[str, float]  # of the parameters of the augmented model
    sets: Mapping[Set, Fitted]


def climb(records: Sequence[Record], held_out: Sequence[Record], model: Model, proposed: Sequence[Candidate]) -> Ladder:
    """Fit every set of the effects that a simulation knows, and keep those that stand; by the angle of `records` alone.

    What a balance of torques proposed says in which form an effect is tried; held-out runs confirm or not.

    Raises
    ------
    InputError : runs that cannot be put side by side.
    """
    runs = servo_runs(records, model)
    fixed = effects_of(model)
    here = {name.partition(".")[0] for name in fixed}
    starts = {name: start for name, start in starts_of(runs, model, proposed).items() if name not in here}
    base: Set = frozenset(ALWAYS & starts.keys())
    sets = every_set(runs, model, {name: starts[name] for name in sorted(base)}, fixed)
    members = prune(sets, base, runs)
    for effect in [name for name, _ in proposed if name in starts.keys() - ALWAYS][:MOST_PROPOSED]:
        smaller = [frozenset(one) for size in range(len(base) + 1) for one in combinations(sorted(base), size)]
        found = fit(runs, [sets[one].parameters | starts[effect][0] for one in smaller], tuple(fixed))
        sets |= {one | {effect}: fitted for one, fitted in zip(smaller, found, strict=True)}
        # a search that ends lower by a luckier way is no gain of the effect: without it, from there, as low again?
        again = fit(runs, [without(fitted.parameters, frozenset({effect})) for fitted in found], tuple(fixed))
        sets |= {one: new for one, new in zip(smaller, again, strict=True) if new.cost < sets[one].cost}
        members = base = prune(sets, base | {effect}, runs)
    unseen = side_by_side(held_out, model)
    standing = standing_of(sets, members, runs, servo_runs(unseen, model) if unseen else None)
    named = frozenset(item.effect for item in standing if item.probability >= NAMED)
    if named not in sets:
        (sets[named],) = fit(runs, [without(sets[members].parameters, members - named)], tuple(fixed))
    return Ladder(standing, sets[frozenset()], sets[named], errors_of(sets[named]), sets)


def standing_of(
    sets: Mapping[Set, Fitted], members: Set, runs: ServoRuns, unseen: ServoRuns | None
) -> tuple[Standing, ...]:
    """How sure each effect is: what it gains where it was fitted, unless runs that nobody fitted lose as much by it."""
    fitted = sets[members]
    stds = errors_of(fitted)
    worse = {name: relative(sets[members - {name}], fitted, runs) for name in members}
    lost = dict.fromkeys(members, 0.0)
    if unseen is not None and unseen.measured.any():
        left = unfollowed(unseen, fitted)
        lost = {name: math.log(left / unfollowed(unseen, sets[members - {name}])) for name in members}
    found = [
        Standing(
            name,
            presence(height(worse[name], fitted)) * (1.0 if lost[name] < worse[name] else UNCONFIRMED),
            worse[name] / sum(worse.values()),
            parameters_of(name, fitted, stds),
            in_place_of(sets, members, name, runs),
        )
        for name in members
    ]
    for more in [one for one in sets if len(one) == len(members) + 1 and one > members]:
        (name,) = more - members
        probability = min(presence(height(relative(fitted, sets[more], runs), sets[more])), NAMED - LEAST)
        if probability >= LEAST:
            found.append(Standing(name, probability, 0.0, parameters_of(name, sets[more], errors_of(sets[more]))))
    return tuple(sorted(found, key=lambda item: (-item.probability, -item.share)))


def in_place_of(sets: Mapping[Set, Fitted], members: Set, name: str, runs: ServoRuns) -> tuple[str, ...]:
    """Effects that follow the runs as well in the place of a member, as far as forms can tell."""
    others = {one: next(iter(one - members)) for one in sets if members - one == {name} and len(one - members) == 1}
    return tuple(sorted(q for one, q in others.items() if relative(sets[one], sets[members], runs) < FORM_ERROR))


def effects_of(model: Model) -> Parameters:
    """Effects that a model has already, as the simulation names them; they stay as they are."""
    found: Parameters = {}
    for entry in model.effects:
        values = dict(entry.parameters)
        if "phase" in values:
            amplitude, phase = values.pop("amplitude"), values.pop("phase")
            values |= {"cos": amplitude * math.cos(phase), "sin": -amplitude * math.sin(phase)}
        found |= {f"{entry.effect}.{name}": value for name, value in values.items()}
    return found


def starts_of(runs: ServoRuns, model: Model, proposed: Sequence[Candidate]) -> dict[str, list[Parameters]]:
    """Where each effect begins, from what the rig can do."""
    forms = dict(proposed)
    largest = float(np.max(runs.limit)) / (model.phase_resistance or math.inf)
    exponent = forms.get("saturation", (1.0,))[0]
    turned = np.abs(np.diff(runs.angle, axis=1))[runs.measured[:, 1:]]
    fast = max(float(np.quantile(turned, 0.95)) / runs.interval, 1e-3)
    shape = forms.get("stribeck", (1.0, 1.0))[1]
    found: dict[str, list[Parameters]] = {
        "load_dependent_friction": [{"coefficient": 0.1}],
        "saturation": [{"loss": LOST, "exponent": exponent, "current": max(largest, 1e-3)}],
        "stribeck": [{"breakaway_ratio": 0.1, "stribeck_velocity": share * fast, "shape": shape} for share in FADES],
    }
    for name, form in proposed:
        if name == "position_dependent_friction":
            found[name] = [{"cos": 0.01, "sin": 0.01, "order": form[0]}]
        if name == "asymmetric_friction":
            found[name] = [{"asymmetry": 0.01}]
        if name == "quadratic_drag":
            found[name] = [{"coefficient": 0.1 * (model.viscous_damping or 0.0) / fast}]
        if name == "dead_time":
            found[name] = [{"voltage": 0.01 * float(np.max(runs.limit)), "current": 0.1 * largest}]
    return {
        effect: [{f"{effect}.{name}": value for name, value in start.items()} for start in starts]
        for effect, starts in found.items()
    }


def every_set(
    runs: ServoRuns, model: Model, starts: Mapping[str, Sequence[Parameters]], fixed: Parameters
) -> dict[Set, Fitted]:
    """The best fit of every set of effects, each from the fits of what it is made of."""
    begin = {name: float(getattr(model, name) or 0.0) for name in OWN} | RIG | fixed
    (alone,) = fit(runs, [begin], tuple(fixed))
    best: dict[Set, Fitted] = {frozenset(): alone}
    for size in range(len(starts)):
        jobs: list[tuple[Set, Parameters]] = []
        for members in [m for m in best if len(m) == size]:
            for effect in sorted(starts.keys() - members):
                base = dict(best[members].parameters)
                if effect == "load_dependent_friction":
                    base["coulomb_friction"] *= 0.5  # of which it takes the place
                jobs += [(members | {effect}, base | start) for start in starts[effect]]
        for (members, _), found in zip(jobs, fit(runs, [start for _, start in jobs], tuple(fixed)), strict=True):
            if members not in best or found.cost < best[members].cost:
                best[members] = found
    return best


def prune(sets: Mapping[Set, Fitted], members: Set, runs: ServoRuns) -> Set:
    """The members that stand: of all, the weakest goes first."""
    while members:
        heights = {
            name: height(relative(sets[members - {name}], sets[members], runs), sets[members]) for name in members
        }
        weakest = min(sorted(members), key=lambda name: heights[name])
        if presence(heights[weakest]) >= NAMED:
            break
        members = members - {weakest}
    return members


def without(parameters: Parameters, effects: Set) -> Parameters:
    """The same but for what belongs to some effects."""
    return {name: value for name, value in parameters.items() if name.partition(".")[0] not in effects}


def relative(without: Fitted, fitted: Fitted, runs: ServoRuns) -> float:
    """Logarithm of how much worse a set is without a member, beside what the encoder's counts leave open."""
    open_to_all = len(fitted.error) * (COUNTS * runs.count) ** 2
    return math.log(max((without.cost + open_to_all) / (fitted.cost + open_to_all), 1.0))


def height(worse: float, fitted: Fitted) -> float:
    """How far an effect stands above what noise and the forms of others would give it."""
    independent = len(fitted.error) / rows_per_independent(fitted.error)
    return worse / math.hypot(FORM_ERROR, math.sqrt(2.0) / independent)


def unfollowed(runs: ServoRuns, fitted: Fitted) -> float:
    """Cost of other runs with the parameters of a fit."""
    return cost((replay(runs, table([fitted.parameters]))[0] - runs.angle)[runs.measured])


def errors_of(fitted: Fitted) -> dict[str, float]:
    """Standard errors of what was fitted: by errors that hang together, or by how far runs lie apart if that is more.

    The second is the sandwich of Huber (1967) over whole runs; a parameter that nothing shows has its own size.
    """
    sizes = np.array([SCALES[name] for name in fitted.names])
    inverse = np.linalg.pinv(fitted.information, hermitian=True)
    variance = np.diag(inverse) * fitted.cost / len(fitted.error) * rows_per_independent(fitted.error)
    count = len(fitted.scores)
    if count >= FEW_RUNS:
        apart = inverse @ (fitted.scores.T @ fitted.scores) @ inverse * count / (count - 1)
        variance = np.maximum(variance, np.diag(apart))
    shown = np.diag(fitted.information) * sizes**2 > 1e-9 * fitted.cost
    stds = np.where(shown, np.sqrt(np.maximum(variance, 0.0)), sizes)
    return dict(zip(fitted.names, stds.tolist(), strict=True))


def parameters_of(effect: str, fitted: Fitted, stds: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """The parameters of an effect by the names of its definition, with standard errors."""
    found = {
        name.removeprefix(f"{effect}."): (value, stds.get(name, 0.0))
        for name, value in fitted.parameters.items()
        if name.startswith(f"{effect}.")
    }
    if "cos" not in found:
        return found
    (cosine, one), (sine, other) = found.pop("cos"), found.pop("sin")
    amplitude, spread = math.hypot(cosine, sine), max(one, other)
    return found | {"amplitude": (amplitude, spread), "phase": (math.atan2(-sine, cosine), spread / amplitude)}
