"""A drive's driver, its far end and the wire between them, with every frame of the host kept."""

import math

from leactl_plugins.elmo_can.driver import ElmoCan
from leactl_plugins.elmo_can.settings import ElmoSettings

from leactl.driver.can_port import CanPort
from leactl.driver.far_end import Frame

from .failing import COUNTS, PER_MILLE_A, RATED_MA, Shaft
from .transports import CanInProcess

ANSWER_S = 5.0  # how long an answer may take on a real bus; it is not waited for once it is there


class Tap:
    """A connection to a bus with a tape of what the host sent."""

    def __init__(self, bus, tape: list[Frame]) -> None:
        self._bus, self._tape = bus, tape

    def send(self, message) -> None:
        self._tape.append(Frame(message.arbitration_id, bytes(message.data)))
        self._bus.send(message)

    def __getattr__(self, name):
        return getattr(self._bus, name)


class ElmoBench:
    """One drive at the host's wire."""

    def __init__(self, node: int = 1, wire=None, **settings) -> None:
        wire = wire or CanInProcess()
        self.exact, self.clock, self.node = wire.exact, wire.clock, node
        self.far = wire.drive(node)
        self.tape: list[Frame] = []
        self.port = CanPort(lambda: Tap(wire.connect(), self.tape), self.clock, returns_own=wire.returns_own)
        checked = ElmoSettings(node=node, counts_per_turn=COUNTS, **(wire.settings | settings))
        self.drive = ElmoCan("drive", "test", checked, self.port, self.clock)

    @property
    def shaft(self) -> Shaft:
        """What the drive turns; in process only."""
        return self.far.shaft

    def cycle(self, period: float = 0.001, answer_s: float | None = None) -> list[float]:
        """One cycle as the control loop makes it; real buses set the pace themselves."""
        self.drive.begin_cycle()
        self.port.sync()
        self.drive.end_cycle(self.clock.now() + (answer_s or (period / 2 if self.exact else ANSWER_S)))
        self.drive.feed()
        if self.exact:
            self.clock.sleep_until(self.clock.now() + period)
        return list(self.drive.values)

    def engage(self, mode) -> None:
        self.drive.engage(mode)
        while not self.drive.engaged:
            self.cycle()

    def wait_until(self, reached, limit: float = 10.0) -> float:
        """Leave the bus alone until the far end has got there; the seconds it took."""
        began = self.clock.now()
        while not reached():
            assert self.clock.now() - began < limit
            if self.exact:
                self.clock.sleep_until(self.clock.now() + 0.001)
        return self.clock.now() - began

    def transfer(self, request: str) -> str:
        """One SDO transfer without the driver, frames in hex."""
        if self.port.bus is None:
            self.port.open()
        answers: list[str] = []
        came = [False]

        def take(data: bytearray, _time: float) -> None:
            answers.append(data.hex())
            came[0] = True

        self.port.listen(0x580 + self.node, take)
        self.port.send(0x600 + self.node, bytes.fromhex(request))
        assert self.port.pump_until(came, self.clock.now() + ANSWER_S)
        return answers[0]

    def sent(self, identifier: int) -> list[bytes]:
        return [frame.data for frame in self.tape if frame.identifier == identifier]

    def close(self) -> None:
        self.drive.close()
        if self.port.bus is not None:  # opened by `transfer`
            self.port.close()
        assert self.port.bus is None


def q_axis(per_mille: int) -> float:
    return per_mille * RATED_MA * 1e-6 * math.sqrt(1.5)


FRESH, EMPTY = (0, 0, 0), (None, None, None)


def ages_of(row: list[float], number: int) -> tuple[int | None, ...]:
    """How many SYNCs old a counting drive's current, velocity and angle are at a SYNC; None where they are left out."""
    numbers = row[3] / PER_MILLE_A, row[4] * COUNTS / (2 * math.pi), row[5] * COUNTS / (2 * math.pi)
    wanted = number % 1000, number, number
    return tuple(None if math.isnan(read) else round(want - read) for read, want in zip(numbers, wanted, strict=True))
