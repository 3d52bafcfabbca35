"""One run of a specimen: the input of a simulator and its output."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.joints.effects import DrawnEffect
from leactl.joints.machine import Generator, Specimen
from leactl.joints.programs import JointProgram

Array = npt.NDArray[np.float64]
STEPS_PER_SAMPLE = 8  # simulation steps of either simulator


@dataclass(frozen=True)
class Log:
    """Conventions that a log does not state: how a reference is held, and the age of a value within a sample."""

    holds: bool = True  # whether the drive holds a reference until the next; else it is interpolated linearly
    reference_before: bool = True  # whether a row has the reference that acted before its stamp, not after it
    current_late: int = 0  # age of a current at its stamp, in steps of the simulation
    velocity_late: int = 0  # age of a velocity at its stamp, in steps of the simulation


@dataclass(frozen=True)
class JointRun:
    """A run of a specimen: its effects, its references, and the conventions of its log."""

    name: str
    protocol: str
    specimen: Specimen
    effects: tuple[DrawnEffect, ...]
    program: JointProgram
    log: Log
    angle: float  # rad, of the rotor at the start
    seed: int

    def parameter(self, effect: str, name: str, otherwise: float = 0.0) -> float:
        """Return a parameter of an effect; if the run lacks the effect, `otherwise`, a value that changes nothing."""
        for drawn in self.effects:
            if drawn.name == effect:
                return drawn.parameters[name]
        return otherwise

    def reference_or_zeros(self, reference: Array | None) -> Array:
        """Return a reference of the program; zeros of the same length for None."""
        given_reference = self.program.current if self.program.current is not None else self.program.velocity
        assert given_reference is not None
        return np.zeros(len(given_reference)) if reference is None else reference


@dataclass(frozen=True)
class JointSignals:
    """Signals of the drive at the end of every sample, without noise."""

    reference: Array  # A, held in the sample
    current: Array  # A, mean over a sample
    velocity: Array  # rad/s, filtered
    angle: Array  # rad, as the encoder reads it


def draw_log(draw: Generator, is_stated: bool) -> Log:
    """Return the conventions of a log: drawn, or those of the run format if the log states what its stamps mean."""
    if is_stated:
        return Log()
    current_age, velocity_age = draw.integers(0, STEPS_PER_SAMPLE, 2)
    return Log(bool(draw.random() < 0.5), bool(draw.random() < 0.5), int(current_age), int(velocity_age))
