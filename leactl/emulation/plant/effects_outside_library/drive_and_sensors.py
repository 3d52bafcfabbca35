"""Faults of drive, terminals and sensors without a name in the vocabulary."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.signal import lfilter

from leactl.emulation.plant.effects.contract import Path, Value
from leactl.emulation.plant.effects_outside_library.drawn import Unlisted, between
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class CoarseCurrentCommand(Unlisted):
    """A drive that rounds its current command to coarse steps and ignores smaller changes.

    The current loop follows the reference rounded to a step.
    """

    step: float = bounded(0.1, 1e-6, 100.0)  # A

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw a step between 0.06 and 0.8 A."""
        return cls(step=between(0.06, 0.8, size))

    def reference_path(self, lanes: int, step_s: float) -> Path:
        """Return a function that rounds the reference to the step."""

        def rounded(reference: Value) -> Value:
            return np.rint(reference / self.step) * self.step

        return rounded


@dataclass(frozen=True)
class LooseTerminal(Unlisted):
    """A terminal with intermittent contact: the resistance rises for a while and returns.

    Resistance x (1 + share) while a sum of three incommensurate sines of time is high.
    """

    share: float = bounded(0.1, 0.0, 10.0)
    period: float = bounded(7.0, 0.1, 1000.0)  # s
    phase: float = bounded(0.0, 0.0, 7.0)  # rad

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw a rise by 3 to 50 % of the resistance with a period of 3 to 9 s."""
        return cls(
            share=between(0.03, 0.5, size), period=float(draw.uniform(3.0, 9.0)), phase=float(draw.uniform(0.0, 6.28))
        )

    def afresh(self, draw: np.random.Generator) -> Self:
        """Draw other times for the bad contact."""
        return replace(self, phase=float(draw.uniform(0.0, 6.28)))

    def resistance_share(self, winding: Value, time: float) -> Value:
        """Return 1 + share during bad contact, else 1."""
        phase_angle = 2.0 * np.pi * time / self.period + self.phase
        waves = np.sin(phase_angle) + np.sin(1.618 * phase_angle + 1.0) + np.sin(2.449 * phase_angle + 2.0)
        return 1.0 + self.share * (waves > 1.2)


@dataclass(frozen=True)
class EncoderGlitches(Unlisted):
    """An encoder that occasionally gives wrong counts for some milliseconds.

    Errors of both signs, `rate` a second, each lasting 2 to 30 ms.
    """

    size: float = bounded(0.01, 0.0, 10.0)  # rad
    rate: float = bounded(1.0, 0.0, 100.0)  # 1/s
    key: float = bounded(0.0, 0.0, 1e6)  # seed of the times and signs

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw errors of 6 to 100 counts, 0.5 to 3 times a second."""
        return cls(
            size=between(0.001, 0.015, size),
            rate=float(draw.uniform(0.5, 3.0)),
            key=float(draw.integers(0, 1000000)),
        )

    def afresh(self, draw: np.random.Generator) -> Self:
        """Draw other times for the errors."""
        return replace(self, key=float(draw.integers(0, 1000000)))

    def angle_record(self, angle: Value, time: Value) -> Value:
        """Return the recorded angle with the errors [rad]."""
        sample_count = len(angle)
        generator = np.random.default_rng(int(self.key))
        error = np.zeros(sample_count)
        for first_sample in generator.integers(
            0, sample_count, generator.poisson(self.rate * float(time[-1, 0] - time[0, 0]))
        ):
            error[first_sample : first_sample + int(generator.integers(2, 31))] = self.size * generator.choice(
                [-1.0, 1.0]
            )
        return angle + error[:, None]


@dataclass(frozen=True)
class SensorCreep(Unlisted):
    """A torque sensor whose glue creeps: after a change of torque the reading keeps changing for half a minute.

    Reading = torque + share x lagged torque, with a first-order lag of the time constant.
    """

    share: float = bounded(0.01, 0.0, 1.0)
    time_constant: float = bounded(10.0, 0.1, 1000.0)  # s

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw a creep of 0.6 to 8 % of the torque within 4 to 15 s."""
        return cls(share=between(0.006, 0.08, size), time_constant=float(draw.uniform(4.0, 15.0)))

    def torque_record(self, torque: Value, angle: Value, time: Value) -> Value:
        """Return the recorded torque with its creep [N*m]."""
        step = float(time[1, 0] - time[0, 0])
        gain = -np.expm1(-step / self.time_constant)
        return torque + self.share * lfilter([gain], [1.0, gain - 1.0], torque, axis=0)
