"""A CAN bus of 1 Mbit/s in this process: each frame takes the time of its bits, and the lowest identifier goes first.

Bits by ISO 11898-1: 11-bit identifier, CRC of 15 bits, a stuff bit after five alike up to there, 13 more without.
"""

import itertools
import os
import time
from collections import deque
from functools import lru_cache
from typing import NamedTuple

import can

from leactl.driver.far_end import Frame
from tests.benchmarks.replay import HEARTBEAT_EVERY, SYNC, VOLTAGE_ANSWER, VOLTAGE_REQUEST, RehearsedBus

BIT_S = 1e-6
CRC = 0x4599
END_BITS = 13  # CRC delimiter, acknowledgement and its delimiter, end of frame (7), pause (3)
SLEEP_S = 2e-4  # the thread sleeps only if more than this is left to wait: waking up takes some 0.1 ms


@lru_cache(maxsize=1 << 16)
def bits_of(identifier: int, data: bytes) -> int:
    """Bits that a frame takes of the bus, stuff bits and the pause behind it included."""
    head = f"0{identifier:011b}000{len(data):04b}" + "".join(f"{byte:08b}" for byte in data)
    crc = 0
    for bit in head:
        crc = crc << 1 ^ (CRC if int(bit) ^ crc >> 14 else 0)
        crc &= 0x7FFF
    stuffed, alike, last = 0, 0, ""
    for bit in head + f"{crc:015b}":
        alike = alike + 1 if bit == last else 1
        last = bit
        if alike == 5:
            stuffed, alike, last = stuffed + 1, 1, "01"[bit == "0"]
    return len(head) + 15 + stuffed + END_BITS


class Pending(NamedTuple):
    """A frame that waits for the bus; the lowest is sent first."""

    identifier: int
    number: int
    ready: float  # s
    data: bytes
    by_host: bool


class TimedBus(RehearsedBus):
    """Rehearses with emulated drives, and plays their answers then, each when the bus has carried it."""

    def __init__(self, *arguments) -> None:
        super().__init__(*arguments)
        self._pending: list[Pending] = []
        self._free = 0.0  # time at which the bus is free next [s]
        self._numbers = itertools.count()  # frames of one identifier go in order
        self._carried: deque[tuple[float, Frame]] = deque()
        self.syncs = 0
        self.cyclic_bits = 0  # of SYNC and PDOs, without heartbeats and SDOs

    def replay(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a frame of the host."""
        self._queue(time.monotonic(), msg.arbitration_id, bytes(msg.data), by_host=True)

    def _queue(self, ready: float, identifier: int, data: bytes, by_host: bool) -> None:
        self._pending.append(Pending(identifier, next(self._numbers), ready, data, by_host))

    def _carry(self, now: float) -> None:
        """Send every frame whose start lies at or before now, in the order of priority."""
        while self._pending:
            begins = max(self._free, min(frame.ready for frame in self._pending))
            if begins > now:
                return
            frame = min(frame for frame in self._pending if frame.ready <= begins)
            self._pending.remove(frame)
            bits = bits_of(frame.identifier, frame.data)
            self._free = begins + bits * BIT_S
            if frame.identifier == SYNC or 0x180 <= frame.identifier < 0x580:
                self.cyclic_bits += bits
            if frame.by_host:
                self._answer(frame)
            else:
                self._carried.append((self._free, Frame(frame.identifier, frame.data)))

    def _answer(self, frame: Pending) -> None:
        if frame.identifier == SYNC:
            self.syncs += 1
            beats = self.heartbeats if self.syncs % HEARTBEAT_EVERY == 0 else ()
            for answer in (*self.answers, *beats):
                self._queue(self._free, answer.identifier, answer.data, by_host=False)
        elif frame.identifier >= 0x600 and frame.data == VOLTAGE_REQUEST:
            self._queue(self._free, frame.identifier - 0x80, VOLTAGE_ANSWER, by_host=False)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.arrived:  # what the rehearsal has left
            return super()._recv_internal(timeout)
        until = time.monotonic() + (timeout or 0.0)
        while True:
            now = time.monotonic()
            self._carry(now)
            if self._carried and self._carried[0][0] <= now:
                identifier, data = self._carried.popleft()[1]
                return can.Message(arbitration_id=identifier, is_extended_id=False, data=data), False
            if now >= until:
                return None, False
            carried = [moment for moment, _frame in list(self._carried)[:1]]
            left = min([until, *carried, *([self._free] if self._pending else [])]) - now
            if left > SLEEP_S:
                time.sleep(left - SLEEP_S)
            else:
                os.sched_yield()  # other threads may run
