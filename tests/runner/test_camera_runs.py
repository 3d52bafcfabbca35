"""The paper's thermal experiment whole on the shipped emulated bench: supply, camera, and the fit of both."""

import csv
import hashlib
import json
import shutil
import subprocess

import numpy as np
import pytest
import yaml
from leactl_plugins.thermal_csv.driver import ThermalCsv
from leactl_plugins.thermal_csv.emulator import CLOCK_FAST_PPM, LEAD_S

from leactl.analysis.analyze import analyze_runs
from leactl.bench import benchfile
from leactl.errors import MissingChannel
from leactl.protocol import protocolfile
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from tests.cli.terminal import COMMAND, leactl

TRUE = {  # of the bench, by its motor file
    "winding_ambient_resistance": 5.6,
    "winding_housing_resistance": 0.3,
    "housing_ambient_resistance": 1.7,
    "winding_capacitance": 22.9,
    "housing_capacitance": 469.1,
    "parallel_thermal_resistance": 5.6 * 2.0 / 7.6,
    "line_resistance": 0.528,
    "resistance_coefficient": 0.004,
}
NOISE_K, GAIN, OFFSET_K = 0.1, 1.005, 0.5  # of a place, as the bench file has them
# of the mean of three places: 2/3 of active and 1/3 of inactive windings, and the housing
INJECTED_K = NOISE_K * np.sqrt((4 / 9 + 1 / 9 + 1) / 3 / 2)
SHORT = {"rest_s": 8, "heating_s": 12, "cooling_s": 8}


@pytest.fixture
def heated(spin):
    """Run `thermal`, shortened, on the shipped bench or another."""

    def run(bench="emulated-heated", at=(), **sets):
        text = protocolfile.locate("thermal").read_text()
        return spin(text, at=at, bench=bench, sets=[f"{k}={v}" for k, v in (SHORT | sets).items()], condition="")

    return run


def bench_with(tmp_path, **changes):
    bench = yaml.safe_load((benchfile.SHIPPED / "emulated-heated.yaml").read_text())
    bench["devices"]["camera"]["settings"] |= changes
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(bench, sort_keys=False))
    return str(path)


def test_the_export_is_on_the_runs_clock_and_shows_the_plant(heated):
    began, looks = [], []

    def watch(bench):
        def look(now):
            actuator = bench.rig.actuators["test"]
            parts = [bench.rig.part_of_winding("test", part) for part in ("active", "inactive")]
            looks.append((now, *parts, actuator.housing_temperature))
            if not began and "supply" in bench.far_ends and bench.rig.line_current:
                began.append(now)

        bench.time.follow(look)

    outcome, _bench = heated(at=[(0.0, watch)])
    assert not outcome.notes, "\n".join(outcome.notes)
    assert verify(outcome.path) == []
    true = np.array(looks).T
    with Run.open(outcome.path) as run:
        about = run.attached("camera")
        # the supply's clock is the bench's: its current jumps within a cycle and a reading of when it was switched on
        current = run.channel("line_current", "test")
        start = began[0] - current.time[np.flatnonzero(current.values)[0]]
        assert about["alignment_offset_s"] == pytest.approx(-LEAD_S - start, abs=about["alignment_uncertainty_s"])
        drift = 1e-6 * (CLOCK_FAST_PPM + about["alignment_drift_uncertainty_ppm"])
        assert about["alignment_rate"] == pytest.approx(1.0, abs=drift)
        assert about["alignment_uncertainty_s"] < 0.3
        for row, (quantity, place) in enumerate(
            (("winding_temperature", "active"), ("winding_temperature", "inactive"), ("housing_temperature", "housing"))
        ):
            seen = np.mean([run.channel(quantity, "test", f"{place}_{k}").values for k in (1, 2, 3)], axis=0)
            time = run.channel(quantity, "test", f"{place}_1").time + start
            expected = 25.0 + OFFSET_K + GAIN * (np.interp(time, true[0], true[row + 1]) - 25.0)
            still = np.abs(np.gradient(expected, time)) < 0.5  # K/s: a late stamp shows where it goes fast
            left = (seen - expected)[still]
            assert np.mean(left) == pytest.approx(0.0, abs=0.05)
            assert np.std(left) == pytest.approx(NOISE_K / np.sqrt(3), rel=0.3)
        air = run.channel("ambient_temperature", "test")
        assert np.mean(air.values) == pytest.approx(25.0 + OFFSET_K, abs=0.02)


def test_the_command_line_gives_the_fit_within_its_intervals(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    sets = [word for k, v in {"rest_s": 8, "heating_s": 120, "cooling_s": 30}.items() for word in ("--set", f"{k}={v}")]
    done = leactl("run", "thermal", "--bench", "emulated-heated", *sets, "--json")
    assert done.returncode == 0, done.stderr
    # how far it is shows once it takes a while
    assert [line for line in done.stderr.splitlines() if not line.startswith("thermal on emulated-heated: ")] == []
    path = json.loads(done.stdout)["run"]
    completed = leactl("analyze", path, "--json")
    assert completed.returncode == 0, completed.stderr
    results = {result["name"]: result for result in json.loads(completed.stdout)["results"]}
    for name in ("winding_ambient_resistance", "housing_ambient_resistance", "parallel_thermal_resistance"):
        assert results[name]["value"] is None, f"{name} after two minutes"
    for name, true in TRUE.items():
        if results[name]["value"] is not None:
            assert results[name]["low"] < true < results[name]["high"], name
    assert results["rmse"]["value"] < 1.05 * INJECTED_K


@pytest.mark.long
def test_the_whole_protocol_gives_every_figure(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    done = leactl("run", "thermal", "--bench", "emulated-heated", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    results = {result.name: result for result in analyze_runs([tmp_path / json.loads(done.stdout)["run"]]).results}
    for name, true in TRUE.items():
        assert results[name].low < true < results[name].high, name
    assert results["parallel_thermal_resistance"].value == pytest.approx(TRUE["parallel_thermal_resistance"], rel=0.02)
    assert results["housing_capacitance"].value == pytest.approx(469.1, rel=0.05)
    assert results["line_resistance"].value == pytest.approx(0.528, rel=0.005)
    assert results["rmse"].value < 1.05 * INJECTED_K


@pytest.mark.long
def test_two_runs_at_once_do_not_mix(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    sets = [word for name, value in SHORT.items() for word in ("--set", f"{name}={value}")]
    command = [*COMMAND, "run", "thermal", "--bench", "emulated-heated", *sets, "--json"]
    both = [
        subprocess.Popen([*command, "--set", f"seed={seed}"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for seed in (1, 2)
    ]
    digests = set()
    for process in both:
        out, err = process.communicate()
        assert (process.returncode, err) == (0, "")
        with Run.open(tmp_path / json.loads(out)["run"]) as run:
            (export,) = (tmp_path / "runs" / "camera" / run.path.stem).iterdir()
            digests.add(run.attached("camera")["record_sha256"])
            assert run.attached("camera")["record_sha256"] == hashlib.sha256(export.read_bytes()).hexdigest()
    assert len(digests) == 2


# -- what goes wrong with a camera is none of the run's business -------------------------------------------------------


def export_of(tmp_path):
    (export,) = (tmp_path / "runs" / "camera").glob("*/*.csv")
    return export


def test_an_export_that_is_gone_at_the_end_is_told_and_the_run_is_whole(heated, tmp_path):
    outcome, _bench = heated(at=[(20.0, lambda _bench: shutil.rmtree(export_of(tmp_path).parent))])
    assert (outcome.status, verify(outcome.path)) == ("complete", [])
    (told,) = outcome.notes
    folder = tmp_path / "runs" / "camera" / outcome.path.stem
    assert told.startswith(
        f"camera: its record is not in the run: no export has come into {folder}, which is no folder"
    )
    assert told.endswith(f"leactl runs attach {outcome.path} FILE --device camera")
    with pytest.raises(MissingChannel, match="no winding_temperature of test"):
        analyze_runs([outcome.path])


def test_a_wrong_folder_is_told_and_the_run_is_whole(heated, tmp_path):
    (tmp_path / "file").write_text("")
    outcome, _bench = heated(bench_with(tmp_path, exports_folder=str(tmp_path / "file")))
    assert (outcome.status, verify(outcome.path)) == ("complete", [])
    assert f"no export has come into {tmp_path / 'file' / outcome.path.stem}, which is no folder" in outcome.notes[0]


def test_missing_frames_are_told_and_stay_missing(heated, tmp_path):
    def lose(_bench):  # the shutter's correction, and a place that leaves the picture
        lines = export_of(tmp_path).read_text().splitlines(keepends=True)
        kept = [*lines[:300], *lines[345:]]
        cells = kept[-30].split(",")
        kept[-30] = ",".join([*cells[:2], "--", *cells[3:]])
        export_of(tmp_path).write_text("".join(kept), newline="")

    outcome, _bench = heated(at=[(14.5, lose)])
    assert not outcome.notes, "\n".join(outcome.notes)
    with Run.open(outcome.path) as run:
        assert "1 gaps, about 45 frames missing, the longest 1.534 s" in run.attached("camera")["record_told"]
        place = run.channel("winding_temperature", "test", "active_2")
        assert np.isnan(place.values).sum() == 1
        assert np.diff(place.time).max() == pytest.approx(46 / 30, abs=1e-3)
    with export_of(tmp_path).open(encoding="utf-8", newline="") as file:
        assert len(list(csv.reader(file))) > 700


def test_a_plug_in_that_fails_is_told_and_the_run_is_whole(heated, monkeypatch):
    monkeypatch.setattr(ThermalCsv, "read_files", lambda _self, paths: paths[99])
    outcome, _bench = heated()
    assert (outcome.status, outcome.error, verify(outcome.path)) == ("complete", None, [])
    assert outcome.notes[0].startswith("camera: its record is not in the run: list index out of range")


def test_what_another_program_writes_there_is_refused_and_told(heated, tmp_path):
    def strange(_bench):
        (export_of(tmp_path).parent / "notes.csv").write_text("Time;Remark\n1;windy\n")

    outcome, _bench = heated(at=[(14.5, strange)])
    assert (outcome.status, verify(outcome.path)) == ("complete", [])
    assert "notes.csv" in outcome.notes[0]
    with Run.open(outcome.path) as run:
        assert "camera" not in run.streams
