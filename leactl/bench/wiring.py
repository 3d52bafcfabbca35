"""Connections to buses and the clock: those of this machine; an emulated bench has a wiring of the same interface."""

import logging
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from leactl.bench.benchfile import Bus, CanBus, I2cBus, LineBus, VisaBus
from leactl.driver.clock import Clock, MonotonicClock
from leactl.driver.i2c_port import SmBus
from leactl.driver.serial_port import SerialLine
from leactl.errors import InputError

if TYPE_CHECKING:
    import can


# a bus whose constructor failed complains there that nobody shut it down (python-can 4.6); the failure itself is raised
logging.getLogger("can").addHandler(logging.NullHandler())


def unknown_interface(bus: CanBus) -> str:
    """A line if python-can does not have the interface of a bus; else empty."""
    import can

    known = sorted(can.VALID_INTERFACES)
    if bus.interface in known:
        return ""
    close = get_close_matches(bus.interface, known, n=1)
    expected = close[0] if close else f"one of {', '.join(known)}"
    return f"python-can has no interface '{bus.interface}'; {expected} was expected"


class Wiring(Protocol):
    """Factories of connections, and their clock."""

    @property
    def clock(self) -> Clock:
        """The bench's clock."""

    def can(self, name: str, bus: CanBus) -> "Callable[[], can.BusABC]":
        """Function that connects to a CAN bus."""

    def i2c(self, name: str, bus: I2cBus) -> Callable[[], SmBus]:
        """Function that connects to an I2C bus."""

    def library(self, device: str) -> Any:
        """Replacement of the maker's library for a device without a bus; None for the library itself."""

    def wait_for_disk(self) -> None:
        """Called before each write of the run file; an emulated bench waits here for its emulated disk."""

    def hang(self, torque: float) -> None:
        """Apply the torque [N*m] of weights on the torque sensor from now on."""

    def serial(self, name: str, bus: LineBus) -> Callable[[], SerialLine]:
        """Function that connects to a serial line."""


class MachineWiring:
    """The buses of this machine."""

    def __init__(self) -> None:
        self.clock: Clock = MonotonicClock()

    def load(self, buses: Iterable[Bus]) -> None:
        """Import what connecting to these buses needs, so that a later connection reads no module from a disk."""
        import_module("encodings.idna")  # by which sockets take an address
        for bus in buses:
            if isinstance(bus, CanBus):
                from can.interfaces import BACKENDS

                if bus.interface in BACKENDS:
                    import_module(BACKENDS[bus.interface][0])
            elif isinstance(bus, I2cBus):
                import_module("smbus2")
            elif isinstance(bus, VisaBus):
                import_module("leactl.bench.instrument_socket")
            else:
                import_module("leactl.bench.tty")
                import_module("serial")

    def can(self, name: str, bus: CanBus) -> "Callable[[], can.BusABC]":
        """Function that connects through any of python-can's interfaces."""

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
        """Function that connects through smbus2."""

        def connect() -> SmBus:
            from smbus2 import SMBus

            connected: SmBus = SMBus(bus.number)
            return connected

        return connect

    def library(self, device: str) -> Any:
        """None: the driver calls the installed library."""
        return None

    def wait_for_disk(self) -> None:
        """Do nothing: the disk is real."""

    def hang(self, torque: float) -> None:
        """Do nothing: the operator hangs the weights."""

    def serial(self, name: str, bus: LineBus) -> Callable[[], SerialLine]:
        """Function that connects to a serial device, or to the raw socket of an instrument."""

        def connect() -> SerialLine:
            if isinstance(bus, VisaBus):
                from leactl.bench.instrument_socket import InstrumentSocket

                return InstrumentSocket(*bus.address)
            from leactl.bench.tty import Tty

            return Tty(bus)

        return connect
