"""An emulated USB-6218 at a motor's leads: one converter behind a multiplexer, 16 bit, four ranges.

It replaces NI-DAQmx below the driver, coerces the clock in the same way, and answers with its error codes. It adds to
the voltages at the leads an error of scale, drawn once from the stated uncertainty, and the steps of its converter.
"""

import math

import numpy as np
from numpy.typing import NDArray

from leactl.driver.far_end import Physics
from leactl_plugins.ni_daq.acquisition import DaqmxError
from leactl_plugins.ni_daq.settings import NiDaqSettings

PRODUCT = "USB-6218"
SERIAL_NUMBER = "1A2B3C4"
TIMEBASE_HZ = 20e6
AGGREGATE_HZ = 250e3
CONVERT_S = 14e-6  # from input to input: the fastest clock's 4 us, and 10 us for the multiplexer to settle
RANGES_V = (0.2, 1.0, 5.0, 10.0)
INPUT_COUNT = 32
CODES_PER_SIGN = 32768
SAMPLE_PERIOD_S = 1e-3  # time between two samples of the leads, between which their voltage is interpolated linearly
BUFFERED_S = 10.0  # of samples in the device's buffer
NO_DEVICE, NO_CHANNEL, BAD_VALUE, TOO_FAST = -200220, -200170, -200077, -200332
IN_USE, OVERWRITTEN, GONE = -50103, -200279, -201003


class EmulatedDaq:
    """The emulated device and library."""

    def __init__(self, settings: NiDaqSettings, physics: Physics) -> None:
        self._device = settings.device
        self.serial_number = SERIAL_NUMBER
        self.terminals = {role: physics.terminals(role) for role in sorted({item.role for item in settings.inputs})}
        rng = next(iter(self.terminals.values())).chance
        self.scale = 1.0 + 1e-6 * settings.scale_std_ppm * float(rng.standard_normal())
        self.gone = False
        self.task: EmulatedTask | None = None
        self.now = 0.0

    def acquire(self, settings: NiDaqSettings, samples: int | None) -> "EmulatedTask":
        """Reserve the device and configure it."""
        if settings.device != self._device:
            raise DaqmxError(NO_DEVICE)
        if self.gone:
            raise DaqmxError(GONE)
        if self.task is not None:
            raise DaqmxError(IN_USE)
        if any(int(item.channel[2:]) >= INPUT_COUNT for item in settings.inputs):
            raise DaqmxError(NO_CHANNEL)
        if any(item.range_V > RANGES_V[-1] for item in settings.inputs):
            raise DaqmxError(BAD_VALUE)
        if settings.rate_Hz * len(settings.inputs) > AGGREGATE_HZ:
            raise DaqmxError(TOO_FAST)
        self.task = EmulatedTask(self, settings, samples)
        return self.task

    def unplug(self) -> None:
        """Remove the device."""
        self.gone = True

    @property
    def due(self) -> float:
        """Time of the next sampling of the leads [s]."""
        return self.task.due if self.task is not None and not self.gone else math.inf

    def tick(self, now: float) -> None:
        """Sample until `now` [s]."""
        self.now = now
        if self.task is not None and now >= self.due:
            self.task.sample(now)


class EmulatedTask:
    """One acquisition of the emulated device."""

    def __init__(self, daq: EmulatedDaq, settings: NiDaqSettings, samples: int | None) -> None:
        self.product, self.serial_number, self.warnings = PRODUCT, daq.serial_number, list[str]()
        count = len(settings.inputs)
        self.rate_Hz = TIMEBASE_HZ / math.floor(TIMEBASE_HZ / settings.rate_Hz)
        self.convert_Hz = 1.0 / min(CONVERT_S, 1.0 / (count * self.rate_Hz))
        self._daq, self._inputs, self._samples = daq, settings.inputs, samples
        self._room = round(BUFFERED_S * settings.rate_Hz)
        self._began, self._converted, self._unread = math.nan, 0, 0
        self._blocks: list[NDArray[np.float64]] = []
        self.due = math.inf

    def start(self) -> None:
        """Start sampling."""
        self._check()
        self._began = self._daq.now
        self.due = self._began + SAMPLE_PERIOD_S

    def sample(self, now: float) -> None:
        """Convert all samples that are due, a sample being due with its last input."""
        last = (len(self._inputs) - 1) / self.convert_Hz
        until = math.floor((now - last - self._began) * self.rate_Hz + 1e-6) + 1
        if self._samples is not None:
            until = min(until, self._samples)
        if until > self._converted:
            self._convert(until)
        done = self._converted >= self._samples if self._samples is not None else self._unread > self._room
        self.due = math.inf if done else now + SAMPLE_PERIOD_S

    def _convert(self, until: int) -> None:
        times = self._began + np.arange(self._converted, until) / self.rate_Hz
        block = np.empty((len(self._inputs), len(times)))
        for index, item in enumerate(self._inputs):
            leads = self._daq.terminals[item.role].voltages(times + index / self.convert_Hz, item.pair)
            step = min(end for end in RANGES_V if end >= item.range_V) / CODES_PER_SIGN
            volts = self._daq.scale * item.sign * leads / item.scale_per_V
            block[index] = step * np.clip(np.round(volts / step), -CODES_PER_SIGN, CODES_PER_SIGN - 1)
        self._converted = until
        self._unread += len(times)
        self._blocks.append(block)

    def read(self) -> NDArray[np.float64]:
        """Samples since the last call."""
        self._check()
        if self._samples is None and self._unread > self._room:
            raise DaqmxError(OVERWRITTEN)
        blocks, self._blocks, self._unread = self._blocks, [], 0
        return np.hstack(blocks) if blocks else np.empty((len(self._inputs), 0))

    def close(self) -> None:
        """Release the device."""
        if self._daq.task is self:
            self._daq.task = None

    def _check(self) -> None:
        if self._daq.gone:
            raise DaqmxError(GONE)
