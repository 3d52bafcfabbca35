"""Signals of rigs other than the bench: another drive, a load that hangs on the shaft, creeping motion.

The torque of a motor that is fed with a voltage and logs no current is that of the voltage less the back-EMF's.

Most rigs log position and command only. A run's own set-up (`drive_gain`, `load_mass`, ...) replaces the model file's.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.effects.contract import Signals
from leactl.effects.hysteresis_and_lags import play
from leactl.gap.signals.derived import channel_means
from leactl.gap.signals.record import Clocked, Record
from leactl.gap.signals.smoothing import smooth
from leactl.model.nominal import DriveModel, LoadModel, Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
DRIVE_CHANNELS = ("q_axis_current", "q_axis_current_reference", "torque_reference", "torque")
"""Channels that determine the drive of a motor better than its voltage."""
VOLTAGE_KIND = "voltage"  # kind of all runs of a motor that is fed with a logged voltage
CREEP_COUNTS = 30.0  # encoder counts a sample up to which an axis creeps
FASTEST_CREEP = 0.15  # rad/s; a faster run has the balance of a turning rotor
CREEP_TRAVEL = 300.0  # encoder counts of travel; an axis that travels less is at rest
JITTER_COUNTS = 10.0  # encoder counts by which a hold overshoots and jitters without a reversal
SLOW_SHARE = 0.02  # share of a run's fast speeds below which an axis counts as at rest
STILL_REACH = 4.0  # samples, Gaussian margin around samples at rest
RIG_ENTRIES = ("drive_gain", "load_mass", "load_length", "load_arm_mass")  # set-up entries that tell kinds of run apart


def drive_of(record: Record, model: Model) -> DriveModel | None:
    """Return the position servo of a run; None if the model has none or the run lacks its reference or angle."""
    clock = record.fast
    if model.drive is None or clock is None or clock.get("angle_reference") is None or clock.get("angle") is None:
        return None
    return model.drive.model_copy(update={"gain": record.setup.get("drive_gain", model.drive.gain)})


def load_of(record: Record, model: Model) -> LoadModel:
    """Return the load on the shaft in a run: the model's load with the run's own numbers."""
    run_values = {
        name: record.setup[f"load_{name}"] for name in ("mass", "length", "arm_mass") if f"load_{name}" in record.setup
    }
    return model.load.model_copy(update=run_values)


class VoltageFeed(NamedTuple):
    """Torque of a voltage on a motor without a current channel."""

    gain: float  # N*m/V; one where the model has torques in volts
    damping: float  # N*m*s/rad, by the back-EMF


def voltage_feed(record: Record, model: Model) -> VoltageFeed | None:
    """Return how a logged voltage drives a free motor; None if no voltage is logged or a parameter is missing.

    None, too, if a current, a torque or a servo's reference is logged and the model has no feedforward.
    """
    clock = record.fast
    if clock is None or record.mechanical != "free" or clock.get("q_axis_voltage") is None:
        return None
    if model.feedforward is not None:
        return VoltageFeed(1.0, model.feedforward.kV)
    if any(clock.get(quantity) is not None for quantity in DRIVE_CHANNELS) or drive_of(record, model) is not None:
        return None
    if model.torque_constant is None or model.phase_resistance is None:
        return None
    gain = model.torque_constant / model.phase_resistance
    return VoltageFeed(gain, gain * (model.back_emf_constant or model.torque_constant))


def add_rig_signals(record: Record, s: Signals) -> None:
    """Add a servo's current, the torque that acts on friction, and the direction of creeping motion to the signals."""
    clock, model = record.fast, s.model
    if clock is None or s.mechanical == "locked":
        return
    if clock.units.get(("angle", "test")) == "m":
        s.angle = None  # a carriage does not turn: effects over a turn and bristles in radians do not apply
    servo = drive_of(record, model)
    if servo is not None and s.current is None and s.velocity is not None:
        servo_current(clock, servo, s)
    if (feed := voltage_feed(record, model)) is not None and s.velocity is not None and s.voltage is not None:
        s.current = None  # with a feedforward the torque of a current is unknown
        s.extra["fed"] = feed.gain * s.voltage
        s.extra["fed_emf"] = -feed.damping * s.velocity
        if model.load.type != "none":
            s.torque = s.extra["fed"] + s.extra["fed_emf"]
    elif s.current is None and (torque := logged_torque(clock, model)) is not None:
        s.extra["told"] = torque
        logs_torque, logs_torque_reference = (clock.get(name) is not None for name in ("torque", "torque_reference"))
        if logs_torque_reference or not logs_torque:
            s.extra["commanded"] = torque  # not a sensor's reading
        if not (logs_torque_reference or logs_torque):
            s.extra["torque_of_current_reference"] = torque  # by the model's torque constant
    if model.load.type != "none" and s.current is not None and model.torque_constant is not None:
        # a gear's friction grows with the motor's torque; a released pendulum has bearing friction alone
        s.torque = model.torque_constant * s.current
    if s.angle is not None and s.velocity is not None and s.mechanical == "free" and is_creeping(clock, s.velocity):
        # a chain of rests needs no derivatives: its samples are not smoothed, so that fine waves keep their height
        s.angle, s.current = clock.values["angle", "test"], clock.get("q_axis_current")
        s.sliding = s.extra["creep"] = creep_direction(s.angle, JITTER_COUNTS * clock.counts["angle", "test"])
    load = load_of(record, model)
    s.load_inertia = load.inertia
    if load.level_torque and s.angle is not None:
        tilt = s.angle - load.hanging_angle
        s.weight, s.weight_slope = load.level_torque * np.sin(tilt), load.level_torque * np.cos(tilt)


def servo_current(clock: Clocked, servo: DriveModel, s: Signals) -> None:
    """Set the current of a servo's voltage against the back-EMF, zero while the servo is disabled."""
    model = s.model
    constant = model.back_emf_constant or model.torque_constant
    if constant is None or model.phase_resistance is None or s.velocity is None:
        return
    reference, angle = clock.values["angle_reference", "test"], clock.values["angle", "test"]
    held_reference = np.concatenate([reference[:1], reference[:-1]])  # a reference holds until the next stamp
    demanded_volts = servo.gain * (held_reference - 0.5 * (angle + np.concatenate([angle[:1], angle[:-1]])))
    volts = np.clip(demanded_volts, -servo.voltage_limit, servo.voltage_limit)
    enabled = clock.get("drive_enabled")
    enabled_share = np.ones_like(volts) if enabled is None else (enabled > 0.5).astype(float)
    s.extra["servo_share"] = smooth(enabled_share)
    s.extra["servo_volts"] = smooth(enabled_share * volts)
    s.extra["servo_slope"] = smooth(enabled_share * (np.abs(demanded_volts) < servo.voltage_limit)) * servo.gain
    s.extra["servo_reference"] = smooth(held_reference)
    s.current = (s.extra["servo_volts"] - constant * s.extra["servo_share"] * s.velocity) / model.phase_resistance


def logged_torque(clock: Clocked, model: Model) -> Array | None:
    """Return the torque or force that a drive logs, or that of its current reference; None where it logs none."""
    for quantity in ("torque_reference", "torque"):
        values = channel_means(clock, quantity)
        if values is not None:
            return smooth(values)
    reference = channel_means(clock, "q_axis_current_reference")
    if reference is None or model.torque_constant is None:
        return None
    return np.asarray(model.torque_constant * smooth(reference), np.float64)


def is_creeping(clock: Clocked, velocity: Array) -> bool:
    """Return whether an axis moves by a few encoder counts a sample, too slowly for its speed to give its direction."""
    count = clock.counts.get(("angle", "test"), 0.0)
    fast_speed = float(np.quantile(np.abs(velocity), 0.95))
    is_slow = fast_speed < FASTEST_CREEP and fast_speed * clock.interval < CREEP_COUNTS * count
    return is_slow and float(np.ptp(clock.values["angle", "test"])) > CREEP_TRAVEL * count


def creep_direction(angle: Array, half_width: float) -> Array:
    """Return the direction of an angle's motion: 1 or -1, and a value between them until a reversal exceeds the play.

    half_width : rad, half the width of the play that the angle carries along.
    """
    travel = angle - angle[0]
    return np.asarray(np.clip((travel - play(travel, half_width)) / half_width, -1.0, 1.0), np.float64)


def moving_samples(s: Signals, count: float) -> Mask:
    """Return the samples around which the axis moves in one direction, as fast as its encoder and its run can show."""
    assert s.velocity is not None
    if "creep" in s.extra:
        return np.asarray(np.abs(s.extra["creep"]) > 0.9)
    speed = np.abs(s.velocity)
    still_speed = max(0.2 * count / s.interval, SLOW_SHARE * max(s.fastest, float(np.quantile(speed, 0.95))))
    return np.asarray(smooth((speed <= still_speed).astype(float), STILL_REACH) < 1e-3)
