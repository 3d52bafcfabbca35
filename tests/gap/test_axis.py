"""Equations of foreign rigs on motion that is made up: a servo's pendulum, a force on a carriage, a creeping rotor."""

from unittest.mock import patch

import numpy as np
import pytest

from leactl.errors import InputError
from leactl.gap.equations import equations
from leactl.gap.servo.runs import servo_runs
from leactl.gap.servo.simulation import replay
from leactl.gap.signals.record import build_record
from leactl.gap.signals.rig import creep_direction
from leactl.model.nominal import Model
from leactl.runfile.read.reader import Channel

from .test_foreign import NO_PRIORS, fitted, rows_of

SERVO = {
    "torque_constant": 0.3,
    "phase_resistance": 3.0,
    "rotor_inertia": 0.002,
    "viscous_damping": 0.006,
    "coulomb_friction": 0.01,
}
PENDULUM = {"load": {"type": "pendulum", "mass": 0.5, "length": 0.1}}
DRIVE = {"drive": {"type": "position_servo", "gain": 3.0, "voltage_limit": 7.4}}


def channel(time, quantity, values, units="1", role="test"):
    values = np.broadcast_to(np.asarray(values, float), time.shape).copy()
    return Channel(time, values, quantity, role, units, "", "", "", "instant", "loop")


def recorded(tmp_path, channels, setup=None, name="a"):
    return build_record(tmp_path / f"{name}.h5", "free", "free", channels, setup or {})


def servo_model(**changes):
    return Model(name="servo", **(SERVO | PENDULUM | DRIVE | changes))


def swung(tmp_path, interval=0.005, **truth):
    """Two gains' runs of a servo's pendulum, as another bench would have recorded them."""
    time = interval * np.arange(round(12.0 / interval))
    goal = 0.9 * np.sin(1.3 * time) + 0.5 * np.sin(3.1 * time)
    model, records = servo_model(), []
    for gain in (2.0, 8.0):
        on = (np.abs(time - 9.0) > 0.5).astype(float)
        parts = [channel(time, "angle", 0.0, "rad"), channel(time, "angle_reference", goal, "rad")]
        parts.append(channel(time, "drive_enabled", on))
        blank = recorded(tmp_path, parts, {"drive_gain": gain})
        sets = {name: np.array([value]) for name, value in (SERVO | truth).items()}
        with patch("leactl.gap.servo.runs.SERVO_STEP", 0.0):  # a step a sample, however slow the servo is
            parts[0] = channel(time, "angle", replay(servo_runs([blank], model), sets)[0, 0], "rad")
        records.append(recorded(tmp_path, parts, {"drive_gain": gain}, f"gain{gain:g}"))
    return records


def test_a_servo_balance_closes_on_its_own_model(tmp_path):
    records = swung(tmp_path)
    for rows in rows_of(records, servo_model()):
        drive = rows.columns["calibration", "phase_resistance"]
        assert np.std(rows.left_over) < 0.05 * np.std(drive)


def test_a_servo_balance_shows_friction_that_grows_with_load(tmp_path):
    records = swung(tmp_path, **{"load_dependent_friction.coefficient": 0.3, "load_zero": 0.02})
    load = [("load_dependent_friction", (0.0,))]
    _, _, found = fitted(rows_of(records, servo_model(), load), load)
    assert found["effect", "load_dependent_friction", "(0.0,)", "coefficient"] == pytest.approx(0.3, abs=0.05)
    assert found["nuisance", "", "load_zero_rad"] == pytest.approx(0.02, abs=0.005)


def test_the_run_s_own_set_up_replaces_the_model_s(tmp_path):
    records = swung(tmp_path)
    heavy = [r for r in records]
    for record in heavy:
        record.setup["load_mass"] = 0.7
    (light, *_), (more, *_) = rows_of(swung(tmp_path), servo_model()), rows_of(heavy, servo_model())
    assert np.std(more.left_over) > 3 * np.std(light.left_over)
    (same, *_) = rows_of(heavy, servo_model(load={"type": "pendulum", "mass": 9.0, "length": 0.1}))
    np.testing.assert_allclose(same.left_over, more.left_over)


def test_no_voltage_acts_while_a_servo_is_let_go(tmp_path):
    record = swung(tmp_path)[1]
    (equation,) = [e for e in equations(record, servo_model()) if e.name == "axis_torque"]
    off = np.flatnonzero(record.fast.get("drive_enabled") < 0.5)[10:-10]
    assert np.all(equation.calibration["phase_resistance"][off] == 0.0)
    assert not equation.mask[off[0] - 11]  # the sample at which it is let go is left out


def test_a_run_without_a_servo_cannot_be_simulated_as_one(tmp_path):
    time = 0.005 * np.arange(200)
    bare = recorded(tmp_path, [channel(time, "angle", np.sin(time), "rad")])
    with pytest.raises(InputError, match="no position servo"):
        servo_runs([bare], servo_model())


@pytest.mark.parametrize(
    ("interval", "quantity", "gain"),
    [(0.001, "torque_reference", 1.0), (0.004, "torque", 1.0), (0.004, "q_axis_current_reference", 40.0)],
)
def test_a_force_on_a_carriage_gives_mass_and_friction(tmp_path, interval, quantity, gain):
    time = interval * np.arange(round(20.0 / interval))
    position = 0.1 * np.sin(2.0 * time) + 0.02 * np.sin(7.0 * time)
    speed = 0.2 * np.cos(2.0 * time) + 0.14 * np.cos(7.0 * time)
    acceleration = -0.4 * np.sin(2.0 * time) - 0.98 * np.sin(7.0 * time)
    force = 95.0 * acceleration + 200.0 * speed + 20.0 * np.sign(speed) - 3.0
    parts = [channel(time, "angle", position, "m"), channel(time, quantity, force / gain, "N")]
    model = Model(name="axis", torque_constant=40.0, rotor_inertia=90.0, viscous_damping=220.0, coulomb_friction=25.0)
    offset = [("asymmetric_friction", ())]
    (rows,) = rows_of([recorded(tmp_path, parts)], model, offset)
    assert (rows.equation, rows.units) == ("axis_torque", "N")
    _, _, found = fitted([rows], offset, NO_PRIORS)
    assert 90.0 * (1 + found["calibration", "rotor_inertia"]) == pytest.approx(95.0, rel=0.003)
    assert 220.0 * (1 + found["calibration", "viscous_damping"]) == pytest.approx(200.0, rel=0.01)
    assert 25.0 * (1 + found["calibration", "coulomb_friction"]) == pytest.approx(20.0, rel=0.02)
    assert 25.0 * found["effect", "asymmetric_friction", "()", "asymmetry"] == pytest.approx(-3.0, abs=0.1)
    if quantity == "torque":
        return  # a sensor's, whose zero is not the drive's
    zero = [("current_sensor_offset", ())]  # which a force that is told shows alike
    (rows,) = rows_of([recorded(tmp_path, parts)], model, zero)
    _, _, found = fitted([rows], zero, NO_PRIORS)
    assert 40.0 * found["effect", "current_sensor_offset", "()", "offset"] == pytest.approx(-3.0, abs=0.1)


@pytest.mark.parametrize(("quantity", "is_fitted"), [("q_axis_current_reference", True), ("torque_reference", False)])
def test_a_known_weight_gives_the_torque_constant_of_a_commanded_current(tmp_path, quantity, is_fitted):
    """A gain that is not fitted would be named as a spring or as a gravity that the model lacks."""
    time = 0.0025 * np.arange(8000)
    angle = 0.9 * np.sin(2.0 * time) + 0.3 * np.sin(5.0 * time)
    speed = 1.8 * np.cos(2.0 * time) + 1.5 * np.cos(5.0 * time)
    acceleration = -3.6 * np.sin(2.0 * time) - 7.5 * np.sin(5.0 * time)
    model = servo_model(drive=None, torque_constant=1.1, rotor_inertia=0.035, viscous_damping=0.06)
    weight = 0.5 * 9.81 * 0.1
    torque = (0.035 + model.load.inertia) * acceleration + 0.06 * speed + 0.01 * np.sign(speed) + weight * np.sin(angle)
    true_constant = 1.0
    parts = [channel(time, "angle", angle, "rad"), channel(time, quantity, torque / true_constant, "A")]
    (rows,) = rows_of([recorded(tmp_path, parts)], model, [])
    assert (("calibration", "torque_constant") in rows.columns) is is_fitted
    if is_fitted:
        _, _, found = fitted([rows], [], NO_PRIORS)
        assert 1.1 * (1.0 + found["calibration", "torque_constant"]) == pytest.approx(true_constant, rel=0.01)


def test_a_rotor_that_creeps_from_hold_to_hold_shows_cogging(tmp_path):
    """Holds of five samples every quarter of a second, an encoder of 20,000 counts, overshoot by a few of them."""
    rng = np.random.default_rng(5)
    holds = np.repeat(0.002 * np.arange(1500), 5)
    time = np.cumsum(np.where(np.arange(7500) % 5 == 0, 0.25, 0.012) * rng.uniform(0.8, 1.2, 7500))
    count = 2 * np.pi / 20000
    angle = count * np.round((holds + count * rng.integers(-2, 3, 7500)) / count)
    torque = 0.002 - 0.004 * np.sin(72 * angle + 0.5)
    parts = [channel(time, "angle", angle, "rad"), channel(time, "q_axis_current", torque / 0.025, "A")]
    model = Model(name="motor", torque_constant=0.025, rotor_inertia=2e-5, coulomb_friction=0.002)
    cogging = [("cogging", (72.0, 144.0))]
    (rows,) = rows_of([recorded(tmp_path, parts)], model, cogging)
    _, _, found = fitted([rows], cogging)
    sizes = {name[-1]: value for name, value in found.items() if name[0] == "effect"}
    assert np.hypot(sizes["cos"], sizes["sin"]) == pytest.approx(0.004, rel=0.03)
    assert np.arctan2(sizes["cos"], sizes["sin"]) == pytest.approx(0.5, abs=0.03)
    assert np.hypot(sizes["cos_144"], sizes["sin_144"]) < 2e-4
    assert found["calibration", "coulomb_friction"] == pytest.approx(0.0, abs=0.05)


def test_the_sense_of_a_creep_is_that_of_its_last_real_move():
    angle = np.concatenate([np.arange(200.0), np.arange(200.0, 0.0, -1.0)])
    sense = creep_direction(angle + np.tile([0.0, 2.0], 200), 10.0)
    assert np.all(sense[30:195] > 0.7)
    assert np.all(sense[240:] < -0.7)
