"""Faults of the emulated bench at the wire: what a host sees of each, when it begins and when it is over."""

import errno
import json
import os
import struct
import subprocess

import can
import numpy as np
import pytest
import yaml

from leactl.bench import benchfile
from leactl.driver.i2c_port import swap_bytes
from leactl.emulation.bench import emulated_bench
from leactl.emulation.bench.emulated_bench import EmulatedBench
from leactl.emulation.faults import check_faults, known_faults
from leactl.emulation.wires.serving import CanBridge
from leactl.errors import InputError
from tests.cli.terminal import COMMAND, leactl
from tests.driver.transports import ROOT

SHIPPED = (benchfile.SHIPPED / "emulated.yaml").read_text()
START_TORQUE = 0x8000 | 0 << 12 | 0 << 9 | 0x0100 | 7 << 5 | 3  # A0-A1, +-6.144 V, single shot, 860 samples/s
COUNTS_PER_NM = 32768 / 6.144 / 3.0
READ = {"statusword": "4041600000000000", "bus_voltage": "4079600000000000", "velocity": "406c600000000000"}


@pytest.fixture
def write(tmp_path):
    """A bench file with these faults; `more` goes into its emulated block."""

    def write(*faults, more=""):
        path = tmp_path / "bench.yaml"
        path.write_text(SHIPPED + more + "".join(["  faults:\n", *(f"    - {fault}\n" for fault in faults)]))
        return path

    return write


@pytest.fixture
def make(write):
    """The emulated bench of such a file."""

    def make(*faults, setup="free", seed=None, more=""):
        file, devices, document = benchfile.load(str(write(*faults, more=more)))
        check_faults(file, devices, document)
        return Bench(file, devices, setup, "design", seed)

    return make


class Bench(EmulatedBench):
    """An emulated bench with a host at its wires."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.bus = self.can("can0", None)()

    def wait(self, until):
        while (now := self.time.now()) < until:  # a device sends by itself once for each step of time
            self.time.sleep_until(min(until, now + 0.001))

    def ask(self, what="statusword", node=1):
        """The value of an SDO upload; None where no answer has come at once."""
        self.heard()
        self.bus.send(can.Message(arbitration_id=0x600 + node, data=bytes.fromhex(READ[what]), is_extended_id=False))
        answers = [data for _time, identifier, data in self.heard() if identifier == 0x580 + node]
        return int.from_bytes(answers[0][4:8], "little") if answers else None

    def download(self, index, value, node=1):
        data = struct.pack("<BHBi", 0x23 if index in (0x1016, 0x60FF) else 0x2B, index, index == 0x1016, value)
        if index == 0x6060:
            data = struct.pack("<BHBi", 0x2F, index, 0, value)
        self.bus.send(can.Message(arbitration_id=0x600 + node, data=data, is_extended_id=False))

    def enable(self, mode, node=1):
        self.download(0x6060, mode, node)
        for word in (0x06, 0x07, 0x0F):
            self.download(0x6040, word, node)

    def heartbeat_every(self, milliseconds, node=1):
        self.download(0x1017, milliseconds, node)
        self.heard()

    def heard(self):
        """Frames that have come in, without any wait."""
        results = []
        while (message := self.bus.recv(0.0)) is not None:
            results.append((message.timestamp, message.arbitration_id, bytes(message.data)))
        return results

    def torque_code(self):
        """One conversion of the torque sensor."""
        chip = self.i2c_buses["i2c1"]
        chip.write_word_data(0x48, 1, swap_bytes(START_TORQUE))
        self.wait(self.time.now() + 0.002)
        code = swap_bytes(chip.read_word_data(0x48, 0))
        return code - 0x10000 if code & 0x8000 else code


# -- a CAN bus ---------------------------------------------------------------------------------------------------------


def test_lost_frames_arrive_neither_way_until_the_fault_is_over(make):
    bench = make("{fault: lost_frames, at_s: 1, for_s: 0.5, bus: can0}")
    bench.wait(0.999)
    assert bench.ask() is not None
    bench.wait(1.0)
    bench.download(0x6060, 9)
    assert bench.ask() is None
    assert bench.far_ends["drive_test"]._values[0x6060, 0] == 0
    bench.wait(1.5)
    assert bench.ask() is not None


@pytest.mark.parametrize(("direction", "obeyed", "beats"), [("to_host", True, 0), ("to_devices", False, 10)])
def test_frames_lost_one_way_go_the_other(make, direction, obeyed, beats):
    bench = make(f"{{fault: lost_frames, at_s: 1, bus: can0, direction: {direction}}}")
    bench.heartbeat_every(10)
    bench.wait(1.0)
    bench.heard()
    bench.download(0x6060, 9)
    assert (bench.far_ends["drive_test"]._values[0x6060, 0] == 9) is obeyed
    bench.wait(1.1)
    assert len(bench.heard()) == pytest.approx(beats, abs=1)


def test_a_share_of_lost_frames_is_drawn_from_the_seed(make):
    def answered(seed):
        bench = make("{fault: lost_frames, at_s: 0, bus: can0, share: 0.5, direction: to_host}", seed=seed)
        return [bench.ask() is not None for _ in range(400)]

    first = answered(1)
    assert sum(first) == pytest.approx(200, abs=40)  # four standard deviations
    assert answered(1) == first
    assert answered(2) != first


def test_late_frames_arrive_as_late_as_they_were_told_to_and_in_order(make):
    bench = make("{fault: late_frames, at_s: 1, for_s: 1, bus: can0, delay_s: 0.0203, direction: to_host}")
    bench.wait(1.0)
    bench.heard()
    for what in ("statusword", "bus_voltage"):
        bench.bus.send(can.Message(arbitration_id=0x601, data=bytes.fromhex(READ[what]), is_extended_id=False))
    assert bench.heard() == []
    times, objects = [], []
    while len(times) < 2:
        message = bench.bus.recv(0.1)
        times.append(message.timestamp)
        objects.append(bytes(message.data[1:3]))
    assert times == [pytest.approx(1.0203, abs=0.001)] * 2  # a host looks once a millisecond
    assert objects == [b"\x41\x60", b"\x79\x60"]
    bench.wait(2.0)
    assert bench.ask() is not None


def test_bus_off_refuses_what_is_sent_and_lets_nothing_in(make):
    bench = make("{fault: bus_off, at_s: 1, for_s: 0.5, bus: can0}")
    bench.heartbeat_every(10)
    bench.wait(1.0)
    bench.heard()
    with pytest.raises(can.CanOperationError) as refused:
        bench.ask()
    assert refused.value.error_code == errno.ENOBUFS
    bench.wait(1.49)
    assert bench.heard() == []
    bench.wait(1.5)
    assert bench.ask() is not None


class RealBus:
    """A real bus whose host asks for the statusword again and again."""

    def __init__(self):
        self.sent = []

    def recv(self, timeout=None):
        self.asked = not getattr(self, "asked", False)
        data = bytes.fromhex(READ["statusword"])
        return can.Message(arbitration_id=0x601, data=data, is_extended_id=False) if self.asked else None

    def send(self, message):
        self.sent.append(message.arbitration_id)


def test_a_served_bench_loses_what_is_sent_to_a_bus_that_is_off(make):
    bench, real = make("{fault: bus_off, at_s: 1, for_s: 0.5, bus: can0}"), RealBus()
    bridge = CanBridge("here", real, bench.wires["can0"])
    answered = []
    for moment in (0.9, 1.0, 1.5):
        bench.wait(moment)
        real.sent.clear()
        bridge.carry()
        answered.append(0x581 in real.sent)
    assert answered == [True, False, True]


def test_a_served_bench_has_its_faults_and_says_which_are_not_its_own(tmp_path):
    bench = yaml.safe_load(SHIPPED)
    # there is no I2C between processes
    del bench["buses"]["i2c1"], bench["devices"]["torque_sensor"], bench["interlocks"]
    bench["buses"]["can0"] |= {"interface": "pty", "options": {"sleep_after_open": 0.0}}
    for role in ("test", "load"):
        bench["devices"][f"drive_{role}"]["settings"]["sdo_timeout_s"] = 1.0
    bench["emulated"]["faults"] = [
        {"fault": "drive_fault", "at_s": 0, "device": "drive_load", "code": "0x7381"},
        {"fault": "clock_jump", "at_s": 0, "jump_s": 1},
    ]
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(bench))
    command = [*COMMAND, "bench", "serve", path, "--setup", "coupled"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        bus = f"--bus=can0=slcan:{server.stdout.readline().split()[-1]}"
        assert server.stdout.readline() == "serving; Ctrl-C ends it\n"
        run = ("run", "friction", "--bench", path, "--served", bus, "--out", tmp_path)
        done = leactl(*run, **os.environ | {"LEACTL_STATE": str(tmp_path)})
    finally:
        server.kill()
        _out, err = server.communicate()
    assert (done.returncode, done.stdout) == (5, ""), done.stderr
    assert "drive_load: in fault at start, " in done.stderr
    assert "0x7381 (two Hall sensors changed at once)" in done.stderr
    assert err == "fault clock_jump: nothing happens, the clock is that of the run's own process\n"


# -- sensors -----------------------------------------------------------------------------------------------------------


def test_a_stuck_sensor_repeats_one_code_and_comes_back(make):
    bench = make("{fault: stuck_sensor, at_s: 1, for_s: 1, device: torque_sensor, quantity: torque}")
    assert len({bench.torque_code() for _ in range(50)}) > 10
    bench.wait(1.0)
    assert len({bench.torque_code() for _ in range(50)}) == 1
    bench.wait(2.0)
    assert len({bench.torque_code() for _ in range(50)}) > 10


def test_a_noisy_sensor_has_the_spread_that_was_asked_for(make):
    bench = make("{fault: noisy_sensor, at_s: 0, device: torque_sensor, quantity: torque, spread: 1.5, unit: N*m}")
    codes = [bench.torque_code() for _ in range(400)]
    assert np.std(codes) / COUNTS_PER_NM == pytest.approx(1.5, rel=0.15)  # four standard deviations


@pytest.mark.parametrize(("end", "code"), [("high", 0x7FFF), ("low", -0x8000)])
def test_a_saturated_sensor_gives_the_code_at_the_end_of_the_range(make, end, code):
    bench = make(f"{{fault: saturated_sensor, at_s: 1, device: torque_sensor, quantity: torque, end: {end}}}")
    assert abs(bench.torque_code()) < 100
    bench.wait(1.0)
    assert bench.torque_code() == code


def test_a_sensor_unplugged_from_its_converter_reads_zero(make):
    bench = make("{fault: disconnected_sensor, at_s: 1, device: torque_sensor, quantity: torque}")
    bench.wait(1.0)
    assert {bench.torque_code() for _ in range(20)} == {0}


def test_a_converter_unplugged_from_its_bus_does_not_acknowledge(make):
    bench = make("{fault: disconnected_sensor, at_s: 1, for_s: 1, device: torque_sensor}")
    bench.wait(1.0)
    with pytest.raises(OSError, match="Remote I/O error") as refused:
        bench.torque_code()
    assert refused.value.errno == errno.EREMOTEIO
    bench.wait(2.0)
    bench.torque_code()


def test_a_stuck_encoder_of_a_drive_tells_the_velocity_of_before_while_the_rotor_stops(make):
    bench = make("{fault: stuck_sensor, at_s: 1, device: drive_test, quantity: velocity}")
    bench.download(0x60FF, 60000)  # 9.4 rad/s
    bench.enable(9)
    bench.wait(1.0)
    bus_sync(bench)
    bench.download(0x6040, 0)
    bench.wait(3.0)
    bus_sync(bench)
    assert bench.rig.actuators["test"].velocity_true == 0.0
    assert bench.ask("velocity") == pytest.approx(60000, rel=0.05)


def bus_sync(bench):
    """Have the drive sample, as every SYNC does."""
    bench.bus.send(can.Message(arbitration_id=0x000, data=b"\x01\x00", is_extended_id=False))
    bench.bus.send(can.Message(arbitration_id=0x080, data=b"", is_extended_id=False))


# -- drives ------------------------------------------------------------------------------------------------------------


def test_a_frozen_drive_turns_on_unheard_and_finds_its_host_gone_when_it_wakes(make):
    bench = make("{fault: frozen_drive, at_s: 1, for_s: 1, device: drive_test}")
    bench.download(0x1016, 127 << 16 | 200)
    bench.download(0x6071, 100)  # 1.37 A
    bench.enable(10)
    bench.heartbeat_every(10)
    bench.wait(0.95)
    bench.bus.send(can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False))
    bench.wait(1.0)
    bench.heard()
    assert bench.ask() is None
    bench.wait(1.99)  # long after the consumer time
    assert bench.heard() == []
    assert bench.rig.actuators["test"].current_true == pytest.approx(1.37, abs=0.01)
    bench.wait(2.001)
    assert bench.rig.actuators["test"].mode == "off"
    assert (0x081, bytes.fromhex("3081110000000000")) in [frame[1:] for frame in bench.heard()]


def test_a_drive_fault_takes_the_power_away_and_tells_its_code(make):
    bench = make("{fault: drive_fault, at_s: 1, device: drive_test, code: 0x3310}")
    bench.download(0x6071, 100)  # 1.37 A
    bench.enable(10)
    bench.wait(0.999)
    assert bench.rig.actuators["test"].mode == "current"
    bench.heard()
    bench.wait(1.001)
    assert bench.rig.actuators["test"].mode == "off"
    assert [frame[1:] for frame in bench.heard()] == [(0x081, bytes.fromhex("1033010000000000"))]
    bus_sync(bench)
    assert bench.ask() & 0x4F == 0x08


@pytest.mark.parametrize(("answers", "heard"), [("false", True), ("true", False)])
def test_a_drive_without_heartbeat_goes_on(make, answers, heard):
    bench = make(f"{{fault: heartbeat_loss, at_s: 1, for_s: 1, device: drive_test, answers: {answers}}}")
    bench.heartbeat_every(10, node=1)
    bench.heartbeat_every(10, node=2)
    bench.download(0x6071, 100)  # 1.37 A
    bench.enable(10)
    bench.wait(1.0)
    bench.heard()
    bench.wait(1.5)
    assert {identifier for _time, identifier, _data in bench.heard()} == {0x702}
    assert (bench.ask() is not None) is heard
    assert bench.rig.actuators["test"].current_true == pytest.approx(1.37, abs=0.01)
    bench.wait(2.1)
    assert {identifier for _time, identifier, _data in bench.heard()} == {0x701, 0x702}


# -- supply, clock, disk -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("more", ["", "  effects: [{name: stribeck}]\n"], ids=["rig", "stepped"])
@pytest.mark.parametrize(("fault", "volts", "reached"), [("under_voltage", 12, 16), ("over_voltage", 75, 30)])
def test_the_drive_tells_the_voltage_and_the_rotor_feels_it(make, more, fault, volts, reached):
    """At 12 V no more than 12 V / sqrt(2) / 0.49 V*s/rad = 17.3 rad/s, of which friction takes a part."""
    bench = make(f"{{fault: {fault}, at_s: 1, for_s: 1, bus_voltage_V: {volts}}}", more=more)
    bench.download(0x60FF, 190986)  # 30 rad/s
    bench.enable(9)
    told, turning = [], []
    for moment in (1.0, 2.0, 3.0):
        bench.wait(moment - 0.001)
        bus_sync(bench)
        told.append(bench.ask("bus_voltage"))
        turning.append(bench.rig.actuators["test"].velocity_true)
    assert told == [29600, volts * 1000, 29600]
    assert turning == [pytest.approx(30, rel=0.02), pytest.approx(reached, rel=0.08), pytest.approx(30, rel=0.06)]


def test_a_second_sag_has_a_voltage_of_its_own(make):
    deep, shallow = "at_s: 1, for_s: 1, bus_voltage_V: 12", "at_s: 3, for_s: 1, bus_voltage_V: 18"
    bench = make(f"{{fault: under_voltage, {deep}}}", f"{{fault: under_voltage, {shallow}}}")
    bench.download(0x60FF, 190986)
    bench.enable(9)
    turning = []
    for moment in (2.0, 4.0):
        bench.wait(moment - 0.001)
        turning.append(bench.rig.actuators["test"].velocity_true)
    assert turning[1] / turning[0] == pytest.approx(18 / 12, rel=0.05)


def test_a_fault_begins_at_its_moment_however_long_the_host_waits(make):
    bench = make("{fault: drive_fault, at_s: 1, device: drive_test, code: 0x2340}")
    bench.download(0x6071, 100)
    bench.enable(10)
    bench.time.sleep_until(4.0)
    assert bench.rig.actuators["test"].velocity_true == 0.0  # it has had three seconds to come to rest


def test_a_clock_jump_is_the_host_s_alone(make):
    bench = make("{fault: clock_jump, at_s: 1, jump_s: -0.25}")
    bench.clock.sleep_until(1.0)
    assert (bench.clock.now(), bench.time.now()) == (0.75, 1.0)
    bench.clock.sleep_until(1.0)
    assert (bench.clock.now(), bench.time.now(), bench.rig.time) == (1.0, 1.25, 1.25)


@pytest.mark.parametrize("jump", [-1.0, 0.1, 12.3])
def test_no_wait_is_held_up_by_what_a_jump_rounds_off(make, jump):
    bench = make(f"{{fault: clock_jump, at_s: 1, jump_s: {jump}}}")
    bench.wait(1.0)
    for step in range(1, 400):
        moment = bench.clock.now() + step / 997
        bench.clock.sleep_until(moment)
        assert bench.clock.now() >= moment
    bench.heard()
    before = bench.time.now()
    bench.bus.recv(1e-17)
    assert bench.time.now() > before


def test_a_slow_disk_delays_each_write_while_it_lasts(make, monkeypatch):
    waited = []
    monkeypatch.setattr(emulated_bench.time, "sleep", waited.append)
    bench = make("{fault: slow_disk, at_s: 1, for_s: 1, delay_s: 2.5}")
    for moment in (0.5, 1.5, 2.5):
        bench.wait(moment)
        bench.wait_for_disk()
    assert waited == [2.5]


# -- bench files -------------------------------------------------------------------------------------------------------


# tests/emulation/test_supply_feeds_the_bench.py, tests/runner/test_serial_runs.py
ELSEWHERE = ("supply_stuck_on", "supply_out_of_regulation", "cut_line")


def test_every_fault_is_taken_as_its_own_example_says_and_is_in_the_documentation(make):
    known = known_faults()
    make(*(fault.example for name, fault in known.items() if name not in ELSEWHERE))
    table = (ROOT / "docs" / "how-to" / "faults.md").read_text()
    assert [name for name in known if f"| `{name}` |" not in table] == []


AT = "fault: stuck_sensor, at_s: 1, device"


@pytest.mark.parametrize(
    ("entry", "place", "words"),
    [
        ("{fault: gremlins, at_s: 1}", "fault", "fault 'gremlins' is not known; known: bus_off, clock_jump, "),
        ("{at_s: 1}", "fault", "is required and missing"),
        ("{fault: bus_off, bus: can0}", "at_s", "is required and missing"),
        ("{fault: bus_off, at_s: -1, bus: can0}", "at_s", "-1: 0 or more was expected"),
        ("{fault: bus_off, at_s: 1, for_s: 0, bus: can0}", "for_s", "0: more than 0 was expected"),
        ("{fault: bus_off, at_s: soon, bus: can0}", "at_s", "'soon': a number was expected"),
        ("{fault: bus_off, at_s: 1, bus: can1}", "bus", "'can1' is no CAN bus of the bench; it has can0"),
        ("{fault: lost_frames, at_s: 1, bus: i2c1}", "bus", "'i2c1' is no CAN bus of the bench; it has can0"),
        ("{fault: lost_frames, at_s: 1, bus: can0, share: 1.5}", "share", "at most 1"),
        ("{fault: bus_off, at_s: 1, bus: can0, share: 1}", "share", "unknown key"),
        ("{fault: drive_fault, at_s: 1, for_s: 1, device: drive_test, code: 0x2340}", "for_s", "unknown key"),
        ("{fault: drive_fault, at_s: 1, device: drive_test, code: 0x10000}", "code", "at most 65535"),
        ("{fault: drive_fault, at_s: 1, device: drive_test, code: 0xxx}", "code", "a whole number was expected"),
        (f"{{{AT}: drive_third, quantity: torque}}", "device", "'drive_third' is no device of the bench; it has drive"),
        (f"{{{AT}: torque_sensor, quantity: angle}}", "quantity", "torque_sensor reads no angle; it has torque"),
        ("{fault: frozen_drive, at_s: 1, device: torque_sensor}", "device", "'torque_sensor' is no drive that can"),
        ("{fault: heartbeat_loss, at_s: 1, device: torque_sensor}", "device", "'torque_sensor' is not on a CAN bus"),
        ("{fault: disconnected_sensor, at_s: 1, device: drive_test}", "device", "'drive_test' is not on an I2C bus"),
        ("{fault: supply_stuck_on, at_s: 1, device: drive_test}", "device", "'drive_test' is no power supply that can"),
        ("{fault: supply_out_of_regulation, at_s: 1, device: supply, share: 2}", "share", "at most 1"),
        ("{fault: scaled_sensor, at_s: 1, device: torque_sensor, quantity: torque, gain: .nan}", "gain", "finite"),
        ("{fault: over_voltage, at_s: 1, bus_voltage_V: 24}", "bus_voltage_V", "24 V is not above the bench's 29.6 V"),
        ("{fault: under_voltage, at_s: 1, bus_voltage_V: 48}", "bus_voltage_V", "48 V is not below the bench's 29.6 V"),
        (
            "{fault: saturated_sensor, at_s: 1, device: drive_test, quantity: velocity}",
            "quantity",
            "velocity comes from an encoder, which has no end of its range",
        ),
        (
            "{fault: noisy_sensor, at_s: 1, device: torque_sensor, quantity: torque, spread: 1, unit: A}",
            "unit",
            "torque is in N*m, not in A",
        ),
    ],
)
def test_a_fault_that_does_not_fit_is_one_line_with_its_place(make, tmp_path, entry, place, words):
    with pytest.raises(InputError) as caught:
        make("{fault: slow_disk, at_s: 1, delay_s: 1}", entry)
    (line,) = caught.value.faults
    number = len(SHIPPED.splitlines()) + 3
    assert line.startswith(f"{tmp_path}/bench.yaml:{number}:")
    assert f"emulated.faults[1].{place}: " in line
    assert words in line


@pytest.mark.parametrize("command", [["bench", "check"], ["bench", "serve"], ["run", "friction", "--bench"]])
def test_the_command_line_refuses_it_with_status_2(write, tmp_path, command):
    path = write("{fault: stuck_sensor, at_s: 1, device: drive_third, quantity: velocity}")
    done = leactl(*command, path)
    assert (done.returncode, done.stdout) == (2, "")
    assert "emulated.faults[0].device: 'drive_third' is no device of the bench" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_the_command_line_lists_and_explains_the_catalogue():
    listed = leactl("bench", "faults")
    assert [line.split()[0] for line in listed.stdout.splitlines()] == sorted(known_faults())
    output = leactl("bench", "faults", "late_frames").stdout
    assert "  delay_s " in output
    assert "    - {fault: late_frames, at_s: 2, " in output
    (row,) = json.loads(leactl("bench", "faults", "bus_off", "--json").stdout)["faults"]
    assert set(row["parameters"]) == {"at_s", "for_s", "bus"}
    unknown = leactl("bench", "faults", "gremlins")
    assert (unknown.returncode, unknown.stdout) == (2, "")


def test_a_fault_that_is_to_come_changes_nothing_yet(make):
    later = "{fault: noisy_sensor, at_s: 100, device: torque_sensor, quantity: torque, spread: 1, unit: N*m}"
    planned, plain = make(later), make("{fault: slow_disk, at_s: 0, delay_s: 1}")
    assert [planned.torque_code() for _ in range(100)] == [plain.torque_code() for _ in range(100)]
