"""`leactl bench read, zero, jog` as a shell sees them: runs like any other, with every check, limit, latch and lock."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import yaml

from leactl.bench import benchfile
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from tests.cli.terminal import leactl
from tests.latches import trip_of

SAFE = {"drive_test": True, "drive_load": True, "torque_sensor": True}
ALL_SAFE = SAFE | {"daq": True}  # a reading opens what is there on demand too


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    return tmp_path


@pytest.fixture
def bench(here):
    """Write a bench file like the emulated one with these changes, watched by its limits alone."""

    def write(**blocks):
        content = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text()) | {"interlocks": {}}
        for name, changes in blocks.items():
            content[name] |= changes
        (here / "bench.yaml").write_text(yaml.safe_dump(content))
        return "bench.yaml"

    return write


def answered(*arguments, status=0):
    done = leactl("bench", *arguments, "--json")
    assert done.returncode == status, done.stderr
    return json.loads(done.stdout)


def safe(answer):
    return {name: device["confirmed"] for name, device in answer["safe"].items()}


def test_read_tells_every_channel_with_the_drives_off(bench):
    offset = {"name": "torque_sensor_offset", "offset": 0.25}
    answer = answered("read", bench(emulated={"effects": [offset]}), "--for", "1")
    assert (answer["status"], safe(answer)) == ("complete", ALL_SAFE)
    channels = {(item["quantity"], item["role"]): item for item in answer["channels"]}
    with Run.open(Path(answer["run"])) as run:
        every = {(spec.quantity, spec.role) for specs in run.streams.values() for spec in specs}
        assert verify(run.path) == []
        enabled = run.channel("drive_enabled", "test").values
    assert np.nanmax(enabled) == 0
    assert every - set(channels) == {
        (f"{quantity}_reference", role)
        for quantity in ("q_axis_current", "velocity", "angle")
        for role in ("test", "load")
        if (f"{quantity}_reference", role) in every
    }
    torque = channels["torque", "test"]
    assert (torque["unit"], torque["device"]) == ("N*m", "torque_sensor")
    assert torque["mean"] == pytest.approx(0.25, abs=4 * 0.004 / torque["samples"] ** 0.5)
    assert torque["standard_deviation"] == pytest.approx(0.004, rel=0.5)
    assert 0 <= torque["age_s"] < 0.04
    assert channels["bus_voltage", "test"]["mean"] == pytest.approx(29.6, abs=0.1)


def test_read_prints_a_line_a_channel():
    done = leactl("bench", "read", "--for", "0.5")
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0].split() == ["quantity", "role", "mean", "std", "unit", "age/s", "device"]
    (torque,) = [line.split() for line in lines if line.startswith("torque ")]
    assert (torque[1], torque[4], torque[6]) == ("test", "N*m", "torque_sensor")


def test_a_reading_past_a_limit_trips_and_latches(bench):
    answer = answered("read", bench(limits={"bus_voltage_low_V": 30}), status=3)
    assert (answer["status"], answer["channels"], safe(answer)) == ("tripped", [], ALL_SAFE)
    assert "bus_voltage" in trip_of("emulated").cause


def test_zero_tells_the_offset_before_and_after_and_holds_for_its_run(bench):
    path = bench(emulated={"effects": [{"name": "torque_sensor_offset", "offset": 0.25}]})
    for _ in range(2):
        answer = answered("zero", path)
        assert (answer["status"], safe(answer)) == ("complete", SAFE)
        zero = answer["zeros"]["torque"]
        assert zero["before_Nm"] == pytest.approx(0.0, abs=1e-9)
        assert zero["after_Nm"] == pytest.approx(0.25, abs=4 * 0.004 / 100**0.5)
    with Run.open(Path(answer["run"])) as run:
        (note,) = [event.message for event in run.events if event.message.startswith("tared")]
    assert note.startswith("tared: offset of torque 0.2")
    words = leactl("bench", "zero", path).stdout
    assert words.startswith("torque: offset 0.2")
    assert "before 0 N*m, moved by +0.2" in words


def test_zero_under_load_is_refused(bench):
    path = bench(emulated={"effects": [{"name": "torque_sensor_offset", "offset": 5.0}]})
    done = leactl("bench", "zero", path)
    assert (done.returncode, done.stdout) == (5, "")
    assert "a tare would move the zero of input torque" in done.stderr


@pytest.mark.parametrize(
    ("option", "value", "role", "quantity"),
    [
        ("--current", 1.5, "test", "q_axis_current"),
        ("--velocity", 2.0, "load", "velocity"),
        ("--angle", -0.1, "load", "angle"),
    ],
)
def test_jog_moves_its_drive_alone_and_is_recorded(option, value, role, quantity):
    answer = answered("jog", option, value, "--role", role, "--for", "0.5")
    assert (answer["status"], safe(answer)) == ("complete", SAFE)
    assert Path(answer["run"]).parent == Path("runs/by-hand")
    with Run.open(Path(answer["run"])) as run:
        (hold,) = [step for step in run.steps if step.name == "jog"]
        channel = run.channel(quantity, role)
        settled = (channel.time > hold.start + 0.3) & (channel.time < hold.stop)
        other = run.channel("drive_enabled", "load" if role == "test" else "test").values
        assert run.source("protocol").startswith("name: jog\n")
    assert np.mean(channel.values[settled]) == pytest.approx(value, rel=0.1)
    assert np.nanmax(other) == 0


def test_the_protocol_of_a_jog_runs_as_one(here):
    answer = answered("jog", "--current", "1")
    with Run.open(Path(answer["run"])) as run:
        (here / "mine.yaml").write_text(run.source("protocol"))
    assert leactl("run", "mine.yaml").returncode == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "one of --current, --velocity, --angle was expected, 0 were given"),
        (["--current", "1", "--angle", "1"], "one of --current, --velocity, --angle was expected, 2 were given"),
        (["--current", "nan"], "invalid value for '--current': nan is not a finite number"),
        (["--current", "31"], "test q_axis_current_reference: 31 A is above the bench limit of 30 A"),
        (["--velocity", "-41", "--role", "load"], "load velocity_reference: 41 rad/s is above the bench limit"),
        (["--velocity", "1", "--for", "0.001"], "at least one cycle (0.02 s) was expected"),
        (["--velocity", "1", "--setup", "loose"], "setup: 'loose': 'free', 'locked'"),
        (["no-such", "--velocity", "1"], "bench 'no-such' is not known; known: emulated, emulated-heated, testbed"),
    ],
)
def test_jog_refuses_in_one_line_before_anything_is_touched(here, arguments, words):
    done = leactl("bench", "jog", *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert words in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (here / "runs").exists()


@pytest.mark.parametrize(("option", "value"), [("--current", 1.5), ("--velocity", 2.0), ("--angle", -0.1)])
def test_a_dry_run_of_a_jog_tells_its_demands_and_opens_nothing(testbed, here, option, value):
    words = ("jog", str(testbed), option, value, "--role", "load", "--for", "0.5", "--dry-run")
    answer = answered(*words)
    (peak,) = answer["peaks"]
    assert (peak["role"], peak["value"]) == ("load", abs(value))
    assert [device["name"] for device in answer["devices"]] == list(SAFE)
    (jog,) = [row for row in answer["timeline"] if row["name"] == "jog"]
    assert jog["duration_s"] == 0.5
    text = leactl("bench", *words).stdout
    assert f"{value:g} {peak['unit']}" in text
    assert "would open drive_test, drive_load, torque_sensor" in text
    assert not (here / "runs").exists()


@pytest.mark.parametrize(("value", "status"), [("31", 2), ("1", 0)])
def test_a_dry_run_of_a_jog_refuses_what_the_jog_refuses(value, status):
    done = leactl("bench", "jog", "--current", value, "--dry-run")
    assert done.returncode == status
    assert ("31 A is above the bench limit of 30 A" in done.stderr) == bool(status)


def test_a_dry_run_of_a_jog_on_a_bench_that_another_run_holds_is_refused(testbed, holder):
    done = leactl("bench", "jog", testbed, "--current", "1", "--dry-run")
    assert (done.returncode, done.stdout) == (5, "")
    assert f"is driven by another run, process {holder.pid};" in done.stderr


def test_an_angle_beyond_the_bench_s_limit_is_refused(bench):
    done = leactl("bench", "jog", bench(limits={"angle_rad": 0.5}), "--angle", "0.6")
    assert done.returncode == 2
    assert "test angle_reference: 0.6 rad is above the bench limit of 0.5 rad" in done.stderr


def test_a_jog_that_trips_latches_the_bench_for_all_that_is_done_by_hand():
    answer = answered("jog", "--current", "4", "--setup", "free", status=3)
    assert (answer["status"], safe(answer)) == ("tripped", SAFE)
    assert trip_of("emulated").cause == answer["reason"]
    for arguments in (["read"], ["zero"], ["jog", "--angle", "0.1"], ["check", "emulated", "--devices"]):
        done = leactl("bench", *arguments)
        assert (done.returncode, done.stdout) == (3, "")
        assert "leactl bench reset emulated" in done.stderr


@pytest.mark.parametrize("arguments", [["read"], ["zero"], ["jog", "--current", "1"], ["check", "--move", "--yes"]])
def test_a_bench_that_another_run_holds_is_refused(testbed, holder, arguments):
    done = leactl("bench", arguments[0], testbed, *arguments[1:])
    assert (done.returncode, done.stdout) == (5, "")
    assert f"bench 'testbed-{os.getpid()}' is driven by another run, process {holder.pid};" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nobody"], "bench 'emulated' has no device 'nobody'; it has drive_test, drive_load, torque_sensor, daq"),
        (["drive_test"], "drive_test (elmo_can) has no recorder of its own that could be uploaded"),
    ],
)
def test_a_recording_is_refused_where_there_is_no_recorder(here, arguments, words):
    done = leactl("bench", "recording", *arguments, "--out", "step.csv")
    assert (done.returncode, done.stderr) == (2, f"leactl: {words}\n")
    assert not (here / "step.csv").exists()
