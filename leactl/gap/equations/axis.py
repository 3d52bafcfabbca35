"""Torque balance of a foreign axis: driven by a servo or a logged force, loaded by a pendulum, or creeping."""

import numpy as np
import numpy.typing as npt

from leactl.effects.contract import Signals
from leactl.gap.equations.contract import Equation, Place
from leactl.gap.record import Record
from leactl.gap.rig import drive_of, in_motion, level_torque, load_inertia, load_of
from leactl.gap.smoothing import slope, smooth

Array = npt.NDArray[np.float64]
ZERO_PRIOR = 0.1  # rad, of where a pendulum hangs straight down
TIMING_SAMPLES = 2.0  # a reference goes over the servo's bus before it counts, its feedback comes back over it


def axis(record: Record, s: Signals) -> Equation | None:
    """What drives the axis = J dw/dt + b w + f sgn(w) + what hangs on it.

    Stands in for the balance of the bench's free rotor where the axis is driven or loaded in another way, or creeps.
    """
    clock, model = record.fast, s.model
    if clock is None or s.mechanical == "locked" or s.velocity is None or s.acceleration is None or s.sliding is None:
        return None
    if model.rotor_inertia is None or (s.mechanical == "coupled" and model.load.type == "none"):
        return None
    load, servo = load_of(record, model), drive_of(record, model)
    driven = drive(s)
    if driven is None or not (servo or s.current is None or load.type != "none" or "creep" in s.extra):
        return None
    torque, calibration, places = driven
    hanging, inertia = level_torque(load), model.rotor_inertia
    damping, friction = model.viscous_damping or 0.0, model.coulomb_friction or 0.0
    weight = hanging * np.sin(s.angle) if s.angle is not None else np.zeros_like(torque)
    own = {
        "rotor_inertia": inertia * s.acceleration,
        "viscous_damping": damping * s.velocity,
        "coulomb_friction": friction * s.sliding,
    }
    nuisance: dict[str, tuple[Array, float]] = {}
    if hanging and s.angle is not None:
        nuisance["load_zero_rad"] = (hanging * np.cos(s.angle), ZERO_PRIOR)
    if "servo_slope" in s.extra and model.torque_constant and model.phase_resistance:
        late = s.extra["servo_slope"] * slope(s.extra["servo_reference"], s.interval)
        column = late * model.torque_constant / model.phase_resistance
        nuisance["reference_timing_s"] = (column, TIMING_SAMPLES * s.interval)
    swung = load_inertia(load)
    places["drag"] = lambda c: c
    places["angle_reading"] = lambda c: _angle_error(c, s.interval, inertia + swung, damping)
    mask = in_motion(s, clock.counts.get(("angle", "test"), 0.0))
    mask &= clock.all_valid(*((quantity, "test") for quantity in ("angle", *_DRIVES)))
    if "servo_share" in s.extra:
        share = s.extra["servo_share"]
        mask &= (share < 1e-3) | (share > 1 - 1e-3)
    return Equation(
        "axis_torque",
        "velocity" if servo is None else "angle",
        "test",
        "N" if clock.units.get(("angle", "test")) == "m" else "N*m",
        torque - sum(own.values()) - swung * s.acceleration - weight,
        s,
        np.asarray(mask, np.bool_),
        places,
        calibration | own,
        shared=nuisance,
        width=1.0 if "creep" in s.extra else 4.0,
        step=2 if "creep" in s.extra else 8,
    )


_DRIVES = ("q_axis_current", "q_axis_current_reference", "torque_reference", "angle_reference", "drive_enabled")


def drive(s: Signals) -> tuple[Array, dict[str, Array], dict[str, Place]] | None:
    """Torque of the drive, its parameters' columns and the places of effects on it.

    A logged force is taken as it is: only its ratio to mass and friction shows, so that its gain stays as it was set.
    """
    model = s.model
    if s.current is None:
        logged = s.extra.get("told")
        if logged is None:
            return None
        scale = model.torque_constant or 1.0  # a logged force is its own current
        return logged, {}, {"torque_factor": lambda c: -logged * c, "current_reading": lambda c: scale * c}
    constant = model.torque_constant
    if constant is None:
        return None
    current, torque = s.current, constant * s.current
    places: dict[str, Place] = {"torque_factor": lambda c: -torque * c}
    if "servo_volts" not in s.extra:
        if model.load.type != "none":
            return torque, {"torque_constant": -torque}, places | {"current_reading": lambda c: constant * c}
        # without a weight a gain shows no more than a logged force's would, and would take all of a creep as its own
        return torque, {}, {} if "creep" in s.extra else places
    resistance = model.phase_resistance or np.inf
    emf = torque - constant * s.extra["servo_volts"] / resistance  # negative where the axis moves ahead
    places["voltage"] = lambda c: constant * s.extra["servo_share"] * c / resistance
    places["emf_factor"] = lambda c: -emf * c
    columns = {"phase_resistance": torque, "torque_constant": -(constant * current + emf)}
    return torque, columns, places


def _angle_error(column: Array, interval: float, inertia: float, damping: float) -> Array:
    speed = slope(smooth(column), interval)
    return -(inertia * slope(speed, interval) + damping * speed)


def confounded(record: Record, s: Signals) -> str | None:
    """What one mass at one length leaves open on a servo's rig, as a note; None where no servo drives one."""
    if "servo_volts" not in s.extra or s.model.load.type == "none":
        return None
    return (
        f"{record.path.name}: a position servo without a current channel: torque_constant, phase_resistance and"
        " load_dependent_friction share one scale where there is one mass at one length, so that each holds only with"
        " the others; add a run with a second mass or length, or log the current"
    )
