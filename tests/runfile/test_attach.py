"""Foreign records in run files: what is stored, what stays as it was, what is refused, at the command line."""

import json

import h5py
import numpy as np
import pytest
import xarray
import yaml
from leactl_plugins.thermal_csv.emulator import series

from leactl import yamlfile
from leactl.bench.records import RecordDevice
from leactl.errors import InputError
from leactl.quantities import ChannelSpec
from leactl.runfile import layout
from leactl.runfile.attach import attach as attach_record
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runfile.write.writer import RunWriter
from leactl.tables.writing import TableDialect
from tests.cli.terminal import leactl

from .specimen import info, unseal

LOOP = [ChannelSpec("iq", "q_axis_current", "test", "drive"), ChannelSpec("idc", "line_current", "test", "supply")]
REGIONS = {"active_1": {"column": "R1 Avg", "quantity": "winding_temperature"}}
TIME = np.arange(0, 60, 0.05)
CURRENT = np.where(TIME > 20.02, 9.0, 0.0)


def device(clock=None, **settings):
    given = {"regions": REGIONS, "time": {"column": "Time"}, **settings}
    given |= {"clock": clock} if clock else {}
    return {"driver": "thermal_csv", "role": "test", "settings": given}


@pytest.fixture
def bench(tmp_path):
    def write(clock=None, name="camera", **settings):
        path = tmp_path / "bench.yaml"
        path.write_text(yaml.safe_dump({"devices": {name: device(clock, **settings)}}, sort_keys=False))
        return path

    return write


@pytest.fixture
def run(tmp_path):
    """A run of a minute whose current jumps at 20.02 s; created at 10:15:30 UTC."""
    with RunWriter(tmp_path, info("heated-run"), {"loop": LOOP}) as writer:
        writer.append("loop", TIME, np.stack([CURRENT, CURRENT], axis=1))
        writer.event(1.0, "info", "runner", "heat")
    return writer.path


@pytest.fixture
def export(tmp_path):
    """Write an export of `frames` of a camera whose clock shows `start` at the run's 2.5 s."""

    def write(stamp, frames=1500, begins=2.5, name="camera.csv", rate=30.0):
        seen = begins + np.arange(frames) / rate
        rises = np.clip(seen - 20.02, 0, None)
        noise = 0.02 * np.random.default_rng(0).normal(size=frames)
        celsius = 25 + 1.8 * rises * np.exp(-rises / 12) + noise
        stamps = [stamp(k / rate) for k in range(frames)]
        path = tmp_path / name
        path.write_bytes(series(stamps, {"R1 Avg": list(celsius)}, TableDialect(delimiter=";")))
        return path

    return write


def elapsed(seconds):
    return f"{int(seconds // 3600):02d}:{int(seconds // 60 % 60):02d}:{seconds % 60:06.3f}"


def of_day(seconds):
    return (
        f"2026-11-20T10:15:{32.5 + seconds:06.3f}Z" if seconds < 27.5 else f"2026-11-20T10:16:{seconds - 27.5:06.3f}Z"
    )


def everything(path):
    with h5py.File(path, "r") as file:
        return {place: layout.digest(item) for place, item in layout.datasets(file) if "camera" not in place}


def joined(run, file, bench, name="camera"):
    """Read and tie a record; the device and what it gives."""
    device = RecordDevice(yamlfile.load(bench), name)
    return device, device.join(device.read([file]), run)


def attach(run, file, bench, name="camera", replace=False):
    device, found = joined(run, file, bench, name)
    device.attach(found, run, replace)
    return found


def at_the_shell(run, file, bench, *options):
    return leactl("runs", "attach", run, file, "--device", "camera", "--bench", bench, *options)


def test_a_given_offset_puts_the_record_beside_what_the_run_holds(run, export, bench):
    before = everything(run)
    answer = at_the_shell(run, export(elapsed), bench({"offset_s": 2.5, "offset_within_s": 0.2}), "--json")
    assert answer.returncode == 0, answer.stderr
    document = json.loads(answer.stdout)
    assert (document["attached"], document["rows"], document["rows_left_out"]) == (True, 1500, 0)
    assert verify(run) == []
    after = everything(run)
    assert {place: after[place] for place in before} == before
    with Run.open(run) as opened:
        channel = opened.channel("winding_temperature", "test", "active_1")
        np.testing.assert_allclose(channel.time[[0, 30]], [2.5, 3.5], atol=1e-3)
        about = opened.attached("camera")
        assert about["alignment_uncertainty_s"] == pytest.approx(0.2, abs=0.01)
        assert about["record_files"] == "camera.csv"
        assert "degC" in about["record_told"]
        assert json.loads(about["record_settings"])["regions"]["active_1"]["column"] == "R1 Avg"
        assert opened.attached("loop") == {}
        assert "camera attached from camera.csv" in opened.notes[-1].text
    with xarray.open_dataset(run, engine="h5netcdf", group="streams/camera") as dataset:
        assert dataset["active_1"].attrs["units"] == "degC"
        assert dataset["active_1"].dims == ("time",)
    shown = leactl("runs", "show", run).stdout
    assert "stream camera: 1500 rows, attached from camera.csv, stamps good to 0.2 s (95 %) by a given offset" in shown


def test_settings_that_no_attribute_holds_are_refused_and_the_run_stays(run, export, bench):
    before = run.read_bytes()
    _device, aligned = joined(run, export(elapsed), bench({"offset_s": 2.5, "offset_within_s": 0.2}))
    with pytest.raises(InputError, match=r"settings of thermal_csv: \d+ bytes as JSON; 8000 at most were expected"):
        attach_record(run, aligned, {"note": "ä" * 5000}, "thermal_csv")
    assert run.read_bytes() == before


def test_the_stamps_can_be_had_back(run, export, bench):
    attach(run, export(elapsed), bench({"onset": {"channel": "active_1", "against": "loop/idc", "jump": 4.0}}))
    with Run.open(run) as opened:
        about, time = opened.attached("camera"), opened.time("camera")
    own = (time - about["alignment_offset_s"]) / about["alignment_rate"]
    np.testing.assert_allclose(own, np.round(np.arange(1500) / 30.0, 3), atol=1e-6)


def test_wall_clocks_tie_within_what_is_stated_and_what_they_resolve(run, export, bench):
    # the run's `created` has whole seconds: its start lies up to 1.2 s later, on the average 0.6 s
    _, found = joined(run, export(of_day), bench({"wall_within_s": 0.3}))
    assert found.alignment.offset == pytest.approx(2.5 - 0.6, abs=0.01)
    assert found.uncertainty == pytest.approx(0.3 + 0.6, abs=0.01)


def test_an_onset_ties_what_wall_clocks_only_bring_near(run, export, bench):
    clock = {"onset": {"channel": "active_1", "against": "loop/idc", "jump": 4.0}, "drift_within_ppm": 50.0}
    _, found = joined(run, export(of_day), bench(clock))
    assert found.alignment.offset == pytest.approx(2.5, abs=found.uncertainty)
    assert found.uncertainty < 0.15
    assert found.alignment.ties == 1


def test_check_tells_and_changes_nothing(run, export, bench):
    before = run.read_bytes()
    answer = at_the_shell(run, export(elapsed), bench({"offset_s": 2.5, "offset_within_s": 0.2}), "--check")
    assert answer.returncode == 0
    assert "utf-8, ';' between cells" in answer.stdout
    assert "stamps are good to 0.2 s (95 %)" in answer.stdout
    assert run.read_bytes() == before


def test_rows_outside_the_run_are_left_out_and_told(run, export, bench):
    result = attach(run, export(elapsed, frames=2400), bench({"offset_s": -10.0, "offset_within_s": 0.2}))
    assert "1799 rows, 0 to 59.933 s of the run; 601 rows outside" in result.summary_lines()[-1]  # of -10 to 70 s
    with Run.open(run) as opened:
        assert opened.rows["camera"] == 1799
        assert opened.time("camera")[0] >= 0.0
        assert opened.time("camera")[-1] <= TIME[-1]


def test_a_second_record_needs_replace_and_a_recorded_stream_never_gives_way(run, export, bench):
    given = bench({"offset_s": 2.5, "offset_within_s": 0.2})
    attach(run, export(elapsed), given)
    with pytest.raises(InputError, match=r"stream camera is attached already, from camera\.csv; --replace puts"):
        attach(run, export(elapsed), given)
    attach(run, export(elapsed, frames=900), given, replace=True)
    with Run.open(run) as opened:
        assert opened.rows["camera"] == 900
        assert len(opened.notes) == 2
    assert verify(run) == []
    other = bench({"offset_s": 2.5, "offset_within_s": 0.2}, name="second")
    with pytest.raises(InputError, match="second/active_1: same quantity, role and location as camera/active_1"):
        attach(run, export(elapsed), other, name="second")
    loop = bench({"offset_s": 2.5, "offset_within_s": 0.2}, name="loop")
    with pytest.raises(InputError, match="stream loop was recorded with the run and stays"):
        attach(run, export(elapsed), loop, name="loop", replace=True)


def test_a_foreign_run_without_checksums_gets_none(run, export, bench):
    with h5py.File(run, "r+") as file:
        for _, dataset in layout.datasets(file):
            del dataset.attrs["sha256"]
        unseal(file)
    attach(run, export(elapsed), bench({"offset_s": 2.5, "offset_within_s": 0.2}))
    assert [finding for finding in verify(run) if "streams" in finding] == []


@pytest.mark.parametrize(
    ("clock", "stamp", "words"),
    [
        (None, elapsed, "devices.camera.settings.clock: is missing: wall_within_s, offset_s, estimate or onset"),
        ({"wall_within_s": 0.5}, elapsed, "its clock tells no day or no zone; set time.date and time.zone"),
        (
            {"offset_s": 500.0, "offset_within_s": 1.0},
            elapsed,
            "a record of another time: on the run's clock it goes from 500 to",
        ),
        (
            {"wall_within_s": 0.5},
            lambda s: f"2025-11-20T10:15:{s:06.3f}Z" if s < 60 else "x",
            "a record of another time",
        ),
        (
            {"estimate": {"channel": "active_1", "against": "loop/nothing"}},
            elapsed,
            "no channel loop/nothing; the run has loop/iq",
        ),
        (
            {"estimate": {"channel": "cold", "against": "loop/idc"}},
            elapsed,
            "the record has no channel 'cold'; it has active_1",
        ),
        (
            {"onset": {"channel": "active_1", "against": "loop/idc", "jump": 90.0}},
            elapsed,
            "shows no onset within 60 s of a jump",
        ),
        ({"offset_s": 1.0}, elapsed, "bench.yaml:.*clock: offset_s and offset_within_s go together"),
    ],
)
def test_clocks_that_cannot_be_tied_are_refused_and_the_run_stays(run, export, bench, clock, stamp, words):
    before = run.read_bytes()
    with pytest.raises(InputError, match=words) as refused:
        attach(run, export(stamp), bench(clock))
    assert len(refused.value.faults) == 1
    assert run.read_bytes() == before


SUPPLY = {"model": "1688B", "feeds": "leads", "voltage_limit_V": 10, "current_limit_A": 10}


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"driver": "ads1115", "role": "test", "settings": {}}, "settings.inputs: is required and missing"),
        ({"driver": "thermal_cvs", "role": "test"}, "driver 'thermal_cvs' is not registered"),
        ({"driver": "thermal_csv", "role": "test", "settings": {"regions": {}}}, "regions"),
        ({"driver": "bk1688b", "role": "test", "bus": "line", "settings": SUPPLY}, "its readings do not come in files"),
        (device(colour="red"), "bench.yaml:.*devices.camera.settings.colour: 'red': unknown key"),
    ],
)
def test_faults_of_the_map_are_told_with_their_place(run, export, tmp_path, entry, words):
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump({"devices": {"camera": entry}}, sort_keys=False))
    with pytest.raises(InputError, match=words):
        attach(run, export(elapsed), path)
    with pytest.raises(InputError, match="no device 'other'; the file has camera"):
        attach(run, export(elapsed), path, name="other")


def test_a_run_that_keeps_no_map_asks_for_one_in_one_line(run, export):
    answer = leactl("runs", "attach", run, export(elapsed), "--device", "camera")
    assert answer.returncode == 2
    assert answer.stderr.startswith(f"leactl: {run}: bench:")
    assert len(answer.stderr.splitlines()) == 1


def test_an_altered_run_takes_no_record(run, export, bench):
    with h5py.File(run, "r+") as file:
        file["streams/loop/iq"][3] = 77.0
    with pytest.raises(InputError, match="/streams/loop/iq: checksum mismatch"):
        attach(run, export(elapsed), bench({"offset_s": 2.5, "offset_within_s": 0.2}))
    with h5py.File(run, "r") as file:
        assert "camera" not in file["streams"]
