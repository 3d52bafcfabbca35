"""Set-points of a servo: its references after limits of speed and acceleration, many parameter sets at once.

A limit is given by its inverse, `slowness` [s/rad] or `sluggishness` [s^2/rad]: there is no limit at zero, which a fit
can reach.
"""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from leactl.gap.servo.runs import ServoRuns

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
SLOWNESS, SLUGGISHNESS = "reference_rate_limit.slowness", "reference_rate_limit.sluggishness"
MOST_PROFILES = 256  # profiles in the cache
PROFILE_PARAMETERS = (SLOWNESS, SLUGGISHNESS)
UNLIMITED = (0.0, 0.0)  # inverse limits of a reference that is used as it is
GOAL_TOLERANCE = 1e-9  # share of the distance at the beginning of an interval within which the goal is reached
LEAST_INVERSE_LIMIT = 1e-300  # avoids a division by zero where there is no limit


class SetPoints:
    """Set-points of runs as a servo's controller uses them; computed profiles are cached."""

    def __init__(self, runs: ServoRuns) -> None:
        self._runs = runs
        self._profiles: dict[tuple[float, float], tuple[Array, Array]] = {}  # set-points by inverse limits

    def at(self, sets: Mapping[str, Array], count: int, delay: str = "reference_delay") -> tuple[Array, Array, Index]:
        """Return distinct set-points (profiles, runs, samples) at both ends of each interval, and each set's index.

        The first array is for the beginning of the interval after a sample, the second for its end; where no set has a
        limit, both are the same array.
        """
        zeros = np.zeros(count)
        delays = (sets.get(delay, zeros) / self._runs.interval).tolist()
        limits = zip(sets.get(SLOWNESS, zeros).tolist(), sets.get(SLUGGISHNESS, zeros).tolist(), strict=True)
        profile_delays = list(zip(limits, delays, strict=True))
        distinct = {profile_delay: index for index, profile_delay in enumerate(dict.fromkeys(profile_delays))}
        if len(self._profiles) > MOST_PROFILES:
            self._profiles.clear()
        self._compute_profiles(
            [limit for limit in dict.fromkeys(limit for limit, _ in distinct) if limit not in self._profiles]
        )
        index = np.array([distinct[profile_delay] for profile_delay in profile_delays])
        begins = np.stack([delayed_rows(self._profiles[limit][0], delay_samples) for limit, delay_samples in distinct])
        if all(limit == UNLIMITED for limit, _ in distinct):
            return begins, begins, index
        return (
            begins,
            np.stack([delayed_rows(self._profiles[limit][1], delay_samples) for limit, delay_samples in distinct]),
            index,
        )

    def _compute_profiles(self, limits: list[tuple[float, float]]) -> None:
        """Add the set-points of some inverse limits to the cache."""
        unlimited = (self._runs.reference, self._runs.reference)
        self._profiles.update({limit: unlimited for limit in limits if limit == UNLIMITED})
        limits = [limit for limit in limits if limit != UNLIMITED]
        if limits:
            slowness, sluggishness = (np.array(values)[:, None] for values in zip(*limits, strict=True))
            begins, ends = profile(
                self._runs.reference, self._runs.interval, slowness, sluggishness, self._runs.angle[:, 0]
            )
            self._profiles.update({limit: (begins[k], ends[k]) for k, limit in enumerate(limits)})


def profile(
    reference: Array, interval: float, slowness: Array, sluggishness: Array, start: Array
) -> tuple[Array, Array]:
    """Return limited set-points (sets, runs, samples) at the beginning and the end of the interval after each sample.

    They go to references (runs, samples) as fast as inverse limits (sets, 1) allow and as they can still stop there. In
    the interval of its arrival a set-point moves only for a share of it, and rests at the goal then. Its beginning is
    the one from which a straight course through the interval has the same mean: the goal itself without a limit.

    start : first set-points of the runs. No log tells them; a limited one is near the axis, which follows it, and may
        be far from the first reference.
    """
    lanes = (len(slowness), len(reference))
    highest_speed = np.broadcast_to(1.0 / np.maximum(slowness, LEAST_INVERSE_LIMIT), lanes).copy()
    highest_change = np.broadcast_to(interval / np.maximum(sluggishness, LEAST_INVERSE_LIMIT), lanes).copy()
    lowest_speed, lowest_change = -highest_speed, -highest_change
    brake_factor = np.broadcast_to(2.0 * sluggishness / interval, lanes).copy()
    set_point, speed = np.repeat(start[None, :], len(slowness), axis=0), np.zeros(lanes)
    begins, ends = np.empty((reference.shape[1], *lanes)), np.empty((reference.shape[1], *lanes))
    has_acceleration_limit = bool(np.any(sluggishness > 0.0))
    change, share = np.empty(lanes), np.empty(lanes)
    for sample, goal_at_sample in enumerate(reference.T.copy()):
        begins[sample] = set_point
        np.subtract(goal_at_sample, set_point, out=change)
        change /= interval
        if has_acceleration_limit:
            np.abs(change, out=share)
            share *= brake_factor
            share += 0.25
            np.sqrt(share, out=share)
            share += 0.5
            np.divide(2.0, share, out=share)
            np.minimum(share, 1.0, out=share)
            change *= share  # at most the speed from which it can still stop at the goal
            np.minimum(change, highest_speed, out=change)
            np.maximum(change, lowest_speed, out=change)
            change -= speed
            np.minimum(change, highest_change, out=change)
            np.maximum(change, lowest_change, out=change)
            speed += change
        else:
            np.minimum(change, highest_speed, out=speed)
            np.maximum(speed, lowest_speed, out=speed)
        np.multiply(speed, interval, out=change)
        set_point += change
        ends[sample] = set_point
    goal = reference.T[:, None, :]
    distance = goal - begins
    moving_share = np.minimum(np.abs(distance) / (highest_speed * interval), 1.0)
    np.copyto(begins, goal - moving_share * distance, where=np.abs(ends - goal) <= GOAL_TOLERANCE * np.abs(distance))
    return np.moveaxis(begins, 0, 2), np.moveaxis(ends, 0, 2)


def delayed_rows(values: Array, samples: float) -> Array:
    """Return rows delayed by a number of samples, linear between samples, constant beyond the ends."""
    if samples == 0.0:
        return values
    whole_samples = int(np.floor(samples))
    share, last_index = samples - whole_samples, values.shape[1] - 1
    index = np.arange(last_index + 1) - whole_samples
    later = values[:, np.clip(index, 0, last_index)]
    return np.asarray((1.0 - share) * later + share * values[:, np.clip(index - 1, 0, last_index)], np.float64)
