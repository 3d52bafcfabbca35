"""Random plants: two actuators anywhere inside their motor's tolerances, half of them at corners, or outside the model.

Half of the corners are the one at which an actuator becomes hottest: by chance alone it would come once in 2000.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.parameters import ActuatorParameters
from leactl.model.motor import load_motor

LEA = load_motor("lea")[0]
TOLD_AMBIENT_DEGC = 25.0
assert LEA.tolerances is not None
WIDTHS: dict[str, float] = LEA.tolerances.model_dump()
ROLES = ("test", "load")
HOTTEST_SHARE = 0.5  # of the corners, that are the one at which an actuator becomes hottest
OUTSIDE = ("third node", "blocked air", "wrong convention")
MISREAD = {"2/3": 2 / 3, "sqrt(3/2)": math.sqrt(1.5), "sqrt(2)": math.sqrt(2.0), "3/2": 1.5, "sqrt(3)": math.sqrt(3.0)}
TORQUE_SHARE, TORQUE_ZERO_NM = 0.03, 0.1  # of the sensor; with 2 % of the current that is the bench's share of 5 %


@dataclass(frozen=True)
class Truth:
    """What the guard does not know: parameters, the true currents over their readings, and the ambient."""

    actuators: dict[str, ActuatorParameters]
    factors: dict[str, float]
    ambient: float  # degC
    corner: bool
    outside: str  # what no tolerance allows for; "" where the plant lies inside
    angle: float  # rad, of the rotors at the start
    misread: str = ""  # by which factor, and of which drives
    torque_gain: float = 1.0  # of the torque sensor
    torque_zero: float = 0.0  # N*m


def drawn(draw: np.random.Generator, outside: str, duration_s: float) -> Truth:
    """One plant."""
    corner = bool(draw.random() < 0.5)
    hottest = corner and bool(draw.random() < HOTTEST_SHARE)

    def place(name: str) -> float:
        if hottest:
            return _hottest(name)
        return float(draw.choice([-1.0, 1.0]) if corner else draw.uniform(-1.0, 1.0))

    actuators, factors = {}, {}
    for role in ROLES:
        phases: dict[str, float] = {"commutation_offset": float(draw.uniform(0.0, math.pi))}
        if outside == "third node":
            phases |= {"fixture_capacitance": draw.uniform(100.0, 2000.0), "fixture_resistance": draw.uniform(0.5, 5.0)}
        elif outside == "blocked air":
            factor = float(np.exp(draw.uniform(np.log(1.5), np.log(20.0))))
            phases |= {"blocked_air_factor": factor, "blocked_air_from": float(draw.uniform(0.0, duration_s))}
        actuators[role] = _actuator(place, phases)
        factors[role] = 1.0 + WIDTHS["current"] * place("current")
    ambient = TOLD_AMBIENT_DEGC + WIDTHS["ambient_K"] * place("ambient_K")
    angle, misread = float(draw.uniform(0.0, 2.0 * math.pi)), ""
    if outside == "wrong convention":
        name, whose = str(draw.choice(list(MISREAD))), str(draw.choice([*ROLES, "both"]))
        misread = f"{name} {whose}"
        factors = {r: factor * (MISREAD[name] if whose in (r, "both") else 1.0) for r, factor in factors.items()}
    gain, zero = float(draw.uniform(-1.0, 1.0)), float(draw.uniform(-1.0, 1.0))
    if corner:
        gain, zero = math.copysign(1.0, gain), math.copysign(1.0, zero)
    sensor = 1.0 + TORQUE_SHARE * gain, TORQUE_ZERO_NM * zero
    return Truth(actuators, factors, ambient, corner, outside, angle, misread, *sensor)


def at_the_corner(offset: float) -> Truth:
    """The plant whose tolerances all add to its heat, commutated at this offset [rad]."""
    actuators = {role: _actuator(_hottest, {"commutation_offset": offset}) for role in ROLES}
    factors = dict.fromkeys(ROLES, 1.0 + WIDTHS["current"])
    return Truth(actuators, factors, TOLD_AMBIENT_DEGC + WIDTHS["ambient_K"], True, "", 0.0)


def _hottest(name: str) -> float:
    return -1.0 if name.endswith("capacitance") else 1.0


def _actuator(place: Callable[[str], float], phases: dict[str, float]) -> ActuatorParameters:
    """An actuator whose parameters lie where `place` says, from -1 to 1 across their tolerances."""
    whole = LEA.model_dump(exclude={"name", "limits", "tolerances"})
    kept = {name: value * (1.0 + WIDTHS[name] * place(name)) for name, value in _numbers(whole) if WIDTHS.get(name)}
    thermal = {name: value * (1.0 + WIDTHS[name] * place(name)) for name, value in _numbers(whole["thermal"])}
    return ActuatorParameters.from_mapping(kept | {"thermal": thermal, "phases": phases})


def _numbers(values: dict) -> list[tuple[str, float]]:
    return [(name, value) for name, value in values.items() if isinstance(value, float)]
