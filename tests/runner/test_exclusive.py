"""Two runs never drive one bench: by its name, and by the buses that its devices hang on."""

import os
import subprocess

import pytest

from leactl.bench import benchfile
from leactl.errors import DeviceError, InputError
from leactl.runner import exclusive
from tests.cli.terminal import leactl
from tests.runner.conftest import SPIN


def real_bench(**changes):
    file, devices, _document = benchfile.load("testbed")
    return file.model_copy(update=changes), devices


def test_a_second_run_is_refused_with_the_process_of_the_first(holder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spin.yaml").write_text(SPIN)
    done = leactl("run", "spin.yaml", "--bench", "testbed", **os.environ)
    assert (done.returncode, done.stdout) == (5, "")
    assert done.stderr == (
        f"leactl: bench 'testbed' is driven by another run, process {holder.pid};"
        " wait for its end, or: leactl bench stop\n"
    )
    assert leactl("run", "spin.yaml", **os.environ).returncode == 0  # emulated in process: nobody else's


def test_another_bench_file_on_the_same_bus_is_refused(holder):
    words = rf"bus 'can0' \(socketcan-can0\) is driven by .* process {holder.pid};"
    with pytest.raises(DeviceError, match=words), exclusive.held(*real_bench(name="other")):
        raise AssertionError


def test_another_bench_on_other_buses_is_not_refused(holder):
    buses = {
        "can0": benchfile.CanBus(kind="can", channel="can7"),
        "i2c1": benchfile.I2cBus(kind="i2c", number=7),
    }
    file, devices = real_bench(name="other")
    with exclusive.held(file.model_copy(update={"buses": file.buses | buses}), devices):
        pass


def test_links_to_one_adapter_are_one_bus(tmp_path):
    (tmp_path / "by-id").symlink_to("/dev/null")
    there = [
        benchfile.CanBus(kind="can", interface="slcan", channel=c) for c in ("/dev/null@115200", f"{tmp_path}/by-id")
    ]
    line = benchfile.SerialBus(kind="serial", port=f"{tmp_path}/by-id")
    assert {exclusive._place(bus) for bus in (*there, line)} == {"/dev/null"}


def test_a_killed_run_lets_go(holder):
    holder.kill()
    holder.wait()
    with exclusive.held(*real_bench()):
        pass
    with exclusive.held(*real_bench()):  # and an orderly one too
        pass


def test_a_process_that_was_handed_the_locks_holds_the_bench_too():
    with exclusive.held(*real_bench()) as locks:
        keeper = subprocess.Popen(["cat"], stdin=subprocess.PIPE, pass_fds=locks)
    with pytest.raises(DeviceError, match="driven by another run"), exclusive.held(*real_bench()):
        raise AssertionError
    keeper.communicate()
    with exclusive.held(*real_bench()):
        pass


def test_no_place_for_locks_is_refused_before_anything_is_touched(monkeypatch):
    monkeypatch.setenv("LEACTL_STATE", "/proc/nowhere")
    with pytest.raises(InputError, match="LEACTL_STATE"), exclusive.held(*real_bench()):
        raise AssertionError
