"""Loads behind teeth with play, moved by a motor whose motion is known."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
PIECE_SAMPLES = 128  # samples in a piece of a run; pieces are stepped side by side
STEPS_PER_SAMPLE = 4  # steps from one sample to the next
MOST_PASSES = 6  # most passes until each piece begins as the previous one ends
MOST_ANGLE_MISMATCH = 0.02  # between a piece's start and the previous end, as a share of half the play
MOST_SPEED_MISMATCH = 1e-3  # the same as a share of the highest speed


def follow_loads(
    speed: Array, interval: float, half_plays: Array, damping: Array, friction: Array
) -> tuple[Array, Array]:
    """Return speeds [rad/s] of loads driven through play, and the motor's relative angle [rad]; (loads, samples).

    Pieces of a run are stepped side by side; those that did not begin at the end of the previous one are repeated.

    Parameters
    ----------
    speed : rad/s, of the motor at its samples.
    half_plays : rad, of each load.
    damping : 1/s, decay rate of each load while it is free.
    friction : rad/s^2, deceleration of each by Coulomb friction.
    """
    loads, pieces = len(half_plays), -(-(len(speed) - 1) // PIECE_SAMPLES)
    motor = np.concatenate([speed, np.full(pieces * PIECE_SAMPLES + 1 - len(speed), speed[-1])])
    begins = np.arange(pieces) * PIECE_SAMPLES
    # states are speed of the load and angle of the motor beyond it; first guess: pressed in the motor's direction
    starts = np.stack([motor[begins] * np.ones((loads, 1)), half_plays[:, None] * np.sign(motor[begins])])
    states = np.zeros((2, PIECE_SAMPLES, loads, pieces))
    fastest = float(np.max(np.abs(speed)))
    shares = np.arange(STEPS_PER_SAMPLE + 1)[:, None] / STEPS_PER_SAMPLE  # of a sample's interval
    # load and piece of each lane; in the first pass there is a lane for every piece of every load
    load, piece = (index.ravel() for index in np.indices((loads, pieces)))
    for _ in range(MOST_PASSES):
        teeth = Teeth(half_plays[load], damping[load], friction[load], interval / STEPS_PER_SAMPLE)
        state = starts[0, load, piece], starts[1, load, piece]
        for index in range(PIECE_SAMPLES):
            motor_before, motor_after = motor[begins[piece] + index], motor[begins[piece] + index + 1]
            states[0, index, load, piece], states[1, index, load, piece] = state
            moments = motor_before + (motor_after - motor_before) * shares
            for part in range(STEPS_PER_SAMPLE):
                state = teeth.step(state[0], state[1], moments[part], moments[part + 1])
        followed_by = piece + 1 < pieces
        load, piece, ends = load[followed_by], piece[followed_by] + 1, np.stack(state)[:, followed_by]
        slower, behind = np.abs(starts[:, load, piece] - ends)
        starts[:, load, piece] = ends
        began_elsewhere = (slower > MOST_SPEED_MISMATCH * fastest) | (behind > MOST_ANGLE_MISMATCH * half_plays[load])
        load, piece = load[began_elsewhere], piece[began_elsewhere]  # stepped again from their new starts
        if len(load) == 0:
            break
    joined = states.transpose(0, 2, 3, 1).reshape(2, loads, -1)
    trimmed = np.concatenate([joined, joined[:, :, -1:]], axis=2)[
        :, :, : len(speed)
    ]  # the last sample equals the one before
    return trimmed[0], trimmed[1]


@dataclass(frozen=True)
class Teeth:
    """Loads behind teeth, one a lane."""

    half_play: Array  # rad
    damping: Array  # 1/s
    friction: Array  # rad/s^2
    interval: float  # s, of a step

    @cached_property
    def _decay(self) -> Array:
        """Factor on the speed of a free load over a step."""
        return np.exp(-self.damping * self.interval)

    @cached_property
    def _slowed(self) -> Array:
        """Largest change of speed by friction in a step [rad/s]."""
        return self.friction * self.interval

    def step(self, load: Array, twist: Array, motor_before: Array, motor_after: Array) -> tuple[Array, Array]:
        """Return the loads' speeds and the motors' relative angles after a step with linear motor speed."""
        # by minimum and maximum: `np.clip` takes several times as long for so few lanes
        free = load * self._decay
        free = free - np.minimum(np.maximum(free, -self._slowed), self._slowed)
        ahead = twist + 0.5 * (motor_before + motor_after - load - free) * self.interval
        side = np.sign(ahead)
        pushed = side * np.maximum(side * free, side * motor_after)
        moved = np.where(np.abs(ahead) >= self.half_play, pushed, free)
        return moved, np.minimum(np.maximum(ahead, -self.half_play), self.half_play)
