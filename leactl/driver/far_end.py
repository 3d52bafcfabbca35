"""The far end of a wire: what an emulator of a device is, and the machine that an emulated drive turns.

An emulator knows frames or bytes and time, no transport: frames in, frames out. The physics behind it is a port of
plain readings, so that the same emulator turns the emulated bench or a stand-in of a test.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable


class Frame(NamedTuple):
    """A CAN frame with an 11-bit identifier."""

    identifier: int
    data: bytes


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

    def reading(self, quantity: str, role: str) -> Callable[[], float]:
        """A function that gives this quantity as the bench has it now, sensor noise included.

        Raises
        ------
        InputError : the bench has no such quantity.
        """
