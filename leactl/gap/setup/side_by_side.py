"""Channels of a run with their expected values, from another channel or from the model and other channels."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.setup.relations import SmoothedMotion, driving, motion_of, taken_of_voltage
from leactl.gap.signals.record import Clocked, Key, Record
from leactl.gap.signals.smoothing import smooth
from leactl.model.nominal import Model
from leactl.vocabulary.variable import Variable

Array = npt.NDArray[np.float64]
CURRENT, REFERENCE = ("q_axis_current", "test"), ("q_axis_current_reference", "test")
VELOCITY, ANGLE, TORQUE = ("velocity", "test"), ("angle", "test"), ("torque", "test")
VOLTAGE, LOAD_VELOCITY = ("q_axis_voltage", "test"), ("velocity", "load")


@dataclass(frozen=True, eq=False)
class Pair:
    """A channel of a run and its expected value."""

    key: Key
    against: str
    reads: Array
    expected: Array
    keys: tuple[Key, ...]  # channels that both are computed from
    filtered: float = 0.0  # samples by which the channel is late according to the model
    variable: Variable = "velocity"  # variable of the expected value, for pictures


def direct_pairs(record: Record, model: Model) -> Iterator[Pair]:
    """Yield channels of a run that nearly equal another, so that their lateness can be measured."""
    clock, bench = record.fast, model.bench
    if clock is None or record.mechanical == "heated":
        return
    angle, current, reference = clock.get(*ANGLE), clock.get(*CURRENT), clock.get(*REFERENCE)
    if angle is not None and record.mechanical != "locked":
        turning = np.gradient(angle, clock.interval)
        late = late_by(clock, bench.velocity_filter_bandwidth)
        for key in (VELOCITY, LOAD_VELOCITY) if record.mechanical == "coupled" else (VELOCITY,):
            if key in clock.values:
                yield Pair(key, "the angle", clock.values[key], turning, (key, ANGLE), late)
    if current is not None and reference is not None:
        late = late_by(clock, bench.current_loop_bandwidth)
        yield Pair(CURRENT, "its reference", current, reference, (CURRENT, REFERENCE), late, "q_axis_current")
    torque, force = clock.get(*TORQUE), driving(clock, model, record.mechanical)
    if torque is not None and force is not None:
        moved = motion_of(clock) if record.mechanical == "coupled" else None
        force = force if moved is None else fitted(torque, [force, *along(moved)])
        late = late_by(clock, bench.torque_filter_bandwidth)
        yield Pair(TORQUE, "the current", torque, force, (TORQUE, CURRENT), late, "torque")


def late_by(clock: Clocked, bandwidth: float | None) -> float:
    """Return the delay in samples of a first-order filter with a bandwidth [Hz]."""
    return 0.0 if bandwidth is None else 1.0 / (2.0 * np.pi * bandwidth * clock.interval)


def along(moved: SmoothedMotion) -> list[Array]:
    """Return the columns of inertia, damping and friction: acceleration, velocity and its sign."""
    return [moved.acceleration, moved.velocity, smooth(np.sign(moved.velocity), moved.width)]


def fitted(values: Array, columns: list[Array]) -> Array:
    """Return the least-squares fit of columns and an offset to a channel."""
    rows = np.stack([*columns, np.ones(len(values))], axis=1)
    return np.asarray(rows @ np.linalg.lstsq(rows, values, rcond=1e-10)[0], np.float64)


def modelled_pairs(record: Record, model: Model) -> Iterator[Pair]:
    """Yield channels of a run with the values that the model computes from other channels."""
    clock = record.fast
    if clock is None or record.mechanical == "heated":
        return
    moved, constant = motion_of(clock), model.torque_constant
    current, torque, voltage = clock.get(*CURRENT), clock.get(*TORQUE), clock.get(*VOLTAGE)
    force = driving(clock, model, record.mechanical)
    parts = (model.rotor_inertia or 0.0, model.viscous_damping or 0.0, model.coulomb_friction or 0.0)
    lost = np.zeros(len(clock.time)) if moved is None else sum_of(parts, along(moved))
    if torque is not None and force is not None:
        force = force if record.mechanical == "locked" else force - lost
        yield Pair(TORQUE, "the current and the model", torque, force, (TORQUE, CURRENT), 0.0, "torque")
    if voltage is not None and current is not None and moved is not None and model.phase_resistance:
        turning = (
            0.0 if record.mechanical == "locked" else (model.back_emf_constant or constant or 0.0) * moved.velocity
        )
        volts = np.asarray(model.phase_resistance * current + turning, np.float64)
        yield Pair(VOLTAGE, "the model", voltage, volts, (VOLTAGE, CURRENT, ANGLE), 0.0, "velocity")
    if (
        voltage is not None
        and moved is not None
        and (volts_taken := taken_of_voltage(record, model, moved)) is not None
    ):
        yield Pair(VOLTAGE, "the motion", voltage, volts_taken, (VOLTAGE, ANGLE), 0.0, "velocity")
    if current is not None and moved is not None and constant and record.mechanical == "free" and any(parts):
        yield Pair(CURRENT, "the motion and the model", current, lost / constant, (CURRENT, ANGLE), 0.0, "velocity")


def sum_of(parts: tuple[float, ...], columns: list[Array]) -> Array:
    """Return the sum of columns times their coefficients."""
    return np.asarray(np.asarray(parts) @ np.stack(columns), np.float64)
