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
KEPT = 256  # profiles
PROFILE = (SLOWNESS, SLUGGISHNESS)
UNLIMITED = (0.0, 0.0)
GOAL_TOLERANCE = 1e-9  # of the distance at the beginning of an interval; a set-point within it is at its goal
TINY = 1e-300


class SetPoints:
    """References of runs as a servo's controller has them; profiles that were worked out once are kept."""

    def __init__(self, runs: ServoRuns) -> None:
        self._runs = runs
        self._known: dict[tuple[float, float], tuple[Array, Array]] = {}

    def at(self, sets: Mapping[str, Array], count: int, delay: str = "reference_delay") -> tuple[Array, Array, Index]:
        """Return distinct set-points (profiles, runs, samples) at both ends of each interval, and each set's index.

        The first array is for the beginning of the interval after a sample, the second for its end; where no set has a
        limit, both are the same array.
        """
        none = np.zeros(count)
        delays = (sets.get(delay, none) / self._runs.interval).tolist()
        limits = zip(sets.get(SLOWNESS, none).tolist(), sets.get(SLUGGISHNESS, none).tolist(), strict=True)
        wanted = list(zip(limits, delays, strict=True))
        distinct = {profile_delay: index for index, profile_delay in enumerate(dict.fromkeys(wanted))}
        if len(self._known) > KEPT:
            self._known.clear()
        self._work_out([limit for limit in dict.fromkeys(limit for limit, _ in distinct) if limit not in self._known])
        index = np.array([distinct[profile_delay] for profile_delay in wanted])
        begins = np.stack([shifted(self._known[limit][0], late) for limit, late in distinct])
        if all(limit == UNLIMITED for limit, _ in distinct):
            return begins, begins, index
        return begins, np.stack([shifted(self._known[limit][1], late) for limit, late in distinct]), index

    def _work_out(self, limits: list[tuple[float, float]]) -> None:
        plain = (self._runs.reference, self._runs.reference)
        self._known.update({limit: plain for limit in limits if limit == UNLIMITED})
        limits = [limit for limit in limits if limit != UNLIMITED]
        if limits:
            slow, idle = (np.array(values)[:, None] for values in zip(*limits, strict=True))
            begins, ends = profile(self._runs.reference, self._runs.interval, slow, idle)
            self._known.update({limit: (begins[k], ends[k]) for k, limit in enumerate(limits)})


def profile(reference: Array, interval: float, slowness: Array, sluggishness: Array) -> tuple[Array, Array]:
    """Return limited set-points (sets, runs, samples) at the beginning and the end of the interval after each sample.

    They go to references (runs, samples) as fast as inverse limits (sets, 1) allow and as they can still stop there. In
    the interval of its arrival a set-point is at the goal from the beginning, as one without a limit is.
    """
    lanes = (len(slowness), len(reference))
    fast = np.broadcast_to(1.0 / np.maximum(slowness, TINY), lanes).copy()
    gain = np.broadcast_to(interval / np.maximum(sluggishness, TINY), lanes).copy()
    slow, loss = -fast, -gain
    held = np.broadcast_to(2.0 * sluggishness / interval, lanes).copy()
    point, pace = np.repeat(reference[None, :, 0], len(slowness), axis=0), np.zeros(lanes)
    begins, ends = np.empty((reference.shape[1], *lanes)), np.empty((reference.shape[1], *lanes))
    ramps = bool(np.any(sluggishness > 0.0))
    needed, wanted = np.empty(lanes), np.empty(lanes)
    for sample, asked in enumerate(reference.T.copy()):
        begins[sample] = point
        np.subtract(asked, point, out=needed)
        needed /= interval
        if ramps:
            np.abs(needed, out=wanted)
            wanted *= held
            wanted += 0.25
            np.sqrt(wanted, out=wanted)
            wanted += 0.5
            np.divide(2.0, wanted, out=wanted)
            np.minimum(wanted, 1.0, out=wanted)
            needed *= wanted  # so fast that it can still stop there
            np.minimum(needed, fast, out=needed)
            np.maximum(needed, slow, out=needed)
            needed -= pace
            np.minimum(needed, gain, out=needed)
            np.maximum(needed, loss, out=needed)
            pace += needed
        else:
            np.minimum(needed, fast, out=pace)
            np.maximum(pace, slow, out=pace)
        np.multiply(pace, interval, out=needed)
        point += needed
        ends[sample] = point
    goal = reference.T[:, None, :]
    np.copyto(
        begins, np.broadcast_to(goal, begins.shape), where=np.abs(ends - goal) <= GOAL_TOLERANCE * np.abs(goal - begins)
    )
    return np.moveaxis(begins, 0, 2), np.moveaxis(ends, 0, 2)


def shifted(values: Array, samples: float) -> Array:
    """Rows some samples later, linear in between, the first or last value beyond the ends."""
    if samples == 0.0:
        return values
    whole = int(np.floor(samples))
    share, last = samples - whole, values.shape[1] - 1
    at = np.arange(last + 1) - whole
    later = values[:, np.clip(at, 0, last)]
    return np.asarray((1.0 - share) * later + share * values[:, np.clip(at - 1, 0, last)], np.float64)
