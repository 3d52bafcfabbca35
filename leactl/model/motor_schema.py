"""What is known of an actuator: every figure of a data sheet may be missing, and none is made up for one that is.

SI throughout, temperatures in degC; q axis, power-invariant transform, in the winding's own frame (winding.py).
`Motor` asks for what moving one needs, `Model` adds the bench around it.
"""

import math
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from leactl.yamlblock import Block

LEAST, MOST = 1e-15, 1e15  # far beyond any machine in SI units, and far from where products overflow or vanish


def _of_a_machine(value: float) -> float:
    if value and not LEAST <= abs(value) <= MOST:
        raise ValueError(f"{LEAST:g} to {MOST:g} was expected")
    return value


Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False), AfterValidator(_of_a_machine)]
NotNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False), AfterValidator(_of_a_machine)]
Percent = Annotated[float, Field(strict=True, ge=0, le=1000)]
Tolerance = Annotated[float, Field(strict=True, ge=0, le=0.5)]
Length = Annotated[float, Field(strict=True, gt=0, le=10)]
DENSEST = 2e4  # kg/m^3: tungsten


class ThermalSheet(Block):
    """The paper's two-node network, winding and housing against ambient, as far as it is known."""

    winding_ambient_resistance: Positive | None = None  # K/W
    winding_housing_resistance: Positive | None = None  # K/W
    housing_ambient_resistance: Positive | None = None  # K/W
    winding_capacitance: Positive | None = None  # J/K
    housing_capacitance: Positive | None = None  # J/K

    @property
    def to_ambient(self) -> float | None:
        """Steady-state resistance from winding to ambient [K/W]; None if the path through the housing is not known.

        A direct path from winding to air that is not known counts as insulating: the winding gets no cooler by that.
        """
        if self.winding_housing_resistance is None or self.housing_ambient_resistance is None:
            return None
        through = self.winding_housing_resistance + self.housing_ambient_resistance
        if self.winding_ambient_resistance is None:
            return through
        return 1.0 / (1.0 / through + 1.0 / self.winding_ambient_resistance)


class Thermal(ThermalSheet):
    """The whole network."""

    winding_ambient_resistance: Positive  # K/W
    winding_housing_resistance: Positive  # K/W
    housing_ambient_resistance: Positive  # K/W
    winding_capacitance: Positive  # J/K
    housing_capacitance: Positive  # J/K


class Tolerances(Block):
    """How far the bench's actuator may be from this file: fractions of each value, unless a unit is in the name.

    `current` is that of the drive's current reading, ripple and d axis included; `line_current` that of a supply's
    reading, as `current` where it is left out; `ambient_K` that of the ambient that a bench file tells;
    `temperature_rise` that of the rises above ambient that the network gives, by a camera's gain where it was fitted.
    """

    phase_resistance: Tolerance
    resistance_coefficient: Tolerance
    winding_ambient_resistance: Tolerance
    winding_housing_resistance: Tolerance
    housing_ambient_resistance: Tolerance
    winding_capacitance: Tolerance
    housing_capacitance: Tolerance
    viscous_damping: Tolerance
    coulomb_friction: Tolerance
    current: Tolerance
    line_current: Tolerance | None = None
    ambient_K: Annotated[float, Field(strict=True, ge=0, le=30)]  # noqa: N815 (a unit keeps its letter)
    temperature_rise: Tolerance = 0.0


class LimitsSheet(Block):
    """What the maker allows."""

    winding_temperature: Annotated[float, Field(strict=True, gt=25, le=250)] | None = None  # degC


class MotorLimits(LimitsSheet):
    """What must not be passed."""

    winding_temperature: Annotated[float, Field(strict=True, gt=25, le=250)]  # degC


class Body(Block):
    """Mass [kg] and size [m]; a length above 10 m or a density above tungsten's is refused as probably mm or g."""

    mass: Positive | None = None  # kg
    outer_diameter: Length | None = None  # m
    inner_diameter: Length | None = None  # m
    length: Length | None = None  # m

    @model_validator(mode="after")
    def _inside_of_itself(self) -> Self:
        inner, outer = self.inner_diameter, self.outer_diameter
        if inner is not None and outer is not None and inner >= outer:
            raise ValueError(f"inner_diameter {inner:g} m is not below outer_diameter {outer:g} m")
        return self

    @model_validator(mode="after")
    def _no_denser_than_metal(self) -> Self:
        if self.mass is not None and self.outer_diameter is not None and self.length is not None:
            density = self.mass / (0.25 * math.pi * self.outer_diameter**2 * self.length)
            if density > DENSEST:
                raise ValueError(
                    f"mass {self.mass:g} in the room of its diameter and length is {density:.3g} kg/m^3, at most"
                    f" {DENSEST:g} was expected; are they in kg and m?"
                )
        return self


class LoopFigures(Block):
    """How a control loop answers, in the terms of data sheets."""

    rise_time: Positive | None = None  # s
    overshoot_percent: Percent | None = None
    settling_time: Positive | None = None  # s
    error_percent: Percent | None = None
    bandwidth: Positive | None = None  # Hz
    bandwidth_at_least: Positive | None = None  # Hz, where no end was seen


class Control(Block):
    """Both loops with the drive they were measured on."""

    current: LoopFigures = LoopFigures()
    position: LoopFigures = LoopFigures()


class Bearings(Block):
    """Bearings on flexures around a large rotor; the bending of each flexure preloads its bearing."""

    each_side: Annotated[int, Field(strict=True, ge=1, le=1000)]
    static_radial_load: Positive  # N, that one bearing takes
    deflection_at_static_load: Positive  # m, of the flexure's free end
    told_gap: Positive  # m, between flexure and stator, for which a preload is told
    told_preload: Positive  # N, of one bearing


class Printed(Block):
    """What the source prints beside its own values, or against them; nothing is worked out from these."""

    motor_constant: Positive | None = None  # N*m/sqrt(W)
    rotor_inertia: Positive | None = None  # kg*m^2
    resistance_coefficient: Positive | None = None  # 1/K
    nominal_torque: Positive | None = None  # N*m
    peak_torque_20_s: Positive | None = None  # N*m


class MotorSheet(Block):
    """One actuator as far as it is known."""

    name: Annotated[str, Field(min_length=1)]
    winding: Literal["wye", "delta"]
    pole_pairs: Annotated[int, Field(strict=True, ge=1, le=500)] | None = None
    phase_resistance: Positive | None = None  # ohm, at reference_temperature: R_ll / 2 (wye), 3/2 R_ll (delta)
    resistance_coefficient: Annotated[float, Field(strict=True, ge=0, le=0.02)] | None = None  # 1/K
    reference_temperature: Annotated[float, Field(strict=True, ge=-50, le=150)] | None = None  # degC
    phase_inductance: Positive | None = None  # H, the same parts of the line-to-line value
    torque_constant: Positive | None = None  # N*m/A
    back_emf_constant: Positive | None = None  # V*s/rad
    rotor_inertia: Positive | None = None  # kg*m^2
    viscous_damping: NotNegative | None = None  # N*m*s/rad
    coulomb_friction: NotNegative | None = None  # N*m
    thermal: ThermalSheet | None = None
    limits: LimitsSheet = LimitsSheet()
    tolerances: Tolerances | None = None  # a motor without them is not moved
    continuous_current: Positive | None = None  # A, as the source states it
    air_gap_radius: Positive | None = None  # m
    body: Body = Body()  # the whole actuator
    frameless: Body = Body()  # rotor and stator alone
    encoder_lines: Annotated[int, Field(strict=True, ge=1)] | None = None  # a turn; four counts each
    control: Control = Control()
    bearings: Bearings | None = None
    printed: Printed = Printed()

    def missing(self, *names: str) -> list[str]:
        """Those of these figures that the file does not have."""
        return [name for name in names if getattr(self, name) is None]
