"""Motion of whole runs, cut into stretches that are stepped side by side.

A turning rotor restarts every second from its measured state: its angle is an integral and would drift. A locked rotor
does not restart, since friction preserves the state after the last move: all of its stretches are stepped at once, and
those that did not begin in the end state of the previous stretch are stepped again. A tracked rotor is stepped
likewise, since its start loses influence. A position servo runs through without a restart.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from leactl.effects.hysteresis_and_lags import play
from leactl.effects.joint_elasticity import follow_spring
from leactl.effects.plant import Array
from leactl.effects.teeth import follow_loads
from leactl.gap.replay.cutting import (
    CutJob,
    Index,
    constants_of,
    cut_job,
    has_coupled_part,
    lanes_of,
    logged_torque,
    smooth_motion,
    voltage_torque,
)
from leactl.gap.replay.initial_state import starting_motion
from leactl.gap.replay.job import Job
from leactl.gap.replay.lanes import LaneMotion, LaneState, step_lanes

MOST_INTERVAL_RATIO = 0.5  # interval between samples over the time constant of drag, above which no start is measured
MOST_LOCKED_PASSES = 128  # passes of locked rotors; a rotor that never slides keeps its first guess in later stretches
TRACKED_PASSES = 3  # passes of tracked rotors, after which their starts have no influence
MOST_MISMATCH_SHARE = (
    3e-4  # difference of a stretch's start from the previous end, as a share of the largest drive torque
)


def move(jobs: Sequence[Job]) -> None:
    """Write the replayed motion into every job that has the inputs; the others get a note on what is missing."""
    cuts_by_kind: dict[tuple[str, float, int], list[CutJob]] = {}
    for job in jobs:
        kind = stepping_kind(job)
        if kind is not None:
            cuts_by_kind.setdefault((kind, round(job.step, 9), job.parts), []).append(cut_job(job, kind))
    for (kind, _, _), cuts in cuts_by_kind.items():
        # lanes of one bench side by side: its effects then act on all of them in one call
        cuts.sort(key=lambda cut: id(cut.job.plant))
        longest = max(cut.length for cut in cuts)
        for cut in cuts:
            cut.set_length(longest)  # a servo that ends earlier continues at its last reference
        if kind in ("locked", "tracked"):
            step_until_settled(cuts, kind)
        else:
            all_lanes = [np.arange(cut.count) for cut in cuts]
            write_motion(cuts, all_lanes, step_stretches(cuts, all_lanes, [start_of(cut, kind) for cut in cuts]))
        for cut in cuts:
            if kind == "tracked":
                add_tracking_current(cut.job)
            cut.job.restarts = kind == "turning"
            cut.job.starts = cut.first + cut.length * np.arange(cut.count)


def stepping_kind(job: Job) -> str | None:
    """Return how a job is stepped: locked, turning, tracked or servo; None, with a note, where it cannot be."""
    model, name = job.plant.model, job.record.path.name
    if model.transmission is not None:
        job.notes.append(f"{name}: the model's `transmission:` is not simulated; motor and joint turn as one")
    if model.rotor_inertia is None:
        job.notes.append(f"{name}: the model has no rotor_inertia; its motion is not replayed")
        return None
    if job.by_servo:
        if model.phase_resistance is None or model.torque_constant is None:
            job.notes.append(f"{name}: a servo's replay needs phase_resistance and torque_constant")
            return None
        return "servo"
    inertia, damping = model.rotor_inertia or 0.0, model.viscous_damping or 0.0
    if job.clock.interval * damping > MOST_INTERVAL_RATIO * inertia and job.record.mechanical != "locked":
        job.notes.append(f"{name}: {1 / job.clock.interval:.3g} samples a second are too few to replay a motion")
        return None
    driven_by_current = job.current is not None and model.torque_constant is not None
    if not driven_by_current and logged_torque(job) is None and voltage_torque(job) is None:
        job.notes.append(
            f"{name}: a replay needs a current of the test drive and a torque_constant in the model, or its voltage and"
            " phase_resistance or feedforward"
        )
        return None
    plant = job.plant
    if voltage_torque(job) is not None and (plant.torque_share or plant.lost_voltage or plant.magnet_share):
        job.notes.append(f"{name}: a voltage drives its replay; effects that act by the current are left out of it")
    if job.record.mechanical == "locked":
        if job.plant.stiffness is None:
            job.notes.append(f"{name}: the model has no bench.shaft_stiffness; its torque is not replayed")
            return None
        return "locked"
    if job.record.mechanical == "coupled":
        if job.plant.stiffness is None or job.clock.get("q_axis_current", "load") is None:
            job.notes.append(f"{name}: a coupled replay needs bench.shaft_stiffness and the load's current")
            return None
    elif job.record.mechanical != "free":
        return None
    if job.tracked and job.clock.get("angle") is None and job.clock.get("velocity") is None:
        return None  # there is no motion to track
    return "tracked" if job.tracked else "turning"


def add_tracking_current(job: Job) -> None:
    """Add the current for the tracking torque to the current of a tracked rotor."""
    torque_constant = job.plant.model.torque_constant
    if job.current is None or job.current_mean is None or job.pull is None or torque_constant is None:
        return
    extra_current = job.pull[: len(job.current)] / torque_constant
    job.current = job.current + extra_current
    job.current_mean = job.current_mean + 0.5 * (extra_current[1:] + extra_current[:-1])


def start_of(cut: CutJob, kind: str) -> LaneState:
    """Return the state at the beginning of each stretch of a turning or tracked rotor, or a servo."""
    job = cut.job
    samples = cut.first + cut.length * np.arange(cut.count)
    if cut.target is None or cut.target_speed is None:
        angle, velocity = starting_motion(job, samples)
    else:
        angle, velocity = cut.target[samples * job.parts], cut.target_speed[samples * job.parts]
    constants = constants_of(job)
    drive = np.zeros(len(samples)) if kind == "servo" else cut.drive[samples * job.parts]
    load_drive = cut.load_drive[samples * job.parts] if cut.load_drive is not None else np.zeros(len(samples))
    sliding_share = np.tanh(velocity / 0.1)
    net = drive - (constants["damping"] + constants["emf_damping"]) * velocity - constants["friction"] * sliding_share
    load_net = load_drive - constants["load_damping"] * velocity - constants["load_friction"] * sliding_share
    load_net = load_net - constants["load_gravity"] * np.sin(angle - constants["hanging"])
    twist = np.zeros(len(samples))
    accelerated_inertia = constants["inertia"]
    if constants["stiffness"]:
        # no ringing at the start: both rotors accelerate alike
        accelerated_inertia = constants["inertia"] + constants["load_inertia"]
        twist = twist_under_torque(
            (constants["load_inertia"] * net - constants["inertia"] * load_net) / accelerated_inertia, job
        )
        net = net + load_net
    # velocities of the stepper lie half a step before the instants
    half_step_velocity = velocity - 0.5 * job.step * net / accelerated_inertia * np.abs(sliding_share)
    load_velocity = half_step_velocity.copy()
    is_measured = job.clock.get("angle") is not None or job.clock.get("velocity") is not None
    if is_measured and kind != "servo" and has_coupled_part(job):
        load_velocity, twist = (load_behind_teeth if job.plant.geared_load is not None else load_on_spring)(
            job, constants, samples
        )
    return LaneState(angle, half_step_velocity, load_velocity, twist, np.sign(velocity) * np.abs(sliding_share))


def load_behind_teeth(job: Job, constants: Mapping[str, float], samples: Index) -> tuple[Array, Array]:
    """Return speed [rad/s] and twist [rad], at some samples, of a load driven by the measured motion through play.

    constants : constants of the bench, from `constants_of`.
    """
    angle, speed = (values[:: job.parts] for values in smooth_motion(job))
    inertia = constants["load_inertia"]
    half_plays, damping, friction = (
        np.array([value])
        for value in (0.5 * job.plant.play, constants["load_damping"] / inertia, constants["load_friction"] / inertia)
    )
    fall = constants["load_gravity"] * np.sin(angle - constants["hanging"]) / inertia
    speeds, twists = follow_loads(speed, job.clock.interval, half_plays, damping, friction, fall)
    return speeds[0, samples], twists[0, samples]


def load_on_spring(job: Job, constants: Mapping[str, float], samples: Index) -> tuple[Array, Array]:
    """Return speed [rad/s] and twist [rad], at some samples, of a load that the measured motion drives by a spring.

    The load's swing at the start of the run is not known; it decays.

    constants : constants of the bench, from `constants_of`.
    """
    spring = job.plant.elastic_load
    assert spring is not None
    interval, angular_frequency = job.clock.interval, 2.0 * np.pi * spring.frequency
    angle, speed = (values[:: job.parts] for values in smooth_motion(job))
    weightless_speed = follow_spring(speed, spring.frequency, spring.damping_ratio, interval)
    damping = 2.0 * spring.damping_ratio * angular_frequency * (speed - weightless_speed)
    twist = (np.gradient(weightless_speed, interval) - damping) / angular_frequency**2
    weight = constants["load_gravity"] * np.sin(angle - constants["hanging"])
    sag = weight / (constants["load_inertia"] * angular_frequency**2)
    return (weightless_speed - np.gradient(sag, interval))[samples], (twist + sag)[samples]


def twist_under_torque(torque: Array, job: Job) -> Array:
    """Return the twist [rad] of a shaft that carries a torque, with its play."""
    return np.asarray(torque / constants_of(job)["stiffness"] + 0.5 * job.plant.play * np.sign(torque), np.float64)


def step_stretches(cuts: Sequence[CutJob], stretches: Sequence[Index], starts: Sequence[LaneState]) -> LaneMotion:
    """Return the motion of some stretches of every job, stepped side by side.

    stretches : numbers of the stretches of each job.
    starts : their states at the beginning, for each job.
    """
    joined_start = LaneState(
        *(np.concatenate(values) for values in zip(*(vars(start).values() for start in starts), strict=True))
    )
    return step_lanes(lanes_of(cuts, stretches), joined_start)


def step_until_settled(cuts: Sequence[CutJob], kind: str) -> None:
    """Step the stretches of locked or tracked rotors until each begins in the end state of the previous one.

    The motion is written into the jobs. Only stretches whose start has changed are stepped again.
    """
    stretches: list[Index] = [np.arange(cut.count) for cut in cuts]
    starts = [locked_start(cut) if kind == "locked" else start_of(cut, kind) for cut in cuts]
    passes = min(max(cut.count for cut in cuts) + 1, MOST_LOCKED_PASSES) if kind == "locked" else TRACKED_PASSES
    for _ in range(passes):
        motion = step_stretches(
            cuts, stretches, [start.of_lanes(lanes) for start, lanes in zip(starts, stretches, strict=True)]
        )
        write_motion(cuts, stretches, motion)
        changed_stretches: list[Index] = []
        first_lane = 0
        for cut, start, lanes in zip(cuts, starts, stretches, strict=True):
            following = lanes[lanes + 1 < cut.count] + 1
            ends = motion.end.of_lanes(first_lane + np.arange(len(following)))
            first_lane += len(lanes)
            changed_stretches.append(following[carry_over_ends(cut, start, following, ends)])
        stretches = changed_stretches
        if not any(len(lanes) for lanes in stretches):
            return


def carry_over_ends(cut: CutJob, start: LaneState, following: Index, ends: LaneState) -> npt.NDArray[np.bool_]:
    """Set the starts of stretches to the ends of the previous ones where they differ; return the mask of those.

    start : states at the beginning of all stretches, which are changed.
    following : numbers of the stretches to compare.
    ends : state at the end of the stretch before each of these.
    """
    constants = constants_of(cut.job)
    spring_stiffness = constants["stiffness"] or constants["tracking"]
    impedance = np.sqrt(spring_stiffness * constants["inertia"])
    mismatch = np.abs(ends.twist - start.twist[following]) * constants["stiffness"]
    mismatch = mismatch + np.abs(ends.angle - start.angle[following]) * constants["tracking"]
    mismatch = mismatch + np.abs(ends.velocity - start.velocity[following]) * impedance
    mismatch = mismatch + np.abs(ends.bristle - start.bristle[following]) * constants["friction"]
    differs = np.asarray(mismatch > MOST_MISMATCH_SHARE * float(np.max(np.abs(cut.drive), initial=1e-9)))
    for name, values in vars(start).items():
        values[following[differs]] = getattr(ends, name)[differs]
    return differs


def locked_start(cut: CutJob) -> LaneState:
    """Return a first guess of the start of each stretch of a locked rotor: friction as play, without ringing."""
    constants = constants_of(cut.job)
    parts, samples = cut.job.parts, cut.length * np.arange(cut.count)
    drive = cut.drive[::parts]
    torque = play(drive, constants["friction"])
    angle = cut.job.clock.get("angle")
    twist = twist_under_torque(torque, cut.job)
    resting_angle = (twist - float(np.mean(twist)))[samples] + (float(np.mean(angle)) if angle is not None else 0.0)
    torque = torque[samples]
    zeros = np.zeros(cut.count)
    bristle = np.clip((drive[samples] - torque) / max(constants["friction"], 1e-12), -1.0, 1.0)
    return LaneState(resting_angle, zeros, zeros.copy(), twist[samples], bristle)


def write_motion(cuts: Sequence[CutJob], stretches: Sequence[Index], motion: LaneMotion) -> None:
    """Write the motion of the lanes into the jobs.

    stretches : numbers of each job's stretches, in the order of the lanes.
    """
    first_lane = 0
    for cut, stretches_of_cut in zip(cuts, stretches, strict=True):
        lanes_of_cut = slice(first_lane, first_lane + len(stretches_of_cut))
        first_lane += len(stretches_of_cut)
        if len(stretches_of_cut) == 0:
            continue
        for name in ("angle", "velocity", "torque", "load_velocity", "current", "pull"):
            values = getattr(motion, name)
            if values is not None:
                cut.write(name, values[:, lanes_of_cut], stretches_of_cut)
