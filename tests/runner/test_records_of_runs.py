"""Devices that leave files behind, on the emulated bench: their exports join the run at its end."""

import hashlib
import os

import numpy as np
import pytest
import yaml
from leactl_plugins.thermal_csv.emulator import LEAD_S

from leactl.bench import benchfile
from leactl.driver.file_records import ExportFolder
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from tests.runner.conftest import SPIN

STEPS = """
name: steps
setup: free
rate_Hz: 100
steps:
  - mode: {test: current}
  - hold: {role: test, current_A: 1.0, duration_s: 1.3}
  - hold: {role: test, current_A: 0.7, duration_s: 0.9}
  - hold: {role: test, current_A: 0.9, duration_s: 1.1}
  - hold: {role: test, current_A: 0.6, duration_s: 2.0}
  - mode: {test: "off"}
"""
SIGNALS = {
    "current": {"column": "Active Current", "quantity": "q_axis_current"},
    "velocity": {"column": "Velocity", "quantity": "velocity"},
    "angle": {"column": "Position", "quantity": "angle"},
    "bus": {"column": "DC Bus Voltage", "quantity": "bus_voltage"},
}
REGIONS = {
    "active_1": {"column": "ROI 1 Avg", "quantity": "winding_temperature"},
    "housing_1": {"column": "ROI 2 Avg", "quantity": "housing_temperature"},
}


def bench_with(tmp_path, **devices):
    text = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
    text["devices"] |= devices
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(text, sort_keys=False))
    return str(path)


def camera(tmp_path, **settings):
    given = {"regions": REGIONS, "time": {"column": "Time"}, "exports_folder": str(tmp_path / "camera")} | settings
    return {"driver": "thermal_csv", "role": "test", "settings": given}


def recorder(tmp_path, against="loop/test_omega"):
    settings = {
        "signals": SIGNALS,
        "time_column": "Time",
        "counts_per_turn": 40000,
        "exports_folder": str(tmp_path / "recorder"),
        "clock": {"estimate": {"channel": "velocity", "against": against, "within_s": 3.0}},
    }
    return {"driver": "elmo_recorder_csv", "role": "test", "settings": settings}


def test_the_drives_recording_joins_the_run_where_it_was_made(spin, tmp_path):
    outcome, _ = spin(STEPS, bench=bench_with(tmp_path, recorder=recorder(tmp_path)))
    assert not outcome.notes, "\n".join(outcome.notes)
    assert verify(outcome.path) == []
    with Run.open(outcome.path) as run:
        about = run.attached("recorder")
        # the recorder is triggered half a second after the bench was made, which is when the run begins
        assert about["alignment_offset_s"] == pytest.approx(0.5, abs=about["alignment_uncertainty_s"])
        assert about["alignment_uncertainty_s"] < 0.01
        fine, coarse = run.channel("velocity", "test", "recorder"), run.channel("velocity", "test", "")
        difference = fine.values - np.interp(fine.time, coarse.time, coarse.values)
        assert np.std(difference[500:]) < 0.05
        assert np.median(np.diff(fine.time)) == pytest.approx(1e-3, rel=1e-3)


def test_a_camera_looks_at_the_actuator_and_its_export_joins(spin, tmp_path):
    clock = {"offset_s": -LEAD_S, "offset_within_s": 0.5}
    bench = bench_with(tmp_path, camera=camera(tmp_path, clock=clock, decimal=",", delimiter=";", unit="degF"))
    outcome, _ = spin(SPIN.replace("$hold_s", "3.0"), bench=bench)
    assert not outcome.notes, "\n".join(outcome.notes)
    with Run.open(outcome.path) as run:
        winding = run.channel("winding_temperature", "test", "active_1")
        assert np.median(np.diff(winding.time)) == pytest.approx(1 / 30, abs=1e-3)
        assert np.nanmean(winding.values) == pytest.approx(25.0, abs=1.0)
        assert run.channel("housing_temperature", "test", "housing_1").stream == "camera"


def test_a_record_that_cannot_join_is_told_and_the_run_is_whole(spin, tmp_path):
    bench = bench_with(tmp_path, camera=camera(tmp_path), recorder=recorder(tmp_path, "loop/test_torque"))
    outcome, _ = spin(SPIN.replace("$hold_s", "3.0"), bench=bench)
    assert (outcome.status, verify(outcome.path)) == ("complete", [])
    told = "\n".join(outcome.notes)
    assert "camera: its record is not in the run:" in told
    assert "settings.clock: is missing" in told
    assert "recorder: its record is not in the run: no export has come into" in told
    assert "leactl runs attach" in told


def test_every_emulated_run_has_a_folder_of_its_own_below_the_one_that_is_set(spin, tmp_path):
    clock = {"offset_s": -LEAD_S, "offset_within_s": 0.5}
    for folder in ("camera", str(tmp_path / "elsewhere")):  # the first where the runs lie
        bench = bench_with(tmp_path, camera=camera(tmp_path, clock=clock, exports_folder=folder))
        for _ in range(2):
            outcome, _bench = spin(SPIN.replace("$hold_s", "2.0"), bench=bench)
            assert not outcome.notes, "\n".join(outcome.notes)
            (export,) = (outcome.path.parent / folder / outcome.path.stem).iterdir()
            with Run.open(outcome.path) as run:
                assert run.attached("camera")["record_sha256"] == hashlib.sha256(export.read_bytes()).hexdigest()


def test_files_that_were_there_before_a_run_are_not_taken_for_its_own(tmp_path):
    folder = ExportFolder(str(tmp_path))
    (tmp_path / "earlier.csv").write_text("1")
    (tmp_path / "goes_on.csv").write_text("1")
    os.utime(tmp_path / "goes_on.csv", (1.0, 1.0))
    folder.look()
    (tmp_path / "goes_on.csv").write_text("12")
    (tmp_path / "later.csv").write_text("1")
    assert [path.name for path in folder.fresh()] == ["goes_on.csv", "later.csv"]
