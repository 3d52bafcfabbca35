"""Motion of whole runs, cut into stretches that are stepped side by side.

A turning rotor starts again every second from its measured state: its angle is an integral, and what goes by the
angle would drift apart. A locked one never does, for friction keeps what the last move left: its stretches are stepped
at once, and again wherever one did not begin where the one before it ended. A rotor that is kept near its motion is
stepped likewise, for it forgets where it began. A position servo runs through.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from leactl.effects.plant import Array
from leactl.effects.shapes import play
from leactl.effects.teeth import followed
from leactl.gap.replay.cutting import (
    CutJob,
    Index,
    constants_of,
    cut_of,
    hangs_apart,
    lanes_of,
    logged_torque,
    target_of,
    voltage_torque,
)
from leactl.gap.replay.job import Job
from leactl.gap.replay.lanes import LaneMotion, LaneState, stepped
from leactl.gap.replay.starting import starting_motion

SLOWEST = 0.5  # of the time in which drag stops a rotor, between samples: in more a start is lost before it is measured
SETTLED_AFTER = 128  # passes, beyond which a locked rotor that never slides may begin a stretch where it was guessed
FORGOTTEN_AFTER = 3  # passes, after which a tracked rotor knows nothing of where it began
CLOSE = 3e-4  # of the largest torque, by which a stretch may begin off the end of the one before


def move(jobs: Sequence[Job]) -> None:
    """Replay the motion of every job that has what it takes; the others say what is missing."""
    sets: dict[tuple[str, float, int], list[CutJob]] = {}
    for job in jobs:
        kind = kind_of(job)
        if kind is not None:
            sets.setdefault((kind, round(job.step, 9), job.parts), []).append(cut_of(job, kind))
    for (kind, _, _), cuts in sets.items():
        # lanes of one bench side by side: its effects then act on all of them in one call
        cuts.sort(key=lambda cut: id(cut.job.plant))
        longest = max(cut.length for cut in cuts)
        for cut in cuts:
            cut.take_length(longest)  # a servo that ends earlier goes on at its last reference
        if kind in ("locked", "tracked"):
            settle(cuts, kind)
        else:
            every = [np.arange(cut.count) for cut in cuts]
            keep(cuts, every, run(cuts, every, [start_of(cut, kind) for cut in cuts]))
        for cut in cuts:
            if kind == "tracked":
                carry(cut.job)
            cut.job.restarts = kind == "turning"
            cut.job.starts = cut.first + cut.length * np.arange(cut.count)


def kind_of(job: Job) -> str | None:
    """How a job is stepped: locked, turning or servo; None, with a note, where it cannot be."""
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
    if job.clock.interval * damping > SLOWEST * inertia and job.record.mechanical != "locked":
        job.notes.append(f"{name}: {1 / job.clock.interval:.3g} samples a second are too few to replay a motion")
        return None
    driven = job.current is not None and model.torque_constant is not None
    if not driven and logged_torque(job) is None and voltage_torque(job) is None:
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
        return None  # there is no motion that it could be kept near
    return "tracked" if job.tracked else "turning"


def carry(job: Job) -> None:
    """Let the current of a tracked rotor make the torque that keeps it near its motion."""
    constant = job.plant.model.torque_constant
    if job.current is None or job.current_mean is None or job.pull is None or constant is None:
        return
    more = job.pull[: len(job.current)] / constant
    job.current = job.current + more
    job.current_mean = job.current_mean + 0.5 * (more[1:] + more[:-1])


def start_of(cut: CutJob, kind: str) -> LaneState:
    """Where each stretch of a turning rotor or a servo begins."""
    job = cut.job
    at = cut.first + cut.length * np.arange(cut.count)
    if cut.target is None or cut.target_speed is None:
        angle, velocity = starting_motion(job, at)
    else:
        angle, velocity = cut.target[at * job.parts], cut.target_speed[at * job.parts]
    c = constants_of(job)
    drive = np.zeros(len(at)) if kind == "servo" else cut.drive[at * job.parts]
    load_drive = cut.load_drive[at * job.parts] if cut.load_drive is not None else np.zeros(len(at))
    rubbing = np.tanh(velocity / 0.1)
    net = drive - (c["damping"] + c["emf_damping"]) * velocity - c["friction"] * rubbing
    load_net = load_drive - c["load_damping"] * velocity - c["load_friction"] * rubbing
    twist = np.zeros(len(at))
    mass = c["inertia"]
    if c["stiffness"]:
        # no ringing at the start: both rotors gain speed alike
        mass = c["inertia"] + c["load_inertia"]
        twist = strained((c["load_inertia"] * net - c["inertia"] * load_net) / mass, job)
        net = net + load_net
    earlier = velocity - 0.5 * job.step * net / mass * np.abs(rubbing)
    load = earlier.copy()
    measured = job.clock.get("angle") is not None or job.clock.get("velocity") is not None
    if measured and kind != "servo" and job.plant.geared_load is not None and hangs_apart(job):
        load, twist = behind_teeth(job, c, at)
    return LaneState(angle, earlier, load, twist, np.sign(velocity) * np.abs(rubbing))


def behind_teeth(job: Job, c: Mapping[str, float], at: Index) -> tuple[Array, Array]:
    """Speed [rad/s] and twist [rad] at some samples of a load that the measured motion moves by teeth with play."""
    _, speed = target_of(job)
    one = np.array(
        [0.5 * job.plant.play, c["load_damping"] / c["load_inertia"], c["load_friction"] / c["load_inertia"]]
    )
    speeds, twists = followed(speed[:: job.parts], job.clock.interval, *one[:, None])
    return speeds[0, at], twists[0, at]


def strained(torque: Array, job: Job) -> Array:
    """Twist [rad] of a shaft that carries a torque, its play taken up."""
    return np.asarray(torque / constants_of(job)["stiffness"] + 0.5 * job.plant.play * np.sign(torque), np.float64)


def run(cuts: Sequence[CutJob], picked: Sequence[Index], starts: Sequence[LaneState]) -> LaneMotion:
    """Step some stretches of every cut."""
    together = LaneState(*(np.concatenate(values) for values in zip(*(vars(s).values() for s in starts), strict=True)))
    return stepped(lanes_of(cuts, picked), together)


def settle(cuts: Sequence[CutJob], kind: str) -> None:
    """Step the stretches of locked or tracked rotors until each begins where the one before it ended."""
    picked: list[Index] = [np.arange(cut.count) for cut in cuts]
    starts = [resting(cut) if kind == "locked" else start_of(cut, kind) for cut in cuts]
    passes = min(max(cut.count for cut in cuts) + 1, SETTLED_AFTER) if kind == "locked" else FORGOTTEN_AFTER
    for _ in range(passes):
        motion = run(cuts, picked, [start.picked(lanes) for start, lanes in zip(starts, picked, strict=True)])
        keep(cuts, picked, motion)
        wrong: list[Index] = []
        at = 0
        for cut, start, lanes in zip(cuts, starts, picked, strict=True):
            after = lanes[lanes + 1 < cut.count] + 1
            ends = motion.end.picked(at + np.arange(len(after)))
            at += len(lanes)
            wrong.append(after[continued(cut, start, after, ends)])
        picked = wrong
        if not any(len(lanes) for lanes in picked):
            return


def continued(cut: CutJob, start: LaneState, after: Index, ends: LaneState) -> npt.NDArray[np.bool_]:
    """Let stretches begin where those before them ended; tells which had begun elsewhere."""
    c = constants_of(cut.job)
    spring = c["stiffness"] or c["tracking"]
    impedance = np.sqrt(spring * c["inertia"])
    off = np.abs(ends.twist - start.twist[after]) * c["stiffness"]
    off = off + np.abs(ends.angle - start.angle[after]) * c["tracking"]
    off = off + np.abs(ends.velocity - start.velocity[after]) * impedance
    off = off + np.abs(ends.bristle - start.bristle[after]) * c["friction"]
    wrong = np.asarray(off > CLOSE * float(np.max(np.abs(cut.drive), initial=1e-9)))
    for name, values in vars(start).items():
        values[after[wrong]] = getattr(ends, name)[wrong]
    return wrong


def resting(cut: CutJob) -> LaneState:
    """A first guess of where each stretch of a locked rotor begins: friction as play, nothing rings."""
    c = constants_of(cut.job)
    parts, at = cut.job.parts, cut.length * np.arange(cut.count)
    drive = cut.drive[::parts]
    torque = play(drive, c["friction"])
    angle = cut.job.clock.get("angle")
    twist = strained(torque, cut.job)
    still = (twist - float(np.mean(twist)))[at] + (float(np.mean(angle)) if angle is not None else 0.0)
    torque = torque[at]
    none = np.zeros(cut.count)
    bristle = np.clip((drive[at] - torque) / max(c["friction"], 1e-12), -1.0, 1.0)
    return LaneState(still, none, none.copy(), twist[at], bristle)


def keep(cuts: Sequence[CutJob], picked: Sequence[Index], motion: LaneMotion) -> None:
    """Put what the lanes did into the jobs."""
    at = 0
    for cut, lanes in zip(cuts, picked, strict=True):
        own = slice(at, at + len(lanes))
        at += len(lanes)
        if len(lanes) == 0:
            continue
        for name in ("angle", "velocity", "torque", "load_velocity", "current", "pull"):
            values = getattr(motion, name)
            if values is not None:
                cut.put(name, values[:, own], lanes)
