"""The fitted effect sets of a servo, put into the words of a diagnosis."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from leactl.gap.diagnosis import CalibratedParameter, Cause, EffectParameter, Shrinkage
from leactl.gap.planning.separating import separating_experiment
from leactl.gap.replay import replay_all
from leactl.gap.replay.bench_of_model import plant_of
from leactl.gap.replay.job import Job
from leactl.gap.search.parameters import LEAST_MODEL_ERROR, UNITS, with_effects
from leactl.gap.servo.effect_sets import OWN, FittedEffectSets
from leactl.gap.servo.fit import FittedServo
from leactl.gap.servo.profile import shifted
from leactl.gap.servo.runs import runs_at_common_rate
from leactl.gap.servo.simulation import FREE
from leactl.gap.signals.record import Record
from leactl.gap.signals.rig import drive_of
from leactl.gap.verdict.decision import NAMED
from leactl.gap.verdict.judge import UNCONFIRMED
from leactl.model.nominal import Model
from leactl.vocabulary.effect import effect_definition

SIMULATED = {name.partition(".")[0] for name in FREE if "." in name}
"""Effects that a servo's simulation knows."""
USUAL = 3.0  # floors that a replay without the rig's own zero and delay leaves
LEAPS, TOP = 2.0, 0.99  # times the highest speed of the axis, from which a reference leaps; the quantile that is it
ARRIVED = 0.1  # of a leap, within which the axis is there
SURE = 2.0  # variances of a uniform instant, that may be hidden
CLOSER = 0.95  # of the squared distance without it, that an effect of the balance must bring a free run to


def judged_by_runs(model: Model, records: Sequence[Record]) -> bool:
    """Whether runs are of a pendulum on a position servo whose torque no channel shows, in a model that can move it."""
    known = all(entry.effect in SIMULATED for entry in model.effects)
    moves = model.torque_constant and model.phase_resistance and model.rotor_inertia
    told = any(record.fast is not None and record.fast.get("q_axis_current") is not None for record in records)
    return bool(known and moves and not told and runs_at_common_rate(records, model))


def rig_note(fitted_sets: FittedEffectSets, pendulum: bool, left_out: Sequence[Record]) -> tuple[str, ...]:
    """What free runs told of the rig that no model file holds, and which runs were not among them."""
    zero, late = fitted_sets.augmented.parameters["load_zero"], fitted_sets.late
    hangs = f"the pendulum straight down at {zero:.3g} rad (replays go without) and " if pendulum else ""
    note = f"free runs have {hangs}the reference {1e3 * late:.2g} ms late, which no model file holds"
    if not left_out:
        return (note,)
    names = ", ".join(record.name for record in left_out)
    return note, f"not among the servo's free runs, for another pace or want of a reference: {names}"


def on_time(records: Sequence[Record], model: Model, late: float) -> list[Record]:
    """Runs of a servo whose references arrive as free runs have them: what a stamp hides is nobody's fault."""
    return [_shifted(record, late) if drive_of(record, model) is not None else record for record in records]


def _shifted(record: Record, late: float) -> Record:
    clock = record.fast
    assert clock is not None
    key = ("angle_reference", "test")
    values = clock.values | {key: shifted(clock.values[key][None], late / clock.interval)[0]}
    return replace(record, fast=replace(clock, values=values))


def causes(
    fitted_sets: FittedEffectSets, balanced: Sequence[Cause], records: Sequence[Record], calibrated: Model
) -> tuple[Cause, ...]:
    """What stands in free runs, beside what a balance of torques found of effects that no servo's simulation knows.

    The torque of that balance is the model's own: what it finds must bring a free run closer, or is no more than odd.
    """
    standing = [
        Cause(
            item.effect,
            item.probability,
            item.share,
            parameters(item.effect, item.parameters),
            item.peers,
            separating_experiment(item.effect, item.peers),
            effect_definition(item.effect).family,
        )
        for item in fitted_sets.standing
    ]
    named = [_entry(cause) for cause in standing if cause.probability >= NAMED]
    others = [cause for cause in balanced if cause.effect not in SIMULATED]
    if others:
        alone, *with_each = distances(
            records, [with_effects(calibrated, [*named, *more]) for more in [[], *([_entry(c)] for c in others)]]
        )
        others = [
            cause if closer < CLOSER * alone else replace(cause, probability=cause.probability * UNCONFIRMED)
            for cause, closer in zip(others, with_each, strict=True)
        ]
    return tuple(sorted([*standing, *others], key=lambda cause: -cause.probability))


def distances(records: Sequence[Record], models: Sequence[Model]) -> list[float]:
    """Mean squares of the angle's error in free runs, for each model."""
    jobs = [[Job(record, plant_of(model)) for record in records] for model in models]
    replay_all([job for own in jobs for job in own])
    squares = []
    for own in jobs:
        pairs = [(job.fast["angle", "test"], job.clock) for job in own if ("angle", "test") in job.fast]
        wrong = np.concatenate(
            [(angle - clock.values["angle", "test"])[clock.all_valid(("angle", "test"))] for angle, clock in pairs]
        )
        squares.append(float(np.nanmean(wrong**2)))
    return squares


def _entry(cause: Cause) -> tuple[str, dict[str, float]]:
    return cause.effect, {parameter.name: parameter.value for parameter in cause.parameters}


def unfollowed(shrinkage: Sequence[Shrinkage], records: Sequence[Record]) -> dict[tuple[str, str, str], float]:
    """Of the angle: what the last model leaves of held-out runs, over what a servo's replay may well leave."""
    hidden = SURE * float(np.mean([hidden_by_stamps(record) for record in records]))
    return {
        ("free run", line.quantity, line.mechanical): line.augmented_rms**2 / ((USUAL * line.floor_rms) ** 2 + hidden)
        for line in shrinkage
        if line.quantity == "angle"
    }


def hidden_by_stamps(record: Record) -> float:
    """Mean square [rad^2] by which an axis is off where its reference leaps, at whatever instant between two stamps."""
    clock = record.fast
    if clock is None or ("angle_reference", "test") not in clock.unstamped or clock.get("angle") is None:
        return 0.0
    reference, angle = clock.values["angle_reference", "test"], clock.values["angle", "test"]
    moved, asked = np.abs(np.diff(angle)), np.abs(np.diff(reference))
    away, on_its_way = np.abs(reference - angle)[1:], np.zeros(len(moved), np.bool_)
    for leap in np.flatnonzero(asked > LEAPS * float(np.quantile(moved, TOP))):
        arrived = np.flatnonzero(away[leap:] < ARRIVED * asked[leap])
        on_its_way[leap : leap + arrived[0] if len(arrived) else None] = True
    return float(np.sum(moved[on_its_way] ** 2)) / (12.0 * len(angle))


def parameters(effect: str, fitted: Mapping[str, tuple[float, float]]) -> tuple[EffectParameter, ...]:
    """Parameters of an effect with the units of its definition."""
    defined = effect_definition(effect).parameters
    return tuple(EffectParameter(name, *fitted[name], defined[name].units) for name in defined if name in fitted)


def calibration(model: Model, fitted: FittedServo, stds: Mapping[str, float]) -> tuple[CalibratedParameter, ...]:
    """The nominal model's parameters as free runs have them."""
    parameters = []
    for name in OWN:
        nominal, value = float(getattr(model, name) or 0.0), fitted.parameters[name]
        std = max(stds.get(name, 0.0), LEAST_MODEL_ERROR * abs(value))
        parameters.append(CalibratedParameter(name, nominal, value, std, UNITS[name]))
        if name == "torque_constant" and model.back_emf_constant is not None:
            other = "back_emf_constant"
            parameters.append(CalibratedParameter(other, model.back_emf_constant, value, std, UNITS[other]))
    return tuple(parameters)
