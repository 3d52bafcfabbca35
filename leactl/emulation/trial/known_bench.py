"""A bench behind the far end of the driver under trial, with a known value of every quantity at any time."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leactl.driver.far_end import PAIRS
from leactl.emulation.clock import EmulatedClock
from leactl.quantities import FLAGS

LOAD_OHM = 0.6  # at a supply's terminals
BASES = {  # value before a quantity begins to rise, in SI units and degC
    "torque": 1.0,
    "q_axis_current": 2.0,
    "velocity": 3.0,
    "angle": 0.5,
    "bus_voltage": 29.6,
    "line_current": 2.0,
    "line_voltage": 1.2,
    "winding_temperature": 41.0,
    "housing_temperature": 33.0,
    "ambient_temperature": 24.0,
}
DEFAULT_BASE = 1.5  # of a quantity that is not in BASES
# share of its base by which a quantity rises in a measurement: large, so that a repeated old reading is far off, and no
# round number, so that repeated readings differ from the multiples of a step that a display shows
RISE = 0.47
AMPLITUDE_V = 4.0  # of the voltages at the leads
HIGHEST_FREQUENCY_HZ = 7.0  # of the voltages at the leads
MOST_TURNS_PER_SAMPLE = 0.004  # of the leads' voltages; an instrument's delay of up to a sample then hardly counts


class KnownMachine:
    """A motor that a drive turns: it records its commands, and its sensors show the values that the trial sets."""

    def __init__(self) -> None:
        self.following = ("off", 0.0)
        self.current: float | None = None  # A; None means the commanded current
        self.velocity, self.angle = 0.0, 0.25
        self.voltage, self.bus_voltage = 3.25, 29.6

    def command(self, mode: str, value: float) -> None:
        """Record a setpoint."""
        self.following = (mode, value)

    def read(self) -> tuple[float, float, float]:
        """Return current [A], velocity [rad/s] and angle [rad]."""
        mode, value = self.following
        commanded = value if mode == "current" else 0.0
        return commanded if self.current is None else self.current, self.velocity, self.angle


class KnownLoad:
    """A resistor at a supply's terminals."""

    def __init__(self) -> None:
        self.fed = (0.0, 0.0)  # V and A at the terminals

    def feed(self, voltage: float, current: float) -> tuple[float, float]:
        """Apply limits of voltage [V] and current [A]; return the voltage and current that result."""
        load_current = min(current, voltage / LOAD_OHM)
        self.fed = (load_current * LOAD_OHM, load_current)
        return self.fed


class KnownTerminals:
    """Three line-to-line voltages, with phases a third of a turn apart."""

    def __init__(self) -> None:
        self.chance = np.random.default_rng(0)
        self.frequency_Hz = HIGHEST_FREQUENCY_HZ

    def voltages(self, times: NDArray[np.float64], pair: int) -> NDArray[np.float64]:
        """Return the voltages [V] of a pair of leads at some times [s]."""
        turns = self.frequency_Hz * times - pair / 3.0
        return np.asarray(AMPLITUDE_V * np.sin(2.0 * math.pi * turns), np.float64)


class KnownBench:
    """The physics behind a far end (`leactl.driver.far_end.Physics`)."""

    def __init__(self, clock: EmulatedClock) -> None:
        self._clock = clock
        self.machines: dict[str, KnownMachine] = {}
        self.load, self.leads = KnownLoad(), KnownTerminals()
        self.rises_from, self.rises_for = 0.0, 5.0  # s, start and duration of the rise by `RISE`

    def rise(self, duration: float, interval: float = 0.0) -> None:
        """Make every quantity rise from now on, over a duration [s], while a device samples it at an interval [s]."""
        self.rises_from, self.rises_for = self._clock.now(), duration
        highest_frequency = MOST_TURNS_PER_SAMPLE / interval if interval > 0.0 else math.inf
        self.leads.frequency_Hz = min(HIGHEST_FREQUENCY_HZ, highest_frequency)

    def machine(self, role: str) -> KnownMachine:
        """Return the machine that the drive of this role turns."""
        return self.machines.setdefault(role, KnownMachine())

    def reading(self, quantity: str, role: str, location: str = "") -> Callable[[], float]:
        """Return a function that gives the present value of a quantity."""
        return lambda: float(self.true_value(quantity, self._clock.now()))

    def true_value(self, quantity: str, time: Any) -> Any:
        """Return the value of a quantity at one or many times [s]."""
        if quantity in PAIRS:
            return self.leads.voltages(np.asarray(time, np.float64), PAIRS.index(quantity))
        progress = np.maximum(time - self.rises_from, 0.0) / self.rises_for
        if quantity in FLAGS:  # a flag cannot rise: it switches at half of the time
            return np.asarray(progress >= 0.5, np.float64)
        return BASES.get(quantity, DEFAULT_BASE) * (1.0 + RISE * progress)

    def terminals(self, role: str) -> KnownTerminals:
        """Return the three leads of this role's motor."""
        return self.leads

    def at_supply(self, feeds: str, role: str) -> KnownLoad:
        """Return the load at the terminals of a power supply."""
        return self.load
