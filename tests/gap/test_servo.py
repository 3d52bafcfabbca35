"""Pendulums on position servos, made by a finer simulator of these tests: what free runs ask for, and what not."""

from dataclasses import replace

import numpy as np
import pytest

from leactl.gap.diagnose import Case, diagnose, hold_out_runs
from leactl.gap.diagnosis import CalibratedParameter
from leactl.gap.servo.answer import implausible_calibration
from leactl.gap.servo.effect_sets import fit_effect_sets, likely_effects
from leactl.gap.servo.fit import FittedServo, fit
from leactl.gap.servo.runs import servo_runs
from leactl.gap.servo.simulation import replay, table
from leactl.gap.verdict.decision import UNKNOWN_PROBABILITY

from .test_axis import PENDULUM, SERVO, channel, recorded, servo_model, swung

TRUE = {"torque_constant": 0.33, "phase_resistance": 2.7, "viscous_damping": 0.0075, "coulomb_friction": 0.014}
INTERVAL_S, FINER, COUNT_RAD = 0.005, 20, 2.0 * np.pi / 4096
GAINS = (2.0, 4.0, 8.0, 14.0)


def bench(
    tmp_path, load=0.0, stribeck=0.0, lost=0.0, drag=0.0, dead=0.0, light=False, logs_current=False, name="servo"
):
    """Runs at several gains; friction falls with the square of speed, torque with the square of current."""
    time = INTERVAL_S * np.arange(1200)
    goals = np.stack([0.9 * np.sin(a * time) + 0.5 * np.sin(3.1 * time + a) for a in np.linspace(1.1, 1.6, len(GAINS))])
    step, gain = INTERVAL_S / FINER, np.array(GAINS)
    rotor, mass = (5e-4, 0.05) if light else (SERVO["rotor_inertia"], 0.5)
    inertia, level = rotor + mass * 0.1**2, mass * 9.80665 * 0.1
    angle, speed, rows, currents = np.zeros(len(gain)), np.zeros(len(gain)), [], []
    for goal in goals.T:
        rows.append(angle)
        for _ in range(FINER):
            volts = np.clip(gain * (goal - angle), -7.4, 7.4)
            volts = np.sign(volts) * np.maximum(np.abs(volts) - dead, 0.0)
            current = (volts - TRUE["torque_constant"] * speed) / TRUE["phase_resistance"]
            motor = TRUE["torque_constant"] * current * (1.0 - lost * (current / 2.5) ** 2)
            push = motor - level * np.sin(angle) - TRUE["viscous_damping"] * speed - drag * speed * np.abs(speed)
            rub = (TRUE["coulomb_friction"] + load * np.abs(motor)) * (1.0 + stribeck * np.exp(-((speed / 0.4) ** 2)))
            stop = push + inertia / step * speed
            speed = np.where(np.abs(stop) <= rub, 0.0, speed + step / inertia * (push - np.sign(stop) * rub))
            angle = angle + step * speed
        currents.append(current)
    currents_of_runs = np.array(currents).T
    angles = np.round(np.array(rows).T / COUNT_RAD) * COUNT_RAD
    return [
        recorded(
            tmp_path,
            [channel(time, "angle", angle, "rad"), channel(time, "angle_reference", goal, "rad")]
            + ([channel(time, "q_axis_current", current, "A")] if logs_current else []),
            {"drive_gain": drive_gain},
            f"{name}-{drive_gain:g}",
        )
        for drive_gain, angle, goal, current in zip(GAINS, angles, goals, currents_of_runs, strict=True)
    ]


def standing(*records, held_out=(), proposed=()):
    """Probabilities of what stands."""
    fitted_sets = fit_effect_sets(records, held_out, servo_model(), proposed)
    return {item.effect: item.probability for item in fitted_sets.standing}


def diagnosed(records, **changes):
    """The whole diagnosis of runs that all occur once."""
    return diagnose(Case(servo_model(**changes), *hold_out_runs(records)))


def named(answer):
    return sorted(cause.effect for cause in answer.causes if cause.probability >= 0.5)


def test_a_servo_is_diagnosed_whole(tmp_path):
    records = bench(tmp_path, load=0.3)
    diagnosis = diagnosed(records)
    assert (diagnosis.verdict, named(diagnosis)) == ("effect", ["load_dependent_friction"])
    assert any("straight down" in note for note in diagnosis.notes)
    [seen] = [cause.picture for cause in diagnosis.causes if cause.effect == "load_dependent_friction"]
    assert (seen.variable, seen.equation) == ("angle", "replay")  # no torque is logged: what a pendulum's angle makes
    assert seen.after_rms < 0.5 * seen.before_rms
    angle = next(line for line in diagnosis.shrinkage if line.quantity == "angle")
    assert angle.augmented_rms < 0.2 * angle.calibrated_rms
    again = diagnose(Case(diagnosis.extra["augmented"], *hold_out_runs(records)))
    assert named(again) == []
    entries = [entry.effect for entry in again.extra["augmented"].effects]
    assert entries == ["load_dependent_friction"]


@pytest.mark.long
def test_a_light_servo_without_any_effect_has_no_cause(tmp_path):
    diagnosis = diagnosed(bench(tmp_path, light=True), rotor_inertia=5e-4, load=PENDULUM["load"] | {"mass": 0.05})
    assert named(diagnosis) == []
    assert diagnosis.unexplained_probability < 0.5


UNNAMED = pytest.mark.xfail(strict=True, raises=AssertionError, reason="left unexplained, with no name")
PROPOSED = (
    ("quadratic_drag", {"drag": 0.02}),
    pytest.param("dead_time", {"dead": 0.4}, marks=UNNAMED),
)


@pytest.mark.long
@pytest.mark.parametrize(("effect", "truth"), PROPOSED)
def test_what_a_balance_proposes_may_take_the_place_of_what_is_always_tried(tmp_path, effect, truth):
    diagnosis = diagnosed(bench(tmp_path, **truth))
    assert effect in {
        name for c in diagnosis.causes if c.probability >= 0.5 for name in (c.effect, *c.indistinguishable_from)
    }
    assert len(named(diagnosis)) <= 2


def test_a_run_that_begins_in_motion_is_followed_from_there(tmp_path):
    records = [later(record, 100) for record in bench(tmp_path)]
    runs = servo_runs(records, servo_model())
    assert np.abs(runs.speed).max() > 0.3
    (found,) = fit(runs, [SERVO])
    assert found.parameters["rotor_inertia"] == pytest.approx(SERVO["rotor_inertia"], rel=0.2)


def later(record, first):
    fast = record.fast
    values, valid = ({key: part[first:] for key, part in parts.items()} for parts in (fast.values, fast.valid))
    return replace(record, fast=replace(fast, time=fast.time[first:], values=values, valid=valid))


@pytest.mark.long
def test_a_parameter_that_the_model_leaves_out_is_fitted_and_written(tmp_path):
    diagnosis = diagnosed(bench(tmp_path), coulomb_friction=None)
    assert named(diagnosis) == []
    assert diagnosis.extra["calibrated"].coulomb_friction == pytest.approx(TRUE["coulomb_friction"], rel=0.1)


@pytest.mark.long
def test_runs_at_another_pace_are_left_out_and_named(tmp_path):
    records = bench(tmp_path, load=0.3)
    slow = records[-1].fast
    half = slice(None, None, 2)
    parts = [channel(slow.time[half], name, slow.get(name)[half], "rad") for name in ("angle", "angle_reference")]
    records[-1] = recorded(tmp_path, parts, {"drive_gain": GAINS[-1]}, "slow")
    diagnosis = diagnosed(records)
    assert named(diagnosis) == ["load_dependent_friction"]
    assert any("another pace" in note and "slow" in note for note in diagnosis.notes)


@pytest.mark.long
def test_a_servo_that_logs_its_current_is_balanced_as_any_axis(tmp_path):
    diagnosis = diagnosed(bench(tmp_path, load=0.3, logs_current=True))
    assert "load_dependent_friction" in named(diagnosis)
    assert not any("straight down" in note for note in diagnosis.notes)


@pytest.mark.long
def test_a_servo_that_lacks_nothing_but_its_parameters_has_no_cause(tmp_path):
    assert standing(*bench(tmp_path), proposed=[("position_dependent_friction", (3.0,))]) == {}


@pytest.mark.long
def test_friction_that_grows_with_load_stands_alone(tmp_path):
    result = standing(*bench(tmp_path, load=0.3))
    assert list(result) == ["load_dependent_friction"]
    assert result["load_dependent_friction"] > 0.9


@pytest.mark.long
def test_friction_that_grows_with_load_and_falls_with_speed_is_found_together(tmp_path):
    result = standing(*bench(tmp_path, load=0.3, stribeck=0.5))
    assert {"load_dependent_friction", "stribeck"} <= {name for name, p in result.items() if p > 0.9}
    assert "saturation" not in result


@pytest.mark.long
def test_torque_that_falls_short_is_told_from_friction(tmp_path):
    result = standing(*bench(tmp_path, lost=0.3), proposed=[("saturation", (2.0, 1.0))])
    assert list(result) == ["saturation"]


def test_what_other_runs_lose_by_more_than_the_fitted_ones_gain_is_not_believed(tmp_path):
    load, true = frozenset({"load_dependent_friction"}), SERVO | TRUE
    coefficient = {"load_dependent_friction.coefficient": 0.2}
    error, names = np.random.default_rng(1).normal(size=1000), ("coulomb_friction",)
    sets = {
        frozenset(): FittedServo(true, 1.5, error, names, np.eye(1), np.ones((4, 1))),
        load: FittedServo(true | coefficient, 1.0, error, names, np.eye(1), np.ones((4, 1))),
    }
    for unseen, believed in ((bench(tmp_path), False), (bench(tmp_path, load=0.2), True)):
        runs = servo_runs(unseen, servo_model())
        (effect,) = likely_effects(sets, load, runs, runs)
        assert (effect.probability > 0.9) == believed


def test_free_runs_give_a_servo_s_parameters_back_with_their_errors(tmp_path):
    result = fit_effect_sets(bench(tmp_path, load=0.3), [], servo_model(), [])
    for name, true in TRUE.items():
        assert abs(result.augmented.parameters[name] - true) < 4.0 * result.stds[name] + 0.01 * true, name


def test_a_fit_finds_a_delay_of_the_reference(tmp_path):
    truth = SERVO | {"load_dependent_friction.coefficient": 0.3, "reference_delay": 0.006}
    runs = servo_runs(swung(tmp_path, **truth), servo_model())
    start = truth | {"coulomb_friction": 0.02, "load_dependent_friction.coefficient": 0.1, "reference_delay": 0.001}
    (found,) = fit(runs, [start])
    assert np.abs(replay(runs, table([found.parameters]))[0] - runs.angle).mean() < 1e-3
    assert found.parameters["load_dependent_friction.coefficient"] == pytest.approx(0.3, abs=0.02)
    assert found.parameters["reference_delay"] == pytest.approx(0.006, abs=5e-4)


@pytest.mark.long
def test_fits_side_by_side_end_where_each_ends_alone(tmp_path):
    runs = servo_runs(swung(tmp_path), servo_model())
    starts = [SERVO | {"coulomb_friction": 0.03}, SERVO | {"load_dependent_friction.coefficient": 0.2}]
    together = fit(runs, starts)
    for start, found in zip(starts, together, strict=True):
        (alone,) = fit(runs, [start])
        assert found.parameters == pytest.approx(alone.parameters)


@pytest.mark.parametrize(("inertia", "is_sign"), [(0.2, True), (0.5, False)])
def test_a_motor_that_no_model_file_is_so_far_off_is_no_calibration(inertia, is_sign):
    parameters = [
        CalibratedParameter("rotor_inertia", 1.0, inertia, 0.01, "kg*m^2"),
        CalibratedParameter("viscous_damping", 1.0, 5.0, 0.1, "N*m*s/rad"),  # may be off by any factor
    ]
    sign = implausible_calibration(parameters)
    assert (sign.probability > UNKNOWN_PROBABILITY) is is_sign
    assert ("rotor_inertia -80 % off the model's" in sign.note) is is_sign


@pytest.mark.long
def test_a_servo_logged_in_degrees_is_unknown(tmp_path):
    records = [in_degrees(record) for record in bench(tmp_path)]
    diagnosis = diagnosed(records)
    assert (diagnosis.verdict, named(diagnosis)) == ("unknown", [])
    assert any("is a channel in another unit" in note for note in diagnosis.notes)


def in_degrees(record):
    """A record whose angle and reference are in degrees."""
    values = {key: np.rad2deg(column) for key, column in record.fast.values.items()}
    return replace(record, fast=replace(record.fast, values=values))
