"""`leactl safety drill` as a shell sees it: a report, pure JSON, its exit status, and its end by Ctrl-C."""

import json
import os
import signal
import subprocess

import pytest
import yaml

from leactl.bench import benchfile
from tests.cli.terminal import COMMAND, leactl, start
from tests.cli.test_stop_key import Terminal
from tests.latches import trip_of


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    (tmp_path / "tmp").mkdir()
    return tmp_path


def unguarded(here):
    """The shipped bench without what holds the torque sensor against Kt i."""
    data = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
    del data["interlocks"]["torque_disagreement"]
    (here / "mine.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
    return "mine.yaml"


def test_json_alone_is_on_stdout_and_nothing_is_left_behind(here):
    done = leactl("safety", "drill", "--only", "bus_off", "--only", "scaled_sensor", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert set(answer) == {"bench", "emulated", "held", "findings", "not_rehearsed"}
    assert (answer["bench"], answer["emulated"], answer["held"], answer["not_rehearsed"]) == (
        "emulated",
        True,
        True,
        [],
    )
    assert set(answer["findings"][1]) == {
        "name", "on", "parameters", "ought", "within_s", "status", "reason", "ended_s", "zero_torque_s", "devices",
        "faults", "notes", "run", "held",
    }  # fmt: skip
    assert [finding["name"] for finding in answer["findings"]] == ["no_fault", "bus_off", *["scaled_sensor"] * 3]
    assert answer["findings"][1]["devices"]["drive_test"]["without_power"] is True
    assert done.stderr.splitlines()[0] == "1 of 5: no_fault"
    assert "s left" in done.stderr.splitlines()[-1]
    assert (trip_of("emulated"), os.listdir(here / "tmp")) == (None, [])


@pytest.mark.parametrize("columns", [80, 140])
def test_the_report_fits_the_terminal_and_names_what_was_not_rehearsed(columns):
    names = ("disconnected_sensor", "frozen_drive", "slow_disk")
    only = [word for name in names for word in ("--only", name)]
    done = leactl("safety", "drill", *only, **os.environ | {"COLUMNS": str(columns)})
    assert done.returncode == 0, done.stderr
    assert max(map(len, done.stdout.splitlines())) <= columns
    assert "disconnected_sensor" in done.stdout  # whole, at any width
    assert "drive_test keeps its power until its supply is switched off" in " ".join(done.stdout.split())
    assert "not rehearsed: slow_disk: " in done.stdout
    assert done.stdout.splitlines()[-1] == "emulated (emulated): 7 rehearsed, 7 ended as they ought to"


def test_a_bench_without_an_interlock_ends_with_status_3_and_its_name(here):
    done = leactl("safety", "drill", unguarded(here), "--only", "scaled_sensor", "--json")
    assert done.returncode == 3
    answer = json.loads(done.stdout)
    assert not answer["held"]
    assert [finding["faults"] for finding in answer["findings"] if finding["on"] == "torque_sensor"] == [["not caught"]]
    line = "leactl: 1 of 4 did not end as they ought to: scaled_sensor torque_sensor: not caught"
    assert done.stderr.splitlines()[-1] == line
    shown = leactl("safety", "drill", "mine.yaml", "--only", "scaled_sensor")
    assert shown.returncode == 3
    assert "NOT AS IT OUGHT: scaled_sensor torque_sensor torque gain 4: not caught" in " ".join(shown.stdout.split())


def test_runs_and_their_bench_files_are_kept_where_they_are_asked_for_and_run_again(here):
    done = leactl("safety", "drill", "--only", "over_voltage", "--out", "kept", "--report", "page.md", "--json")
    assert done.returncode == 0, done.stderr
    finding = json.loads(done.stdout)["findings"][1]
    assert leactl("runs", "verify", finding["run"]).returncode == 0
    again = leactl("run", "friction", "--bench", "kept/01-over_voltage.yaml", "--json")
    assert (again.returncode, json.loads(again.stdout)["reason"]) == (3, finding["reason"])
    page = (here / "page.md").read_text()
    assert "`leactl safety drill emulated --only over_voltage --report page.md`" in page
    assert "| ok | over_voltage bus_voltage_V 75 | test bus_voltage of 75 V passed the limit of 60 V |" in page


def test_a_dry_run_tells_what_a_real_bench_would_do_and_opens_nothing(testbed, here):
    done = leactl("safety", "drill", testbed, "--out", "kept", "--report", "page.md", "--dry-run", "--json")
    assert (done.returncode, done.stderr) == (0, "")  # there is no such bus on this machine
    answer = json.loads(done.stdout)
    (stop,) = answer["rehearsals"]
    assert answer["devices"] == ["drive_test", "drive_load", "torque_sensor"]
    assert (answer["emulated"], stop["name"], stop["duration_s"]) == (False, "stop", pytest.approx(31.3))
    demands = {(peak["role"], peak["quantity"], peak["value"], peak["unit"]) for peak in stop["peaks"]}
    assert demands == {("load", "velocity_reference", 1.0, "rad/s"), ("test", "q_axis_current_reference", 1.0, "A")}
    why = {item["name"]: item["why"] for item in answer["not_rehearsed"]}
    assert why["operator_stop"] == "it takes a person at a terminal"
    assert {path.name for path in here.iterdir()} <= {"tmp", "testbed.yaml", "machine"}
    text = leactl("safety", "drill", testbed, "--dry-run").stdout
    assert "stop: 31.3 s at most, load velocity_reference 1 rad/s, test q_axis_current_reference 1 A\n" in text


def test_a_dry_run_of_an_emulated_bench_names_each_rehearsal(here):
    answer = json.loads(leactl("safety", "drill", "--only", "frozen_drive", "--dry-run", "--json").stdout)
    names = [(item["name"], item["on"]) for item in answer["rehearsals"]]
    assert names == [("no_fault", ""), ("frozen_drive", "drive_test"), ("frozen_drive", "drive_load")]
    assert {path.name for path in here.iterdir()} <= {"tmp", "state"}


def test_a_dry_run_of_a_bench_that_another_run_holds_is_refused(testbed, holder):
    done = leactl("safety", "drill", testbed, "--dry-run")
    assert (done.returncode, done.stdout) == (5, "")
    assert f"is driven by another run, process {holder.pid};" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["no-such"], "bench 'no-such' is not known; known: emulated, emulated-heated, testbed"),
        (["--only", "gremlins"], "fault 'gremlins' is not known; known: bus_off, "),
        (
            ["testbed", "--only", "bus_off", "--yes"],
            "--only bus_off: no fault can be put into a real bench",
        ),
        (["testbed"], "a real bench is asked for before it moves, and stdin is no terminal; --yes agrees to all"),
        (["--bus", "can0=socketcan:can0"], "--bus: an emulated bench has its buses in this process"),
        (["--out", "/dev/null/here"], "/dev/null/here: cannot be made or written to: /dev/null: not a folder"),
        (["--only", "bus_off", "--report", "/no/page.md"], "--report /no/page.md: No such file or directory"),
    ],
)
def test_what_cannot_be_used_is_one_line_and_status_2(arguments, words):
    done = leactl("safety", "drill", *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert words in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_ctrl_c_ends_the_drill_in_order_and_leaves_nothing_behind(here):
    process = start("safety", "drill", "--json")
    for line in process.stderr:
        if line.startswith("4 of "):
            process.send_signal(signal.SIGINT)
            break
    out, err = process.communicate()
    assert (process.returncode, out) == (4, ""), err
    assert err.splitlines()[-1] == "leactl: stopped by SIGINT"
    assert os.listdir(here / "tmp") == []


@pytest.fixture
def served(here):
    """Two drives that another process emulates on a serial CAN adapter; and how to meet them."""
    data = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
    # there is no I2C between processes, and what else runs here may hold the loop up
    del data["buses"]["i2c1"], data["devices"]["torque_sensor"], data["interlocks"]
    data["interlocks"] = {"loop_overruns": {"in_a_row": 1000, "share_percent": 99}, "clock": {"jump_s": 5}}
    data["limits"]["cyclic_age_s"] = 0.5
    data["buses"]["can0"] |= {"interface": "pty", "options": {"sleep_after_open": 0.0}}
    for role in ("test", "load"):
        data["devices"][f"drive_{role}"]["settings"] |= {"sdo_timeout_s": 1.0, "consumer_heartbeat_ms": 1000}
    (here / "served.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
    command = [*COMMAND, "bench", "serve", "served.yaml", "--setup", "coupled"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        place = server.stdout.readline().split()[-1]
        assert server.stdout.readline() == "serving; Ctrl-C ends it\n"
        yield ("served.yaml", "--served", f"--bus=can0=slcan:{place}")
    finally:
        server.kill()
        server.communicate()


def test_a_bench_on_real_buses_is_stopped_and_asked_to_confirm(served):
    done = leactl("safety", "drill", *served, "--yes", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    (stop,) = answer["findings"]
    assert (stop["name"], stop["status"], stop["reason"]) == ("stop", "stopped", "stopped by the drill")
    assert {name: end["confirmed"] for name, end in stop["devices"].items()} == {"drive_test": True, "drive_load": True}
    assert 0 < stop["ended_s"] <= stop["within_s"]
    why = {item["name"]: item["why"] for item in answer["not_rehearsed"]}
    assert why["operator_stop"] == "it takes a person at a terminal"
    assert why["sensor_unplugged"] == "no sensor on an analogue input"
    assert "kill -9" in why["dead_man"]


@pytest.fixture
def at_the_bench(served):
    """A person at a terminal in front of the served bench, who is asked about the operator's stop."""
    terminal = Terminal("safety", "drill", *served, "--only", "operator_stop", "--json")
    terminal.read_until(lambda: b"Go on? [y/N]" in terminal.shown)
    assert b"keep clear of the shaft" in terminal.shown
    yield terminal
    terminal.close()


def test_a_person_at_the_terminal_agrees_and_presses_the_key(at_the_bench):
    os.write(at_the_bench.hands, b"y\n")
    at_the_bench.read_until(lambda: b"Press space or q now" in at_the_bench.shown)
    os.write(at_the_bench.hands, b" ")
    (finding,) = json.loads(at_the_bench.wait())["findings"]
    assert at_the_bench.process.returncode == 0
    assert (finding["status"], finding["reason"]) == ("stopped", "stopped by the operator: key space")
    assert all(end["confirmed"] for end in finding["devices"].values())


def test_a_person_who_does_not_agree_moves_nothing(at_the_bench, here):
    os.write(at_the_bench.hands, b"no\n")
    answer = json.loads(at_the_bench.wait())
    assert (at_the_bench.process.returncode, answer["findings"]) == (0, [])
    assert answer["not_rehearsed"][0] == {"name": "operator_stop", "why": "not agreed to"}


def test_a_bench_that_another_run_holds_is_not_drilled(testbed, holder):
    done = leactl("safety", "drill", testbed, "--yes")
    assert (done.returncode, done.stdout) == (5, "")
    assert f"bench 'testbed-{os.getpid()}' is driven by another run, process {holder.pid};" in done.stderr
