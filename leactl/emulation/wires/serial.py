"""An emulated serial line in the same process: bytes take time in either direction, by the emulated clock.

Synchronous and without threads: time passes only while the host waits. Events between two readings of the clock happen
in their order and at their own times.
"""

import math
from collections import deque

from leactl.driver.far_end import SerialEmulator
from leactl.emulation.clock import EmulatedClock

TICK_S = 1e-3
MOST_UNSENT = 4096  # bytes in the host's transmit buffer, as in a kernel's


class SerialWire:
    """The line between one emulated device and the hosts that have connected; the last one receives."""

    def __init__(self, clock: EmulatedClock, byte_s: float) -> None:
        self.clock, self.byte_s = clock, byte_s
        self.device: SerialEmulator | None = None
        self.cut = False  # the cable is unplugged: nothing arrives, on either side
        self.gone = False  # the adapter was pulled out of the host
        self._to_device: deque[tuple[float, int]] = deque()  # moment of arrival, byte
        self._to_host: deque[tuple[float, int]] = deque()
        clock.follow(self._pass_time)

    def from_host(self, data: bytes) -> int:
        """Begin to send a host's bytes; returns how many fit into the buffer."""
        accepted = data[: MOST_UNSENT - len(self._to_device)]
        self._send(self._to_device, accepted, self.clock.now())
        return len(accepted)

    def to_host(self) -> bytes:
        """Take the bytes that have arrived at the host."""
        return self._arrived(self._to_host, self.clock.now())

    def forget(self) -> None:
        """Drop the bytes on the line, when a host connects or disconnects."""
        self._to_device.clear()
        self._to_host.clear()

    def _send(self, queue: "deque[tuple[float, int]]", data: bytes, now: float) -> None:
        moment = max(now, queue[-1][0] if queue else -math.inf)
        for byte in data:
            moment += self.byte_s
            queue.append((moment, byte))

    def _arrived(self, queue: "deque[tuple[float, int]]", now: float) -> bytes:
        received = bytearray()
        while queue and queue[0][0] <= now:
            received.append(queue.popleft()[1])
        return b"" if self.cut else bytes(received)

    def _pass_time(self, now: float) -> None:
        device = self.device
        if device is None:
            return
        while True:
            arrival, due = (self._to_device[0][0] if self._to_device else math.inf), device.due
            if min(arrival, due) > now:
                return
            if arrival <= due:
                device.receive(self._arrived(self._to_device, arrival), arrival)
            else:
                self._send(self._to_host, device.tick(due), due)


class EmulatedSerialLine:
    """A host's connection to a SerialWire."""

    def __init__(self, wire: SerialWire) -> None:
        if wire.gone:
            raise FileNotFoundError("no such device")
        self._wire = wire
        wire.forget()

    def read(self, timeout: float) -> bytes:
        """Take the bytes that have arrived; if there are none, let emulated time pass until some do or time is up."""
        clock = self._wire.clock
        until = clock.now() + timeout
        while True:
            self._check()
            read = self._wire.to_host()
            if read or clock.now() >= until:
                return read
            clock.sleep_until(min(until, clock.now() + TICK_S))

    def write(self, data: bytes) -> int:
        """Begin to send; returns how many bytes fit into the buffer."""
        self._check()
        return self._wire.from_host(data)

    def close(self) -> None:
        """Disconnect from the line."""
        self._wire.forget()

    def _check(self) -> None:
        if self._wire.gone:
            raise OSError("nothing is at the other end")
