"""Drives, inverters and supplies whose current differs from the demanded one."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import Path, PlantEffect, Value
from leactl.emulation.plant.effects.lag_and_delay import Delay
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantTransportDelay(PlantEffect):
    """A drive whose current follows its reference after a delay, as from a fieldbus or a slow cycle.

    The current loop gets the reference of a time `delay` before.
    """

    delay: float = bounded(0.0, 0.0, 0.5)  # s

    def reference_path(self, lanes: int, step_s: float) -> Path:
        """Return the delay line of the reference."""
        return Delay(self.delay, lanes, step_s)


@dataclass(frozen=True)
class PlantCommandSlewLimit(PlantEffect):
    """A drive whose current reference changes no faster than a fixed rate.

    The current reference changes by at most rate x step.
    """

    rate: float = bounded(1e6, 1e-3, 1e9)  # A/s

    def reference_path(self, lanes: int, step_s: float) -> Path:
        """Return a function that moves towards the reference by at most rate x step."""
        limited_reference = np.zeros(lanes)
        highest_change = self.rate * step_s

        def step(reference: Value) -> Value:
            """Return the reference [A] that the rate allows in this step."""
            np.add(
                limited_reference,
                np.minimum(np.maximum(reference - limited_reference, -highest_change), highest_change),
                out=limited_reference,
            )
            return limited_reference

        return step


@dataclass(frozen=True)
class PlantTorqueLimit(PlantEffect):
    """A drive that limits its current below the reference.

    The current loop follows its reference up to a maximum current.
    """

    current: float = bounded(1e4, 1e-3, 1e6)  # A

    def bounded_reference(self, reference: Value, torque_constant: Value, velocity: Value) -> Value:
        """Return the reference [A], clipped at the maximum in both directions."""
        return np.minimum(np.maximum(reference, -self.current), self.current)


LEAST_SPEED = 1e-6  # rad/s; below it the limit is constant, since at zero it would be infinite


@dataclass(frozen=True)
class PlantPowerFoldback(PlantEffect):
    """A drive that reduces its current at speed.

    The current loop follows its reference as far as the power limit allows.
    """

    power: float = bounded(1e6, 1e-3, 1e9)  # W

    def bounded_reference(self, reference: Value, torque_constant: Value, velocity: Value) -> Value:
        """Return the reference [A], limited so that torque constant x velocity x current stays within the power."""
        highest_current = self.power / (torque_constant * np.maximum(np.abs(velocity), LEAST_SPEED))
        return np.minimum(np.maximum(reference, -highest_current), highest_current)


@dataclass(frozen=True)
class PlantVoltageLimit(PlantEffect):
    """A drive at the end of its voltage.

    The current loop follows its reference as far as the voltage drives a current against the back-EMF.
    """

    stall_current: float = bounded(1e6, 1e-3, 1e9)  # A
    no_load_speed: float = bounded(1e6, 1e-3, 1e9)  # rad/s

    def bounded_reference(self, reference: Value, torque_constant: Value, velocity: Value) -> Value:
        """Return the reference [A], limited to what voltage less back-EMF drives through the winding."""
        back_emf = self.stall_current * velocity / self.no_load_speed
        return np.minimum(np.maximum(reference, -self.stall_current - back_emf), self.stall_current - back_emf)


@dataclass(frozen=True)
class PlantDeadTime(PlantEffect):
    """An inverter that loses voltage, with the sign of the current.

    Loss = voltage x i / sqrt(i^2 + current^2).
    """

    voltage: float = bounded(0.0, 0.0, 20.0)  # V
    current: float = bounded(0.3, 1e-3, 100.0)  # A

    def lost_voltage(self, current: Value) -> Value:
        """Return the loss [V], which rises with the current and saturates."""
        return self.voltage * current / np.hypot(current, self.current)


@dataclass(frozen=True)
class PlantBusSag(PlantEffect):
    """A supply with an internal resistance.

    Voltage at which source and load agree: V = source - resistance x power / V.
    """

    resistance: float = bounded(0.0, 0.0, 10.0)  # ohm

    def bus_voltage(self, source: Value, power: Value) -> Value:
        """Return the upper root of the quadratic [V], or half the source's voltage if it cannot supply the power."""
        return 0.5 * (source + np.sqrt(np.maximum(source * source - 4.0 * self.resistance * power, 0.0)))
