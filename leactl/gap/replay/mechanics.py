"""Motion of whole runs, cut into stretches that are stepped side by side.

A turning rotor starts again every second from its measured state: its angle is an integral, and what goes by the angle
would drift apart. A locked one never does, for friction keeps what the last move left: its stretches are stepped at
once, and again wherever one did not begin where the one before it ended. A position servo runs through.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.effects.plant import Array, Plant
from leactl.effects.shapes import play
from leactl.gap.replay.drive import measured, spread
from leactl.gap.replay.job import Job
from leactl.gap.replay.lanes import Lanes, Motion, Servo, State, stepped
from leactl.gap.replay.starting import reach, starting_motion

RESTART_S = 1.0
LOCKED_STRETCH_S = 0.25
CLOSE = 3e-4  # of the largest torque, by which a stretch may begin off the end of the one before
Index = npt.NDArray[np.intp]


@dataclass
class Cut:
    """A job cut into stretches."""

    job: Job
    first: int  # sample at which the first stretch begins
    length: int  # samples in a stretch
    count: int
    drive: Array  # N*m at the instants, or rad where a position servo drives
    load_drive: Array | None
    share: Array | None

    @property
    def steps(self) -> int:
        """Sub-steps in a stretch."""
        return self.length * self.job.parts

    def cut(self, values: Array, lanes: Index) -> Array:
        """Instants of some stretches, (steps, lanes); the last value goes on beyond the run's end."""
        begin = self.first * self.job.parts
        short = begin + self.count * self.steps - len(values)
        whole = np.concatenate([values[begin:], np.full(max(short, 0), values[-1])])[: self.count * self.steps]
        return np.ascontiguousarray(whole.reshape(self.count, self.steps)[lanes].T)

    def put(self, name: str, values: Array, lanes: Index) -> None:
        """Put some stretches, one after the other, into a job; what precedes the first holds its value."""
        begin, total = self.first * self.job.parts, (len(self.job.clock.time) - 1) * self.job.parts + 1
        whole = getattr(self.job, name) if len(lanes) < self.count else None
        if whole is None or len(whole) < total:
            whole = np.zeros(begin + self.count * self.steps)
        table = whole[begin:].reshape(self.count, self.steps)
        table[lanes] = values.T
        whole[:begin] = table[0, 0]
        setattr(self.job, name, whole)


def move(jobs: Sequence[Job]) -> None:
    """Replay the motion of every job that has what it takes; the others say what is missing."""
    sets: dict[tuple[str, float, int], list[Cut]] = {}
    for job in jobs:
        kind = kind_of(job)
        if kind is not None:
            sets.setdefault((kind, round(job.step, 9), job.parts), []).append(cut_of(job, kind))
    for (kind, _, _), cuts in sets.items():
        # lanes of one bench side by side: its effects then act on all of them in one call
        cuts.sort(key=lambda cut: id(cut.job.plant))
        if kind == "locked":
            settle(cuts)
        else:
            every = [np.arange(cut.count) for cut in cuts]
            keep(cuts, every, run(cuts, every, [start_of(cut, kind) for cut in cuts]))
        for cut in cuts:
            cut.job.restarts = kind == "turning"
            cut.job.starts = cut.first + cut.length * np.arange(cut.count)


def kind_of(job: Job) -> str | None:
    """How a job is stepped: locked, turning or servo; None, with a note, where it cannot be."""
    model, name = job.plant.model, job.record.path.name
    if model.rotor_inertia is None:
        job.notes.append(f"{name}: the model has no rotor_inertia; its motion is not replayed")
        return None
    if model.drive is not None and job.clock.get("angle_reference") is not None:
        if model.phase_resistance is None or model.torque_constant is None:
            job.notes.append(f"{name}: a servo's replay needs phase_resistance and torque_constant")
            return None
        return "servo"
    if job.current is None or model.torque_constant is None:
        job.notes.append(f"{name}: a replay needs a current of the test drive and a torque_constant in the model")
        return None
    if job.record.mechanical == "locked":
        if job.plant.stiffness is None:
            job.notes.append(f"{name}: the model has no bench.shaft_stiffness; its torque is not replayed")
            return None
        return "locked"
    if job.record.mechanical == "coupled":
        if job.plant.stiffness is None or job.clock.get("q_axis_current", "load") is None:
            job.notes.append(f"{name}: a coupled replay needs bench.shaft_stiffness and the load's current")
            return None
        return "turning"
    return "turning" if job.record.mechanical == "free" else None


def cut_of(job: Job, kind: str) -> Cut:
    """Cut a job into stretches and work out what drives it."""
    clock, plant, parts = job.clock, job.plant, job.parts
    samples = len(clock.time)
    course = job.course()
    magnets = np.ones(samples)
    for share_of in plant.magnet_share:
        magnets = magnets * share_of(course)
    if kind == "servo":
        reference = clock.values["angle_reference", "test"]
        drive = spread(reference, parts)
        for late in plant.loop_answer:
            drive = late(drive, job.step)
    else:
        assert job.current is not None and plant.model.torque_constant is not None
        drive = plant.model.torque_constant * spread(magnets, parts) * job.current
        for saturates in plant.torque_share:
            drive = drive * saturates(job.current)
    share = None
    if plant.friction_share:
        share = np.ones(samples)
        for rubs in plant.friction_share:
            share = share * rubs(course)
        share = spread(share, parts)
    load_drive = None
    if job.record.mechanical == "coupled":
        found = measured(job, "load")
        assert found is not None
        load_drive = (plant.model.torque_constant or 0.0) * found[0]
    first = 0 if kind == "locked" else reach(job)
    seconds = {"locked": LOCKED_STRETCH_S, "turning": RESTART_S}.get(kind)
    length = samples if seconds is None else max(1, round(seconds / clock.interval))
    job.first = first
    count = -(-((samples - 1 - first) * parts + 1) // (length * parts))
    return Cut(job, first, length, count, drive, load_drive, share)


def lanes_of(cuts: Sequence[Cut], picked: Sequence[Index]) -> Lanes:
    """Some stretches of every cut as lanes."""
    plants: list[tuple[Plant, slice]] = []
    at = 0
    for cut, lanes in zip(cuts, picked, strict=True):
        if plants and plants[-1][0] is cut.job.plant:
            plants[-1] = (cut.job.plant, slice(plants[-1][1].start, at + len(lanes)))
        else:
            plants.append((cut.job.plant, slice(at, at + len(lanes))))
        at += len(lanes)

    def each(values: Iterable[float]) -> Array:
        return np.concatenate([np.full(len(lanes), v) for v, lanes in zip(values, picked, strict=True)])

    def inputs(name: str, default: float) -> Array:
        found = []
        for cut, lanes in zip(cuts, picked, strict=True):
            values = getattr(cut, name)
            full = (cut.steps, len(lanes))
            found.append(cut.cut(values, lanes) if values is not None else np.full(full, default))
        return np.concatenate(found, axis=1)

    constants = [constants_of(cut.job) for cut in cuts]
    drive = inputs("drive", 0.0)

    def constant(name: str) -> Array:
        return each([c[name] for c in constants])

    servo = None
    if "servo_gain" in constants[0]:
        servo = Servo(
            reference=drive,
            gain=constant("servo_gain"),
            limit=constant("servo_limit"),
            resistance=constant("resistance"),
            torque_constant=constant("torque_constant"),
            emf=constant("emf"),
        )
    return Lanes(
        step=cuts[0].job.step,
        plants=plants,
        drive=drive,
        load_drive=inputs("load_drive", 0.0) if any(c.load_drive is not None for c in cuts) else None,
        friction_share=inputs("share", 1.0) if any(c.share is not None for c in cuts) else None,
        inertia=constant("inertia"),
        damping=constant("damping"),
        friction=constant("friction"),
        load_inertia=constant("load_inertia"),
        load_damping=constant("load_damping"),
        load_friction=constant("load_friction"),
        stiffness=constant("stiffness"),
        gravity=constant("gravity"),
        servo=servo,
    )


def constants_of(job: Job) -> dict[str, float]:
    """The numbers of a bench as the stepper takes them, a run's own set-up over the model's."""
    model, setup = job.plant.model, job.record.setup
    inertia, gravity = model.rotor_inertia or 0.0, 0.0
    damping, friction = model.viscous_damping or 0.0, model.coulomb_friction or 0.0
    if model.load.type == "pendulum":
        mass, length = setup.get("load_mass", model.load.mass), setup.get("load_length", model.load.length)
        arm = setup.get("load_arm_mass", model.load.arm_mass)
        inertia += mass * length**2 + arm * length**2 / 3.0
        gravity = (mass + 0.5 * arm) * model.load.gravity * length
    mechanical = job.record.mechanical
    found = {
        "inertia": inertia,
        "damping": damping,
        "friction": friction,
        "load_inertia": np.inf if mechanical == "locked" else model.rotor_inertia or 0.0,
        "load_damping": model.load.viscous_damping if model.load.viscous_damping is not None else damping,
        "load_friction": model.load.coulomb_friction if model.load.coulomb_friction is not None else friction,
        "stiffness": 0.0 if mechanical == "free" else job.plant.stiffness or 0.0,
        "gravity": gravity,
    }
    if model.drive is not None and job.clock.get("angle_reference") is not None:
        constant = model.torque_constant or 0.0
        found |= {
            "servo_gain": setup.get("drive_gain", model.drive.gain),
            "servo_limit": model.drive.voltage_limit,
            "resistance": model.phase_resistance or 0.0,
            "torque_constant": constant,
            "emf": model.back_emf_constant or constant,
        }
    return found


def start_of(cut: Cut, kind: str) -> State:
    """Where each stretch of a turning rotor or a servo begins."""
    job = cut.job
    at = cut.first + cut.length * np.arange(cut.count)
    angle, velocity = starting_motion(job, at)
    c = constants_of(job)
    drive = cut.drive[at * job.parts] if kind == "turning" else np.zeros(len(at))
    load_drive = cut.load_drive[at * job.parts] if cut.load_drive is not None else np.zeros(len(at))
    rubbing = np.tanh(velocity / 0.1)
    net = drive - c["damping"] * velocity - c["friction"] * rubbing
    load_net = load_drive - c["load_damping"] * velocity - c["load_friction"] * rubbing
    twist = np.zeros(len(at))
    mass = c["inertia"]
    if c["stiffness"]:
        # no ringing at the start: both rotors gain speed alike
        mass = c["inertia"] + c["load_inertia"]
        twist = (c["load_inertia"] * net - c["inertia"] * load_net) / mass / c["stiffness"]
        net = net + load_net
    earlier = velocity - 0.5 * job.step * net / mass * np.abs(rubbing)
    return State(angle, earlier, earlier.copy(), twist, np.sign(velocity) * np.abs(rubbing))


def run(cuts: Sequence[Cut], picked: Sequence[Index], starts: Sequence[State]) -> Motion:
    """Step some stretches of every cut."""
    together = State(*(np.concatenate(values) for values in zip(*(vars(s).values() for s in starts), strict=True)))
    return stepped(lanes_of(cuts, picked), together)


def settle(cuts: Sequence[Cut]) -> None:
    """Step the stretches of locked rotors until each begins where the one before it ended."""
    picked: list[Index] = [np.arange(cut.count) for cut in cuts]
    starts = [resting(cut) for cut in cuts]
    for _ in range(max(cut.count for cut in cuts) + 1):
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


def continued(cut: Cut, start: State, after: Index, ends: State) -> npt.NDArray[np.bool_]:
    """Let stretches begin where those before them ended; tells which had begun elsewhere."""
    c = constants_of(cut.job)
    impedance = np.sqrt(c["stiffness"] * c["inertia"])
    off = np.abs(ends.twist - start.twist[after]) * c["stiffness"]
    off = off + np.abs(ends.velocity - start.velocity[after]) * impedance
    off = off + np.abs(ends.bristle - start.bristle[after]) * c["friction"]
    wrong = np.asarray(off > CLOSE * float(np.max(np.abs(cut.drive), initial=1e-9)))
    for name, values in vars(start).items():
        values[after[wrong]] = getattr(ends, name)[wrong]
    return wrong


def resting(cut: Cut) -> State:
    """A first guess of where each stretch of a locked rotor begins: friction as play, nothing rings."""
    c = constants_of(cut.job)
    parts, at = cut.job.parts, cut.length * np.arange(cut.count)
    drive = cut.drive[::parts]
    torque = play(drive, c["friction"])
    angle = cut.job.clock.get("angle")
    still = (torque - float(np.mean(torque)))[at] / c["stiffness"]
    still = still + (float(np.mean(angle)) if angle is not None else 0.0)
    torque = torque[at]
    none = np.zeros(cut.count)
    bristle = np.clip((drive[at] - torque) / max(c["friction"], 1e-12), -1.0, 1.0)
    return State(still, none, none.copy(), torque / c["stiffness"], bristle)


def keep(cuts: Sequence[Cut], picked: Sequence[Index], motion: Motion) -> None:
    """Put what the lanes did into the jobs."""
    at = 0
    for cut, lanes in zip(cuts, picked, strict=True):
        own = slice(at, at + len(lanes))
        at += len(lanes)
        if len(lanes) == 0:
            continue
        for name in ("angle", "velocity", "torque", "load_velocity", "current"):
            values = getattr(motion, name)
            if values is not None:
                cut.put(name, values[:, own], lanes)
