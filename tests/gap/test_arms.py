"""Motors that are fed with a voltage and log no current: arms, springs and drags in volts, and real arms of WPILib."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leactl.gap.diagnose import diagnose, hold_out_runs, read_case
from leactl.gap.equations import equations
from leactl.gap.replay import replay
from leactl.gap.search.parameters import with_calibration, with_effects
from leactl.gap.signals.record import read_record
from leactl.model.nominal import Model
from leactl.runfile.importing.importer import import_runs
from tests.gap.arms import TESTS, Arm, case_of, logs, recorded

VOLTS = {"name": "arm", "feedforward": {"kS": 0.17, "kV": 1.1, "kA": 0.13}}
# the same machine by its winding: a volt makes 1.25 N*m, back-EMF brakes with 0.625 N*m*s/rad
WINDING = {
    "name": "arm",
    "phase_resistance": 0.4,
    "torque_constant": 0.5,
    "back_emf_constant": 0.5,
    "rotor_inertia": 0.155,
    "viscous_damping": 0.8,
    "coulomb_friction": 0.2,
}
VOLTS_OF_TEST = ("q_axis_voltage", "test")
FILES = Path(__file__).parent / "foreign"
PUBLISHED = {
    "elbow_sysid_data20230222-162953": 0.61,
    "elbow_sysid_data20230222-163221": 0.62,
    "wrist_sysid_data20230306-171942": 0.57,
    "wrist_sysid_data20230306-172331": 0.55,
    "wrist_sysid_data20230306-172559": 0.54,
}  # V, kG of a least-squares fit over all four tests of each log


def weight(angle, speed):
    return 0.5 * np.cos(angle + 0.3)


def spring(angle, speed):
    return 0.3 * (angle - 0.2)


def drag(angle, speed):
    return 0.15 * speed * abs(speed)


def named(found):
    return [cause.effect for cause in found.causes if cause.probability >= 0.5]


def parameters_of(cause):
    return {item.name: (item.value, item.units) for item in cause.parameters}


@pytest.fixture(scope="module")
def weighed(tmp_path_factory):
    """A log of an arm whose weight the model leaves out."""
    return logs(tmp_path_factory.mktemp("arm"), Arm(pull=weight))


def test_a_feedforward_s_arm_is_told_in_volts(weighed):
    diagnosis = diagnose(case_of(weighed, Model.model_validate(VOLTS)))
    assert named(diagnosis) == ["gravity_load", "unbalance"]
    assert diagnosis.causes[0].indistinguishable_from == ("unbalance",)
    told = parameters_of(diagnosis.causes[0])
    assert told["amplitude"] == (pytest.approx(0.5, rel=0.02), "V")
    assert told["phase"] == (pytest.approx(0.3, abs=0.02), "rad")
    fitted = {line.parameter: (line.fitted, line.units) for line in diagnosis.calibration}
    assert fitted == {
        "feedforward.kS": (pytest.approx(0.15, rel=0.05), "V"),
        "feedforward.kV": (pytest.approx(1.2, rel=0.02), "V*s/rad"),
        "feedforward.kA": (pytest.approx(0.12, rel=0.05), "V*s^2/rad"),
    }
    (line,) = diagnosis.shrinkage
    assert line.closed > 0.95
    written = diagnosis.extra["augmented"]
    assert written.feedforward.kV == pytest.approx(1.2, rel=0.02)
    assert [entry.effect for entry in written.effects] == ["gravity_load"]


def test_a_winding_s_arm_is_told_in_newton_metres(weighed):
    diagnosis = diagnose(case_of(weighed, Model.model_validate(WINDING)))
    assert named(diagnosis) == ["gravity_load", "unbalance"]
    assert parameters_of(diagnosis.causes[0])["amplitude"] == (pytest.approx(0.625, rel=0.02), "N*m")


def test_an_arm_that_the_model_has_is_no_cause(weighed):
    mass = 0.625 / 9.80665 / 0.5
    load = {"type": "arm", "mass": mass, "length": 0.5, "zero_angle": 0.3}
    inertia = WINDING["rotor_inertia"] - mass * 0.25
    diagnosis = diagnose(case_of(weighed, Model.model_validate(WINDING | {"load": load, "rotor_inertia": inertia})))
    assert named(diagnosis) == []
    assert diagnosis.verdict in ("none", "calibration")


@pytest.mark.parametrize(
    ("pull", "effect", "size"),
    [(spring, "position_spring", 0.3), (drag, "quadratic_drag", 0.15), (None, None, None)],
)
def test_what_else_acts_on_the_rotor_is_named_and_a_sound_arm_is_sound(tmp_path, pull, effect, size):
    arm = Arm(pull=pull) if pull else Arm()
    diagnosis = diagnose(case_of(logs(tmp_path, arm), Model.model_validate(VOLTS)))
    assert named(diagnosis) == ([effect] if effect else [])
    if effect:
        value, units = next(iter(parameters_of(diagnosis.causes[0]).values()))
        assert value == pytest.approx(size, rel=0.05)
        assert units == {"position_spring": "V/rad", "quadratic_drag": "V*s^2/rad^2"}[effect]
    else:
        assert diagnosis.verdict == "calibration"


def test_a_replay_of_a_voltage_is_the_run(tmp_path):
    """The model that made a run moves as it did, second by second; without the arm's weight it does not."""
    run = recorded(tmp_path, Arm(pull=weight, noise=0.0), "fast-forward", np.random.default_rng(1))
    bare = Model.model_validate({"name": "arm", "feedforward": {"kS": 0.15, "kV": 1.2, "kA": 0.12}})
    whole = with_effects(bare, [("gravity_load", {"amplitude": 0.5, "phase": 0.3})])
    measured = run.fast.values["velocity", "test"]
    missed = []
    for model in (whole, bare):
        left = replay(run, model).fast["velocity", "test"] - measured
        missed.append(float(np.sqrt(np.nanmean(left**2))))
    assert missed[0] < 0.01 * np.std(measured)
    assert missed[1] > 0.3 * np.std(measured)


def test_an_arm_of_the_model_weighs_as_the_effect_does(tmp_path):
    run = recorded(tmp_path, Arm(pull=weight), "slow-backward", np.random.default_rng(1))
    mass = 0.625 / 9.80665 / 0.5
    plain = Model.model_validate(WINDING)
    load = {"type": "arm", "mass": mass, "length": 0.5, "zero_angle": 0.3}
    lighter = WINDING | {"rotor_inertia": WINDING["rotor_inertia"] - mass * 0.25, "load": load}
    by_load = replay(run, Model.model_validate(lighter)).fast["velocity", "test"]
    by_effect = replay(run, with_effects(plain, [("gravity_load", {"amplitude": 0.625, "phase": 0.3})]))
    np.testing.assert_allclose(by_load, by_effect.fast["velocity", "test"], atol=1e-9)


def test_a_run_s_own_mass_replaces_the_model_s(tmp_path):
    run = recorded(tmp_path, Arm(pull=weight), "slow-backward", np.random.default_rng(1))
    load = {"type": "arm", "mass": 0.2, "length": 0.5}
    model = Model.model_validate(WINDING | {"load": load})
    run.setup["load_mass"] = 0.4
    (own,) = [e for e in equations(run, model) if e.name == "axis_torque"]
    run.setup.clear()
    heavier = Model.model_validate(WINDING | {"load": load | {"mass": 0.4}})
    (other,) = [e for e in equations(run, heavier) if e.name == "axis_torque"]
    np.testing.assert_array_equal(own.left_over, other.left_over)


@pytest.mark.long
def test_a_turned_voltage_is_the_set_up_s_fault(weighed):
    turned = [
        replace(
            record,
            fast=replace(record.fast, values=record.fast.values | {VOLTS_OF_TEST: -record.fast.get(*VOLTS_OF_TEST)}),
        )
        for record in weighed
    ]
    diagnosis = diagnose(case_of(turned, Model.model_validate(VOLTS)))
    assert named(diagnosis) == ["channel_sign", "gravity_load", "unbalance"]
    assert "q_axis_voltage" in diagnosis.causes[0].change


@pytest.mark.long
def test_where_the_arm_makes_whole_turns_an_unbalance_stands_first(tmp_path):
    records = logs(tmp_path, Arm(pull=weight), span=8.0, start=-4.0)
    diagnosis = diagnose(case_of(records, Model.model_validate(VOLTS)))
    assert named(diagnosis) == ["unbalance", "gravity_load"]


def test_a_geared_motor_s_unbalance_is_another_thing(tmp_path):
    records = logs(tmp_path, Arm(pull=lambda angle, speed: -0.4 * np.sin(4.3 * angle + 0.5)))
    diagnosis = diagnose(case_of(records, Model.model_validate(VOLTS | {"gear_ratio": 4.3})))
    assert named(diagnosis)[0] == "unbalance"
    assert "gravity_load" not in named(diagnosis)
    assert parameters_of(diagnosis.causes[0])["phase"][0] == pytest.approx(0.5, abs=0.05)


def test_ramps_and_steps_of_one_name_are_no_runs_of_a_kind(weighed):
    for record in weighed:
        record.kind, kind = "sysid", record.kind
        assert kind in TESTS
    try:
        fitted, held_out = hold_out_runs(list(weighed))
    finally:
        for record, kind in zip(weighed, TESTS, strict=True):
            record.kind = kind
    assert len(fitted) == len(held_out) == len(TESTS)


def test_a_calibrated_feedforward_is_written_as_one():
    model = Model.model_validate(VOLTS)
    assert with_calibration(model, []).model_dump() == model.model_dump()


def arm_logs():
    sets = [parent.parent / "shared" / "gap-real" / "frc_arms" for parent in Path(__file__).resolve().parents]
    return next((place for place in sets if place.is_dir()), None)


def runs_of(log, folder):
    """The four tests of a log as runs, by the mapping file."""
    rows, text = json.loads(log.read_text()), (FILES / "frc_arms_map.yaml").read_text()
    results = []
    for test in TESTS:
        mapping = folder / f"{test}.yaml"
        mapping.write_text(text.replace("TEST", test).replace("ROWS", str(len(rows[test]))))
        results += import_runs([str(log)], mapping, folder)
    return results


def feedforward_of(runs):
    """kS, kV, kA by least squares over logged velocity and its slope, as WPILib's analysis has them for an elevator."""
    columns, volts = [], []
    for clock in (read_record(run).fast for run in runs):
        speed = clock.values["velocity", "test"]
        moving = np.abs(speed) > 0.05 * np.abs(speed).max()
        slope = np.gradient(speed, clock.interval)
        columns.append(np.stack([np.sign(speed), speed, slope], axis=1)[moving])
        volts.append(clock.values["q_axis_voltage", "test"][moving])
    return np.linalg.lstsq(np.concatenate(columns), np.concatenate(volts), rcond=None)[0].tolist()


SPLITS = (0, 1, 2, 3), (0, 3), (0, 1, 3), (0, 2, 3)
"""Tests that are fitted, by their order in `TESTS`."""
QUICK = ("elbow_sysid_data20230222-162953", SPLITS[0])
MISSED_SPLITS = [("wrist_sysid_data20230306-172559", SPLITS[1]), ("wrist_sysid_data20230306-172559", SPLITS[2])]
MISSED = pytest.mark.xfail(
    strict=True, raises=AssertionError, reason="a friction over the angle takes a part of the weight"
)


@pytest.mark.parametrize(
    ("name", "fit"),
    [
        pytest.param(
            name,
            fit,
            marks=[
                *([] if (name, fit) == QUICK else [pytest.mark.long]),
                *([MISSED] if (name, fit) in MISSED_SPLITS else []),
            ],
        )
        for name in PUBLISHED
        for fit in SPLITS
    ],
)
def test_a_real_arm_s_weight_is_named_first_as_published(tmp_path, name, fit):
    """All tests with stretches held out, or whole tests held out; without the slow ramp up no fit tells a wrist's."""
    folder = arm_logs()
    if folder is None:
        pytest.skip("the frc_arms recordings (../shared/gap-real) are not on this machine")
    runs = runs_of(folder / f"{name}.json", tmp_path)
    kS, kV, kA = feedforward_of(runs)  # noqa: N806 (WPILib's names)
    model = tmp_path / "model.yaml"
    model.write_text(f"name: {name}\nfeedforward: {{kS: {kS:.6g}, kV: {kV:.6g}, kA: {kA:.6g}}}\n")
    held_out = [run for index, run in enumerate(runs) if index not in fit]
    diagnosis = diagnose(read_case([runs[index] for index in fit], held_out, model))
    machine = [cause for cause in diagnosis.causes if cause.effect != "velocity_filter_lag"]
    first = machine[0]
    assert first.effect == "gravity_load"
    assert first.probability > 0.9
    amplitude, units = parameters_of(first)["amplitude"]
    assert units == "V"
    assert amplitude == pytest.approx(PUBLISHED[name], rel=0.1)
    if fit == SPLITS[0]:  # two of the other splits tell friction over the angle as well, which loaded gears may have
        assert set(named(diagnosis)) <= {"gravity_load", "unbalance", "velocity_filter_lag"}
