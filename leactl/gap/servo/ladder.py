"""Which effects a servo's free runs ask for: every small set fitted by simulation, from the fits of smaller ones.

A balance of torques linearises what moves by half where friction and torque constant trade places, and a servo does not
log its torque; a simulation that follows the angle does without both. Sets are fitted and not effects one by one:
friction that falls with speed shows nothing where friction that grows with load is missing. An effect counts by how far
the set of all that stand is worse without it, refitted.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.evidence import rows_per_independent
from leactl.gap.judge import UNCONFIRMED, presence
from leactl.gap.record import Record
from leactl.gap.regression import Candidate
from leactl.gap.servo.fit import Fitted, cost, fit
from leactl.gap.servo.runs import ServoRuns, servo_runs
from leactl.gap.servo.simulation import Parameters, replay, table
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
Set = frozenset[str]
OWN = ("torque_constant", "phase_resistance", "rotor_inertia", "viscous_damping", "coulomb_friction")
RIG = {"load_zero": 0.0, "reference_delay": 0.005}  # what belongs to the rig and to no model
ALL: Set = frozenset({"load_dependent_friction", "saturation", "stribeck"})
FORM_ERROR = 0.05  # relative change of a cost, that an effect makes by standing in for another or by luck of the search
"""On the XL330's logs, friction over the angle at any order gains 2 to 15 % beyond the others, by where a fit ends."""
LOST = 0.1  # share of the torque at the largest current, that saturation begins with
FADES = (0.03, 0.15)  # of the fast speeds, at which friction may begin to fall


@dataclass(frozen=True, eq=False)
class Standing:
    """An effect of the set."""

    effect: str
    probability: float
    share: float  # of what the set takes from the cost
    parameters: Mapping[str, tuple[float, float]]  # value and standard error


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
    sets = every_set(runs, model, starts_of(runs, model, proposed))
    members = prune(sets)
    for effect, start in waves(proposed).items():
        (with_wave,) = fit(runs, [sets[members].parameters | start])
        if presence(height(relative(sets[members], with_wave), with_wave)) < 0.5:
            continue
        smaller = [members - {name} for name in sorted(members)]
        others = fit(runs, [sets[one].parameters | start for one in smaller])
        sets |= {members | {effect}: with_wave} | {one | {effect}: f for one, f in zip(smaller, others, strict=True)}
        members |= {effect}
    standing = standing_of(sets, members, servo_runs(held_out, model) if held_out else None)
    named = frozenset(item.effect for item in standing if item.probability >= 0.5)
    return Ladder(standing, sets[frozenset()], sets[named], errors_of(sets[named]), sets)


def standing_of(sets: Mapping[Set, Fitted], members: Set, unseen: ServoRuns | None) -> tuple[Standing, ...]:
    """How sure each member is: what it gains where it was fitted, unless runs that nobody fitted lose as much by it."""
    fitted = sets[members]
    stds = errors_of(fitted)
    worse = {name: relative(sets[members - {name}], fitted) for name in members}
    lost = dict.fromkeys(members, 0.0)
    if unseen is not None:
        left = unfollowed(unseen, fitted)
        lost = {name: math.log(left / unfollowed(unseen, sets[members - {name}])) for name in members}
    found = [
        Standing(
            name,
            presence(height(worse[name], fitted)) * (1.0 if lost[name] < worse[name] else UNCONFIRMED),
            worse[name] / sum(worse.values()),
            parameters_of(name, fitted, stds),
        )
        for name in members
    ]
    return tuple(sorted(found, key=lambda item: (-item.probability, -item.share)))


def starts_of(runs: ServoRuns, model: Model, proposed: Sequence[Candidate]) -> dict[str, list[Parameters]]:
    """Where each effect begins, from what the rig can do."""
    forms = dict(proposed)
    largest = float(np.max(runs.limit)) / (model.phase_resistance or math.inf)
    exponent = forms.get("saturation", (1.0,))[0]
    fast = float(np.quantile(np.abs(np.diff(runs.angle, axis=1)), 0.95)) / runs.interval
    shape = forms.get("stribeck", (1.0, 1.0))[1]
    found: dict[str, list[Parameters]] = {
        "load_dependent_friction": [{"coefficient": 0.1}],
        "saturation": [{"loss": LOST * (25.0 / max(largest, 1e-3)) ** exponent, "exponent": exponent}],
        "stribeck": [{"breakaway_ratio": 0.1, "stribeck_velocity": share * fast, "shape": shape} for share in FADES],
    }
    return {
        effect: [{f"{effect}.{name}": value for name, value in start.items()} for start in starts]
        for effect, starts in found.items()
    }


def waves(proposed: Sequence[Candidate]) -> dict[str, Parameters]:
    """Friction over the angle, at the order that was proposed: tried beside what stands without it."""
    return {
        name: {f"{name}.cos": 0.01, f"{name}.sin": 0.01, f"{name}.order": form[0]}
        for name, form in proposed
        if name == "position_dependent_friction"
    }


def every_set(runs: ServoRuns, model: Model, starts: Mapping[str, Sequence[Parameters]]) -> dict[Set, Fitted]:
    """The best fit of every set of effects, each from the fits of what it is made of."""
    begin = {name: float(getattr(model, name) or 0.0) for name in OWN} | RIG
    (alone,) = fit(runs, [begin])
    best: dict[Set, Fitted] = {frozenset(): alone}
    for size in range(len(ALL)):
        jobs: list[tuple[Set, Parameters]] = []
        for members in [m for m in best if len(m) == size]:
            for effect in sorted(starts.keys() - members):
                base = dict(best[members].parameters)
                if effect == "load_dependent_friction":
                    base["coulomb_friction"] *= 0.5  # of which it takes the place
                jobs += [(members | {effect}, base | start) for start in starts[effect]]
        for (members, _), found in zip(jobs, fit(runs, [start for _, start in jobs]), strict=True):
            if members not in best or found.cost < best[members].cost:
                best[members] = found
    return best


def prune(sets: Mapping[Set, Fitted]) -> Set:
    """The members that stand: of all, the weakest goes first."""
    members = ALL
    while members:
        heights = {name: height(relative(sets[members - {name}], sets[members]), sets[members]) for name in members}
        weakest = min(sorted(members), key=lambda name: heights[name])
        if presence(heights[weakest]) >= 0.5:
            break
        members = members - {weakest}
    return members


def relative(without: Fitted, fitted: Fitted) -> float:
    """Logarithm of how much worse a set is without a member."""
    return math.log(max(without.cost / fitted.cost, 1.0))


def height(worse: float, fitted: Fitted) -> float:
    """How far an effect stands above what noise and the forms of others would give it."""
    independent = len(fitted.error) / rows_per_independent(fitted.error)
    return worse / math.hypot(FORM_ERROR, math.sqrt(2.0) / independent)


def unfollowed(runs: ServoRuns, fitted: Fitted) -> float:
    """Cost of other runs with the parameters of a fit."""
    return cost((replay(runs, table([fitted.parameters]))[0] - runs.angle)[runs.measured])


def errors_of(fitted: Fitted) -> dict[str, float]:
    """Standard errors of what was fitted: errors that hang together count for less."""
    variance = fitted.cost / len(fitted.error) * rows_per_independent(fitted.error)
    spread = np.linalg.pinv(fitted.information, hermitian=True) * variance
    stds = np.sqrt(np.maximum(np.diag(spread), 0.0))
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
