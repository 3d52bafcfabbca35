"""A drive, its emulator and the wire between them, with every frame kept."""

import math

import can
from leactl_plugins.elmo_can.driver import ElmoCan
from leactl_plugins.elmo_can.emulator import ElmoEmulator
from leactl_plugins.elmo_can.settings import ElmoSettings

from leactl.driver.can_port import CanPort
from leactl.driver.far_end import Frame
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.wires import CanWire, EmulatedCanBus

RATED_MA = 11186
COUNTS = 40000


class Shaft:
    """A machine that reports what it was told last, exactly."""

    voltage = 3.25
    bus_voltage = 29.6

    def __init__(self) -> None:
        self.following = ("off", 0.0)
        self.velocity, self.angle = 0.0, 0.25

    def command(self, mode: str, value: float) -> None:
        self.following = (mode, value)

    def read(self) -> tuple[float, float, float]:
        mode, value = self.following
        return (value if mode == "current" else 0.0), self.velocity, self.angle


class Recorder(EmulatedCanBus):
    """The wire with a tape: frames of the host in `sent`, frames of the devices in `came`."""

    def __init__(self, wire: CanWire, tape: list[tuple[str, Frame]]) -> None:
        super().__init__(wire)
        self.tape = tape

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.tape.append(("host", Frame(msg.arbitration_id, bytes(msg.data))))
        super().send(msg, timeout)


class ElmoBench:
    """One node on an emulated wire."""

    def __init__(self, node: int = 1, **settings) -> None:
        self.clock = EmulatedClock()
        self.wire = CanWire(self.clock)
        self.shaft = Shaft()
        self.far = ElmoEmulator(node, self.shaft, rated_current_ma=RATED_MA, counts_per_turn=COUNTS)
        self.wire.attach(self.far)
        self.tape: list[tuple[str, Frame]] = []
        self.port = CanPort(lambda: Recorder(self.wire, self.tape), self.clock)
        self.drive = ElmoCan(
            "drive", "test", ElmoSettings(node=node, counts_per_turn=COUNTS, **settings), self.port, self.clock
        )

    def cycle(self, period: float = 0.001) -> list[float]:
        self.drive.begin_cycle()
        self.port.sync()
        self.drive.end_cycle(self.clock.now() + period / 2)
        self.drive.feed()
        self.clock.sleep_until(self.clock.now() + period)
        return list(self.drive.values)

    def sent(self, identifier: int) -> list[bytes]:
        return [frame.data for side, frame in self.tape if side == "host" and frame.identifier == identifier]


def q_axis(per_mille: int) -> float:
    return per_mille * RATED_MA * 1e-6 * math.sqrt(1.5)
