"""A bench with its devices: one exchange per cycle with all drives, streams of other devices, and one way to close."""

from collections.abc import Callable, Sequence
from typing import Any

from leactl import yamlfile
from leactl.bench.benchfile import BenchFile, Bus, CanBus, CheckedDevice, LineBus
from leactl.bench.provenance import Provenance
from leactl.bench.wiring import Wiring
from leactl.driver import registry
from leactl.driver.can_port import CanPort
from leactl.driver.contract import Driver, MotionDevice, PacedDevice, Row, SampleBlock
from leactl.driver.i2c_port import I2cPort
from leactl.driver.safe_state import make_safe, unconfirmed_devices
from leactl.driver.serial_port import SerialPort
from leactl.errors import DeviceError, InputError, LeactlError, NoBus
from leactl.quantities import ChannelSpec

Wrap = Callable[[str, str, Callable[..., Any]], Callable[..., Any]]
"""Takes the name of a device or bus, the name of one of its methods, and the method; returns a replacement."""


class Bench:
    """The devices of a bench file, connected by a wiring; call `open` before use and `close` in any case."""

    def __init__(self, file: BenchFile, devices: Sequence[CheckedDevice], wiring: Wiring) -> None:
        self.file, self.clock, self.wait_for_disk = file, wiring.clock, wiring.wait_for_disk
        self.apply_weight_torque = wiring.apply_weight_torque
        ports: dict[str, Any] = {name: _port(name, bus, wiring) for name, bus in file.buses.items()}
        self.not_confirmed = ""  # the devices that a failed `open` left unconfirmed, and why
        self.drivers: dict[str, Driver] = {}
        self.drives: dict[str, Driver] = {}
        self.provenance = {device.name: Provenance(device.entry) for device in devices}
        self._motion: list[MotionDevice] = []
        self.syncs: dict[str, Callable[[], None]] = {}  # CANopen's SYNC, by bus
        for device in devices:
            entry = device.entry
            port = ports[entry.bus] if entry.bus else wiring.emulator_of(device.name)
            driver = registry.load(entry.driver)(device.name, entry.role, device.settings, port, self.clock)
            self.drivers[device.name] = driver
            if isinstance(driver, MotionDevice):
                self.drives[entry.role] = driver
                self._motion.append(driver)
            if driver.synchronised and isinstance(port, CanPort) and entry.bus:
                self.syncs[entry.bus] = port.sync
        self._sync = list(self.syncs.values())
        self._drivers_with_notices = [
            (name, driver) for name, driver in self.drivers.items() if type(driver).notices is not Driver.notices
        ]
        self._drivers_with_streams = [driver for driver in self.drivers.values() if driver.streams]
        self.loop_channels: tuple[ChannelSpec, ...] = tuple(
            channel._replace(name=f"{channel.role}_{channel.name}")
            for drive in self._motion
            for channel in drive.loop_channels
        )

    def pass_calls_through(self, wrap: Wrap, names: Sequence[str]) -> None:
        """Wrap these methods of every driver, and every SYNC, by a function; call it before `open`."""
        for name, driver in self.drivers.items():
            for method in names:
                if hasattr(driver, method):
                    setattr(driver, method, wrap(name, method, getattr(driver, method)))
        self._sync = [wrap(name, "sync", sync) for name, sync in self.syncs.items()]

    @property
    def others(self) -> list[Driver]:
        """Devices other than drives."""
        return [driver for driver in self.drivers.values() if driver not in self.drives.values()]

    @property
    def in_order_of_stop(self) -> list[Driver]:
        """Every device in the order in which power is removed: test drive, load drive, then the others."""
        return [*(self.drives[role] for role in ("test", "load") if role in self.drives), *self.others]

    def streams(self) -> dict[str, tuple[ChannelSpec, ...]]:
        """Return the channels of every stream of the bench, by the name of the stream."""
        device_streams = {spec.name: spec.channels for driver in self._drivers_with_streams for spec in driver.streams}
        return {"loop": self.loop_channels, **device_streams} if self.loop_channels else device_streams

    @property
    def fast_streams(self) -> dict[str, float]:
        """Sampling rate [Hz] of each stream that declares a rate, by the name of the stream."""
        specs = [spec for driver in self._drivers_with_streams for spec in driver.streams]
        return {spec.name: spec.rate_Hz for spec in specs if spec.rate_Hz}

    def open(self) -> None:
        """Open every device in the order of the file; if one fails, all are made safe and closed.

        The failed device is made safe first, then the others, opened or not: an earlier program may have left a drive
        in operation.

        Raises
        ------
        DeviceError : with the device's name and the devices that are not confirmed safe; also if a device reports
            another serial number than the bench file states.
        """
        for name, driver in self.drivers.items():
            try:
                driver.open()
                self.provenance[name].take(driver.identity())
            except BaseException as error:
                confirmations = make_safe(
                    [driver, *[device for device in self.drivers.values() if device is not driver]]
                )
                cause = str(error).removeprefix(f"{name}: ")
                if isinstance(error, NoBus):  # no device on this bus has heard of this machine
                    confirmations = {
                        device: confirmation
                        for device, confirmation in confirmations.items()
                        if not confirmation.detail.endswith(cause)
                    }
                not_confirmed = self.not_confirmed = unconfirmed_devices(confirmations, cause)
                self.close()
                if not isinstance(error, DeviceError):
                    if not_confirmed:
                        error.add_note(not_confirmed)
                    raise
                text = str(error) if str(error).startswith(f"{name}:") else f"{name}: {error}"
                raise type(error)(f"{text}; {not_confirmed}" if not_confirmed else text) from None

    def close(self) -> list[str]:
        """Close every device, even if one of them fails; return one line for each failure."""
        faults = []
        for name, driver in self.drivers.items():
            try:
                driver.close()
            except Exception as error:  # noqa: BLE001 (a broken driver must not keep the others' buses open)
                faults.append(f"{name}: was not closed in order: {type(error).__name__}: {error}")
        return faults

    def exchange(self, deadline: float) -> list[float]:
        """Make one cycle with all drives: send setpoints and SYNC, and return the readings of `loop_channels`.

        deadline : time on the bench's clock until which answers are collected [s].

        Raises
        ------
        DeviceError : a drive or its bus failed, or a driver broke.
        """
        row: list[float] = []
        drive: MotionDevice | None = None
        try:
            for drive in self._motion:
                drive.begin_cycle()
            for sync in self._sync:
                sync()
            for drive in self._motion:
                drive.end_cycle(deadline)
                row += drive.values
        except (LeactlError, MemoryError):
            raise
        except Exception as error:
            raise _driver_error(drive, error) from error
        return row

    def pace(self, period: float) -> None:
        """Set the time between two setpoints [s] in every drive that has to know it.

        Raises
        ------
        DeviceError : a drive refuses it.
        """
        for drive in self._motion:
            if isinstance(drive, PacedDevice):
                drive.pace(period)

    def take(self) -> list[Row | SampleBlock]:
        """Return the new rows of all streams that devices sample by their own clocks.

        Raises
        ------
        DeviceError : a device or its bus failed, or a driver broke.
        """
        rows: list[Row | SampleBlock] = []
        driver: Driver | None = None
        try:
            for driver in self._drivers_with_streams:
                if new_rows := driver.take():
                    rows += new_rows
        except (LeactlError, MemoryError):
            raise
        except Exception as error:
            raise _driver_error(driver, error) from error
        return rows

    def notices(self) -> list[tuple[str, str]]:
        """Return the (device, notice) pairs since the last call."""
        return [(name, text) for name, driver in self._drivers_with_notices for text in driver.notices()]

    def feed(self) -> None:
        """Send the host's heartbeat to every drive; only the control loop calls this, after a supervised cycle."""
        for drive in self._motion:
            drive.feed()


def _driver_error(driver: object, error: BaseException) -> DeviceError:
    """Return a DeviceError for an unexpected exception of a driver, which ends a run like a failure of the device."""
    name = getattr(driver, "name", "a driver")
    return DeviceError(f"{name}: its driver broke: {type(error).__name__}: {error}; LEACTL_TRACE=1 shows where")


def require_channels_for_interlocks(bench: Bench, document: yamlfile.Document) -> None:
    """Check that devices measure what interlocks watch, and that temperatures without a limit have an interlock.

    Raises
    ------
    InputError : one line for each fault, with file, line and column.
    """
    channels = [channel for stream in bench.streams().values() for channel in stream]
    faults = [document.fault(("interlocks", *keys), text) for keys, text in bench.file.interlocks.blind(channels)]
    if faults:
        raise InputError(faults)


def _port(name: str, bus: Bus, wiring: Wiring) -> CanPort | I2cPort | SerialPort:
    """Return the port that the drivers of a bus share."""
    if isinstance(bus, CanBus):
        return CanPort(wiring.can(name, bus), wiring.clock, name, bus.returns_own)
    if isinstance(bus, LineBus):
        return SerialPort(wiring.serial(name, bus), wiring.clock, name)
    return I2cPort(wiring.i2c(name, bus), name)
