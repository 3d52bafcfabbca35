"""Signals of equations and effects from the channels of a run: the motion by the encoder, the model's response to the
reference, and the model's torque on the shaft.

Current, voltage and torque are means over the interval that ends at a stamp, as the difference of two angles is;
instants are averaged with the one before. All get one smoothing, so that no equation compares a smooth side with a
sharp one.
"""

import math
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter, lfilter_zi

from leactl.effects.contract import Signals
from leactl.effects.hysteresis_and_lags import play, ramp_means
from leactl.gap.signals.noise import noise_of, quantum_of
from leactl.gap.signals.record import Clocked, Record
from leactl.gap.signals.smoothing import interval_means, sharp_mean_signs, slope, smooth, speeds
from leactl.model.motor_schema import Thermal
from leactl.model.nominal import BenchModel, Model
from leactl.model.thermal_network import ThermalNetwork

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
TEMPERATURE_SMOOTHING_SHARE = 0.15  # smoothing of temperatures, as a share of a winding's time constant
LEAST_TEMPERATURE_SMOOTHING = 2.0  # samples, narrowest smoothing of temperatures
RESIDUAL_SMOOTHING_SHARE = 0.87  # smoothing of the part that no network explains, as a share of the time constant
RESIDUAL_SMOOTHING = 6.0  # samples, smoothing of that part without a network
NETWORK_PRIOR = 1.0  # K per e-fold, prior cost of a change of a network parameter
MOST_NETWORK_CHANGE = 1.5  # e-folds, largest change of a network parameter from the model's value
MOST_NETWORK_ROUNDS = 8  # rounds of the network's fit, of one evaluation for each unknown and one more
CALM_WIDTH = 5.0  # samples, smoothing of torque and velocity until encoder steps no longer show
SWING_DAMPING = 0.03  # damping ratio of shafts without a damper
RINGING_TIME_CONSTANTS = 2.4  # decay time constants for which a locked rotor may swing on its shaft
STICKING_SWING = 0.5  # swing over friction from which the sticking position of a locked rotor is unknown
SLIDING_SWING = 1.0  # swing over friction from which the sliding of a locked rotor is unknown
LEAST_FRICTION_SHARE = 0.01  # share of the largest torque below which friction hardly moves the sticking position
FOURTH_DIFFERENCE_VARIANCE = 70.0  # variance of a fourth difference, over that of a sample
LEAST_SETTLED_INTERVAL = 3.0  # time constants of a current loop; within a longer interval its current settles
SUDDEN_POWER_RATIO = 4.0  # power of fourth differences over noise from which motion changes between samples
SUDDEN_WINDOW = 9  # samples over which that power is averaged
SHORTEST_RAMP = 1e-6  # time constants of the loop; a shorter ramp is a step
SHARP_WIDTH = 0.7  # samples, smoothing of the current where friction sticks: noise must not move the play


def fast_signals(record: Record, model: Model, slow: Signals | None) -> Signals | None:
    """Return the signals on the drive's clock; None where the run has no such clock."""
    clock = record.fast
    if clock is None:
        return None
    dt = clock.interval
    s = Signals(record.mechanical, clock.since_begin, model, dt, record.name, clock.fastest, smoothed=smooth)
    current = channel_means(clock, "q_axis_current")
    reference = clock.get("q_axis_current_reference")
    if reference is not None and model.bench.current_loop_bandwidth:
        if not moved_by_a_servo(clock):
            reference = with_setpoint_lead(reference, model.bench, dt)
        bandwidth, as_means = model.bench.current_loop_bandwidth, ("q_axis_current", "test") in clock.means
        keys = {("q_axis_current", "test"), ("q_axis_current_reference", "test")}
        unclear_stamps = keys & (clock.unstamped | clock.between.keys())
        s.command_held = not (unclear_stamps or clock.setpoints_between or moved_by_a_servo(clock))
        ends, means = loop_response(reference, bandwidth, dt)
        s.command, s.following = reference, means if as_means else ends
        s.looped = partial(loop_reading, bandwidth=bandwidth, interval=dt, as_mean=as_means)
        if not as_means and current is not None and not moved_by_a_servo(clock):
            current = current + means - interval_means(ends)  # corrects for a step between two instants
    if current is not None:
        s.current = smooth(current)
        s.extra["sharp_current"] = smooth(current, SHARP_WIDTH)
    voltage = channel_means(clock, "q_axis_voltage")
    s.voltage = smooth(voltage) if voltage is not None else None
    s.bus_voltage = clock.get("bus_voltage", "bench")
    angle = clock.get("angle")
    if angle is not None:
        speed = speeds(angle, dt)
        s.sharp_angle = interval_means(angle)
        s.angle = smooth(s.sharp_angle)
        s.velocity = smooth(speed)
        s.acceleration = slope(s.velocity, dt)
        s.count = quantum_of(np.diff(angle))
        s.sliding = smooth(sharp_mean_signs(speed, max(s.count, math.sqrt(2.0) * noise_of(angle)) / dt))
    elif (velocity := clock.get("velocity")) is not None:
        s.velocity = smooth(interval_means(velocity))
        s.acceleration = slope(s.velocity, dt)
        s.sliding = smooth(sharp_mean_signs(interval_means(velocity), noise_of(velocity)))
    interpolate_temperatures(s, slow, clock.time)
    s.torque = shaft_torque(s)
    if s.torque is not None:
        # a locked rotor's torque comes from the current alone: no encoder step is in it
        s.calm_torque = s.torque if s.mechanical == "locked" else smooth(s.torque, CALM_WIDTH)
    if s.velocity is not None:
        s.calm_velocity = smooth(s.velocity, CALM_WIDTH)
    if angle is not None:
        s.resolved = resolved_samples(angle, s.count) & ~hidden_step_samples(clock, model.bench)
    s.settled, s.unleapt = known_sticking_samples(s, STICKING_SWING), known_sticking_samples(s, SLIDING_SWING)
    return s


def resolved_samples(angle: Array, count: float) -> Mask:
    """Return the samples around which an angle is smooth enough to be interpolated.

    Where fourth differences exceed their noise, the motion has parts as fast as the sampling. An encoder whose counts
    do not show is taken as smooth.
    """
    if count == 0.0 or len(angle) < SUDDEN_WINDOW:
        return np.ones(len(angle), np.bool_)
    fourth_differences = np.diff(angle, 4)
    # 0.6745: median of absolute values over standard deviation of normal noise; 1/12: variance of rounding
    noise = max(
        float(np.median(np.abs(fourth_differences))) / 0.6745, count * np.sqrt(FOURTH_DIFFERENCE_VARIANCE / 12.0)
    )
    sudden = np.zeros(len(angle), np.bool_)
    sudden[2:-2] = uniform_filter1d((fourth_differences / noise) ** 2, SUDDEN_WINDOW) > SUDDEN_POWER_RATIO
    return ~sudden


def hidden_step_samples(clock: Clocked, bench: BenchModel) -> Mask:
    """Return the samples around which a current may change and settle between two samples.

    That is where a drive is switched, and where a servo's target moves if its current loop is that fast and the log
    does not have the current as means.
    """
    hidden = np.zeros(len(clock.time), np.bool_)
    is_fast_loop = 2.0 * np.pi * (bench.current_loop_bandwidth or 0.0) * clock.interval > LEAST_SETTLED_INTERVAL
    for quantity, role in clock.values:
        is_fast_target = quantity in ("velocity_reference", "angle_reference") and is_fast_loop
        if quantity != "drive_enabled" and (not is_fast_target or ("q_axis_current", role) in clock.means):
            continue
        steps = np.diff(clock.values[quantity, role]) != 0.0
        hidden[1:] |= steps
        hidden[:-1] |= steps
    return hidden


def channel_means(clock: Clocked, quantity: str, role: str = "test") -> Array | None:
    """Return a channel as means over the interval that ends at each stamp; None where it is missing."""
    values = clock.get(quantity, role)
    if values is None or (quantity, role) in clock.means:
        return values
    return interval_means(values)


def moved_by_a_servo(clock: Clocked) -> bool:
    """Return whether a loop inside the drive moves the current reference between samples."""
    return clock.get("velocity_reference") is not None or clock.get("angle_reference") is not None


def with_setpoint_lead(reference: Array, bench: BenchModel, interval: float) -> Array:
    """Return the reference after the drive's setpoint lead, as means over the intervals of each setpoint."""
    if not bench.setpoint_lead:
        return reference
    _, lagged_means = loop_response(reference, 1.0 / (2.0 * np.pi * bench.setpoint_lead_time), interval)
    return reference + bench.setpoint_lead * (reference - lagged_means)


def loop_response(
    command: Array, bandwidth: float, interval: float, begin: float | None = None, shares: Array | None = None
) -> tuple[Array, Array]:
    """Return a first-order loop's response to a command: values at the ends of intervals, and means over them.

    command : A; held over each interval, or ramped to its value over a share of the interval first.
    begin : A, command and response before the first interval; by default the first value.
    shares : share of each interval that the ramp takes, 0 to 1; by default no ramp.
    """
    time_constant = 1.0 / (2.0 * np.pi * bandwidth)
    decay = float(np.exp(-interval / time_constant))
    start = float(command[0]) if begin is None else begin
    forcing, means = (1.0 - decay) * command, command
    if shares is not None:
        ramp_heights = np.diff(command, prepend=start)
        ramp_constants = np.maximum(shares * interval / time_constant, SHORTEST_RAMP)
        # the ramp's distance to its end, change * (1 - t / ramp), filtered by the loop until the interval ends
        forcing = (
            forcing
            - ramp_heights
            * (np.exp(ramp_constants - interval / time_constant) - decay * (1.0 + ramp_constants))
            / ramp_constants
        )
        means = ramp_means(command, shares, start)
    ends: Array = lfilter([1.0], [1.0, -decay], forcing, zi=[decay * start])[0]
    return ends, np.asarray(means - (time_constant / interval) * np.diff(ends, prepend=start), np.float64)


def loop_reading(
    command: Array, shares: Array, begin: float, bandwidth: float, interval: float, as_mean: bool
) -> Array:
    """Return the part of a loop's response that the current channel reads: its mean over each interval, or its end."""
    ends, means = loop_response(command, bandwidth, interval, begin, shares)
    return means if as_mean else ends


def known_sticking_samples(s: Signals, least_swing: float) -> Mask:
    """Return the samples at which the sticking position of a locked rotor is known; all samples in other set-ups.

    A step of the current makes the rotor swing on its shaft, and its sticking position then depends on the last swing.
    It is known again once the drive's torque has changed by twice the friction from its last extreme.

    least_swing : swing over Coulomb friction from which the position counts as unknown.
    """
    model, is_known = s.model, np.ones(len(s.time), bool)
    stiffness, inertia, friction = model.bench.shaft_stiffness, model.rotor_inertia, model.coulomb_friction or 0.0
    if s.mechanical != "locked" or s.current is None or not stiffness or not inertia or not model.torque_constant:
        return is_known
    motor_torque, natural_frequency = model.torque_constant * s.extra["sharp_current"], np.sqrt(stiffness / inertia)
    if natural_frequency * s.interval > np.pi or friction < LEAST_FRICTION_SHARE * np.max(np.abs(motor_torque)):
        return is_known
    numerator, denominator, _ = cont2discrete(
        ([natural_frequency**2], [1.0, 2.0 * SWING_DAMPING * natural_frequency, natural_frequency**2]),
        s.interval,
        "foh",
    )
    swinging_torque = lfilter(
        numerator[0], denominator, motor_torque, zi=lfilter_zi(numerator[0], denominator) * motor_torque[0]
    )[0]  # without friction
    leaps = np.flatnonzero(np.abs(swinging_torque - motor_torque) > least_swing * friction)
    if s.time[0] > 0.0:  # before a stretch of a run the sticking position is unknown
        leaps = np.union1d(0, leaps)
    for leap, next_leap in zip(leaps, np.append(leaps, len(motor_torque))[1:], strict=True):
        swing_end = leap + round(RINGING_TIME_CONSTANTS / (SWING_DAMPING * natural_frequency * s.interval))
        later_torque = motor_torque[swing_end:next_leap]
        excursion = np.maximum(
            later_torque - np.minimum.accumulate(later_torque), np.maximum.accumulate(later_torque) - later_torque
        )
        reversed_at = np.flatnonzero(excursion > 2.0 * friction)
        is_known[leap : swing_end + int(reversed_at[0]) if len(reversed_at) else next_leap] = False
    return is_known


def interpolate_temperatures(s: Signals, slow: Signals | None, time: Array) -> None:
    """Interpolate the temperatures of the slow clock at the times of the signals."""
    if slow is None:
        return
    for name in ("winding", "housing", "ambient", "winding_rise", "housing_rise"):
        values = getattr(slow, name)
        if values is not None:
            setattr(s, name, np.interp(time, slow.extra["stamps"], values))


def shaft_torque(s: Signals) -> Array | None:
    """Return the model's torque [N*m] on the shaft from current and motion.

    None if nothing is on the shaft, or the run or the model lacks what the torque is computed from.
    """
    model = s.model
    if s.current is None or model.torque_constant is None or s.mechanical not in ("locked", "coupled"):
        return None
    if s.mechanical == "locked":
        return locked_rotor_torque(s, 1.0, 1.0)
    drive = model.torque_constant * s.current
    if s.velocity is None or s.acceleration is None or s.sliding is None or model.rotor_inertia is None:
        return None
    friction = (model.viscous_damping or 0.0) * s.velocity + (model.coulomb_friction or 0.0) * s.sliding
    return drive - model.rotor_inertia * s.acceleration - friction


def locked_rotor_torque(s: Signals, drive_factor: float, friction_factor: float) -> Array:
    """Return the torque [N*m] that a locked rotor transmits, with factors on drive torque and Coulomb friction."""
    model = s.model
    motor_torque = drive_factor * (model.torque_constant or 0.0) * s.extra["sharp_current"]
    return smooth(play(motor_torque, friction_factor * (model.coulomb_friction or 0.0)))


def slow_signals(record: Record, model: Model) -> Signals | None:
    """Return the signals on the camera's clock: temperatures and heat; None where the run has no such clock."""
    clock = record.slow
    if clock is None:
        return None
    s = Signals(record.mechanical, clock.since_begin, model, clock.interval, record.name)
    s.extra["stamps"] = clock.time
    temperatures = {
        name: clock.get(f"{name}_temperature", "bench" if name == "ambient" else "test")
        for name in ("winding", "housing", "ambient")
    }
    time_constant_samples = winding_time_constant(model) / clock.interval
    width = max(TEMPERATURE_SMOOTHING_SHARE * time_constant_samples, LEAST_TEMPERATURE_SMOOTHING)
    s.line_current = clock.get("line_current")
    winding, housing, ambient = temperatures["winding"], temperatures["housing"], temperatures["ambient"]
    s.ambient = smooth(ambient, width) + model.ambient_offset if ambient is not None else None
    s.housing = smooth(housing, width) if housing is not None else None
    if winding is not None and clock.aside:
        s.winding = smooth(winding, width)
        s.winding_rise = s.winding - model.reference_temperature
    elif winding is not None:
        s.winding = smooth(winding, width)
        set_motion(record, s, clock.time)
        s.winding_rise = s.winding - model.reference_temperature
        set_joule_heat(record, s)
        heat = s.extra.get("heat")
        if heat is not None and housing is not None and s.ambient is not None and model.thermal is not None:
            # columns must not contain the camera's noise: the left-over side of the equation contains it
            measured = np.stack([winding, housing])
            valid = np.stack([clock.all_valid((f"{name}_temperature", "test")) for name in ("winding", "housing")])
            network_temperatures = fitted_temperatures(model.thermal, clock.interval, heat, s.ambient, measured, valid)
            residual = np.where(valid, measured - network_temperatures, 0.0)
            width = RESIDUAL_SMOOTHING_SHARE * time_constant_samples
            shares = [smooth(values.astype(float), width) for values in valid]
            s.winding, s.housing = network_temperatures + np.stack(
                [
                    smooth(values, width) / np.maximum(share, 1e-6)
                    for values, share in zip(residual, shares, strict=True)
                ]
            )
        s.winding_rise = s.winding - model.reference_temperature
        if clock.fed is not None:
            width = RESIDUAL_SMOOTHING_SHARE * time_constant_samples if time_constant_samples else RESIDUAL_SMOOTHING
            s.extra["fed_rise"] = s.winding_rise + smooth(clock.fed - winding, width)
    s.housing_rise = s.housing - model.reference_temperature if s.housing is not None else None
    return s


def winding_time_constant(model: Model) -> float:
    """Return the time constant [s] of a winding towards its housing; zero without a network."""
    thermal = model.thermal
    return 0.0 if thermal is None else thermal.winding_capacitance * thermal.winding_housing_resistance


def fitted_temperatures(
    thermal: Thermal, interval: float, heat: Array, ambient: Array, measured: Array, valid: Mask
) -> Array:
    """Return winding and housing temperatures [degC] of the network that fits a run best, shape (2, samples)."""
    names = list(Thermal.model_fields)
    nominal = np.array([getattr(thermal, name) for name in names])

    def temperatures_at(point: Array) -> Array:
        factors = np.exp(np.clip(point[2:], -MOST_NETWORK_CHANGE, MOST_NETWORK_CHANGE))
        scaled_network = Thermal(**dict(zip(names, (nominal * factors).tolist(), strict=True)))
        return ThermalNetwork(scaled_network, interval).temperatures(heat, ambient, (float(point[0]), float(point[1])))

    def residual(point: Array) -> Array:
        return np.concatenate([(temperatures_at(point) - measured)[valid], NETWORK_PRIOR * point[2:]])

    start_point = np.concatenate([measured[:, 0], np.zeros(len(names))])
    return temperatures_at(
        least_squares(residual, start_point, method="lm", max_nfev=MOST_NETWORK_ROUNDS * (len(start_point) + 1)).x
    )


def set_motion(record: Record, s: Signals, stamps: Array) -> None:
    """Set the mean and the mean square of the current, and the root mean square of the speed, of each slow interval."""
    if record.slow is not None and record.slow.driven:
        s.extra |= {name: values for name, values in record.slow.driven.items() if name.startswith("current")}
        if (speed_squared := record.slow.driven.get("speed_squared")) is not None:
            s.velocity = np.sqrt(speed_squared)
        return
    if record.fast is None:
        return
    current, angle = record.fast.get("q_axis_current"), record.fast.get("angle")
    if current is not None:
        s.extra["current_squared"] = means_after_edges(record.fast.time, current**2, stamps)
        s.extra["current_mean"] = means_after_edges(record.fast.time, current, stamps)
    if angle is not None:
        speed = smooth(speeds(angle, record.fast.interval))
        s.velocity = np.sqrt(means_after_edges(record.fast.time, speed**2, stamps))


def set_joule_heat(record: Record, s: Signals) -> None:
    """Set the Joule heat of the winding [W] from the supply of the heated leads, else from the drive's current.

    For a drive the derivative by an offset of the current is set, too [W/A].
    """
    model = s.model
    if s.line_current is not None:
        line_voltage = record.slow.get("line_voltage") if record.slow is not None else None
        if line_voltage is not None:
            s.extra["heat"] = line_voltage * s.line_current
        return
    current_squared = s.extra.get("current_squared")
    if current_squared is not None and model.phase_resistance is not None and s.winding_rise is not None:
        resistance = model.phase_resistance * (1 + model.resistance_coefficient * s.winding_rise)
        s.extra["heat"] = current_squared * resistance
        s.extra["heat_per_ampere"] = 2.0 * s.extra["current_mean"] * resistance


def means_after_edges(time: Array, values: Array, edges: Array) -> Array:
    """Return the mean of the values in the interval that begins at each edge; an interpolated value if it has none."""
    running_sum = np.concatenate([[0.0], np.cumsum(values)])
    first_samples = np.searchsorted(time, np.append(edges, 2 * edges[-1] - edges[-2]))
    count = np.diff(first_samples)
    sums = np.diff(running_sum[first_samples])
    return np.where(count > 0, sums / np.maximum(count, 1), np.interp(edges, time, values))
