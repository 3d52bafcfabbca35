"""Torque balance of a foreign axis: driven by a servo, a logged force or voltage, loaded by a weight, or creeping."""

import numpy as np
import numpy.typing as npt

from leactl.effects.contract import Signals
from leactl.gap.equations.contract import Equation, Place
from leactl.gap.equations.mechanical import load_angle_nuisance, load_torque
from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.record import Clocked, Record
from leactl.gap.signals.rig import drive_of, moving_samples, voltage_feed
from leactl.gap.signals.smoothing import noise_of_acceleration, slope, smooth
from leactl.gap.signals.stamps import stamp_columns

Array = npt.NDArray[np.float64]
SMOOTHING_WIDTHS = (4.0, 8.0, 12.0)  # samples, widths of the smoothing of a fed motor that are tried in this order
MOST_INERTIAL_NOISE = 2e-3  # root mean square of the inertial torque's noise over that of the voltage's torque
TIMING_SAMPLES = 2.0  # samples, prior error of a reference's time: reference and feedback both pass the servo's bus


def axis_torque(record: Record, s: Signals) -> Equation | None:
    """Return the torque balance of an axis, drive torque = J dw/dt + b w + f sgn(w) + load torque; None without one.

    It replaces the balance of the bench's free rotor where the axis is driven or loaded in another way, or creeps.
    """
    clock, model = record.fast, s.model
    if clock is None or s.mechanical == "locked" or s.velocity is None or s.acceleration is None or s.sliding is None:
        return None
    if model.rotor_inertia is None or (s.mechanical == "coupled" and model.load.type == "none"):
        return None
    servo = drive_of(record, model)
    drive_terms = drive_torque(s)
    is_coupled = s.mechanical == "coupled"  # to a load; the balance of a free rotor has its load
    if drive_terms is None or not (servo or s.current is None or is_coupled or "creep" in s.extra):
        return None
    torque, calibration, places = drive_terms
    inertia = model.rotor_inertia
    damping, friction = model.viscous_damping or 0.0, model.coulomb_friction or 0.0
    resisting_columns = {
        "rotor_inertia": inertia * s.acceleration,
        "viscous_damping": damping * s.velocity,
        "coulomb_friction": friction * s.sliding,
    }
    nuisance = load_angle_nuisance(s)
    if "servo_slope" in s.extra and model.torque_constant and model.phase_resistance:
        voltage_rate = s.extra["servo_slope"] * slope(s.extra["servo_reference"], s.interval)
        column = voltage_rate * model.torque_constant / model.phase_resistance
        nuisance["reference_timing_s"] = (column, TIMING_SAMPLES * s.interval)
    shared = dict[str, tuple[Array, float]]()
    resisting_torque = sum(resisting_columns.values()) + load_torque(s)
    if (feed := voltage_feed(record, model)) is not None:
        damping += feed.damping
        shared = stamp_columns("axis_torque", clock, _FEED_CHANNELS, -s.extra["fed"])
        if model.feedforward is None:
            # columns of the motion's torque, not of the voltage: else all torques would shrink together
            calibration = {
                "phase_resistance": resisting_torque,
                "torque_constant": -(resisting_torque + s.extra["fed_emf"]),
            }
        else:
            calibration = {"feedforward.kV": -s.extra["fed_emf"]}
            resisting_columns = {
                VOLT_PARAMETERS[name]: column for name, column in resisting_columns.items() if name in VOLT_PARAMETERS
            }
    places["drag"] = lambda c: c
    places["angle_reading"] = lambda c: _angle_error(c, s.interval, inertia + s.load_inertia, damping)
    mask = moving_samples(s, clock.counts.get(("angle", "test"), 0.0))
    mask &= clock.all_valid(*((quantity, "test") for quantity in ("angle", *_DRIVE_CHANNELS)))
    if feed is not None:
        mask &= clock.all_valid(*_FEED_CHANNELS)
    if "servo_share" in s.extra:
        share = s.extra["servo_share"]
        mask &= (share < 1e-3) | (share > 1 - 1e-3)
    return Equation(
        "axis_torque",
        "velocity" if servo is None else "angle",
        "test",
        "N" if clock.units.get(("angle", "test")) == "m" else model.units_of("N*m"),
        torque - resisting_torque,
        s,
        np.asarray(mask, np.bool_),
        places,
        calibration | resisting_columns,
        shared=nuisance | shared,
        width=1.0 if "creep" in s.extra else 4.0 if feed is None else fed_motor_width(clock, s),
        step=2 if "creep" in s.extra else 8,
    )


VOLT_PARAMETERS = {"rotor_inertia": "feedforward.kA", "coulomb_friction": "feedforward.kS"}
"""Parameters of a balance in newton metres, and their counterparts where torques are in volts."""
_FEED_CHANNELS = ("q_axis_voltage", "test"), ("angle", "test"), ("velocity", "test")
_DRIVE_CHANNELS = ("q_axis_current", "q_axis_current_reference", "torque_reference", "angle_reference", "drive_enabled")


def fed_motor_width(clock: Clocked, s: Signals) -> float:
    """Return the least smoothing [samples] at which the acceleration noise of a fed motor is small; else the largest.

    The limit is `MOST_INERTIAL_NOISE`. Where the torque of inertia is noisier, a fit lowers the inertia and names an
    effect instead.
    """
    noise = noise_of(clock.values["angle", "test"]) if s.angle is not None else 0.0
    inertia = (s.model.rotor_inertia or 0.0) + s.load_inertia
    largest_noise = MOST_INERTIAL_NOISE * float(np.sqrt(np.mean(s.extra["fed"] ** 2)))
    for width in SMOOTHING_WIDTHS:
        if inertia * noise_of_acceleration(noise, s.interval, width) <= largest_noise:
            return width
    return SMOOTHING_WIDTHS[-1]


def drive_torque(s: Signals) -> tuple[Array, dict[str, Array], dict[str, Place]] | None:
    """Return the torque of the drive, its parameters' columns and the places of effects on it; None without a drive.

    The gain of a logged force is not fitted: runs tell only its ratio to mass and friction. That of a current's
    reference is, where the model has a weight.
    """
    model = s.model
    if "fed" in s.extra:
        return s.extra["fed"] + s.extra["fed_emf"], {}, {}
    if s.current is None:
        logged_torque = s.extra.get("told")
        if logged_torque is None:
            return None
        torque_per_reading = model.torque_constant or 1.0  # a logged force counts as a current
        has_weight = model.load.type != "none"  # without one the gain is not identifiable
        return (
            logged_torque,
            {"torque_constant": -logged_torque} if has_weight and "torque_of_current_reference" in s.extra else {},
            {"torque_factor": lambda c: -logged_torque * c, "current_reading": lambda c: torque_per_reading * c},
        )
    constant = model.torque_constant
    if constant is None:
        return None
    current, torque = s.current, constant * s.current
    places: dict[str, Place] = {"torque_factor": lambda c: -torque * c}
    if "servo_volts" not in s.extra:
        if model.load.type != "none":
            return torque, {"torque_constant": -torque}, places | {"current_reading": lambda c: constant * c}
        # without a weight the gain is not identifiable, and would absorb a whole creep
        return torque, {}, {} if "creep" in s.extra else places
    resistance = model.phase_resistance or np.inf
    emf_torque = torque - constant * s.extra["servo_volts"] / resistance  # negative at positive speed
    places["voltage"] = lambda c: constant * s.extra["servo_share"] * c / resistance
    places["emf_factor"] = lambda c: -emf_torque * c
    calibration = {"phase_resistance": torque, "torque_constant": -(constant * current + emf_torque)}
    return torque, calibration, places


def _angle_error(column: Array, interval: float, inertia: float, damping: float) -> Array:
    """Return the torque [N*m] that an error of the angle [rad] adds to the balance's inertia and damping."""
    speed = slope(smooth(column), interval)
    return -(inertia * slope(speed, interval) + damping * speed)


def confounded_note(record: Record, s: Signals) -> str | None:
    """Return a note on parameters that a rig with one mass at one length cannot separate; None for other rigs."""
    if "servo_volts" not in s.extra or s.model.load.type == "none":
        return None
    return (
        f"{record.path.name}: a position servo without a current channel: torque_constant, phase_resistance and"
        " load_dependent_friction share one scale where there is one mass at one length, so that each holds only with"
        " the others; add a run with a second mass or length, or log the current"
    )
