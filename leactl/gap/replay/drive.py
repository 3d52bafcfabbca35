"""Current of the test drive: the loop's response to the reference, else the measured current."""

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from leactl.gap.replay.job import Job
from leactl.gap.replay.time_steps import MOST_DELAY, samples
from leactl.gap.signals.derived import moved_by_a_servo, with_setpoint_lead
from leactl.gap.signals.noise import noise_of, quantum_of
from leactl.gap.signals.setpoints import unknown_setpoints
from leactl.gap.signals.smoothing import smooth
from leactl.gap.signals.stamps import restamped
from leactl.gap.signals.voltage_ceiling import at_ceiling

Array = npt.NDArray[np.float64]
BUSIEST_SAMPLES = 2000  # number of samples with the largest changes, which show how a reference moves between samples
ROUNDING_HOLD_S = 1.0  # s, time for which a rounding error stays the same
RECOVERY_SAMPLES = 12  # samples on either side of the voltage ceiling in which the loop still recovers


def compute_current(job: Job) -> None:
    """Write the current of the whole run, if it has one, into the job; no replayed motion or restart changes it."""
    clock, plant = job.clock, job.plant
    bandwidth = plant.model.bench.current_loop_bandwidth
    if clock.get("q_axis_current_reference") is not None:
        reference = reference_between_samples(job) + draw_rounding_error(job)
        if not moved_by_a_servo(clock):
            reference = with_setpoint_lead(reference, plant.model.bench, job.step)
        measured_current = clock.get("q_axis_current")
        # a run may begin during a transient
        initial_value = reference[:1] if measured_current is None else measured_current[:1]
        for transform in plant.command:
            reference = transform(np.concatenate([initial_value, reference]), job.step)[1:]
        if plant.command_at_speed and (speed := speed_over_steps(job)) is not None:
            for transform_at_speed in plant.command_at_speed:
                reference = transform_at_speed(reference, speed)
        reading, mean = response_over_steps(reference, reference[0], bandwidth, job.step)
        for transform in plant.loop_answer:
            reading, mean = transform(reading, job.step), transform(mean, job.step)
        lateness = clock.lateness.get("current", 0.0)
        reading, mean = restamped(reading, lateness, job.parts), restamped(mean, lateness, job.parts)
        reading, mean = with_measured_current(job, reading, mean)
    else:
        measured_over_run = measured_over_steps(job, "test")
        if measured_over_run is None:
            return
        reading, mean = measured_over_run
    enabled = clock.get("drive_enabled")
    enabled_share = interpolate_steps(np.round(enabled), job.parts) if enabled is not None else np.ones_like(reading)
    job.current = enabled_share * (reading - plant.current_offset) / plant.current_gain
    job.current_mean = enabled_share[1:] * (mean - plant.current_offset) / plant.current_gain


def speed_over_steps(job: Job) -> Array | None:
    """Return the measured speed over each sub-step [rad/s]; None where the run has neither angle nor velocity."""
    clock = job.clock
    angle, speed = clock.get("angle"), clock.get("velocity")
    if angle is not None:
        speed = smooth(np.gradient(angle, clock.interval))
    return None if speed is None else interpolate_steps(speed, job.parts)[1:]


def with_measured_current(job: Job, reading: Array, mean: Array) -> tuple[Array, Array]:
    """Return the current [A], measured where no known reference drives it or the drive is at its voltage ceiling.

    The samples at the ceiling are counted in the job.

    reading : current at the instants of the sub-steps.
    mean : current over each sub-step.
    """
    unreferenced = undriven_samples(job)
    measured, is_at_ceiling = measured_over_steps(job, "test"), at_ceiling(job.clock, job.plant.model) & ~unreferenced
    if measured is None or not (is_at_ceiling | unreferenced).any():
        return reading, mean
    job.at_ceiling = int(is_at_ceiling.sum())
    use_measured = unreferenced | (np.convolve(is_at_ceiling, np.ones(2 * RECOVERY_SAMPLES + 1), "same") > 0)
    measured_at_instants, measured_means = measured
    use_over_steps = np.repeat(use_measured[1:], job.parts)
    use_at_instants = np.concatenate([use_over_steps[:1], use_over_steps])
    return np.where(use_at_instants, measured_at_instants, reading), np.where(use_over_steps, measured_means, mean)


def undriven_samples(job: Job) -> npt.NDArray[np.bool_]:
    """Return the samples whose current follows no known setpoint: without a reference, or after one between rows."""
    return job.clock.samples_without_reference("q_axis_current_reference") | unknown_setpoints(
        job.clock, job.plant.model
    )


def reference_between_samples(job: Job) -> Array:
    """Return the reference over each sub-step: held between samples, or ramped where a servo moves it.

    A servo inside the drive may change its current reference between samples: where its own target steps, the current
    reference jumps by the servo's gain times the step and then ramps to the next sample. The gain is fitted to the
    record, and the measured current decides whether the drive does so.
    """
    clock, parts = job.clock, job.parts
    reference = clock.values["q_axis_current_reference", "test"]
    held_reference = np.repeat(reference[1:], parts)
    candidates = [held_reference]
    for name in ("velocity", "angle"):
        target, actual = clock.get(f"{name}_reference"), clock.get(name)
        if target is not None and actual is not None:
            motion_changes = np.stack([np.diff(target), np.diff(actual), (target - actual)[1:]], axis=1)
            gain = float(np.linalg.lstsq(motion_changes, np.diff(reference), rcond=None)[0][0])
            values_after_jump = reference[:-1] + gain * motion_changes[:, 0]
            elapsed_share = (np.arange(parts) + 0.5) / parts
            candidates.append(
                (values_after_jump[:, None] + (reference[1:] - values_after_jump)[:, None] * elapsed_share).reshape(-1)
            )
    if ("q_axis_current", "test") in clock.unstamped:
        return held_reference  # the fitted delay of stamps of unknown meaning stands for a ramp's
    if len(candidates) == 1 or clock.get("q_axis_current") is None:
        return candidates[-1]
    return min(candidates, key=lambda candidate: misfit(job, candidate))


def misfit(job: Job, reference_over_steps: Array) -> float:
    """Return the squared residual [A^2] of the loop's response at its best delay, where the reference changes most."""
    clock, parts = job.clock, job.parts
    measured_current, reference = (
        clock.values[name, "test"] for name in ("q_axis_current", "q_axis_current_reference")
    )
    _, mean = response_over_steps(
        reference_over_steps, reference_over_steps[0], job.plant.model.bench.current_loop_bandwidth, job.step
    )
    cumulative_response = np.concatenate([[0.0], np.cumsum(mean)])
    delays = np.arange(samples(MOST_DELAY, job.plant.model.bench, clock.interval) * parts)
    first_sample = -(-len(delays) // parts) + 1
    busiest = first_sample + np.argsort(-np.abs(np.diff(reference)[first_sample - 1 :]))[:BUSIEST_SAMPLES]
    ends = busiest[:, None] * parts - delays
    residual = measured_current[busiest, None] - (cumulative_response[ends] - cumulative_response[ends - parts]) / parts
    return float(np.min(np.sum(residual**2, axis=0)))


def draw_rounding_error(job: Job) -> Array | float:
    """Return a random rounding error [A] of a servo's recorded current reference; zero in an undisturbed replay.

    A reference may be constant for seconds. Without the servo, a rotor whose friction falls with speed runs away from
    the smallest error.
    """
    if job.disturbance is None or not moved_by_a_servo(job.clock):
        return 0.0
    quantum = quantum_of(job.clock.values["q_axis_current_reference", "test"])
    steps_held = max(1, round(ROUNDING_HOLD_S / job.step))
    step_count = (len(job.clock.time) - 1) * job.parts
    rounding_error = quantum * (job.disturbance.random(step_count // steps_held + 1) - 0.5)
    return np.asarray(np.repeat(rounding_error, steps_held)[:step_count], np.float64)


def response_over_steps(
    reference: Array, initial_response: float, bandwidth: float | None, step: float
) -> tuple[Array, Array]:
    """Return a first-order loop's response to a reference over each sub-step: at the instants, and as means between.

    initial_response : response at the first instant.
    bandwidth : of the loop [Hz]; without one the response equals the reference.
    step : length of a sub-step [s].
    """
    if not bandwidth:
        return np.concatenate([reference[:1], reference]), reference
    time_constant = 1.0 / (2.0 * np.pi * bandwidth)
    decay = float(np.exp(-step / time_constant))
    later_instants = lfilter([1.0 - decay], [1.0, -decay], reference, zi=[decay * initial_response])[0]
    instants = np.concatenate([[initial_response], later_instants])
    return instants, reference - time_constant * np.diff(instants) / step


def measured_over_steps(job: Job, role: str) -> tuple[Array, Array] | None:
    """Return a measured current [A] at the instants and as means between, interpolated by the loop's response.

    A disturbed replay adds noise to it. None where the run has no such current.
    """
    values = job.clock.get("q_axis_current", role)
    if values is None:
        return None
    if job.disturbance is not None:
        values = values + noise_of(values) * job.disturbance.standard_normal(len(values))
    bandwidth = job.plant.model.bench.current_loop_bandwidth
    if ("q_axis_current", role) in job.clock.means:
        means = np.repeat(values[1:], job.parts)
        return np.concatenate([means[:1], means]), means
    if not bandwidth:
        instants = interpolate_steps(values, job.parts)
        return instants, 0.5 * (instants[1:] + instants[:-1])
    decay = float(np.exp(-2.0 * np.pi * bandwidth * job.clock.interval))
    equivalent_reference = (values[1:] - decay * values[:-1]) / (1.0 - decay)
    return response_over_steps(np.repeat(equivalent_reference, job.parts), float(values[0]), bandwidth, job.step)


def interpolate_steps(values: Array, parts: int) -> Array:
    """Return samples interpolated linearly at the instants of the sub-steps."""
    positions = np.arange((len(values) - 1) * parts + 1) / parts
    return np.interp(positions, np.arange(len(values)), values)


def means_over_samples(means: Array, parts: int) -> Array:
    """Return means over the interval that ends at each sample, from means over sub-steps."""
    sample_means = means.reshape(-1, parts).mean(axis=1)
    return np.concatenate([sample_means[:1], sample_means])
