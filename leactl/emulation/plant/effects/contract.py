"""What an effect may do to the plant; each method left alone means: nothing.

The rig (exact steps, one bench) knows `torque`, `sense_current` and `sense_torque`. The stepped plant knows all of
them and calls each over many lanes at once: an effect made by `stacked` holds arrays where one made alone holds
numbers, and its methods are written for both.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Self, TypeAlias

import numpy as np

from leactl.emulation.plant.parameters import Checked
from leactl.errors import InputError

Value: TypeAlias = Any  # a number in the rig, an array over lanes in the stepped plant
Path: TypeAlias = Callable[[Value], Value]  # takes a signal once per step and gives what becomes of it


class Now:
    """What holds in the lanes of one effect at one moment: views that the plant keeps up to date."""

    time: float = 0.0  # s since the run's start
    angle: Value  # rad, of the rotor
    velocity: Value  # rad/s, friction of this step not yet taken off
    current: Value  # A, that flows
    shaft_torque: Value  # N*m
    winding: Value  # degC
    housing: Value  # degC


@dataclass(frozen=True)
class PlantEffect(Checked):
    """One thing that the nominal plant lacks, on one actuator."""

    adds_torque: ClassVar[bool] = False
    needs_whole_record: ClassVar[bool] = False  # `torque_record` looks ahead: nothing for a live bench
    role: str = "test"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.role not in ("test", "load"):
            raise InputError(f"role: found {self.role!r}, expected test or load")

    @classmethod
    def stacked(cls, effects: "Sequence[PlantEffect]") -> Self:
        """One effect over lanes, its parameters arrays, from as many single ones as there are lanes."""
        over = object.__new__(cls)
        for item in fields(cls):
            values = [getattr(effect, item.name) for effect in effects]
            object.__setattr__(over, item.name, values[0] if item.name == "role" else np.array(values, np.float64))
        return over

    # ------------------------------------------------------------ rig and stepped plant

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Torque on the rotor [N*m], asked for at most every 0.25 ms where `adds_torque` is set."""
        return 0.0

    def sense_current(self, current: Value) -> Value:
        """What the drive's current sensor makes of a current [A]; affine, since the current loop closes over it."""
        return current

    def sense_torque(self, torque: Value) -> Value:
        """What the shaft's torque sensor makes of a torque [N*m]; the role does not matter."""
        return torque

    # ------------------------------------------------------------ stepped plant: mechanics

    def shaft_stiffness(self, nominal: Value) -> Value:
        """Stiffness of the shaft [N*m/rad]."""
        return nominal

    def transmitted_twist(self, twist: Value) -> Value:
        """The part of the twist between the actuators that strains the shaft [rad]."""
        return twist

    def torque_share(self, now: Now) -> Value:
        """Factor on the torque constant at this angle and current."""
        return 1.0

    def coulomb(self, level: Value, now: Now) -> Value:
        """Coulomb friction [N*m] in place of this level."""
        return level

    def friction_share(self, now: Now) -> Value:
        """Factor on viscous damping and Coulomb friction, asked for every millisecond."""
        return 1.0

    def friction_path(self, lanes: int, step_s: float) -> Callable[[Value, Value], Value] | None:
        """Coulomb friction of a form with a memory: takes its level and the velocity, gives the torque on the rotor."""
        return None

    def rotor_path(self, lanes: int, step_s: float) -> Callable[[Now], Value] | None:
        """A torque on the rotor with a memory, or of more than angle and velocity [N*m]."""
        return None

    # ------------------------------------------------------------ stepped plant: electrics

    def magnet_share(self, now: Now) -> Value:
        """Factor on torque and back-EMF constant, asked for every millisecond."""
        return 1.0

    def resistance_share(self, winding: Value, time: float) -> Value:
        """Factor on the winding resistance."""
        return 1.0

    def reference_path(self, lanes: int, step_s: float) -> Path | None:
        """What the current loop follows [A] in place of the reference it is given."""
        return None

    def bounded_reference(self, reference: Value, torque_constant: Value, velocity: Value) -> Value:
        """What the drive allows of a current reference [A], asked for every millisecond."""
        return reference

    def lost_voltage(self, current: Value) -> Value:
        """Voltage that the drive applies and the winding does not see [V]."""
        return 0.0

    def bus_voltage(self, source: Value, power: Value) -> Value:
        """Bus voltage [V] under a power drawn from it [W]."""
        return source

    # ------------------------------------------------------------ stepped plant: sensors

    def encoder_error(self, angle: Value) -> Value:
        """Error of the encoder [rad] at an angle."""
        return 0.0

    def velocity_path(self, lanes: int, step_s: float) -> Path | None:
        """What becomes of the velocity behind the drive's filter."""
        return None

    def torque_path(self, lanes: int, step_s: float) -> Path | None:
        """What becomes of the torque behind the sensor's filter."""
        return None

    def torque_record(self, torque: Value, angle: Value, time: Value) -> Value:
        """A whole record of torque, a column a lane, as the sensor gives it."""
        return torque

    def angle_record(self, angle: Value, time: Value) -> Value:
        """A whole record of the angle, a column a lane, as the encoder gives it."""
        return angle

    # ------------------------------------------------------------ stepped plant: heat

    def ambient_error(self, time: float) -> Value:
        """True ambient minus the logged one [K]."""
        return 0.0

    def housing_conductance(self, rise: Value, speed: Value) -> Value:
        """Factor on the conductance from housing to ambient, at a rise of the housing [K] and a speed [rad/s]."""
        return 1.0

    def housing_heat(self, friction_power: Value) -> Value:
        """Heat into the housing [W] from a power that friction takes."""
        return 0.0

    def fixture(self) -> tuple[Value, Value] | None:
        """Heat capacity that hangs on the housing [J/K] and the resistance between them [K/W]."""
        return None

    def camera(self, temperature: Value, ambient: Value) -> Value:
        """What the camera reads [degC]."""
        return temperature


HOOKS = tuple(name for name, thing in vars(PlantEffect).items() if callable(thing) and not name.startswith("_"))
"""Names of everything an effect may do."""
RIG_HOOKS = ("torque", "sense_current", "sense_torque")
"""Those of them that the rig can express."""


def own_hooks(effect: PlantEffect) -> list[str]:
    """Those for which an effect has a form of its own."""
    return [hook for hook in HOOKS if getattr(type(effect), hook) is not getattr(PlantEffect, hook)]
