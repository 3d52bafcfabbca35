"""Destination of each effect of a model in MuJoCo: the MJCF file, the callbacks, or none, with the reason."""

from collections.abc import Iterator
from dataclasses import dataclass

from leactl.model.nominal import EffectEntry, Model
from leactl.vocabulary.effect import effect_definition

MJCF, CALLBACKS, NOWHERE = "mjcf", "callbacks", "nowhere"
SERVO, CURRENT = "position servo", "torque actuator"
ACTS_ON = {
    "asymmetric_friction": "joint",
    "cogging": "joint",
    "command_slew_limit": CURRENT,
    "current_sensor_gain": CURRENT,
    "current_sensor_offset": CURRENT,
    "dead_time": SERVO,
    "encoder_eccentricity": "joint",
    "friction_run_in": "joint",
    "gravity_load": "joint",
    "load_dependent_friction": "drive",
    "position_dependent_friction": "joint",
    "position_spring": "joint",
    "power_foldback": CURRENT,
    "presliding": "joint",
    "quadratic_drag": "joint",
    "reference_rate_limit": SERVO,
    "saturation": "drive",
    "servo_dead_band": SERVO,
    "stribeck": "joint",
    "torque_limit": CURRENT,
    "torque_ripple": "drive",
    "transmission_error": "joint",
    "transport_delay": "drive",
    "unbalance": "joint",
    "voltage_limit": CURRENT,
}
"""What each effect of the callbacks acts on: the joint, a drive of either kind, or a drive of one kind."""
EFFECTS_IN_AMPERES = (
    "command_slew_limit",
    "current_sensor_offset",
    "power_foldback",
    "saturation",
    "torque_limit",
    "voltage_limit",
)
SECOND_BODY = "a second body behind the joint would have to be added"
TEMPERATURES = "MuJoCo has no temperatures"
REASON_OF_EFFECT = {
    "backlash": SECOND_BODY,
    "bus_sag": "MuJoCo has no supply",
    "friction_temperature": TEMPERATURES,
    "gear_backlash": SECOND_BODY,
    "joint_elasticity": SECOND_BODY,
    "magnet_temperature": TEMPERATURES,
    "shaft_compliance": SECOND_BODY,
    "velocity_filter_lag": "it changes a reading alone; filter qvel where it is read",
}
REASON_OF_FAMILY = {"sensor": "it changes the reading of a sensor that MuJoCo does not have", "thermal": TEMPERATURES}
UNKNOWN_EQUATION = "its equation is not among those of the callbacks"


@dataclass(frozen=True)
class Destination:
    """An effect of a model, and where it is exported to."""

    entry: EffectEntry
    goes_to: str  # mjcf, callbacks or nowhere
    reason: str  # why it goes nowhere; empty otherwise


def destinations(model: Model, law: str | None) -> Iterator[Destination]:
    """Yield each effect of a model with the file that holds it, or with the reason why no file does.

    Parameters
    ----------
    law : law of the joint's actuator: `SERVO`, `CURRENT`, or None if the callbacks cannot replace it.
    """
    springs = [entry for entry in model.effects if entry.effect == "position_spring"]
    for entry in model.effects:
        if springs == [entry] and "reach" not in entry.parameters:
            yield Destination(entry, MJCF, "")
        else:
            reason = _reason_against(entry.effect, model, law)
            yield Destination(entry, NOWHERE if reason else CALLBACKS, reason)


def _reason_against(effect: str, model: Model, law: str | None) -> str:
    """Return the reason why callbacks cannot hold an effect; empty if they can."""
    acts_on = ACTS_ON.get(effect)
    if acts_on is None:
        return REASON_OF_EFFECT.get(effect) or REASON_OF_FAMILY.get(effect_definition(effect).family, UNKNOWN_EQUATION)
    if acts_on == "joint":
        return ""
    if law is None or acts_on not in ("drive", law):
        drive_kind = "drive" if acts_on == "drive" else acts_on
        return f"it acts on a {drive_kind}, and the joint has none that the model describes"
    if effect in EFFECTS_IN_AMPERES and model.torque_constant is None:
        return "it is in A, and the model has no torque_constant"
    return ""
