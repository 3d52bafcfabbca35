"""A machine with its nominal model, and specimens of it, whose parameters all differ from the nominal ones."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from leactl import yamlfile

Generator = np.random.Generator
DURATIONS_S = (12.0, 20.0)  # range of the duration of a run
SAMPLING_RATES_HZ = (250.0, 400.0, 500.0, 1000.0)
PROTOCOLS = ("multisine", "levels", "ramp", "steps")
TORQUE_RESERVE = 1.6  # highest torque over the torque at the highest constant speed
# largest relative departures of a specimen from the nominal model
SPREADS = {"torque_constant": 0.06, "rotor_inertia": 0.15, "viscous_damping": 0.3, "coulomb_friction": 0.3}


@dataclass(frozen=True)
class JointMachine:
    """Nominal parameters of a machine, and how its runs are made and logged."""

    kind: str
    rate: float  # Hz, sampling rate
    seconds: float  # s, duration of a run
    torque_constant: float  # N*m/A
    rotor_inertia: float  # kg*m^2
    viscous_damping: float  # N*m*s/rad
    coulomb_friction: float  # N*m
    current: float  # A, highest current
    speed: float  # rad/s, highest speed
    pole_pairs: int
    loop: float  # Hz, bandwidth of the current loop
    filter: float  # Hz, bandwidth of the velocity filter
    count: float  # rad, resolution of the encoder
    current_noise: float  # A, standard deviation
    velocity_noise: float  # rad/s, standard deviation
    protocols: tuple[str, ...]
    channels: tuple[str, ...]
    sampling: bool  # whether the log states what its stamps mean

    @property
    def friction(self) -> float:
        """Coulomb and viscous friction torque at the highest speed [N*m]."""
        return self.coulomb_friction + self.viscous_damping * self.speed

    def scale(self, name: str) -> float:
        """Return a scale by name; `sizes.yaml` declares the sizes of effects in multiples of it."""
        scales = {
            "1": 1.0,
            "friction": self.friction,
            "drag": self.friction / self.speed**2,
            "spring": self.friction / (self.speed * self.seconds),
            "current": self.current,
            "interval": 1.0 / self.rate,
            "lag": 1.0 / (2.0 * np.pi * self.filter),
            "power": self.torque_constant * self.current * self.speed,
            "rate": 2.0 * np.pi * self.current,
        }
        return float(scales[name])


@dataclass(frozen=True)
class Specimen:
    """True parameters of one specimen of a machine."""

    machine: JointMachine
    torque_constant: float  # N*m/A
    rotor_inertia: float  # kg*m^2
    viscous_damping: float  # N*m*s/rad
    coulomb_friction: float  # N*m

    def true_base(self) -> dict[str, float]:
        """Return the true parameters under the names of a model file."""
        return {name: getattr(self, name) for name in SPREADS} | {"back_emf_constant": self.torque_constant}


def draw_machine(draw: Generator, kind: str) -> JointMachine:
    """Draw a machine of a kind in `machines.yaml`, and how it is run and logged."""
    values = {name: logarithmic(draw, *limits) for name, limits in kinds()[kind].items()}
    friction = values["torque_constant"] * values["current"] / TORQUE_RESERVE
    coulomb, speed, rate = values["coulomb"] * friction, values["speed"], float(draw.choice(SAMPLING_RATES_HZ))
    channels = ["current", "angle"]
    channels += [name for name, share in (("current_reference", 0.85), ("velocity", 0.85)) if draw.random() < share]
    channels += ["velocity_reference"] if draw.random() < 0.5 else []
    # levels last long enough to show friction; the other two protocols are drawn
    other_protocols = draw.choice([name for name in PROTOCOLS if name != "levels"], 2, replace=False)
    return JointMachine(
        kind=kind,
        rate=rate,
        seconds=float(draw.uniform(*DURATIONS_S)),
        torque_constant=values["torque_constant"],
        rotor_inertia=friction / speed * values["time"],
        viscous_damping=(friction - coulomb) / speed,
        coulomb_friction=coulomb,
        current=values["current"],
        speed=speed,
        pole_pairs=int(draw.integers(2, 22)),
        loop=rate * float(draw.uniform(0.15, 0.3)),
        filter=rate * float(draw.uniform(0.1, 0.2)),
        count=2.0 * np.pi / 2 ** int(draw.integers(12, 18)),
        current_noise=values["current"] * logarithmic(draw, 5e-4, 4e-3),
        velocity_noise=speed * logarithmic(draw, 1e-4, 1e-3),
        protocols=("levels", *(str(name) for name in other_protocols)),
        channels=tuple(channels),
        sampling=bool(draw.random() < 0.6),
    )


def draw_specimen(draw: Generator, machine: JointMachine) -> Specimen:
    """Draw the true parameters of one specimen of a machine."""
    factors = {name: 1.0 + spread * float(draw.uniform(-1.0, 1.0)) for name, spread in SPREADS.items()}
    return Specimen(machine, **{name: getattr(machine, name) * factor for name, factor in factors.items()})


def nominal_text(machine: JointMachine) -> str:
    """Return the text of the nominal model file, which is stored with the runs."""
    return f"""\
name: {machine.kind}
torque_constant: {machine.torque_constant:.6g}  # N*m/A
back_emf_constant: {machine.torque_constant:.6g}  # V*s/rad
rotor_inertia: {machine.rotor_inertia:.6g}  # kg*m^2
viscous_damping: {machine.viscous_damping:.6g}  # N*m*s/rad
coulomb_friction: {machine.coulomb_friction:.6g}  # N*m
bench:
  current_loop_bandwidth: {machine.loop:.6g}  # Hz, first order
  velocity_filter_bandwidth: {machine.filter:.6g}  # Hz, first order
"""


def logarithmic(draw: Generator, low: float, high: float) -> float:
    """Draw a number between two limits, uniformly on a logarithmic scale."""
    return float(np.exp(draw.uniform(np.log(low), np.log(high))))


def kinds() -> Mapping[str, Mapping[str, tuple[float, float]]]:
    """Return the limits of the drawn parameters of each kind of machine."""
    limits: Mapping[str, Mapping[str, tuple[float, float]]] = package_yaml("machines.yaml")
    return limits


@cache
def package_yaml(name: str) -> Any:
    """Return the content of a YAML file of this package."""
    return yamlfile.parse((resources.files(__package__) / name).read_text(encoding="utf-8"), name).data
