"""Torque balances of a free rotor and of two rotors on a shaft, and the equations of the torque channel."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from leactl.effects.contract import Signals
from leactl.gap.equations.contract import MEMORY_ROWS, STAMP_TOLERANCE, Equation, Mask, Place
from leactl.gap.equations.motion import load_lag
from leactl.gap.signals.derived import channel_means, locked_rotor_torque
from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.record import Clocked, Record
from leactl.gap.signals.smoothing import (
    BASE_WIDTH,
    KERNEL_REACH,
    interval_means,
    noise_of_acceleration,
    sharp_mean_signs,
    slope,
    smooth,
)
from leactl.gap.signals.stamps import stamp_columns

Array = npt.NDArray[np.float64]
SLOW_SHARE = 0.005  # share of a run's highest speed below which a shaft counts as slow: it may be at rest
SWING_REACH = 8.0  # samples, Gaussian width over which a locked rotor's rate of torque is averaged
SLOW_REACH = 4.0  # samples, Gaussian margin around slow samples of a coupled shaft, whose twist reverses there, too
FREE_SLOW_REACH = 0.5  # samples, the same margin for a free rotor, which needs almost none
FINER_ROWS, USUAL_ROWS = ((1.0, 2), (2.0, 4)), (4.0, 8)  # samples: smoothing of rows, and distance between rows
MOST_FINE_ROW_NOISE = 0.01  # largest noise of an acceleration, relative to its size, at which finer rows are used
MOST_ACCELERATION_NOISE = 0.1  # relative; a fit lowers the inertia by its square, so that above it a lower rate is used
LOAD_ZERO, ZERO_PRIOR = "load_zero_rad", 0.1  # nuisance of the angle at which a load hangs, and its prior error [rad]
STICKING_PRIOR = 0.5  # prior relative change of the nominal Coulomb friction while it sticks


def turning_samples(s: Signals, velocity: Array, reach: float) -> Mask:
    """Return the mask of the samples around which the shaft turns in one direction and is not slow.

    reach : samples, Gaussian width around a sample.
    """
    return np.asarray(smooth(possibly_resting_samples(s, velocity).astype(float), reach) < 1e-3)


def possibly_resting_samples(s: Signals, velocity: Array) -> Mask:
    """Return the mask of the samples in which the shaft may be at rest."""
    slow_limit = max(0.5 * s.count / s.interval, SLOW_SHARE * highest_speed(s, velocity))
    return np.asarray(np.abs(velocity) <= slow_limit)


def samples_near_rest(s: Signals, velocity: Array) -> Mask:
    """Return the mask of the samples whose smoothing reaches a slow stretch that is no quick reversal.

    At rest friction equals the driving torque, and is unknown. A stretch is no quick reversal if the shaft continues in
    the same direction, if the stretch is longer than the smoothing reaches, or if it lies at either end of a run.
    """
    slow_samples, may_rest, reach = (
        possibly_resting_samples(s, velocity),
        np.zeros(len(velocity)),
        KERNEL_REACH * BASE_WIDTH,
    )
    edges = np.flatnonzero(np.diff(slow_samples.astype(np.int8), prepend=0, append=0))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        turns_back = begin > 0 and end < len(slow_samples) and velocity[begin - 1] * velocity[end] < 0.0
        may_rest[begin:end] = not turns_back or end - begin > reach
    return np.asarray(smooth(may_rest) > 0.0)


def highest_speed(s: Signals, velocity: Array) -> float:
    """Return the highest speed of the shaft [rad/s], of a long run in any of its stretches."""
    return max(s.fastest, float(np.quantile(np.abs(velocity), 0.999)))


def sliding_samples(s: Signals, torque_rate: Array) -> Mask:
    """Return the mask of the samples around which a locked rotor slides.

    Its torque changes there by its friction or more within its mechanical time constant.

    torque_rate : rate of the torque [N*m/s].
    """
    model = s.model
    least_rate = (model.coulomb_friction or 0.0) * (model.viscous_damping or 0.0) / (model.rotor_inertia or np.inf)
    return np.asarray(smooth(np.abs(torque_rate), SWING_REACH) > least_rate)


def free_torque(record: Record, s: Signals) -> Equation | None:
    """Return the torque balance of a free rotor, K i = J dw/dt + b w + f sgn(w), and the torque of the model's load.

    None where the rotor is not free, or a channel or parameter is missing.
    """
    if s.mechanical != "free" or record.fast is None:
        return None
    torques = rotor_torques(s)
    if torques is None or s.velocity is None:
        return None
    drive, calibration, places = torques
    left_over = drive - sum(column for name, column in calibration.items() if name != "torque_constant")
    left_over = left_over - load_torque(s)
    calibration["torque_constant"] = -drive
    keys = ("q_axis_current", "test"), ("angle", "test")
    mask = turning_samples(s, s.velocity, FREE_SLOW_REACH) & s.resolved & record.fast.all_valid(*keys)
    mask &= ~samples_near_rest(s, s.velocity)
    shared = stamp_columns("free_torque", record.fast, keys, -drive)
    nuisances = {"torque_stamp_s": (slope(drive, s.interval), STAMP_TOLERANCE * s.interval / record.fast.decimation)}
    nuisances |= between_instants(record.fast, s)
    width, step = row_smoothing(record.fast, s, mask)
    return Equation(
        "free_torque",
        "velocity",
        "test",
        "N*m",
        left_over,
        s,
        mask,
        places,
        calibration,
        nuisances,
        shared | load_angle_nuisance(s),
        rounding=noise_of_counts(s, width),
        width=width,
        step=step,
        memory=MEMORY_ROWS * USUAL_ROWS[1] // step,  # the same duration in closer rows
    )


def load_torque(s: Signals) -> Array:
    """Return the torque [N*m] that the model's load takes from the shaft, by its inertia and its weight."""
    assert s.acceleration is not None
    inertial_torque = s.load_inertia * s.acceleration
    return inertial_torque if s.weight is None else inertial_torque + s.weight


def load_angle_nuisance(s: Signals) -> dict[str, tuple[Array, float]]:
    """Return the nuisance of the angle at which the model's load hangs; empty where it has no weight."""
    return {} if s.weight_slope is None else {LOAD_ZERO: (s.weight_slope, ZERO_PRIOR)}


def reversal_torque(record: Record, balance: Equation) -> Equation:
    """Return the balance in the rows around slow reversals, which the balance of a turning rotor leaves out.

    Friction that builds up over an angle shows only there. Its course differs between bearings, so that a residual of
    these rows does not make a machine unexplained.

    balance : torque balance of the free rotor.
    """
    s = balance.signals
    assert record.fast is not None and s.velocity is not None
    near_rest = samples_near_rest(s, s.velocity)
    is_valid = record.fast.all_valid(("q_axis_current", "test"), ("angle", "test"))
    mask, touched = s.resolved & is_valid & ~near_rest, possibly_resting_samples(s, s.velocity) & ~near_rest
    return replace(balance, name="reversal_torque", mask=mask, touched=touched, rough=True)


def noise_of_counts(s: Signals, width: float) -> float:
    """Return the standard deviation [N*m] of a row of torque due to the counts of the encoder.

    width : samples, smoothing of the row.
    """
    inertia = (s.model.rotor_inertia or 0.0) + s.load_inertia
    return inertia * noise_of_acceleration(s.count / math.sqrt(12.0), s.interval, width)


def between_instants(clock: Clocked, s: Signals) -> dict[str, tuple[Array, float]]:
    """Return the nuisance of a current that is sampled at instants while an angle reference moves.

    A drive responds to each step of its reference, and a host samples it in step with them: always at the same point of
    the response. The error of the samples is proportional to the reference's rate; its prior is their noise.
    """
    reference, current = clock.get("angle_reference"), clock.get("q_axis_current")
    instants = ("q_axis_current", "test") not in clock.means
    if reference is None or current is None or s.velocity is None or not instants:
        return {}
    rate = np.nan_to_num(np.diff(reference, prepend=reference[:1])) / s.interval
    rate[np.abs(rate) > highest_speed(s, s.velocity)] = 0.0  # a step, which no shaft follows
    usual_rate = float(np.sqrt(np.mean(rate[rate != 0.0] ** 2))) if rate.any() else 0.0
    if usual_rate == 0.0:
        return {}
    return {"between_instants_A": ((s.model.torque_constant or 0.0) / usual_rate * smooth(rate), noise_of(current))}


def is_noisy(record: Record, equation: Equation) -> bool:
    """Return whether the angle's noise is a large part of the smoothed acceleration, or no row is usable.

    The noise is in the column of the inertia as well and biases its fit towards zero by its share of the column's
    power. A servo's current that is computed from its setpoints needs the samples at the log's rate.
    """
    s, clock = equation.signals, record.fast
    assert clock is not None and s.acceleration is not None
    angle = clock.get("angle")
    if angle is None or clock.get("q_axis_current") is None:
        return False
    if not equation.mask.any():
        return True
    noise = noise_of_acceleration(noise_of(angle), s.interval, USUAL_ROWS[0])
    acceleration_power = float(np.mean(smooth(s.acceleration, USUAL_ROWS[0])[equation.mask] ** 2))
    return (1.0 + MOST_ACCELERATION_NOISE**2) * noise**2 > MOST_ACCELERATION_NOISE**2 * acceleration_power


def row_smoothing(clock: Clocked, s: Signals, mask: Mask) -> tuple[float, int]:
    """Return the least smoothing [samples] of rows at which acceleration noise is small, and their distance [samples].

    Less smoothing shows waves of higher orders over the angle.
    """
    assert s.acceleration is not None
    angle = clock.get("angle")
    if angle is None or not mask.any():
        return USUAL_ROWS
    noise, quiet_noise = noise_of(angle), MOST_FINE_ROW_NOISE * float(np.sqrt(np.mean(s.acceleration[mask] ** 2)))
    for width, step in FINER_ROWS:
        if noise_of_acceleration(noise, s.interval, width) <= quiet_noise:
            return width, step
    return USUAL_ROWS


def coupled_torque(record: Record, s: Signals) -> Equation | None:
    """Return the equation of the torque channel between two actuators: reading = K i - J dw/dt - b w - f sgn(w).

    None where the run is not coupled, or a channel or parameter is missing.
    """
    if s.mechanical != "coupled" or record.fast is None or s.velocity is None:
        return None
    torques, reading = rotor_torques(s), torque_reading(record.fast, s, 0.0)
    if torques is None or reading is None:
        return None
    drive, resisting_columns, resisting_places = torques
    left_over = reading - drive + sum(c for name, c in resisting_columns.items() if name != "torque_constant")
    calibration = {name: -column for name, column in resisting_columns.items()}
    calibration["torque_constant"] = drive
    places = {name: _negative(effect_place) for name, effect_place in resisting_places.items()}
    places["torque_reading"] = lambda c: c
    keys = ("torque", "test"), ("q_axis_current", "test"), ("angle", "test")
    mask = turning_samples(s, s.velocity, SLOW_REACH) & s.resolved & record.fast.all_valid(*keys)
    shared = stamp_columns("coupled_torque", record.fast, keys, drive)
    shared |= stamp_columns("torque_channel", record.fast, keys, reading)
    return Equation("coupled_torque", "torque", "test", "N*m", left_over, s, mask, places, calibration, shared=shared)


def both_torque(record: Record, s: Signals) -> Equation | None:
    """Return the balance of both coupled actuators together, K (i + i_load) = resisting torque of both rotors.

    It needs no torque channel. None where the run is not coupled, or another channel or parameter is missing.
    """
    clock = record.fast
    if s.mechanical != "coupled" or clock is None or s.velocity is None:
        return None
    torques, load_current = rotor_torques(s), channel_means(clock, "q_axis_current", "load")
    load_velocity = clock.get("velocity", "load")
    if torques is None or load_current is None or load_velocity is None:
        return None
    model = s.model
    drive, calibration, places = torques
    constant = model.torque_constant or 0.0
    load_speed = smooth(interval_means(load_velocity))
    acceleration = slope(load_speed, s.interval)
    load_drive = constant * smooth(load_current)
    inertia = (model.rotor_inertia or 0.0) * acceleration
    viscous, coulomb = model.load.frictions(model.viscous_damping, model.coulomb_friction)
    damping = viscous * load_speed
    friction = coulomb * smooth(sharp_mean_signs(interval_means(load_velocity), noise_of(load_velocity)))
    resisting_torque = sum(column for name, column in calibration.items() if name != "torque_constant")
    left_over = drive + load_drive - resisting_torque - inertia - damping - friction
    calibration = dict(calibration)
    calibration["torque_constant"] = -drive - load_drive
    calibration["rotor_inertia"] = calibration["rotor_inertia"] + inertia
    calibration["load.viscous_damping"] = damping
    calibration["load.coulomb_friction"] = friction
    keys = ("q_axis_current", "test"), ("q_axis_current", "load"), ("velocity", "load"), ("angle", "test")
    mask = (
        turning_samples(s, s.velocity, SLOW_REACH)
        & turning_samples(s, load_speed, SLOW_REACH)
        & s.resolved
        & clock.all_valid(*keys)
    )
    return Equation(
        "both_torque",
        "velocity",
        "load",
        "N*m",
        left_over,
        s,
        mask,
        places,
        calibration,
        {"load_velocity_lag_s": (slope(inertia + damping, s.interval), load_lag(s))},
        stamp_columns("both_torque", clock, keys, -drive) | stamp_columns("load_torque", clock, keys, -load_drive),
    )


def locked_torque(record: Record, s: Signals) -> Equation | None:
    """Return the equation of a locked rotor's torque channel at constant current: friction holds the last state."""
    return locked_rotor_equation(record, s, "locked_torque", swinging=False)


def swung_torque(record: Record, s: Signals) -> Equation | None:
    """Return the equation of a locked rotor's torque channel while its current changes and the rotor slides."""
    return locked_rotor_equation(record, s, "swung_torque", swinging=True)


def locked_rotor_equation(record: Record, s: Signals, name: str, swinging: bool) -> Equation | None:
    """Return the equation of a locked rotor's torque channel: the drive's torque with the hysteresis of friction.

    None where the rotor is not locked, or a channel or parameter is missing.

    swinging : whether the rows are those in which the rotor slides.
    """
    model = s.model
    if s.mechanical != "locked" or record.fast is None or s.current is None or s.torque is None:
        return None
    inertia_per_stiffness = (model.rotor_inertia or 0.0) / (model.bench.shaft_stiffness or np.inf)
    reading = torque_reading(record.fast, s, inertia_per_stiffness)
    if reading is None or model.torque_constant is None:
        return None
    constant_column, places = derivative_by_constant(s, s.torque, model.torque_constant)
    places["torque_reading"] = lambda c: c
    nuisance = (
        {f"sticking_{name}": (derivative_by_friction(s, s.torque), STICKING_PRIOR)} if model.coulomb_friction else {}
    )
    torque_rate = slope(s.torque, s.interval)
    keys = ("torque", "test"), ("q_axis_current", "test")
    mask = record.fast.all_valid(*keys) & (sliding_samples(s, torque_rate) == swinging)
    return Equation(
        name,
        "torque",
        "test",
        "N*m",
        reading - s.torque,
        s,
        mask & (s.unleapt if swinging else s.settled),
        places,
        {"torque_constant": constant_column},
        nuisance,
        stamp_columns(name, record.fast, keys, s.torque),
        width=2.0,
        step=6,
        # Sliding friction is assumed to follow a command at once. The rotor's swing on its shaft therefore stays in the
        # residual, with spectral lines that depend on the give of its bearing, which no model file contains.
        rough=swinging,
    )


def derivative_by_constant(s: Signals, torque: Array, constant: float) -> tuple[Array, dict[str, Place]]:
    """Return the derivative of a locked rotor's torque by the relative torque constant, and the places of effects.

    torque : torque of the locked rotor under the nominal model.
    constant : nominal torque constant [N*m/A].
    """
    assert s.current is not None
    drive, derivative = constant * s.current, (locked_rotor_torque(s, 1.02, 1.0) - torque) / 0.02
    transmitted_share = np.where(np.abs(drive) > 1e-9, derivative / np.where(np.abs(drive) > 1e-9, drive, 1.0), 0.0)
    return derivative, {
        "torque_factor": lambda c: derivative * c,
        "drag": lambda c: -c,
        "current_reading": lambda c: -constant * c * np.clip(transmitted_share, 0.0, 1.0),
    }


def derivative_by_friction(s: Signals, torque: Array) -> Array:
    """Return the derivative of a locked rotor's torque by the relative Coulomb friction [N*m]."""
    return (locked_rotor_torque(s, 1.0, 1.05) - torque) / 0.05


def rotor_torques(s: Signals) -> tuple[Array, dict[str, Array], dict[str, Place]] | None:
    """Return drive torque, resisting torques by parameter, and the places of effects as resisting torques.

    None where a channel or parameter is missing.
    """
    model = s.model
    if s.current is None or s.velocity is None or s.acceleration is None or s.sliding is None:
        return None
    if model.torque_constant is None or model.rotor_inertia is None:
        return None
    drive, inertia, damping = model.torque_constant * s.current, model.rotor_inertia, model.viscous_damping or 0.0
    resisting_columns = {
        "rotor_inertia": inertia * s.acceleration,
        "viscous_damping": damping * s.velocity,
        "coulomb_friction": (model.coulomb_friction or 0.0) * s.sliding,
    }
    constant, interval = model.torque_constant, s.interval
    moved_inertia = inertia + (s.load_inertia if s.mechanical == "free" else 0.0)

    def angle_error(column: Array) -> Array:
        """Return the resisting torque [N*m] that an error of the angle [rad] seems to add."""
        speed = slope(smooth(column), interval)
        return -(moved_inertia * slope(speed, interval) + damping * speed)

    places: dict[str, Place] = {
        "drag": lambda c: c,
        "torque_factor": lambda c: -drive * c,
        "current_reading": lambda c: constant * c,
        "angle_reading": angle_error,
    }
    return drive, resisting_columns, places


def torque_reading(clock: Clocked, s: Signals, inertia_per_stiffness: float) -> Array | None:
    """Return the torque channel [N*m] with its filter inverted, and the inertial torque of a locked rotor added.

    inertia_per_stiffness : of a locked rotor on its shaft [s^2]; zero for a turning one.
    """
    values = channel_means(clock, "torque")
    if values is None:
        return None
    reading = smooth(values)
    rate = slope(reading, s.interval)
    if s.model.bench.torque_filter_bandwidth:
        reading = reading + rate / (2 * np.pi * s.model.bench.torque_filter_bandwidth)
    return np.asarray(reading + inertia_per_stiffness * slope(rate, s.interval), np.float64)


def _negative(place: Place) -> Place:
    """Return the place of an effect with the opposite sign."""
    return lambda c: -place(c)
