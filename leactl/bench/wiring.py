"""Connect to the buses and the clock of this machine, by an interface that emulated benches share."""

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


# python-can 4.6 logs here that a bus was not shut down if its constructor failed; that failure is raised anyway
logging.getLogger("can").addHandler(logging.NullHandler())


def unknown_interface(bus: CanBus) -> str:
    """Return a line on the interface of a bus that python-can does not have; else an empty text."""
    import can

    interfaces = sorted(can.VALID_INTERFACES)
    if bus.interface in interfaces:
        return ""
    similar = get_close_matches(bus.interface, interfaces, n=1)
    expected = similar[0] if similar else f"one of {', '.join(interfaces)}"
    return f"python-can has no interface '{bus.interface}'; {expected} was expected"


class Wiring(Protocol):
    """Makes functions that connect to the buses of a bench, and has the clock of the bench."""

    @property
    def clock(self) -> Clock:
        """The bench's clock."""

    def can(self, name: str, bus: CanBus) -> "Callable[[], can.BusABC]":
        """Return a function that connects to a CAN bus."""

    def i2c(self, name: str, bus: I2cBus) -> Callable[[], SmBus]:
        """Return a function that connects to an I2C bus."""

    def emulator_of(self, device: str) -> Any:
        """Return the emulator that replaces the library of a device without a bus; None: the library is used."""

    def wait_for_disk(self) -> None:
        """Wait for the emulated disk of an emulated bench; called before each write of the run file."""

    def apply_weight_torque(self, torque: float) -> None:
        """Apply the torque of weights [N*m] to the torque sensor from now on."""

    def serial(self, name: str, bus: LineBus) -> Callable[[], SerialLine]:
        """Return a function that connects to a serial line."""


class MachineWiring:
    """Wiring of the buses of this machine."""

    def __init__(self) -> None:
        self.clock: Clock = MonotonicClock()

    def load(self, buses: Iterable[Bus]) -> None:
        """Import the modules that connections to these buses need, so that a connection reads no module from a disk."""
        import_module("encodings.idna")  # needed by a socket for its address
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
        """Return a function that connects through python-can.

        The function raises InputError if python-can has no such interface.
        """

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
        """Return a function that connects through smbus2."""

        def connect() -> SmBus:
            from smbus2 import SMBus

            connected: SmBus = SMBus(bus.number)
            return connected

        return connect

    def emulator_of(self, device: str) -> Any:
        """Return None: the driver uses the installed library."""
        return None

    def wait_for_disk(self) -> None:
        """Do nothing: the disk is real."""

    def apply_weight_torque(self, torque: float) -> None:
        """Do nothing: the operator hangs the weights up."""

    def serial(self, name: str, bus: LineBus) -> Callable[[], SerialLine]:
        """Return a function that connects to a serial device, or to the raw socket of an instrument."""

        def connect() -> SerialLine:
            if isinstance(bus, VisaBus):
                from leactl.bench.instrument_socket import InstrumentSocket

                return InstrumentSocket(*bus.address)
            from leactl.bench.tty import Tty

            return Tty(bus)

        return connect
