"""Read model files: the nominal parameters of a bench, complete or partial, for the gap diagnosis and the simulator.

A motor file has all parameters of one actuator. A model file may leave out those that the runs do not reveal, and adds
the bench (`bench:`), the load on the shaft (`load:`), the drive (`drive:`), and effects with their parameters. SI
throughout; for a linear axis the same keys stand for m, N and kg, and `units:` renames them in reports. All torques and
angles are those of the joint, behind its gear.
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
LARGEST_AMBIENT_OFFSET = 20.0  # K, from the logged to the true ambient; a larger one means a sensor at another place


class BenchModel(Block):
    """Parameters of the supply, the sensors and the control loops."""

    bus_voltage: Positive | None = None  # V
    current_loop_bandwidth: Positive | None = None  # Hz, first order
    setpoint_lead: NotNegative = 0.0  # relative overshoot of the effective current setpoint after a change
    setpoint_lead_time: Positive = 0.06  # s, time constant of the overshoot's decay
    velocity_filter_bandwidth: Positive | None = None  # Hz, first order
    torque_filter_bandwidth: Positive | None = None  # Hz, first order
    shaft_stiffness: Positive | None = None  # N*m/rad, between test and load actuator


class LoadModel(Block):
    """Load on the shaft: none, a pendulum or the arm of a joint; and the friction of a load actuator.

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
    coulomb_friction: NotNegative | None = None  # N*m, of the load actuator; by default the test actuator's

    def frictions(self, viscous: float | None, coulomb: float | None) -> tuple[float, float]:
        """Return viscous damping [N*m*s/rad] and Coulomb friction [N*m] of the load actuator.

        Parameters
        ----------
        viscous, coulomb : values of the test actuator, used if the load's are None; None counts as 0.
        """
        value_pairs = (self.viscous_damping, viscous), (self.coulomb_friction, coulomb)
        damping, friction = (
            test_value or 0.0 if load_value is None else load_value for load_value, test_value in value_pairs
        )
        return damping, friction

    @model_validator(mode="after")
    def _fits_type(self) -> "LoadModel":
        """Raise an error at a key that the type of load does not have, or lacks."""
        if self.type != "arm" and self.zero_angle:
            raise self.faulty([(("zero_angle",), f"is an arm's; a load of type {self.type} has none")])
        if self.type == "arm" and self.arm_mass:
            raise self.faulty([(("arm_mass",), "is a pendulum's; an arm has its mass at its centre, length away")])
        if self.type == "arm" and not (self.mass and self.length):
            raise self.faulty([(("type",), "an arm has a mass and a length above zero")])
        return self

    @property
    def level_torque(self) -> float:
        """Torque that holds the load horizontal against gravity [N*m]."""
        return 0.0 if self.type == "none" else (self.mass + 0.5 * self.arm_mass) * self.gravity * self.length

    @property
    def inertia(self) -> float:
        """Inertia of the load about the shaft [kg*m^2]."""
        return 0.0 if self.type == "none" else (self.mass + self.arm_mass / 3.0) * self.length**2

    @property
    def hanging_angle(self) -> float:
        """Shaft angle [rad] at which the load hangs straight down: gravity takes level_torque sin(angle - this)."""
        return -0.5 * math.pi - self.zero_angle if self.type == "arm" else 0.0


class Transmission(Block):
    """Compliance between the motor and the joint."""

    stiffness: Positive  # N*m/rad, at the joint
    damping: NotNegative = 0.0  # N*m*s/rad


class Feedforward(Block):
    """Voltage-driven motor by WPILib's constants: V = kS sgn(w) + kV w + kA dw/dt. Torques of such a model are in V."""

    kS: NotNegative  # V  # noqa: N815 (WPILib's names)
    kV: NotNegative  # V*s/rad  # noqa: N815
    kA: Positive  # V*s^2/rad  # noqa: N815


class DriveModel(Block):
    """Position servo whose voltage is proportional to the angle's error and to the rate of that error."""

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
        """Raise ValueError if the effect or one of its parameters is not known."""
        if self.effect not in effect_names():
            raise ValueError(f"effect '{self.effect}' is not known; known: {', '.join(effect_names())}")
        parameter_names = effect_definition(self.effect).parameters
        for name in self.parameters:
            if name not in parameter_names:
                raise ValueError(f"effect {self.effect} has no parameter '{name}'; it has {', '.join(parameter_names)}")
        return self


KEYS_IN_NEWTON_METRES = (
    "phase_resistance",
    "torque_constant",
    "back_emf_constant",
    "rotor_inertia",
    "viscous_damping",
    "coulomb_friction",
    "drive",
    "transmission",
)
"""Keys of a model that are in newton metres or describe currents; `feedforward:` has their values in volts instead."""


class Model(MotorSheet):
    """A nominal model; a parameter that the file leaves out is None, and the diagnosis does not judge it."""

    winding: Literal["wye", "delta"] = "wye"
    resistance_coefficient: Annotated[float, Field(strict=True, ge=0, le=0.02)] = 0.0  # 1/K
    reference_temperature: Annotated[float, Field(strict=True, ge=-50, le=150)] = 25.0  # degC
    thermal: Thermal | None = None
    # K, true ambient minus the logged one
    ambient_offset: Annotated[float, Field(strict=True, ge=-LARGEST_AMBIENT_OFFSET, le=LARGEST_AMBIENT_OFFSET)] = 0.0
    bench: BenchModel = BenchModel()
    load: LoadModel = LoadModel()
    drive: DriveModel | None = None
    gear_ratio: Positive = 1.0  # turns of the motor for one of the joint
    transmission: Transmission | None = None
    feedforward: Feedforward | None = None
    units: dict[str, str] = {}
    effects: list[EffectEntry] = []

    @model_validator(mode="after")
    def _adopt_feedforward(self) -> "Model":
        """Use kA and kS of a feedforward as inertia and friction, with torques in volts."""
        if self.feedforward is None:
            return self
        if conflicting_keys := [key for key in KEYS_IN_NEWTON_METRES if getattr(self, key) is not None]:
            surplus_keys = ", ".join(conflicting_keys)
            message = f"stands beside `feedforward:`, whose torques are told in volts; leave out {surplus_keys}"
            raise self.faulty([((conflicting_keys[0],), message)])
        if self.load.type != "none":
            message = "its torque is in N*m, those of `feedforward:` are in V; leave it out, gravity_load tells it in V"
            raise self.faulty([(("load",), message)])
        object.__setattr__(self, "rotor_inertia", self.feedforward.kA)
        object.__setattr__(self, "coulomb_friction", self.feedforward.kS)
        return self

    def units_of(self, units: str) -> str:
        """Return the units of a quantity in this model: V in place of N*m if it has a `feedforward`."""
        return units.replace("N*m", "V") if self.feedforward is not None else units


def read_model(path: Path) -> tuple[Model, yamlfile.Document]:
    """Read a model file; the document keeps its text byte for byte.

    Raises
    ------
    InputError : no such file, or faults in the file, one line each.
    """
    document = yamlfile.load(path)
    return document.validate(Model), document


def as_mapping(model: Model) -> dict[str, Any]:
    """Return the model as the mapping of a model file, without keys that have their default."""
    document = model.model_dump(exclude_none=True, exclude_defaults=True) | {"name": model.name}
    if model.feedforward is not None:
        return {key: value for key, value in document.items() if key not in ("rotor_inertia", "coulomb_friction")}
    return document
