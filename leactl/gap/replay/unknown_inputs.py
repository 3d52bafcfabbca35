"""Find the samples where a replay is unknown: its input was not measured there but interpolated."""

from collections.abc import Iterator

import numpy as np

from leactl.gap.replay.cutting import logged_torque
from leactl.gap.replay.job import Job
from leactl.gap.signals.record import INTERPOLATION_REACH, Key, Mask, median_interval, near_stamps
from leactl.gap.signals.rig import voltage_feed

MOST_LISTED_STRETCHES = 5  # stretches of a channel without data that a note lists


def unmeasured_samples(job: Job, key: Key) -> Mask:
    """Return the samples at which a channel is interpolated over more than the usual reach."""
    if key not in job.clock.between:
        return np.zeros(len(job.clock.time), bool)
    stamps = job.clock.between[key][0]
    return ~near_stamps(job.clock.time, stamps, INTERPOLATION_REACH * max(median_interval(stamps), job.clock.interval))


def driving_channels(job: Job) -> Iterator[tuple[Key, Mask]]:
    """Yield each channel that drives a replay, with the samples at which it is unmeasured."""
    clock = job.clock
    if job.by_servo:
        keys = [("angle_reference", "test")]
    elif voltage_feed(job.record, job.plant.model) is not None:
        keys = [("q_axis_voltage", "test")]
    elif job.current is not None:
        keys = [("q_axis_current_reference", "test"), ("q_axis_current", "test")]
    else:
        quantity = "torque_reference" if clock.get("torque_reference") is not None else "torque"
        keys = [(quantity, "test")] if logged_torque(job) is not None else []
    present = [key for key in keys if key in clock.values]
    if len(present) > 1:  # where the drive follows no reference, the measured current drives the replay
        reference, current = present
        yield reference, unmeasured_samples(job, reference) & unmeasured_samples(job, current)
    elif present:
        yield present[0], unmeasured_samples(job, present[0])
    if job.record.mechanical == "coupled":
        yield ("q_axis_current", "load"), unmeasured_samples(job, ("q_axis_current", "load"))


def unknown_samples(job: Job) -> tuple[Mask, list[str]]:
    """Return the samples at which a replay is unknown, and a note for each channel that is missing there.

    A motion that restarts is unknown from such a sample until its next start, and after a start that was not measured.
    """
    clock = job.clock
    unknown = np.zeros(len(clock.time), bool)
    notes: list[str] = []
    for (quantity, role), is_missing in driving_channels(job):
        if is_missing.any():
            unknown |= is_missing
            notes.append(f"{job.record.path.name}: {quantity} of {role} is missing {interval_text(job, is_missing)}")
    if job.restarts and job.starts is not None:
        motion_quantity = "angle" if clock.get("angle") is not None else "velocity"
        unmeasured_motion = unmeasured_samples(job, (motion_quantity, "test"))
        if unmeasured_motion[job.starts[job.starts < len(unmeasured_motion)]].any():
            notes.append(
                f"{job.record.path.name}: {motion_quantity} of test is missing {interval_text(job, unmeasured_motion)}"
            )
        for start, stop in zip(job.starts, [*job.starts[1:], len(unknown)], strict=True):
            unknown_in_stretch = unknown[start:stop]
            if unmeasured_motion[start:stop][:1].any():
                unknown_in_stretch[:] = True
            elif unknown_in_stretch.any():
                unknown_in_stretch[int(np.argmax(unknown_in_stretch)) :] = True
    return unknown, [f"{note}; what the model makes is NaN there, until the motion starts again" for note in notes]


def interval_text(job: Job, is_missing: Mask) -> str:
    """Return the time intervals [s] of some samples as text."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_missing.astype(np.intp), [0]]))).reshape(-1, 2)
    time = job.clock.time
    interval_texts = [
        f"from {time[begin]:.6g} to {time[end - 1]:.6g} s" for begin, end in edges[:MOST_LISTED_STRETCHES]
    ]
    return ", ".join(interval_texts) + (
        f" and in {len(edges) - MOST_LISTED_STRETCHES} more stretches" if len(edges) > MOST_LISTED_STRETCHES else ""
    )
