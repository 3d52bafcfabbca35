"""One run of a specimen: what a simulator is given and what it gives back."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.joints.effects import DrawnEffect
from leactl.joints.machine import Generator, Specimen
from leactl.joints.programs import JointProgram

Array = npt.NDArray[np.float64]
PARTS = 8  # steps of a simulator in a sample


@dataclass(frozen=True)
class Log:
    """What a log does not say: how a reference is held, and where in a sample a value is from."""

    holds: bool = True  # whether the drive holds a reference until the next; else it goes there on a straight line
    reference_before: bool = True  # whether a row has the reference that acted before its stamp
    current_late: int = 0  # parts of a sample, by which a value is older than its stamp
    velocity_late: int = 0


@dataclass(frozen=True)
class JointRun:
    """A specimen, what is wrong with it, what is asked of it."""

    name: str
    protocol: str
    specimen: Specimen
    effects: tuple[DrawnEffect, ...]
    program: JointProgram
    log: Log
    angle: float  # rad, at the start
    seed: int

    def parameter(self, effect: str, name: str, otherwise: float = 0.0) -> float:
        """A parameter of an effect; what does nothing where the effect is not there."""
        for drawn in self.effects:
            if drawn.name == effect:
                return drawn.parameters[name]
        return otherwise

    def asked(self, program: Array | None) -> Array:
        """A reference of the program, zero where it has none."""
        length = self.program.current if self.program.current is not None else self.program.velocity
        assert length is not None
        return np.zeros(len(length)) if program is None else program


@dataclass(frozen=True)
class JointSignals:
    """What the drive has at the end of every sample, free of noise."""

    reference: Array  # A, that acted in the sample
    current: Array  # A, mean over a sample
    velocity: Array  # rad/s, filtered
    angle: Array  # rad, as the encoder has it


def draw_log(draw: Generator, says: bool) -> Log:
    """The conventions of a log; those of the run format where the log says what its stamps mean."""
    if says:
        return Log()
    late = draw.integers(0, PARTS, 2)
    return Log(bool(draw.random() < 0.5), bool(draw.random() < 0.5), int(late[0]), int(late[1]))
