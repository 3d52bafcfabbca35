"""Runs of a servo cut into stretches that are simulated side by side.

The start of a servo loses influence within a few of its own time constants, unless the drive is disabled. A stretch
begins from the measured state that much earlier, and only the following part is scored; runs that are not much longer
stay whole.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.servo.runs import ServoRuns

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
SPEED_SPAN = 4  # samples over which the speed at the beginning of a stretch is taken
LEAST_SCORED_RATIO = 2.0  # shortest scored part of a stretch, over the time in which a start loses influence


@dataclass(frozen=True, eq=False)
class Stretches:
    """Stretches of runs, and the sample from which each is scored; arrays have one value per stretch."""

    run: Index
    first: Index  # first sample in the run
    scored_from: Index  # sample in the run
    length: int  # samples of every stretch
    angle: Array  # rad, at the first sample
    speed: Array  # rad/s, at the first sample

    @property
    def samples(self) -> Index:
        """Sample of the run at each step of each stretch, (stretches, samples); it may lie beyond the run's end."""
        return self.first[:, None] + np.arange(self.length)


def whole_runs(runs: ServoRuns) -> Stretches:
    """Return each run as one stretch."""
    zeros = np.zeros(len(runs.gain), np.intp)
    return Stretches(np.arange(len(zeros)), zeros, zeros, runs.angle.shape[1], runs.angle[:, 0], runs.speed)


def cut_runs(runs: ServoRuns) -> Stretches:
    """Return runs cut into stretches; whole runs if fewer than two stretches fit or a drive is disabled at times."""
    samples, memory_samples = runs.angle.shape[1], runs.memory_samples
    count = int(samples / (LEAST_SCORED_RATIO * memory_samples))
    if count < 2 or bool(np.any(runs.enabled < 1.0)):
        return whole_runs(runs)
    scored_length = -(-samples // count)
    count = -(-samples // scored_length)  # a length rounded up may need fewer stretches
    scored_from = np.tile(scored_length * np.arange(count), len(runs.gain))
    run = np.repeat(np.arange(len(runs.gain)), count)
    first = np.maximum(scored_from - memory_samples, 0)
    ends = np.minimum(first + SPEED_SPAN, samples - 1)
    angle = runs.angle[run, first]
    speed = (runs.angle[run, ends] - angle) / (SPEED_SPAN * runs.interval)
    at_start = first == 0
    return Stretches(
        run, first, scored_from, scored_length + memory_samples, angle, np.where(at_start, runs.speed[run], speed)
    )
