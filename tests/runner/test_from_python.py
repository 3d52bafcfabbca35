"""A protocol run from Python: interrupted, tripped and refused, the bench is safe and the script is told."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from jupyter_client.manager import start_new_kernel

import leactl
from leactl.errors import InputError, SafetyTrip
from tests.cli.terminal import leactl as command

SCRIPT = """
import leactl
from leactl.errors import Stopped
try:
    leactl.run_protocol("friction", settings={"seed": 1}, condition="design")
except Stopped as error:
    print(error, *error.__notes__, sep="; ")
"""


def test_an_interrupt_ends_a_run_in_order_and_is_raised(tmp_path):
    with subprocess.Popen([sys.executable, "-c", SCRIPT], cwd=tmp_path, stdout=subprocess.PIPE, text=True) as script:
        deadline = time.monotonic() + 60.0
        while not list(tmp_path.glob("runs/*.h5")):
            assert time.monotonic() < deadline
            assert script.poll() is None
        script.send_signal(signal.SIGINT)
        said, _ = script.communicate(timeout=60)
    [run] = tmp_path.glob("runs/*.h5")
    assert said == f"stopped by SIGINT; run file: runs/{run.name}\n"
    with leactl.open_run(run) as opened:
        assert opened.status == "stopped"
        safe = [event.level for event in opened.events if event.message.startswith("safe state: ")]
    assert safe == ["info", "info", "info"]  # both drives and the torque sensor


def test_a_cell_that_is_interrupted_in_the_middle_of_a_run_leaves_the_bench_safe(tmp_path):
    manager, client = start_new_kernel(kernel_name="python3", cwd=str(tmp_path))
    try:
        cell = client.execute("import leactl; leactl.run_protocol('friction', settings={'seed': 1}, realtime=True)")
        deadline = time.monotonic() + 60.0
        while not list(tmp_path.glob("runs/*.h5")):
            assert time.monotonic() < deadline
        manager.interrupt_kernel()
        reply = {}
        while reply.get("parent_header", {}).get("msg_id") != cell:
            reply = client.get_shell_msg(timeout=60)
        assert (reply["content"]["status"], reply["content"].get("ename")) == ("error", "Stopped")
        assert (
            client.execute("leactl.__version__", reply=True, timeout=60)["content"]["status"] == "ok"
        )  # the kernel goes on
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)
    [run] = tmp_path.glob("runs/*.h5")
    with leactl.open_run(run) as opened:
        assert opened.status == "stopped"
        safe = [event.level for event in opened.events if event.message.startswith("safe state: ")]
    assert safe == ["info", "info", "info"]  # both drives and the torque sensor


def tripping_bench(folder):
    bench = command("bench", "show", "emulated").stdout.replace("name: emulated", "name: mine", 1)
    bench += "  faults: [{fault: scaled_sensor, at_s: 2, device: drive_test, quantity: q_axis_current, gain: 1000}]\n"
    (folder / "mine.yaml").write_text(bench)
    return folder / "mine.yaml"


def test_a_trip_is_raised_with_the_file_or_told_where_that_is_asked_for(tmp_path, monkeypatch):
    bench = tripping_bench(tmp_path)
    with pytest.raises(SafetyTrip, match="q_axis_current") as caught:
        leactl.run_protocol("current-step", bench, out=tmp_path / "runs")
    [run] = (tmp_path / "runs").glob("*.h5")
    assert caught.value.__notes__[-1] == f"run file: {run}"
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "another state"))  # where nothing is latched
    done = leactl.run_protocol("current-step", bench, out=tmp_path / "again", check=False)
    assert done.status == "tripped"
    assert "q_axis_current" in done.reason
    assert all(confirmation.safe for confirmation in done.safe.values())


def test_settings_may_be_numbers_and_arrays_of_numpy(tmp_path):
    settings = {"trials": np.int64(1), "hold_s": np.float32(2.0), "settle_s": 1, "levels_A": np.array([0.7, 0.8])}
    done = leactl.run_protocol("friction", settings=settings, out=tmp_path)
    with leactl.open_run(done.run) as run:
        assert run.parameters["hold_s"] == 2.0
        assert list(run.parameters["levels_A"]) == [0.7, 0.8]


def test_a_setting_that_is_no_number_is_refused(tmp_path):
    with pytest.raises(InputError, match="a number or a list of numbers was expected"):
        leactl.run_protocol("friction", settings={"trials": object()}, out=tmp_path)


def test_a_diagnosis_of_no_run_is_refused(tmp_path):
    with pytest.raises(InputError, match="no run to diagnose"):
        leactl.diagnose([], [], tmp_path / "nominal.yaml")


def test_a_run_leaves_every_signal_to_whoever_had_it_before(tmp_path):
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGQUIT, signal.SIGHUP
    before = [signal.getsignal(number) for number in numbers]
    done = leactl.run_protocol("current-step", settings={"trials": 1}, out=tmp_path)
    assert json.loads(json.dumps(done.as_json())).keys() == {
        "run", "status", "reason", "duration_s", "safe", "acceptance"
    }  # fmt: skip
    assert [signal.getsignal(number) for number in numbers] == before


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        ({"protocol": "frictoin"}, "protocol 'frictoin' is not known"),
        ({"protocol": "friction", "bench": "emulatde"}, "bench 'emulatde' is not known"),
        ({"protocol": "friction", "settings": {"holds": 3}}, "holds"),
        ({"protocol": "torque-sensor-calibration", "bench": "testbed"}, "asks the operator; run it by: leactl run"),
    ],
)
def test_what_cannot_be_run_is_refused_with_the_sentence_of_the_command(tmp_path, words, fault):
    with pytest.raises(InputError, match=fault):
        leactl.run_protocol(**words, out=tmp_path)
    assert list(tmp_path.glob("*.h5")) == []
