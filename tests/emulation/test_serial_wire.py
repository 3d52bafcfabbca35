"""The emulated serial line: bytes take their time, in order, in either direction."""

import math

import pytest

from leactl.emulation.clock import EmulatedClock
from leactl.emulation.wires.serial import MOST_UNSENT_BYTES, EmulatedSerialLine, SerialWire

BYTE_S = 10 / 9600


class Echo:
    """Answers each line with itself, 5 ms after its end has come."""

    def __init__(self):
        self.came = []
        self._line = b""
        self._answers = []

    def receive(self, data, now):
        self.came += [(now, byte) for byte in data]
        self._line += data
        if data.endswith(b"\n"):
            self._answers.append((now + 0.005, self._line))
            self._line = b""

    @property
    def due(self):
        return self._answers[0][0] if self._answers else math.inf

    def tick(self, now):
        return self._answers.pop(0)[1]


@pytest.fixture
def wire():
    wire = SerialWire(EmulatedClock(), BYTE_S)
    wire.device = Echo()
    return wire


def test_each_byte_takes_its_bits_however_far_the_clock_goes_at_once(wire):
    EmulatedSerialLine(wire).write(b"abc\n")
    wire.clock.sleep_until(1.0)
    assert [round(moment / BYTE_S, 6) for moment, _ in wire.device.came] == [1, 2, 3, 4]


@pytest.mark.parametrize("period", [0.0003, 0.001, 0.1])
def test_an_answer_comes_when_the_line_has_carried_it_both_ways(wire, period):
    line = EmulatedSerialLine(wire)
    line.write(b"abc\n")
    heard = b""
    while len(heard) < 4:
        wire.clock.sleep_until(wire.clock.now() + period)
        heard += line.read(0.0)
    assert heard == b"abc\n"
    due = 8 * BYTE_S + 0.005
    assert due <= wire.clock.now() <= due + period


def test_a_read_waits_for_the_first_byte_and_no_longer(wire):
    line = EmulatedSerialLine(wire)
    assert line.read(0.25) == b""
    assert wire.clock.now() == pytest.approx(0.25)
    line.write(b"\n")
    assert line.read(1.0) == b"\n"
    assert wire.clock.now() == pytest.approx(0.25 + 2 * BYTE_S + 0.005, abs=0.001)


def test_what_the_line_cannot_hold_is_not_taken(wire):
    line = EmulatedSerialLine(wire)
    assert line.write(b"x" * (MOST_UNSENT_BYTES + 7)) == MOST_UNSENT_BYTES
    assert line.write(b"x") == 0


def test_a_line_that_is_let_go_sends_no_more(wire):
    line = EmulatedSerialLine(wire)
    line.write(b"abc\n")
    line.close()
    wire.clock.sleep_until(1.0)
    assert wire.device.came == []
