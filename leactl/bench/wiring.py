"""Where buses and time come from: the machine's own here; an emulated bench brings another wiring of the same shape."""

import logging
from collections.abc import Callable
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Protocol

from leactl.bench.benchfile import CanBus, I2cBus, SerialBus
from leactl.driver.clock import Clock, MonotonicClock
from leactl.driver.i2c_port import SmBus
from leactl.driver.serial_port import SerialLine
from leactl.errors import InputError

if TYPE_CHECKING:
    import can


# a bus whose constructor failed complains there that nobody shut it down (python-can 4.6); the failure itself is raised
logging.getLogger("can").addHandler(logging.NullHandler())


def unknown_interface(bus: CanBus) -> str:
    """What is wrong with a bus whose interface python-can does not have; empty where it has it."""
    import can

    known = sorted(can.VALID_INTERFACES)
    if bus.interface in known:
        return ""
    close = get_close_matches(bus.interface, known, n=1)
    expected = close[0] if close else f"one of {', '.join(known)}"
    return f"python-can has no interface '{bus.interface}'; {expected} was expected"


class Wiring(Protocol):
    """Factories of connections, and the clock that goes with them."""

    @property
    def clock(self) -> Clock:
        """The bench's clock."""

    def can(self, name: str, bus: CanBus) -> "Callable[[], can.BusABC]":
        """How to connect to a CAN bus."""

    def i2c(self, name: str, bus: I2cBus) -> Callable[[], SmBus]:
        """How to connect to an I2C bus."""

    def library(self, device: str) -> Any:
        """What stands in for the maker's library of a device without a bus; None where it is the library itself."""

    def wait_for_disk(self) -> None:
        """What every write of the run file waits for; a disk that is none of the emulation's takes its own time."""

    def hang(self, torque: float) -> None:
        """Weights that the operator has hung on the torque sensor act with this torque [N*m] from now on."""

    def serial(self, name: str, bus: SerialBus) -> Callable[[], SerialLine]:
        """How to connect to a serial line."""


class MachineWiring:
    """The buses of this machine."""

    def __init__(self) -> None:
        self.clock: Clock = MonotonicClock()

    def can(self, name: str, bus: CanBus) -> "Callable[[], can.BusABC]":
        """Connect through any of python-can's interfaces."""

        def connect() -> "can.BusABC":
            import can

            if fault := unknown_interface(bus):
                raise InputError(f"bus '{name}': {fault}")
            options: dict[str, Any] = dict(bus.options)
            if bus.interface not in ("udp_multicast", "virtual"):
                options.setdefault("bitrate", bus.bitrate)
            return can.Bus(channel=bus.channel, interface=bus.interface, **options)

        return connect

    def i2c(self, name: str, bus: I2cBus) -> Callable[[], SmBus]:
        """Connect through smbus2."""

        def connect() -> SmBus:
            from smbus2 import SMBus

            connected: SmBus = SMBus(bus.number)
            return connected

        return connect

    def library(self, device: str) -> Any:
        """Nothing: the driver calls the library that is installed here."""
        return None

    def wait_for_disk(self) -> None:
        """Nothing: the disk is this machine's own."""

    def hang(self, torque: float) -> None:
        """Nothing: the operator has."""

    def serial(self, name: str, bus: SerialBus) -> Callable[[], SerialLine]:
        """Connect to a serial device."""

        def connect() -> SerialLine:
            from leactl.bench.tty import Tty

            return Tty(bus)

        return connect
