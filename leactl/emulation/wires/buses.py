"""Emulated buses in the same process, with the calls of python-can and smbus2, answered at once by the far ends.

Synchronous and without threads: a frame is answered inside `send`, and emulated time passes inside `recv`.
"""

import errno
import heapq
import math
from collections import deque
from collections.abc import Callable
from functools import partial

import can

from leactl.driver.far_end import LAST_OF_11_BITS, CanEmulator, FdFrame, Frame, I2cEmulator
from leactl.driver.i2c_port import swap_bytes
from leactl.emulation.clock import EmulatedClock

TICK_S = 1e-3  # of emulated time, between two looks for a frame
LEAST_WAIT_S = 1e-9  # a wait that rounding makes shorter must still let time pass, or it would never end
MOST_STOPS_PER_S = 8000  # stops of emulated time for I2C devices, which are then at most 0.125 ms late

FrameDelay = Callable[[Frame, CanEmulator | None], float | None]
"""Returns the delay [s] of a frame of a device, or of a host if the device is None; None if the frame is lost."""


def message_of(frame: Frame, timestamp: float = 0.0) -> can.Message:
    """Return an emulator's frame as a message of python-can."""
    identifier, data = frame
    if isinstance(frame, FdFrame):
        is_extended = identifier > LAST_OF_11_BITS
        return can.Message(timestamp, identifier, is_extended, data=data, is_fd=True, bitrate_switch=True)
    return can.Message(timestamp, identifier, False, data=data)


class CanWire:
    """The CAN segment that emulated devices and any number of host connections share."""

    def __init__(self, clock: EmulatedClock) -> None:
        self.clock = clock
        self.devices: list[CanEmulator] = []
        self.hosts: list[EmulatedCanBus] = []
        self.cut = False  # the cable is unplugged: nothing arrives, on either side
        self.off = False  # the hosts' controller has left the bus: they cannot send, and nothing comes in
        self._disturbances: list[FrameDelay] = []
        self._delayed_frames: list[tuple[float, int, Callable[[], None]]] = []
        self._delayed_count = 0  # frames delayed so far; frames that are due at one time keep their order
        clock.follow(self._pass_time)
        clock.stop_at(lambda: self._delayed_frames[0][0] if self._delayed_frames else math.inf)

    def attach(self, device: CanEmulator) -> None:
        """Put a device on the segment."""
        self.devices.append(device)

    def disturb(self, delay_of_frame: FrameDelay) -> Callable[[], None]:
        """Apply a fault to every frame; return a function that removes it."""
        self._disturbances.append(delay_of_frame)
        return lambda: self._disturbances.remove(delay_of_frame)

    def from_host(self, frame: Frame, sender: "EmulatedCanBus") -> None:
        """Deliver a host's frame, and the answers of the devices."""
        if self._disturbances:
            self._deliver(frame, None, partial(self._send_to_devices, frame, sender))
        else:
            self._send_to_devices(frame, sender)

    def _send_to_devices(self, frame: Frame, sender: "EmulatedCanBus") -> None:
        """Give a host's frame to all devices and the other hosts; pass on the devices' answers."""
        if self.cut:
            return
        now = self.clock.now()
        for host in self.hosts:
            if host is not sender:
                host.arrived.append(frame)
        for device in self.devices:
            answers = device.receive(frame, now)
            if answers:
                self._pass_from_device(device, answers)

    def _pass_from_device(self, device: CanEmulator, frames: list[Frame]) -> None:
        """Pass on the frames of a device to the hosts, with the faults of the wire."""
        if self._disturbances:
            for frame in frames:
                self._deliver(frame, device, partial(self._send_to_hosts, [frame]))
        else:
            self._send_to_hosts(frames)

    def _deliver(self, frame: Frame, source: CanEmulator | None, deliver: Callable[[], None]) -> None:
        """Deliver a frame at once, later or never, as the faults of the wire say; a host's frame has no source."""
        delay = 0.0
        for delay_of_frame in self._disturbances:
            added_delay = delay_of_frame(frame, source)
            if added_delay is None:
                return
            delay += added_delay
        if delay <= 0.0:
            deliver()
            return
        self._delayed_count += 1
        heapq.heappush(self._delayed_frames, (self.clock.now() + delay, self._delayed_count, deliver))

    def _pass_time(self, now: float) -> None:
        """Deliver the delayed frames that are due at a time [s], and let the devices that are due send."""
        while self._delayed_frames and self._delayed_frames[0][0] <= now:
            heapq.heappop(self._delayed_frames)[2]()
        for device in self.devices:
            if now >= device.due:
                self._pass_from_device(device, device.tick(now))

    def _send_to_hosts(self, frames: list[Frame]) -> None:
        """Give frames of a device to all hosts, unless the cable is cut or the controller is off."""
        if self.cut or self.off:
            return
        for host in self.hosts:
            host.arrived.extend(frames)


class EmulatedCanBus(can.BusABC):
    """A python-can bus whose other end is a CanWire."""

    def __init__(self, wire: CanWire) -> None:
        self._wire = wire
        self.arrived: deque[Frame] = deque()
        super().__init__(channel="emulated")
        self.channel_info = "emulated bench, in process"
        wire.hosts.append(self)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame; the devices have answered when this returns."""
        if self._wire.off:
            raise can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)
        frame_class = FdFrame if msg.is_fd else Frame
        self._wire.from_host(frame_class(msg.arbitration_id, bytes(msg.data)), self)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the oldest frame; if there is none, let time pass until one arrives or for the timeout [s]."""
        arrived, clock = self.arrived, self._wire.clock
        if not arrived and timeout:
            deadline = clock.now() + max(timeout, LEAST_WAIT_S)
            while not arrived and clock.now() < deadline:
                clock.sleep_until(min(deadline, clock.now() + TICK_S))
        if not arrived:
            return None
        return message_of(arrived.popleft(), clock.now())

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self.recv(timeout), True

    def shutdown(self) -> None:
        """Disconnect from the wire."""
        if self in self._wire.hosts:
            self._wire.hosts.remove(self)
        super().shutdown()


class EmulatedI2cBus:
    """smbus2's word calls, answered by emulated devices; an absent address does not acknowledge."""

    def __init__(self, clock: EmulatedClock) -> None:
        self._clock = clock
        self.devices: dict[int, I2cEmulator] = {}
        self.silent: list[I2cEmulator] = []  # devices that are unplugged
        clock.follow(self._pass_time)
        clock.stop_at(self._due)

    def _due(self) -> float:
        """Return the next time [s] at which a device is due, rounded up to a multiple of 1 / `MOST_STOPS_PER_S`."""
        earliest_due = min((device.due for device in self.devices.values()), default=math.inf)
        return (
            math.ceil(earliest_due * MOST_STOPS_PER_S) / MOST_STOPS_PER_S if earliest_due < math.inf else earliest_due
        )

    def _pass_time(self, now: float) -> None:
        for device in self.devices.values():
            if now >= device.due:
                device.tick(now)

    def _answering_device(self, address: int) -> I2cEmulator:
        """Return the device at an address; raise OSError if none is there or its plug is out."""
        device = self.devices.get(address)
        if device is None or device in self.silent:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        return device

    def read_word_data(self, i2c_addr: int, register: int) -> int:
        """Read a 16-bit register; the first byte on the wire is the low one of the word."""
        return swap_bytes(self._answering_device(i2c_addr).read(register, self._clock.now()))

    def write_word_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write a 16-bit register; the low byte of the word is sent first."""
        self._answering_device(i2c_addr).write(register, swap_bytes(value), self._clock.now())

    def close(self) -> None:
        """Do nothing: no connection is held."""
