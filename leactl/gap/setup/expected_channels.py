"""Channels of a run with their expected values, from another channel or from the model and other channels."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.setup.relations import SmoothedMotion, motion_of, torque_of_current, voltage_for_motion
from leactl.gap.signals.record import Clocked, Key, Record
from leactl.gap.signals.smoothing import smooth
from leactl.model.nominal import Model
from leactl.vocabulary.variable import Variable

Array = npt.NDArray[np.float64]
CURRENT, REFERENCE = ("q_axis_current", "test"), ("q_axis_current_reference", "test")
VELOCITY, ANGLE, TORQUE = ("velocity", "test"), ("angle", "test"), ("torque", "test")
VOLTAGE, LOAD_VELOCITY = ("q_axis_voltage", "test"), ("velocity", "load")


@dataclass(frozen=True, eq=False)
class ExpectedChannel:
    """A channel of a run with the values that are expected of it."""

    key: Key
    reference_label: str  # source of the expected values, as evidence texts name it
    measured: Array
    expected: Array
    inputs: tuple[Key, ...]  # channels that the measured and the expected values come from
    expected_delay: float = 0.0  # samples by which the channel is late according to the model
    variable: Variable = "velocity"  # variable that its error is drawn over
    drawn_over: Array | None = None  # values of `variable`; None if the expected values are values of it


def direct_pairs(record: Record, model: Model) -> Iterator[ExpectedChannel]:
    """Yield channels of a run that nearly equal another, so that their lateness can be measured."""
    clock, bench = record.fast, model.bench
    if clock is None or record.mechanical == "heated":
        return
    angle, current, reference = clock.get(*ANGLE), clock.get(*CURRENT), clock.get(*REFERENCE)
    if angle is not None and record.mechanical != "locked":
        angle_velocity = np.gradient(angle, clock.interval)
        delay = filter_delay(clock, bench.velocity_filter_bandwidth)
        for key in (VELOCITY, LOAD_VELOCITY) if record.mechanical == "coupled" else (VELOCITY,):
            if key in clock.values:
                yield ExpectedChannel(key, "the angle", clock.values[key], angle_velocity, (key, ANGLE), delay)
    if current is not None and reference is not None:
        delay = filter_delay(clock, bench.current_loop_bandwidth)
        yield ExpectedChannel(
            CURRENT, "its reference", current, reference, (CURRENT, REFERENCE), delay, "q_axis_current"
        )
    torque, expected_torque = clock.get(*TORQUE), torque_of_current(clock, model, record.mechanical)
    if torque is not None and expected_torque is not None:
        motion = motion_of(clock) if record.mechanical == "coupled" else None
        if motion is not None:
            expected_torque = least_squares_fit(torque, [expected_torque, *motion_columns(motion)])
        delay = filter_delay(clock, bench.torque_filter_bandwidth)
        yield ExpectedChannel(TORQUE, "the current", torque, expected_torque, (TORQUE, CURRENT), delay, "torque")


def filter_delay(clock: Clocked, bandwidth: float | None) -> float:
    """Return the delay in samples of a first-order filter with a bandwidth [Hz]."""
    return 0.0 if bandwidth is None else 1.0 / (2.0 * np.pi * bandwidth * clock.interval)


def motion_columns(motion: SmoothedMotion) -> list[Array]:
    """Return the columns of inertia, damping and friction: acceleration, velocity and the smoothed sign of velocity."""
    return [motion.acceleration, motion.velocity, smooth(np.sign(motion.velocity), motion.width)]


def least_squares_fit(values: Array, columns: list[Array]) -> Array:
    """Return the least-squares fit of columns and an offset to a channel."""
    design = np.stack([*columns, np.ones(len(values))], axis=1)
    return np.asarray(design @ np.linalg.lstsq(design, values, rcond=1e-10)[0], np.float64)


def modelled_pairs(record: Record, model: Model) -> Iterator[ExpectedChannel]:
    """Yield channels of a run with the values that the model computes from other channels."""
    clock = record.fast
    if clock is None or record.mechanical == "heated":
        return
    motion, constant = motion_of(clock), model.torque_constant
    current, torque, voltage = clock.get(*CURRENT), clock.get(*TORQUE), clock.get(*VOLTAGE)
    motor_torque = torque_of_current(clock, model, record.mechanical)
    coefficients = (model.rotor_inertia or 0.0, model.viscous_damping or 0.0, model.coulomb_friction or 0.0)
    inertia_and_friction = (
        np.zeros(len(clock.time)) if motion is None else linear_combination(coefficients, motion_columns(motion))
    )
    locked = record.mechanical == "locked"
    if torque is not None and motor_torque is not None:
        expected = motor_torque if locked else motor_torque - inertia_and_friction
        yield ExpectedChannel(TORQUE, "the current and the model", torque, expected, (TORQUE, CURRENT), 0.0, "torque")
    if voltage is not None and current is not None and motion is not None and model.phase_resistance:
        back_emf = 0.0 if locked else (model.back_emf_constant or constant or 0.0) * motion.velocity
        volts = np.asarray(model.phase_resistance * current + back_emf, np.float64)
        inputs: tuple[Key, ...] = (VOLTAGE, CURRENT, ANGLE)
        if locked:
            yield ExpectedChannel(VOLTAGE, "the model", voltage, volts, inputs, 0.0, "q_axis_current", current)
        else:
            yield ExpectedChannel(VOLTAGE, "the model", voltage, volts, inputs, 0.0, "velocity", motion.velocity)
    if (
        voltage is not None
        and motion is not None
        and (motion_volts := voltage_for_motion(record, model, motion)) is not None
    ):
        inputs = (VOLTAGE, ANGLE)
        yield ExpectedChannel(VOLTAGE, "the motion", voltage, motion_volts, inputs, 0.0, "velocity", motion.velocity)
    if current is not None and motion is not None and constant and record.mechanical == "free" and any(coefficients):
        expected, inputs = inertia_and_friction / constant, (CURRENT, ANGLE)
        yield ExpectedChannel(CURRENT, "the motion and the model", current, expected, inputs, 0.0, "q_axis_current")


def linear_combination(coefficients: tuple[float, ...], columns: list[Array]) -> Array:
    """Return the sum of columns, each times its coefficient."""
    return np.asarray(np.asarray(coefficients) @ np.stack(columns), np.float64)
