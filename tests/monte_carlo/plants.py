"""Random plants: two actuators anywhere inside their motor's tolerances, half of them at corners, or outside the model.

Half of the corners are the one at which an actuator becomes hottest: by chance alone it would come once in 2000.
"""

import math
from dataclasses import dataclass

import numpy as np

from leactl.emulation.parameters import ActuatorParameters
from leactl.model.motor import load_motor

LEA = load_motor("lea")[0]
TOLD_AMBIENT_DEGC = 25.0
ROLES = ("test", "load")
HOTTEST_SHARE = 0.5  # of the corners, that are the one at which an actuator becomes hottest
OUTSIDE = ("third node", "blocked air", "wrong convention")


@dataclass(frozen=True)
class Truth:
    """What the guard does not know: parameters, the true currents over their readings, and the ambient."""

    actuators: dict[str, ActuatorParameters]
    factors: dict[str, float]
    ambient: float  # degC
    corner: bool
    outside: str  # what no tolerance allows for; "" where the plant lies inside
    angle: float  # rad, of the rotors at the start


def drawn(draw: np.random.Generator, outside: str, duration_s: float) -> Truth:
    """One plant."""
    tolerances = LEA.tolerances
    assert tolerances is not None
    widths = tolerances.model_dump()
    whole = LEA.model_dump(exclude={"name", "limits", "tolerances"})
    corner = bool(draw.random() < 0.5)
    hottest = corner and bool(draw.random() < HOTTEST_SHARE)

    def place(name: str) -> float:
        """Where in its tolerance a parameter lies, from -1 to 1."""
        if hottest:
            return -1.0 if name.endswith("capacitance") else 1.0
        return float(draw.choice([-1.0, 1.0]) if corner else draw.uniform(-1.0, 1.0))

    actuators, factors = {}, {}
    for role in ROLES:
        values = {name: value * (1.0 + widths.get(name, 0.0) * place(name)) for name, value in _numbers(whole)}
        thermal = {
            name: value * (1.0 + widths.get(name, 0.0) * place(name)) for name, value in _numbers(whole["thermal"])
        }
        phases: dict[str, float] = {"commutation_offset": float(draw.uniform(0.0, math.pi))}
        factors[role] = 1.0 + widths["current"] * place("current")
        if outside == "third node":
            phases |= {"fixture_capacitance": draw.uniform(100.0, 2000.0), "fixture_resistance": draw.uniform(0.5, 5.0)}
        elif outside == "blocked air":
            factor = float(np.exp(draw.uniform(np.log(1.5), np.log(20.0))))
            phases |= {"blocked_air_factor": factor, "blocked_air_from": float(draw.uniform(0.0, duration_s))}
        elif outside == "wrong convention":
            factors[role] *= math.sqrt(2.0)
        kept = {name: value for name, value in values.items() if widths.get(name)}
        actuators[role] = ActuatorParameters.from_mapping(kept | {"thermal": thermal, "phases": phases})
    ambient = TOLD_AMBIENT_DEGC + widths["ambient_K"] * place("ambient_K")
    return Truth(actuators, factors, ambient, corner, outside, float(draw.uniform(0.0, 2.0 * math.pi)))


def _numbers(values: dict) -> list[tuple[str, float]]:
    return [(name, value) for name, value in values.items() if isinstance(value, float)]
