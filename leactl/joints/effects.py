"""Effects of a specimen, drawn at a strength; their sizes are declared relative to scales of the machine."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from leactl.joints.machine import Generator, JointMachine, package_yaml

STRENGTHS = ("faint", "plain", "strong")
SIZE_SPREAD = 0.15  # largest relative departure of a size from the usual size of its strength
SLOWEST_LEVEL = 0.03  # slowest held level, as a share of the highest speed
SWING_RATE_SHARES = (0.01, 0.04)  # natural frequency of an elastic load, as a share of the sampling rate
NO_LOAD_SPEED_RATIOS = (1.1, 1.4)  # no-load speed of a drive at the end of its voltage, over the highest speed
LOAD_SHARES = (0.3, 0.8)  # inertia of a load behind a gear, as a share of the whole inertia
SAMPLES_A_PERIOD = 4.0  # samples that a periodic effect needs in a period at the slowest level


@dataclass(frozen=True)
class DrawnEffect:
    """One effect with its parameters; effects of the vocabulary have the vocabulary's names."""

    name: str
    strength: str
    parameters: Mapping[str, float]


def listed_rules() -> dict[str, Mapping[str, Any]]:
    """Return the rules for the effects of the vocabulary that a joint may have, by name."""
    return {name: rule for name, rule in package_yaml("sizes.yaml").items() if name != "unlisted"}


def unlisted_rules() -> Mapping[str, Mapping[str, Any]]:
    """Return the rules for the effects that are not in the vocabulary, by name."""
    rules: Mapping[str, Mapping[str, Any]] = package_yaml("sizes.yaml")["unlisted"]
    return rules


def showable_effects(machine: JointMachine) -> list[str]:
    """Return the names of the effects of the vocabulary that this machine may have and its channels can show."""
    return [
        name
        for name, rule in listed_rules().items()
        if set(rule["needs"]) <= set(machine.channels) and machine.kind in rule.get("kinds", [machine.kind])
    ]


def indistinguishable_effects(name: str) -> list[str]:
    """Return the names of the effects that no record of a free joint without a voltage can tell from an effect."""
    return list(listed_rules()[name].get("alike", [])) if name in listed_rules() else []


def excluded_effects(name: str) -> list[str]:
    """Return the names of the effects that are not drawn with an effect, since they exclude it or are like it."""
    return [*indistinguishable_effects(name), *listed_rules()[name].get("not_beside", [])]


def draw_effect(draw: Generator, machine: JointMachine, name: str, strength: str) -> DrawnEffect:
    """Draw an effect's parameters at a strength, in SI units."""
    rule = listed_rules()[name] if name in listed_rules() else unlisted_rules()[name]
    spread = 1.0 + SIZE_SPREAD * float(draw.uniform(-1.0, 1.0))
    size = rule[strength] * spread * machine.scale(rule["in"])
    if rule.get("signed") and draw.random() < 0.5:
        size = -size
    return DrawnEffect(name, strength, {rule["size"]: size, **draw_secondary_parameters(draw, machine, name)})


def draw_secondary_parameters(draw: Generator, machine: JointMachine, name: str) -> dict[str, float]:
    """Draw the parameters of an effect other than its size."""
    phase = {"phase": float(draw.uniform(-np.pi, np.pi))}
    slowest_speed = SLOWEST_LEVEL * machine.speed
    if name in ("cogging", "torque_ripple"):
        highest_order = 2.0 * np.pi * machine.rate / SAMPLES_A_PERIOD / slowest_speed
        orders = [order for order in (1, 2, 6) if order * machine.pole_pairs <= highest_order] or [1]
        return {"order": float(draw.choice(orders) * machine.pole_pairs), **phase}
    if name == "position_dependent_friction":
        return {"order": float(draw.choice([1, 2, 3, 6, 8, 12])), **phase}
    if name in ("unbalance", "gravity_load", "encoder_eccentricity"):
        return phase
    if name == "stribeck":
        return {"stribeck_velocity": machine.speed * float(draw.uniform(0.01, 0.05))}
    if name == "friction_run_in":
        return {"time_constant": machine.seconds * float(draw.uniform(0.2, 0.5))}
    if name == "saturation":
        return {"exponent": 2.0, "current": machine.current}
    if name == "push_in_time":
        return {"frequency": float(draw.uniform(3.0, 60.0)) / machine.seconds, **phase}
    if name == "rubbing_bursts":
        return {"period": machine.seconds * float(draw.uniform(0.03, 0.12)), **phase}
    if name == "joint_elasticity":
        lowest, highest_order = (share * machine.rate for share in SWING_RATE_SHARES)
        return {
            "frequency": float(np.exp(draw.uniform(np.log(lowest), np.log(highest_order)))),
            "damping_ratio": float(draw.uniform(0.02, 0.1)),
        }
    if name == "gear_backlash":
        share = float(draw.uniform(*LOAD_SHARES))
        return {"share": share, "friction": share * float(draw.uniform(0.0, 1.0))}
    if name == "voltage_limit":
        return {"no_load_speed": machine.speed * float(draw.uniform(*NO_LOAD_SPEED_RATIOS))}
    if name == "position_spring":
        reach = machine.speed * machine.seconds * float(draw.uniform(0.02, 0.1))
        return {"rest_angle": float(draw.uniform(-np.pi, np.pi)), "reach": reach}
    return {}
