"""Channel readings of a replayed run: averages, filters, and the sensor errors of effects."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from leactl.effects.plant import Array, Becomes, Course
from leactl.gap.replay.drive import interpolate_steps, means_over_samples, undriven_samples
from leactl.gap.replay.heat import resistance_share
from leactl.gap.replay.job import Job
from leactl.gap.replay.time_steps import FILTER_MEMORY, samples
from leactl.gap.signals.smoothing import smooth, speeds
from leactl.gap.signals.stamps import restamped

# by channel: the equation that determines its stamps
STAMP_EQUATIONS = {"velocity": "velocity", "torque": "torque_channel", "q_axis_voltage": "voltage"}


def write_readings(job: Job) -> None:
    """Write the readings of the fast clock's channels that the run has and the replay determines."""
    clock = job.clock
    step_count = (len(clock.time) - 1) * job.parts
    if job.current is not None and job.current_mean is not None:
        # a servo's current may extend beyond the run
        job.current, job.current_mean = job.current[: step_count + 1], job.current_mean[:step_count]
    readings: dict[str, Array | None] = {}
    if clock.get("q_axis_current_reference") is not None or job.clock.get("angle_reference") is not None:
        # without the loop's bandwidth the model cannot predict how a current follows its reference
        has_loop = job.plant.model.bench.current_loop_bandwidth is not None or job.plant.model.drive is not None
        current_reading = replayed_current(job) if has_loop else None
        if current_reading is not None:  # without a reference the measured current is an input
            current_reading = np.where(undriven_samples(job), np.nan, current_reading)
        readings["q_axis_current"] = current_reading
    if job.velocity is not None:
        readings["velocity"] = replayed_velocity(job) if clock.get("velocity") is not None else derived_speed(job)
        readings["torque"] = replayed_torque(job) if job.record.mechanical in ("locked", "coupled") else None
        readings["angle"] = replayed_angle(job) if not job.restarts and job.record.mechanical != "locked" else None
    drive_voltage = replayed_voltage(job)
    readings["q_axis_voltage"] = drive_voltage
    for name, values in readings.items():
        if values is not None and (clock.get(name) is not None or name == "velocity"):
            job.fast[name, "test"] = restamped(values, clock.lateness.get(STAMP_EQUATIONS.get(name, ""), 0.0))
    if (
        drive_voltage is not None
        and clock.get("bus_voltage", "bench") is not None
        and job.plant.model.bench.bus_voltage
    ):
        job.fast["bus_voltage", "bench"] = replayed_bus_voltage(job, drive_voltage)
    turns_load = job.record.mechanical == "coupled"  # in other set-ups no replay includes the load actuator
    if turns_load and job.load_velocity is not None and clock.get("velocity", "load") is not None:
        job.fast["velocity", "load"] = filtered_speed(job, job.load_velocity)
    for values in job.fast.values():
        values[: job.first + 1] = np.nan


def replayed_current(job: Job) -> Array | None:
    """Return the current reading [A] at the samples, as instants or means; None where the replay has no current."""
    if job.current is None or job.current_mean is None:
        return None
    if ("q_axis_current", "test") in job.clock.means:
        winding_current = means_over_samples(job.current_mean, job.parts)
    else:
        winding_current = job.current[:: job.parts]
    return job.plant.current_gain * winding_current + job.plant.current_offset


def replayed_velocity(job: Job) -> Array:
    """Return the velocity reading [rad/s]: encoder differences through the drive's filter."""
    return filtered_speed(job, encoder_speed(job), job.plant.velocity_reading)


def derived_speed(job: Job) -> Array:
    """Return the smoothed rate of the encoder's angle [rad/s], for runs that record no velocity."""
    return smooth(means_over_samples(encoder_speed(job)[: (len(job.clock.time) - 1) * job.parts], job.parts))


def encoder_speed(job: Job) -> Array:
    """Return the rate of the encoder's angle [rad/s] over each sub-step: the rotor's speed with the encoder's error."""
    assert job.velocity is not None and job.angle is not None
    speed = job.velocity
    for error in job.plant.angle_error:
        speed = speed + (error(job.angle + job.step * job.velocity) - error(job.angle)) / job.step
    return speed


def filtered_speed(job: Job, speed_of_steps: Array, sensor_errors: Sequence[Becomes] = ()) -> Array:
    """Return a speed [rad/s] at the samples after the sensor's errors and the model's velocity filter.

    speed_of_steps : speed over each sub-step.
    sensor_errors : changes of the speed by the sensor, applied in turn before the filter.
    """
    step_count = (len(job.clock.time) - 1) * job.parts
    bandwidth = job.plant.model.bench.velocity_filter_bandwidth

    def filtered(values: Array) -> Array:
        """Return a speed after the errors and the filter, which starts in equilibrium."""
        for transform in sensor_errors:
            values = transform(values, job.step)
        if bandwidth:
            decay = float(np.exp(-2.0 * np.pi * bandwidth * job.step))
            values = lfilter([1.0 - decay], [1.0, -decay], values, zi=[decay * values[0]])[0]
        return values

    steps = speed_of_steps[:step_count]
    steps = _filtered_from_starts(job, steps, filtered) if job.restarts else filtered(steps)
    return np.concatenate([steps[:1], steps[job.parts - 1 :: job.parts]])


def _filtered_from_starts(job: Job, steps: Array, filter_speed: Callable[[Array], Array]) -> Array:
    """Return a speed filtered stretch by stretch, each from the filter state of the measured motion before it."""
    assert job.starts is not None
    measured_steps = np.repeat(measured_speed(job)[1:], job.parts)
    memory = samples(FILTER_MEMORY, job.plant.model.bench, job.clock.interval) * job.parts
    filtered_steps = np.zeros_like(steps)
    edges = [*(int(start) * job.parts for start in job.starts), len(steps)]
    for begin, end in pairwise(edges):
        if begin < end:
            history = measured_steps[max(0, begin - memory) : begin]
            filtered_steps[begin:end] = filter_speed(np.concatenate([history, steps[begin:end]]))[len(history) :]
    return filtered_steps


def measured_speed(job: Job) -> Array:
    """Return the measured speed [rad/s]: from the encoder, else from the velocity channel."""
    angles, clock = job.clock.get("angle"), job.clock
    if angles is None:
        return clock.values["velocity", "test"]
    return smooth(speeds(angles, clock.interval))


def replayed_angle(job: Job) -> Array:
    """Return the encoder's reading of the angle [rad] at the samples."""
    assert job.angle is not None
    reading = job.angle[:: job.parts][: len(job.clock.time)]
    for error in job.plant.angle_error:
        reading = reading + error(reading)
    return np.asarray(reading, np.float64)


def replayed_torque(job: Job) -> Array:
    """Return the torque channel [N*m]: the sensor's reading of the shaft's torque after the channel's filter."""
    assert job.torque is not None and job.angle is not None
    instant_count = (len(job.clock.time) - 1) * job.parts + 1
    reading: Array = job.torque[:instant_count]
    if job.plant.torque_reading:
        time = job.clock.since_begin[0] + np.arange(instant_count, dtype=np.float64) * job.step
        housing = interpolate_steps(job.course().housing, job.parts)
        course = Course(time, job.step, job.angle[:instant_count], housing)
        for reading_of in job.plant.torque_reading:
            reading = reading_of(course, reading)
    bandwidth = job.plant.model.bench.torque_filter_bandwidth
    if bandwidth:
        decay = float(np.exp(-2.0 * np.pi * bandwidth * job.step))
        step_means = 0.5 * (reading[1:] + reading[:-1])
        filtered = lfilter([1.0 - decay], [1.0, -decay], step_means, zi=[decay * reading[0]])[0]
        reading = np.concatenate([reading[:1], filtered])
    return np.asarray(reading[:: job.parts], np.float64)


def replayed_voltage(job: Job) -> Array | None:
    """Return the drive's voltage [V] with resistance, inductance, back-EMF and inverter loss; None where unknown."""
    model = job.plant.model
    if job.current is None or job.current_mean is None or model.phase_resistance is None:
        return None
    if job.velocity is None and job.record.mechanical != "locked":
        return None
    sample_count, parts = len(job.clock.time), job.parts
    step_count = (sample_count - 1) * parts
    speed = job.velocity[:step_count] if job.velocity is not None else np.zeros(step_count)
    emf_constant = np.full(sample_count, model.back_emf_constant or model.torque_constant or 0.0)
    course = job.course()
    for magnet_share in job.plant.magnet_share:
        emf_constant = emf_constant * magnet_share(course)
    resistance = model.phase_resistance * resistance_share(job, job.winding)
    lost_voltage = np.zeros(step_count)
    for loss_at in job.plant.lost_voltage:
        lost_voltage = lost_voltage + loss_at(job.current_mean)
    inductance = model.phase_inductance or 0.0
    if ("q_axis_voltage", "test") in job.clock.means:
        winding_current, rotor_speed = means_over_samples(job.current_mean, parts), means_over_samples(speed, parts)
        current_rate = np.diff(job.current[::parts], prepend=job.current[0]) / job.clock.interval
        return (
            resistance * winding_current
            + inductance * current_rate
            + emf_constant * rotor_speed
            + means_over_samples(lost_voltage, parts)
        )
    winding_current = job.current[::parts]
    current_rate = np.gradient(job.current, job.step)[::parts]
    rotor_speed = np.concatenate([speed[:1], 0.5 * (speed + np.append(speed[1:], speed[-1]))[parts - 1 :: parts]])
    loss_at_samples = np.concatenate([lost_voltage[:1], lost_voltage[parts - 1 :: parts]])
    return np.asarray(
        resistance * winding_current + inductance * current_rate + emf_constant * rotor_speed + loss_at_samples,
        np.float64,
    )


def replayed_bus_voltage(job: Job, drive_voltage: Array) -> Array:
    """Return the bus voltage [V] under the power of the test drive: U = U0 - r P / U."""
    idle_voltage, resistance = job.plant.model.bench.bus_voltage or 0.0, job.plant.bus_resistance
    if not resistance or job.current_mean is None:
        return np.full(len(drive_voltage), idle_voltage)
    power = drive_voltage * means_over_samples(job.current_mean, job.parts)
    discriminant = np.maximum(idle_voltage**2 - 4.0 * resistance * power, 0.0)
    return np.asarray(0.5 * (idle_voltage + np.sqrt(discriminant)), np.float64)
