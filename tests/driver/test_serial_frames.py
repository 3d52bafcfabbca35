"""Binary protocols over a serial line: Modbus RTU and DYNAMIXEL Protocol 2.0, byte by byte.

Published bytes: SDM of Eastron (SDM320Y user manual, examples of reading registers); Modbus Application Protocol
V1.1b3, 6.3, with address and CRC; Modbus over Serial Line V1.02, appendix B (CRC of 02 07); ROBOTIS e-manual, Protocol
2.0, examples of ping and read.
"""

import math
import os
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.bench.benchfile import SerialBus
from leactl.bench.wiring import MachineWiring
from leactl.driver.clock import MonotonicClock
from leactl.driver.serial_port import FrameCut, SerialPort
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.trial.running import try_driver
from leactl.emulation.wires.pseudo_terminal import PseudoTerminal
from leactl.errors import DeviceError, DeviceFault, NoAnswer
from tests.bench.test_instrument_sockets import Instrument, port_at

from . import dynamixel, modbus_meter
from .dynamixel import Dynamixel, DynamixelEnd
from .modbus_meter import ModbusMeter, ModbusMeterEnd
from .transports import SerialInProcess

hexa = bytes.fromhex
LATE_S, PACKET = 0.016, 62  # FTDI's latency timer and payload of a USB packet (AN232B-04)
LONG_S = 20.0

# Eastron: voltage of 230.2 V, width of a pulse of 100 ms
ASK_VOLTAGE, VOLTAGE = hexa("01 04 00 00 00 02 71 CB"), hexa("01 04 04 43 66 33 34 1B 38")
ASK_WIDTH, WIDTH = hexa("01 03 00 0C 00 02 04 08"), hexa("01 03 04 42 C8 00 00 6F B5")
ASK_CURRENT, CURRENT = hexa("01 04 00 06 00 04 11 C8"), modbus_meter.with_crc(hexa("01 04 08 40 20 00 00 00 00 00 00"))
# ROBOTIS: model 1030 with firmware 38, position 166
PING, PONG = hexa("FF FF FD 00 01 03 00 01 19 4E"), hexa("FF FF FD 00 01 07 00 55 00 06 04 26 65 5D")
ASK_POSITION = hexa("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15")
POSITION = hexa("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0")
ASK_VOLTS = dynamixel.packet(1, 0x02, struct.pack("<HH", 144, 2))
VOLTS = dynamixel.packet(1, 0x55, hexa("00 78 00"))  # 12.0 V

METER = {ASK_WIDTH: [WIDTH], ASK_VOLTAGE: [VOLTAGE], ASK_CURRENT: [CURRENT]}
SERVO = {PING: [PONG], ASK_POSITION: [POSITION], ASK_VOLTS: [VOLTS]}
KINDS = {
    "modbus": (ModbusMeter, METER, (230.2, 2.5)),
    "dynamixel": (Dynamixel, SERVO, (2 * math.pi * 166 / 4096, 12.0)),
}
FIRST = {"modbus": (ASK_VOLTAGE, VOLTAGE), "dynamixel": (ASK_POSITION, POSITION)}  # question of a round, its answer


class Device:
    """A line whose far side answers each question by pieces 10 ms apart; a number among them is a longer pause [s]."""

    def __init__(self, answers):
        self.clock, self.answers = EmulatedClock(), {asked: [pieces] for asked, pieces in answers.items()}
        self.said, self.coming = [], []

    def once(self, question, *pieces):
        """Answer the question so the next time, and as before from then on."""
        self.answers[question].insert(0, list(pieces))

    def read(self, timeout):
        until = self.clock.now() + timeout
        if self.coming and self.coming[0][0] <= until:
            moment, piece = self.coming.pop(0)
            self.clock.sleep_until(moment)
            if piece is None:
                raise OSError("nothing is at the other end")
            return piece
        self.clock.sleep_until(until)
        return b""

    def write(self, data):
        assert data in self.answers, data.hex(" ")
        self.said.append(data)
        queue = self.answers[data]
        moment = self.coming[-1][0] if self.coming else self.clock.now()
        for piece in queue.pop(0) if len(queue) > 1 else queue[0]:
            moment += piece if isinstance(piece, float) else 0.01
            if not isinstance(piece, float):
                self.coming.append((moment, piece))
        return len(data)

    def close(self):
        self.coming.clear()


class Bench:
    """A driver at the end of such a line, or at the end of a line with a far end."""

    def __init__(self, driver, line, clock, **settings):
        self.line, self.clock = line, clock
        self.port = SerialPort(lambda: line, clock)
        self.driver = driver("example", "test", driver.Settings(**settings), self.port, clock)

    def rows(self, count=1):
        rows, end = [], self.clock.now() + 10.0
        while len(rows) < count and self.clock.now() < end:
            rows += self.driver.take()
            self.clock.sleep_until(self.clock.now() + 0.002)
        return rows


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


@pytest.fixture
def bench(kind):
    driver, answers, _ = KINDS[kind]
    device = Device(answers)
    made = Bench(driver, device, device.clock)
    made.driver.open()
    return made


def expect(kind, rows):
    assert [row.values for row in rows] == [pytest.approx(KINDS[kind][2])] * len(rows)
    assert rows


@pytest.mark.parametrize("driver", [ModbusMeter, Dynamixel])
def test_the_examples_pass_the_check_of_drivers(driver):
    assert [trial.fault for trial in try_driver(driver) if trial.fault] == []


def test_published_bytes_are_read(bench, kind):
    expect(kind, bench.rows(3))
    first, second = list(KINDS[kind][1])[1:]
    assert bench.line.said[:5] == [next(iter(KINDS[kind][1])), first, second, first, second]


def test_a_wait_ends_with_the_frame(bench):
    assert bench.clock.now() < bench.driver.settings.answer_s  # the answer has come 10 ms after the question


def test_published_checksums():
    for frame in (WIDTH, VOLTAGE, ASK_VOLTAGE, hexa("0207 4112"), hexa("01 03 00 6B 00 03 74 17")):
        assert modbus_meter.with_crc(frame[:-2]) == frame
    answer = hexa("01 03 06 02 2B 00 00 00 64 05 7A")
    assert modbus_meter.answers_to(hexa("01 03 00 6B 00 03 74 17"))(answer) == FrameCut(0, len(answer))
    assert dynamixel.body_of(PONG) == (1, 0x55, hexa("00 06 04 26"))


def test_the_far_ends_send_the_published_bytes():
    [volts] = struct.unpack(">f", VOLTAGE[3:7])  # the float above that next to 230.2
    meter = ModbusMeterEnd(lambda: volts, lambda: 2.5)
    servo = DynamixelEnd(lambda: 2 * math.pi * 166 / 4096, lambda: 12.0)
    for far, answers in ((meter, METER), (servo, SERVO)):
        for question, [answer] in answers.items():
            far.receive(question, 0.0)
            sent = b""
            while far.due < math.inf:
                sent += far.tick(far.due)
            assert sent == answer


@pytest.mark.parametrize("at", range(1, len(POSITION)))
def test_an_answer_may_come_in_two_pieces(bench, kind, at):
    question, answer = FIRST[kind]
    bench.line.once(question, answer[:at], LATE_S, answer[at:])
    expect(kind, bench.rows(2))
    assert bench.line.said.count(question) == 2


def test_an_answer_may_come_byte_by_byte(bench, kind):
    question, answer = FIRST[kind]
    bench.line.once(question, *(bytes((byte,)) for byte in answer))
    expect(kind, bench.rows())


@given(st.binary(max_size=40))
@pytest.mark.parametrize("name", KINDS)
def test_noise_before_an_answer_is_skipped(name, noise):
    driver, answers, _ = KINDS[name]
    device = Device(answers)
    bench = Bench(driver, device, device.clock)
    bench.driver.open()
    question, answer = FIRST[name]
    device.once(question, noise.replace(dynamixel.HEADER, b"") + answer)
    expect(name, bench.rows())
    assert device.said.count(question) == 1


def test_the_echo_of_a_question_is_no_answer(bench, kind):
    """As over two wires, where the host hears itself."""
    for question, [answer] in KINDS[kind][1].items():
        bench.line.answers[question] = [[question + answer]]
    expect(kind, bench.rows(2))


def another(kind):
    """The first answer of a round with another reading, and a checksum that is right."""
    answer = bytearray(FIRST[kind][1])
    answer[-6] ^= 1
    return modbus_meter.with_crc(answer[:-2]) if kind == "modbus" else dynamixel.packet(1, 0x55, answer[8:-2])


def test_a_late_answer_is_not_taken_for_that_of_the_next_question(bench, kind):
    """It comes behind the next question, whose answer differs in length."""
    second = list(KINDS[kind][1])[2]
    bench.line.once(second, another(kind), *KINDS[kind][1][second])
    expect(kind, bench.rows(2))
    assert bench.line.said.count(second) == 2


@pytest.mark.parametrize("name", KINDS)
def test_a_late_answer_that_comes_before_the_next_question_is_dropped(name):
    driver, answers, _ = KINDS[name]
    device = Device(answers)
    bench = Bench(driver, device, device.clock, answer_s=0.1, period_s=0.3)
    bench.driver.open()
    question, _ = FIRST[name]
    device.once(question, 0.15, another(name))
    expect(name, bench.rows(2))
    assert device.said.count(question) == 3  # one of which went unanswered


def test_an_answer_with_a_wrong_checksum_is_none(bench, kind):
    question, answer = FIRST[kind]
    for at in range(len(answer)):
        garbled = bytearray(answer)
        garbled[at] ^= 0x10
        bench.line.once(question, bytes(garbled))
        expect(kind, bench.rows())
    bench.line.answers[question] = [[answer[:-1] + b"\xee"]]
    with pytest.raises(NoAnswer, match=f"example: no answer to {question.hex(' ').upper()} within 0"):
        bench.rows()


@pytest.mark.parametrize(
    ("name", "refusal", "error", "said"),
    [
        ("modbus", modbus_meter.with_crc(hexa("01 84 02")), DeviceError,
         "registers 0 to 1 are refused: exception 2 (illegal data address)"),
        ("dynamixel", dynamixel.packet(1, 0x55, b"\x07"), DeviceError, "error 7 (access error)"),
        ("dynamixel", dynamixel.packet(1, 0x55, hexa("80 A6 00 00 00")), DeviceFault,
         "its hardware error status is set"),
    ],
)  # fmt: skip
def test_an_answer_that_refuses_is_told(name, refusal, error, said):
    driver, answers, _ = KINDS[name]
    device = Device(answers)
    bench = Bench(driver, device, device.clock)
    bench.driver.open()
    question, _ = FIRST[name]
    device.once(question, refusal)
    with pytest.raises(error) as told:
        bench.rows()
    assert str(told.value).startswith("example: ")
    assert str(told.value).endswith(said)
    expect(name, bench.rows())


def test_a_line_that_goes_within_a_frame_is_told_and_the_half_is_forgotten(bench, kind):
    question, answer = FIRST[kind]
    bench.line.once(question, answer[:5], None)
    with pytest.raises(DeviceError, match=r"bus 'serial': the device is gone: nothing is at the other end"):
        bench.rows()
    bench.port.reopen()
    bench.line.coming = [(bench.clock.now(), answer[5:])]
    framing = modbus_meter.answers_to(question) if kind == "modbus" else dynamixel.packets
    assert bench.port.take_frame(framing) is None
    expect(kind, bench.rows())


def test_a_payload_that_looks_like_a_header_is_stuffed():
    body = hexa("00 FF FF FD 00 FF FF FD")
    whole = dynamixel.packet(1, 0x55, body)
    assert whole[9:].count(dynamixel.HEADER) == 0
    assert dynamixel.packets(whole) == FrameCut(0, len(whole))
    assert dynamixel.body_of(whole) == (1, 0x55, body)


class UsbAdapter:
    """A connection whose bytes are passed on as FTDI's chips do: 62 at a time, or what is there every 16 ms."""

    def __init__(self, line, clock):
        self._line, self._clock = line, clock
        self._held, self._passed, self.said = b"", 0.0, []
        self.write, self.close = self._write, line.close

    def _write(self, data):
        self.said.append((self._clock.now(), self._heard_at, data))
        return self._line.write(data)

    _heard_at = -math.inf

    def read(self, timeout):
        until = self._clock.now() + timeout
        while True:
            read = self._line.read(0.0)
            self._heard_at = self._clock.now() if read else self._heard_at
            self._held += read
            if len(self._held) >= PACKET or self._clock.now() >= self._passed + LATE_S:
                self._passed = self._clock.now()
                passed, self._held = self._held[:PACKET], self._held[PACKET:]
                if passed:
                    return passed
            if self._clock.now() >= until:
                return b""
            self._clock.sleep_until(min(until, self._clock.now() + 0.001))


@pytest.mark.parametrize("name", KINDS)
def test_an_adapter_that_holds_bytes_back_and_splits_frames_changes_nothing(name):
    driver, _, values = KINDS[name]
    wire = SerialInProcess(10 / 9600)
    ends = {"modbus": ModbusMeterEnd, "dynamixel": DynamixelEnd}
    wire.wire.device = ends[name](lambda: values[0], lambda: values[1])
    bench = Bench(driver, UsbAdapter(wire.connect(), wire.clock), wire.clock, answer_s=0.5)
    bench.driver.open()
    expect(name, bench.rows(5))
    if name == "modbus":
        pauses = [now - heard for now, heard, _ in bench.line.said[1:]]
        assert min(pauses) >= 3.5 * 11 / 9600


def test_a_question_waits_for_the_silence_of_the_line():
    """Bytes that nobody asked for delay it; else it would go into somebody else's frame."""
    device = Device(METER)
    bench = Bench(ModbusMeter, device, device.clock, silence_s=0.1)
    device.coming = [(0.05 * tick, b"\x55") for tick in range(1, 9)]
    bench.driver.open()
    assert device.clock.now() >= 0.05 * 8 + 0.1
    assert device.said == [ASK_WIDTH]


FRAMES = st.lists(
    st.tuples(st.integers(0, 252), st.binary(max_size=30)).map(lambda told: dynamixel.packet(told[0], 0x55, told[1])),
    min_size=1,
    max_size=6,
)


def chunked(draw, stream):
    cuts = sorted(draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    return [stream[begin:end] for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True)]


def taken(chunks, take):
    """What a port gives of these chunks, looked at after each."""
    clock = EmulatedClock()
    device = Device({})
    port = SerialPort(lambda: device, clock)
    port.open()
    frames = []
    for chunk in chunks:
        device.coming = [(0.0, chunk)]
        while (frame := take(port)) is not None:
            frames.append(frame)
    return frames


@given(st.data())
def test_any_delivery_of_a_stream_gives_the_same_frames(data):
    frames = data.draw(FRAMES)
    noise = st.binary(max_size=6).map(lambda said: said.replace(b"\xff", b""))
    stream = b"".join(data.draw(noise) + frame for frame in frames)
    assert taken(chunked(data.draw, stream), lambda port: port.take_frame(dynamixel.packets)) == frames


@given(st.data())
def test_any_delivery_of_any_bytes_gives_the_same_frames(data):
    """Whatever they are: headers without a frame, and frames cut short."""
    parts = st.sampled_from(
        [VOLTAGE, VOLTAGE[:5], b"\x01\x04", b"\x01\x04\x04", WIDTH, hexa("01 84 02 C2 C1"), b"\x01"]
    )
    stream = b"".join(data.draw(st.lists(parts | st.binary(max_size=5), max_size=10)))
    framing = modbus_meter.answers_to(ASK_VOLTAGE)

    def take(port):
        return port.take_frame(framing)

    assert taken(chunked(data.draw, stream), take) == taken([stream], take)


@given(st.data())
def test_lines_and_frames_of_one_stream_keep_their_order(data):
    """As a block of bytes among lines of text (IEEE 488.2): a header line, its bytes, the next line."""
    blocks = data.draw(st.lists(st.binary(min_size=1, max_size=40), max_size=4))
    stream = b"".join(b"%d\r\n" % len(block) + block for block in blocks)
    ahead = []

    def take(port):
        if not ahead:
            line = port.take_line()
            if line is None:
                return None
            ahead.append(int(line))
        block = port.take_frame(lambda _received: FrameCut(0, ahead[0]))
        if block is not None:
            ahead.clear()
        return block

    assert taken(chunked(data.draw, stream), take) == blocks


def test_of_bytes_without_a_frame_only_the_last_are_kept():
    device = Device({})
    port = SerialPort(lambda: device, device.clock)
    port.open()
    for _ in range(10):
        device.coming = [(0.0, b"x" * 4096)]
        assert port.take_frame(lambda _received: FrameCut(0, 0)) is None
    assert len(port._received) == port.longest_line


@pytest.fixture(params=["pty", "tcp"])
def both_sides(request):
    """A port of this machine, and what writes to it, reads from it and ends it at the far side."""
    if request.param == "pty":
        far, wiring = PseudoTerminal(), MachineWiring()
        port = SerialPort(wiring.serial("line", SerialBus(kind="serial", port=far.path)), wiring.clock, "line")
        port.open()

        def pull():
            for name in ("_master", "_slave"):
                os.close(getattr(far, name))
                setattr(far, name, os.open(os.devnull, os.O_RDONLY))

        yield port, far.write, far.read, pull
    else:
        far = Instrument()
        port = port_at(far.resource)
        port.open()
        far.accept()
        yield port, far.client.sendall, lambda: far.client.recv(64), far.client.close
    port.close()
    far.close()


def test_frames_over_a_real_line(both_sides):
    port, write, read, pull = both_sides
    framing = modbus_meter.answers_to(ASK_VOLTAGE)
    port.write(ASK_VOLTAGE)
    assert read() == ASK_VOLTAGE
    write(b"\xff\x01" + VOLTAGE[:4])
    port.wait(MonotonicClock.now() + 0.02, framing)
    assert port.take_frame(framing) is None
    write(VOLTAGE[4:] + VOLTAGE[:3])
    port.wait(MonotonicClock.now() + LONG_S, framing)
    assert port.take_frame(framing) == VOLTAGE
    assert port.take_frame(framing) is None
    pull()
    with pytest.raises(DeviceError, match=r"the device is gone"):
        port.wait(MonotonicClock.now() + LONG_S, framing)
