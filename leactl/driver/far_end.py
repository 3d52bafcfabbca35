"""The far end of a wire: interfaces of device emulators, and of the physics behind them on an emulated bench.

An emulator exchanges frames or bytes and knows the time, but no transport. The physics behind it is an interface of
plain readings, so that the same emulator serves the emulated bench and tests.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


PAIRS = ("phase_voltage_ab", "phase_voltage_bc", "phase_voltage_ca")


LAST_OF_11_BITS = 0x7FF


class Frame(NamedTuple):
    """A CAN frame: a classic frame with an 11-bit identifier, unless it is of a derived class."""

    identifier: int
    data: bytes


class FdFrame(Frame):
    """A CAN-FD frame whose data goes at the faster rate; an identifier above `LAST_OF_11_BITS` has 29 bits."""

    __slots__ = ()


class Machine(Protocol):
    """The motor behind an emulated drive; currents are power-invariant q-axis currents."""

    def command(self, mode: str, value: float) -> None:
        """Follow a setpoint in a mode ("current", "velocity", "angle"); in mode "off" no current flows."""

    def read(self) -> tuple[float, float, float]:
        """Return current [A], velocity [rad/s] and angle [rad] as the drive's sensors measure them now."""

    @property
    def voltage(self) -> float:
        """q-axis voltage [V]."""

    @property
    def bus_voltage(self) -> float:
        """DC link voltage [V]."""


class CanEmulator(Protocol):
    """A device on an emulated CAN bus."""

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Receive one frame from the bus; return the answers."""

    def tick(self, now: float) -> list[Frame]:
        """Return the frames that the device sends by itself until `now` [s]."""

    @property
    def due(self) -> float:
        """Time [s] of the next event of `tick`."""


@runtime_checkable
class Breakable(Protocol):
    """Optional capability of a drive's emulator, needed to rehearse faults inside the drive."""

    def freeze(self, frozen: bool) -> None:
        """Stop answering and keep the last demand (`frozen` True), or return to normal."""

    def fault(self, code: int) -> None:
        """Enter the device's fault state and report this error code (CiA 301) as its protocol does."""


@runtime_checkable
class Living(Protocol):
    """Optional capability of the emulator of a CAN device that sends heartbeats."""

    def is_sign_of_life(self, frame: Frame) -> bool:
        """Return whether a frame of the device is only a heartbeat."""


@runtime_checkable
class Numbered(Protocol):
    """Optional capability of the emulator of a device with a serial number, which the bench file may set."""

    serial_number: str


class SerialEmulator(Protocol):
    """A device at the far end of an emulated serial line; bytes in, bytes out."""

    def receive(self, data: bytes, now: float) -> None:
        """Receive bytes in the order of arrival, one or more per call."""

    def tick(self, now: float) -> bytes:
        """Return the bytes that the device begins to send at `now` [s]."""

    @property
    def due(self) -> float:
        """Time [s] of the next event of `tick`."""


class SupplyLoad(Protocol):
    """The load at the terminals of an emulated power supply."""

    def feed(self, voltage: float, current: float) -> tuple[float, float]:
        """Apply limits of voltage [V] and current [A]; return the resulting voltage and current."""


@runtime_checkable
class FailingSupply(Protocol):
    """Optional capability of the emulator of a power supply, needed to rehearse its faults."""

    def stuck_on(self, admits: bool = True) -> None:
        """Make the output stay on; `admits` tells whether the supply reports it as on."""

    def lose_regulation(self, share: float) -> None:
        """Put out this share of the set voltage and current, and report that it does not regulate.

        A share above 1 is a supply that passes its levels: its over-voltage protection trips.
        """

    def mend(self) -> None:
        """Return to normal operation."""


class I2cEmulator(Protocol):
    """A device on an emulated I2C bus: 16-bit registers, most significant byte first."""

    def read(self, register: int, now: float) -> int:
        """Read a register."""

    def write(self, register: int, value: int, now: float) -> None:
        """Write a register."""

    def tick(self, now: float) -> None:
        """Let the device act by itself until `now` [s]."""

    @property
    def due(self) -> float:
        """Time [s] of the next event of `tick`, at which emulated time stops."""


class BuslessEmulator(Protocol):
    """A device without a bus: replaces the maker's library, or the program that writes its files."""

    def tick(self, now: float) -> None:
        """Let the device act by itself until `now` [s]; called whenever emulated time has passed."""

    @property
    def due(self) -> float:
        """Time [s] of the next event of `tick`, at which emulated time stops."""


class Terminals(Protocol):
    """The three line-to-line voltages of a motor, for a converter that is faster than the steps of emulated time."""

    @property
    def chance(self) -> "np.random.Generator":
        """Random generator of the bench, for errors that the device adds."""

    def voltages(self, times: "NDArray[np.float64]", pair: int) -> "NDArray[np.float64]":
        """Return the voltages [V] of the pair of index `pair` in `PAIRS`, at times [s] within the last milliseconds."""


class RegisterStore(Protocol):
    """16-bit registers that host and emulator both read and write, such as the kernel's i2c-stub."""

    def read(self, register: int) -> int:
        """Read a register."""

    def write(self, register: int, value: int) -> None:
        """Write a register."""


@runtime_checkable
class StoreKeeper(Protocol):
    """Optional capability of an I2cEmulator, needed to serve the device to other processes."""

    def keep(self, store: RegisterStore, now: float) -> None:
        """Exchange with the store once: read what the host wrote, write what it will read; called often."""


class Physics(Protocol):
    """The physics of an emulated bench, as a device's emulator sees it."""

    def machine(self, role: str) -> Machine:
        """Return the motor of this role."""

    def reading(self, quantity: str, role: str, location: str = "") -> Callable[[], float]:
        """Return a function that returns the present value of a quantity, sensor noise included.

        `location` distinguishes windings: a winding `active_...` carries a direct current through two leads, a winding
        `inactive_...` does not.

        Raises
        ------
        InputError : the bench has no such quantity.
        """

    def terminals(self, role: str) -> Terminals:
        """Return the three leads of this role's motor.

        Raises
        ------
        InputError : the bench has no such motor.
        """

    def at_supply(self, feeds: str, role: str) -> SupplyLoad:
        """Return the load of a power supply; `feeds` is "leads" (two leads of the role's motor) or "bus" (the DC link).

        Raises
        ------
        InputError : the bench has no such thing to feed.
        """
