"""`leactl gap simulate`, `compare` and `effects` at the command line."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
import yaml

from leactl.effects import library
from leactl.gap.replay import replay
from leactl.gap.signals.record import read_record
from leactl.gap.verdict.notes import condition_notes
from leactl.model.nominal import as_mapping, read_model
from leactl.quantities import ChannelSpec
from leactl.runfile.read.reader import Run
from leactl.runfile.write.run_info import RunInfo
from leactl.runfile.write.writer import RunWriter
from tests.cli.terminal import leactl
from tests.gap.synthetic import model

LOOP = [
    ChannelSpec("iq_ref", "q_axis_current_reference", "test", "drive"),
    ChannelSpec("iq", "q_axis_current", "test", "drive", sampling="mean"),
    ChannelSpec("theta", "angle", "test", "drive", dtype="f8"),
    ChannelSpec("omega", "velocity", "test", "drive"),
    ChannelSpec("d", "d_axis_current", "test", "drive"),
]
DAQ = [ChannelSpec("torque", "torque", "test", "sensor")]


HEAD = RunInfo(
    run_id="20261121T100000Z-staircase-0001",
    protocol="staircase",
    bench="bench-1",
    actuator="lea-1",
    condition="design",
    operator="someone",
    simulated=False,
    mechanical="locked",
    software="elsewhere",
    created="2026-11-21T10:00:00Z",
    sources={"protocol": "name: staircase\n"},
    setup={"drive_gain": 2.0},
)


@pytest.fixture
def run(tmp_path):
    time = 0.001 * np.arange(3000)
    reference = 10.0 * (time > 1.0)
    writer = RunWriter(tmp_path, HEAD, {"loop": LOOP, "daq": DAQ})
    none = np.zeros_like(time)
    writer.append("loop", time, np.stack([reference, reference, none, none, none], axis=1))
    writer.append("daq", time[::2] + 2e-4, 0.49 * reference[::2, None])
    writer.step("level", 1.0, 3.0, 0.5, {"current_A": 10.0})
    writer.close("complete")
    return writer.path


@pytest.fixture
def model_file(tmp_path):
    return written(tmp_path / "model.yaml", model(("saturation", {"loss": 0.1})))


def written(path, content):
    path.write_text(yaml.safe_dump(as_mapping(content)))
    return path


def test_a_simulated_run_has_the_channels_and_clocks_of_the_measured_one(run, model_file, tmp_path):
    out = tmp_path / "simulated.h5"
    answer = leactl("gap", "simulate", model_file, run, "--out", out, "--json")
    assert answer.returncode == 0, answer.stderr
    document = json.loads(answer.stdout)
    assert document["run"] == str(out)
    assert "torque of test" in document["simulated"]
    assert document["left_out"] == ["d_axis_current of test"]
    with Run.open(run) as before, Run.open(out) as after:
        assert after.attributes["simulated"] == 1
        assert after.mechanical == "locked"
        assert after.setup["drive_gain"] == 2.0
        assert after.source("model") == model_file.read_text()
        assert after.source("protocol") == "name: staircase\n"
        assert after.steps == before.steps
        for stream in ("loop", "daq"):
            assert np.array_equal(after.time(stream), before.time(stream))
        reference = after.channel("q_axis_current_reference").values
        assert np.array_equal(reference, before.channel("q_axis_current_reference").values)
        level = after.channel("torque").values[-100:]
    assert level == pytest.approx(0.49 * 10.0 * (1 - 0.1 * 0.16), abs=0.21)
    assert leactl("runs", "verify", out).returncode == 0
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_a_stretch_without_its_input_is_told_and_not_simulated(tmp_path, model_file):
    time = 0.001 * np.arange(3000)
    drive = 5.0 * np.sin(6.0 * time)
    missing = (time > 0.9) & (time < 1.4)
    paths = []
    for name, spoilt in (("whole", False), ("spoilt", True)):
        given = np.where(missing & spoilt, np.nan, drive)
        given[50] = np.nan  # one sample alone is bridged
        info = replace(HEAD, run_id=f"20261121T100000Z-friction-{name}", mechanical="free")
        with RunWriter(tmp_path, info, {"loop": LOOP[:1] + LOOP[2:4]}) as writer:
            writer.append("loop", time, np.stack([given, np.sin(time), np.cos(time)], axis=1))
        paths.append(writer.path)
    answers = [leactl("gap", "simulate", model_file, path, "--out", tmp_path / f"{path.stem}-sim.h5") for path in paths]
    assert "is missing" not in answers[0].stderr + answers[0].stdout
    note = "q_axis_current_reference of test is missing from 0.9"
    assert note in answers[1].stderr + answers[1].stdout
    whole, spoilt = (Run.open(tmp_path / f"{path.stem}-sim.h5") for path in paths)
    with whole, spoilt:
        speeds = [run.channel("velocity").values for run in (whole, spoilt)]
        assert np.isfinite(speeds[0][time > 0.5]).all()
        assert np.isnan(speeds[1][missing]).all()
        np.testing.assert_array_equal(speeds[1][time < 0.89], speeds[0][time < 0.89])
        np.testing.assert_allclose(speeds[1][time > 2.1], speeds[0][time > 2.1], rtol=0.01)
    answer = leactl(
        "gap", "compare", tmp_path / f"{paths[0].stem}-sim.h5", tmp_path / f"{paths[1].stem}-sim.h5", "--json"
    )
    (of_speed,) = (each for each in json.loads(answer.stdout)["channels"] if each["quantity"] == "velocity")
    common = np.isfinite(speeds[0]) & np.isfinite(speeds[1])
    assert abs(of_speed["samples"] - common.sum()) <= 4  # rows beside the stretch are within reach


def test_by_default_it_stands_beside_the_run_under_a_name_of_its_own(run, model_file):
    answer = leactl("gap", "simulate", model_file, run)
    assert answer.returncode == 0, answer.stderr
    with h5py.File(answer.stdout.strip()) as file:
        assert file.attrs["run_id"].endswith(answer.stdout.strip().rsplit("/", 1)[1].removesuffix(".h5"))
    assert len(list(run.parent.glob("*.h5"))) == 2


def test_nothing_is_overwritten(run, model_file):
    answer = leactl("gap", "simulate", model_file, run, "--out", run)
    assert answer.returncode == 2
    assert answer.stderr.count("\n") == 1
    assert "never overwritten" in answer.stderr


def test_a_model_that_says_nothing_of_the_run_is_one_clear_line(run, tmp_path):
    bare = tmp_path / "bare.yaml"
    bare.write_text("name: bare\n")
    answer = leactl("gap", "simulate", bare, run)
    assert answer.returncode == 2
    assert answer.stderr.count("\n") == 1
    assert "rotor_inertia" in answer.stderr


def test_an_effect_without_its_parameter_is_one_clear_line(run, tmp_path):
    part = written(tmp_path / "part.yaml", model(("cogging", {"amplitude": 0.1, "order": 6.0})))
    answer = leactl("gap", "simulate", part, run)
    assert answer.returncode == 2
    assert answer.stderr.count("\n") == 1
    assert "cogging has no 'phase'" in answer.stderr


def test_an_augmented_model_file_comes_back_as_it_was(run, model_file, tmp_path):
    first, _ = read_model(model_file)
    again, _ = read_model(written(tmp_path / "again.yaml", first))
    assert again == first
    record = read_record(run)
    one, other = replay(record, first), replay(record, again)
    assert np.array_equal(one.fast["torque", "test"], other.fast["torque", "test"], equal_nan=True)


def test_compare_measures_each_channel(run, model_file, tmp_path):
    out = tmp_path / "simulated.h5"
    assert leactl("gap", "simulate", model_file, run, "--out", out).returncode == 0
    answer = leactl("gap", "compare", run, out, "--json")
    assert answer.returncode == 0, answer.stderr
    results = {channel["quantity"]: channel for channel in json.loads(answer.stdout)["channels"]}
    assert results["q_axis_current_reference"]["rms"] == 0.0
    assert results["q_axis_current_reference"]["correlation"] == pytest.approx(1.0)
    assert results["torque"]["units"] == "N*m"
    assert 0.0 < results["torque"]["rms"] < 0.5
    assert results["torque"]["lag_s"] == pytest.approx(0.0, abs=0.005)
    text = leactl("gap", "compare", run, out)
    assert text.returncode == 0
    assert "test torque" in text.stdout


def test_a_lag_is_found(tmp_path):
    paths = []
    for index, late in enumerate((0.0, 0.02)):
        info = RunInfo(f"run-{index}", "p", "b", "a", "c", "", False, "free", "x", "2026-11-21T10:00:00Z")
        time = 0.001 * np.arange(2000)
        writer = RunWriter(tmp_path, info, {"loop": [ChannelSpec("omega", "velocity", "test", "drive")]})
        writer.append("loop", time, np.sin(20 * (time - late) ** 2)[:, None])
        writer.close("complete")
        paths.append(writer.path)
    result = json.loads(leactl("gap", "compare", *paths, "--json").stdout)["channels"][0]
    assert result["lag_s"] == pytest.approx(0.02)


def test_runs_without_a_channel_in_common_are_one_clear_line(run, tmp_path):
    info = RunInfo("other", "p", "b", "a", "c", "", False, "free", "x", "2026-11-21T10:00:00Z")
    with RunWriter(tmp_path, info, {"loop": [ChannelSpec("u", "bus_voltage", "bench", "supply")]}) as writer:
        writer.append("loop", 0.01 * np.arange(20), np.ones((20, 1)))
    answer = leactl("gap", "compare", run, writer.path)
    assert answer.returncode == 2
    assert answer.stderr.count("\n") == 1


@pytest.mark.parametrize("file", ["missing.h5", "text.h5"])
def test_what_is_no_run_file_is_one_clear_line(file, model_file, tmp_path):
    (tmp_path / "text.h5").write_text("no run")
    for command in (("simulate", model_file), ("compare", tmp_path / file)):
        answer = leactl("gap", *command, tmp_path / file)
        assert answer.returncode == 2
        assert answer.stderr.count("\n") == 1


def test_an_effect_is_explained_with_equation_units_and_ranges():
    text = leactl("gap", "effects", "quadratic_drag").stdout
    assert "c w |w|" in text
    assert "[1e-05 to 0.001 N*m*s^2/rad^2]" in text
    about = json.loads(leactl("gap", "effects", "quadratic_drag", "--json").stdout)
    assert about["parameters"][0]["units"] == "N*m*s^2/rad^2"
    assert all(about[key] for key in ("meaning", "equation", "shows_in", "confused_with", "shown_by"))


def test_all_effects_are_listed_and_explained():
    listed = leactl("gap", "effects").stdout
    everything = json.loads(leactl("gap", "effects", "--json").stdout)["effects"]
    assert [item["effect"] for item in everything] == list(library())
    assert all(name in listed for name in library())


def test_faults_of_a_set_up_are_listed_and_explained():
    everything = json.loads(leactl("gap", "effects", "--json").stdout)["setup_faults"]
    listed = leactl("gap", "effects").stdout
    assert {"channel_sign", "channel_scale", "frozen_channel"} <= {item["effect"] for item in everything}
    assert all(item["family"] == "setup" and item["meaning"] in " ".join(listed.split()) for item in everything)
    assert "ammeter" in leactl("gap", "effects", "channel_scale").stdout


def test_an_unknown_effect_is_one_clear_line():
    answer = leactl("gap", "effects", "gremlins")
    assert answer.returncode == 2
    assert answer.stderr.startswith("leactl: effect 'gremlins' is not known; known: ")


def test_json_of_a_diagnosis_goes_to_stdout_or_to_a_file(run, model_file, tmp_path):
    out = tmp_path / "answer.json"
    fixed = ("gap", "diagnose", "--model", model_file)
    written_to_file = leactl(*fixed, run, "--json", out)
    assert written_to_file.returncode == 0, written_to_file.stderr
    assert "verdict" in written_to_file.stdout
    answer = json.loads(out.read_text())
    for words in ((*fixed, run, "--json"), (*fixed, "--json", run), (*fixed[:2], run, "--json", *fixed[2:])):
        assert json.loads(leactl(*words).stdout) == answer
    assert json.loads(leactl(*fixed, run, "--json", "-").stdout) == answer


def test_a_held_out_run_of_another_condition_is_noted(run, model_file, tmp_path):
    other = tmp_path / "other.h5"
    other.write_bytes(run.read_bytes())
    for condition, notes in (("design", 0), ("unloaded", 1)):
        learnt = read_record(run)
        judged = replace(read_record(other), condition=condition)
        noted = condition_notes([learnt], [judged])
        assert len(noted) == notes
    assert noted == ("staircase: condition of fitted runs: design; of held-out runs: unloaded",)
