"""`leactl run` as a shell sees it: streams, exit statuses, signals, kill -9, a full disk."""

import json
import os
import resource
import signal
import subprocess
import sys

import h5py
import pytest

from leactl.runfile.verify.integrity import recover, verify
from tests.cli.terminal import COMMAND, leactl, live_run, start
from tests.runner.conftest import SPIN


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A directory with the protocol, and state of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    (tmp_path / "spin.yaml").write_text(SPIN)
    return tmp_path


def test_json_is_pure_and_names_the_run(here):
    done = leactl("run", "spin.yaml", "--set", "seed=7", "--set", "hold_s=0.5", "--out", "runs", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["status"] == "complete"
    assert verify(here / answer["run"]) == []
    shown = json.loads(leactl("runs", "show", answer["run"], "--json").stdout)
    assert shown["attributes"]["seed"] == "7"
    completed = leactl("runs", "list", "runs", "--where", "seed=7")
    assert completed.stdout.split()[-1] == "seed=7"
    assert leactl("runs", "list", "runs", "--where", "seed=8").stdout == ""
    assert shown["parameters"] == {"current_A": 0.7, "hold_s": 0.5, "trials": 1}
    assert {name: device["confirmed"] for name, device in answer["safe"].items()} == {
        "drive_test": True,
        "drive_load": True,
        "torque_sensor": True,
    }


def test_a_trip_is_status_3_and_the_reset_states_its_cause(here):
    done = leactl("run", "spin.yaml", "--set", "current_A=2.5", "--set", "hold_s=2", "--json")
    assert done.returncode == 3
    assert json.loads(done.stdout)["status"] == "tripped"
    assert done.stderr.startswith("leactl: test velocity of ")
    again = leactl("run", "spin.yaml")
    assert again.returncode == 3
    assert "leactl bench reset emulated" in again.stderr
    unsure = leactl("bench", "reset", "emulated", input="n\n")
    assert unsure.returncode == 4
    reset = leactl("bench", "reset", "emulated", "--yes")
    assert reset.returncode == 0
    assert "test velocity of" in reset.stderr
    assert leactl("run", "spin.yaml").returncode == 0
    assert leactl("bench", "reset", "emulated").stdout == "emulated: not tripped\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["no-such"], "no-such"),
        (
            ["spin.yaml", "--bench", "no-such"],
            "bench 'no-such' is not known; known: emulated, emulated-heated, testbed",
        ),
        (["spin.yaml", "--set", "speed=1"], "speed"),
        (["spin.yaml", "--set", "hold_s"], "--set hold_s: name=value was expected"),
        (["spin.yaml", "--condition", "icy"], "condition 'icy'"),
        (["spin.yaml", "--bench", "testbed", "--set", "seed=1"], "takes no seed"),
    ],
)
def test_unusable_input_is_status_2_in_one_line(here, arguments, words):
    done = leactl("run", *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert words in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (here / "runs").exists()


def test_a_dry_run_checks_plans_and_touches_nothing(here):
    done = leactl("run", "spin.yaml", "--set", "hold_s=0.5", "--dry-run", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    body = json.loads(done.stdout)
    assert body["parameters"]["hold_s"] == 0.5
    assert body["peaks"][0]["limits"] == [-30, 30]
    assert body["windings"]["test"]["hottest_degC"] < body["windings"]["test"]["limit_degC"]
    text = leactl("run", "spin.yaml", "--dry-run").stdout
    assert "bench 'emulated' is not tripped, and no other run holds it\nwould write " in text
    assert sorted(path.name for path in here.iterdir()) == ["spin.yaml"]


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        (["--bench", "no-such"], 2),
        (["--set", "current_A=31"], 2),
        (["--set", "hold_s=3600", "--set", "current_A=29"], 2),  # too hot
        (["--bench", "testbed", "--set", "seed=1"], 2),
        (["--out", "spin.yaml/runs"], 2),
    ],
)
def test_a_dry_run_ends_as_the_run_would_at_the_door(here, arguments, status):
    dry, real = (leactl("run", "spin.yaml", *arguments, *also) for also in (["--dry-run"], []))
    assert (dry.returncode, dry.stdout, real.returncode) == (status, "", status)
    assert len(dry.stderr.splitlines()) == 1


def test_a_dry_run_asks_for_the_terminal_that_a_prompt_needs(here, testbed):
    (here / "asks.yaml").write_text(SPIN.replace("steps:\n", "steps:\n  - prompt: mount the mass\n"))
    for also in (["--dry-run"], []):
        done = leactl("run", "asks.yaml", "--bench", testbed, "--cold", *also)
        assert (done.returncode, done.stdout) == (2, "")
        assert "asks the operator" in done.stderr


def test_a_dry_run_meets_latch_and_lock(here, holder, testbed):
    held = leactl("run", "spin.yaml", "--bench", testbed, "--cold", "--dry-run")
    assert (held.returncode, held.stdout) == (5, "")
    assert f"is driven by another run, process {holder.pid}" in held.stderr
    assert leactl("run", "spin.yaml", "--set", "current_A=2.5", "--set", "hold_s=2").returncode == 3
    latched = leactl("run", "spin.yaml", "--dry-run")
    assert (latched.returncode, latched.stdout) == (3, "")
    assert "leactl bench reset emulated" in latched.stderr


def test_an_absent_bus_is_status_5_in_one_line(here, testbed):
    done = leactl("run", "spin.yaml", "--bench", testbed, "--cold")
    assert (done.returncode, done.stdout) == (5, "")
    assert done.stderr.startswith("leactl: drive_test: bus 'can0': ")
    assert len(done.stderr.splitlines()) == 1


def test_an_acceptance_limit_that_is_not_met_is_status_6(here):
    shipped = leactl("protocol", "show", "friction").stdout
    text = shipped + "\nacceptance:\n  - {result: coulomb_friction, low: 5, unit: N*m}\n"
    (here / "strict.yaml").write_text(text)
    done = leactl("run", "strict.yaml", "--set", "trials=1", "--set", "hold_s=2", "--set", "settle_s=1", "--json")
    assert done.returncode == 6, done.stderr
    assert "acceptance: coulomb_friction is 0.2" in done.stderr
    assert json.loads(done.stdout)["acceptance"][0]["met"] is False


def test_a_run_that_does_not_answer_has_not_met_its_limit(here):
    acceptance = "analysis: friction\nacceptance:\n  - {result: coulomb_friction, low: 0.1, unit: N*m}\nsteps:\n"
    (here / "strict.yaml").write_text(SPIN.replace("steps:\n", acceptance))
    done = leactl("run", "strict.yaml", "--json")
    assert done.returncode == 6, done.stderr
    answer = json.loads(done.stdout)
    assert answer["status"] == "complete"
    assert answer["acceptance"] == [{"result": "coulomb_friction", "value": None, "units": "N*m", "met": False}]
    assert done.stderr.startswith("leactl: acceptance: coulomb_friction is not known, 0.1 to inf was required: ")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    "number",
    [signal.SIGINT, *(pytest.param(number, marks=pytest.mark.long) for number in (signal.SIGTERM, signal.SIGQUIT))],
)
def test_a_signal_stops_in_order_and_a_second_one_changes_nothing(here, number):
    process = start("run", "spin.yaml", "--set", "hold_s=60", "--realtime", "--json")
    path = live_run(here, process)
    process.send_signal(number)
    process.send_signal(number)
    out, err = process.communicate(timeout=20)
    assert process.returncode == 4, err
    assert json.loads(out)["status"] == "stopped"
    assert err == f"leactl: stopped by {number.name}\n"
    assert verify(path) == []


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Linux tells who writes a file")
def test_a_run_under_way_is_not_recovered(here):
    process = start("run", "spin.yaml", "--set", "hold_s=60", "--realtime")
    path = live_run(here, process)
    refused = leactl("runs", "recover", path)
    assert refused.returncode == 2
    assert "a process still writes it; wait for the run's end" in refused.stderr
    process.kill()
    process.communicate(timeout=20)
    assert leactl("runs", "recover", path).returncode == 0


def test_kill_leaves_a_file_that_recovers(here):
    process = start("run", "spin.yaml", "--set", "hold_s=60", "--realtime")
    path = live_run(here, process)
    process.kill()
    process.communicate(timeout=20)
    assert any("recording" in finding for finding in verify(path))
    clean = recover(path)
    with h5py.File(clean) as file:
        assert len(file["streams/loop/time"]) > 5
        assert file.attrs["status"] == "recovered"


def test_a_full_disk_fails_the_run_and_keeps_what_was_flushed(here):
    def small_disk():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (5_000_000, 5_000_000))

    done = subprocess.run(
        [*COMMAND, "run", "spin.yaml", "--set", "hold_s=750", "--set", "current_A=0.7", "--json"],
        capture_output=True,
        text=True,
        preexec_fn=small_disk,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    assert "recording failed" in done.stderr
    answer = json.loads(done.stdout)
    assert answer["status"] == "failed"
    assert all(device["confirmed"] for device in answer["safe"].values())
    with h5py.File(here / answer["run"], "r", swmr=True) as file:
        assert len(file["streams/loop/time"]) > 100


def test_the_live_view_shows_step_progress_and_channels(here):
    pexpect = pytest.importorskip("pexpect")
    environment = os.environ | {"COLUMNS": "80", "LINES": "24", "TERM": "xterm-256color"}
    child = pexpect.spawn(
        sys.executable,
        [*COMMAND[1:], "run", "spin.yaml", "--set", "hold_s=2", "--realtime"],
        env=environment,
        dimensions=(24, 80),
        encoding="utf-8",
        timeout=20,
    )
    child.expect("spin on emulated")
    child.expect("test velocity")
    child.expect(r"left")
    child.expect("complete, 2")
    child.expect(pexpect.EOF)
    child.close()
    assert child.exitstatus == 0


def test_a_recording_that_took_no_more_is_not_closed_again_on_the_way_out(tmp_path):
    """HDF5 crashes there, and takes the status with it."""
    script = """
import sys
from leactl.cli.main import main
from leactl.runfile.write import writer

class File:
    def __del__(self):
        print("closed again", file=sys.stderr)

writer.KEPT_OPEN.append(File())
sys.argv = ["leactl", "motor", sys.argv[1]]
main()
"""
    for word, status in (("list", 0), ("nothing", 2)):
        done = subprocess.run([sys.executable, "-c", script, word], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == status
        assert "closed again" not in done.stderr
        assert ("lea" in done.stdout) is (status == 0)
        assert ("nothing" in done.stderr) is (status == 2)
