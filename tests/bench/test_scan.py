"""Scans at emulated wires: who is recognised, and that nothing but harmless reads is ever sent."""

import re
from pathlib import Path

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from leactl_plugins.scpi_supply.emulator import ScpiSupplyEmulator
from leactl_plugins.scpi_supply.models import OUTPUTS, dialect_of

from leactl.bench.benchfile import SerialBus
from leactl.bench.scan import (
    LISTEN_S,
    LONGEST_PROBE_S,
    Watcher,
    WireReport,
    ask_can,
    ask_i2c,
    ask_line,
    can_probes,
    i2c_probes,
    line_probes,
    rates_of,
    settings_left_open,
)
from leactl.driver import registry
from leactl.driver.conversation import Unreadable
from leactl.driver.far_end import FdFrame, Frame
from leactl.driver.probe import CanProbe, I2cProbe, LineProbe, Sighting
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.trial.known_bench import KnownBench
from leactl.emulation.wires.buses import CanWire, EmulatedCanBus, EmulatedI2cBus
from leactl.emulation.wires.serial import EmulatedSerialLine, SerialWire
from leactl.errors import DeviceError, Stopped

QUIET = Watcher(lambda _text: None, lambda: None)
CAN, I2C, LINES = can_probes(), i2c_probes(), line_probes("serial")
READ = 0x10  # kind of a moteus subframe


class Tap:
    """A connection with a tape of what the host sent."""

    def __init__(self, bus, tape):
        self._bus, self._tape = bus, tape

    def send(self, message, timeout=None):
        kind = FdFrame if message.is_fd else Frame
        self._tape.append(kind(message.arbitration_id, bytes(message.data)))
        self._bus.send(message, timeout)

    def __getattr__(self, name):
        return getattr(self._bus, name)


class Speaker:
    """A device that says what a test tells it to: by itself, and to what it hears."""

    def __init__(self, frames=(), every_s=0.1, answer=lambda frame: ()):
        self._frames, self._every_s, self._answer = list(frames), every_s, answer
        self.due = 0.0 if self._frames else float("inf")

    def tick(self, now):
        self.due = now + self._every_s
        return self._frames

    def receive(self, frame, now):
        return list(self._answer(frame))


class CanBench:
    """An emulated bus with devices of any drivers."""

    def __init__(self):
        self.clock = EmulatedClock()
        self.wire, self.physics = CanWire(self.clock), KnownBench(self.clock)
        self.tape, self.report = [], WireReport("can0")

    def place(self, driver, **given):
        kind = registry.load(driver)
        far = kind.far_end(kind.Settings(**{**kind.example, **given}), "test", self.physics)
        self.wire.attach(far)
        return far

    def scan(self, fd=False, probes=None, watcher=QUIET):
        connect = lambda: Tap(EmulatedCanBus(self.wire), self.tape)  # noqa: E731
        ask_can(self.report, connect, self.clock, probes or CAN, watcher, fd)
        assert self.clock.now() < LISTEN_S + LONGEST_PROBE_S
        return self.report

    def seen(self):
        return [(each.driver, each.sighting.address) for each in self.report.answered if each.sighting.settings]


@pytest.fixture
def bench():
    made = CanBench()
    yield made
    assert [frame for frame in made.tape if not is_harmless(frame)] == []
    assert not made.wire.hosts  # the bus is let go


def is_harmless(frame):
    """Whether a frame is one of those that a scan may send; by the standards' numbers alone."""
    identifier, data = frame
    if isinstance(frame, FdFrame):
        return 0x8001 <= identifier <= 0x807E and reads_only(data)
    if 0x601 <= identifier <= 0x67F and len(data) == 8:
        return data[0] in (0x40, 0x60, 0x70)  # initiate an upload, and go on with it
    return identifier & 0x1F == 0 and not data and identifier != 0x080  # ODrive: the version, which is no SYNC


def reads_only(data):
    place = 0
    while place < len(data):
        kind, place = data[place], place + 1
        if kind == 0x50:
            continue
        if kind & 0xF0 != READ:
            return False
        place += 0 if kind & 3 else 1  # how many
        while data[place] & 0x80:
            place += 1
        place += 1  # the register
    return True


def test_the_frames_that_move_something_are_not_called_harmless():
    nmt, sync, pdo, download = (
        (0x000, b"\x01\x00"),
        (0x080, b""),
        (0x201, b"\x0f\0"),
        (0x601, b"\x2b\x40\x60\0\x0f\0\0\0"),
    )
    stop = FdFrame(0x8003, bytes.fromhex("01000a1110"))
    assert not any(is_harmless(Frame(*each)) for each in (nmt, sync, pdo, download))
    assert not is_harmless(stop)


# -- CAN -------------------------------------------------------------------------------------------------------------


def test_two_drives_of_one_kind_and_one_of_another_are_told_apart(bench):
    bench.place("elmo_can", node=1)
    bench.place("elmo_can", node=5)
    bench.place("odrive_can", node=3)
    report = bench.scan()
    assert bench.seen() == [("elmo_can", 1), ("elmo_can", 5), ("odrive_can", 3)]
    first = report.answered[0].sighting
    assert first.identity == ("Gold DC Whistle, hardware 1.0", "1", "Whistle 01.01.16.00 08Mar2018G")
    assert first.detail == "vendor 0x0000009A, product 0x00030923, revision 0x000103F6"
    assert report.answered[2].sighting.identity.firmware == "0.6.11"
    asked = {frame.identifier for frame in bench.tape if frame.data[:4] == bytes.fromhex("40001000")}
    assert asked == set(range(0x601, 0x680))


def test_a_controller_on_can_fd_is_asked_where_nothing_classic_is_there(bench):
    bench.place("moteus_can", node=7)
    bench.scan(fd=True)
    assert bench.seen() == [("moteus_can", 7)]
    assert bench.report.answered[0].sighting.identity.model.startswith("moteus, model 0x")


def test_no_can_fd_frame_is_sent_where_a_classic_device_would_take_it_for_an_error(bench):
    bench.place("elmo_can", node=1)
    bench.place("moteus_can", node=7)
    report = bench.scan(fd=True)
    assert bench.seen() == [("elmo_can", 1)]
    assert not any(isinstance(frame, FdFrame) for frame in bench.tape)
    assert any("errors to the classic devices" in note for note in report.notes)


@pytest.mark.parametrize("node", [0, 4, 17])  # whose questions have the identifier of NMT, SYNC and node 32's RPDO1
def test_an_odrive_is_not_asked_by_what_a_canopen_device_takes_for_a_command(bench, node):
    bench.place("odrive_can", node=node)
    bench.place("elmo_can", node=32)
    bench.scan()
    assert bench.seen() == [("elmo_can", 32), ("odrive_can", node)]
    assert node << 5 not in {frame.identifier for frame in bench.tape}


def test_frames_that_may_be_of_either_protocol_are_told_and_nobody_is_asked_for_them(bench):
    bench.place("odrive_can", node=16)  # whose heartbeat has the identifier of node 1's RPDO1
    bench.place("elmo_can", node=1)
    report = bench.scan()
    assert bench.seen() == [("elmo_can", 1)]
    assert any("node 16: what may be an ODrive's heartbeat" in note for note in report.notes)


def test_an_odrive_whose_question_is_a_sync_is_heard_alone(bench):
    bench.place("odrive_can", node=4)
    bench.scan()
    sighting = bench.report.answered[0].sighting
    assert (sighting.address, sighting.identity.firmware) == (4, "")
    assert "heard by its heartbeat" in sighting.detail


def test_no_node_is_asked_on_identifiers_that_an_odrive_takes_for_commands(bench):
    bench.place("odrive_can", node=48)  # 0x600 to 0x61F: 0x602 stops it, 0x607 sets its state
    report = bench.scan()
    assert bench.seen() == [("odrive_can", 48)]
    assert any("nodes 1, 2, 3" in note and "not asked by SDO" in note for note in report.notes)
    assert not [frame for frame in bench.tape if 0x600 < frame.identifier < 0x620]


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (Frame(0x080, b""), "CANopen's SYNC"),
        (Frame(0x000, b"\x01\x00"), "network management"),
        (Frame(0x602, bytes.fromhex("4041600000000000")), "an SDO request to node 2"),
        (FdFrame(0x8005, bytes.fromhex("01000a")), "the moteus at node 5"),
    ],
)
def test_where_another_host_is_at_work_nothing_is_sent(bench, frame, words):
    bench.place("elmo_can", node=1)
    bench.wire.attach(Speaker([frame]))
    report = bench.scan(fd=True)
    assert bench.tape == []
    assert words in report.notes[0]
    assert report.notes[0].startswith("only listened: another host is at work")
    assert "heard, and not asked: elmo_can at 1" in report.notes
    assert not report.asked


def test_a_host_that_commands_an_odrive_is_heard(bench):
    bench.place("odrive_can", node=3)
    bench.wire.attach(Speaker([Frame(3 << 5 | 0x0D, bytes(8))]))
    assert "a command to the ODrive at node 3" in bench.scan().notes[0]
    assert bench.tape == []


def test_a_host_that_begins_meanwhile_ends_the_questions(bench):
    def begins(frame):
        return [Frame(0x080, b"")] if frame.identifier == 0x601 else ()

    bench.place("odrive_can", node=3)
    bench.wire.attach(Speaker(answer=begins))
    report = bench.scan()
    assert any(note.startswith("only listened from then on: another host") for note in report.notes)
    assert {frame.identifier >> 7 for frame in bench.tape} == {0x600 >> 7}  # the ODrive was not asked any more


@pytest.mark.parametrize("times", [1, 9], ids=["one frame too many", "to each question"])
def test_an_answer_of_an_odrive_that_comes_twice_is_asked_for_again(bench, times):
    bench.place("odrive_can", node=3)
    doubled = [1] * times

    def again(frame):
        return [Frame(3 << 5, bytes.fromhex("02050200 00060B00"))] if frame == (3 << 5, b"") and doubled.pop() else ()

    doubled[:0] = [0] * (20 - times)
    bench.wire.attach(Speaker(answer=again))
    report = bench.scan()
    assert bench.seen() == ([("odrive_can", 3)] if times == 1 else [])
    assert any("two drives have this node" in note for note in report.notes) is (times > 1)


def test_two_devices_of_one_number_are_said_to_be_so(bench):
    bench.place("elmo_can", node=9)
    bench.place("elmo_can", node=9)
    report = bench.scan()
    assert bench.seen() == []
    assert any("node 9: 2 answers to one question: two devices have this number" in note for note in report.notes)


@pytest.mark.parametrize("data", [b"", b"\x43", bytes.fromhex("4b41600037060000"), bytes.fromhex("ff00100092010200")])
def test_an_answer_that_fits_no_question_is_told_and_no_device(bench, data):
    bench.wire.attach(Speaker(answer=lambda frame: [Frame(0x585, data)] if frame.identifier == 0x605 else ()))
    report = bench.scan()
    assert report.answered == []
    assert any(f"node 5: sent {data.hex(' ') or 'no byte'}" in note for note in report.notes)


def test_a_node_of_another_maker_is_told_and_no_driver_is_named_for_it(bench):
    far = bench.place("elmo_can", node=2)
    far._values[0x1018, 1] = 0x11C
    report = bench.scan()
    assert report.answered[0].sighting.settings is None
    assert "vendor 0x0000011C" in report.answered[0].sighting.detail


def test_a_drive_with_the_host_s_number_gets_another_host(bench):
    bench.place("elmo_can", node=126, host_node=125)
    bench.place("elmo_can", node=127)
    bench.scan()
    assert [dict(each.sighting.settings) for each in bench.report.answered] == [
        {"node": 126, "host_node": 125},
        {"node": 127, "host_node": 125},
    ]


def test_a_stopped_node_is_heard_and_said_not_to_answer(bench):
    bench.wire.attach(Speaker([Frame(0x70A, b"\x04")]))
    assert any("node 10: sends heartbeats and answers no SDO" in note for note in bench.scan().notes)


def test_a_silent_bus_has_nothing(bench):
    report = bench.scan()
    assert (report.answered, report.asked) == ([], True)


def test_a_flood_is_listened_to_and_nothing_is_added(bench):
    bench.wire.attach(Speaker([Frame(0x3A5, bytes(8))] * 5, every_s=0.001))
    report = bench.scan()
    assert bench.tape == []
    assert "a device babbles" in report.notes[0]


class Erring(EmulatedCanBus):
    """A bus whose controller reports errors."""

    def recv(self, timeout=None):
        self._wire.clock.sleep_until(self._wire.clock.now() + 0.001)
        return can.Message(is_error_frame=True, arbitration_id=0x20, dlc=8)


def test_error_frames_keep_a_scan_from_sending(bench):
    ask_can(bench.report, lambda: Tap(Erring(bench.wire), bench.tape), bench.clock, CAN, QUIET)
    assert "one bit rate" in bench.report.notes[0]
    assert bench.tape == []


def test_frames_that_nobody_acknowledges_are_a_fault_with_its_mend(bench):
    bench.wire.off = True
    with pytest.raises(DeviceError, match=r"can0.*no frame is acknowledged; is a device switched on"):
        bench.scan()
    bench.tape.clear()


def test_what_was_seen_before_a_person_stops_it_remains(bench):
    bench.place("elmo_can", node=1)
    bench.place("odrive_can", node=3)

    def check():
        if bench.report.answered:
            raise Stopped("stopped by SIGINT")

    with pytest.raises(Stopped):
        bench.scan(watcher=Watcher(lambda _text: None, check))
    assert bench.seen() == [("elmo_can", 1)]


frames = st.lists(
    st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8)).filter(lambda frame: frame.identifier != 0x080),
    max_size=4,
)


@settings(max_examples=25, deadline=None)
@given(spoken=frames, answers=frames, node=st.integers(1, 127))
def test_whatever_is_answered_a_scan_ends_and_sends_reads_alone(spoken, answers, node):
    bench = CanBench()
    replies = [Frame(0x580 + node, frame.data) for frame in answers]
    bench.wire.attach(Speaker(spoken, every_s=0.3, answer=lambda frame: [*answers, *replies][:3]))
    bench.scan()
    assert all(map(is_harmless, bench.tape))


@settings(max_examples=25, deadline=None)
@given(answers=st.lists(st.binary(max_size=64), max_size=2))
def test_whatever_a_can_fd_device_answers_a_scan_ends(answers):
    bench = CanBench()

    def answer(frame):
        node = frame.identifier & 0x7F
        return [FdFrame(node << 8, data) for data in answers] if isinstance(frame, FdFrame) and node < 4 else ()

    bench.wire.attach(Speaker(answer=answer))
    bench.scan(fd=True)
    assert all(map(is_harmless, bench.tape))


# -- probes that break the contract ----------------------------------------------------------------------------------


class Rogue(CanProbe):
    """A probe whose `ask` a test gives."""

    def __init__(self, ask):
        self._ask = ask

    def identifiers(self, address):
        return (0x123,)

    def ask(self, port, addresses, taken):
        yield from self._ask(port)


def hangs(port):
    while True:
        port.pump_until((False,), port.clock.now() + 1.0)
    yield ""


def breaks(port):
    yield Sighting(1, None, {})
    raise RuntimeError("divided by cheese")


def never_ends(port):
    while True:
        yield "and another one"


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (hangs, "was ended: it takes more than 20 s"),
        (breaks, "breaks with RuntimeError: divided by cheese"),
        (never_ends, "was ended: more than 200 answers"),
    ],
)
def test_a_probe_that_hangs_or_breaks_is_told_and_the_others_are_asked(ask, words):
    bench = CanBench()
    bench.place("odrive_can", node=3)
    probes = {"rogue": Rogue(ask), "odrive_can": CAN["odrive_can"]}
    ask_can(bench.report, lambda: EmulatedCanBus(bench.wire), bench.clock, probes, QUIET)
    assert any(f"the probe of rogue {words}" in note for note in bench.report.notes)
    assert ("odrive_can", 3) in bench.seen()


def test_a_probe_cannot_send_what_another_device_acts_on():
    def oversteps(port):
        port.send(3 << 5 | 0x07, bytes(4))
        yield ""

    bench = CanBench()
    bench.place("odrive_can", node=3)
    probes = {"rogue": Rogue(oversteps), "odrive_can": CAN["odrive_can"]}
    bench.scan(probes=probes)
    assert any("would send 0x067, on which another device acts" in note for note in bench.report.notes)
    assert all(frame.identifier != 0x067 for frame in bench.tape)


# -- I2C -------------------------------------------------------------------------------------------------------------


class Registers:
    """A chip whose registers a test gives; what is written to it counts."""

    due = float("inf")

    def __init__(self, held):
        self._held, self.written, self.asked = held, 0, set()

    def read(self, register, now):
        self.asked.add(register)
        return self._held

    def write(self, register, value, now):
        self.written += 1


def scan_i2c(chips, probes=None):
    clock, report = EmulatedClock(), WireReport("/dev/i2c-1")
    bus = EmulatedI2cBus(clock)
    bus.devices.update(chips)
    ask_i2c(report, lambda: bus, clock, probes or I2C, QUIET)
    return report


@pytest.mark.parametrize(
    ("held", "driver"), [(0x8583, True), (0xC3E3, True), (0x60A0, False), (0xFFFF, False), (0x0000, False)]
)
def test_a_converter_is_recognised_by_one_register_that_is_read(held, driver):
    chip = Registers(held)
    report = scan_i2c({0x49: chip})
    (each,) = report.answered
    assert (each.sighting.address, each.sighting.settings) == (0x49, {"address": 0x49} if driver else None)
    assert f"0x{held:04X}" in each.sighting.detail
    assert (chip.asked, chip.written) == ({1}, 0)


def test_no_address_is_touched_that_no_converter_can_have():
    chips = {address: Registers(0x8583) for address in range(0x08, 0x78)}
    report = scan_i2c(chips)
    assert [each.sighting.address for each in report.answered] == [0x48, 0x49, 0x4A, 0x4B]
    assert [address for address, chip in chips.items() if chip.asked] == [0x48, 0x49, 0x4A, 0x4B]


def test_a_probe_cannot_write_to_a_chip():
    class Writes(I2cProbe):
        def ask(self, port):
            port.write(0x48, 1, 0x8583)
            yield ""

    chip = Registers(0)
    report = scan_i2c({0x48: chip}, {"rogue": Writes()})
    assert (chip.written, report.notes) == (0, ["the probe of rogue was ended: it would write to address 0x48"])


# -- lines -----------------------------------------------------------------------------------------------------------

ASKED = {b"VR;", b"SN[4];", b"GMAX\r", b"GETS\r", b"*IDN?\n", b"*IDN?", b"\n"}


class LineBench:
    """An emulated line with one device, which has one rate: at another one it hears nothing."""

    def __init__(self, device=None, baudrate=9600):
        self.clock, self.baudrate = EmulatedClock(), baudrate
        self.wire = SerialWire(self.clock, 11 / baudrate)
        self.wire.device = device
        self.said, self.report = [], WireReport("/dev/ttyUSB0")

    def connect(self, line):
        self.wire.cut = line.baudrate != self.baudrate
        bench, inner = self, EmulatedSerialLine(self.wire)

        class Taped:
            def write(self, data):
                bench.said.append(bytes(data))
                return inner.write(data) if not bench.wire.cut else len(data)

            def __getattr__(self, name):
                return getattr(inner, name)

        return Taped()

    def scan(self, rates=(), further=None):
        probes = LINES | (further or {})
        rates = rates or rates_of(probes.values())
        lines = [SerialBus(kind="serial", port="/dev/ttyUSB0", baudrate=rate) for rate in rates]
        ask_line(self.report, self.connect, self.clock, probes, lines, QUIET)
        assert set(self.said) <= ASKED
        return self.report


def far_end(driver, clock):
    kind = registry.load(driver)
    return kind.far_end(kind.Settings(**kind.example), "test", KnownBench(clock))


@pytest.mark.parametrize(
    ("driver", "baudrate", "model", "settings"),
    [
        ("elmo_serial", 115200, "Elmo Whistle", {}),
        ("elmo_serial", 19200, "Elmo Whistle", {}),
        ("bk1688b", 9600, "BK Precision 1688B", {"model": "1688B"}),
        ("korad_ka", 9600, "KORADKA3005P", {"model": "KA3005P"}),
        ("scpi_supply", 9600, "E3633A", {"dialect": "e36xx", "model": "E3633A"}),
        ("scpi_supply", 57600, "E3633A", {"dialect": "e36xx", "model": "E3633A"}),
    ],
)
def test_the_device_of_a_line_is_recognised_at_its_rate(driver, baudrate, model, settings):
    bench = LineBench(baudrate=baudrate)
    bench.wire.device = far_end(driver, bench.clock)
    report = bench.scan()
    (each,) = report.answered
    assert (each.driver, each.line.baudrate, dict(each.sighting.settings)) == (driver, baudrate, settings)
    assert model in each.sighting.identity.model
    assert report.notes == []


@pytest.mark.parametrize("model", OUTPUTS)
def test_which_output_of_several_feeds_a_motor_is_left_open(model):
    bench, dialect = LineBench(), dialect_of(model)
    bench.wire.device = ScpiSupplyEmulator(dialect, model, KnownBench(bench.clock).load, "AB12", 2)
    (each,) = bench.scan().answered
    assert dict(each.sighting.settings) == {"dialect": dialect, "model": model, "serial_number": "AB12"}
    assert each.sighting.identity.serial == "AB12"
    driver = registry.load(each.driver)
    assert settings_left_open(driver, each.sighting) == ["output", "feeds", "voltage_limit_V", "current_limit_A"]
    assert not any(output.on for output in bench.wire.device.outputs)


def test_every_shipped_probe_on_a_line_is_tried_here():
    assert set(LINES) == {"elmo_serial", "bk1688b", "korad_ka", "scpi_supply"}
    assert set(line_probes("visa")) == {"scpi_supply"}
    assert set(CAN) == {"elmo_can", "odrive_can", "moteus_can"}
    assert set(I2C) == {"ads1115"}


def test_a_silent_line_is_told_with_the_rates_that_were_tried():
    report = LineBench().scan()
    assert report.notes == ["silent at 9600, 19200, 38400, 57600, 115200 baud"]


class FailsAt(LineProbe):
    """Breaks, or waits for ever, at each of its rates."""

    def __init__(self, baudrates, hangs):
        self.baudrates, self._hangs = baudrates, hangs

    def ask(self, port):
        while self._hangs:
            port.wait(port.clock.now() + 1.0)
        raise KeyError("cheese")
        yield ""


@pytest.mark.parametrize("hangs", [False, True], ids=["breaks", "hangs"])
@pytest.mark.parametrize("baudrates", [(9600,), (9600, 115200)])
def test_a_probe_that_fails_hides_no_device_at_another_rate(baudrates, hangs):
    bench = LineBench(baudrate=115200)
    bench.wire.device = far_end("elmo_serial", bench.clock)
    report = bench.scan(further={"a_foreign_one": FailsAt(baudrates, hangs)})
    (each,) = report.answered
    assert (each.driver, each.line.baudrate) == ("elmo_serial", 115200)
    (note,) = report.notes
    assert note.startswith(f"the probe of a_foreign_one {'was ended' if hangs else 'breaks with KeyError'}")


class Talker:
    """A device that answers each end of a line with given bytes, or talks without an end."""

    def __init__(self, answers=(), talks=b""):
        self._answers, self._talks, self._out = list(answers), talks, b""

    @property
    def due(self):
        return 0.0 if self._talks or self._out else float("inf")

    def receive(self, data, now):
        if data[-1:] in (b"\r", b"\n", b";") and self._answers:
            self._out += self._answers.pop(0)

    def tick(self, now):
        out, self._out = self._out, b""
        return out


def test_what_no_driver_can_read_is_shown():
    report = LineBench(Talker([b"?\r\n"] * 40)).scan()
    assert report.answered == []
    assert any("something answers at 9600 baud what no driver can read" in note for note in report.notes)


class Babbler:
    """A device that sends a line every millisecond."""

    due = 0.0

    def receive(self, data, now): ...

    def tick(self, now):
        self.due = now + 0.001
        return b"+0.123\r\n"


def test_a_line_that_never_pauses_is_listened_to():
    bench = LineBench(Babbler(), 115200)
    report = bench.scan()
    assert report.answered == []
    assert any("bytes come without a question at 115200 baud" in note for note in report.notes)


@settings(max_examples=25, deadline=None)
@given(answers=st.lists(st.binary(max_size=40), max_size=6))
def test_whatever_a_line_answers_a_scan_ends(answers):
    bench = LineBench(Talker(answers))
    bench.scan(rates=[9600])
    assert bench.clock.now() < 30.0


def test_an_instrument_that_is_no_supply_is_told():
    report = LineBench(Talker([b"", b"", b"", b"", b"KEITHLEY,2000,123,A1\n", b"KEITHLEY,2000,123,A1\n"])).scan()
    (each,) = report.answered
    assert (each.sighting.settings, each.sighting.identity.model) == (None, "KEITHLEY 2000")


def test_the_probe_of_the_page_recognises_its_thermometer():
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "own-driver.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(from leactl.driver.contract import Identity.*?)```", page, re.DOTALL)

    def value_of(answer):
        if not answer.startswith((b"+", b"-")):
            raise Unreadable("no temperature")
        return float(answer)

    known = {"value_of": value_of}
    exec(block, known)
    bench = LineBench(Talker([b"?\r\n", b"", b"+23.412\r\n"]))  # one answer to each CR, and to each LF
    line = SerialBus(kind="serial")
    ask_line(bench.report, bench.connect, bench.clock, {"room_meter": known["RoomMeterProbe"]()}, [line], QUIET)
    assert bench.report.answered[0].sighting.identity.model == "Lake Shore 218"
    assert bench.said == [b"CRDG? 1\r\n", b"CRDG? 1\r\n"]
