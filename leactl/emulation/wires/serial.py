"""An emulated serial line in the same process: bytes take their time in either direction, by the emulated clock.

Synchronous and without threads: time passes only while the host waits. What happens between two looks at the clock
happens in its order and at its own moment.
"""

import math
from collections import deque

from leactl.driver.far_end import SerialEmulator
from leactl.emulation.clock import EmulatedClock

TICK_S = 1e-3
MOST_UNSENT = 4096  # bytes that the host's side holds, as a kernel's does


class SerialWire:
    """The line between one emulated device and the hosts that have connected; the last of them hears."""

    def __init__(self, clock: EmulatedClock, byte_s: float) -> None:
        self.clock, self.byte_s = clock, byte_s
        self.device: SerialEmulator | None = None
        self.cut = False  # the cable is out: nothing arrives, on either side
        self.gone = False  # the adapter was pulled out of the host
        self._down: deque[tuple[float, int]] = deque()  # moment of arrival, byte
        self._up: deque[tuple[float, int]] = deque()
        clock.follow(self._pass_time)

    def from_host(self, data: bytes) -> int:
        """Begin to send a host's bytes; how many were taken."""
        taken = data[: MOST_UNSENT - len(self._down)]
        self._send(self._down, taken, self.clock.now())
        return len(taken)

    def to_host(self) -> bytes:
        """What has arrived at the host."""
        return self._arrived(self._up, self.clock.now())

    def forget(self) -> None:
        """Drop what is under way: a host has let go, or come."""
        self._down.clear()
        self._up.clear()

    def _send(self, way: "deque[tuple[float, int]]", data: bytes, now: float) -> None:
        moment = max(now, way[-1][0] if way else -math.inf)
        for byte in data:
            moment += self.byte_s
            way.append((moment, byte))

    def _arrived(self, way: "deque[tuple[float, int]]", now: float) -> bytes:
        received = bytearray()
        while way and way[0][0] <= now:
            received.append(way.popleft()[1])
        return b"" if self.cut else bytes(received)

    def _pass_time(self, now: float) -> None:
        device = self.device
        if device is None:
            return
        while True:
            arrival, due = (self._down[0][0] if self._down else math.inf), device.due
            if min(arrival, due) > now:
                return
            if arrival <= due:
                device.receive(self._arrived(self._down, arrival), arrival)
            else:
                self._send(self._up, device.tick(due), due)


class EmulatedSerialLine:
    """A host's connection to a SerialWire."""

    def __init__(self, wire: SerialWire) -> None:
        if wire.gone:
            raise FileNotFoundError("no such device")
        self._wire = wire
        wire.forget()

    def read(self, timeout: float) -> bytes:
        """What has come; where that is nothing, let emulated time pass until something does or the time is over."""
        clock = self._wire.clock
        until = clock.now() + timeout
        while True:
            self._check()
            read = self._wire.to_host()
            if read or clock.now() >= until:
                return read
            clock.sleep_until(min(until, clock.now() + TICK_S))

    def write(self, data: bytes) -> int:
        """Begin to send."""
        self._check()
        return self._wire.from_host(data)

    def close(self) -> None:
        """Let the line go."""
        self._wire.forget()

    def _check(self) -> None:
        if self._wire.gone:
            raise OSError("nothing is at the other end")
