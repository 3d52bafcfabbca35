"""Runs of many lanes at once: references go in, velocity servos act, sensor readings of every millisecond come out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from leactl.emulation.plant.stepped.lanes import Array, Lane, in_groups
from leactl.emulation.plant.stepped.plant import TICK, SteppedPlant

Single = NDArray[np.float32]
CAMERA_TICKS = 100  # 10 Hz
BLOCK = 1000  # ticks
COMMAND_STEP = 0.002  # A, resolution of the drives' current command


@dataclass(frozen=True)
class DriveReferences:
    """References of the drives of one run, one row a millisecond."""

    current: Array  # A, of the test drive where it does not hold a velocity
    velocity: Array | None = None  # rad/s
    servo: str = ""  # "test" or "load": which drive holds the velocity
    velocity_gain: float = 150.0  # 1/s, proportional
    velocity_integral: float = 600.0  # 1/s^2
    feedforward: float = 0.0  # share of the test drive's reference that a load servo opposes at once
    velocity_noise: float = 0.0  # rad/s, of both drives' readings
    seed: int = 0


@dataclass(frozen=True)
class DriveSignals:
    """Sensor readings of one run before noise, except for the velocities, which carry theirs; one row a millisecond."""

    reference: Single
    current: Single  # mean over the millisecond, as the drive's sensor reads it
    voltage: Single  # the same
    velocity: Single
    angle: Array
    torque: Single
    bus_voltage: Single
    load_current: Single  # at the end of the millisecond
    load_velocity: Single
    winding: Single  # 10 Hz, as the camera reads it
    housing: Single


class _Block(NamedTuple):
    """One second of all lanes, a row a tick."""

    reference: Array
    current: Array
    voltage: Array
    velocity: Array
    angle: Array
    torque: Array
    bus_voltage: Array
    load_current: Array
    load_velocity: Array


def simulate(lanes: Sequence[Lane], programs: Sequence[DriveReferences]) -> list[DriveSignals]:
    """Run every lane to the end of its references; results are in the order of `lanes`."""
    order = in_groups(lanes)
    signals = _simulate([lanes[k] for k in order], [programs[k] for k in order])
    by_lane = dict(zip(order, signals, strict=True))
    return [by_lane[k] for k in range(len(lanes))]


def _simulate(lanes: Sequence[Lane], programs: Sequence[DriveReferences]) -> list[DriveSignals]:
    plant = SteppedPlant(lanes)
    servo = _Servo(lanes, programs)
    lengths = [len(program.current) for program in programs]
    records = [_empty(length) for length in lengths]
    longest, count = max(lengths), len(lanes)
    block = _Block(*(np.zeros((BLOCK, count)) for _ in _Block._fields))
    camera = np.zeros((-(-longest // CAMERA_TICKS), 2, count), np.float32)
    noise = [np.random.default_rng([program.seed, 1]) for program in programs]
    spread = np.array([program.velocity_noise for program in programs])
    reading = np.zeros((2, count))
    for start in range(0, longest, BLOCK):
        jitter = np.stack([generator.standard_normal((BLOCK, 2)) for generator in noise], axis=2) * spread
        references = _part(programs, start)
        for row in range(min(BLOCK, longest - start)):
            reference = servo.current(references[0, row], references[1, row], reading)
            plant.advance(reference)
            np.add(plant.velocity_read, jitter[row], out=reading)
            _take(block, row, plant, reference, reading)
            if row % CAMERA_TICKS == 0:
                camera[(start + row) // CAMERA_TICKS] = plant.thermal.camera()
        _keep(block, records, lengths, start)
    for k, length in enumerate(lengths):
        ticks = -(-length // CAMERA_TICKS)
        records[k]["winding"], records[k]["housing"] = camera[:ticks, 0, k].copy(), camera[:ticks, 1, k].copy()
    return [DriveSignals(**record) for record in records]


class _Servo:
    """Velocity servos of the lanes that have one; the current references of the other lanes pass unchanged."""

    def __init__(self, lanes: Sequence[Lane], programs: Sequence[DriveReferences]) -> None:
        self._held = np.array([[program.servo == role for program in programs] for role in ("test", "load")])
        self._passes = ~self._held[0]
        per_acceleration = np.array(
            [
                [lane.test.rotor_inertia / lane.test.torque_constant for lane in lanes],
                [lane.load.rotor_inertia / lane.load.torque_constant for lane in lanes],
            ]
        )
        gain = np.array([program.velocity_gain for program in programs])
        integral = np.array([program.velocity_integral for program in programs])
        self._gain = per_acceleration * gain * self._held
        self._per_tick = per_acceleration * integral * TICK * self._held
        self._unwind = np.clip(integral / gain * TICK, 0.0, 1.0)
        self._opposed = self._held[1] * np.array([program.feedforward for program in programs])
        self._peak = np.array([lane.bench.peak_current for lane in lanes])
        self._integral = np.zeros(self._held.shape)

    def current(self, current: Array, velocity: Array, reading: Array) -> Array:
        """Current references of both drives [A], clipped to the peak current, rounded to the command's resolution."""
        error = velocity - reading
        self._integral += self._per_tick * error
        unlimited = self._gain * error + self._integral
        unlimited[0] += current * self._passes
        unlimited[1] -= current * self._opposed
        limited = np.minimum(np.maximum(unlimited, -self._peak), self._peak)
        self._integral += self._unwind * (limited - unlimited) * self._held
        command: Array = np.rint(limited / COMMAND_STEP) * COMMAND_STEP
        return command


def _part(programs: Sequence[DriveReferences], start: int) -> Array:
    """Current and velocity references of one block, shape (2, ticks, lanes); zero after the end of a run."""
    references = np.zeros((2, BLOCK, len(programs)))
    for k, program in enumerate(programs):
        part = program.current[start : start + BLOCK]
        references[0, : len(part), k] = part
        if program.velocity is not None:
            references[1, : len(part), k] = program.velocity[start : start + BLOCK]
    return references


def _take(block: _Block, row: int, plant: SteppedPlant, reference: Array, reading: Array) -> None:
    block.reference[row] = reference[0]
    block.current[row] = plant.current_mean_sensed[0]
    block.voltage[row] = plant.voltage_mean[0]
    block.velocity[row], block.load_velocity[row] = reading
    block.angle[row] = plant.angle_read
    block.torque[row] = plant.torque_read
    block.bus_voltage[row] = plant.bus_voltage
    block.load_current[row] = plant.current_sensed[1]


def _empty(length: int) -> dict[str, Any]:
    return {name: np.zeros(length, np.float64 if name == "angle" else np.float32) for name in _Block._fields}


def _keep(block: _Block, records: Sequence[dict[str, Any]], lengths: Sequence[int], start: int) -> None:
    for name, values in block._asdict().items():
        by_lane = np.ascontiguousarray(values.T)
        for k, length in enumerate(lengths):
            remaining = length - start
            if remaining > 0:
                records[k][name][start : start + BLOCK] = by_lane[k, :remaining]
