"""Late signals: a first-order lag and a pure delay, over lanes, stepped at a fixed rate."""

import numpy as np

from leactl.emulation.plant.effects.contract import Value


class Lag:
    """First-order lag [s], exact to second order for a signal that is linear between steps."""

    def __init__(self, time_constant: Value, lanes: int, step_s: float) -> None:
        self._half_gain = 0.5 * -np.expm1(-step_s / np.broadcast_to(time_constant, (lanes,)))
        self._previous_signal = np.zeros(lanes)
        self._output = np.zeros(lanes)

    def __call__(self, signal: Value) -> Value:
        """Return the lagging signal for the signal of this step."""
        self._output += self._half_gain * (self._previous_signal + signal - 2.0 * self._output)
        self._previous_signal[:] = signal
        return self._output


class Delay:
    """Delay [s] of a signal that is linear between steps, and zero before the run."""

    def __init__(self, delay: Value, lanes: int, step_s: float) -> None:
        steps = np.broadcast_to(delay, (lanes,)) / step_s
        self._whole_steps = np.floor(steps).astype(int)
        self._fraction_of_step = steps - self._whole_steps
        self._length = int(self._whole_steps.max()) + 2
        self._past_signals = np.zeros((self._length, lanes))
        self._lanes = np.arange(lanes)
        self._step_count = 0

    def __call__(self, signal: Value) -> Value:
        """Return the delayed signal for the signal of this step."""
        self._past_signals[self._step_count % self._length] = signal
        row = (self._step_count - self._whole_steps) % self._length
        newer_signal = self._past_signals[row, self._lanes]
        older_signal = self._past_signals[(row - 1) % self._length, self._lanes]
        self._step_count += 1
        return newer_signal + self._fraction_of_step * (older_signal - newer_signal)
