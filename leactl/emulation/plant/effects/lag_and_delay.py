"""Late signals: a first-order lag and a pure delay, over lanes, stepped at a fixed rate."""

import numpy as np

from leactl.emulation.plant.effects.contract import Value


class Lag:
    """First-order lag, exact to second order for a signal that is linear between steps."""

    def __init__(self, time_constant: Value, lanes: int, step_s: float) -> None:
        self._half_gain = 0.5 * -np.expm1(-step_s / np.broadcast_to(time_constant, (lanes,)))
        self._before = np.zeros(lanes)
        self._output = np.zeros(lanes)

    def __call__(self, signal: Value) -> Value:
        """Take the signal of this step and return the lagging one."""
        self._output += self._half_gain * (self._before + signal - 2.0 * self._output)
        self._before[:] = signal
        return self._output


class Delay:
    """The signal of an earlier time, linear between steps; zero before the run."""

    def __init__(self, delay: Value, lanes: int, step_s: float) -> None:
        steps = np.broadcast_to(delay, (lanes,)) / step_s
        self._whole_steps = np.floor(steps).astype(int)
        self._step_share = steps - self._whole_steps
        self._length = int(self._whole_steps.max()) + 2
        self._past = np.zeros((self._length, lanes))
        self._lanes = np.arange(lanes)
        self._count = 0

    def __call__(self, signal: Value) -> Value:
        """Take the signal of this step and return the delayed one."""
        self._past[self._count % self._length] = signal
        row = (self._count - self._whole_steps) % self._length
        after = self._past[row, self._lanes]
        before = self._past[(row - 1) % self._length, self._lanes]
        self._count += 1
        return after + self._step_share * (before - after)
