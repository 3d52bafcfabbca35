"""`leactl bench stop` from another process: it ends a run in order, waits for its end, and says how it ended."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from leactl.bench import benchfile
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from tests.cli.terminal import leactl, live_run, start
from tests.runner.conftest import SPIN

CAUSE = "stopped by `leactl bench stop`"
SPINNING = ("run", "spin.yaml", "--set", "hold_s=600", "--realtime", "--json")

HOLD = """
import sys, time
from leactl.driver.contract import Confirmation
from leactl.runner import runs_underway
with runs_underway.announced(sys.argv[1], "rig.yaml", "hold", is_needed=True) as announcement:
    print("held", flush=True)
    while not announcement.stop_cause():
        time.sleep(0.01)
    if sys.argv[2] == "unsafe":
        announcement.tell_safe({"drive": Confirmation(False, "no answer"), "supply": Confirmation(True, "off")})
    if sys.argv[2] == "open fails":
        raise OSError("no bus")
    announcement.tell(status="stopped", reason="asked", run="a.h5")
"""

ANOTHER_USER = """
import os
from leactl.cli import main
from leactl.runner import runs_underway
os.seteuid(65534)
main.main()
"""


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    (tmp_path / "spin.yaml").write_text(SPIN)
    return tmp_path


@pytest.fixture
def processes():
    made = []
    yield made
    for process in made:
        process.kill()
        process.communicate()


@pytest.fixture
def hold(processes):
    def begin(bench="rig", how="well"):
        process = subprocess.Popen([sys.executable, "-c", HOLD, bench, how], stdout=subprocess.PIPE, text=True)
        processes.append(process)
        assert process.stdout.readline() == "held\n"
        return process

    return begin


@pytest.mark.parametrize(
    "how",
    [
        ["emulated"],
        *(pytest.param(how, marks=pytest.mark.long) for how in ([], [str(benchfile.SHIPPED / "emulated.yaml")])),
    ],
)
def test_a_stop_ends_the_run_in_order_and_tells_how(here, processes, how):
    run = start(*SPINNING)
    processes.append(run)
    path = live_run(here, run)
    done = leactl("bench", "stop", *how)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"emulated: every device confirmed safe; stopped: {CAUSE}; {path}\n"
    out, err = run.communicate()
    assert (run.returncode, err) == (4, f"leactl: {CAUSE}\n")
    answer = json.loads(out)
    assert answer["status"] == "stopped"
    assert all(device["confirmed"] for device in answer["safe"].values())
    assert verify(path) == []
    with Run.open(path) as recorded:
        assert (recorded.status, recorded.attributes["status_reason"]) == ("stopped", CAUSE)


def test_json_names_run_process_and_devices(here, processes):
    run = start("bench", "jog", "--current", "1", "--for", "600", "--realtime", "--out", "runs")
    processes.append(run)
    path = live_run(here, run)
    done = leactl("bench", "stop", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    (end,) = json.loads(done.stdout)["runs"]
    safe = end.pop("safe")
    assert {name: device["confirmed"] for name, device in safe.items()} == {
        "drive_test": True,
        "drive_load": True,
        "torque_sensor": True,
    }
    assert end == {
        "bench": "emulated",
        "protocol": "jog",
        "process": run.pid,
        "ended": True,
        "status": "stopped",
        "reason": CAUSE,
        "run": str(path),
        "doubt": "",
    }
    run.communicate()
    assert run.returncode == 4


def test_without_a_bench_every_run_is_stopped_and_with_one_that_alone(hold):
    first, second = hold("rig-1"), hold("rig-2")
    (Path("rig-2.yaml")).write_text(
        (benchfile.SHIPPED / "emulated.yaml").read_text().replace("emulated\n", "other\n", 1)
    )
    assert leactl("bench", "stop", "rig-2.yaml").stdout == "nothing runs on rig-2.yaml\n"  # its name is another
    assert leactl("bench", "stop", "rig-2").returncode == 5
    second.wait()
    assert first.poll() is None
    third = hold("rig-3")
    ends = json.loads(leactl("bench", "stop", "--json").stdout)["runs"]
    assert [end["bench"] for end in ends] == ["rig-1", "rig-3"]
    first.wait()
    third.wait()


def test_nothing_runs():
    assert leactl("bench", "stop").stdout == "nothing runs\n"
    assert leactl("bench", "stop", "testbed").stdout == "nothing runs on testbed\n"
    done = leactl("bench", "stop", "--json")
    assert (done.returncode, json.loads(done.stdout)) == (0, {"runs": []})


def test_an_unknown_bench_is_status_2():
    done = leactl("bench", "stop", "no-such")
    assert (done.returncode, done.stdout) == (2, "")
    assert (
        done.stderr
        == "leactl: bench 'no-such' is not known; known: emulated, emulated-heated, testbed, or a path to a .yaml\n"
    )


@pytest.mark.parametrize(
    ("how", "words"),
    [("unsafe", "drive: no answer"), ("open fails", "no bus"), ("well", "asked")],
)
def test_an_end_that_is_not_confirmed_safe_is_status_5(hold, how, words):
    hold("rig", how)
    done = leactl("bench", "stop")
    assert (done.returncode, done.stdout) == (5, "")
    assert done.stderr == f"leactl: rig: NOT CONFIRMED SAFE, switch off the supply: {words}\n"


@pytest.mark.long
def test_a_run_that_hangs_is_status_5_after_the_wait(here, processes):
    run = start(*SPINNING)
    processes.append(run)
    live_run(here, run)
    run.send_signal(signal.SIGSTOP)
    done = leactl("bench", "stop", "--wait", "0.2")
    assert (done.returncode, done.stdout) == (5, "")
    assert done.stderr == (
        "leactl: emulated: NOT CONFIRMED SAFE, switch off the supply:"
        f" process {run.pid} has not answered within 0.2 s\n"
    )
    run.send_signal(signal.SIGCONT)  # what was asked for still stands
    run.communicate()
    assert run.returncode == 4


def test_after_a_kill_nothing_runs(here, processes):
    run = start(*SPINNING)
    processes.append(run)
    live_run(here, run)
    run.kill()
    run.wait()
    assert leactl("bench", "stop").stdout == "nothing runs\n"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be another user")
def test_another_user_s_run_goes_on_and_is_status_5(hold, monkeypatch):
    with tempfile.TemporaryDirectory() as shared:
        os.chmod(shared, 0o755)
        monkeypatch.setenv("LEACTL_STATE", shared)
        run = hold()
        command = [sys.executable, "-c", ANOTHER_USER, "bench", "stop"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == (5, "")
        assert done.stderr == (
            f"leactl: hold on rig, process {run.pid}: cannot be asked to stop:"
            " no permission; the run is that of user 0, who may, as root may\n"
        )
        assert run.poll() is None
        shutil.rmtree(Path(shared) / "runs")


def test_a_remark_and_a_pause_reach_a_run_and_nothing_running_is_said(here, processes):
    run = start(*SPINNING)
    processes.append(run)
    path = live_run(here, run)
    completed = leactl("bench", "remark", "the bearing squeaks")
    assert (completed.returncode, completed.stderr) == (0, "")
    assert completed.stdout == f"spin on emulated, process {run.pid} records it\n"
    completed = leactl("bench", "pause", "emulated", "--json")
    assert json.loads(completed.stdout) == {"runs": [{"bench": "emulated", "protocol": "spin", "process": run.pid}]}
    assert leactl("bench", "resume").returncode == 0
    assert leactl("bench", "stop").returncode == 0
    run.communicate()
    with Run.open(path) as recorded:
        assert "remark: the bearing squeaks" in [event.message for event in recorded.events]
    for words in (("pause",), ("resume", "emulated"), ("remark", "x")):
        done = leactl("bench", *words)
        assert (done.returncode, done.stdout) == (5, "")
        assert done.stderr.startswith("leactl: nothing runs")
    assert leactl("bench", "remark", " ").returncode == 2
