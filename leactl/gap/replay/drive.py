"""Current of the test drive: the loop's response to the reference, else the measured current."""

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from leactl.gap.replay.job import Job
from leactl.gap.replay.time_steps import MOST_DELAY, samples
from leactl.gap.signals.derived import moved_by_a_servo, with_setpoint_lead
from leactl.gap.signals.noise import noise_of, quantum_of
from leactl.gap.signals.smoothing import smooth
from leactl.gap.signals.stamps import restamped
from leactl.gap.signals.voltage_ceiling import at_ceiling

Array = npt.NDArray[np.float64]
BUSIEST_SAMPLES = 2000  # number of samples with the largest changes, which show how a reference moves in between
ROUNDING_HOLD_S = 1.0  # s, longest time for which a rounding error stays the same
RECOVERY_SAMPLES = 12  # samples around the voltage ceiling in which the loop still recovers


def compute_current(job: Job) -> None:
    """Compute the current of the whole run; it does not depend on the motion, so it never restarts."""
    clock, plant = job.clock, job.plant
    bandwidth = plant.model.bench.current_loop_bandwidth
    if clock.get("q_axis_current_reference") is not None:
        reference = reference_between_samples(job) + draw_rounding_error(job)
        if not moved_by_a_servo(clock):
            reference = with_setpoint_lead(reference, plant.model.bench, job.step)
        measured_current = clock.get("q_axis_current")
        # a run may begin during a transient
        begin = reference[:1] if measured_current is None else measured_current[:1]
        for becomes in plant.command:
            reference = becomes(np.concatenate([begin, reference]), job.step)[1:]
        if plant.command_at_speed and (speed := speed_over_steps(job)) is not None:
            for becomes_at in plant.command_at_speed:
                reference = becomes_at(reference, speed)
        reading, mean = response_over_steps(reference, reference[0], bandwidth, job.step)
        for becomes in plant.loop_answer:
            reading, mean = becomes(reading, job.step), becomes(mean, job.step)
        stamp_weights = clock.stamping.get("current")
        reading, mean = restamped(reading, stamp_weights, job.parts), restamped(mean, stamp_weights, job.parts)
        reading, mean = with_measured_current(job, reading, mean)
    else:
        flowing = measured_over_steps(job, "test")
        if flowing is None:
            return
        reading, mean = flowing
    enabled = clock.get("drive_enabled")
    enabled_share = interpolate_steps(np.round(enabled), job.parts) if enabled is not None else np.ones_like(reading)
    job.current = enabled_share * (reading - plant.current_offset) / plant.current_gain
    job.current_mean = enabled_share[1:] * (mean - plant.current_offset) / plant.current_gain


def speed_over_steps(job: Job) -> Array | None:
    """Return the measured speed over each sub-step [rad/s]; None where the run has none."""
    clock = job.clock
    angle, speed = clock.get("angle"), clock.get("velocity")
    if angle is not None:
        speed = smooth(np.gradient(angle, clock.interval))
    return None if speed is None else interpolate_steps(speed, job.parts)[1:]


def with_measured_current(job: Job, reading: Array, mean: Array) -> tuple[Array, Array]:
    """Replace the current by the measured one where the drive has no reference, or is at its voltage ceiling."""
    unreferenced = job.clock.samples_without_reference("q_axis_current_reference")
    flowing, at_limit = measured_over_steps(job, "test"), at_ceiling(job.clock, job.plant.model) & ~unreferenced
    if flowing is None or not (at_limit | unreferenced).any():
        return reading, mean
    job.at_ceiling = int(at_limit.sum())
    use_measured = unreferenced | (np.convolve(at_limit, np.ones(2 * RECOVERY_SAMPLES + 1), "same") > 0)
    steps = np.repeat(use_measured[1:], job.parts)
    instants = np.concatenate([steps[:1], steps])
    return np.where(instants, flowing[0], reading), np.where(steps, flowing[1], mean)


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
            moved = np.stack([np.diff(target), np.diff(actual), (target - actual)[1:]], axis=1)
            gain = float(np.linalg.lstsq(moved, np.diff(reference), rcond=None)[0][0])
            begins = reference[:-1] + gain * moved[:, 0]
            elapsed_share = (np.arange(parts) + 0.5) / parts
            candidates.append((begins[:, None] + (reference[1:] - begins)[:, None] * elapsed_share).reshape(-1))
    if ("q_axis_current", "test") in clock.unstamped:
        return held_reference  # fitted weights of stamps of unknown meaning can represent a ramp
    if len(candidates) == 1 or clock.get("q_axis_current") is None:
        return candidates[-1]
    return min(candidates, key=lambda candidate: misfit(job, candidate))


def misfit(job: Job, reference_over_steps: Array) -> float:
    """Return the squared residual of the loop's response at its best delay, where the reference changes most."""
    clock, parts = job.clock, job.parts
    flowing, reference = (clock.values[name, "test"] for name in ("q_axis_current", "q_axis_current_reference"))
    _, mean = response_over_steps(
        reference_over_steps, reference_over_steps[0], job.plant.model.bench.current_loop_bandwidth, job.step
    )
    total = np.concatenate([[0.0], np.cumsum(mean)])
    delays = np.arange(samples(MOST_DELAY, job.plant.model.bench, clock.interval) * parts)
    begin = -(-len(delays) // parts) + 1
    busiest = begin + np.argsort(-np.abs(np.diff(reference)[begin - 1 :]))[:BUSIEST_SAMPLES]
    ends = busiest[:, None] * parts - delays
    residual = flowing[busiest, None] - (total[ends] - total[ends - parts]) / parts
    return float(np.min(np.sum(residual**2, axis=0)))


def draw_rounding_error(job: Job) -> Array | float:
    """Return a random rounding error for the recorded reference of a servo; zero in an undisturbed replay.

    A reference may be constant for seconds. Without the servo, a rotor whose friction falls with speed runs away from
    the smallest error.
    """
    if job.disturbance is None or not moved_by_a_servo(job.clock):
        return 0.0
    step = quantum_of(job.clock.values["q_axis_current_reference", "test"])
    steps_at_rest = max(1, round(ROUNDING_HOLD_S / job.step))
    total = (len(job.clock.time) - 1) * job.parts
    rounding_error = step * (job.disturbance.random(total // steps_at_rest + 1) - 0.5)
    return np.asarray(np.repeat(rounding_error, steps_at_rest)[:total], np.float64)


def response_over_steps(reference: Array, start: float, bandwidth: float | None, step: float) -> tuple[Array, Array]:
    """Return a first-order loop's response to a reference over each sub-step: at the instants, and as means between."""
    if not bandwidth:
        return np.concatenate([reference[:1], reference]), reference
    constant = 1.0 / (2.0 * np.pi * bandwidth)
    decay = float(np.exp(-step / constant))
    answer = lfilter([1.0 - decay], [1.0, -decay], reference, zi=[decay * start])[0]
    instants = np.concatenate([[start], answer])
    return instants, reference - constant * np.diff(instants) / step


def measured_over_steps(job: Job, role: str) -> tuple[Array, Array] | None:
    """Return a measured current at the instants and as means between, interpolated by the loop's response."""
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
    """Interpolate samples linearly at the instants of the sub-steps."""
    positions = np.arange((len(values) - 1) * parts + 1) / parts
    return np.interp(positions, np.arange(len(values)), values)


def means_over_samples(means: Array, parts: int) -> Array:
    """Average means over sub-steps to means over the interval that ends at each sample."""
    sample_means = means.reshape(-1, parts).mean(axis=1)
    return np.concatenate([sample_means[:1], sample_means])
