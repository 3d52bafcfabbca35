"""A run in one process meets an emulated bench in another, as two shells would start them."""

import json
import signal
import subprocess

import can
import h5py
import numpy as np
import pytest
import yaml

from leactl.bench import benchfile
from leactl.bench.benchfile import I2cBus
from leactl.driver.far_end import I2cEmulator
from leactl.emulation.bench.emulated_bench import EmulatedBench
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.wires.buses import CanWire, EmulatedI2cBus
from leactl.emulation.wires.serving import CanBridge, stub_bus, stub_chips
from leactl.errors import InputError
from tests.cli.terminal import COMMAND
from tests.driver.transports import CAN, I2C, can_place, i2c_place
from tests.runner.conftest import SPIN

PLACES = [
    pytest.param(place, marks=[pytest.mark.long] if place == "udp_multicast" else [])
    for place in ("udp_multicast", "pty", "kernel")
    if place == "pty" or place in CAN
]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    (tmp_path / "spin.yaml").write_text(SPIN)
    return tmp_path


@pytest.fixture(params=PLACES)
def place(request):
    return request.param


@pytest.fixture
def served(here, place):
    """The bench's process, and the options with which a run meets it."""
    bench = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
    for role in ("test", "load"):  # other load on the machine may hold up either process
        bench["devices"][f"drive_{role}"]["settings"] |= {"consumer_heartbeat_ms": 1000, "sdo_timeout_s": 1.0}
    bench["limits"] |= {"age_s": 30, "cyclic_age_s": 30}
    seldom = {"in_a_row": 10_000, "share_percent": 99, "window_s": 600}
    bench["interlocks"] = {"clock": {"jump_s": 10}, "loop_overruns": seldom}
    if place == "kernel" and "kernel" in I2C:
        bench["buses"]["i2c1"]["number"] = i2c_place()["number"]
    else:  # without i2c-stub there is no I2C between processes
        del bench["buses"]["i2c1"], bench["devices"]["torque_sensor"]
    if place == "pty":
        bench["buses"]["can0"] |= {"interface": "pty", "options": {"sleep_after_open": 0.0}}
    else:
        bench["buses"]["can0"] |= can_place(place)
    if place == "kernel":  # both processes share the one slow processor of a virtual machine
        (here / "spin.yaml").write_text(SPIN.replace("rate_Hz: 100", "rate_Hz: 10").replace("hold_s: 0.6", "hold_s: 3"))
        for sensor in bench["devices"]["torque_sensor"]["settings"]["inputs"]:
            sensor["rate_sps"] = 8
    (here / "bench.yaml").write_text(yaml.safe_dump(bench))
    process = start("bench", "serve", "bench.yaml", "--setup", "free")
    where = process.stdout.readline().split()
    while process.stdout.readline() != "serving; Ctrl-C ends it\n":
        assert process.poll() is None, process.communicate()
    bus = [f"--bus=can0=slcan:{where[-1]}"] if place == "pty" else []
    yield process, ["--bench", "bench.yaml", "--served", *bus]
    process.kill()
    process.communicate()


def start(*arguments):
    return subprocess.Popen([*COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_a_run_over_a_real_bus_moves_the_served_bench(here, served):
    server, options = served
    run = start("run", "spin.yaml", *options, "--json")
    out, err = run.communicate()
    assert run.returncode == 0, err
    answer = json.loads(out)
    assert answer["status"] == "complete"
    assert all(device["confirmed"] for device in answer["safe"].values())
    with h5py.File(here / answer["run"]) as file:
        velocity = file["streams/loop/test_omega"][:]
        assert np.nanmax(velocity) > 1.0
        if "torque_sensor" in file["streams"]:
            torque = file["streams/torque_sensor/torque"][:]
            assert len(np.unique(torque)) > 3  # each row is a conversion of its own
    server.send_signal(signal.SIGINT)
    _out, err = server.communicate()
    assert (server.returncode, err) == (0, "")


@pytest.mark.parametrize("place", [place for place in PLACES if place.values != ("kernel",)], indirect=True)
def test_a_server_that_dies_fails_the_run_and_nothing_is_called_safe(here, served):
    server, options = served
    run = start("run", "spin.yaml", *options, "--set", "hold_s=60", "--json")
    recorded = None
    while recorded is None:
        assert run.poll() is None, run.communicate()
        recorded = next((path for path in (here / "runs").glob("*") if path.stat().st_size > 0), None)
    server.kill()
    out, err = run.communicate()
    assert run.returncode == 5, err
    assert "NOT CONFIRMED SAFE, switch off the supply" in err
    answer = json.loads(out)
    assert answer["status"] == "failed"
    assert not answer["safe"]["drive_test"]["confirmed"]


def test_only_a_stub_is_ever_written_to(tmp_path):
    adapter = tmp_path / "sys/class/i2c-dev/i2c-1"
    adapter.mkdir(parents=True)
    assert stub_bus(2, tmp_path) is None
    (adapter / "name").write_text("bcm2835 (i2c@7e804000)\n")
    assert stub_bus(1, tmp_path) is None


def test_a_far_end_that_keeps_no_registers_is_not_put_behind_a_stub(monkeypatch):
    class Deaf(I2cEmulator):
        def read(self, register, now):
            return 0

        def write(self, register, value, now): ...

    file, devices, _document = benchfile.load("emulated")
    bench = EmulatedBench(file, devices, "free", "")
    bench.i2c_buses["i2c1"].devices[0x48] = Deaf()
    store = EmulatedI2cBus(EmulatedClock())
    monkeypatch.setattr("leactl.emulation.wires.serving.stub_bus", lambda number: store)
    with pytest.raises(InputError, match="0x48 cannot stand behind i2c-stub"):
        stub_chips(file, bench)
    assert isinstance(file.buses["i2c1"], I2cBus)


class Restless:
    """A real bus on which a frame always waits."""

    taken = 0

    def recv(self, timeout=None):
        assert self.taken < 10_000
        self.taken += 1
        return can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False)


def test_a_host_that_never_pauses_does_not_hold_up_the_bench_s_time():
    real = Restless()
    CanBridge("here", real, CanWire(EmulatedClock())).carry()
    assert real.taken > 0


class Kept:
    """A real bus with these frames of a host; what is sent to it is kept."""

    def __init__(self, *frames):
        self.frames, self.sent = list(frames), []

    def recv(self, timeout=None):
        return self.frames.pop(0) if self.frames else None

    def send(self, msg, timeout=None):
        self.sent.append(msg)


class Echo:
    """A device that answers a frame of either kind with one of that kind."""

    due = float("inf")

    def receive(self, frame, now):
        return [type(frame)(frame.identifier + 1, frame.data)]


def test_can_fd_frames_pass_to_the_far_ends_and_back_as_such():
    wire = CanWire(EmulatedClock())
    wire.attach(Echo())
    long = can.Message(arbitration_id=0x8001, data=bytes(range(64)), is_fd=True, bitrate_switch=True)
    short = can.Message(arbitration_id=0x7FE, data=b"\x07", is_extended_id=False)
    real = Kept(long, short)
    CanBridge("here", real, wire).carry()
    sent = [(m.arbitration_id, m.is_extended_id, m.is_fd, m.bitrate_switch, bytes(m.data)) for m in real.sent]
    assert sent == [(0x8002, True, True, True, bytes(range(64))), (0x7FF, False, False, False, b"\x07")]
