"""Pendulums on position servos, made by a finer simulator of these tests: what free runs ask for, and what not."""

import numpy as np
import pytest

from leactl.gap.servo.fit import Fitted, fit
from leactl.gap.servo.ladder import climb, standing_of
from leactl.gap.servo.runs import servo_runs
from leactl.gap.servo.simulation import mean_absolute_errors

from .test_axis import SERVO, channel, recorded, servo_model, swung

TRUE = {"torque_constant": 0.33, "phase_resistance": 2.7, "viscous_damping": 0.0075, "coulomb_friction": 0.014}
INTERVAL_S, FINER, COUNT_RAD = 0.005, 20, 2.0 * np.pi / 4096
GAINS = (2.0, 4.0, 8.0, 14.0)


def bench(tmp_path, load=0.0, stribeck=0.0, lost=0.0, name="servo"):
    """Runs at several gains; friction falls with the square of speed, torque with the square of current."""
    time = INTERVAL_S * np.arange(1200)
    goals = np.stack([0.9 * np.sin(a * time) + 0.5 * np.sin(3.1 * time + a) for a in np.linspace(1.1, 1.6, len(GAINS))])
    step, gain = INTERVAL_S / FINER, np.array(GAINS)
    inertia, level = SERVO["rotor_inertia"] + 0.5 * 0.1**2, 0.5 * 9.80665 * 0.1
    angle, speed, rows = np.zeros(len(gain)), np.zeros(len(gain)), []
    for goal in goals.T:
        rows.append(angle)
        for _ in range(FINER):
            volts = np.clip(gain * (goal - angle), -7.4, 7.4)
            current = (volts - TRUE["torque_constant"] * speed) / TRUE["phase_resistance"]
            motor = TRUE["torque_constant"] * current * (1.0 - lost * (current / 2.5) ** 2)
            push = motor - level * np.sin(angle) - TRUE["viscous_damping"] * speed
            rub = (TRUE["coulomb_friction"] + load * np.abs(motor)) * (1.0 + stribeck * np.exp(-((speed / 0.4) ** 2)))
            stop = push + inertia / step * speed
            speed = np.where(np.abs(stop) <= rub, 0.0, speed + step / inertia * (push - np.sign(stop) * rub))
            angle = angle + step * speed
    angles = np.round(np.array(rows).T / COUNT_RAD) * COUNT_RAD
    return [
        recorded(
            tmp_path,
            [channel(time, "angle", angle, "rad"), channel(time, "angle_reference", goal, "rad")],
            {"drive_gain": own},
            f"{name}-{own:g}",
        )
        for own, angle, goal in zip(GAINS, angles, goals, strict=True)
    ]


def standing(*records, held_out=(), proposed=()):
    """Probabilities of what stands."""
    found = climb(records, held_out, servo_model(), proposed)
    return {item.effect: item.probability for item in found.standing}


def test_a_servo_that_lacks_nothing_but_its_parameters_has_no_cause(tmp_path):
    assert standing(*bench(tmp_path), proposed=[("position_dependent_friction", (3.0,))]) == {}


def test_friction_that_grows_with_load_stands_alone(tmp_path):
    found = standing(*bench(tmp_path, load=0.3))
    assert list(found) == ["load_dependent_friction"]
    assert found["load_dependent_friction"] > 0.9


def test_friction_that_grows_with_load_and_falls_with_speed_is_found_together(tmp_path):
    found = standing(*bench(tmp_path, load=0.3, stribeck=0.5))
    assert {"load_dependent_friction", "stribeck"} <= {name for name, p in found.items() if p > 0.9}
    assert "saturation" not in found


def test_torque_that_falls_short_is_told_from_friction(tmp_path):
    found = standing(*bench(tmp_path, lost=0.3), proposed=[("saturation", (2.0,))])
    assert list(found) == ["saturation"]


def test_what_other_runs_lose_by_more_than_the_fitted_ones_gain_is_not_believed(tmp_path):
    load, true = frozenset({"load_dependent_friction"}), SERVO | TRUE
    coefficient = {"load_dependent_friction.coefficient": 0.2}
    error, names = np.random.default_rng(1).normal(size=1000), ("coulomb_friction",)
    sets = {
        frozenset(): Fitted(true, 1.5, error, names, np.eye(1)),
        load: Fitted(true | coefficient, 1.0, error, names, np.eye(1)),
    }
    for unseen, believed in ((bench(tmp_path), False), (bench(tmp_path, load=0.2), True)):
        (one,) = standing_of(sets, load, servo_runs(unseen, servo_model()))
        assert (one.probability > 0.9) == believed


def test_free_runs_give_a_servo_s_parameters_back_with_their_errors(tmp_path):
    found = climb(bench(tmp_path, load=0.3), [], servo_model(), [])
    for name, true in TRUE.items():
        assert abs(found.augmented.parameters[name] - true) < 4.0 * found.stds[name] + 0.01 * true, name


def test_a_fit_finds_a_delay_of_the_reference(tmp_path):
    truth = SERVO | {"load_dependent_friction.coefficient": 0.3, "reference_delay": 0.006}
    runs = servo_runs(swung(tmp_path, **truth), servo_model())
    start = truth | {"coulomb_friction": 0.02, "load_dependent_friction.coefficient": 0.1, "reference_delay": 0.001}
    (found,) = fit(runs, [start])
    assert mean_absolute_errors(runs, found.parameters).max() < 1e-3
    assert found.parameters["load_dependent_friction.coefficient"] == pytest.approx(0.3, abs=0.02)
    assert found.parameters["reference_delay"] == pytest.approx(0.006, abs=5e-4)


def test_fits_side_by_side_end_where_each_ends_alone(tmp_path):
    runs = servo_runs(swung(tmp_path), servo_model())
    starts = [SERVO | {"coulomb_friction": 0.03}, SERVO | {"load_dependent_friction.coefficient": 0.2}]
    together = fit(runs, starts)
    for start, found in zip(starts, together, strict=True):
        (alone,) = fit(runs, [start])
        assert found.parameters == pytest.approx(alone.parameters)
