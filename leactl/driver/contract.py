"""What a driver plug-in is: a few required methods, and small capabilities that it may have besides.

A driver declares its settings and channels and composes a transport. `safe_state` is required of every driver and must
work from any state, as often as it is called.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, runtime_checkable

from leactl import yamlblock
from leactl.driver.clock import Clock
from leactl.driver.far_end import BuslessEmulator, CanEmulator, I2cEmulator, Physics, SerialEmulator
from leactl.errors import InputError
from leactl.quantities import ChannelSpec

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SAFE_STATE_S = 1.0  # what a device has to confirm its safe state; no answer and no watchdog may take longer


class DriverSettings(yamlblock.Block):
    """Settings of one device in the bench file; every field's name carries its unit."""

    def shown(self) -> "list[Shown]":
        """What the device can tell of its quantities, where the settings say it: a limit outside would never trip."""
        return []

    @property
    def bus_address(self) -> int | None:
        """Where the device answers on its bus, which no other there may; None where the bus knows no addresses."""
        return None

    @property
    def bus_identifiers(self) -> frozenset[int]:
        """Identifiers of a CAN bus that the device and its host use; two protocols on one bus must share none."""
        return frozenset()

    @property
    def host_bus_address(self) -> int | None:
        """The address that the host's sign of life carries, which no device may have; None where there is none."""
        return None

    @property
    def host_silence_s(self) -> float | None:
        """How long the device goes on without a sign of life from the host; None where it listens for none."""
        return None


class Confirmation(NamedTuple):
    """What a device answered when it was told to become safe."""

    safe: bool
    detail: str


class Identity(NamedTuple):
    """Who a device says it is; empty where it cannot tell."""

    model: str = ""
    serial: str = ""
    firmware: str = ""


class Shown(NamedTuple):
    """Lowest and highest value of a quantity that a device can tell, and where its settings say so."""

    place: tuple[str | int, ...]
    quantity: str
    low: float
    high: float


class StreamSpec(NamedTuple):
    """A stream that a device samples by a clock of its own."""

    name: str
    channels: tuple[ChannelSpec, ...]
    rate_Hz: float = 0.0  # noqa: N815 (a unit keeps its letter)  rows a second where they come faster than the loop
    ends: bool = False  # by itself, before the run does: its driver raises where it ends too soon


class Row(NamedTuple):
    """One sample of a device's own stream; NaN where a channel has no value at this time."""

    stream: str
    time: float
    values: Sequence[float]
    fault: str = ""  # why a value is NaN, where the device knows


class Block(NamedTuple):
    """Many samples of a device's own stream at once: a row each would cost a fast converter the loop its cycle.

    A value is NaN where a channel has none at its time; what a reader should know of it is a notice.
    """

    stream: str
    times: "NDArray[np.float64]"  # (n,), s on the bench's clock, increasing; n is at least 1
    values: "NDArray[np.float64]"  # (n, channels)

    @property
    def last(self) -> Row:
        """The newest sample."""
        return Row(self.stream, float(self.times[-1]), self.values[-1].tolist())

    def rows(self) -> Iterator[Row]:
        """The samples one by one."""
        for time, values in zip(self.times.tolist(), self.values.tolist(), strict=True):
            yield Row(self.stream, time, values)


class TripAccuracy(NamedTuple):
    """How far from its level an instrument's protection may trip: a share of the level, and so much beside it."""

    share: float
    beside: float

    def level_below(self, highest: float) -> float:
        """The level at which it has tripped at this value at the latest."""
        return (highest - self.beside) / (1.0 + self.share)


class Mode(StrEnum):
    """What a motion device follows."""

    OFF = "off"
    CURRENT = "current"  # q axis, A, power invariant
    TORQUE_PROFILE = "torque_profile"  # as CURRENT, ramped by the drive
    VELOCITY = "velocity"  # rad/s
    ANGLE = "angle"  # rad


FarEnd = CanEmulator | SerialEmulator | BuslessEmulator | tuple[int, I2cEmulator]


class Driver(ABC):
    """One device: made from settings and a transport, opened, used, made safe, closed."""

    Settings: ClassVar[type[DriverSettings]]
    transport: ClassVar[str]  # the kind of bus it needs: "can", "i2c", "serial", or "none": the maker's own library
    summary: ClassVar[str]  # one line for `leactl driver list`
    example: ClassVar[Mapping[str, Any]] = {}  # settings with which `leactl driver check` makes one and its far end
    baudrate: ClassVar[int] = 9600  # of the serial line on which `leactl driver check` tries one
    synchronised: ClassVar[bool] = False  # its CAN bus carries CANopen's SYNC once a cycle, after the outputs

    @abstractmethod
    def __init__(self, name: str, role: str, settings: Any, port: Any, clock: Clock) -> None: ...

    @abstractmethod
    def safe_state(self, deadline_s: float) -> Confirmation:
        """Bring the device to where it cannot hurt, from any state, within the deadline; never raises."""

    def stop_now(self) -> None:  # noqa: B027 (optional: a device that only measures has nothing to send)
        """Send what takes the power away and wait for no answer: it comes before any device's `safe_state`."""

    @abstractmethod
    def open(self) -> None:
        """Meet the device, check that it is the one expected, and configure it; nothing moves.

        Raises
        ------
        DeviceError : the device is absent, another one, or refuses a setting.
        """

    @abstractmethod
    def close(self) -> None:
        """Let the device go; harmless when it was never opened or is closed already."""

    @classmethod
    def far_end(cls, settings: Any, role: str, physics: Physics) -> FarEnd:
        """The device's emulator on an emulated bench; with its address where the bus is I2C.

        Where there is no bus, the driver's `port` is this emulator, in place of the maker's library; it is None on a
        real bench.

        Raises
        ------
        InputError : this device has no emulator.
        """
        raise InputError(f"{cls.__name__} has no emulator; it cannot stand on an emulated bench")

    def identity(self) -> Identity:
        """What the device said of itself when it was opened; empty before, and where it cannot tell.

        Nothing is asked of the device here. What it refuses to tell of itself is no reason to refuse it in `open`.
        """
        return Identity()

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """Streams of the device's own clocks."""
        return ()

    def take(self) -> Sequence[Row | Block]:
        """Rows of the own streams that have come in since the last call, blocks where they are many."""
        return ()

    def notices(self) -> Sequence[str]:
        """What the device has done by itself since the last call and a reader of the run should know, a line each."""
        return ()


@runtime_checkable
class CyclicDevice(Protocol):
    """A device exchanged once per cycle of the control loop."""

    @property
    def loop_channels(self) -> tuple[ChannelSpec, ...]:
        """Channels of `values`, in order."""

    values: list[float]  # the last exchange; NaN where nothing came

    def begin_cycle(self) -> None:
        """Send the outputs."""

    def end_cycle(self, deadline: float) -> None:
        """Collect the inputs until the deadline on the bench's clock."""


@runtime_checkable
class MotionDevice(CyclicDevice, Protocol):
    """A drive. Only the supervisor calls `command`, `engage` and `release`."""

    def engage(self, mode: Mode) -> None:
        """Begin to enter operation in this mode with zero demand; completes over the next cycles."""

    def release(self) -> None:
        """Begin to leave operation; completes over the next cycles."""

    @property
    def engaged(self) -> bool:
        """True once the device itself reports that it follows its setpoint."""

    def command(self, value: float) -> None:
        """Set the setpoint of the engaged mode in its SI unit, for the next cycle.

        Raises
        ------
        InputError : the value is not finite or the device cannot express it.
        """

    def feed(self) -> None:
        """Send the host's sign of life; the control loop calls this after each supervised cycle, nothing else does."""


@runtime_checkable
class PacedDevice(Protocol):
    """A drive that has to know how often its setpoint is renewed."""

    def pace(self, period: float) -> None:
        """Learn the time between two setpoints [s]; called before the first cycle of a run, while the drive is off.

        Raises
        ------
        DeviceError : the drive does not take it.
        """


@runtime_checkable
class AnalogInput(Protocol):
    """A device that measures voltages and can set their zero."""

    def tare(self, means: Mapping[str, float]) -> dict[str, float]:
        """Take these mean readings, by stream, as zero from now on; returns the new offsets by channel name.

        The control loop averages the readings itself, since a drive would stop were it left alone meanwhile.
        """


@runtime_checkable
class PowerSupply(Protocol):
    """A supply of direct current. Only the supervisor calls `supply`, `switch_on` and `switch_off`.

    None of them waits: the device is told, and its answer awaited, in the calls of `take` that follow.
    """

    @property
    def most(self) -> tuple[float, float]:
        """Highest voltage [V] and current [A] that `supply` takes."""

    def supply(self, voltage: float, current: float) -> None:
        """Put out no more than this voltage [V] and this current [A] while switched on; switches nothing.

        Raises
        ------
        InputError : a value is not finite, negative, or above `most`; nothing is passed on.
        """

    def switch_on(self) -> None:
        """Begin to switch the output on."""

    def switch_off(self) -> None:
        """Begin to switch the output off."""

    @property
    def supplying(self) -> bool:
        """True from when the device itself has reported its output on until it has reported it off."""


@runtime_checkable
class ProtectedSupply(Protocol):
    """A supply whose own over-voltage protection switches its output off, whoever is dead; armed and read back."""

    @property
    def trip_accuracy(self) -> TripAccuracy:
        """How far from its level [V] the protection may trip."""

    def protect(self, level: float) -> None:
        """Have the protection trip at this level [V], from the next `supply` on and with it.

        Raises
        ------
        InputError : a value that is not finite, not above zero, or above the highest voltage; nothing is passed on.
        """


class OwnRecording(NamedTuple):
    """What a device's own recorder holds, on a clock of its own that begins at 0."""

    headings: tuple[str, ...]  # of the columns, with their units in brackets
    interval: float  # between two rows [s]
    values: "NDArray[np.float64]"  # (rows, columns)


@runtime_checkable
class RecordingDevice(Protocol):
    """A device with a recorder inside, faster than any line to it; it is armed by the maker's program."""

    def recorded(self) -> OwnRecording:
        """Upload what the recorder holds, which may take many seconds; only while the device is open and off.

        Raises
        ------
        DeviceError : it holds nothing, or the upload is not whole.
        """


def drive_channels(role: str, device: str) -> tuple[ChannelSpec, ...]:
    """Channels that the `values` of a drive begin with: references, readings, and whether it follows its setpoint."""

    def channel(name: str, quantity: str, words: str, dtype: str = "f4") -> ChannelSpec:
        return ChannelSpec(name, quantity, role, device, f"{role} {words}", dtype=dtype)

    return (
        channel("iq_ref", "q_axis_current_reference", "q axis current reference"),
        channel("omega_ref", "velocity_reference", "velocity reference"),
        channel("theta_ref", "angle_reference", "angle reference", "f8"),
        channel("iq", "q_axis_current", "q axis current"),
        channel("omega", "velocity", "velocity"),
        channel("theta", "angle", "angle", "f8"),
        channel("enabled", "drive_enabled", "drive follows its setpoint"),
    )
