"""Three phases and a housing, stepped finely: what a bound of the thermal guard is held against."""

from dataclasses import dataclass

import numpy as np

from leactl.model.motor import load_motor

LEA = load_motor("lea")[0]
NETWORK = (
    "winding_ambient_resistance",
    "winding_housing_resistance",
    "housing_ambient_resistance",
    "winding_capacitance",
    "housing_capacitance",
)
STEP_S = 0.005


@dataclass(frozen=True)
class Plant:
    """One actuator's true parameters."""

    phase_resistance: float
    resistance_coefficient: float
    winding_ambient_resistance: float
    winding_housing_resistance: float
    housing_ambient_resistance: float
    winding_capacitance: float
    housing_capacitance: float
    viscous_damping: float
    coulomb_friction: float
    current_gain: float = 1.0
    ambient: float = 25.0
    offset: float = 0.0  # of commutation, rad electrical

    @classmethod
    def inside(cls, places, offset=0.0, motor=LEA):
        """At these places of the box, -1 to 1 each: nine parameters, current, ambient."""
        t = motor.tolerances.model_dump()
        names = [name for name in cls.__annotations__ if name in t]
        values = motor.model_dump() | motor.model_dump()["thermal"]
        results = {name: values[name] * (1.0 + t[name] * place) for name, place in zip(names, places, strict=False)}
        return cls(
            **results,
            current_gain=1.0 + t["current"] * places[len(names)],
            ambient=25.0 + t["ambient_K"] * places[len(names) + 1],
            offset=offset,
        )


def advance(plant, state, current, angle, speed, tref=25.0, poles=41):
    """State after one fine step: three phases and the housing [degC]; angle in rad of the rotor as the step begins."""
    turned = poles * speed * STEP_S
    middle = poles * angle + 0.5 * turned + plant.offset + 2.0 * np.pi / 3.0 * np.arange(3)
    share = (1.0 + np.sinc(turned / np.pi) * np.cos(2.0 * middle)) / 3.0  # mean of 2/3 cos^2 over the step
    phases, housing = state[:3], state[3]
    resistance = plant.phase_resistance * (1.0 + plant.resistance_coefficient * (phases - tref))
    heat = share * resistance * (current * plant.current_gain) ** 2
    to_housing = (phases - housing) / (3.0 * plant.winding_housing_resistance)
    to_air = (phases - plant.ambient) / (3.0 * plant.winding_ambient_resistance)
    friction = (plant.coulomb_friction + plant.viscous_damping * abs(speed)) * abs(speed)
    out = (housing - plant.ambient) / plant.housing_ambient_resistance
    rates = np.empty(4)
    rates[:3] = (heat - to_housing - to_air) / (plant.winding_capacitance / 3.0)
    rates[3] = (to_housing.sum() + friction - out) / plant.housing_capacitance
    return state + STEP_S * rates


def follow(plant, currents, speeds, start=None):
    """Hottest phase, mean of the phases and housing at every fine step, shape (3, n + 1)."""
    state = np.full(4, plant.ambient if start is None else start)
    angle, found = 0.0, []
    for current, speed in zip(currents, speeds, strict=True):
        found.append((state[:3].max(), state[:3].mean(), state[3]))
        state = advance(plant, state, current, angle, speed)
        angle += speed * STEP_S
    found.append((state[:3].max(), state[:3].mean(), state[3]))
    return np.array(found).T
