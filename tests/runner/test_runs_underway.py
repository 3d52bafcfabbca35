"""A run can be found and stopped by other processes while it lasts; what a kill left behind is no run."""

import fcntl
import json
import os
import subprocess
import sys
import time
from contextlib import nullcontext

import pytest
from leactl_plugins.ads1115.driver import Ads1115

from leactl.errors import InputError
from leactl.runfile.read.reader import Run
from leactl.runner import runs_underway
from leactl.runner.state_folder import state_directory

PERIOD = 0.01  # of `spin` [s]

HOLD = """
import sys, time
from leactl.runner import runs_underway
with runs_underway.announced("rig", "rig.yaml", "hold", is_needed=True):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder():
    process = subprocess.Popen([sys.executable, "-c", HOLD], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def files():
    return list((state_directory() / "runs").iterdir())


def test_no_cycle_begins_after_a_stop_and_the_drives_lose_torque_within_one(spin):
    begun, asked, benches = [], [], []

    def ask(bench):
        (run,), _faults = runs_underway.running()
        run.ask_to_stop()
        run.close()
        asked.append(bench.clock.now())

    def watch(_progress):
        begun.append(benches[0].clock.now())
        return nullcontext()

    outcome, bench = spin(at=[(0.0, benches.append), (0.305, ask)], watch=watch)
    assert (outcome.status, outcome.reason) == ("stopped", "stopped by `leactl bench stop`")
    assert outcome.error.exit_status == 4
    assert all(confirmation.safe for confirmation in outcome.safe.values())
    with Run.open(outcome.path) as run:
        last = begun[0] + run.time("loop")[-1]  # start of the last cycle
    assert last <= asked[0] <= last + PERIOD + 1e-9
    assert bench.clock.now() <= asked[0] + PERIOD
    assert [bench.far_ends[name].state for name in ("drive_test", "drive_load")] == ["disabled", "disabled"]
    assert files() == []


def test_a_run_tells_how_it_ended_to_whoever_had_its_file_open(spin):
    results = []
    outcome, _bench = spin(
        at=[(0.3, lambda _bench: results.extend(runs_underway.running()[0]))], sets=("current_A=2.5", "hold_s=2")
    )
    (run,) = results
    assert run.wait(time.monotonic())
    told = run.facts()
    run.close()
    assert (told["status"], told["reason"]) == ("tripped", outcome.reason)
    assert told["run"] == str(outcome.path)
    assert {name: device["confirmed"] for name, device in told["safe"].items()} == {
        "drive_test": True,
        "drive_load": True,
        "torque_sensor": True,
    }


def test_what_a_kill_left_behind_is_no_run_and_is_told_once_to_the_next_one(holder):
    (run,), _faults = runs_underway.running()
    assert (run.bench, run.protocol, run.process) == ("rig", "hold", holder.pid)
    assert not run.wait(time.monotonic())
    assert runs_underway.lost("rig") == []  # it goes on
    holder.kill()
    holder.wait()
    assert run.wait(time.monotonic())
    assert "status" not in run.facts()
    run.close()
    assert len(files()) == 1
    assert runs_underway.running() == ([], [])
    assert runs_underway.lost("another") == []
    said = f"process {holder.pid} of the run hold ended without a word, and its watchdog too"
    (lost,) = runs_underway.lost("rig")
    assert (lost.cause, lost.recording) == (said, "none")
    assert runs_underway.lost("rig") == [lost]  # whatever was to be done about it failed
    runs_underway.forget(lost)
    assert runs_underway.lost("rig") == []
    assert files() == []


@pytest.mark.parametrize(
    ("told", "counts"),
    [
        ({}, True),
        ({"safe": {"drive": {"confirmed": False, "detail": "no answer"}}}, True),
        ({"safe": {"drive": {"confirmed": True, "detail": "off"}}}, False),
        ({"safe": "yes"}, True),
        ({"real": False}, False),  # its devices ended with it
    ],
)
def test_a_run_that_ended_is_lost_unless_it_told_that_its_devices_are_safe(told, counts):
    place = state_directory() / "runs" / "rig.1.0.run"
    place.parent.mkdir(parents=True)
    about = {"bench": "rig", "file": "rig.yaml", "protocol": "hold", "process": 1, "real": True, "run": "r.h5"} | told
    place.write_bytes(b"--" + json.dumps(about).encode() + b"\n")
    runs_underway.running()
    assert place.exists() == counts
    lost = runs_underway.lost("rig")
    assert [run.recording for run in lost] == (["r.h5"] if counts else [])
    for run in lost:
        runs_underway.forget(run)
    assert not place.exists()


def test_a_file_without_a_lock_that_names_a_living_process_is_no_run():
    place = state_directory() / "runs" / f"rig.{os.getpid()}.0.run"
    place.parent.mkdir(parents=True)
    place.write_bytes(b'-{"bench": "rig", "file": "rig.yaml", "protocol": "hold", "process": %d}\n' % os.getpid())
    assert runs_underway.running() == ([], [])
    assert not place.exists()


def test_a_run_is_locked_before_it_can_be_found(monkeypatch):
    seen = []
    lock = fcntl.flock

    def slow(descriptor, how):
        if how & fcntl.LOCK_EX:
            seen.extend(runs_underway.running()[0])
            assert [path.suffix for path in files()] == [".tmp"]
        lock(descriptor, how)

    monkeypatch.setattr(fcntl, "flock", slow)
    with runs_underway.announced("rig", "rig.yaml", "hold", is_needed=True):
        assert seen == []
        (run,), _faults = runs_underway.running()
        run.close()


def test_without_a_place_a_rehearsal_goes_on_and_says_so_and_a_real_run_is_refused(spin, monkeypatch):
    monkeypatch.setenv("LEACTL_STATE", "/proc/nowhere")
    outcome, _bench = spin()
    assert outcome.status == "complete"
    with Run.open(outcome.path) as run:
        (event,) = [event for event in run.events if event.level == "warning"]
    assert event.message.startswith("/proc/nowhere/runs: `leactl bench stop` cannot reach this run: ")
    refused = pytest.raises(InputError, match="set LEACTL_STATE to a directory that can be written")
    with refused, runs_underway.announced("rig", "rig.yaml", "hold", is_needed=True):
        raise AssertionError


def test_a_stop_that_comes_while_the_devices_are_opened_moves_nothing(spin, monkeypatch):
    opened = Ads1115.open

    def ask_and_open(device):
        (run,), _faults = runs_underway.running()
        run.ask_to_stop()
        run.close()
        opened(device)

    monkeypatch.setattr(Ads1115, "open", ask_and_open)
    outcome, bench = spin()
    assert outcome.status == "stopped"
    with Run.open(outcome.path) as run:
        assert len(run.time("loop")) == 0
    assert bench.far_ends["drive_test"].state == "disabled"
