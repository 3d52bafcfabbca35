"""Damage to what a device sends, between its far end and the wire, for drivers of any kind.

What happens to whole frames and answers (lost, doubled, late, cut short, one too many) a driver can tell, by length,
form, number or time. Bytes that are others in a frame of the right form it cannot tell where the protocol has no
checksum: they have to break nothing, and what a row then says is not judged.
"""

import heapq
import math
import random
from collections import Counter
from collections.abc import Callable
from typing import Any

from leactl.driver.far_end import FdFrame

WHOLE = ("lose", "double", "hold back", "cut short", "lengthen", "insert")
BYTES = ("other byte", "other bytes", "drop byte", "double byte", "insert byte")
LATEST_S = 0.3  # by which an answer is held back
FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)  # bytes that a CAN-FD frame can have
NOISE = (b"\xff\x00", b"#\r\n", b"\n", b"\r", b"?\n")  # on a serial line, which no answer consists of


class Damage:
    """Chooses what happens to each frame or answer, and counts; nothing does before `on`."""

    def __init__(self, kinds: tuple[str, ...], seed: str) -> None:
        self.rng = random.Random(seed)
        self.kinds, self.rate = kinds, self.rng.choice((0.02, 0.1, 0.5))
        self.on, self.counts = False, Counter[str]()

    def kind(self, size: int = 1) -> str:
        """What happens to the next one; nothing mostly. It counts for so much."""
        if not self.on or self.rng.random() >= self.rate:
            return ""
        kind = self.rng.choice(self.kinds)
        self.counts[kind] += size
        return kind

    def content(self, data: bytes, kind: str) -> bytes:
        """Bytes with one or all of them changed."""
        at = self.rng.randrange(len(data) + (kind == "insert byte"))
        byte = bytes([self.rng.randrange(256)])
        match kind:
            case "other byte":
                return data[:at] + byte + data[at + 1 :]
            case "other bytes":
                return self.rng.randbytes(len(data))
            case "drop byte":
                return data[:at] + data[at + 1 :]
            case "double byte":
                return data[: at + 1] + data[at:]
        return data[:at] + byte + data[at:]


class Between:
    """The far end as the wire has it; what the emulator can do besides, it can still."""

    def __init__(self, far_end: Any, damage: Damage) -> None:
        self._far_end, self._damage = far_end, damage
        self._late: list[tuple[float, int, Any]] = []
        self._number = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._far_end, name)

    @property
    def due(self) -> float:
        """Also when something that was held back is to come."""
        return min(self._far_end.due, self._late[0][0] if self._late else math.inf)

    def hold_back(self, what: Any, now: float) -> None:
        """Send this later."""
        self._number += 1
        heapq.heappush(self._late, (now + self._damage.rng.uniform(1e-3, LATEST_S), self._number, what))

    def now_late(self, now: float) -> list[Any]:
        """What was held back until now."""
        came = []
        while self._late and self._late[0][0] <= now:
            came.append(heapq.heappop(self._late)[2])
        return came


class CanBetween(Between):
    """On a CAN bus."""

    def __init__(self, far_end: Any, damage: Damage) -> None:
        super().__init__(far_end, damage)
        self._seen: set[int] = set()

    def receive(self, frame, now):
        return self._damaged(self._far_end.receive(frame, now), now)

    def tick(self, now):
        return self.now_late(now) + self._damaged(self._far_end.tick(now) if now >= self._far_end.due else [], now)

    def _damaged(self, frames, now):
        return [sent for frame in frames for sent in self._changed(frame, now)]

    def _changed(self, frame, now):
        damage, rng, data = self._damage, self._damage.rng, frame.data
        self._seen.add(frame.identifier)
        match damage.kind():
            case "":
                return [frame]
            case "lose":
                return []
            case "double":
                return [frame, frame]
            case "hold back":
                self.hold_back(frame, now)
                return []
            case "cut short":
                return [frame._replace(data=data[: self._length(frame, rng.randrange(len(data) or 1), max)])]
            case "lengthen" if isinstance(frame, FdFrame):  # its protocol may have any number of parts in a frame
                return [frame, frame]
            case "lengthen":
                length = self._length(frame, len(data) + 1, min)
                return [frame._replace(data=data + rng.randbytes(length - len(data)))]
            case "insert":
                others = [identifier for identifier in range(0x100, 0x800) if identifier not in self._seen]
                return [frame._replace(identifier=rng.choice(others), data=rng.randbytes(len(data))), frame]
            case "other byte" | "other bytes" as kind if data:
                return [frame._replace(data=damage.content(data, kind))]
        return [frame._replace(identifier=frame.identifier ^ 1 << rng.randrange(11))]

    @staticmethod
    def _length(frame, wanted, choose: Callable):
        """The next length that such a frame can have: none above, or none below."""
        lengths = FD_LENGTHS if isinstance(frame, FdFrame) else range(9)
        fitting = [length for length in lengths if (length <= wanted if choose is max else length >= wanted)]
        return choose(fitting, default=len(frame.data))


class SerialBetween(Between):
    """On a serial line; an answer is what the emulator sends at once."""

    def receive(self, data, now):
        self._far_end.receive(data, now)

    def tick(self, now):
        sent = self._far_end.tick(now) if now >= self._far_end.due else b""
        return b"".join(self.now_late(now)) + (self._changed(sent, now) if sent else b"")

    def _changed(self, sent, now):
        damage, rng = self._damage, self._damage.rng
        match kind := damage.kind(len(sent) if damage.kinds is WHOLE else 1):
            case "":
                return sent
            case "lose":
                return b""
            case "double":
                return sent + sent
            case "hold back":
                self.hold_back(sent, now)
                return b""
            case "cut short":
                return sent[: rng.randrange(len(sent))]
            case "lengthen":
                return sent + rng.choice(NOISE)
            case "insert":
                return rng.choice(NOISE) + sent
        return damage.content(sent, kind)


class I2cBetween(Between):
    """On an I2C bus; a transfer is not acknowledged, or its register has other bits."""

    def read(self, register, now):
        match self._damage.kind():
            case "":
                return self._far_end.read(register, now)
            case "other byte" | "other bytes":
                return self._damage.rng.randrange(0x10000)
        raise OSError(121, "Remote I/O error")

    def write(self, register, value, now):
        if self._damage.kind() not in ("", "other byte", "other bytes"):
            raise OSError(121, "Remote I/O error")
        self._far_end.write(register, value, now)

    def tick(self, now):
        self._far_end.tick(now)


BETWEEN = {"can": CanBetween, "serial": SerialBetween, "i2c": I2cBetween}


def damaged(driver: type, damage: Damage) -> type:
    """A driver whose far end's wire is damaged."""
    put = BETWEEN[driver.transport]

    def far_end(cls, settings, role, physics):
        far = driver.far_end(settings, role, physics)
        return (far[0], put(far[1], damage)) if driver.transport == "i2c" else put(far, damage)

    return type(driver.__name__, (driver,), {"far_end": classmethod(far_end), "__doc__": driver.__doc__})
