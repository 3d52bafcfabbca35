"""An augmented model as a table for other simulators: figures of joint and actuator, effects with units and meaning."""

from typing import Any

from leactl.exchange.robot_joint import rounded
from leactl.exchange.robot_patch import servo_figures
from leactl.model.nominal import Model
from leactl.vocabulary.effect import effect_definition

FORMAT, VERSION = "leactl-actuator", 1


def actuator_table(model: Model, joint: str, timestep: float | None = None) -> dict[str, Any]:
    """Return the table of a model; a figure that the model lacks is None.

    Parameters
    ----------
    timestep : step [s] of the simulation; with it, the delay is stated in steps too.
    """
    figures = {
        "format": FORMAT,
        "format_version": VERSION,
        "model": model.name,
        "joint": joint,
        "gear_ratio": model.gear_ratio,
        "inertia": _inertia(model),
        "friction": _friction(model),
        "actuator": _actuator(model),
        "delay": _delay(model, timestep),
        "effects": [_effect(model, entry.effect, entry.parameters) for entry in model.effects],
    }
    table: dict[str, Any] = rounded(figures)
    return table


def _inertia(model: Model) -> dict[str, Any]:
    load = model.load
    return {
        "rotor_kg_m2": model.rotor_inertia,
        "load_kg_m2": load.inertia,
        "load_level_torque_Nm": load.level_torque,
        "load_hanging_angle_rad": load.hanging_angle if load.type != "none" else None,
    }


def _friction(model: Model) -> dict[str, Any]:
    """Return friction at rest, while sliding and with speed."""
    sliding = at_rest = model.coulomb_friction
    for entry in model.effects:
        if entry.effect == "stribeck" and at_rest is not None:
            at_rest *= 1.0 + entry.parameters["breakaway_ratio"]
    servo = servo_figures(model)
    return {
        "static_Nm": at_rest,
        "dynamic_Nm": sliding,
        "viscous_Nm_s_per_rad": model.viscous_damping,
        "back_emf_Nm_s_per_rad": servo.braking if servo else None,
    }


def _actuator(model: Model) -> dict[str, Any]:
    """Return stiffness, limits and torque constant of the actuator."""
    servo, constant = servo_figures(model), model.torque_constant
    limits = [entry.parameters["current"] for entry in model.effects if entry.effect == "torque_limit"]
    effort = servo.limit if servo else min(limits) * constant if limits and constant is not None else None
    return {
        "type": "position_servo" if servo else "torque",
        "stiffness_Nm_per_rad": servo.stiffness if servo else None,
        "effort_limit_Nm": effort,
        "velocity_limit_rad_per_s": servo.top_speed if servo else None,
        "torque_constant_Nm_per_A": constant,
        "current_loop_bandwidth_Hz": model.bench.current_loop_bandwidth,
    }


def _delay(model: Model, timestep: float | None) -> dict[str, Any]:
    delay = sum(entry.parameters["delay"] for entry in model.effects if entry.effect == "transport_delay")
    return {"delay_s": delay, "timestep_s": timestep, "steps": None if timestep is None else round(delay / timestep)}


def _effect(model: Model, name: str, parameters: dict[str, float]) -> dict[str, Any]:
    definition = effect_definition(name)
    return {
        "effect": name,
        "family": definition.family,
        "meaning": definition.meaning,
        "parameters": [
            {
                "name": parameter,
                "value": parameters.get(parameter, about.default),
                "units": model.units_of(about.units),
                "meaning": about.meaning,
            }
            for parameter, about in definition.parameters.items()
        ],
    }
