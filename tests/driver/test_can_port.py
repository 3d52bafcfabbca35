"""The shared CAN bus: what reaches the bus for repeated and changed frames, and how long a wait may last."""

import errno

import can
import pytest

from leactl.driver.can_port import CanPort
from leactl.emulation.clock import EmulatedClock
from leactl.errors import DeviceError


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


class Full(Keeping):
    """An interface whose queue has no room for so many attempts."""

    def __init__(self, clock, refusals):
        super().__init__(clock)
        self.refusals = refusals

    def send(self, msg, timeout=None):
        if self.refusals:
            self.refusals -= 1
            raise can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)
        super().send(msg)


def full_port(refusals):
    clock = EmulatedClock()
    port = CanPort(lambda: Full(clock, refusals), clock)
    port.open()
    return port


def test_a_frame_waits_for_room_in_the_queue_and_is_told():
    port = full_port(refusals=5)
    port.send(0x201, b"\x01")
    assert [message.arbitration_id for message in port.bus.given] == [0x201]
    assert port.clock.now() < 0.002
    [told] = port.notices()
    assert "had to wait for room in the interface's queue, 1 so far" in told
    assert port.notices() == []


def test_a_queue_that_stays_full_is_an_error_within_two_milliseconds():
    port = full_port(refusals=10_000)
    with pytest.raises(DeviceError, match="cannot send 0x201: Failed to transmit: No buffer space available"):
        port.send(0x201, b"\x01")
    assert port.clock.now() <= 0.0022


def test_what_fails_for_another_reason_is_not_repeated(port, monkeypatch):
    attempts = []

    def gone(message, timeout=None):
        attempts.append(message)
        raise OSError(errno.ENETDOWN, "Network is down")

    monkeypatch.setattr(port.bus, "send", gone)
    with pytest.raises(DeviceError, match="Network is down"):
        port.send(0x201, b"")
    assert len(attempts) == 1


@pytest.mark.parametrize(("identifier", "ends"), [(0x40, True), (0x04, False), (0x100, False)])
def test_a_controller_that_has_left_the_bus_is_told(port, monkeypatch, identifier, ends):
    frames = [can.Message(arbitration_id=identifier, is_error_frame=True, is_extended_id=False, data=bytes(8))]
    monkeypatch.setattr(port.bus, "recv", lambda timeout=None: frames.pop() if frames else None)
    if ends:
        with pytest.raises(DeviceError, match=r"has left the bus \(bus-off\)"):
            port.pump_until([False], 0.0)
    else:
        assert not port.pump_until([False], 0.0)


def test_error_frames_are_counted_and_told(port, monkeypatch):
    frames = [can.Message(arbitration_id=0x04, is_error_frame=True, is_extended_id=False, data=bytes(8))] * 3
    monkeypatch.setattr(port.bus, "recv", lambda timeout=None: frames.pop() if frames else None)
    frames += [can.Message(arbitration_id=kind, is_error_frame=True, is_extended_id=False) for kind in (0x02, 0x100)]
    assert port.why_silent() == ""
    port.pump_until([False], 0.0)
    assert port.why_silent() == "; the bus 'can' has shown 3 error frames: look at cable, termination and bit rate"
    [told] = port.notices()
    assert told.startswith("bus 'can': the controller reports an error by an error frame, 3 so far; look at cable")
    assert port.notices() == []


def test_a_can_fd_frame_has_its_faster_rate_and_29_bits_where_11_are_too_few(port):
    for identifier in (0x100, 0x7FF, 0x800, 0x8001):
        port.send_fd(identifier, bytes(64))
    given = [(message.is_fd, message.bitrate_switch, message.is_extended_id) for message in port.bus.given]
    assert given == [(True, True, False), (True, True, False), (True, True, True), (True, True, True)]
    assert all(message.dlc == 64 for message in port.bus.given)


def test_classic_and_fd_frames_of_one_identifier_go_to_their_own_listeners(port, monkeypatch):
    heard = []
    port.listen(0x123, lambda data, _stamp: heard.append(("classic", bytes(data))))
    port.listen_fd(0x123, lambda data, _stamp: heard.append(("fd", bytes(data))))
    port.listen_fd(0x1234, lambda data, _stamp: heard.append(("long", bytes(data))))
    frames = [
        can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\x01"),
        can.Message(arbitration_id=0x123, is_extended_id=False, is_fd=True, data=bytes(12)),
        can.Message(arbitration_id=0x123, is_extended_id=True, is_fd=True, data=b"\x03"),
        can.Message(arbitration_id=0x123, is_extended_id=True, data=b"\x04"),  # of nobody here
        can.Message(arbitration_id=0x1234, is_extended_id=True, is_fd=True, data=b"\x05"),
    ]
    monkeypatch.setattr(port.bus, "recv", lambda timeout=None: frames.pop(0) if frames else None)
    port.take_waiting()
    assert heard == [("classic", b"\x01"), ("fd", bytes(12)), ("fd", b"\x03"), ("long", b"\x05")]
    port.listen_fd(0x1234, None)
    frames.append(can.Message(arbitration_id=0x1234, is_fd=True, data=b"\x06"))
    port.take_waiting()
    assert len(heard) == 4


def test_a_bus_of_classic_frames_says_what_can_fd_needs(port, monkeypatch):
    def classic_only(message, timeout=None):
        raise can.CanOperationError("Failed to transmit: Invalid argument", errno.EINVAL)

    monkeypatch.setattr(port.bus, "send", classic_only)
    with pytest.raises(DeviceError, match=r"cannot send 0x8001: .*; a CAN-FD frame needs options: \{fd: true\}"):
        port.send_fd(0x8001, b"")
    with pytest.raises(DeviceError, match=r"cannot send 0x201: [^;]*$"):
        port.send(0x201, b"")
