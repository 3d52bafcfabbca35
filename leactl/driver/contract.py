"""The contract of driver plug-ins: a few required methods, and small optional capabilities.

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
from leactl.driver.probe import Probe
from leactl.errors import InputError
from leactl.quantities import ChannelSpec

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SAFE_STATE_S = 1.0  # time for a device to confirm its safe state; no answer timeout and no watchdog may be longer


class DriverSettings(yamlblock.Block):
    """Settings of one device in the bench file; every field's name carries its unit."""

    def shown(self) -> "list[MeasurableRange]":
        """Return the measurable range of each quantity by the settings; a limit outside of it could never trip."""
        return []

    @property
    def bus_address(self) -> int | None:
        """Address of the device, unique on its bus; None if the bus has no addresses."""
        return None

    @property
    def bus_identifiers(self) -> frozenset[int]:
        """CAN identifiers of the device and its host; devices of different protocols on one bus must share none."""
        return frozenset()

    @property
    def host_bus_address(self) -> int | None:
        """Address in the host's heartbeat, which no device may have; None if there is none."""
        return None

    @property
    def host_silence_s(self) -> float | None:
        """Time for which the device runs on without the host's heartbeat [s]; None if it monitors none."""
        return None


class Confirmation(NamedTuple):
    """Answer of a device to the demand for its safe state."""

    safe: bool
    detail: str


class Identity(NamedTuple):
    """Identity that a device reports; a field that it cannot report is empty."""

    model: str = ""
    serial: str = ""
    firmware: str = ""


class MeasurableRange(NamedTuple):
    """Measurable range of a quantity; `place` is the path, in the driver's settings, of the setting that defines it."""

    place: tuple[str | int, ...]
    quantity: str
    low: float
    high: float


class StreamSpec(NamedTuple):
    """A stream that a device samples by its own clock."""

    name: str
    channels: tuple[ChannelSpec, ...]
    rate_Hz: float = 0.0  # noqa: N815 (a unit keeps its letter)  given if it is faster than the loop
    ends: bool = False  # whether the stream ends by itself before the run; its driver raises if it ends too soon


class Row(NamedTuple):
    """One sample of a device's own stream; NaN if a channel has no value at this time."""

    stream: str
    time: float
    values: Sequence[float]
    fault: str = ""  # reason why a value is NaN, if the device knows it


class SampleBlock(NamedTuple):
    """Many samples of a device's own stream at once; single rows of a fast converter would take too much of a cycle.

    A value is NaN if a channel has no value at its time; the driver explains this in a notice.
    """

    stream: str
    times: "NDArray[np.float64]"  # (n,), s on the bench's clock, increasing; n is at least 1
    values: "NDArray[np.float64]"  # (n, channels)

    @property
    def last(self) -> Row:
        """The newest sample."""
        return Row(self.stream, float(self.times[-1]), self.values[-1].tolist())

    def rows(self) -> Iterator[Row]:
        """Yield the samples one by one."""
        for time, values in zip(self.times.tolist(), self.values.tolist(), strict=True):
            yield Row(self.stream, time, values)


class TripAccuracy(NamedTuple):
    """Tolerance of the level at which an instrument's protection trips: a share of the level plus a constant."""

    share: float
    beside: float  # constant, in the unit of the level

    def level_below(self, highest: float) -> float:
        """Return the level to set so that the protection has tripped at `highest` at the latest."""
        return (highest - self.beside) / (1.0 + self.share)


class Mode(StrEnum):
    """Control mode of a drive."""

    OFF = "off"
    CURRENT = "current"  # q axis, A, power invariant
    TORQUE_PROFILE = "torque_profile"  # as CURRENT, ramped by the drive
    VELOCITY = "velocity"  # rad/s
    ANGLE = "angle"  # rad


FarEnd = CanEmulator | SerialEmulator | BuslessEmulator | tuple[int, I2cEmulator]


class Driver(ABC):
    """One device: constructed from settings and a transport, opened, used, made safe, closed."""

    Settings: ClassVar[type[DriverSettings]]
    transport: ClassVar[str]  # kind of bus: "can", "i2c", "serial", or "none" for the maker's own library
    # kinds of bus that give it the same port: "visa" for a driver over "serial" whose messages fit a socket as well
    further_transports: ClassVar[tuple[str, ...]] = ()
    summary: ClassVar[str]  # one line for `leactl driver list`
    example: ClassVar[Mapping[str, Any]] = {}  # settings with which `leactl driver check` tries driver and emulator
    baudrate: ClassVar[int] = 9600  # of the serial line that `leactl driver check` uses
    synchronised: ClassVar[bool] = False  # its CAN bus carries CANopen's SYNC once a cycle, after the outputs
    probe: ClassVar[Probe | None] = None  # how `leactl bench scan` recognises such a device

    @abstractmethod
    def __init__(self, name: str, role: str, settings: Any, port: Any, clock: Clock) -> None: ...

    @abstractmethod
    def safe_state(self, deadline_s: float) -> Confirmation:
        """Bring the device to its safe state, from any state, within the deadline [s]; never raise."""

    def stop_now(self) -> None:  # noqa: B027 (optional: a device that only measures has nothing to send)
        """Send the command that removes power, without waiting for an answer; called before any `safe_state`."""

    @abstractmethod
    def open(self) -> None:
        """Connect to the device, check that it is the expected one, and configure it; nothing moves.

        Raises
        ------
        DeviceError : the device is absent, another one, or refuses a setting.
        """

    @abstractmethod
    def close(self) -> None:
        """Disconnect from the device; harmless if it was never opened or is closed already."""

    @classmethod
    def far_end(cls, settings: Any, role: str, physics: Physics) -> FarEnd:
        """Return the device's emulator for an emulated bench; for I2C a tuple of its address and the emulator.

        Without a bus, the driver's `port` is this emulator, in place of the maker's library; on a real bench it is
        None.

        Raises
        ------
        InputError : this device has no emulator.
        """
        raise InputError(f"{cls.__name__} has no emulator; it cannot stand on an emulated bench")

    def identity(self) -> Identity:
        """Return the identity that the device reported when it was opened; empty before.

        This method sends nothing to the device. A device that reports no identity must not be refused in `open`.
        """
        return Identity()

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """Streams that the device samples by its own clock."""
        return ()

    def take(self) -> Sequence[Row | SampleBlock]:
        """Return the rows of `streams` since the last call, or blocks of many rows; never wait."""
        return ()

    def notices(self) -> Sequence[str]:
        """Return one line for each notable thing that the device did by itself since the last call."""
        return ()


@runtime_checkable
class CyclicDevice(Protocol):
    """A device exchanged once per cycle of the control loop."""

    @property
    def loop_channels(self) -> tuple[ChannelSpec, ...]:
        """Channels of `values`, in the same order."""

    values: list[float]  # readings of the last exchange; NaN if none came

    def begin_cycle(self) -> None:
        """Send the outputs of this cycle."""

    def end_cycle(self, deadline: float) -> None:
        """Collect the inputs of this cycle, until the deadline on the bench's clock."""


@runtime_checkable
class MotionDevice(CyclicDevice, Protocol):
    """A drive. Only the supervisor calls `command`, `engage` and `release`."""

    def engage(self, mode: Mode) -> None:
        """Begin to enter operation in this mode with zero setpoint; the next cycles complete it."""

    def release(self) -> None:
        """Begin to leave operation; the next cycles complete it."""

    @property
    def engaged(self) -> bool:
        """Whether the device itself reports that it follows its setpoint."""

    def command(self, value: float) -> None:
        """Set the setpoint of the engaged mode in its SI unit, for the next cycle.

        Raises
        ------
        InputError : the value is not finite or the device cannot express it.
        """

    def feed(self) -> None:
        """Send the host's heartbeat; only the control loop calls this, after each supervised cycle."""


@runtime_checkable
class PacedDevice(Protocol):
    """A drive that has to know the period of its setpoints."""

    def pace(self, period: float) -> None:
        """Set the time between two setpoints [s]; called before the first cycle of a run, while the drive is off.

        Raises
        ------
        DeviceError : the drive refuses it.
        """


@runtime_checkable
class AnalogInput(Protocol):
    """A device that measures voltages and can set their zero."""

    def tare(self, means: Mapping[str, float]) -> dict[str, float]:
        """Subtract these mean readings (by stream) from now on; return the new offsets by channel name.

        The control loop averages the readings itself, because a drive that gets no setpoints meanwhile would stop.
        """


@runtime_checkable
class PowerSupply(Protocol):
    """A DC power supply. Only the supervisor calls `supply`, `switch_on` and `switch_off`.

    None of them waits: the command is sent, and its answer awaited, in later calls of `take`.
    """

    @property
    def most(self) -> tuple[float, float]:
        """Highest voltage [V] and current [A] that `supply` accepts."""

    def supply(self, voltage: float, current: float) -> None:
        """Set the limits of voltage [V] and current [A] for the output while it is on; switch nothing.

        Raises
        ------
        InputError : a value is not finite, negative, or above `most`; nothing is sent.
        """

    def switch_on(self) -> None:
        """Begin to switch the output on."""

    def switch_off(self) -> None:
        """Begin to switch the output off."""

    @property
    def supplying(self) -> bool:
        """Whether the output is on, by the device's last report."""


@runtime_checkable
class ProtectedSupply(Protocol):
    """A supply whose own over-voltage protection switches its output off, even if the host is dead."""

    @property
    def trip_accuracy(self) -> TripAccuracy:
        """Tolerance of the protection's level [V]."""

    def protect(self, level: float) -> None:
        """Set the level [V] of the protection; it takes effect with the next `supply`.

        Raises
        ------
        InputError : the level is not finite, not positive, or above the highest voltage; nothing is sent.
        """


class OwnRecording(NamedTuple):
    """Content of a device's own recorder, on its own clock that begins at 0."""

    headings: tuple[str, ...]  # names of the columns with units in brackets
    interval: float  # between two rows [s]
    values: "NDArray[np.float64]"  # (rows, columns)


@runtime_checkable
class RecordingDevice(Protocol):
    """A device with an internal recorder, faster than its connection; the maker's program arms it."""

    def recorded(self) -> OwnRecording:
        """Upload the recording, which may take many seconds; only while the device is open and off.

        Raises
        ------
        DeviceError : there is no recording, or the upload is incomplete.
        """


def drive_channels(role: str, device: str) -> tuple[ChannelSpec, ...]:
    """Return the first channels of a drive's `values`: three references, three readings, and whether it is engaged."""

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
