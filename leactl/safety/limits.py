"""Limits of a bench: the largest commanded and measured values, and the largest age of a reading."""

from collections.abc import Callable
from typing import Annotated

from pydantic import AfterValidator, Field, model_validator

from leactl.yamlblock import Block

CYCLES_OF_SILENCE = 3  # default of the largest age of a drive's cyclic readings, in periods of the loop
# square of the q-axis current that heats like a direct current through two leads, over the square of the latter
LEADS = 2.0
LEAST_CYCLIC_AGE_S = 0.05
UNKNOWN_AMBIENT_DEGC = 40.0  # an ambient temperature that a bench file does not state is taken as hot
COLDEST_DEGC, HOTTEST_DEGC = -40.0, 200.0  # of anything on a bench; above, 25 degC in kelvin would pass for one
MOST_TRIP_DELAY_S = 60.0  # of a limit or an interlock
Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]


def trips_by(longest: float) -> Callable[[float], float]:
    """Return a validator that raises ValueError for a time above `longest` [s], after which a trip comes too late."""

    def check(value: float) -> float:
        if value > longest:
            raise ValueError(f"it would never trip in time; {longest:g} s or less was expected")
        return value

    return check


Age = Annotated[
    Positive, AfterValidator(trips_by(MOST_TRIP_DELAY_S)), Field(json_schema_extra={"maximum": MOST_TRIP_DELAY_S})
]


class Limits(Block):
    """The `limits:` block of a bench file; every limit that protects a motor is required, none defaults to infinity.

    `cyclic_age_s` is the largest age of readings that a drive returns in every cycle, `age_s` that of other streams.
    """

    current_A: Positive  # noqa: N815 (a unit keeps its letter)
    velocity_rad_s: Positive
    torque_Nm: Positive  # noqa: N815
    bus_voltage_low_V: Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]  # noqa: N815
    bus_voltage_high_V: Positive  # noqa: N815
    age_s: Age
    winding_temperature_degC: Annotated[float, Field(strict=True, gt=25, le=200)]  # noqa: N815
    ambient_temperature_degC: Annotated[float, Field(strict=True, ge=-40, le=60)] = UNKNOWN_AMBIENT_DEGC  # noqa: N815
    cyclic_age_s: Age | None = None  # None: three cycles, 50 ms at the least
    angle_rad: Positive | None = None  # to either side of the encoder's zero; None: the shaft may turn on and on
    angle_leap_rad: Positive | None = None  # of a setpoint at once, for drives that limit their own speed on the way

    @model_validator(mode="after")
    def _low_below_high(self) -> "Limits":
        if self.bus_voltage_low_V >= self.bus_voltage_high_V:
            raise ValueError(
                f"bus_voltage_low_V {self.bus_voltage_low_V:g} V is not below bus_voltage_high_V"
                f" {self.bus_voltage_high_V:g} V"
            )
        return self

    def of(self, quantity: str) -> tuple[float, float] | None:
        """Return the lowest and highest value that a quantity may have; None if no limit applies to it."""
        symmetric = {
            "q_axis_current": self.current_A,
            "q_axis_current_reference": self.current_A,
            "d_axis_current": self.current_A,
            "velocity": self.velocity_rad_s,
            "velocity_reference": self.velocity_rad_s,
            "torque": self.torque_Nm,
            "line_current": self.current_A / LEADS**0.5,
        }.get(quantity)
        if symmetric is not None:
            return -symmetric, symmetric
        if quantity in ("angle", "angle_reference") and self.angle_rad is not None:
            return -self.angle_rad, self.angle_rad
        if quantity == "bus_voltage":
            return self.bus_voltage_low_V, self.bus_voltage_high_V
        if quantity == "winding_temperature":
            return COLDEST_DEGC, self.winding_temperature_degC
        if quantity.endswith("_temperature"):
            return COLDEST_DEGC, HOTTEST_DEGC
        return None

    def cyclic_age(self, period: float) -> float:
        """Return the largest age [s] of a reading that a drive returns in every cycle of this period [s]."""
        return self.cyclic_age_s or max(CYCLES_OF_SILENCE * period, LEAST_CYCLIC_AGE_S)
