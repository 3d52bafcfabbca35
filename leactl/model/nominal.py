"""Model files: what one believes of a bench, whole or in part, as the gap diagnosis and the simulator read them.

A motor file says all of one actuator; a model file may leave out what the runs cannot show, and adds the bench around
it (`bench:`), what a foreign rig moves (`load:`) and how it is driven (`drive:`), and effects with their parameters.
SI throughout; for a linear axis the same keys stand for m, N and kg, and `units:` renames them in reports. All figures
are at the joint, behind its gear: a torque is what the joint feels, an angle what the joint turns by.
"""

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from leactl import yamlfile
from leactl.model.motor_schema import MotorSheet, NotNegative, Positive, Thermal
from leactl.vocabulary.effect import effect_definition, effect_names
from leactl.yamlblock import Block

Angle = Annotated[float, Field(strict=True, ge=-10.0, le=10.0)]  # rad
MOST_OFFSET = 20.0  # K, of the logged ambient: beyond that it is of another place


class BenchModel(Block):
    """What the supply, the sensors and the loops do."""

    bus_voltage: Positive | None = None  # V
    current_loop_bandwidth: Positive | None = None  # Hz, first order
    setpoint_lead: NotNegative = 0.0  # share by which the drive's current setpoint counts for more at first
    setpoint_lead_time: Positive = 0.06  # s, in which that fades
    velocity_filter_bandwidth: Positive | None = None  # Hz, first order
    torque_filter_bandwidth: Positive | None = None  # Hz, first order
    shaft_stiffness: Positive | None = None  # N*m/rad, between test and load actuator


class LoadModel(Block):
    """What hangs on the shaft: nothing, a pendulum or the arm of a joint; friction of a load actuator.

    A pendulum is a point mass on an arm and hangs straight down at angle zero; an arm is a point mass that stands
    `zero_angle` above level where the joint reads zero, so that gravity takes mass g length cos(angle + zero_angle).
    """

    type: Literal["none", "pendulum", "arm"] = "none"
    mass: NotNegative = 0.0  # kg
    length: NotNegative = 0.0  # m
    arm_mass: NotNegative = 0.0  # kg, of a pendulum's own arm, evenly along it
    zero_angle: Angle = 0.0  # rad, of an arm
    gravity: Positive = 9.80665  # m/s^2
    viscous_damping: NotNegative | None = None  # N*m*s/rad, of the load actuator; by default the test actuator's
    coulomb_friction: NotNegative | None = None  # N*m, the same

    def frictions(self, viscous: float | None, coulomb: float | None) -> tuple[float, float]:
        """Viscous damping [N*m*s/rad] and Coulomb friction [N*m] of the load actuator.

        Parameters
        ----------
        viscous, coulomb : of the test actuator: the load's where it has none of its own, 0 where neither has.
        """
        own = (self.viscous_damping, viscous), (self.coulomb_friction, coulomb)
        damping, friction = (of_test or 0.0 if of_load is None else of_load for of_load, of_test in own)
        return damping, friction

    @model_validator(mode="after")
    def _of_its_type(self) -> "LoadModel":
        if self.type != "arm" and self.zero_angle:
            raise self.faulty([(("zero_angle",), f"is an arm's; a load of type {self.type} has none")])
        if self.type == "arm" and self.arm_mass:
            raise self.faulty([(("arm_mass",), "is a pendulum's; an arm has its mass at its centre, length away")])
        if self.type == "arm" and not (self.mass and self.length):
            raise self.faulty([(("type",), "an arm has a mass and a length above zero")])
        return self

    @property
    def level_torque(self) -> float:
        """Torque that holds what hangs on the shaft out level [N*m]."""
        return 0.0 if self.type == "none" else (self.mass + 0.5 * self.arm_mass) * self.gravity * self.length

    @property
    def inertia(self) -> float:
        """Inertia of what hangs on the shaft about it [kg*m^2]."""
        return 0.0 if self.type == "none" else (self.mass + self.arm_mass / 3.0) * self.length**2

    @property
    def hanging_angle(self) -> float:
        """Angle of the shaft [rad] at which it hangs straight down: gravity takes level_torque sin(angle - this)."""
        return -0.5 * math.pi - self.zero_angle if self.type == "arm" else 0.0


class Transmission(Block):
    """What gives between the motor and the joint."""

    stiffness: Positive  # N*m/rad, at the joint
    damping: NotNegative = 0.0  # N*m*s/rad


class Feedforward(Block):
    """A motor driven by a voltage, as WPILib gives it: V = kS sgn(w) + kV w + kA dw/dt. Its torques are told in V."""

    kS: NotNegative  # V  # noqa: N815 (WPILib's names)
    kV: NotNegative  # V*s/rad  # noqa: N815
    kA: Positive  # V*s^2/rad  # noqa: N815


class DriveModel(Block):
    """A position servo that turns the angle's error, and how fast that changes, into a voltage."""

    type: Literal["position_servo"]
    gain: NotNegative = 0.0  # V/rad
    damping: NotNegative = 0.0  # V*s/rad, on the rate of the error
    voltage_limit: Positive  # V


class EffectEntry(Block):
    """An effect of the library with its parameters."""

    effect: str
    parameters: dict[str, Annotated[float, Field(strict=True, allow_inf_nan=False)]] = {}

    @model_validator(mode="after")
    def _known(self) -> "EffectEntry":
        if self.effect not in effect_names():
            raise ValueError(f"effect '{self.effect}' is not known; known: {', '.join(effect_names())}")
        known = effect_definition(self.effect).parameters
        for name in self.parameters:
            if name not in known:
                raise ValueError(f"effect {self.effect} has no parameter '{name}'; it has {', '.join(known)}")
        return self


IN_NEWTON_METRES = (
    "phase_resistance",
    "torque_constant",
    "back_emf_constant",
    "rotor_inertia",
    "viscous_damping",
    "coulomb_friction",
    "drive",
    "transmission",
)
"""Keys of a model that say in newton metres, or of currents, what `feedforward:` says in volts."""


class Model(MotorSheet):
    """A nominal model; what it leaves out is None and cannot be judged."""

    winding: Literal["wye", "delta"] = "wye"
    resistance_coefficient: Annotated[float, Field(strict=True, ge=0, le=0.02)] = 0.0  # 1/K
    reference_temperature: Annotated[float, Field(strict=True, ge=-50, le=150)] = 25.0  # degC
    thermal: Thermal | None = None
    # K, true ambient minus the logged one
    ambient_offset: Annotated[float, Field(strict=True, ge=-MOST_OFFSET, le=MOST_OFFSET)] = 0.0
    bench: BenchModel = BenchModel()
    load: LoadModel = LoadModel()
    drive: DriveModel | None = None
    gear_ratio: Positive = 1.0  # turns of the motor for one of the joint
    transmission: Transmission | None = None
    feedforward: Feedforward | None = None
    units: dict[str, str] = {}
    effects: list[EffectEntry] = []

    @model_validator(mode="after")
    def _in_volts(self) -> "Model":
        """Let kA and kS of a feedforward stand for inertia and friction, torques being told in volts."""
        if self.feedforward is None:
            return self
        if given := [key for key in IN_NEWTON_METRES if getattr(self, key) is not None]:
            text = f"stands beside `feedforward:`, whose torques are told in volts; leave out {', '.join(given)}"
            raise self.faulty([((given[0],), text)])
        if self.load.type != "none":
            text = "its torque is in N*m, those of `feedforward:` are in V; leave it out, gravity_load tells it in V"
            raise self.faulty([(("load",), text)])
        object.__setattr__(self, "rotor_inertia", self.feedforward.kA)
        object.__setattr__(self, "coulomb_friction", self.feedforward.kS)
        return self

    def units_of(self, units: str) -> str:
        """The units in which this model tells what a definition tells in some: volts for torques of a feedforward."""
        return units.replace("N*m", "V") if self.feedforward is not None else units


def read_model(path: Path) -> tuple[Model, yamlfile.Document]:
    """Read a model file; the document keeps its text byte for byte.

    Raises
    ------
    InputError : no such file, or a fault in it, one line each.
    """
    document = yamlfile.load(path)
    return document.validate(Model), document


def as_mapping(model: Model) -> dict[str, Any]:
    """What a model file says, without what it leaves out."""
    document = model.model_dump(exclude_none=True, exclude_defaults=True) | {"name": model.name}
    if model.feedforward is not None:
        return {key: value for key, value in document.items() if key not in ("rotor_inertia", "coulomb_friction")}
    return document
