"""References of a joint in a run, one row a sample: a current, or a speed that the drive's servo holds."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.joints.effects import SLOWEST_LEVEL
from leactl.joints.machine import Generator, JointMachine

Array = npt.NDArray[np.float64]
LEVEL_COUNT = 10  # held levels of a run
SERVO_HZ = 3.0  # bandwidth of the velocity servo
SERVO_CORNER_HZ = 0.6  # frequency below which the servo's integral acts


@dataclass(frozen=True)
class JointProgram:
    """References of one run, one value per sample; one of the two is given."""

    current: Array | None  # A
    velocity: Array | None  # rad/s, held by the drive's servo


def draw_program(draw: Generator, machine: JointMachine, protocol: str) -> JointProgram:
    """Draw the references of a run of a protocol."""
    time = np.arange(round(machine.seconds * machine.rate)) / machine.rate
    if protocol == "levels":
        sizes = np.geomspace(SLOWEST_LEVEL, 1.0, LEVEL_COUNT) * draw.uniform(0.9, 1.1, LEVEL_COUNT)
        signs = np.tile([1.0, -1.0], LEVEL_COUNT // 2) * draw.choice([-1.0, 1.0])
        return JointProgram(None, machine.speed * hold_levels(draw.permutation(sizes) * signs, time))
    if protocol == "ramp":
        phase = 2.0 * np.pi * 2.0 * time / machine.seconds
        triangle = 2.0 / np.pi * np.arcsin(np.sin(phase)) * draw.choice([-1.0, 1.0])
        return JointProgram(None, machine.speed * draw.uniform(0.7, 1.0) * triangle)
    if protocol == "steps":
        breakaway_current = machine.coulomb_friction / machine.torque_constant
        sizes = draw.uniform(1.1 * breakaway_current, machine.current / 1.3, LEVEL_COUNT) * np.tile(
            [1.0, -1.0], LEVEL_COUNT // 2
        )
        return JointProgram(hold_levels(sizes, time), None)
    frequencies = np.geomspace(0.2, 9.0, 9)
    waves = [np.sin(2.0 * np.pi * (f * time + draw.random())) / np.sqrt(f) for f in frequencies]
    multisine = np.sum(waves, axis=0)
    # an RMS current that overcomes friction, so that the rotor turns to and fro
    current = multisine / np.std(multisine) * draw.uniform(0.45, 0.6) * machine.current
    return JointProgram(np.clip(current, -machine.current, machine.current), None)


def hold_levels(levels: Array, time: Array) -> Array:
    """Return levels that are each held for the same time, shape (samples,)."""
    return np.asarray(levels[np.arange(len(time)) * len(levels) // len(time)], np.float64)
