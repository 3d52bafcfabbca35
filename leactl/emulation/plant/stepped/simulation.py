"""Runs of many lanes at once: references go in, velocity servos act, sensor readings of every millisecond come out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from leactl.emulation.plant.stepped.lanes import Array, Lane, in_groups
from leactl.emulation.plant.stepped.plant import TICK, SteppedPlant

Single = NDArray[np.float32]
CAMERA_TICKS = 100  # between two pictures of the camera: 10 Hz
BLOCK = 1000  # ticks that are simulated before their signals are stored
COMMAND_STEP = 0.002  # A, resolution of the current command


@dataclass(frozen=True)
class DriveReferences:
    """References of the drives of one run, one value a millisecond."""

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
    """Sensor readings of one run, one a millisecond, those of the camera one in `CAMERA_TICKS`.

    Only velocities have noise already, since the servos read them.
    """

    reference: Single  # A
    current: Single  # A, mean over the millisecond as the drive's sensor reads it
    voltage: Single  # V, mean over the millisecond
    velocity: Single  # rad/s
    angle: Array  # rad
    torque: Single  # N*m
    bus_voltage: Single  # V
    load_current: Single  # A, at the end of the millisecond
    load_velocity: Single  # rad/s
    winding: Single  # degC at 10 Hz, as the camera reads it
    housing: Single  # degC, likewise


class _Block(NamedTuple):
    """One second of the signals of all lanes, one row for each tick and one column for each lane."""

    reference: Array
    current: Array
    voltage: Array
    velocity: Array
    angle: Array
    torque: Array
    bus_voltage: Array
    load_current: Array
    load_velocity: Array


def simulate(lanes: Sequence[Lane], references: Sequence[DriveReferences]) -> list[DriveSignals]:
    """Run every lane to the end of its references; results are in the order of `lanes`."""
    order = in_groups(lanes)  # indices, lanes with the same kinds of effects adjacent
    signals = _simulate([lanes[k] for k in order], [references[k] for k in order])
    signals_by_lane = dict(zip(order, signals, strict=True))
    return [signals_by_lane[k] for k in range(len(lanes))]


def _simulate(lanes: Sequence[Lane], references: Sequence[DriveReferences]) -> list[DriveSignals]:
    """Run lanes of which those with the same kinds of effects are adjacent, block by block."""
    plant = SteppedPlant(lanes)
    servo = _Servo(lanes, references)
    lengths = [len(run_references.current) for run_references in references]
    records = [_empty_record(length) for length in lengths]
    most_ticks, lane_count = max(lengths), len(lanes)
    block = _Block(*(np.zeros((BLOCK, lane_count)) for _ in _Block._fields))
    camera = np.zeros((-(-most_ticks // CAMERA_TICKS), 2, lane_count), np.float32)
    noise_generators = [np.random.default_rng([run_references.seed, 1]) for run_references in references]
    velocity_noise = np.array([run_references.velocity_noise for run_references in references])
    reading = np.zeros((2, lane_count))
    for first_tick in range(0, most_ticks, BLOCK):
        noise_block = (
            np.stack([generator.standard_normal((BLOCK, 2)) for generator in noise_generators], axis=2) * velocity_noise
        )
        reference_block = _reference_block(references, first_tick)
        for row in range(min(BLOCK, most_ticks - first_tick)):
            current_references = servo.current(reference_block[0, row], reference_block[1, row], reading)
            plant.advance(current_references)
            np.add(plant.velocity_read, noise_block[row], out=reading)
            _fill_row(block, row, plant, current_references, reading)
            if row % CAMERA_TICKS == 0:
                camera[(first_tick + row) // CAMERA_TICKS] = plant.thermal.camera()
        _store_block(block, records, lengths, first_tick)
    for k, length in enumerate(lengths):
        ticks = -(-length // CAMERA_TICKS)
        records[k]["winding"], records[k]["housing"] = camera[:ticks, 0, k].copy(), camera[:ticks, 1, k].copy()
    return [DriveSignals(**record) for record in records]


class _Servo:
    """Velocity servos of the lanes that have one; the current references of the other lanes pass unchanged."""

    def __init__(self, lanes: Sequence[Lane], references: Sequence[DriveReferences]) -> None:
        self._holds_velocity = np.array(
            [[run_references.servo == role for run_references in references] for role in ("test", "load")]
        )
        self._test_has_no_servo = ~self._holds_velocity[0]
        current_per_acceleration = np.array(
            [
                [lane.test.rotor_inertia / lane.test.torque_constant for lane in lanes],
                [lane.load.rotor_inertia / lane.load.torque_constant for lane in lanes],
            ]
        )
        gain = np.array([run_references.velocity_gain for run_references in references])
        integral = np.array([run_references.velocity_integral for run_references in references])
        self._gain = current_per_acceleration * gain * self._holds_velocity
        self._integral_gain = current_per_acceleration * integral * TICK * self._holds_velocity
        self._unwinding_share = np.clip(integral / gain * TICK, 0.0, 1.0)
        self._opposed_share = self._holds_velocity[1] * np.array(
            [run_references.feedforward for run_references in references]
        )
        self._peak = np.array([lane.bench.peak_current for lane in lanes])
        self._integral = np.zeros(self._holds_velocity.shape)

    def current(self, current: Array, velocity: Array, reading: Array) -> Array:
        """Advance by a tick; return both drives' current references [A], limited and rounded as commands.

        Parameters
        ----------
        current : reference of the test drive if it has no servo [A].
        velocity : reference of the servo [rad/s].
        reading : velocities of both drives [rad/s].
        """
        velocity_error = velocity - reading
        self._integral += self._integral_gain * velocity_error
        unlimited_current = self._gain * velocity_error + self._integral
        unlimited_current[0] += current * self._test_has_no_servo
        unlimited_current[1] -= current * self._opposed_share
        limited_current = np.minimum(np.maximum(unlimited_current, -self._peak), self._peak)
        self._integral += self._unwinding_share * (limited_current - unlimited_current) * self._holds_velocity
        command: Array = np.rint(limited_current / COMMAND_STEP) * COMMAND_STEP
        return command


def _reference_block(references: Sequence[DriveReferences], first_tick: int) -> Array:
    """Return the current and velocity references of one block, shape (2, ticks, lanes); zero after a run's end."""
    block = np.zeros((2, BLOCK, len(references)))
    for k, run_references in enumerate(references):
        currents = run_references.current[first_tick : first_tick + BLOCK]
        block[0, : len(currents), k] = currents
        if run_references.velocity is not None:
            block[1, : len(currents), k] = run_references.velocity[first_tick : first_tick + BLOCK]
    return block


def _fill_row(block: _Block, row: int, plant: SteppedPlant, reference: Array, reading: Array) -> None:
    """Write the readings of one tick into a row of the block."""
    block.reference[row] = reference[0]
    block.current[row] = plant.current_mean_sensed[0]
    block.voltage[row] = plant.voltage_mean[0]
    block.velocity[row], block.load_velocity[row] = reading
    block.angle[row] = plant.angle_read
    block.torque[row] = plant.torque_read
    block.bus_voltage[row] = plant.bus_voltage
    block.load_current[row] = plant.current_sensed[1]


def _empty_record(length: int) -> dict[str, Any]:
    """Return arrays of zeros for the signals of one run."""
    return {name: np.zeros(length, np.float64 if name == "angle" else np.float32) for name in _Block._fields}


def _store_block(block: _Block, records: Sequence[dict[str, Any]], lengths: Sequence[int], first_tick: int) -> None:
    """Copy a block that begins at tick `first_tick` into the records, each up to its own length."""
    for name, values in block._asdict().items():
        lane_values = np.ascontiguousarray(values.T)
        for k, length in enumerate(lengths):
            ticks_left = length - first_tick
            if ticks_left > 0:
                records[k][name][first_tick : first_tick + BLOCK] = lane_values[k, :ticks_left]
