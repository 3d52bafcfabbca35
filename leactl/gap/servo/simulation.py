"""Free runs of position servos, many parameter sets at once.

A free run of a servo shows where it sticks, which a balance of torques cannot. Friction is
`(f + c |T|) (1 + r exp(-(|w| / v)^n)) (1 + s sgn(w)) (1 + p cos(m q) + u sin(m q)) + b |w| + d w^2` over the torque T
that the motor puts into the gear; at standstill it cancels the driving torque up to this limit. Saturation reduces that
torque by a share that grows with a power of the current, dead time by a voltage that saturates with the current. Errors
within a dead band give no output, and a limited reference is computed by `profile`. These effects equal those of the
library with the same names, whose parameters have the same names here.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from leactl.gap.replay.time_steps import SERVO_STEP
from leactl.gap.servo.profile import SLOWNESS, SLUGGISHNESS, SetPoints
from leactl.gap.servo.runs import ServoRuns
from leactl.gap.servo.stretches import Stretches, whole_runs

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Parameters = dict[str, float]
FEWEST_PARTS, MOST_PARTS = 2, 20  # simulation steps in a sample
FREE_PARAMETERS = (
    "torque_constant",
    "phase_resistance",
    "rotor_inertia",
    "viscous_damping",
    "coulomb_friction",
    "load_zero",
    "reference_delay",
    "voltage_delay",
    SLOWNESS,
    SLUGGISHNESS,
    "servo_dead_band.band",
    "saturation.loss",
    "load_dependent_friction.coefficient",
    "stribeck.breakaway_ratio",
    "stribeck.stribeck_velocity",
    "position_dependent_friction.cos",
    "position_dependent_friction.sin",
    "asymmetric_friction.asymmetry",
    "quadratic_drag.coefficient",
    "dead_time.voltage",
    "dead_time.current",
)
"""Parameters that a fit may move."""
SHAPE_DEFAULTS = {
    "saturation.exponent": 2.0,
    "saturation.current": 25.0,
    "stribeck.shape": 1.0,
    "position_dependent_friction.order": 1.0,
}
"""Parameters that are never fitted, with their defaults."""
SIGNED_PARAMETERS = (
    "load_zero",
    "voltage_delay",
    "position_dependent_friction.cos",
    "position_dependent_friction.sin",
    "asymmetric_friction.asymmetry",
)
"""Parameters that may be negative."""
FINEST_RESOLUTION = 1e-6  # rad, resolution of an encoder whose counts do not show
BAND_EDGE_COUNTS = 1.0  # encoder counts over which a dead band ends


def table(points: Sequence[Mapping[str, float]]) -> dict[str, Array]:
    """Return parameter sets as one array per parameter; a parameter missing in a set is at its default, or zero."""
    names = {name for point in points for name in point}
    return {name: np.array([point.get(name, SHAPE_DEFAULTS.get(name, 0.0)) for point in points]) for name in names}


def replay(runs: ServoRuns, sets: Mapping[str, Array]) -> Array:
    """Return the angles [rad] of whole runs simulated from their first states, (sets, runs, samples).

    sets : by parameter, one value per set.
    """
    return simulate(runs, sets, whole_runs(runs), SetPoints(runs))


def simulate(runs: ServoRuns, sets: Mapping[str, Array], stretches: Stretches, set_points: SetPoints) -> Array:
    """Return the angles [rad] of stretches simulated side by side and joined to runs, (sets, runs, samples)."""
    count, run = len(next(iter(sets.values()))), stretches.run

    def of_parameter(name: str) -> Array:
        return np.repeat(sets.get(name, np.full(count, SHAPE_DEFAULTS.get(name, 0.0)))[:, None], len(run), axis=1)

    def of_runs(values: Array) -> Array:
        return np.repeat(values[run][None], count, axis=0)

    constant, resistance, coulomb, damping, load_zero = (
        of_parameter(name)
        for name in ("torque_constant", "phase_resistance", "coulomb_friction", "viscous_damping", "load_zero")
    )
    parts = parts_of(runs, sets)
    step = runs.interval / parts
    gain, rate_gain, level = (of_runs(values) for values in (runs.gain, runs.rate_gain, runs.level))
    has_rate_gain = bool(np.any(rate_gain))
    # half of the damping acts at the end of a step (implicit), which allows far longer steps
    half_drive_damping = 0.5 * constant * (constant + rate_gain) / resistance
    free_impedance = (of_parameter("rotor_inertia") + of_runs(runs.inertia)) / step + 0.5 * damping
    impedance = free_impedance + half_drive_damping
    saturate = _saturation_function(*(of_parameter(f"saturation.{name}") for name in ("loss", "exponent", "current")))
    load_coefficient = of_parameter("load_dependent_friction.coefficient")
    speed_factor = _stribeck_function(
        *(of_parameter(f"stribeck.{name}") for name in ("breakaway_ratio", "stribeck_velocity", "shape"))
    )
    angle_factor = _angle_function(
        *(of_parameter(f"position_dependent_friction.{name}") for name in ("cos", "sin", "order"))
    )
    dead_band = _dead_band_function(
        of_parameter("servo_dead_band.band"), max(BAND_EDGE_COUNTS * runs.encoder_resolution, FINEST_RESOLUTION)
    )
    has_load_friction, has_pendulum = bool(np.any(load_coefficient)), runs.hangs
    asymmetry, drag = of_parameter("asymmetric_friction.asymmetry"), of_parameter("quadratic_drag.coefficient")
    has_asymmetry, has_drag = bool(np.any(asymmetry)), bool(np.any(drag))
    dead_current, dead_time_current = (
        of_parameter("dead_time.voltage") / resistance,
        np.maximum(of_parameter("dead_time.current"), 1e-300),
    )
    has_dead_time = bool(np.any(dead_current))
    highest_voltage = of_runs(runs.limit)
    lowest_voltage = -highest_voltage
    begins, ends, profile_index = set_points.at(sets, count)
    has_profile, elapsed_shares = begins is not ends, [(part + 0.5) / parts for part in range(parts)]
    samples = np.minimum(stretches.samples, runs.angle.shape[1] - 1)
    # one row per sample, in which all lanes are adjacent
    reference_changes = by_lane(ends - begins, run, samples, profile_index) if has_profile else None
    begins = by_lane(begins, run, samples, profile_index)
    enabled, has_switched_drive = runs.enabled[run[:, None], samples].T.copy(), bool(np.any(runs.enabled < 1.0))
    angle = np.repeat(stretches.angle[None], count, axis=0)
    speed = np.repeat(stretches.speed[None], count, axis=0)
    drive, friction, scratch, gravity_torque, reference = (np.zeros_like(angle) for _ in range(5))
    angles = np.empty((stretches.length, *angle.shape))
    conductance = 1.0 / resistance
    emf_constant, rate_voltage, last_reference = constant.copy(), np.zeros_like(angle), begins[0]
    # arrays of a few hundred numbers: the number of numpy calls takes the time, not their size. The loop works
    # in place, and `drive` holds the error, the voltage, the current, the torque and the change of speed in turn
    for sample in range(stretches.length):
        angles[sample] = angle
        target = begins[sample]
        if has_switched_drive:
            conductance = enabled[sample] / resistance
            impedance = free_impedance + enabled[sample] * half_drive_damping
        if has_rate_gain:
            next_target = target if reference_changes is None else target + reference_changes[sample]
            np.subtract(next_target, last_reference, out=rate_voltage)
            rate_voltage *= rate_gain / runs.interval
            last_reference = next_target
        if has_pendulum:
            np.multiply(speed, 0.5 * runs.interval, out=gravity_torque)
            gravity_torque += angle
            gravity_torque += load_zero
            np.sin(gravity_torque, out=gravity_torque)
            gravity_torque *= level
        for part in range(parts):
            if reference_changes is None:
                np.subtract(target, angle, out=drive)
            else:
                np.multiply(reference_changes[sample], elapsed_shares[part], out=reference)
                reference += target
                np.subtract(reference, angle, out=drive)
            if dead_band is not None:
                dead_band(drive, scratch)
            drive *= gain
            if has_rate_gain:
                drive += rate_voltage
                np.multiply(rate_gain, speed, out=scratch)
                drive -= scratch
            np.minimum(drive, highest_voltage, out=drive)
            np.maximum(drive, lowest_voltage, out=drive)
            np.multiply(emf_constant, speed, out=scratch)
            drive -= scratch
            drive *= conductance  # the current
            if has_dead_time:
                drive -= (
                    (enabled[sample] if has_switched_drive else 1.0) * dead_current * np.tanh(drive / dead_time_current)
                )
            if saturate is not None:
                saturate(drive, scratch)
            drive *= constant
            if has_load_friction:
                np.abs(drive, out=friction)
                friction *= load_coefficient
                friction += coulomb
            else:
                np.copyto(friction, coulomb)
            np.abs(speed, out=scratch)
            if speed_factor is not None:
                friction *= speed_factor(scratch)
            if angle_factor is not None:
                friction *= angle_factor(angle)
            if has_asymmetry:
                friction *= 1.0 + asymmetry * np.sign(speed)
            if has_drag:
                friction += drag * scratch**2
            scratch *= damping
            friction += scratch
            if has_pendulum:
                drive -= gravity_torque
            np.multiply(impedance, speed, out=scratch)
            scratch += drive  # torque that would bring the axis to rest
            np.minimum(scratch, friction, out=scratch)
            np.negative(friction, out=friction)
            np.maximum(scratch, friction, out=scratch)
            drive -= scratch
            drive /= impedance
            speed += drive
            np.multiply(speed, step, out=drive)
            angle += drive
    return join_stretches(angles, stretches, runs)


def voltages(runs: ServoRuns, sets: Mapping[str, Array], set_points: SetPoints) -> Array:
    """Return the controller's voltages [V] for the measured angles, (sets, runs, samples).

    They do not depend on the motor, so their residuals show effects of the drive alone.
    """
    count = len(next(iter(sets.values())))
    begins, _, profile_index = set_points.at(sets, count, "voltage_delay")
    error = begins[profile_index] - runs.angle
    band = sets.get("servo_dead_band.band", np.zeros(count))[:, None, None]
    dead_band = _dead_band_function(band, max(BAND_EDGE_COUNTS * runs.encoder_resolution, FINEST_RESOLUTION))
    if dead_band is not None:
        dead_band(error, np.empty_like(error))
    volts = runs.gain[:, None] * error
    if np.any(runs.rate_gain):
        reference_rate = np.gradient(begins, runs.interval, axis=2)[profile_index]
        error_rate = reference_rate - np.gradient(runs.angle, runs.interval, axis=1)
        volts += runs.rate_gain[:, None] * error_rate
    limit = runs.limit[:, None]
    return np.asarray(np.clip(volts, -limit, limit) * runs.enabled, np.float64)


def by_lane(values: Array, run: Index, samples: Index, profile_index: Index) -> Array:
    """Return values (profiles, runs, samples) rearranged by lane, (samples, sets, stretches)."""
    return np.take(np.ascontiguousarray(np.moveaxis(values[:, run[:, None], samples], 2, 0)), profile_index, axis=1)


def join_stretches(values: Array, stretches: Stretches, runs: ServoRuns) -> Array:
    """Return the scored parts of stretches, (samples, sets, stretches), joined to runs, (sets, runs, samples)."""
    scored = np.moveaxis(values, 0, 2)
    samples = runs.angle.shape[1]
    if stretches.length == samples:
        return scored
    joined = np.empty((scored.shape[0], len(runs.gain), samples))
    for stretch, (run, begin, scored_from) in enumerate(
        zip(stretches.run, stretches.first, stretches.scored_from, strict=True)
    ):
        end = min(begin + stretches.length, samples)
        joined[:, run, scored_from:end] = scored[:, stretch, scored_from - begin : end - begin]
    return joined


def parts_of(runs: ServoRuns, sets: Mapping[str, Array]) -> int:
    """Return the number of simulation steps in a sample that the lightest axis needs in the median set."""
    constant, resistance = sets["torque_constant"], sets["phase_resistance"]
    least_inertia = sets["rotor_inertia"] + float(np.min(runs.inertia))
    decay_rate = constant * (constant + float(np.max(runs.rate_gain))) / (resistance * least_inertia)
    natural_frequency = np.sqrt(float(np.max(runs.gain)) * constant / (resistance * least_inertia))
    needed_parts = runs.interval * float(np.quantile(np.maximum(decay_rate, natural_frequency), 0.5)) / SERVO_STEP
    return int(np.clip(np.ceil(needed_parts), FEWEST_PARTS, MOST_PARTS)) if np.isfinite(needed_parts) else FEWEST_PARTS


def _dead_band_function(band: Array, edge: float) -> Callable[[Array, Array], None] | None:
    """Return a function that zeroes errors within a dead band in place; None if no set has a band.

    band, edge : rad, half width of the band, and width over which the output rises at its end.
    """
    if not np.any(band):
        return None
    band_end = np.where(band > 0.0, band / edge - 0.5, -np.inf)

    def apply_dead_band(error: Array, scratch: Array) -> None:
        np.abs(error, out=scratch)
        scratch /= edge
        scratch -= band_end
        np.clip(scratch, 0.0, 1.0, out=scratch)
        error *= scratch

    return apply_dead_band


def _saturation_function(loss: Array, exponent: Array, current_scale: Array) -> Callable[[Array, Array], None] | None:
    """Return a function that reduces currents by saturation in place; None if no set has a loss."""
    if not np.any(loss):
        return None
    has_exponent, is_square = bool(np.any(exponent != 1.0)), bool(np.all(exponent == 2.0))

    def saturate(current: Array, scratch: Array) -> None:
        np.abs(current, out=scratch)
        scratch /= current_scale
        if is_square:
            np.multiply(scratch, scratch, out=scratch)
        elif has_exponent:
            np.power(scratch, exponent, out=scratch)
        scratch *= loss
        np.subtract(1.0, scratch, out=scratch)
        np.maximum(scratch, 0.0, out=scratch)
        current *= scratch

    return saturate


def _stribeck_function(breakaway_ratio: Array, velocity: Array, shape: Array) -> Callable[[Array], Array] | None:
    """Return the factor on friction as a function of speed; None if it is one in all sets."""
    if not np.any(breakaway_ratio):
        return None
    per_speed = 1.0 / np.maximum(velocity, 1e-300)
    has_shape, is_square = bool(np.any(shape != 1.0)), bool(np.all(shape == 2.0))

    def factor_at(speed: Array) -> Array:
        decay = speed * per_speed
        if is_square:
            np.multiply(decay, decay, out=decay)
        elif has_shape:
            np.power(decay, shape, out=decay)
        np.negative(decay, out=decay)
        np.exp(decay, out=decay)
        decay *= breakaway_ratio
        decay += 1.0
        return decay

    return factor_at


def _angle_function(cosine: Array, sine: Array, order: Array) -> Callable[[Array], Array] | None:
    """Return the factor on friction as a function of the angle; None if it is one in all sets."""
    if not (np.any(cosine) or np.any(sine)):
        return None

    def factor_at(angle: Array) -> Array:
        phase = order * angle
        return np.asarray(1.0 + cosine * np.cos(phase) + sine * np.sin(phase), np.float64)

    return factor_at
