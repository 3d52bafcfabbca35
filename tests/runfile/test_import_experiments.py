"""Experiments beyond friction on imported recordings, by each way to find steps, against the run's own analysis."""

import json

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from leactl.runfile.read.reader import Run

from .test_import_steps import answered, imported, results

TORQUE_CONSTANT = """
mechanical: coupled
run: {protocol: torque-constant, actuator: a1}
streams:
  loop:
    records: streams.loop
    time: {column: time}
    channels:
      iq_ref: {column: test_iq_ref.values, quantity: q_axis_current_reference}
      iq: {column: test_iq.values, quantity: q_axis_current}
  sensor:
    records: streams.torque_sensor
    time: {column: time}
    channels: {torque: {column: torque.values, quantity: torque}}
steps_by_holds: {channel: loop/iq_ref, parameter: current_A, least_s: 0.9, settle_s: 0.5}
"""
BACK_DRIVE = """
mechanical: coupled
run: {protocol: back-drive, actuator: a1}
streams:
  loop:
    records: streams.loop
    time: {column: time}
    channels:
      load_ref: {column: load_omega_ref.values, quantity: velocity_reference, role: load}
      load_omega: {column: load_omega.values, quantity: velocity, role: load}
      omega: {column: test_omega.values, quantity: velocity}
      theta: {column: test_theta.values, quantity: angle}
  sensor:
    records: streams.torque_sensor
    time: {column: time}
    channels: {torque: {column: torque.values, quantity: torque}}
"""
BY_COLUMN = """
steps_by_column:
  stream: loop
  column: phase
  names: {1: hold, 2: turn, 3: breakaway}
  settle_s: 0.5
  parameters: {velocity_rad_s: loop/load_ref, role: load}
"""
BY_HOLDS = """
steps_by_holds:
  {channel: loop/CHANNEL, parameter: velocity_rad_s, least_s: 0.95, settle_s: 0.5, parameters: {role: load}}
"""


@pytest.fixture(scope="module")
def back_drive(tmp_path_factory):
    """A short run of the emulated bench, its MAT file with a column that tells its steps, and the run's results."""
    here = tmp_path_factory.mktemp("back-drive")
    chosen = {"hold_s": 1, "settle_s": 0.5, "turn_s": 0.6, "breakaway_s": 3, "trials": 2}
    settings = [word for name, value in chosen.items() for word in ("--set", f"{name}={value}")]
    run = answered("run", "back-drive", *settings, "--out", here)["run"]
    answered("runs", "export", run, "--format", "mat", "--out", here / "mat")
    [source] = (here / "mat").glob("*.mat")
    tree = loadmat(source, simplify_cells=True)
    with Run.open(run) as opened:
        steps = opened.steps
    time = tree["streams"]["loop"]["time"]
    tree["streams"]["loop"]["phase"] = np.zeros(len(time))
    for step in steps:
        label = {"hold": 1, "turn": 2, "breakaway": 3}.get(step.name, 0)
        tree["streams"]["loop"]["phase"][(time >= step.start) & (time < step.stop)] = label
    savemat(source, {name: tree[name] for name in tree if not name.startswith("__")})
    lines = [
        f"  - {{name: {step.name}, start_s: {step.start}, stop_s: {step.stop}, settle_s: {step.settle},"
        f" parameters: {json.dumps(step.parameters)}}}"
        for step in steps
        if step.name in ("hold", "turn", "breakaway")
    ]
    return here, source, "\n".join(["steps:", *lines, ""]), results(run, "back-drive")


@pytest.mark.parametrize("way", ["instants", "column", "holds of the setpoint", "holds of the reading"])
def test_back_drive_of_an_imported_matrix_is_that_of_the_run(back_drive, way):
    here, source, instants, expected = back_drive
    steps = {
        "instants": instants,
        "column": BY_COLUMN,
        "holds of the setpoint": BY_HOLDS.replace("CHANNEL", "load_ref"),
        # a reading holds its level from where it has settled on
        "holds of the reading": BY_HOLDS.replace("CHANNEL", "load_omega")
        .replace("0.95", "0.45")
        .replace("0.5,", "0.1,"),
    }[way]
    result = results(imported(here, source, BACK_DRIVE + steps), "back-drive")
    for name in ("coulomb_friction", "viscous_damping", "quadratic_drag"):
        assert abs(result[name]["value"] - expected[name]["value"]) < expected[name]["std"]
    if not way.startswith("holds"):
        assert result["breakaway_torque"]["value"] == pytest.approx(expected["breakaway_torque"]["value"], rel=1e-3)


@pytest.fixture(scope="module")
def torque_constant(tmp_path_factory):
    """The MAT file of a short run of the emulated bench, and the run's results."""
    here = tmp_path_factory.mktemp("torque-constant")
    chosen = ("--set", "hold_s=1", "--set", "rest_s=3", "--set", "trials=2", "--out", here)
    run = answered("run", "torque-constant", *chosen)["run"]
    answered("runs", "export", run, "--format", "mat", "--out", here / "mat")
    [source] = (here / "mat").glob("*.mat")
    return here, source, results(run, "torque-constant")["torque_constant"]


def test_torque_constant_of_an_imported_matrix_is_that_of_the_run(torque_constant):
    here, source, expected = torque_constant
    result = results(imported(here, source, TORQUE_CONSTANT), "torque-constant")["torque_constant"]
    assert abs(result["value"] - expected["value"]) < 2.0 * expected["std"]


def test_the_uncertainty_of_an_instrument_s_scale_is_part_of_an_imported_result(torque_constant):
    here, source, _ = torque_constant
    known = TORQUE_CONSTANT.replace("quantity: torque}", "quantity: torque, scale_std: 0.03}")
    known = known.replace("quantity: q_axis_current}", "quantity: q_axis_current, scale_std: 0.01}")
    before, after = (
        results(imported(here, source, mapping), "torque-constant")["torque_constant"]
        for mapping in (TORQUE_CONSTANT, known)
    )
    assert after["value"] == before["value"]
    assert after["std"] == pytest.approx(np.hypot(np.hypot(0.03, 0.01) * before["value"], before["std"]), rel=1e-3)
