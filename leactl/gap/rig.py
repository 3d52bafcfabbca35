"""What rigs other than the bench add to the signals: another drive, something that hangs on the shaft, creeping motion.

Most log position and command only. A run's own set-up (`drive_gain`, `load_mass`, ...) replaces the model file's.
"""

import numpy as np
import numpy.typing as npt

from leactl.effects.contract import Signals
from leactl.effects.shapes import play
from leactl.gap.record import Clocked, Record
from leactl.gap.signals import averaged
from leactl.gap.smoothing import smooth
from leactl.model.nominal import DriveModel, LoadModel, Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
CREEP_COUNTS = 30.0  # of the encoder a sample, up to which an axis creeps
FASTEST_CREEP = 0.15  # rad/s, from where on the balance of a rotor that turns takes a run
CREEP_TRAVEL = 300.0  # counts, below which it stands
JITTER_COUNTS = 10.0  # by which a hold overshoots and jitters without having turned back
SLOW_SHARE = 0.02  # of a run's fast speeds, below which it counts as standing
STILL_REACH = 4.0  # samples


def drive_of(record: Record, model: Model) -> DriveModel | None:
    """The servo of a run; None where no position servo drives it or the run lacks its reference."""
    clock = record.fast
    if model.drive is None or clock is None or clock.get("angle_reference") is None or clock.get("angle") is None:
        return None
    return model.drive.model_copy(update={"gain": record.setup.get("drive_gain", model.drive.gain)})


def load_of(record: Record, model: Model) -> LoadModel:
    """What hangs on the shaft in a run."""
    own = {
        name: record.setup[f"load_{name}"] for name in ("mass", "length", "arm_mass") if f"load_{name}" in record.setup
    }
    return model.load.model_copy(update=own)


def level_torque(load: LoadModel) -> float:
    """Torque of a pendulum held out level."""
    if load.type == "none":
        return 0.0
    return (load.mass + 0.5 * load.arm_mass) * load.gravity * load.length


def load_inertia(load: LoadModel) -> float:
    """Inertia of a pendulum about the shaft."""
    return 0.0 if load.type == "none" else (load.mass + load.arm_mass / 3.0) * load.length**2


def complete(record: Record, s: Signals) -> None:
    """Put a servo's current, the torque that acts on friction, and the sense of creeping motion into the signals."""
    clock, model = record.fast, s.model
    if clock is None or s.mechanical == "locked":
        return
    if clock.units.get(("angle", "test")) == "m":
        s.angle = None  # a carriage does not go round: neither a turn's effects nor bristles in radians make sense
    servo = drive_of(record, model)
    if servo is not None and s.current is None and s.velocity is not None:
        servo_current(clock, servo, s)
    if s.current is None and (told := logged_torque(clock, model)) is not None:
        s.extra["told"] = told
        if clock.get("torque") is None or clock.get("torque_reference") is not None:
            s.extra["commanded"] = told  # and not what a sensor says
    if model.load.type != "none" and s.current is not None and model.torque_constant is not None:
        # a gear rubs with the torque that its motor puts in; let go, a pendulum swings with bearing friction alone
        s.torque = model.torque_constant * s.current
    if s.angle is not None and s.velocity is not None and s.mechanical == "free" and creeping(clock, s.velocity):
        # a chain of rests needs no derivatives: its samples stand as they are, so that fine waves keep their height
        s.angle, s.current = clock.values["angle", "test"], clock.get("q_axis_current")
        s.sliding = s.extra["creep"] = creep_sense(s.angle, JITTER_COUNTS * clock.counts["angle", "test"])


def servo_current(clock: Clocked, servo: DriveModel, s: Signals) -> None:
    """Current that a servo's voltage drives through the winding against the back-EMF, none while it is disabled."""
    model = s.model
    constant = model.back_emf_constant or model.torque_constant
    if constant is None or model.phase_resistance is None or s.velocity is None:
        return
    reference, angle = clock.values["angle_reference", "test"], clock.values["angle", "test"]
    held = np.concatenate([reference[:1], reference[:-1]])  # what is sent at a stamp holds until the next
    wanted = servo.gain * (held - 0.5 * (angle + np.concatenate([angle[:1], angle[:-1]])))
    volts = np.clip(wanted, -servo.voltage_limit, servo.voltage_limit)
    enabled = clock.get("drive_enabled")
    share = np.ones_like(volts) if enabled is None else (enabled > 0.5).astype(float)
    s.extra["servo_share"] = smooth(share)
    s.extra["servo_volts"] = smooth(share * volts)
    s.extra["servo_slope"] = smooth(share * (np.abs(wanted) < servo.voltage_limit)) * servo.gain
    s.extra["servo_reference"] = smooth(held)
    s.current = (s.extra["servo_volts"] - constant * s.extra["servo_share"] * s.velocity) / model.phase_resistance


def logged_torque(clock: Clocked, model: Model) -> Array | None:
    """Torque or force that a drive was told to make, where it logs that, or a reference alone, instead of a current."""
    for quantity in ("torque_reference", "torque"):
        values = averaged(clock, quantity)
        if values is not None:
            return smooth(values)
    reference = averaged(clock, "q_axis_current_reference")
    if reference is None or model.torque_constant is None:
        return None
    return np.asarray(model.torque_constant * smooth(reference), np.float64)


def creeping(clock: Clocked, velocity: Array) -> bool:
    """Whether an axis gets on by a few counts of its encoder a sample, too slowly for its speed to tell its sense."""
    count = clock.counts.get(("angle", "test"), 0.0)
    fast = float(np.quantile(np.abs(velocity), 0.95))
    slow = fast < FASTEST_CREEP and fast * clock.interval < CREEP_COUNTS * count
    return slow and float(np.ptp(clock.values["angle", "test"])) > CREEP_TRAVEL * count


def creep_sense(angle: Array, width: float) -> Array:
    """-1 or 1 where an angle last moved that way by more than a width, in between after a turn."""
    moved = angle - angle[0]
    return np.asarray(np.clip((moved - play(moved, width)) / width, -1.0, 1.0), np.float64)


def in_motion(s: Signals, count: float) -> Mask:
    """Samples around which the axis moves one way, judged by its encoder and its own speeds."""
    assert s.velocity is not None
    if "creep" in s.extra:
        return np.asarray(np.abs(s.extra["creep"]) > 0.9)
    speed = np.abs(s.velocity)
    slowest = max(0.2 * count / s.interval, SLOW_SHARE * float(np.quantile(speed, 0.95)))
    return np.asarray(smooth((speed <= slowest).astype(float), STILL_REACH) < 1e-3)
