"""Base class of the effects: an effect overrides the methods for what it changes in the plant.

The rig (exact steps, one bench) calls `torque`, `sense_current` and `sense_torque`. The stepped plant calls all
methods, each over many lanes at once: an effect made by `stacked` holds arrays where a single effect holds numbers,
and its methods accept both.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Self, TypeAlias

import numpy as np

from leactl.emulation.plant.parameters import Checked
from leactl.errors import InputError

Value: TypeAlias = Any  # a number in the rig, an array over lanes in the stepped plant
Path: TypeAlias = Callable[[Value], Value]  # called with a signal once a step; returns the changed signal


class Now:
    """State of the plant in the lanes of one effect at one moment: views that the plant keeps up to date."""

    time: float = 0.0  # s since the run's start
    angle: Value  # rad, of the rotor
    velocity: Value  # rad/s, before the friction of this step
    current: Value  # A, true current
    shaft_torque: Value  # N*m
    winding: Value  # degC
    housing: Value  # degC


@dataclass(frozen=True)
class PlantEffect(Checked):
    """One effect that the nominal plant lacks, on one actuator; a method that is not overridden changes nothing."""

    adds_torque: ClassVar[bool] = False
    needs_whole_record: ClassVar[bool] = False  # `torque_record` uses later samples, which a live bench does not have
    role: str = "test"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.role not in ("test", "load"):
            raise InputError(f"role: found {self.role!r}, expected test or load")

    @classmethod
    def effect_name(cls) -> str:
        """Return the name of the effect in files and in the vocabulary: `bus_sag` for `PlantBusSag`."""
        return re.sub("(?<!^)(?=[A-Z])", "_", cls.__name__.removeprefix("Plant")).lower()

    @classmethod
    def stacked(cls, effects: "Sequence[PlantEffect]") -> Self:
        """Combine effects of one kind, one per lane, into one effect whose parameters are arrays over lanes."""
        combined = object.__new__(cls)
        for parameter in fields(cls):
            values = [getattr(effect, parameter.name) for effect in effects]
            object.__setattr__(
                combined, parameter.name, values[0] if parameter.name == "role" else np.array(values, np.float64)
            )
        return combined

    # ------------------------------------------------------------ rig and stepped plant

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Return the torque on the rotor [N*m], if `adds_torque`; called at intervals of 0.25 ms at most."""
        return 0.0

    def sense_current(self, current: Value) -> Value:
        """Return the drive's reading of a current [A]; it must be affine, as the current loop closes over it."""
        return current

    def sense_torque(self, torque: Value) -> Value:
        """Return the reading of the shaft's torque sensor at a torque [N*m]; the effect's role does not matter."""
        return torque

    # ------------------------------------------------------------ stepped plant: mechanics

    def shaft_stiffness(self, nominal: Value) -> Value:
        """Return the stiffness of the shaft [N*m/rad] in place of the nominal one."""
        return nominal

    def transmitted_twist(self, twist: Value) -> Value:
        """Return the part of the twist between the actuators that strains the shaft [rad]."""
        return twist

    def torque_share(self, now: Now) -> Value:
        """Return the factor on the torque constant at the present angle and current."""
        return 1.0

    def coulomb(self, level: Value, now: Now) -> Value:
        """Return the Coulomb friction [N*m] that replaces `level`, which is nominal or another effect's."""
        return level

    def friction_share(self, now: Now) -> Value:
        """Return the factor on viscous damping and Coulomb friction; called every millisecond."""
        return 1.0

    def friction_path(self, lanes: int, step_s: float) -> Callable[[Value, Value], Value] | None:
        """Return a function of level [N*m] and velocity [rad/s] for the torque of friction with a memory [N*m]."""
        return None

    def rotor_path(self, lanes: int, step_s: float) -> Callable[[Now], Value] | None:
        """Return a function for a torque [N*m] that has a memory, or depends on more than angle and velocity."""
        return None

    # ------------------------------------------------------------ stepped plant: electrics

    def magnet_share(self, now: Now) -> Value:
        """Return the factor on torque constant and back-EMF constant; called every millisecond."""
        return 1.0

    def resistance_share(self, winding: Value, time: float) -> Value:
        """Return the factor on the winding resistance at a winding temperature [degC] and a time of the run [s]."""
        return 1.0

    def reference_path(self, lanes: int, step_s: float) -> Path | None:
        """Return a function that changes the reference of the current loop [A]."""
        return None

    def bounded_reference(self, reference: Value, torque_constant: Value, velocity: Value) -> Value:
        """Return the current reference [A] within the limits of the drive; called every millisecond."""
        return reference

    def lost_voltage(self, current: Value) -> Value:
        """Return the voltage that the drive applies but that does not reach the winding [V]."""
        return 0.0

    def bus_voltage(self, source: Value, power: Value) -> Value:
        """Return the DC link voltage [V] while a power [W] is drawn from a source voltage [V]."""
        return source

    # ------------------------------------------------------------ stepped plant: sensors

    def encoder_error(self, angle: Value) -> Value:
        """Return the error of the encoder [rad] at an angle [rad]."""
        return 0.0

    def velocity_path(self, lanes: int, step_s: float) -> Path | None:
        """Return a function that changes the velocity [rad/s] after the drive's filter."""
        return None

    def torque_path(self, lanes: int, step_s: float) -> Path | None:
        """Return a function that changes the torque [N*m] after the sensor's filter."""
        return None

    def torque_record(self, torque: Value, angle: Value, time: Value) -> Value:
        """Return the torque [N*m] that the sensor records in a run; arrays have one row for each time [s]."""
        return torque

    def angle_record(self, angle: Value, time: Value) -> Value:
        """Return the angle [rad] that the encoder records in a run; arrays have one row for each time [s]."""
        return angle

    # ------------------------------------------------------------ stepped plant: heat

    def ambient_error(self, time: float) -> Value:
        """Return the true ambient temperature minus the logged one [K] at a time of the run [s]."""
        return 0.0

    def housing_conductance(self, rise: Value, speed: Value) -> Value:
        """Return the factor on the conductance of housing to ambient, at its rise [K] and a speed [rad/s]."""
        return 1.0

    def housing_heat(self, friction_power: Value) -> Value:
        """Return the heat into the housing [W] at a friction power [W]."""
        return 0.0

    def fixture(self) -> tuple[Value, Value] | None:
        """Return the heat capacity of a fixture [J/K] and its thermal resistance to the housing [K/W], or None."""
        return None

    def camera_reading(self, temperature: Value, ambient: Value) -> Value:
        """Return the temperature that the camera reads [degC]."""
        return temperature


HOOKS = tuple(name for name, member in vars(PlantEffect).items() if callable(member) and not name.startswith("_"))
"""Names of the methods of `PlantEffect`, which an effect may override."""
RIG_HOOKS = ("torque", "sense_current", "sense_torque")
"""Names of the hooks that the rig calls."""


def own_hooks(effect: PlantEffect) -> list[str]:
    """Return the names of the hooks that an effect overrides."""
    return [hook for hook in HOOKS if getattr(type(effect), hook) is not getattr(PlantEffect, hook)]
