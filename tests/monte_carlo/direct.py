"""A bench without wires: drives and a torque sensor that fulfil the driver's contract, with rotors right behind them.

What a loop and its supervisor ask of a bench, they ask of this one in the same order; faults stand between the rotors
and what is told of them, and come at moments of the rotors' own time.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from leactl.driver.contract import Confirmation, Driver, DriverSettings, Mode, Row, StreamSpec
from leactl.emulation.clock import EmulatedClock, HostClock
from leactl.errors import DeviceFault
from leactl.quantities import ChannelSpec
from tests.monte_carlo.plants import ROLES, Truth
from tests.monte_carlo.rotors import Rotors, Stage

NOISE_A, NOISE_RAD_S, NOISE_NM = 0.015, 0.002, 0.004
ENGAGING = 3  # cycles
LOOP = (
    ("iq_ref", "q_axis_current_reference"),
    ("omega_ref", "velocity_reference"),
    ("theta_ref", "angle_reference"),
    ("iq", "q_axis_current"),
    ("omega", "velocity"),
    ("theta", "angle"),
    ("enabled", "drive_enabled"),
)
PLACE = {quantity: place for place, (_, quantity) in enumerate(LOOP)}
KINDS = {Mode.CURRENT: "current", Mode.TORQUE_PROFILE: "current", Mode.VELOCITY: "velocity", Mode.ANGLE: "angle"}
REFERENCES = {"current": 0, "velocity": 1, "angle": 2}
FAULTS = (
    "stale readings",
    "stuck current",
    "current reads zero",
    "noisy current",
    "stuck velocity",
    "stuck angle",
    "lost frames",
    "late frames",
    "frozen drive",
    "clock jump",
    "loop stalls",
    "process killed",
)
BROKEN_READING = {
    "stuck current": "q_axis_current",
    "current reads zero": "q_axis_current",
    "noisy current": "q_axis_current",
    "stuck velocity": "velocity",
    "stuck angle": "angle",
}


class Killed(BaseException):
    """The process has died: nothing of it goes on."""


@dataclass(frozen=True)
class Fault:
    """One fault of a trial."""

    kind: str
    at_s: float
    for_s: float
    role: str
    size: float  # of what the kind has: A of noise, s of delay, jump or stall, share of lost frames

    @classmethod
    def drawn(cls, draw: np.random.Generator, duration_s: float) -> "Fault":
        """A fault of any kind at any time."""
        kind = str(draw.choice(FAULTS))
        sizes = {
            "noisy current": draw.uniform(0.5, 3.0),
            "lost frames": draw.uniform(0.05, 1.0),
            "late frames": draw.uniform(0.01, 0.15),
            "clock jump": float(draw.choice([-1.0, 1.0])) * np.exp(draw.uniform(np.log(0.02), np.log(600.0))),
            "loop stalls": np.exp(draw.uniform(np.log(0.03), np.log(1.0))),
        }
        lasts = float(draw.choice([math.inf, np.exp(draw.uniform(np.log(0.02), np.log(5.0)))]))
        at = float(draw.uniform(0.0, duration_s))
        return cls(kind, at, lasts, str(draw.choice(ROLES)), float(sizes.get(kind, 0.0)))

    def on(self, now: float) -> bool:
        """Whether it holds now."""
        return self.at_s <= now < self.at_s + self.for_s


class DirectDrive(Driver):
    """A drive whose far end is in the same process."""

    Settings = DriverSettings
    transport, summary = "none", "drive of a Monte Carlo trial"

    def __init__(self, role: str, bench: "DirectBench") -> None:
        self.name, self.role, self._bench = f"drive_{role}", role, bench
        self.stage: Stage = bench.rotors.stages[role]
        self.loop_channels = tuple(ChannelSpec(name, quantity, role, self.name) for name, quantity in LOOP)
        self.values = [math.nan] * len(LOOP)
        self._mode, self._demand, self._cycles = Mode.OFF, 0.0, 0
        self._last: list[float] = []
        self._late: deque[tuple[float, str, float]] = deque()
        self._told: deque[tuple[float, list[float]]] = deque()

    # -- as the loop and the supervisor see it ---------------------------------------------------------------------

    def open(self) -> None:
        """Nothing to be opened."""

    def close(self) -> None:
        """Nothing to be closed."""

    def engage(self, mode: Mode) -> None:
        """Begin to follow."""
        self._mode, self._cycles = mode, 0
        self._demand = self._bench.rotors.angle if mode is Mode.ANGLE else 0.0

    def release(self) -> None:
        """Tell it to switch off; it may not hear."""
        self._mode = Mode.OFF
        self._tell("off", 0.0)

    @property
    def engaged(self) -> bool:
        """Whether it has said so."""
        return self._mode is not Mode.OFF and self._cycles >= ENGAGING

    def command(self, value: float) -> None:
        """Keep a setpoint for the next exchange."""
        self._demand = value

    def feed(self) -> None:
        """The host's sign of life."""
        if self._bench.heard(self.role):
            self.stage.fed = self._bench.rotors.time

    def stop_now(self) -> None:
        """Tell it to switch off."""
        self._tell("off", 0.0)

    def safe_state(self, deadline_s: float) -> Confirmation:
        """Ask whether it has."""
        self._tell("off", 0.0)
        reached = self._bench.heard(self.role) and not self.stage.frozen
        return Confirmation(reached and self.stage.mode == "off", "" if reached else "no answer")

    def begin_cycle(self) -> None:
        """Readings of now, and then the demand."""
        readings = self._read()
        fault, now = self._bench.fault, self._bench.rotors.time
        if fault is not None and fault.kind == "late frames" and fault.on(now):
            self._told.append((now + fault.size, readings))
            readings = [math.nan] * len(LOOP)
            while self._told and self._told[0][0] <= now + 1e-9:
                readings = self._told.popleft()[1]
        self.values = readings if self._bench.answered(self.role) and not self.stage.frozen else [math.nan] * len(LOOP)
        self._cycles += 1
        if self._mode is not Mode.OFF:
            self._tell(KINDS[self._mode], self._demand)

    def end_cycle(self, deadline: float) -> None:
        """Raise DeviceFault where the drive has stopped by itself."""
        if self.stage.starved and self._bench.answered(self.role) and not self.stage.frozen:
            raise DeviceFault(f"{self.name}: stopped, its host was silent")

    # -- what is behind it -----------------------------------------------------------------------------------------

    def _tell(self, mode: str, demand: float) -> None:
        bench, stage = self._bench, self.stage
        if bench.dead or stage.frozen or not bench.heard(self.role):
            return
        fault = bench.fault
        if fault is not None and fault.kind == "late frames" and fault.on(bench.rotors.time) and mode != "off":
            self._late.append((bench.rotors.time + fault.size, mode, demand))
            return
        self._apply(mode, demand)

    def _apply(self, mode: str, demand: float) -> None:
        stage = self.stage
        if stage.starved:
            return  # until it is reset, which nothing does within a run
        if mode != "off" and stage.mode == "off":
            stage.fed = self._bench.rotors.time
        stage.mode, stage.demand = mode, demand

    def arrive(self) -> None:
        """Take demands that have been on their way."""
        while self._late and self._late[0][0] <= self._bench.rotors.time + 1e-9:
            _, mode, demand = self._late.popleft()
            if self._mode is not Mode.OFF and not self.stage.frozen:
                self._apply(mode, demand)

    def _read(self) -> list[float]:
        stage, bench = self.stage, self._bench
        coupled = self.role == "test" or bench.setup == "coupled"
        result = [math.nan] * 3 + [
            stage.current / stage.factor + NOISE_A * bench.noise(),
            (bench.rotors.velocity if coupled else 0.0) + NOISE_RAD_S * bench.noise(),
            bench.rotors.angle if coupled else 0.0,
            1.0 if stage.mode != "off" else 0.0,
        ]
        if stage.mode in REFERENCES:
            result[REFERENCES[stage.mode]] = stage.demand
        fault = bench.fault
        quantity = BROKEN_READING.get(fault.kind) if fault is not None and fault.role == self.role else None
        if fault is not None and quantity and fault.on(bench.rotors.time):
            place = PLACE[quantity]
            if fault.kind == "current reads zero":
                result[place] = 0.0
            elif fault.kind == "noisy current":
                result[place] += fault.size * bench.noise()
            elif self._last:
                result[place] = self._last[place]
        self._last = result
        return result


class DirectSensor(Driver):
    """The torque sensor, a reading a cycle."""

    Settings = DriverSettings
    transport, summary = "none", "torque sensor of a Monte Carlo trial"

    def __init__(self, bench: "DirectBench") -> None:
        self.name, self._bench = "torque_sensor", bench
        self._streams = (StreamSpec("torque", (ChannelSpec("torque", "torque", "test", self.name),)),)

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """One."""
        return self._streams

    def open(self) -> None:
        """Nothing to be opened."""

    def close(self) -> None:
        """Nothing to be closed."""

    def safe_state(self, deadline_s: float) -> Confirmation:
        """It has no power to lose."""
        return Confirmation(True, "")

    def take(self) -> list[Row]:
        """The torque of now."""
        bench = self._bench
        reading = bench.truth.torque_gain * bench.rotors.torque + bench.truth.torque_zero + NOISE_NM * bench.noise()
        return [Row("torque", bench.clock.now(), (reading,))]


class DirectBench:
    """What the runner's loop asks of a bench."""

    def __init__(self, truth: Truth, setup: str, fault: Fault | None, seed: int, name: str = "direct") -> None:
        self.setup, self.fault, self.dead, self.file = setup, fault, False, _Named(name)
        self.truth, self.rotors = truth, Rotors(truth, setup)
        self.time = EmulatedClock()
        self.clock = HostClock(self.time)
        self.time.follow(self._advance)
        self._draw = np.random.default_rng(seed)
        self._noises: list[float] = []
        self.drives = {role: DirectDrive(role, self) for role in ROLES}
        self.sensor = DirectSensor(self)
        self.drivers: dict[str, Driver] = {d.name: d for d in (*self.drives.values(), self.sensor)}
        self._struck = False

    def noise(self) -> float:
        """A standard normal number."""
        if not self._noises:
            self._noises = self._draw.standard_normal(4096).tolist()
        return self._noises.pop()

    def pace(self, period: float) -> None:
        """Nothing: these drives take a setpoint whenever it comes."""

    def heard(self, role: str) -> bool:
        """Whether what the host says now reaches this drive."""
        return not self.dead and not self._lost(True)

    def answered(self, role: str) -> bool:
        """Whether what this drive says now reaches the host."""
        return not self._lost(False)

    def _lost(self, outward: bool) -> bool:
        fault = self.fault
        if fault is None or not fault.on(self.rotors.time):
            return False
        if fault.kind == "stale readings":
            return not outward
        return fault.kind == "lost frames" and self._draw.random() < fault.size

    def _advance(self, to: float) -> None:
        rotors = self.rotors
        for drive in self.drives.values():
            drive.arrive()
        rotors.advance(to)

    # -- as the loop sees it ---------------------------------------------------------------------------------------

    def exchange(self, deadline: float) -> list[float]:
        """One cycle with both drives."""
        self._strike()
        row: list[float] = []
        for drive in self.drives.values():
            drive.begin_cycle()
        for drive in self.drives.values():
            drive.end_cycle(deadline)
            row += drive.values
        return row

    def take(self) -> list[Row]:
        """Rows of the sensor."""
        return self.sensor.take()

    def notices(self) -> list[tuple[str, str]]:
        """None."""
        return []

    def feed(self) -> None:
        """The host's sign of life."""
        for drive in self.drives.values():
            drive.feed()

    def streams(self) -> dict[str, tuple[ChannelSpec, ...]]:
        """Channels of the loop and of the sensor."""
        loop = tuple(channel for drive in self.drives.values() for channel in drive.loop_channels)
        return {"loop": loop, "torque": self.sensor.streams[0].channels}

    def _strike(self) -> None:
        """What happens once, at its moment."""
        fault = self.fault
        if fault is None or self._struck or self.rotors.time < fault.at_s:
            return
        self._struck = True
        if fault.kind == "process killed":
            self.dead = True
            raise Killed
        if fault.kind == "frozen drive":
            self.drives[fault.role].stage.frozen = True
        elif fault.kind == "clock jump":
            self.clock.ahead += fault.size
        elif fault.kind == "loop stalls":
            self.time.sleep_until(self.time.now() + round(fault.size, 2))

    @property
    def energised(self) -> list[str]:
        """Drives that have power."""
        return [role for role, stage in self.rotors.stages.items() if stage.mode != "off"]


@dataclass(frozen=True)
class _Named:
    name: str
