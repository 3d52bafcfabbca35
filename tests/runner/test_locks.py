"""Two runs never drive one bench: by its name, and by the buses that its devices hang on."""

import os
import subprocess
from pathlib import Path

import pytest

from leactl.bench import benchfile
from leactl.errors import DeviceError, InputError
from leactl.runner import locks
from tests.cli.terminal import leactl
from tests.runner.conftest import SPIN


@pytest.fixture
def real_bench(testbed):
    def loaded(**changes):
        file, devices, _document = benchfile.load(str(testbed))
        return file.model_copy(update=changes), devices

    return loaded


def test_a_second_run_is_refused_with_the_process_of_the_first(testbed, holder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spin.yaml").write_text(SPIN)
    done = leactl("run", "spin.yaml", "--bench", testbed, **os.environ)
    assert (done.returncode, done.stdout) == (5, "")
    assert done.stderr == (
        f"leactl: bench 'testbed-{os.getpid()}' is driven by another run, process {holder.pid};"
        " wait for its end, or: leactl bench stop\n"
    )
    assert leactl("run", "spin.yaml", **os.environ).returncode == 0  # emulated in process: nobody else's


def test_another_bench_file_on_the_same_bus_is_refused(holder, real_bench):
    words = rf"bus 'can0' \(socketcan-can{os.getpid()}\) is driven by .* process {holder.pid};"
    with pytest.raises(DeviceError, match=words), locks.held(*real_bench(name="other")):
        raise AssertionError


def test_another_bench_on_other_buses_is_not_refused(holder, real_bench):
    buses = {
        "can0": benchfile.CanBus(kind="can", channel=f"can{os.getpid()}-other"),
        "i2c1": benchfile.I2cBus(kind="i2c", number=7),
    }
    file, devices = real_bench(name="other")
    with locks.held(file.model_copy(update={"buses": file.buses | buses}), devices):
        pass


def test_two_benches_do_not_take_their_exports_from_one_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    told = (Path(benchfile.__file__).parent / "files" / "emulated-heated.yaml").read_text()
    loaded = []
    for name in ("one", "other"):
        (tmp_path / f"{name}.yaml").write_text(told.replace("name: emulated-heated", f"name: {name}"))
        file, devices, _document = benchfile.load(f"{name}.yaml")
        port = benchfile.SerialBus(kind="serial", port=f"/dev/ttyUSB{len(loaded)}")
        loaded.append((file.model_copy(update={"buses": {"supply0": port}}), devices))
    words = r"the folder .*camera of 'camera' is driven by another run"
    with locks.held(*loaded[0]), pytest.raises(DeviceError, match=words), locks.held(*loaded[1]):
        raise AssertionError


def test_links_to_one_adapter_are_one_bus(tmp_path):
    (tmp_path / "by-id").symlink_to("/dev/null")
    there = [
        benchfile.CanBus(kind="can", interface="slcan", channel=c) for c in ("/dev/null@115200", f"{tmp_path}/by-id")
    ]
    line = benchfile.SerialBus(kind="serial", port=f"{tmp_path}/by-id")
    assert {locks._bus_key(bus) for bus in (*there, line)} == {("device-1-3", "/dev/null")}


def test_a_default_that_is_written_out_is_the_same_bus():
    bus = benchfile.CanBus(kind="can", interface="udp_multicast", channel="239.74.163.2")
    assert locks._bus_key(bus) == locks._bus_key(bus.model_copy(update={"options": {"port": 43113}}))
    lo = benchfile.CanBus(kind="can", channel="lo")
    assert locks._bus_key(lo)[0] == "socketcan-lo"


def test_a_killed_run_lets_go(holder, real_bench):
    holder.kill()
    holder.wait()
    with locks.held(*real_bench()):
        pass
    with locks.held(*real_bench()):  # and an orderly one too
        pass


def test_a_process_that_was_handed_the_locks_holds_the_bench_too(real_bench):
    with locks.held(*real_bench()) as descriptors:
        keeper = subprocess.Popen(["cat"], stdin=subprocess.PIPE, pass_fds=descriptors)
    with pytest.raises(DeviceError, match="driven by another run"), locks.held(*real_bench()):
        raise AssertionError
    keeper.communicate()
    with locks.held(*real_bench()):
        pass


@pytest.mark.parametrize("name", ["LEACTL_STATE", "LEACTL_MACHINE_STATE", "HOME", "XDG_STATE_HOME", "TMPDIR"])
def test_no_variable_leads_around_the_lock_of_a_real_bench(holder, real_bench, monkeypatch, tmp_path, name):
    monkeypatch.setenv(name, str(tmp_path / "elsewhere"))
    with pytest.raises(DeviceError, match=f"process {holder.pid};"), locks.held(*real_bench()):
        raise AssertionError
    with pytest.raises(DeviceError, match=f"process {holder.pid};"), locks.held(*real_bench(name="other")):
        raise AssertionError


def test_a_lock_that_was_asked_for_too_often_still_holds(holder, real_bench, monkeypatch):
    monkeypatch.setattr(locks, "_holder_text", lambda _name: "process unknown")
    with pytest.raises(DeviceError, match="process unknown; wait for its end"), locks.held(*real_bench()):
        raise AssertionError


def test_a_folder_s_lock_empties_no_link_s_target_and_waits_for_no_pipe(tmp_path):
    target = tmp_path / "precious"
    target.write_text("kept")
    (tmp_path / "link").symlink_to(target)
    os.mkfifo(tmp_path / "pipe")
    for name in ("link", "pipe"):
        with pytest.raises(InputError, match="no lock can be kept here"), locks.locked(tmp_path / name, "taken"):
            raise AssertionError
    assert target.read_text() == "kept"
