"""An emulated serial line in the same process: bytes take time in either direction, by the emulated clock.

Synchronous and without threads: time passes only while the host waits. Events that one wait spans happen in their
order and at their own times.
"""

import math
from collections import deque

from leactl.driver.far_end import SerialEmulator
from leactl.emulation.clock import EmulatedClock

TICK_S = 1e-3  # of emulated time, between two looks for a byte
MOST_UNSENT_BYTES = 4096  # in the host's transmit buffer, as in a kernel's


class SerialWire:
    """The line between one emulated device and the hosts that have connected; the last one receives."""

    def __init__(self, clock: EmulatedClock, byte_s: float) -> None:
        self.clock, self.byte_s = clock, byte_s
        self.device: SerialEmulator | None = None
        self.cut = False  # the cable is unplugged: nothing arrives, on either side
        self.gone = False  # the adapter was pulled out of the host
        self._to_device: deque[tuple[float, int]] = deque()  # time of arrival [s], byte
        self._to_host: deque[tuple[float, int]] = deque()
        clock.follow(self._pass_time)

    def from_host(self, data: bytes) -> int:
        """Begin to send a host's bytes; return how many fit into the buffer."""
        accepted = data[: MOST_UNSENT_BYTES - len(self._to_device)]
        self._send(self._to_device, accepted, self.clock.now())
        return len(accepted)

    def to_host(self) -> bytes:
        """Remove and return the bytes that have arrived at the host."""
        return self._take_arrived(self._to_host, self.clock.now())

    def forget(self) -> None:
        """Drop the bytes on the line, when a host connects or disconnects."""
        self._to_device.clear()
        self._to_host.clear()

    def _send(self, queue: "deque[tuple[float, int]]", data: bytes, now: float) -> None:
        """Queue bytes to arrive one after the other, behind those that are on the line."""
        arrival_time = max(now, queue[-1][0] if queue else -math.inf)
        for byte in data:
            arrival_time += self.byte_s
            queue.append((arrival_time, byte))

    def _take_arrived(self, queue: "deque[tuple[float, int]]", now: float) -> bytes:
        """Remove and return the bytes of a queue that have arrived; none arrives over a cut line."""
        received = bytearray()
        while queue and queue[0][0] <= now:
            received.append(queue.popleft()[1])
        return b"" if self.cut else bytes(received)

    def _pass_time(self, now: float) -> None:
        """Let bytes arrive and the device act, in their order, up to a time [s]."""
        device = self.device
        if device is None:
            return
        while True:
            next_arrival, tick_due = (self._to_device[0][0] if self._to_device else math.inf), device.due
            if min(next_arrival, tick_due) > now:
                return
            if next_arrival <= tick_due:
                device.receive(self._take_arrived(self._to_device, next_arrival), next_arrival)
            else:
                self._send(self._to_host, device.tick(tick_due), tick_due)


class EmulatedSerialLine:
    """A host's connection to a SerialWire."""

    def __init__(self, wire: SerialWire) -> None:
        if wire.gone:
            raise FileNotFoundError("no such device")
        self._wire = wire
        wire.forget()

    def read(self, timeout: float) -> bytes:
        """Return the bytes that have arrived; if there are none, let time pass until some do or for the timeout [s]."""
        clock = self._wire.clock
        deadline = clock.now() + timeout
        while True:
            self._expect_adapter()
            received = self._wire.to_host()
            if received or clock.now() >= deadline:
                return received
            clock.sleep_until(min(deadline, clock.now() + TICK_S))

    def write(self, data: bytes) -> int:
        """Begin to send bytes; return how many fit into the buffer."""
        self._expect_adapter()
        return self._wire.from_host(data)

    def close(self) -> None:
        """Disconnect from the line."""
        self._wire.forget()

    def _expect_adapter(self) -> None:
        """Raise OSError if the adapter was pulled out."""
        if self._wire.gone:
            raise OSError("nothing is at the other end")
