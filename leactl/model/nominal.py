"""Model files: what one believes of a bench, whole or in part, as the gap diagnosis and the simulator read them.

A motor file says all of one actuator; a model file may leave out what the runs cannot show, and adds the bench around
it (`bench:`), what a foreign rig moves (`load:`) and how it is driven (`drive:`), and effects with their parameters.
SI throughout; for a linear axis the same keys stand for m, N and kg, and `units:` renames them in reports.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from leactl import yamlfile
from leactl.model.sheet import MotorSheet, NotNegative, Positive, Thermal
from leactl.vocabulary.effect import effect_definition, effect_names
from leactl.yamlblock import Block


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
    """What hangs on the shaft: nothing, or a pendulum of a point mass on an arm; friction of a load actuator."""

    type: Literal["none", "pendulum"] = "none"
    mass: NotNegative = 0.0  # kg
    length: NotNegative = 0.0  # m
    arm_mass: NotNegative = 0.0  # kg
    gravity: Positive = 9.80665  # m/s^2
    viscous_damping: NotNegative | None = None  # N*m*s/rad, of the load actuator; by default the test actuator's
    coulomb_friction: NotNegative | None = None  # N*m, the same


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


class Model(MotorSheet):
    """A nominal model; what it leaves out is None and cannot be judged."""

    winding: Literal["wye", "delta"] = "wye"
    resistance_coefficient: Annotated[float, Field(strict=True, ge=0, le=0.02)] = 0.0  # 1/K
    reference_temperature: Annotated[float, Field(strict=True, ge=-50, le=150)] = 25.0  # degC
    thermal: Thermal | None = None
    ambient_offset: Annotated[float, Field(strict=True, ge=-20, le=20)] = 0.0  # K, true ambient minus the logged one
    bench: BenchModel = BenchModel()
    load: LoadModel = LoadModel()
    drive: DriveModel | None = None
    units: dict[str, str] = {}
    effects: list[EffectEntry] = []


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
    return model.model_dump(exclude_none=True, exclude_defaults=True) | {"name": model.name}
