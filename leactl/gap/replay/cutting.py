"""Runs cut into stretches, with the inputs of each stretch and the constants of its bench."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from leactl.effects.plant import Array, Plant
from leactl.gap.replay.drive import interpolate_steps, measured_over_steps
from leactl.gap.replay.initial_state import half_window
from leactl.gap.replay.job import Job
from leactl.gap.replay.lanes import SHAFT_DAMPING, Lanes, Servo, Tracking
from leactl.gap.signals.rig import load_of, voltage_feed
from leactl.gap.signals.smoothing import smooth
from leactl.gap.signals.stamps import restamped

# by set-up: the equation that determines the stamps of the current
BALANCE_EQUATIONS = {"free": "free_torque", "coupled": "coupled_torque"}
RESTART_S = 1.0  # s, stretch of a turning rotor: its angle is an integral and would drift
TRACKING_SAMPLES = 20.0  # samples, time constant with which a tracked rotor is kept near its motion
FEWEST_TRACKING_TIMES = 12.0  # tracking time constants in a stretch: at its end its start has no influence
LOCKED_STRETCH_S = 0.25  # s, stretch of a locked rotor
TOOTH_PHASE = 0.3  # rad, phase of the resonance of meshing teeth in a step: as rigid as steps can resolve
TOOTH_DAMPING = 0.5 / TOOTH_PHASE  # damping ratio with which one step removes all of the speed with which teeth meet
Index = npt.NDArray[np.intp]


@dataclass
class CutJob:
    """A job cut into stretches."""

    job: Job
    first: int  # sample at which the first stretch begins
    length: int  # samples in a stretch
    count: int  # number of stretches
    drive: Array  # N*m at the instants, or rad where a position servo drives
    load_drive: Array | None  # N*m, at the instants
    share: Array | None  # factor on the friction, at the instants
    target: Array | None = None  # rad, at the instants, motion that a tracked rotor is kept near
    target_speed: Array | None = None  # rad/s

    @property
    def steps(self) -> int:
        """Sub-steps in a stretch."""
        return self.length * self.job.parts

    def set_length(self, length: int) -> None:
        """Cut the job into stretches of `length` samples, up to its end."""
        self.length, self.count = length, stretch_count(self.job, self.first, length)

    def cut(self, values: Array, lanes: Index) -> Array:
        """Return values at the instants of some stretches, shape (steps, lanes), held constant beyond the run's end.

        values : at the instants of the whole run.
        lanes : numbers of the stretches.
        """
        begin = self.first * self.job.parts
        missing_count = begin + self.count * self.steps - len(values)
        padded = np.concatenate([values[begin:], np.full(max(missing_count, 0), values[-1])])[: self.count * self.steps]
        return np.ascontiguousarray(padded.reshape(self.count, self.steps)[lanes].T)

    def write(self, name: str, values: Array, lanes: Index) -> None:
        """Write the values of some stretches into an attribute of the job, held constant before the first stretch.

        name : attribute of `Job`.
        values : shape (steps, lanes).
        lanes : numbers of the stretches.
        """
        begin, instant_count = self.first * self.job.parts, (len(self.job.clock.time) - 1) * self.job.parts + 1
        column = getattr(self.job, name) if len(lanes) < self.count else None
        if column is None or len(column) < instant_count:
            column = np.zeros(begin + self.count * self.steps)
        table = column[begin:].reshape(self.count, self.steps)
        table[lanes] = values.T
        column[:begin] = table[0, 0]
        setattr(self.job, name, column)


def cut_job(job: Job, kind: str) -> CutJob:
    """Return a job cut into stretches, with its inputs.

    kind : how it is stepped, as `stepping_kind` returns it.
    """
    clock, plant, parts = job.clock, job.plant, job.parts
    sample_count = len(clock.time)
    course = job.course()
    magnet_share = np.ones(sample_count)
    for share_of in plant.magnet_share:
        magnet_share = magnet_share * share_of(course)
    drive = angle_set_point(job) if kind == "servo" else drive_torque(job, magnet_share)
    friction_share = None
    if plant.friction_share:
        friction_share = np.ones(sample_count)
        for share_of_friction in plant.friction_share:
            friction_share = friction_share * share_of_friction(course)
        friction_share = interpolate_steps(friction_share, parts)
    load_drive = None
    if job.record.mechanical == "coupled":
        load_current = measured_over_steps(job, "load")
        assert load_current is not None
        load_drive = (plant.model.torque_constant or 0.0) * load_current[0]
    first_sample = 0 if kind == "locked" else half_window(job)
    tracked_s = max(RESTART_S, FEWEST_TRACKING_TIMES * TRACKING_SAMPLES * clock.interval)
    stretch_duration = {"locked": LOCKED_STRETCH_S, "turning": RESTART_S, "tracked": tracked_s}.get(kind)
    length = sample_count if stretch_duration is None else max(1, round(stretch_duration / clock.interval))
    job.first = first_sample
    cut = CutJob(job, first_sample, length, stretch_count(job, first_sample, length), drive, load_drive, friction_share)
    if kind == "tracked":
        cut.target, cut.target_speed = smooth_motion(job)
    return cut


def stretch_count(job: Job, begin: int, length: int) -> int:
    """Return the number of stretches of `length` samples in a job; the last may reach beyond its end."""
    instants = (len(job.clock.time) - 1 - begin) * job.parts + 1
    return -(-instants // (length * job.parts))


def smooth_motion(job: Job) -> tuple[Array, Array]:
    """Return the smoothed measured motion at the instants: angle [rad] and speed [rad/s]."""
    clock = job.clock
    angle, speed = clock.get("angle"), clock.get("velocity")
    if angle is None:
        assert speed is not None
        angle = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) * clock.interval])
    spline = CubicSpline(np.arange(len(angle)), smooth(angle))
    positions = np.arange((len(angle) - 1) * job.parts + 1) / job.parts
    return np.asarray(spline(positions), np.float64), np.asarray(spline(positions, 1) / clock.interval, np.float64)


def angle_set_point(job: Job) -> Array:
    """Return a servo's angle set-point [rad] at the instants; NaN while the drive is disabled."""
    reference, enabled = job.clock.values["angle_reference", "test"], job.clock.get("drive_enabled")
    set_point = np.append(np.repeat(reference[:-1], job.parts), reference[-1])
    angle = job.clock.get("angle")
    if job.plant.set_point and angle is not None:
        set_point[0] = angle[0]  # a limited set-point is near the axis, and may be far from the reference
    for transform in (*job.plant.loop_answer, *job.plant.set_point):
        set_point = transform(set_point, job.step)
    if delay := job.clock.reference_delay:  # of the set-point: rows between two references would start a ramp early
        instants = np.arange(len(set_point))
        set_point = np.interp(instants - delay / job.step, instants, set_point)
    # the stepper's step is centred on an instant, at which a reference changes: it takes the mean of both values
    set_point = np.append(set_point[:1], 0.5 * (set_point[:-1] + set_point[1:]))
    if enabled is not None:
        enabled_steps = np.append(np.repeat(enabled[:-1], job.parts), enabled[-1])
        set_point = np.where(enabled_steps > 0.5, set_point, np.nan)
    return np.asarray(set_point, np.float64)


def drive_torque(job: Job, magnet_share: Array) -> Array:
    """Return the torque of the test drive [N*m] at the instants, from voltage or current, else as logged.

    magnet_share : factor on the torque constant at each sample.
    """
    torque_constant = job.plant.model.torque_constant
    if (fed_torque := voltage_torque(job)) is not None:
        return np.append(fed_torque[:1], np.repeat(fed_torque[1:], job.parts))
    if job.current is None or torque_constant is None:
        torque_as_logged = logged_torque(job)
        assert torque_as_logged is not None
        # a logged force has the offset of the drive's current
        torque_as_logged = torque_as_logged - (torque_constant or 1.0) * job.plant.current_offset
        return np.append(torque_as_logged[:1], np.repeat(torque_as_logged[1:], job.parts))
    stamped_current = restamped(
        job.current, job.clock.lateness.get(BALANCE_EQUATIONS.get(job.record.mechanical, ""), 0.0), job.parts
    )
    torque = torque_constant * interpolate_steps(magnet_share, job.parts) * stamped_current
    for saturation_share in job.plant.torque_share:
        torque = torque * saturation_share(stamped_current)
    return torque


def voltage_torque(job: Job) -> Array | None:
    """Return the torque [N*m] at each sample of the logged voltage in a motor at rest; None where no voltage drives."""
    feed = voltage_feed(job.record, job.plant.model)
    if feed is None:
        return None
    return feed.gain * restamped(job.clock.values["q_axis_voltage", "test"], job.clock.lateness.get("axis_torque", 0.0))


def logged_torque(job: Job) -> Array | None:
    """Return the torque reference, else the torque, that a free drive logs instead of a current, else None."""
    if job.record.mechanical != "free":
        return None
    reference = job.clock.get("torque_reference")
    return reference if reference is not None else job.clock.get("torque")


def lanes_of(cuts: Sequence[CutJob], stretches: Sequence[Index]) -> Lanes:
    """Return some stretches of every job as lanes.

    stretches : numbers of the stretches of each job.
    """
    plants: list[tuple[Plant, slice]] = []
    first_lane = 0
    for cut, lanes in zip(cuts, stretches, strict=True):
        if plants and plants[-1][0] is cut.job.plant:
            plants[-1] = (cut.job.plant, slice(plants[-1][1].start, first_lane + len(lanes)))
        else:
            plants.append((cut.job.plant, slice(first_lane, first_lane + len(lanes))))
        first_lane += len(lanes)

    def per_lane(values: Iterable[float]) -> Array:
        """Return one value for each lane, from one for each job."""
        return np.concatenate([np.full(len(lanes), value) for value, lanes in zip(values, stretches, strict=True)])

    def inputs(name: str, default: float) -> Array:
        """Return an attribute of the jobs at every step, shape (steps, lanes)."""
        columns = []
        for cut, lanes in zip(cuts, stretches, strict=True):
            values = getattr(cut, name)
            shape = (cut.steps, len(lanes))
            columns.append(cut.cut(values, lanes) if values is not None else np.full(shape, default))
        return np.concatenate(columns, axis=1)

    constants = [constants_of(cut.job) for cut in cuts]
    drive = inputs("drive", 0.0)

    def constant(name: str) -> Array:
        """Return one constant of the benches for each lane."""
        return per_lane([constants_of_bench[name] for constants_of_bench in constants])

    servo = None
    if "servo_gain" in constants[0]:
        servo = Servo(
            reference=drive,
            gain=constant("servo_gain"),
            damping=constant("servo_damping"),
            limit=constant("servo_limit"),
            resistance=constant("resistance"),
            torque_constant=constant("torque_constant"),
            emf=constant("emf"),
            held=cuts[0].job.parts,
        )
    tracking = None
    if cuts[0].target is not None:
        tracking = Tracking(
            angle=inputs("target", 0.0),
            velocity=inputs("target_speed", 0.0),
            stiffness=constant("tracking"),
            damping=constant("tracking_damping"),
        )
    return Lanes(
        step=cuts[0].job.step,
        plants=plants,
        drive=drive,
        load_drive=inputs("load_drive", 0.0) if any(has_two_ends(cut.job) for cut in cuts) else None,
        friction_share=inputs("share", 1.0) if any(cut.share is not None for cut in cuts) else None,
        inertia=constant("inertia"),
        damping=constant("damping"),
        emf_damping=constant("emf_damping"),
        friction=constant("friction"),
        load_inertia=constant("load_inertia"),
        load_damping=constant("load_damping"),
        load_friction=constant("load_friction"),
        stiffness=constant("stiffness"),
        damping_ratio=constant("damping_ratio"),
        gravity=constant("gravity"),
        load_gravity=constant("load_gravity"),
        hanging=constant("hanging"),
        servo=servo,
        tracking=tracking,
    )


def has_two_ends(job: Job) -> bool:
    """Return whether a load actuator or a part of a free rotor's inertia turns at the other end of a shaft."""
    return job.record.mechanical == "coupled" or has_coupled_part(job)


def has_coupled_part(job: Job) -> bool:
    """Return whether part of a free rotor's inertia is coupled by a spring or by teeth with play."""
    plant = job.plant
    return job.record.mechanical == "free" and (plant.elastic_load is not None or plant.geared_load is not None)


def constants_of(job: Job) -> dict[str, float]:
    """Return the constants of a bench for the stepper, in SI units; a run's set-up replaces the model's."""
    model, record = job.plant.model, job.record
    load, feed = load_of(record, model), voltage_feed(record, model)
    inertia = (model.rotor_inertia or 0.0) + load.inertia
    load_damping, load_friction = load.frictions(model.viscous_damping, model.coulomb_friction)
    constants = {
        "inertia": inertia,
        "damping": model.viscous_damping or 0.0,
        "emf_damping": feed.damping if feed is not None else 0.0,
        "friction": model.coulomb_friction or 0.0,
        "load_inertia": np.inf if record.mechanical == "locked" else model.rotor_inertia or 0.0,
        "load_damping": load_damping,
        "load_friction": load_friction,
        "stiffness": 0.0 if record.mechanical == "free" else job.plant.stiffness or 0.0,
        "damping_ratio": SHAFT_DAMPING,
        "gravity": load.level_torque,
        "load_gravity": 0.0,
        "hanging": load.hanging_angle,
    }
    if has_coupled_part(job):
        constants |= split_rotor_constants(constants, job)
    tracking_rate = 1.0 / (TRACKING_SAMPLES * job.clock.interval)
    moved_inertia = constants["inertia"] + (constants["load_inertia"] if has_two_ends(job) else 0.0)
    # the tracking spring must be strong against the back-EMF's braking
    constants["tracking"] = (
        moved_inertia * tracking_rate**2 + constants["emf_damping"] * tracking_rate if job.tracked else 0.0
    )
    constants["tracking_damping"] = 2.0 * moved_inertia * tracking_rate if job.tracked else 0.0
    if job.by_servo:
        assert model.drive is not None
        torque_constant = model.torque_constant or 0.0
        constants |= {
            "servo_gain": record.setup.get("drive_gain", model.drive.gain),
            "servo_damping": model.drive.damping,
            "servo_limit": model.drive.voltage_limit,
            "resistance": model.phase_resistance or 0.0,
            "torque_constant": torque_constant,
            "emf": model.back_emf_constant or torque_constant,
        }
    return constants


def split_rotor_constants(rotor: Mapping[str, float], job: Job) -> dict[str, float]:
    """Return the constants of a rotor with a coupled part of its inertia, from those of the rigid rotor.

    A model with both a spring and teeth has one load, on the spring and behind the teeth.

    rotor : constants of the rigid rotor.
    """
    spring, gear = job.plant.elastic_load, job.plant.geared_load
    share, friction_share = (
        max(spring.share if spring else 0.0, gear.share if gear else 0.0),
        gear.friction if gear else 0.0,
    )
    load_inertia = share * rotor["inertia"]
    constants = {
        "inertia": rotor["inertia"] - load_inertia,
        "damping": (1.0 - friction_share) * rotor["damping"],
        "friction": (1.0 - friction_share) * rotor["friction"],
        "load_inertia": load_inertia,
        "load_damping": friction_share * rotor["damping"],
        "load_friction": friction_share * rotor["friction"],
        "gravity": 0.0,  # a pendulum or an arm hangs on the coupled part
        "load_gravity": rotor["gravity"],
    }
    if spring is not None:
        constants["stiffness"] = load_inertia * (2.0 * np.pi * spring.frequency) ** 2
        # ratio for the swing of both ends against each other, with the same damper
        constants["damping_ratio"] = spring.damping_ratio / np.sqrt(1.0 - share)
    else:
        constants["stiffness"] = constants["inertia"] * share * (TOOTH_PHASE / job.step) ** 2
        constants["damping_ratio"] = TOOTH_DAMPING
    return constants
