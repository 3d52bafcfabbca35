"""Loads behind teeth with play, moved by a motor whose motion is known."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
PIECE_SAMPLES = 128  # samples in a piece of a run; pieces are stepped side by side
STEPS_PER_SAMPLE = 4  # steps from one sample to the next
MOST_PASSES = 6  # passes until each piece begins as the previous piece ends
MOST_ANGLE_MISMATCH = 0.02  # between a piece's start and the previous end, as a share of half the play
MOST_SPEED_MISMATCH = 1e-3  # between a piece's start and the previous end, as a share of the highest speed


def follow_loads(
    speed: Array, interval: float, half_plays: Array, damping: Array, friction: Array, fall: Array | None = None
) -> tuple[Array, Array]:
    """Return speeds [rad/s] of loads driven through play, and the motor's relative angle [rad]; (loads, samples).

    Pieces of a run are stepped side by side; a piece that did not begin at the end of the previous piece is repeated.

    Parameters
    ----------
    speed : rad/s, of the motor at its samples.
    half_plays : rad, half of the play of each load.
    damping : 1/s, decay rate of each load while it is free.
    friction : rad/s^2, deceleration of each load by Coulomb friction.
    fall : rad/s^2, deceleration of a free load by its weight, at the motor's samples.
    """
    load_count, piece_count = len(half_plays), -(-(len(speed) - 1) // PIECE_SAMPLES)
    motor = np.concatenate([speed, np.full(piece_count * PIECE_SAMPLES + 1 - len(speed), speed[-1])])
    falls = np.zeros_like(motor)
    if fall is not None:
        falls[: len(speed)] = fall * interval / STEPS_PER_SAMPLE
    begins = np.arange(piece_count) * PIECE_SAMPLES
    # states are speed of the load and angle of the motor beyond it; first guess: pressed in the motor's direction
    starts = np.stack([motor[begins] * np.ones((load_count, 1)), half_plays[:, None] * np.sign(motor[begins])])
    states = np.zeros((2, PIECE_SAMPLES, load_count, piece_count))
    highest_speed = float(np.max(np.abs(speed)))
    shares = np.arange(STEPS_PER_SAMPLE + 1)[:, None] / STEPS_PER_SAMPLE  # of a sample's interval
    # load and piece of each lane; in the first pass there is a lane for every piece of every load
    load, piece = (index.ravel() for index in np.indices((load_count, piece_count)))
    for _ in range(MOST_PASSES):
        teeth = Teeth(half_plays[load], damping[load], friction[load], interval / STEPS_PER_SAMPLE)
        state = starts[0, load, piece], starts[1, load, piece]
        for index in range(PIECE_SAMPLES):
            motor_before, motor_after = motor[begins[piece] + index], motor[begins[piece] + index + 1]
            states[0, index, load, piece], states[1, index, load, piece] = state
            motor_speeds = motor_before + (motor_after - motor_before) * shares
            fall_in_step = falls[begins[piece] + index]
            for substep in range(STEPS_PER_SAMPLE):
                state = teeth.step(state[0], state[1], motor_speeds[substep], motor_speeds[substep + 1], fall_in_step)
        has_next = piece + 1 < piece_count
        load, piece, ends = load[has_next], piece[has_next] + 1, np.stack(state)[:, has_next]
        speed_mismatch, angle_mismatch = np.abs(starts[:, load, piece] - ends)
        starts[:, load, piece] = ends
        is_mismatched = (speed_mismatch > MOST_SPEED_MISMATCH * highest_speed) | (
            angle_mismatch > MOST_ANGLE_MISMATCH * half_plays[load]
        )
        load, piece = load[is_mismatched], piece[is_mismatched]  # stepped again from their new starts
        if len(load) == 0:
            break
    joined = states.transpose(0, 2, 3, 1).reshape(2, load_count, -1)
    # the last sample is taken as equal to the sample before
    load_speeds, twists = np.concatenate([joined, joined[:, :, -1:]], axis=2)[:, :, : len(speed)]
    return load_speeds, twists


@dataclass(frozen=True)
class Teeth:
    """Loads behind teeth, one per lane."""

    half_play: Array  # rad
    damping: Array  # 1/s
    friction: Array  # rad/s^2
    interval: float  # s, of a step

    @cached_property
    def _decay(self) -> Array:
        """Factor on the speed of a free load over a step."""
        return np.exp(-self.damping * self.interval)

    @cached_property
    def _friction_change(self) -> Array:
        """Largest change of speed by friction in a step [rad/s]."""
        return self.friction * self.interval

    def step(
        self, load: Array, twist: Array, motor_before: Array, motor_after: Array, fall: Array
    ) -> tuple[Array, Array]:
        """Return the loads' speeds and the motors' relative angles after a step with linear motor speed.

        fall : rad/s, change of a free load's speed by its weight.
        """
        # by minimum and maximum: `np.clip` takes several times as long for so few lanes
        free_speed = load * self._decay - fall
        free_speed = free_speed - np.minimum(np.maximum(free_speed, -self._friction_change), self._friction_change)
        free_twist = twist + 0.5 * (motor_before + motor_after - load - free_speed) * self.interval
        side = np.sign(free_twist)
        pushed_speed = side * np.maximum(side * free_speed, side * motor_after)
        next_speed = np.where(np.abs(free_twist) >= self.half_play, pushed_speed, free_speed)
        return next_speed, np.minimum(np.maximum(free_twist, -self.half_play), self.half_play)
