"""Emulated buses in the same process: python-can's and smbus2's own calls, answered at once by the devices' far ends.

Synchronous and without threads: a frame is answered inside `send`, and emulated time passes inside `recv`.
"""

import errno
import math
from collections import deque

import can

from leactl.driver.far_end import CanEmulator, Frame, I2cEmulator
from leactl.driver.i2c_port import swapped
from leactl.emulation.clock import EmulatedClock

TICK_S = 1e-3
STOPS_PER_S = 8000  # at most 0.125 ms late for a device, and few of the plant's own steps


class CanWire:
    """The segment that emulated devices and any number of host connections share."""

    def __init__(self, clock: EmulatedClock) -> None:
        self.clock = clock
        self.devices: list[CanEmulator] = []
        self.hosts: list[EmulatedCanBus] = []
        self.cut = False  # the cable is out: nothing arrives, on either side
        clock.follow(self._pass_time)

    def attach(self, device: CanEmulator) -> None:
        """Put a device on the segment."""
        self.devices.append(device)

    def from_host(self, frame: Frame, sender: "EmulatedCanBus") -> None:
        """Deliver a host's frame, and what it makes the devices say."""
        if self.cut:
            return
        now = self.clock.now()
        answers: list[Frame] = []
        for device in self.devices:
            answers += device.receive(frame, now)
        for host in self.hosts:
            if host is not sender:
                host.arrived.append(frame)
        self._to_hosts(answers)

    def _pass_time(self, now: float) -> None:
        frames: list[Frame] = []
        for device in self.devices:
            if now >= device.due:
                frames += device.tick(now)
        if frames and not self.cut:
            self._to_hosts(frames)

    def _to_hosts(self, frames: list[Frame]) -> None:
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
        self._wire.from_host(Frame(msg.arbitration_id, bytes(msg.data)), self)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Take the oldest frame; where there is none, let emulated time pass until one comes or `timeout` is over."""
        arrived, clock = self.arrived, self._wire.clock
        if not arrived and timeout:
            until = clock.now() + timeout
            while not arrived and clock.now() < until:
                clock.sleep_until(min(until, clock.now() + TICK_S))
        if not arrived:
            return None
        identifier, data = arrived.popleft()
        return can.Message(clock.now(), identifier, False, data=data)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self.recv(timeout), True

    def shutdown(self) -> None:
        """Leave the wire."""
        if self in self._wire.hosts:
            self._wire.hosts.remove(self)
        super().shutdown()


class EmulatedI2cBus:
    """smbus2's word calls, answered by emulated devices; an absent address does not acknowledge."""

    def __init__(self, clock: EmulatedClock) -> None:
        self._clock = clock
        self.devices: dict[int, I2cEmulator] = {}
        clock.follow(self._pass_time)
        clock.stop_at(self._due)

    def _due(self) -> float:
        due = min((device.due for device in self.devices.values()), default=math.inf)
        return math.ceil(due * STOPS_PER_S) / STOPS_PER_S if due < math.inf else due

    def _pass_time(self, now: float) -> None:
        for device in self.devices.values():
            if now >= device.due:
                device.tick(now)

    def _device(self, address: int) -> I2cEmulator:
        device = self.devices.get(address)
        if device is None:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        return device

    def read_word_data(self, i2c_addr: int, register: int) -> int:
        """Read a 16-bit register; the byte that comes first is the low one of the word."""
        return swapped(self._device(i2c_addr).read(register, self._clock.now()))

    def write_word_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write a 16-bit register; the low byte of the word goes first."""
        self._device(i2c_addr).write(register, swapped(value), self._clock.now())

    def close(self) -> None:
        """Let the bus go."""
