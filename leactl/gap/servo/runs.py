"""Runs of position servos side by side, as arrays for the simulation."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.gap.replay.time_steps import SERVO_MEMORY, SERVO_STEP, servo_times
from leactl.gap.search.effect_regression import PRIORS
from leactl.gap.signals.record import Clocked, Record
from leactl.gap.signals.rig import drive_of, load_of
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
PARABOLA_SAMPLES = 4  # samples at the beginning of a run, to which a parabola is fitted for its speed
LEAST_MOVING_SHARE = 0.1  # share of the fast speeds; a run that begins more slowly begins at rest
INTERVAL_TOLERANCE = 0.01  # relative difference of sampling intervals that count as equal
FAST_QUANTILE = 0.95  # quantile of the speeds that counts as fast


@dataclass(frozen=True)
class ServoRuns:
    """Runs side by side; (runs, samples) for channels, one value a run for the rest."""

    interval: float  # s
    encoder_resolution: float  # rad, the largest of the runs' smallest angle steps; 0.0 if no run has one
    angle: Array  # rad
    speed: Array  # rad/s, at the first sample
    reference: Array  # rad
    enabled: Array  # 1 where the drive is enabled, else 0
    measured: Mask  # whether angle and reference are valid
    q_axis_voltage: Array  # V, logged voltage of each motor; use it only where `voltage_logged` is true
    voltage_logged: Mask  # whether voltage and reference are valid at a sample and the servo's gain is above zero
    gain: Array  # V/rad
    rate_gain: Array  # V*s/rad, on the rate of the error
    limit: Array  # V
    level: Array  # N*m, torque of the pendulum held out level
    inertia: Array  # kg*m^2, of the pendulum
    scales: Mapping[str, float]  # typical size of each parameter that a fit may move, in the parameter's own unit
    priors: Mapping[str, tuple[float, float]]  # value and prior width, by parameter of the model
    memory_samples: int  # samples after which the start of a servo has no influence

    @property
    def hangs(self) -> bool:
        """Whether a load of known weight hangs on the shaft."""
        return bool(np.any(self.level > 0.0))


def servo_runs(records: Sequence[Record], model: Model) -> ServoRuns:
    """Return runs of position servos side by side; shorter runs stay at their last reference.

    Samples are thinned out if they are closer than a simulation of the servo needs.

    Raises
    ------
    InputError : a run without a position servo, or runs sampled at different rates.
    """
    clocks = [record.fast for record in records if record.fast is not None and drive_of(record, model) is not None]
    if len(clocks) < len(records):
        record_without_servo = next(record for record in records if drive_of(record, model) is None)
        raise InputError(
            f"{record_without_servo.path}: no position servo: an angle, its reference and a `drive:` were expected"
        )
    longest, interval = max(len(clock.time) for clock in clocks), clocks[0].interval
    if any(abs(clock.interval / interval - 1.0) > INTERVAL_TOLERANCE for clock in clocks):
        intervals = sorted({f"{clock.interval:.4g}" for clock in clocks})
        raise InputError(f"runs sampled every {', '.join(intervals)} s cannot be simulated side by side")
    angles, references, enabled, volts = (
        np.stack(columns) for columns in zip(*(channels(clock, longest) for clock in clocks), strict=True)
    )
    measured = np.stack([np.arange(longest) < len(clock.time) for clock in clocks])
    voltage_logged = measured.copy()
    for row, logged, clock in zip(measured, voltage_logged, clocks, strict=True):
        row[: len(clock.time)] &= clock.all_valid(("angle", "test"), ("angle_reference", "test"))
        logged[: len(clock.time)] &= clock.all_valid(("q_axis_voltage", "test"), ("angle_reference", "test"))
        logged &= clock.get("q_axis_voltage") is not None
    servos = [servo for record in records if (servo := drive_of(record, model)) is not None]
    loads = [load_of(record, model) for record in records]
    gain, inertia = np.array([servo.gain for servo in servos]), np.array([load.inertia for load in loads])
    voltage_logged &= (gain > 0.0)[:, None]
    shortest_time, longest_time = servo_times(model, gain, float(np.min(inertia)), float(np.max(inertia)))
    thinning = max(1, math.floor(SERVO_STEP * shortest_time / interval))
    return ServoRuns(
        interval * thinning,
        max(clock.counts.get(("angle", "test"), 0.0) for clock in clocks),
        angles[:, ::thinning],
        np.array([starting_speed(angle, interval) for angle in angles]),
        block_means(references, thinning),
        enabled[:, ::thinning],
        measured[:, ::thinning],
        volts[:, ::thinning],
        voltage_logged[:, ::thinning],
        gain,
        np.array([servo.damping for servo in servos]),
        np.array([servo.voltage_limit for servo in servos]),
        np.array([load.level_torque for load in loads]),
        inertia,
        parameter_scales(model, angles, interval * thinning, interval, float(np.mean(inertia))),
        parameter_priors(model),
        math.ceil(SERVO_MEMORY * longest_time / (interval * thinning)),
    )


def parameter_scales(
    model: Model, angles: Array, interval: float, sampling_interval: float, load_inertia: float
) -> dict[str, float]:
    """Return the typical size of each parameter of a simulation, from the servo's torque, speed and response time."""
    constant, resistance = model.torque_constant or 0.0, model.phase_resistance or 1.0
    volts = model.drive.voltage_limit if model.drive is not None else 0.0
    stall_torque, back_emf_damping = constant * volts / resistance, constant**2 / resistance
    total_inertia = (model.rotor_inertia or 0.0) + load_inertia
    speeds = np.abs(np.diff(angles, axis=1)) / sampling_interval
    fast_speed = max(float(np.quantile(speeds, FAST_QUANTILE)), 1e-3 * volts / max(constant, 1e-300), 1e-300)
    response_time = total_inertia / max(back_emf_damping, 1e-300)
    return {
        "torque_constant": 0.3 * constant,
        "phase_resistance": 0.3 * resistance,
        "rotor_inertia": 0.015 * total_inertia,
        "viscous_damping": 0.025 * back_emf_damping,
        "coulomb_friction": 0.0015 * stall_torque,
        "load_zero": 0.1,  # rad, of where the pendulum hangs straight down
        "reference_delay": 2.0 * interval,
        "voltage_delay": interval,
        "reference_rate_limit.slowness": 0.3 / fast_speed,
        "reference_rate_limit.sluggishness": 0.3 * response_time / fast_speed,
        "servo_dead_band.band": 0.01,  # rad
        "saturation.loss": 1.0,
        "load_dependent_friction.coefficient": 0.1,
        "stribeck.breakaway_ratio": 0.1,
        "stribeck.stribeck_velocity": 0.1 * fast_speed,
        "position_dependent_friction.cos": 0.1,
        "position_dependent_friction.sin": 0.1,
        "asymmetric_friction.asymmetry": 0.1,
        "quadratic_drag.coefficient": 0.025 * back_emf_damping / fast_speed,
        "dead_time.voltage": 0.015 * volts,
        "dead_time.current": 0.05 * volts / resistance,
    }


def parameter_priors(model: Model) -> dict[str, tuple[float, float]]:
    """Return the model's values of the parameters that a fit may move, with the widths of their priors."""
    names = ("torque_constant", "phase_resistance", "rotor_inertia", "viscous_damping", "coulomb_friction")
    values = {name: float(getattr(model, name) or 0.0) for name in names}
    return {name: (value, PRIORS[name] * value) for name, value in values.items() if value > 0.0}


def block_means(values: Array, length: int) -> Array:
    """Return means over blocks of samples, shape (runs, blocks); the last sample fills up the last block."""
    if length == 1:
        return values
    missing = -values.shape[1] % length
    padded = np.pad(values, ((0, 0), (0, missing)), mode="edge")
    return np.asarray(padded.reshape(len(values), -1, length).mean(axis=2), np.float64)


def runs_at_common_rate(records: Sequence[Record], model: Model) -> list[Record]:
    """Return the largest group of servo runs whose sampling intervals are within 1 % of that of one run."""
    runs_with_interval = [
        (record, record.fast.interval)
        for record in records
        if record.fast is not None and drive_of(record, model) is not None
    ]
    groups = [
        [
            record
            for record, other_interval in runs_with_interval
            if abs(other_interval / interval - 1.0) <= INTERVAL_TOLERANCE
        ]
        for _, interval in runs_with_interval
    ]
    return max(groups, key=len, default=[])


def starting_speed(angle: Array, interval: float) -> float:
    """Return the speed [rad/s] at the first sample by a parabola through a few angles; zero if the axis was at rest."""
    speed = float(
        np.polynomial.Polynomial.fit(interval * np.arange(PARABOLA_SAMPLES), angle[:PARABOLA_SAMPLES], 2).deriv()(0.0)
    )
    fast_speed = float(np.quantile(np.abs(np.diff(angle)), FAST_QUANTILE)) / interval
    return speed if abs(speed) > LEAST_MOVING_SHARE * fast_speed else 0.0


def channels(clock: Clocked, length: int) -> tuple[Array, Array, Array, Array]:
    """Return angle, reference, enabled state and voltage of a run, padded to a length with their last values."""
    enabled, volts = clock.get("drive_enabled"), clock.get("q_axis_voltage")
    enabled_samples = np.ones(len(clock.time)) if enabled is None else (enabled > 0.5).astype(float)
    zeros = np.zeros(len(clock.time))
    columns = (
        clock.values["angle", "test"],
        clock.values["angle_reference", "test"],
        enabled_samples,
        zeros if volts is None else volts,
    )
    angle, reference, enabled_samples, volts = (
        np.pad(values, (0, length - len(values)), mode="edge") for values in columns
    )
    return angle, reference, enabled_samples, volts
