"""Heat that the nominal thermal network lacks."""

import math
from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantAmbientDrift(PlantEffect):
    """Ambient temperature that departs from the logged one.

    The departure follows half a cosine over two hours, and is `change` from then on.
    """

    change: float = bounded(0.0, -50.0, 50.0)  # K

    def ambient_error(self, time: float) -> Value:
        """Return the departure [K], which begins slowly, as when a door stays open."""
        return self.change * 0.5 * (1.0 - math.cos(math.pi * min(time / 7200.0, 1.0)))


@dataclass(frozen=True)
class PlantRotationalHeat(PlantEffect):
    """Friction and iron loss that heat the machine.

    Heat into the housing = fraction x (b w^2 + f |w|), with viscous damping b and Coulomb friction f.
    """

    fraction: float = bounded(0.0, 0.0, 10.0)

    def housing_heat(self, friction_power: Value) -> Value:
        """Return a fraction of the friction power [W]."""
        return self.fraction * friction_power


@dataclass(frozen=True)
class PlantThirdThermalNode(PlantEffect):
    """A fixture that takes up heat from the housing.

    A heat capacity coupled to the housing through a thermal resistance.
    """

    capacitance: float = bounded(500.0, 1e-3, 1e6)  # J/K
    resistance: float = bounded(2.0, 1e-3, 1e6)  # K/W

    def fixture(self) -> tuple[Value, Value]:
        """Return capacity [J/K] and thermal resistance [K/W]."""
        return self.capacitance, self.resistance


@dataclass(frozen=True)
class PlantForcedConvection(PlantEffect):
    """Convection that grows with the rotor's speed.

    Conductance x (1 + coefficient |speed| / 0.8)^0.8, as a turbulent boundary layer gives.
    """

    coefficient: float = bounded(0.0, 0.0, 10.0)  # s/rad

    def housing_conductance(self, rise: Value, speed: Value) -> Value:
        """Return a factor on the conductance that grows with speed."""
        return (1.0 + 1.25 * self.coefficient * np.abs(speed)) ** 0.8


@dataclass(frozen=True)
class PlantNonlinearConvection(PlantEffect):
    """Convection that grows with the housing's temperature.

    Conductance x sqrt(1 + 2 coefficient rise): relative growth `coefficient` per kelvin at first, less later.
    """

    coefficient: float = bounded(0.0, 0.0, 1.0)  # 1/K

    def housing_conductance(self, rise: Value, speed: Value) -> Value:
        """Return a factor on the conductance that grows with the magnitude of the rise."""
        return np.sqrt(1.0 + 2.0 * self.coefficient * np.abs(rise))
