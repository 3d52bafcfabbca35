"""A simulated bench: its numbers, and the functions by which effects change it, listed by the place where they act.

Each effect of the library puts its simulation form here (`Effect.act`), so that any of them combine: factors multiply,
torques and voltages add, transformations of a reference or a reading are applied in turn. Mechanical
functions see many stretches of runs at once (`Moment`), the others a whole run (`Course`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from leactl.model.nominal import Model

Array: TypeAlias = npt.NDArray[np.float64]
BEARING_GIVE = 5e-5  # rad over which friction builds up; bearings have 1e-6 to 1e-4


@dataclass
class Moment:
    """Rotors of many stretches of runs at one instant."""

    angle: Array  # rad
    velocity: Array  # rad/s, before this step's friction: its sign is the direction in which a rotor would move
    drive: Array  # N*m, of the current
    transmitted: Array  # N*m, torque on the shaft


@dataclass
class Course:
    """One run on an even clock."""

    time: Array  # s since the run's start
    interval: float  # s
    angle: Array  # rad
    housing: Array  # degC


OfMoment = Callable[[Moment], Array]  # a torque or factor for each rotor at one instant
OfCourse = Callable[[Course], Array]  # a factor over one run
Becomes = Callable[[Array, float], Array]  # changes values, given their interval [s]
Reads = Callable[[Course, Array], Array]  # changes a reading of a run


class ElasticLoad(NamedTuple):
    """A part of a rotor's inertia that is coupled by a spring and a damper."""

    share: float  # of the whole inertia
    frequency: float  # Hz, of its swing while the motor stands
    damping_ratio: float


class GearedLoad(NamedTuple):
    """A part of a rotor's inertia that teeth with play move, with its part of the friction."""

    share: float  # share of the whole inertia
    friction: float  # share of the whole friction


@dataclass
class Plant:
    """One bench to simulate; every list is empty where no effect acts."""

    model: Model
    stiffness: float | None  # N*m/rad, of the shaft
    resistance_coefficient: float  # 1/K
    play: float = 0.0  # rad, whole width between actuator and shaft, or of a free rotor's gear
    elastic_load: ElasticLoad | None = None  # on a free rotor
    geared_load: GearedLoad | None = None  # on a free rotor
    bristle: float = 0.0  # rad, angle over which friction builds up by an effect
    give: float = BEARING_GIVE  # rad, angle over which friction builds up in any bearing
    current_gain: float = 1.0  # measured current over current
    current_offset: float = 0.0  # A, measured current less current
    bus_resistance: float = 0.0  # ohm, of the supply
    camera_fraction: float = 1.0  # of the rise above ambient that the camera reads
    further_node: tuple[float, float] | None = None  # J/K and K/W of a body behind the housing

    command: list[Becomes] = field(default_factory=list)  # changes of the current loop's command [A]
    # changes of that command at a speed [rad/s]
    command_at_speed: list[Callable[[Array, Array], Array]] = field(default_factory=list)
    loop_answer: list[Becomes] = field(default_factory=list)  # changes of the current loop's response [A]
    set_point: list[Becomes] = field(default_factory=list)  # changes of a position servo's set-point [rad]
    servo_error: list[Callable[[Array], Array]] = field(default_factory=list)  # changes of the servo's error [rad]
    torque_share: list[Callable[[Array], Array]] = field(default_factory=list)  # factor at a current [A]
    magnet_share: list[OfCourse] = field(default_factory=list)  # factor on torque and back-EMF constant
    friction_share: list[OfCourse] = field(default_factory=list)  # factor on viscous damping and Coulomb friction
    lost_voltage: list[Callable[[Array], Array]] = field(default_factory=list)  # V at a current [A]

    ripple: list[OfMoment] = field(default_factory=list)  # relative change of the drive's torque
    rotor_torque: list[OfMoment] = field(default_factory=list)  # N*m that drives the rotor
    drag: list[OfMoment] = field(default_factory=list)  # N*m against the rotor, zero at standstill
    coulomb_share: list[OfMoment] = field(default_factory=list)  # factor on Coulomb friction
    coulomb_added: list[OfMoment] = field(default_factory=list)  # N*m of Coulomb friction beyond the model's

    torque_reading: list[Reads] = field(default_factory=list)  # changes of the torque reading [N*m]
    velocity_reading: list[Becomes] = field(default_factory=list)  # changes of the velocity reading [rad/s]
    angle_error: list[Callable[[Array], Array]] = field(default_factory=list)  # rad at an angle

    ambient_change: list[Callable[[Array], Array]] = field(default_factory=list)  # K at a time in the run
    convection: list[Callable[[Array, Array], Array]] = field(default_factory=list)  # relative, of rise and speed
    housing_heat: list[Callable[[Array], Array]] = field(default_factory=list)  # W at a speed


def plant_without_effects(model: Model) -> Plant:
    """Return the bench of a model without its effects."""
    return Plant(model, model.bench.shaft_stiffness, model.resistance_coefficient)
