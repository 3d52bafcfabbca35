"""The vocabulary of measured quantities: names, units and roles that run files, drivers and analyses share."""

from typing import Final, NamedTuple

UNITS: Final[dict[str, str]] = {
    "q_axis_current_reference": "A",
    "q_axis_current": "A",
    "q_axis_voltage": "V",
    "d_axis_current": "A",
    "d_axis_voltage": "V",
    "velocity_reference": "rad/s",
    "velocity": "rad/s",
    "angle_reference": "rad",
    "angle": "rad",
    "torque": "N*m",
    "torque_reference": "N*m",
    "winding_temperature": "degC",
    "housing_temperature": "degC",
    "ambient_temperature": "degC",
    "drive_temperature": "degC",
    "line_current": "A",
    "line_voltage": "V",
    "phase_voltage_ab": "V",
    "phase_voltage_bc": "V",
    "phase_voltage_ca": "V",
    "bus_voltage": "V",
    "bus_current": "A",
    "drive_enabled": "1",
}
"""Unit string of each quantity (Pint and UDUNITS both read it)."""

FLAGS: Final = ("drive_enabled",)
"""Quantities that are 0 or 1 and nothing between."""

LINEAR_UNITS: Final[dict[str, str]] = {
    "rad": "m",
    "rad/s": "m/s",
    "N*m": "N",
}
"""Unit of a linear axis of a foreign rig, by the unit that it replaces."""

ROLES: Final = ("test", "load", "bench")
SETUPS: Final = ("free", "locked", "coupled", "heated")  # mechanical set-ups of a bench


def accepted_units(quantity: str) -> tuple[str, ...]:
    """Return the units that a channel of this quantity may have; empty for a quantity outside the vocabulary."""
    unit = UNITS.get(quantity)
    if unit is None:
        return ()
    return (unit, LINEAR_UNITS[unit]) if unit in LINEAR_UNITS else (unit,)


class ChannelSpec(NamedTuple):
    """Description of a channel; a reader finds a channel by quantity, role and location, never by name."""

    name: str
    quantity: str
    role: str
    device: str
    long_name: str = ""
    location: str = ""
    sampling: str = "instant"  # or "mean" over the interval that ends at the stamp; empty: stamps good to one sample
    units: str = ""  # empty: those of the vocabulary
    dtype: str = "f4"  # of the stored values; angles have "f8", since float32 loses counts after a few hundred turns
    skew_s: float = 0.0  # from the row's stamp to this channel's sample, if a multiplexer reads channels in turn
    scale_std: float = 0.0  # relative standard uncertainty of the calibration, shared by the device's channels

    @property
    def unit(self) -> str:
        """Unit that is stored with the channel."""
        return self.units or UNITS[self.quantity]
