"""Schema of a motor sheet, in which every parameter of an actuator may be missing; no default replaces a missing one.

SI throughout, temperatures in degC; q axis, power-invariant transform, in the frame of the winding (winding.py).
`Motor` requires the parameters without which a drive may not move, `Model` adds the bench around the actuator.
"""

import math
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from leactl.yamlblock import Block

# outside the range of any machine in SI units, and far from an overflow of products
SMALLEST_MAGNITUDE, LARGEST_MAGNITUDE = 1e-15, 1e15


def _within_machine_range(value: float) -> float:
    """Return the value; raise ValueError if it is not 0 and its magnitude is out of range."""
    if value and not SMALLEST_MAGNITUDE <= abs(value) <= LARGEST_MAGNITUDE:
        raise ValueError(f"{SMALLEST_MAGNITUDE:g} to {LARGEST_MAGNITUDE:g} was expected")
    return value


Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False), AfterValidator(_within_machine_range)]
NotNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False), AfterValidator(_within_machine_range)]
Percent = Annotated[float, Field(strict=True, ge=0, le=1000)]
Tolerance = Annotated[float, Field(strict=True, ge=0, le=0.5)]
Length = Annotated[float, Field(strict=True, gt=0, le=10)]
LARGEST_DENSITY = 2e4  # kg/m^3; tungsten has 1.93e4


class ThermalSheet(Block):
    """Parameters of the paper's two-node thermal network, winding and housing against ambient; each may be missing."""

    winding_ambient_resistance: Positive | None = None  # K/W
    winding_housing_resistance: Positive | None = None  # K/W
    housing_ambient_resistance: Positive | None = None  # K/W
    winding_capacitance: Positive | None = None  # J/K
    housing_capacitance: Positive | None = None  # J/K

    @property
    def to_ambient(self) -> float | None:
        """Steady-state resistance from winding to ambient [K/W]; None if the path through the housing is not known.

        A direct path from winding to air that is not known counts as insulating, which never predicts too low a
        winding temperature.
        """
        if self.winding_housing_resistance is None or self.housing_ambient_resistance is None:
            return None
        housing_path = self.winding_housing_resistance + self.housing_ambient_resistance
        if self.winding_ambient_resistance is None:
            return housing_path
        return 1.0 / (1.0 / housing_path + 1.0 / self.winding_ambient_resistance)


class Thermal(ThermalSheet):
    """Parameters of the two-node thermal network, all known."""

    winding_ambient_resistance: Positive  # K/W
    winding_housing_resistance: Positive  # K/W
    housing_ambient_resistance: Positive  # K/W
    winding_capacitance: Positive  # J/K
    housing_capacitance: Positive  # J/K


class Tolerances(Block):
    """Largest deviation of the bench's actuator from the file, as a fraction of each value unless the name has a unit.

    `current` is the tolerance of the drive's current reading, ripple and d axis included; `line_current` that of a
    supply's reading, equal to `current` by default; `ambient_K` that of the ambient temperature in a bench file;
    `temperature_rise` that of the network's rises above ambient, for a network that was fitted to a camera with a
    gain error.
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
    """Limits that the maker states; each may be missing."""

    winding_temperature: Annotated[float, Field(strict=True, gt=25, le=250)] | None = None  # degC


class MotorLimits(LimitsSheet):
    """Limits that a run must not exceed."""

    winding_temperature: Annotated[float, Field(strict=True, gt=25, le=250)]  # degC


class Body(Block):
    """Mass [kg] and size [m]; a length above 10 m or a density above tungsten's is refused as probably mm or g."""

    mass: Positive | None = None  # kg
    outer_diameter: Length | None = None  # m
    inner_diameter: Length | None = None  # m
    length: Length | None = None  # m

    @model_validator(mode="after")
    def _inner_below_outer(self) -> Self:
        """Raise ValueError if the inner diameter is not below the outer one."""
        inner, outer = self.inner_diameter, self.outer_diameter
        if inner is not None and outer is not None and inner >= outer:
            raise ValueError(f"inner_diameter {inner:g} m is not below outer_diameter {outer:g} m")
        return self

    @model_validator(mode="after")
    def _density_below_limit(self) -> Self:
        """Raise ValueError if the density exceeds `LARGEST_DENSITY`."""
        if self.mass is not None and self.outer_diameter is not None and self.length is not None:
            density = self.mass / (0.25 * math.pi * self.outer_diameter**2 * self.length)
            if density > LARGEST_DENSITY:
                raise ValueError(
                    f"mass {self.mass:g} in the room of its diameter and length is {density:.3g} kg/m^3, at most"
                    f" {LARGEST_DENSITY:g} was expected; are they in kg and m?"
                )
        return self


class LoopFigures(Block):
    """Response of a control loop, in the terms of data sheets."""

    rise_time: Positive | None = None  # s
    overshoot_percent: Percent | None = None
    settling_time: Positive | None = None  # s
    error_percent: Percent | None = None
    bandwidth: Positive | None = None  # Hz
    bandwidth_at_least: Positive | None = None  # Hz, if the response did not fall to the limit in the tested band


class Control(Block):
    """Responses of the current and position loops, measured with a drive."""

    current: LoopFigures = LoopFigures()
    position: LoopFigures = LoopFigures()


class Bearings(Block):
    """Bearings on flexures around a large rotor; the bending of each flexure preloads its bearing."""

    each_side: Annotated[int, Field(strict=True, ge=1, le=1000)]  # number of bearings
    static_radial_load: Positive  # N, rating of one bearing
    deflection_at_static_load: Positive  # m, of the flexure's free end
    told_gap: Positive  # m, between flexure and stator, for which the source states a preload
    told_preload: Positive  # N, preload of one bearing at that gap


class Printed(Block):
    """Values that the source prints and that repeat or contradict its other values; checks use them, models do not."""

    motor_constant: Positive | None = None  # N*m/sqrt(W)
    rotor_inertia: Positive | None = None  # kg*m^2
    resistance_coefficient: Positive | None = None  # 1/K
    nominal_torque: Positive | None = None  # N*m
    peak_torque_20_s: Positive | None = None  # N*m


class MotorSheet(Block):
    """One actuator, of which any parameter may be missing."""

    name: Annotated[str, Field(min_length=1)]
    winding: Literal["wye", "delta"]
    pole_pairs: Annotated[int, Field(strict=True, ge=1, le=500)] | None = None
    phase_resistance: Positive | None = None  # ohm, at reference_temperature: R_ll / 2 (wye), 3/2 R_ll (delta)
    resistance_coefficient: Annotated[float, Field(strict=True, ge=0, le=0.02)] | None = None  # 1/K
    reference_temperature: Annotated[float, Field(strict=True, ge=-50, le=150)] | None = None  # degC
    phase_inductance: Positive | None = None  # H, the same fractions of the line-to-line value
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
        """Return the names among `names` whose value the file lacks."""
        return [name for name in names if getattr(self, name) is None]
