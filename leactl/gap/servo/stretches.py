"""Runs of a servo cut into stretches that are simulated side by side.

A servo forgets where it began within a few of its own time constants, unless it is let go. A stretch begins from the
measured state that much earlier, and only what follows is scored; runs that are not much longer stay whole.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.servo.runs import ServoRuns

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
SPEED_SPAN = 4  # samples over which the speed at the beginning of a stretch is taken
LEAST_SCORED = 2.0  # times as long as it takes to forget, that a stretch is scored for at least


@dataclass(frozen=True, eq=False)
class Stretches:
    """Which run each stretch is of, where it begins and from where on it is scored."""

    run: Index
    first: Index  # sample that it begins at
    scored_from: Index  # sample
    length: int  # samples, of each
    angle: Array  # rad, where it begins
    speed: Array  # rad/s

    @property
    def samples(self) -> Index:
        """The sample that each stretch is at, (stretches, samples); those that run on beyond the end stay there."""
        return self.first[:, None] + np.arange(self.length)


def whole_runs(runs: ServoRuns) -> Stretches:
    """Each run as one stretch."""
    none = np.zeros(len(runs.gain), np.intp)
    return Stretches(np.arange(len(none)), none, none, runs.angle.shape[1], runs.angle[:, 0], runs.speed)


def cut(runs: ServoRuns) -> Stretches:
    """Cut runs into stretches; where fewer than two fit, or a drive is disabled at times, each run is one."""
    samples, forgets = runs.angle.shape[1], runs.forgets
    count = int(samples / (LEAST_SCORED * forgets))
    if count < 2 or bool(np.any(runs.enabled < 1.0)):
        return whole_runs(runs)
    long = -(-samples // count)
    count = -(-samples // long)  # a length that is rounded up may need fewer
    scored_from = np.tile(long * np.arange(count), len(runs.gain))
    run = np.repeat(np.arange(len(runs.gain)), count)
    first = np.maximum(scored_from - forgets, 0)
    ends = np.minimum(first + SPEED_SPAN, samples - 1)
    angle = runs.angle[run, first]
    speed = (runs.angle[run, ends] - angle) / (SPEED_SPAN * runs.interval)
    begin = first == 0
    return Stretches(run, first, scored_from, long + forgets, angle, np.where(begin, runs.speed[run], speed))
