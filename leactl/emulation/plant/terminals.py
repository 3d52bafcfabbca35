"""The three leads of an emulated motor: line-to-line voltages between the moments at which the plant is looked at.

Every phase carries the q-axis voltage at the electrical angle, as back-EMF where no current flows, and what harmonics
the bench file gives it; between two looks the angle and the voltage go straight.
"""

import math
from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from leactl.bench.benchfile import Harmonic
from leactl.emulation.plant.exact.rig import Actuator
from leactl.emulation.plant.stepped.rig import SteppedActuator

Array = NDArray[np.float64]
KEPT = 64  # looks, some 8 ms at the most of them; a converter asks once a millisecond
THIRD = 2.0 * math.pi / 3.0
TO_PHASE = math.sqrt(2.0 / 3.0)  # amplitude of a phase over the q-axis voltage, power-invariant


class MotorTerminals:
    """Line-to-line voltages of one actuator, noise included; `chance` is the bench's own source of it."""

    def __init__(
        self,
        actuator: Actuator | SteppedActuator,
        harmonics: Sequence[Harmonic],
        noise_V: float,  # noqa: N803 (a unit keeps its letter)
        chance: np.random.Generator,
    ) -> None:
        self._actuator, self._harmonics, self._noise, self.chance = actuator, harmonics, noise_V, chance
        self._looks: deque[tuple[float, float, float]] = deque(maxlen=KEPT)
        self._columns: Array | None = None  # of the looks, made when first asked for

    def look(self, now: float) -> None:
        """Take angle and voltage as they are now."""
        self._looks.append((now, self._actuator.angle, self._actuator.voltage))
        self._columns = None

    def voltages(self, times: Array, pair: int) -> Array:
        """Voltages [V] of a pair (0 ab, 1 bc, 2 ca) at these times."""
        if self._columns is None:
            self._columns = np.array(self._looks).T
        moments, angles, volts = self._columns
        parameters = self._actuator.parameters
        angle = parameters.pole_pairs * np.interp(times, moments, angles) + parameters.phases.commutation_offset
        amplitude = TO_PHASE * np.interp(times, moments, volts)
        difference = self._phase(angle, pair) - self._phase(angle, (pair + 1) % 3)
        if parameters.winding == "delta":  # a pair is one phase, of the same shape and angle as the wye's difference
            difference = difference / math.sqrt(3.0)
        return np.asarray(amplitude * difference + self._noise * self.chance.standard_normal(len(times)))

    def _phase(self, angle: Array, number: int) -> Array:
        own = angle - number * THIRD
        shape = -np.sin(own)  # the q axis leads the angle by a quarter turn
        for item in self._harmonics:
            shape -= item.share * np.sin(item.order * own + item.phase_rad)
        return np.asarray(shape)
