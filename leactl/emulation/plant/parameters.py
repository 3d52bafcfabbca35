"""Parameters of the emulated plant: one actuator, its thermal network, and the bench around two of them.

SI throughout, temperatures in degC, q axis, power-invariant transform. The defaults are the LEA of the paper; every
field can be set; a mapping that does not describe a plant raises one InputError that lists all its faults.
"""

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from typing import Any, Self

from leactl.errors import InputError


def bounded(default: float, low: float, high: float = math.inf) -> Any:
    """Declare a field of a frozen dataclass that is a number from `low` to `high`, both ends allowed."""
    return field(default=default, metadata={"low": low, "high": high})


def switch(default: bool) -> Any:
    """Declare a field of a frozen dataclass that is true or false; numbers and words are faults."""
    return field(default=default, metadata={"switch": True})


def _positive(default: float) -> Any:
    """Declare a field that is a positive number."""
    return bounded(default, 1e-12)


def _not_negative(default: float) -> Any:
    """Declare a field that is zero or a positive number."""
    return bounded(default, 0.0)


class Checked:
    """Base class of dataclasses that check their fields when they are made, and can be made from a mapping of YAML."""

    def __post_init__(self) -> None:
        faults: list[str] = []
        for parameter in fields(self):  # type: ignore[arg-type]
            value = getattr(self, parameter.name)
            faults += _faults(parameter.name, value, parameter.metadata)
        if faults:
            raise InputError(faults)

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> Self:
        """Make an object from a mapping of names to values; a name that is missing keeps its default.

        Raises
        ------
        InputError : one line for each unknown name and for each value that is no number, not finite or out of range.
        """
        parameters = {parameter.name: parameter for parameter in fields(cls)}  # type: ignore[arg-type]
        faults: list[str] = []
        values: dict[str, Any] = {}
        for name, value in mapping.items():
            if name not in parameters:
                faults.append(f"{name}: unknown parameter; known are {', '.join(parameters)}")
                continue
            nested_class = parameters[name].default_factory
            if nested_class is not MISSING and is_dataclass(nested_class) and not isinstance(value, Checked):
                if not isinstance(value, Mapping):
                    faults.append(f"{name}: found {value!r}, expected parameters by name")
                    continue
                try:
                    value = nested_class.from_mapping(value)
                except InputError as error:
                    faults += [f"{name}.{fault}" for fault in error.faults]
                    continue
            faults += _faults(name, value, parameters[name].metadata)
            values[name] = value
        if faults:
            raise InputError(faults)
        return cls(**values)


def _faults(name: str, value: object, metadata: Mapping[str, Any]) -> list[str]:
    """Return the fault of a parameter's value in a list, or an empty list; `metadata` are those of its field."""
    if "switch" in metadata and not isinstance(value, bool):
        return [f"{name}: found {value!r}, expected true or false"]
    if "low" not in metadata:
        return []
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return [f"{name}: found {value!r}, expected a number"]
    if not math.isfinite(value):
        return [f"{name}: {value} is not finite; give a number"]
    if not metadata["low"] <= value <= metadata["high"]:
        return [f"{name}: {value} is outside {metadata['low']:g} to {metadata['high']:g}"]
    return []


@dataclass(frozen=True)
class ThermalParameters(Checked):
    """Two thermal nodes, winding and housing, against the ambient."""

    winding_ambient_resistance: float = _positive(5.6)  # K/W
    winding_housing_resistance: float = _positive(0.3)  # K/W
    housing_ambient_resistance: float = _positive(1.7)  # K/W
    winding_capacitance: float = _positive(22.9)  # J/K
    housing_capacitance: float = _positive(469.1)  # J/K


@dataclass(frozen=True)
class PhaseParameters(Checked):
    """Parameters of an actuator that act only if its phases are resolved."""

    commutation_offset: float = bounded(0.0, -1e3, 1e3)  # rad, electrical angle at rotor angle 0
    fixture_capacitance: float = _not_negative(0.0)  # J/K, on the housing; 0 is no fixture
    fixture_resistance: float = _positive(2.0)  # K/W, between housing and fixture
    blocked_air_factor: float = bounded(1.0, 0.01, 1e6)  # on housing_ambient_resistance; 1 is free air
    blocked_air_from: float = _not_negative(0.0)  # s


@dataclass(frozen=True)
class ActuatorParameters(Checked):
    """One actuator on its q axis."""

    winding: str = "wye"
    pole_pairs: int = bounded(41, 1, 1000)
    phase_resistance: float = _positive(0.264)  # ohm, at reference_temperature
    resistance_coefficient: float = bounded(0.004, 0.0, 0.1)  # 1/K
    reference_temperature: float = bounded(25.0, -273.0, 1000.0)  # degC
    phase_inductance: float = _positive(128e-6)  # H
    torque_constant: float = _positive(0.49)  # N*m/A
    back_emf_constant: float = _positive(0.49)  # V*s/rad
    rotor_inertia: float = _positive(0.0024)  # kg*m^2
    viscous_damping: float = _not_negative(0.0238)  # N*m*s/rad
    coulomb_friction: float = _not_negative(0.208)  # N*m
    thermal: ThermalParameters = field(default_factory=ThermalParameters)
    phases: PhaseParameters = field(default_factory=PhaseParameters)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.winding not in ("wye", "delta"):
            raise InputError(f"winding: found {self.winding!r}, expected wye or delta")

    @property
    def lead_amplitude(self) -> float:
        """Amplitude of the voltage between two leads, divided by the power-invariant q-axis voltage.

        It is sqrt(2/3) of one phase, which is between two leads of a delta; between those of a wye are two phases.
        """
        return math.sqrt(2.0 / 3.0) if self.winding == "delta" else math.sqrt(2.0)

    def resistance(self, temperature: float) -> float:
        """Return the phase resistance [ohm] at a winding temperature [degC]."""
        rise = temperature - self.reference_temperature
        return self.phase_resistance * (1.0 + self.resistance_coefficient * rise)


@dataclass(frozen=True)
class BenchParameters(Checked):
    """Parameters of the bench around the two actuators: supply, drives, filters, shaft."""

    bus_voltage: float = _positive(29.6)  # V
    current_loop_bandwidth: float = _positive(450.0)  # Hz, first order
    setpoint_lead: float = bounded(0.0, 0.0, 1.0)  # share by which a drive's current setpoint counts for more at first
    setpoint_lead_time: float = _positive(0.06)  # s, time constant with which the lead decays
    velocity_filter_bandwidth: float = _positive(250.0)  # Hz, first order
    torque_filter_bandwidth: float = _positive(265.0)  # Hz, first order
    shaft_stiffness: float = _positive(6000.0)  # N*m/rad, between test and load actuator
    shaft_damping_ratio: float = bounded(0.025, 0.0, 1.0)  # of critical, with both rotors loose
    peak_current: float = _positive(45.0)  # A, q axis, of each drive
    speed_limit: float = _positive(40.0)  # rad/s, of the position servo
    position_gain: float = _positive(38.0)  # 1/s
    velocity_gain: float = _positive(200.0)  # 1/s, proportional, of an unloaded rotor
    velocity_integral: float = _not_negative(1000.0)  # 1/s^2
    ambient_temperature: float = bounded(25.0, -100.0, 200.0)  # degC
    friction_heat: bool = switch(False)  # True: friction warms the housing, which the paper leaves out
    phase_resolved: bool = switch(False)  # True: each winding has three phase nodes in place of one
