"""The far end of a wire: what an emulator of a device is, and the machine that an emulated drive turns.

An emulator knows frames or bytes and time, no transport: frames in, frames out. The physics behind it is a port of
plain readings, so that the same emulator turns the emulated bench or a stand-in of a test.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


PAIRS = ("phase_voltage_ab", "phase_voltage_bc", "phase_voltage_ca")


LAST_OF_11_BITS = 0x7FF


class Frame(NamedTuple):
    """A CAN frame; a classic one with an 11-bit identifier where its class says nothing else."""

    identifier: int
    data: bytes


class FdFrame(Frame):
    """A CAN-FD frame whose data goes at the faster rate; an identifier above `LAST_OF_11_BITS` has 29 bits."""

    __slots__ = ()


class Machine(Protocol):
    """What an emulated drive turns and reads; currents in the drive's power-invariant q axis."""

    def command(self, mode: str, value: float) -> None:
        """Follow a setpoint; mode "off" lets no current flow."""

    def read(self) -> tuple[float, float, float]:
        """Current [A], velocity [rad/s] and angle [rad] as the drive's sensors report them now."""

    @property
    def voltage(self) -> float:
        """q-axis voltage [V]."""

    @property
    def bus_voltage(self) -> float:
        """DC link voltage [V]."""


class CanEmulator(Protocol):
    """A device on an emulated CAN bus."""

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Take one frame from the bus and answer it."""

    def tick(self, now: float) -> list[Frame]:
        """Frames that the device sends by itself up to now."""

    @property
    def due(self) -> float:
        """Time at which `tick` next has something to do."""


@runtime_checkable
class Breakable(Protocol):
    """What a drive's emulator may have besides: without it no fault inside the drive can be rehearsed."""

    def freeze(self, frozen: bool) -> None:
        """Hear nothing, answer nothing and go on with the last demand, or come back to life."""

    def fault(self, code: int) -> None:
        """Enter the device's own fault state by itself and tell this error code (CiA 301) as its protocol does."""


@runtime_checkable
class Living(Protocol):
    """What the emulator of a CAN device has besides that shows by itself that it lives."""

    def is_sign_of_life(self, frame: Frame) -> bool:
        """Whether a frame of the device says no more than that."""


@runtime_checkable
class Numbered(Protocol):
    """What an emulator has besides whose device tells its serial number: the bench file may say which."""

    serial_number: str


class SerialEmulator(Protocol):
    """A device at the far end of an emulated serial line; bytes in, bytes out."""

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes as they arrive."""

    def tick(self, now: float) -> bytes:
        """Bytes that the device begins to send now."""

    @property
    def due(self) -> float:
        """Time at which `tick` next has something to do."""


class SupplyLoad(Protocol):
    """What hangs at the terminals of an emulated power supply."""

    def feed(self, voltage: float, current: float) -> tuple[float, float]:
        """Be fed from now on with no more than this voltage [V] and current [A]; those that come of it."""


@runtime_checkable
class FailingSupply(Protocol):
    """What the far end of a power supply has besides, so that its faults can be rehearsed."""

    def stuck_on(self, admits: bool = True) -> None:
        """Switch on no more off; `admits` says whether it owns to that when its output is asked for."""

    def lose_regulation(self, share: float) -> None:
        """Give this share of the voltage and current it is asked for, and say that it does not regulate."""

    def mend(self) -> None:
        """Be whole again."""


class I2cEmulator(Protocol):
    """A device on an emulated I2C bus: 16-bit registers, most significant byte first."""

    def read(self, register: int, now: float) -> int:
        """Read a register."""

    def write(self, register: int, value: int, now: float) -> None:
        """Write a register."""

    def tick(self, now: float) -> None:
        """What the device does by itself up to now."""

    @property
    def due(self) -> float:
        """Time at which `tick` next has something to do; emulated time stops there."""


class BuslessEmulator(Protocol):
    """A device without a bus: what stands in for its maker's library, or for the program that writes its files."""

    def tick(self, now: float) -> None:
        """What the device does by itself up to now; called whenever emulated time has passed."""

    @property
    def due(self) -> float:
        """Time at which `tick` next has something to do; emulated time stops there."""


class Terminals(Protocol):
    """The three line-to-line voltages of a motor, for a converter that is faster than emulated time's steps."""

    @property
    def chance(self) -> "np.random.Generator":
        """The bench's own, for errors that the device adds."""

    def voltages(self, times: "NDArray[np.float64]", pair: int) -> "NDArray[np.float64]":
        """Voltages [V] of a pair, by its place among `PAIRS`, at these times of the last milliseconds."""


class RegisterStore(Protocol):
    """Plain 16-bit registers that the host and a far end both read and write; the kernel's i2c-stub is one."""

    def read(self, register: int) -> int:
        """Read a register."""

    def write(self, register: int, value: int) -> None:
        """Write a register."""


@runtime_checkable
class StoreKeeper(Protocol):
    """What an I2cEmulator may have besides: without it the device cannot be served to other processes."""

    def keep(self, store: RegisterStore, now: float) -> None:
        """Look at the store once: take what the host wrote there, put there what it will read; called often."""


class Physics(Protocol):
    """The bench behind the wires, as a device's far end sees it."""

    def machine(self, role: str) -> Machine:
        """What the drive of this role turns."""

    def reading(self, quantity: str, role: str, location: str = "") -> Callable[[], float]:
        """A function that gives this quantity as the bench has it now, sensor noise included.

        `location` tells places apart that are not alike: `active_...` windings carry a direct current through two
        leads, `inactive_...` ones do not.

        Raises
        ------
        InputError : the bench has no such quantity.
        """

    def terminals(self, role: str) -> Terminals:
        """The three leads of this role's motor.

        Raises
        ------
        InputError : the bench has no such motor.
        """

    def at_supply(self, feeds: str, role: str) -> SupplyLoad:
        """What a power supply feeds: "leads" for two leads of this role's motor, "bus" for the DC link of the drives.

        Raises
        ------
        InputError : the bench has no such thing to feed.
        """
