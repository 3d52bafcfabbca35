"""The shared CAN bus: what reaches the bus for repeated and changed frames, and how long a wait may last."""

import can
import pytest

from leactl.driver.can_port import CanPort
from leactl.emulation.clock import EmulatedClock


class Keeping(can.BusABC):
    """A bus that keeps the message objects it was given, as some do until they are on the wire."""

    def __init__(self, clock):
        super().__init__(channel="keeping")
        self.clock, self.given, self.babbles = clock, [], False

    def send(self, msg, timeout=None):
        self.given.append(msg)

    def recv(self, timeout=None):
        self.clock.sleep_until(self.clock.now() + (0.001 if self.babbles else timeout or 0.0))
        return can.Message(arbitration_id=0x123, is_extended_id=False) if self.babbles else None


@pytest.fixture
def port():
    clock = EmulatedClock()
    port = CanPort(lambda: Keeping(clock), clock)
    port.open()
    yield port
    port.close()


def test_every_frame_goes_out_and_a_message_that_a_bus_keeps_never_changes(port):
    for data in (b"\x01", b"\x01", b"\x02", b"\x01\x00", b""):
        port.send(0x201, data)
    port.send(0x202, b"")
    kept = [(message.arbitration_id, bytes(message.data), message.dlc) for message in port.bus.given]
    of_first = [(0x201, data, len(data)) for data in (b"\x01", b"\x01", b"\x02", b"\x01\x00", b"")]
    assert kept == [*of_first, (0x202, b"", 0)]


def test_a_wait_ends_at_its_deadline(port):
    assert not port.pump_until([False], 0.5)
    assert port.clock.now() == 0.5


def test_a_bus_that_never_falls_silent_does_not_hold_a_wait(port):
    port.bus.babbles = True
    assert not port.pump_until([False], 0.5)
    assert 0.5 <= port.clock.now() <= 0.512
