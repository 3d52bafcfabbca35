"""The inner set-point of a servo: what its profile makes of the reference, many parameter sets at once.

A limit is told by its inverse, `slowness` [s/rad] and `sluggishness` [s^2/rad]: it is none at zero, where a fit may go.
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
ARRIVED = 1e-9  # of what was left to go, within which a set-point is at its goal
TINY = 1e-300


class SetPoints:
    """References of runs as a servo's controller has them; profiles that were worked out once are kept."""

    def __init__(self, runs: ServoRuns) -> None:
        self._runs = runs
        self._known: dict[tuple[float, float], tuple[Array, Array]] = {}

    def at(self, sets: Mapping[str, Array], count: int, delay: str = "reference_delay") -> tuple[Array, Array, Index]:
        """Distinct set-points (some, runs, samples) at the beginning and the end of the interval after each sample.

        The third tells which of them each set has; where none is limited, beginning and end are the same array.
        """
        none = np.zeros(count)
        delays = (sets.get(delay, none) / self._runs.interval).tolist()
        limits = zip(sets.get(SLOWNESS, none).tolist(), sets.get(SLUGGISHNESS, none).tolist(), strict=True)
        wanted = list(zip(limits, delays, strict=True))
        distinct = {one: place for place, one in enumerate(dict.fromkeys(wanted))}
        if len(self._known) > KEPT:
            self._known.clear()
        self._work_out([limit for limit in dict.fromkeys(limit for limit, _ in distinct) if limit not in self._known])
        place = np.array([distinct[one] for one in wanted])
        begins = np.stack([shifted(self._known[limit][0], late) for limit, late in distinct])
        if all(limit == UNLIMITED for limit, _ in distinct):
            return begins, begins, place
        return begins, np.stack([shifted(self._known[limit][1], late) for limit, late in distinct]), place

    def _work_out(self, limits: list[tuple[float, float]]) -> None:
        plain = (self._runs.reference, self._runs.reference)
        self._known.update({limit: plain for limit in limits if limit == UNLIMITED})
        limits = [limit for limit in limits if limit != UNLIMITED]
        if limits:
            slow, idle = (np.array(values)[:, None] for values in zip(*limits, strict=True))
            begins, ends = profile(self._runs.reference, self._runs.interval, slow, idle)
            self._known.update({limit: (begins[k], ends[k]) for k, limit in enumerate(limits)})


def profile(reference: Array, interval: float, slowness: Array, sluggishness: Array) -> tuple[Array, Array]:
    """Set-points (sets, runs, samples) that go to references (runs, samples), no faster than limits (sets, 1) allow.

    Each goes as fast as it may and can still stop at the goal; one that arrives leaps the rest of the way, as one
    without a limit does.
    """
    lanes = (len(slowness), len(reference))
    fast = np.broadcast_to(1.0 / np.maximum(slowness, TINY), lanes).copy()
    gain = np.broadcast_to(interval / np.maximum(sluggishness, TINY), lanes).copy()
    slow, loss = -fast, -gain
    held = np.broadcast_to(2.0 * sluggishness / interval, lanes).copy()
    point, pace = np.repeat(reference[None, :, 0], len(slowness), axis=0), np.zeros(lanes)
    begins, ends = np.empty((reference.shape[1], *lanes)), np.empty((reference.shape[1], *lanes))
    ramps = bool(np.any(sluggishness > 0.0))
    left, wanted = np.empty(lanes), np.empty(lanes)
    for sample, asked in enumerate(reference.T.copy()):
        begins[sample] = point
        np.subtract(asked, point, out=left)
        left /= interval
        if ramps:
            np.abs(left, out=wanted)
            wanted *= held
            wanted += 0.25
            np.sqrt(wanted, out=wanted)
            wanted += 0.5
            np.divide(2.0, wanted, out=wanted)
            np.minimum(wanted, 1.0, out=wanted)
            left *= wanted  # so fast that it can still stop there
            np.minimum(left, fast, out=left)
            np.maximum(left, slow, out=left)
            left -= pace
            np.minimum(left, gain, out=left)
            np.maximum(left, loss, out=left)
            pace += left
        else:
            np.minimum(left, fast, out=pace)
            np.maximum(pace, slow, out=pace)
        np.multiply(pace, interval, out=left)
        point += left
        ends[sample] = point
    goal = reference.T[:, None, :]
    np.copyto(begins, np.broadcast_to(goal, begins.shape), where=np.abs(ends - goal) <= ARRIVED * np.abs(goal - begins))
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
