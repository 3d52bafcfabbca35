"""Make a table of an augmented model for other simulators: joint, actuator, effects with units and meanings."""

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
    """Return the inertia of rotor and load, and the load's weight."""
    load = model.load
    return {
        "rotor_kg_m2": model.rotor_inertia,
        "load_kg_m2": load.inertia,
        "load_level_torque_Nm": load.level_torque,
        "load_hanging_angle_rad": load.hanging_angle if load.type != "none" else None,
    }


def _friction(model: Model) -> dict[str, Any]:
    """Return the friction at rest and while sliding, and the damping of friction and of the back-EMF."""
    sliding_torque = breakaway_torque = model.coulomb_friction
    for entry in model.effects:
        if entry.effect == "stribeck" and breakaway_torque is not None:
            breakaway_torque *= 1.0 + entry.parameters["breakaway_ratio"]
    servo = servo_figures(model)
    return {
        "static_Nm": breakaway_torque,
        "dynamic_Nm": sliding_torque,
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
    """Return the delay of the command in seconds, and in steps if a step [s] is given."""
    delay = sum(entry.parameters["delay"] for entry in model.effects if entry.effect == "transport_delay")
    return {"delay_s": delay, "timestep_s": timestep, "steps": None if timestep is None else round(delay / timestep)}


def _effect(model: Model, name: str, parameters: dict[str, float]) -> dict[str, Any]:
    """Return an effect with its meaning, and its parameters with their units and meanings."""
    definition = effect_definition(name)
    return {
        "effect": name,
        "family": definition.family,
        "meaning": definition.meaning,
        "parameters": [
            {
                "name": parameter,
                "value": parameters.get(parameter, parameter_definition.default),
                "units": model.units_of(parameter_definition.units),
                "meaning": parameter_definition.meaning,
            }
            for parameter, parameter_definition in definition.parameters.items()
        ],
    }
