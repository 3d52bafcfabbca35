"""Relations between the channels of a run and the model, as factors that are one in a sound set-up.

Each relation is a regression of one channel on its expected value, with further columns for lags and offsets. Channels
that are differentiated are smoothed until the encoder's noise no longer shows in the acceleration.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_opening, maximum_filter1d

from leactl.effects.hysteresis_and_lags import play
from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.record import Clocked, Record
from leactl.gap.signals.rig import voltage_feed
from leactl.gap.signals.smoothing import BASE_WIDTH, slope, smooth
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
MOST_WIDTH = 64.0  # samples, widest smoothing; an encoder that needs more is too coarse for an acceleration
MOST_NOISE_SHARE = 0.1  # largest noise of an acceleration, as a share of its standard deviation
# standard deviation of the second derivative of smoothed noise over that of the noise, at a width of one sample
CURVATURE_NOISE = 0.46
LEAST_FIT_SHARE = 0.8  # smallest share of a channel's variance that its expected value explains if a relation holds
FEWEST_SAMPLES = 50  # samples that a relation needs
MOST_BRIDGED_SAMPLES = 1  # samples of the longest gap that interpolation bridges well
LEAST_COEFFICIENT_STDS = 4.0  # standard errors from which a coefficient is determined
SMALL_SHARE = 0.3  # share of the values that count as small
MOST_FACTOR_DIFFERENCE = 0.3  # relative difference of the logarithms of the factors of small and of all values
MOST_SMALL_LEVEL = 0.5  # share of a channel's largest value above which a value is not small
LEAST_LOG_FACTOR = 0.1  # logarithm of a factor below which small and large values need not agree
ERROR_WIDENING = 3.0  # factor on standard errors, for residuals that are not noise
TIGHT_STD = 0.02  # standard deviation of the logarithm of a factor between two channels of one quantity
FACTOR_STDS = {
    "velocity test": TIGHT_STD,
    "velocity load": TIGHT_STD,
    "current test": TIGHT_STD,
    "current load": TIGHT_STD,
    "angle to its reference": 0.3,
    "velocity to its reference": 0.3,
    "torque": 0.07,
    "resistance": 0.2,
    "back_emf": 0.03,
    "feeding": 1.0,
    "inertia": 0.2,
    "damping": 0.5,
    "friction": 0.4,
}
"""Standard deviation of each factor's logarithm on sound machines, without the share of the torque constant."""
CONSTANT_STD = 0.08  # standard deviation of the logarithm of the torque constant on sound machines
CONSTANT_POWERS = {"torque": 1.0, "back_emf": 1.0, "inertia": -1.0, "damping": -1.0, "friction": -1.0}
"""Power of the torque constant in each factor."""


@dataclass(frozen=True)
class Factor:
    """One factor of one run: logged over expected value."""

    relation: str
    value: float
    error: float  # of its logarithm
    r_squared: float  # share of the channel's variance that the whole regression explains
    explained: float  # share of the channel's squared error that the factor removes

    @property
    def holds(self) -> bool:
        """Whether the relation explains enough of the channel's variance."""
        return self.r_squared >= LEAST_FIT_SHARE


@dataclass(frozen=True)
class SmoothedMotion:
    """Angle, velocity and acceleration of a run with one smoothing of `width` samples."""

    angle: Array | None
    velocity: Array
    acceleration: Array
    width: float


def factors_of(record: Record, model: Model) -> Iterator[Factor]:
    """Yield every factor that a run determines, and every relation that does not hold."""
    clock = record.fast
    if clock is None or len(clock.time) < FEWEST_SAMPLES:
        return
    for role in ("test", "load"):
        yield from followed_factors(clock, role, record.mechanical)
    motion = motion_of(clock)
    yield from torque_factors(clock, model, record.mechanical, motion)
    if motion is not None:
        yield from voltage_factors(clock, model, record.mechanical, motion)
        if record.mechanical == "free":
            yield from feeding_factors(record, clock, model, motion)
            yield from motion_factors(record, clock, model, motion)


def motion_of(clock: Clocked, role: str = "test") -> SmoothedMotion | None:
    """Return the motion from the angle, else the velocity; None if neither is logged or the acceleration is noise."""
    angle, velocity = clock.get("angle", role), clock.get("velocity", role)
    if angle is None and velocity is None:
        return None
    width = BASE_WIDTH
    while width <= MOST_WIDTH:
        if angle is not None:
            speed = smooth(np.gradient(angle, clock.interval), width)
            noise = noise_of(angle) * CURVATURE_NOISE / width**2.5 / clock.interval**2
        else:
            speed = smooth(np.asarray(velocity), width)
            noise = noise_of(np.asarray(velocity)) * CURVATURE_NOISE / width**1.5 / clock.interval
        acceleration = slope(speed, clock.interval)
        if noise <= MOST_NOISE_SHARE * float(np.std(acceleration)):
            return SmoothedMotion(None if angle is None else smooth(angle, width), speed, acceleration, width)
        width *= math.sqrt(2.0)
    return None


def followed_factors(clock: Clocked, role: str, mechanical: str) -> Iterator[Factor]:
    """Yield the factors of channels that equal another channel or follow their reference."""
    angle = "angle", role if clock.get("angle", role) is not None or mechanical != "coupled" else "test"
    pairs = [
        (f"velocity {role}", ("velocity", role), angle),
        (f"current {role}", ("q_axis_current", role), ("q_axis_current_reference", role)),
    ]
    if role == "test":
        pairs += [
            ("angle to its reference", ("angle", role), ("angle_reference", role)),
            ("velocity to its reference", ("velocity", role), ("velocity_reference", role)),
        ]
    for name, key, companion in pairs:
        measured, expected = clock.get(*key), clock.get(*companion)
        if measured is None or expected is None or (mechanical == "locked" and key[0] != "q_axis_current"):
            continue
        if key[0] == "velocity" and companion[0] == "angle":
            expected = np.gradient(expected, clock.interval)
        width = smoothing_width(expected)
        expected = smooth(expected, width)
        valid = clock.all_valid(key, companion)
        yield from single_factor(name, smooth(measured, width), expected, [slope(expected, 1.0)], valid, width)


def smoothing_width(values: Array) -> float:
    """Return the smoothing [samples] that leaves a share of `MOST_NOISE_SHARE` of noise or less, else the widest."""
    width = BASE_WIDTH
    while width < MOST_WIDTH and noise_of(values) / math.sqrt(3.5 * width) > MOST_NOISE_SHARE * float(
        np.std(smooth(values, width))
    ):
        width *= math.sqrt(2.0)
    return width


def torque_factors(clock: Clocked, model: Model, mechanical: str, motion: SmoothedMotion | None) -> Iterator[Factor]:
    """Yield the factor of the logged shaft torque over the torque from current and motion."""
    torque, motor_torque = clock.get("torque"), torque_of_current(clock, model, mechanical)
    if torque is None or motor_torque is None:
        return
    valid = clock.all_valid(("torque", "test"), ("q_axis_current", "test"))
    width, other_columns = BASE_WIDTH, list[Array]()
    if mechanical == "coupled" and motion is not None:
        width, valid = motion.width, valid & clock.all_valid(("angle", "test"))
        other_columns = [motion.acceleration, motion.velocity, smooth(np.sign(motion.velocity), width)]
    motor_torque = smooth(motor_torque, width)
    yield from single_factor(
        "torque", smooth(torque, width), motor_torque, [slope(motor_torque, 1.0), *other_columns], valid, width
    )


def torque_of_current(clock: Clocked, model: Model, mechanical: str) -> Array | None:
    """Return the torque [N*m] of the current; for a locked rotor, the part that sticking friction lets through.

    None if the run has no current, the model no torque constant, or the rotor is neither locked nor coupled.
    """
    current = clock.get("q_axis_current")
    if current is None or not model.torque_constant or mechanical not in ("locked", "coupled"):
        return None
    motor_torque = model.torque_constant * current
    return play(motor_torque, model.coulomb_friction or 0.0) if mechanical == "locked" else motor_torque


def voltage_factors(clock: Clocked, model: Model, mechanical: str, motion: SmoothedMotion) -> Iterator[Factor]:
    """Yield the factors of resistance and back-EMF in the voltage."""
    voltage, current = clock.get("q_axis_voltage"), clock.get("q_axis_current")
    if voltage is None or current is None:
        return
    constant = model.back_emf_constant or model.torque_constant
    current = smooth(current, motion.width)
    sign = np.tanh(4.0 * current / (float(np.std(current)) or 1.0))  # column of a drive's dead time
    columns = [current, motion.velocity, slope(current, 1.0), sign]
    nominal = {"resistance": model.phase_resistance, "back_emf": constant}
    if mechanical == "locked":
        del nominal["back_emf"], columns[1]
    valid = clock.all_valid(("q_axis_voltage", "test"), ("q_axis_current", "test"), ("angle", "test"))
    yield from coefficient_factors(nominal, smooth(voltage, motion.width), columns, valid, motion.width)


def feeding_factors(record: Record, clock: Clocked, model: Model, motion: SmoothedMotion) -> Iterator[Factor]:
    """Yield the factor of a feeding voltage over the voltage for the motion; it shows the sign, not the size.

    Both are extended by their negative mirror images, since a step holds one voltage, whose sign is in its mean.
    """
    expected, voltage = voltage_for_motion(record, model, motion), clock.get("q_axis_voltage")
    if expected is None or voltage is None:
        return
    measured, expected = smooth(voltage, motion.width), smooth(expected, motion.width)
    valid = clock.all_valid(("q_axis_voltage", "test"), ("angle", "test"))
    measured, expected = (np.concatenate([values, -values[::-1]]) for values in (measured, expected))
    yield from single_factor("feeding", measured, expected, [], np.concatenate([valid, valid[::-1]]), motion.width)


def voltage_for_motion(record: Record, model: Model, motion: SmoothedMotion) -> Array | None:
    """Return the voltage [V] for back-EMF and friction of a motor fed with a voltage; None if no voltage feeds it."""
    feed = voltage_feed(record, model)
    if feed is None:
        return None
    friction = (model.coulomb_friction or 0.0) * np.sign(motion.velocity)
    return np.asarray((feed.damping * motion.velocity + friction) / feed.gain, np.float64)


def motion_factors(record: Record, clock: Clocked, model: Model, motion: SmoothedMotion) -> Iterator[Factor]:
    """Yield the factors of inertia, damping and friction in the current of a free run; gravity is fitted, too."""
    current = clock.get("q_axis_current")
    if current is None or not model.torque_constant:
        return
    constant, load = model.torque_constant, model.load
    mass, length = record.setup.get("load_mass", load.mass), record.setup.get("load_length", load.length)
    arm = record.setup.get("load_arm_mass", load.arm_mass)
    inertia = None if model.rotor_inertia is None else model.rotor_inertia + (mass + arm / 3.0) * length**2
    parameters = {"inertia": inertia, "damping": model.viscous_damping, "friction": model.coulomb_friction}
    nominal = {name: value / constant if value else None for name, value in parameters.items()}
    columns = [motion.acceleration, motion.velocity, smooth(np.sign(motion.velocity), motion.width)]
    if motion.angle is not None and load.type != "none":
        columns += [np.sin(motion.angle), np.cos(motion.angle)]
    valid = clock.all_valid(("q_axis_current", "test"), ("angle", "test"))
    yield from coefficient_factors(nominal, smooth(current, motion.width), columns, valid, motion.width)


def single_factor(
    name: str, measured: Array, expected: Array, other_columns: list[Array], valid: Mask, width: float
) -> Iterator[Factor]:
    """Yield the factor of one relation, if it is determined or does not hold."""
    yield from coefficient_factors({name: 1.0}, measured, [expected, *other_columns], valid, width)


def coefficient_factors(
    nominal: dict[str, float | None], measured: Array, columns: list[Array], valid: Mask, width: float
) -> Iterator[Factor]:
    """Yield the ratios of the first columns' coefficients to their nominal values; the other columns are fitted, too.

    nominal : value by relation, in the order of the first columns; None or zero if the model has none.
    width : samples, smoothing of the channels, which leaves fewer independent samples.
    """
    valid = samples_away_from_gaps(valid, width)
    design = np.stack([column[valid] for column in columns], axis=1)
    values = measured[valid]
    independent_count = len(values) / (math.sqrt(4.0 * math.pi) * width)
    if len(values) < FEWEST_SAMPLES or independent_count < 2 * design.shape[1] or float(np.ptp(values)) == 0.0:
        return
    design, values = design - design.mean(axis=0), values - values.mean()
    column_rms = np.sqrt(np.mean(design**2, axis=0))
    non_zero = column_rms > 0.0
    coefficients, covariance = np.zeros(len(column_rms)), np.full(len(column_rms), np.inf)
    scaled = design[:, non_zero] / column_rms[non_zero]
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10)
    coefficients[non_zero] = inverse @ (scaled.T @ values) / column_rms[non_zero]
    if len(nominal) == 1 and not is_scaled(design, values, float(coefficients[0])):
        return
    residual = values - design @ coefficients
    noise = (
        float(residual @ residual) / max(independent_count - int(non_zero.sum()), 1.0) * independent_count / len(values)
    )
    covariance[non_zero] = np.diag(inverse) * len(values) / independent_count * noise / column_rms[non_zero] ** 2
    r_squared = 1.0 - float(residual @ residual) / float(values @ values)
    nominal_values = np.asarray([value or 0.0 for value in nominal.values()])
    nominal_residual = values - design[:, : len(nominal_values)] @ nominal_values
    other_columns = design[:, len(nominal_values) :]
    if other_columns.shape[1]:
        nominal_residual = (
            nominal_residual - other_columns @ np.linalg.lstsq(other_columns, nominal_residual, rcond=1e-10)[0]
        )
    nominal_squares = float(nominal_residual @ nominal_residual)
    explained = 1.0 - float(residual @ residual) / nominal_squares if nominal_squares > 0.0 else 0.0
    for index, (name, value) in enumerate(nominal.items()):
        error = ERROR_WIDENING * math.sqrt(covariance[index])
        determined = math.isfinite(error) and abs(coefficients[index]) > LEAST_COEFFICIENT_STDS * error
        if value and (determined or r_squared < LEAST_FIT_SHARE):
            coefficient_size = abs(float(coefficients[index])) or 1e-300
            yield Factor(name, float(coefficients[index]) / value, error / coefficient_size, r_squared, explained)


def is_scaled(design: Array, values: Array, factor_of_all: float) -> bool:
    """Return whether small values have the same factor as all: a limit changes only large values, a scale all."""
    expected_size = np.abs(design[:, 0])
    small_limit = float(np.quantile(expected_size, SMALL_SHARE))
    is_small = expected_size <= small_limit
    if factor_of_all <= 0.0 or abs(math.log(factor_of_all)) < LEAST_LOG_FACTOR or int(is_small.sum()) < FEWEST_SAMPLES:
        return True
    if small_limit > MOST_SMALL_LEVEL * float(np.max(expected_size)):  # a channel of two levels has no small values
        return False
    columns = np.column_stack([design[is_small], np.ones(int(is_small.sum()))])
    factor_of_small = float(np.linalg.lstsq(columns, values[is_small], rcond=1e-10)[0][0])
    return factor_of_small > 0.0 and abs(math.log(factor_of_small / factor_of_all)) <= MOST_FACTOR_DIFFERENCE * abs(
        math.log(factor_of_all)
    )


def samples_away_from_gaps(valid: Mask, width: float) -> Mask:
    """Return the valid samples more than two widths of the smoothing from a gap; a gap of one sample does not count."""
    if valid.all():
        return valid
    gaps = binary_opening(~valid, np.ones(MOST_BRIDGED_SAMPLES + 1))
    return np.asarray(valid & ~maximum_filter1d(gaps, 2 * int(2.0 * width) + 1), np.bool_)
