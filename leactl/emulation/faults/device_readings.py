"""The readings that one device takes of the bench, to which sensor faults can be applied."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leactl.driver.far_end import PAIRS, Machine, Physics, SupplyLoad, Terminals

Change = Callable[[float], float]


class DeviceSignals:
    """The plant as one device reads it, with sensor faults; the keys of `changes` are the quantities asked for."""

    def __init__(self, physics: Physics) -> None:
        self._physics = physics
        self.changes: dict[str, list[Change]] = {}

    def change(self, quantity: str, change: Change) -> Callable[[], None]:
        """Apply a fault to a quantity; return a function that removes it."""
        self.changes[quantity].append(change)
        return lambda: self.changes[quantity].remove(change)

    def machine(self, role: str) -> Machine:
        """Return the machine that the drive of this role turns, as this device reads it."""
        return _ReadMachine(self._physics.machine(role), self)

    def reading(self, quantity: str, role: str, location: str = "") -> Callable[[], float]:
        """Return a function that gives the quantity as the device reads it now."""
        return self.changed(quantity, self._physics.reading(quantity, role, location))

    def at_supply(self, feeds: str, role: str) -> SupplyLoad:
        """Return the load at a power supply's terminals; the supply's meters have no sensor faults."""
        return self._physics.at_supply(feeds, role)

    def terminals(self, role: str) -> Terminals:
        """Return the three leads of this role's motor as the device reads them."""
        return _ReadTerminals(self._physics.terminals(role), self)

    def changed(self, quantity: str, read: Callable[[], float]) -> Callable[[], float]:
        """Return a function that reads a quantity's value and applies its faults."""
        changes = self.changes.setdefault(quantity, [])

        def reading() -> float:
            value = read()
            for change in changes:
                value = change(value)
            return value

        return reading


class _ReadMachine:
    """A machine as its drive's sensors read it."""

    def __init__(self, machine: Machine, signals: DeviceSignals) -> None:
        self.command = machine.command
        self._read, self._true_motion = machine.read, (0.0, 0.0, 0.0)
        self._motion = [
            signals.changed("q_axis_current", lambda: self._true_motion[0]),
            signals.changed("velocity", lambda: self._true_motion[1]),
            signals.changed("angle", lambda: self._true_motion[2]),
        ]
        self._bus_voltage = signals.changed("bus_voltage", lambda: machine.bus_voltage)
        self._voltage = signals.changed("q_axis_voltage", lambda: machine.voltage)

    def read(self) -> tuple[float, float, float]:
        """Return current [A], velocity [rad/s] and angle [rad]."""
        self._true_motion = self._read()
        current, velocity, angle = self._motion
        return current(), velocity(), angle()

    @property
    def voltage(self) -> float:
        """q-axis voltage [V]."""
        return self._voltage()

    @property
    def bus_voltage(self) -> float:
        """DC link voltage [V]."""
        return self._bus_voltage()


class _ReadTerminals:
    """The leads of a motor as the device at them reads their voltages."""

    def __init__(self, terminals: Terminals, signals: DeviceSignals) -> None:
        self._terminals, self.chance = terminals, terminals.chance
        self._changes = [signals.changes.setdefault(quantity, []) for quantity in PAIRS]

    def voltages(self, times: NDArray[np.float64], pair: int) -> NDArray[np.float64]:
        """Return the voltages [V] of a pair of leads at some times [s]."""
        voltages = self._terminals.voltages(times, pair)
        for change in self._changes[pair]:
            voltages = np.array([change(value) for value in voltages.tolist()])
        return voltages


class _MotionlessBench:
    """A bench on which nothing moves and every reading is zero, to find out which quantities a device reads."""

    voltage = bus_voltage = 0.0

    def machine(self, role: str) -> "_MotionlessBench":
        return self

    def command(self, mode: str, value: float) -> None:
        return

    def read(self) -> tuple[float, float, float]:
        return 0.0, 0.0, 0.0

    def reading(self, quantity: str, role: str, location: str = "") -> Callable[[], Any]:
        return float

    def terminals(self, role: str) -> "_MotionlessBench":
        return self

    def voltages(self, times: NDArray[np.float64], pair: int) -> NDArray[np.float64]:
        return np.zeros_like(times)

    @property
    def chance(self) -> np.random.Generator:
        return np.random.default_rng(0)

    def at_supply(self, feeds: str, role: str) -> "_MotionlessBench":
        return self

    def feed(self, voltage: float, current: float) -> tuple[float, float]:
        return 0.0, 0.0


STILL = _MotionlessBench()
