"""Convert the fitted effect sets of a servo into causes, calibration and notes of a diagnosis."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from leactl.gap.diagnosis import CalibratedParameter, Cause, EffectParameter, Shrinkage
from leactl.gap.planning.separating import separating_experiment
from leactl.gap.replay import replay_all
from leactl.gap.replay.bench_of_model import plant_of
from leactl.gap.replay.job import Job
from leactl.gap.search.effect_regression import PRIORS
from leactl.gap.search.parameters import LEAST_MODEL_ERROR, UNITS, with_effects
from leactl.gap.servo.effect_sets import MODEL_PARAMETERS, FittedEffectSets
from leactl.gap.servo.fit import FittedServo
from leactl.gap.servo.runs import runs_at_common_rate
from leactl.gap.servo.simulation import FREE_PARAMETERS
from leactl.gap.signals.record import Record
from leactl.gap.signals.rig import drive_of
from leactl.gap.verdict.decision import NAMED_PROBABILITY
from leactl.gap.verdict.judge import MOST_PROBABILITY, UNCONFIRMED_FACTOR, Unexplained
from leactl.model.nominal import Model
from leactl.vocabulary.effect import effect_definition

SIMULATED_EFFECTS = {name.partition(".")[0] for name in FREE_PARAMETERS if "." in name}
"""Effects that the simulation of a servo includes."""
ALLOWED_RMS_OVER_FLOOR = 3.0  # RMS error over floor that a replay without the rig's load zero and delay may have
LEAST_LEAP_RATIO = 2.0  # step of the reference over the fastest step of the axis, above which the reference leaps
TOP_STEP_QUANTILE = 0.99  # quantile of the axis' steps that counts as its fastest
ARRIVAL_SHARE = 0.1  # share of a leap; an axis this close to its reference has arrived
STAMP_ERROR_FACTOR = 2.0  # mean square error that a replay may have, in multiples of the error hidden by stamps
# parameters of a motor whose errors are small beside their values, as friction's are not
DATA_SHEET_PARAMETERS = ("torque_constant", "phase_resistance", "rotor_inertia")
MOST_PRIOR_WIDTHS = 5.0  # widths of its prior by which a calibrated parameter may differ from the model's
CONFIRMED_ERROR_RATIO = 0.95  # mean square error with an effect over that without, below which free runs confirm it


def judged_by_runs(model: Model, records: Sequence[Record]) -> bool:
    """Return whether free runs judge the effects of a servo, instead of a balance of torques.

    They do if a position servo drives a run, no run logs its q-axis current, the servo simulation includes every effect
    of the model, and the model has a torque constant, a phase resistance and a rotor inertia.
    """
    includes_all_effects = all(entry.effect in SIMULATED_EFFECTS for entry in model.effects)
    has_motor_parameters = model.torque_constant and model.phase_resistance and model.rotor_inertia
    logs_current = any(record.fast is not None and record.fast.get("q_axis_current") is not None for record in records)
    return bool(
        includes_all_effects and has_motor_parameters and not logs_current and runs_at_common_rate(records, model)
    )


def rig_note(fitted_sets: FittedEffectSets, has_pendulum: bool, left_out: Sequence[Record]) -> tuple[str, ...]:
    """Return notes on the load zero and the reference delay that free runs gave, and on runs left out of their fit."""
    load_zero, delay = fitted_sets.augmented.parameters["load_zero"], fitted_sets.reference_delay
    pendulum_text = (
        f"the pendulum straight down at {load_zero:.3g} rad (replays go without) and " if has_pendulum else ""
    )
    note = f"free runs have {pendulum_text}the reference {1e3 * delay:.2g} ms late, which no model file holds"
    if not left_out:
        return (note,)
    names = ", ".join(record.name for record in left_out)
    return note, f"not among the servo's free runs, for another pace or want of a reference: {names}"


def with_delayed_references(records: Sequence[Record], model: Model, delay: float) -> list[Record]:
    """Return runs with servo references `delay` [s] later: a delay hidden by stamps is no error of the model."""
    return [
        _with_delayed_reference(record, delay) if drive_of(record, model) is not None else record for record in records
    ]


def _with_delayed_reference(record: Record, delay: float) -> Record:
    """Return a run whose angle reference acts `delay` [s] later."""
    assert record.fast is not None
    return replace(record, fast=replace(record.fast, reference_delay=delay))


def causes(
    fitted_sets: FittedEffectSets, balance_causes: Sequence[Cause], records: Sequence[Record], calibrated: Model
) -> tuple[Cause, ...]:
    """Return causes from free runs, and from a balance of torques for effects that the simulation lacks.

    No torque is logged, so that the balance uses the model's torque. An effect that it proposes has to lower the mean
    square error of replayed angles; otherwise its probability is reduced.
    """
    from_free_runs = [
        Cause(
            item.effect,
            item.probability,
            item.share,
            parameters_with_units(item.effect, item.parameters),
            item.peers,
            separating_experiment(item.effect, item.peers),
            effect_definition(item.effect).family,
        )
        for item in fitted_sets.standing
    ]
    named = [_entry(cause) for cause in from_free_runs if cause.probability >= NAMED_PROBABILITY]
    from_balance = [cause for cause in balance_causes if cause.effect not in SIMULATED_EFFECTS]
    if from_balance:
        error_without_causes, *errors_with_each = mean_square_errors(
            records,
            [with_effects(calibrated, [*named, *further]) for further in [[], *([_entry(c)] for c in from_balance)]],
        )
        from_balance = [
            cause
            if error_with_cause < CONFIRMED_ERROR_RATIO * error_without_causes
            else replace(cause, probability=cause.probability * UNCONFIRMED_FACTOR)
            for cause, error_with_cause in zip(from_balance, errors_with_each, strict=True)
        ]
    return tuple(sorted([*from_free_runs, *from_balance], key=lambda cause: -cause.probability))


def mean_square_errors(records: Sequence[Record], models: Sequence[Model]) -> list[float]:
    """Return the mean square error [rad^2] of the angle when runs are replayed with each model, by model."""
    jobs = [[Job(record, plant_of(model)) for record in records] for model in models]
    replay_all([job for jobs_of_model in jobs for job in jobs_of_model])
    squares = []
    for jobs_of_model in jobs:
        pairs = [(job.fast["angle", "test"], job.clock) for job in jobs_of_model if ("angle", "test") in job.fast]
        errors = np.concatenate(
            [(angle - clock.values["angle", "test"])[clock.all_valid(("angle", "test"))] for angle, clock in pairs]
        )
        squares.append(float(np.nanmean(errors**2)))
    return squares


def _entry(cause: Cause) -> tuple[str, dict[str, float]]:
    """Return the effect of a cause with its parameters, as an entry of a model."""
    return cause.effect, {parameter.name: parameter.value for parameter in cause.parameters}


def implausible_calibration(parameters: Sequence[CalibratedParameter]) -> Unexplained:
    """Return the sign of runs that no motor of this model file makes: the farthest parameter that a data sheet gives.

    An angle in another unit is followed by a motor without resistance and inertia as closely as by the right one.
    """
    widths = {
        item: abs(item.fitted - item.nominal) / math.hypot(PRIORS[item.parameter] * item.nominal, item.std)
        for item in parameters
        if item.parameter in DATA_SHEET_PARAMETERS and item.nominal
    }
    farthest = max(widths, key=lambda item: widths[item], default=None)
    if farthest is None or widths[farthest] < MOST_PRIOR_WIDTHS:
        return Unexplained(0.0, "")
    change = 100.0 * (farthest.fitted / farthest.nominal - 1.0)
    note = (
        f"unexplained: these runs need a {farthest.parameter} {change:+.0f} % off the model's, {widths[farthest]:.2g}"
        " times what a model file may be off; is a channel in another unit, or the model of another motor?"
    )
    return Unexplained(MOST_PROBABILITY, note)


def angle_error_ratios(shrinkage: Sequence[Shrinkage], records: Sequence[Record]) -> dict[tuple[str, str, str], float]:
    """Return the augmented model's mean square angle error over the allowed one, by (equation, quantity, set-up)."""
    hidden_by_stamps = STAMP_ERROR_FACTOR * float(np.mean([error_hidden_by_stamps(record) for record in records]))
    return {
        ("free run", line.quantity, line.mechanical): line.augmented_rms**2
        / ((ALLOWED_RMS_OVER_FLOOR * line.floor_rms) ** 2 + hidden_by_stamps)
        for line in shrinkage
        if line.quantity == "angle"
    }


def error_hidden_by_stamps(record: Record) -> float:
    """Return the mean square error [rad^2] of an axis due to leaps of its reference at unknown times between stamps."""
    clock = record.fast
    if clock is None or ("angle_reference", "test") not in clock.unstamped or clock.get("angle") is None:
        return 0.0
    reference, angle = clock.values["angle_reference", "test"], clock.values["angle", "test"]
    angle_change, reference_change = np.abs(np.diff(angle)), np.abs(np.diff(reference))
    distance, is_moving = np.abs(reference - angle)[1:], np.zeros(len(angle_change), np.bool_)
    for leap in np.flatnonzero(
        reference_change > LEAST_LEAP_RATIO * float(np.quantile(angle_change, TOP_STEP_QUANTILE))
    ):
        arrival = np.flatnonzero(distance[leap:] < ARRIVAL_SHARE * reference_change[leap])
        is_moving[leap : leap + arrival[0] if len(arrival) else None] = True
    return float(np.sum(angle_change[is_moving] ** 2)) / (12.0 * len(angle))


def parameters_with_units(effect: str, fitted: Mapping[str, tuple[float, float]]) -> tuple[EffectParameter, ...]:
    """Return an effect's fitted parameters, given as (value, standard error), with the units of its definition."""
    defined = effect_definition(effect).parameters
    return tuple(EffectParameter(name, *fitted[name], defined[name].units) for name in defined if name in fitted)


def calibration(model: Model, fitted: FittedServo, stds: Mapping[str, float]) -> tuple[CalibratedParameter, ...]:
    """Return the calibrated parameters of the nominal model from free runs."""
    parameters = []
    for name in MODEL_PARAMETERS:
        nominal, value = float(getattr(model, name) or 0.0), fitted.parameters[name]
        std = max(stds.get(name, 0.0), LEAST_MODEL_ERROR * abs(value))
        parameters.append(CalibratedParameter(name, nominal, value, std, UNITS[name]))
        if name == "torque_constant" and model.back_emf_constant is not None:
            back_emf = "back_emf_constant"
            parameters.append(CalibratedParameter(back_emf, model.back_emf_constant, value, std, UNITS[back_emf]))
    return tuple(parameters)
