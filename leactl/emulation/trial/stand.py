"""One driver, its far end and the wire between them, made anew for each trial."""

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from leactl.bench.benchfile import SerialBus
from leactl.bench.scan import Watcher, WireReport, ask_can, ask_i2c, ask_line
from leactl.driver.can_port import CanPort
from leactl.driver.contract import Driver, MotionDevice
from leactl.driver.i2c_port import I2cPort
from leactl.driver.probe import CanProbe, I2cProbe, LineProbe
from leactl.driver.serial_port import SerialPort
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.trial.known_bench import KnownBench, KnownMachine
from leactl.emulation.wires.buses import CanWire, EmulatedCanBus, EmulatedI2cBus
from leactl.emulation.wires.serial import EmulatedSerialLine, SerialWire

BITS_PER_BYTE = 11  # on a serial line with two stop bits
PERIOD_S, ANSWER_S = 0.01, 0.006  # of a cycle; and from a cycle's start to the deadline of the drive's answers
ROLE = "test"


class Broken(Exception):
    """A requirement that the driver breaks; the text says what was done, what happened and what was expected."""


class Stand:
    """A driver, not yet open, and the far end that it talks to."""

    def __init__(self, driver_class: type[Driver], folder: Path) -> None:
        self.clock = EmulatedClock()
        self.bench = KnownBench(self.clock)
        self.settings = example_settings(driver_class, folder)
        far_end: Any = driver_class.far_end(self.settings, ROLE, self.bench)
        self._wire: Any = None
        self._connect: Any = None
        self._make_port: Callable[[], Any] = lambda: far_end
        if driver_class.transport == "can":
            wire = self._wire = CanWire(self.clock)
            wire.attach(far_end)
            self._connect = lambda: EmulatedCanBus(wire)
            self._make_port = lambda: CanPort(self._connect, self.clock)
        elif driver_class.transport == "i2c":
            address, far_end = far_end
            bus = self._wire = EmulatedI2cBus(self.clock)
            bus.devices[address] = far_end
            self._connect = lambda: bus
            self._make_port = lambda: I2cPort(self._connect)
        elif driver_class.transport == "serial":
            line = self._wire = SerialWire(self.clock, BITS_PER_BYTE / driver_class.baudrate)
            line.device = far_end
            self._connect = lambda: EmulatedSerialLine(line)
            self._make_port = lambda: SerialPort(self._connect, self.clock)
        else:
            self.clock.follow(far_end.tick)
            self.clock.stop_at(lambda: far_end.due)
        self.far_end, self._driver_class = far_end, driver_class
        self.renew_driver()

    def renew_driver(self) -> None:
        """Replace the driver by a new one, as of another host; the device keeps its state."""
        self._port = self._make_port()
        self.driver = self._driver_class("tried", ROLE, self.settings, self._port, self.clock)

    @property
    def is_connected(self) -> bool:
        """Whether the driver's port is open; false if it has no bus."""
        return self._wire is not None and bool(self._port.connected)

    def synchronise(self) -> None:
        """Send CANopen's SYNC, if the driver's bus carries it."""
        if self.driver.synchronised:
            self._port.sync()

    @property
    def motion(self) -> MotionDevice:
        """The driver, typed as that of a drive."""
        assert isinstance(self.driver, MotionDevice)
        return self.driver

    @property
    def machine(self) -> KnownMachine:
        """The machine that the drive turns."""
        return self.bench.machine(ROLE)

    def cut(self) -> None:
        """Unplug the cable: nothing arrives, on either side."""
        if isinstance(self._wire, EmulatedI2cBus):
            self._wire.silent += self._wire.devices.values()
        elif self._wire is not None:
            self._wire.cut = True

    def scan(self) -> WireReport:
        """Scan the wire with the driver's probe alone and return the report; the driver stays closed."""
        report, probe, watcher = WireReport("tried"), self.driver.probe, Watcher(lambda _text: None, lambda: None)
        if isinstance(probe, CanProbe):
            ask_can(report, self._connect, self.clock, {"tried": probe}, watcher, fd=True)
        elif isinstance(probe, I2cProbe):
            ask_i2c(report, self._connect, self.clock, {"tried": probe}, watcher)
        elif isinstance(probe, LineProbe):
            line = SerialBus(kind="serial", baudrate=probe.baudrates[0])
            ask_line(report, lambda _line: self._connect(), self.clock, {"tried": probe}, [line], watcher)
        return report

    def wait(self, seconds: float) -> None:
        """Let time [s] pass without sending."""
        self.clock.sleep_until(self.clock.now() + seconds)

    def cycle(self, feed: bool = True) -> list[float]:
        """Run one cycle as the control loop does; return the values of the drive's channels."""
        start, drive = self.clock.now(), self.motion
        drive.begin_cycle()
        self.synchronise()
        drive.end_cycle(start + ANSWER_S)
        values = list(drive.values)
        if feed:
            drive.feed()
        self.clock.sleep_until(start + PERIOD_S)
        return values

    def cycles(self, seconds: float, feed: bool = True) -> Iterable[list[float]]:
        """Run cycles for a time [s]; yield the values of each."""
        end = self.clock.now() + seconds
        while self.clock.now() < end:
            yield self.cycle(feed)

    def read(self, quantity: str) -> float:
        """Return the value of a quantity in the last cycle; NaN if the drive has no such channel."""
        for index, channel in enumerate(self.motion.loop_channels):
            if channel.quantity == quantity:
                return self.motion.values[index]
        return math.nan


def example_settings(driver_class: type[Driver], folder: Path) -> Any:
    """Return the settings of the driver's `example`; files that a program exports are expected in `folder`."""
    values: dict[str, Any] = dict(driver_class.example)
    if "exports_folder" in driver_class.Settings.model_fields:
        values["exports_folder"] = str(folder)
    return driver_class.Settings.model_validate(values)
