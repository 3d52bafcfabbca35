"""The three leads of an emulated motor: line-to-line voltages, interpolated between samples of the plant.

Every phase carries the q-axis voltage at the electrical angle (the back-EMF if no current flows), and the harmonics
of the bench file. Between two samples, angle and voltage are linear.
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
MOST_SAMPLES = 64  # kept; they cover about 8 ms, and a converter reads once a millisecond
THIRD_OF_A_TURN = 2.0 * math.pi / 3.0
PHASE_PER_Q_VOLT = math.sqrt(2.0 / 3.0)  # amplitude of a phase over the q-axis voltage, power-invariant


class MotorTerminals:
    """Line-to-line voltages of one actuator, with noise; `chance` is the random generator of the noise."""

    def __init__(
        self,
        actuator: Actuator | SteppedActuator,
        harmonics: Sequence[Harmonic],
        noise_V: float,  # noqa: N803 (a unit keeps its letter)
        chance: np.random.Generator,
    ) -> None:
        self._actuator, self._harmonics, self._noise, self.chance = actuator, harmonics, noise_V, chance
        self._samples: deque[tuple[float, float, float]] = deque(maxlen=MOST_SAMPLES)
        self._columns: Array | None = (
            None  # times [s], angles [rad] and voltages [V] of the samples, made when first needed
        )

    def sample(self, time: float) -> None:
        """Sample angle and voltage at the present time [s]."""
        self._samples.append((time, self._actuator.angle, self._actuator.voltage))
        self._columns = None

    def voltages(self, times: Array, pair: int) -> Array:
        """Return the voltages [V] of a pair of leads (0 ab, 1 bc, 2 ca) at some times [s]."""
        if self._columns is None:
            self._columns = np.array(self._samples).T
        sample_times, sampled_angles, sampled_voltages = self._columns
        parameters = self._actuator.parameters
        electrical_angle = (
            parameters.pole_pairs * np.interp(times, sample_times, sampled_angles)
            + parameters.phases.commutation_offset
        )
        amplitude = PHASE_PER_Q_VOLT * np.interp(times, sample_times, sampled_voltages)
        line_to_line = self._phase(electrical_angle, pair) - self._phase(electrical_angle, (pair + 1) % 3)
        if parameters.winding == "delta":  # a pair is one phase, of the same shape and angle as the wye's difference
            line_to_line = line_to_line / math.sqrt(3.0)
        return np.asarray(amplitude * line_to_line + self._noise * self.chance.standard_normal(len(times)))

    def _phase(self, angle: Array, phase: int) -> Array:
        """Return the voltage of a phase over the amplitude of its fundamental, at electrical angles [rad]."""
        phase_angle = angle - phase * THIRD_OF_A_TURN
        phase_voltage = -np.sin(phase_angle)  # the q axis leads the angle by a quarter turn
        for harmonic in self._harmonics:
            phase_voltage -= harmonic.share * np.sin(harmonic.order * phase_angle + harmonic.phase_rad)
        return np.asarray(phase_voltage)
