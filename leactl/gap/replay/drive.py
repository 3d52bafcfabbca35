"""Current of the test drive: what its loop makes of the reference, else what was measured."""

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from leactl.gap.replay.bench_times import LATEST, samples
from leactl.gap.replay.job import Job
from leactl.gap.signals.derived import led, moved_by_a_servo
from leactl.gap.signals.noise import noise_of, quantum_of
from leactl.gap.signals.smoothing import smooth
from leactl.gap.signals.stamps import restamped
from leactl.gap.signals.voltage_ceiling import at_ceiling

Array = npt.NDArray[np.float64]
BUSIEST = 2000  # samples that tell how a reference moves
STANDS_S = 1.0  # how long a rounding error may stay the same
RECOVERS = 12  # samples around the ceiling in which the loop is still on its way back


def follow(job: Job) -> None:
    """Work out the current of the whole run; the loop knows nothing of the motion, so it never starts again."""
    clock, plant = job.clock, job.plant
    bandwidth = plant.model.bench.current_loop_bandwidth
    if clock.get("q_axis_current_reference") is not None:
        over = asked(job) + rounding(job)
        if not moved_by_a_servo(clock):
            over = led(over, plant.model.bench, job.step)
        flows = clock.get("q_axis_current")
        before = over[:1] if flows is None else flows[:1]  # a run may begin while its drive is on the way
        for becomes in plant.command:
            over = becomes(np.concatenate([before, over]), job.step)[1:]
        if plant.command_at_speed and (speed := speed_over_steps(job)) is not None:
            for becomes_at in plant.command_at_speed:
                over = becomes_at(over, speed)
        reading, mean = answered(over, over[0], bandwidth, job.step)
        for becomes in plant.loop_answer:
            reading, mean = becomes(reading, job.step), becomes(mean, job.step)
        late = clock.stamping.get("current")
        reading, mean = restamped(reading, late, job.parts), restamped(mean, late, job.parts)
        reading, mean = where_measured(job, reading, mean)
    else:
        flowing = measured(job, "test")
        if flowing is None:
            return
        reading, mean = flowing
    enabled = clock.get("drive_enabled")
    on = spread(np.round(enabled), job.parts) if enabled is not None else np.ones_like(reading)
    job.current = on * (reading - plant.current_offset) / plant.current_gain
    job.current_mean = on[1:] * (mean - plant.current_offset) / plant.current_gain


def speed_over_steps(job: Job) -> Array | None:
    """The measured speed over each sub-step [rad/s]; None where the run has none."""
    clock = job.clock
    angle, speed = clock.get("angle"), clock.get("velocity")
    if angle is not None:
        speed = smooth(np.gradient(angle, clock.interval))
    return None if speed is None else spread(speed, job.parts)[1:]


def where_measured(job: Job, reading: Array, mean: Array) -> tuple[Array, Array]:
    """The measured current where the drive follows no current reference, or its voltage is too low to follow one."""
    unasked = job.clock.unasked("q_axis_current_reference")
    flowing, beyond = measured(job, "test"), at_ceiling(job.clock, job.plant.model) & ~unasked
    if flowing is None or not (beyond | unasked).any():
        return reading, mean
    job.at_ceiling = int(beyond.sum())
    near = unasked | (np.convolve(beyond, np.ones(2 * RECOVERS + 1), "same") > 0)
    steps = np.repeat(near[1:], job.parts)
    instants = np.concatenate([steps[:1], steps])
    return np.where(instants, flowing[0], reading), np.where(steps, flowing[1], mean)


def asked(job: Job) -> Array:
    """The reference over each sub-step: held from sample to sample, or on its way between two where a servo moves it.

    A servo inside the drive may move its current reference between samples: where its own target steps, the current
    reference jumps by its gain times the step and then goes to the next sample. That gain shows in the record, and the
    measured current shows whether the drive does so.
    """
    clock, parts = job.clock, job.parts
    reference = clock.values["q_axis_current_reference", "test"]
    held = np.repeat(reference[1:], parts)
    ways = [held]
    for name in ("velocity", "angle"):
        target, actual = clock.get(f"{name}_reference"), clock.get(name)
        if target is not None and actual is not None:
            moved = np.stack([np.diff(target), np.diff(actual), (target - actual)[1:]], axis=1)
            gain = float(np.linalg.lstsq(moved, np.diff(reference), rcond=None)[0][0])
            begins = reference[:-1] + gain * moved[:, 0]
            way = (np.arange(parts) + 0.5) / parts
            ways.append((begins[:, None] + (reference[1:] - begins)[:, None] * way).reshape(-1))
    if ("q_axis_current", "test") in clock.unstamped:
        return held  # what a straight line adds is among what its stamps may be
    if len(ways) == 1 or clock.get("q_axis_current") is None:
        return ways[-1]
    return min(ways, key=lambda over: misfit(job, over))


def misfit(job: Job, over: Array) -> float:
    """Squares that a loop's answer leaves of the measured current where its reference moves most, at its best delay."""
    clock, parts = job.clock, job.parts
    flowing, reference = (clock.values[name, "test"] for name in ("q_axis_current", "q_axis_current_reference"))
    _, mean = answered(over, over[0], job.plant.model.bench.current_loop_bandwidth, job.step)
    total = np.concatenate([[0.0], np.cumsum(mean)])
    delays = np.arange(samples(LATEST, job.plant.model.bench, clock.interval) * parts)
    first = -(-len(delays) // parts) + 1
    busiest = first + np.argsort(-np.abs(np.diff(reference)[first - 1 :]))[:BUSIEST]
    ends = busiest[:, None] * parts - delays
    left = flowing[busiest, None] - (total[ends] - total[ends - parts]) / parts
    return float(np.min(np.sum(left**2, axis=0)))


def rounding(job: Job) -> Array | float:
    """Once more what rounding took from the recorded reference of a servo, which may stand still for seconds.

    Without the servo, a rotor whose friction falls with speed runs away from the least of it.
    """
    if job.disturbance is None or not moved_by_a_servo(job.clock):
        return 0.0
    step = quantum_of(job.clock.values["q_axis_current_reference", "test"])
    stands = max(1, round(STANDS_S / job.step))
    total = (len(job.clock.time) - 1) * job.parts
    taken = step * (job.disturbance.random(total // stands + 1) - 0.5)
    return np.asarray(np.repeat(taken, stands)[:total], np.float64)


def answered(over: Array, start: float, bandwidth: float | None, step: float) -> tuple[Array, Array]:
    """A first-order loop's answer to what it follows over each sub-step: at the instants, and as means between."""
    if not bandwidth:
        return np.concatenate([over[:1], over]), over
    constant = 1.0 / (2.0 * np.pi * bandwidth)
    decay = float(np.exp(-step / constant))
    answer = lfilter([1.0 - decay], [1.0, -decay], over, zi=[decay * start])[0]
    instants = np.concatenate([[start], answer])
    return instants, over - constant * np.diff(instants) / step


def measured(job: Job, role: str) -> tuple[Array, Array] | None:
    """A measured current at the instants and as means between; a loop is taken to have led from sample to sample."""
    values = job.clock.get("q_axis_current", role)
    if values is None:
        return None
    if job.disturbance is not None:
        values = values + noise_of(values) * job.disturbance.standard_normal(len(values))
    bandwidth = job.plant.model.bench.current_loop_bandwidth
    if ("q_axis_current", role) in job.clock.means:
        over = np.repeat(values[1:], job.parts)
        return np.concatenate([over[:1], over]), over
    if not bandwidth:
        instants = spread(values, job.parts)
        return instants, 0.5 * (instants[1:] + instants[:-1])
    decay = float(np.exp(-2.0 * np.pi * bandwidth * job.clock.interval))
    held = (values[1:] - decay * values[:-1]) / (1.0 - decay)
    return answered(np.repeat(held, job.parts), float(values[0]), bandwidth, job.step)


def spread(values: Array, parts: int) -> Array:
    """Samples at the instants of the sub-steps, linear in between."""
    at = np.arange((len(values) - 1) * parts + 1) / parts
    return np.interp(at, np.arange(len(values)), values)


def over_samples(means: Array, parts: int) -> Array:
    """Means over sub-steps as means over the interval that ends at each sample."""
    over = means.reshape(-1, parts).mean(axis=1)
    return np.concatenate([over[:1], over])
