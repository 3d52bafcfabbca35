"""An emulated USB-6218 at a motor's leads: one converter behind a multiplexer, 16 bit, four ranges.

It replaces NI-DAQmx below the driver, coerces the clock in the same way, and answers with its error codes. Its samples
have an error of scale, drawn once from the stated uncertainty, and the steps of its converter.
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
HIGHEST_AGGREGATE_HZ = 250e3  # samples of all inputs together
CONVERT_PERIOD_S = 14e-6  # between two inputs: the fastest clock's 4 us, and 10 us for the multiplexer to settle
RANGES_V = (0.2, 1.0, 5.0, 10.0)
INPUT_COUNT = 32
CODES_PER_SIGN = 32768
SAMPLE_PERIOD_S = 1e-3  # time between two samples of the leads, between which their voltage is interpolated linearly
BUFFER_S = 10.0  # time for which the device's buffer holds samples
NO_DEVICE, NO_CHANNEL, BAD_VALUE, TOO_FAST = -200220, -200170, -200077, -200332
IN_USE, OVERWRITTEN, GONE = -50103, -200279, -201003


class EmulatedDaq:
    """Emulated device, with the factory of its acquisitions."""

    def __init__(self, settings: NiDaqSettings, physics: Physics) -> None:
        self._device = settings.device
        self.serial_number = SERIAL_NUMBER
        self.terminals = {
            role: physics.terminals(role) for role in sorted({daq_input.role for daq_input in settings.inputs})
        }
        rng = next(iter(self.terminals.values())).chance
        self.scale = 1.0 + 1e-6 * settings.scale_std_ppm * float(rng.standard_normal())
        self.gone = False
        self.task: EmulatedTask | None = None
        self.now = 0.0

    def acquire(self, settings: NiDaqSettings, samples: int | None) -> "EmulatedTask":
        """Reserve the device and configure it; raise DaqmxError if it is gone, in use, or lacks what is asked."""
        if settings.device != self._device:
            raise DaqmxError(NO_DEVICE)
        if self.gone:
            raise DaqmxError(GONE)
        if self.task is not None:
            raise DaqmxError(IN_USE)
        if any(int(daq_input.channel[2:]) >= INPUT_COUNT for daq_input in settings.inputs):
            raise DaqmxError(NO_CHANNEL)
        if any(daq_input.range_V > RANGES_V[-1] for daq_input in settings.inputs):
            raise DaqmxError(BAD_VALUE)
        if settings.rate_Hz * len(settings.inputs) > HIGHEST_AGGREGATE_HZ:
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
        input_count = len(settings.inputs)
        self.rate_Hz = TIMEBASE_HZ / math.floor(TIMEBASE_HZ / settings.rate_Hz)
        self.convert_Hz = 1.0 / min(CONVERT_PERIOD_S, 1.0 / (input_count * self.rate_Hz))
        self._daq, self._inputs, self._samples = daq, settings.inputs, samples
        self._buffer_samples = round(BUFFER_S * settings.rate_Hz)
        self._started_at, self._converted, self._unread = math.nan, 0, 0
        self._blocks: list[NDArray[np.float64]] = []
        self.due = math.inf

    def start(self) -> None:
        """Start sampling."""
        self._check()
        self._started_at = self._daq.now
        self.due = self._started_at + SAMPLE_PERIOD_S

    def sample(self, now: float) -> None:
        """Convert all samples that are due, a sample being due with its last input."""
        last_input_delay = (len(self._inputs) - 1) / self.convert_Hz
        sample_end = math.floor((now - last_input_delay - self._started_at) * self.rate_Hz + 1e-6) + 1
        if self._samples is not None:
            sample_end = min(sample_end, self._samples)
        if sample_end > self._converted:
            self._convert(sample_end)
        is_done = self._converted >= self._samples if self._samples is not None else self._unread > self._buffer_samples
        self.due = math.inf if is_done else now + SAMPLE_PERIOD_S

    def _convert(self, sample_end: int) -> None:
        """Convert all samples before this index."""
        times = self._started_at + np.arange(self._converted, sample_end) / self.rate_Hz
        block = np.empty((len(self._inputs), len(times)))
        for index, daq_input in enumerate(self._inputs):
            lead_voltages = self._daq.terminals[daq_input.role].voltages(
                times + index / self.convert_Hz, daq_input.pair
            )
            step = min(range_end for range_end in RANGES_V if range_end >= daq_input.range_V) / CODES_PER_SIGN
            volts = self._daq.scale * daq_input.sign * lead_voltages / daq_input.scale_per_V
            block[index] = step * np.clip(np.round(volts / step), -CODES_PER_SIGN, CODES_PER_SIGN - 1)
        self._converted = sample_end
        self._unread += len(times)
        self._blocks.append(block)

    def read(self) -> NDArray[np.float64]:
        """Return the samples since the last call, (inputs, samples), V."""
        self._check()
        if self._samples is None and self._unread > self._buffer_samples:
            raise DaqmxError(OVERWRITTEN)
        blocks, self._blocks, self._unread = self._blocks, [], 0
        return np.hstack(blocks) if blocks else np.empty((len(self._inputs), 0))

    def close(self) -> None:
        """Release the device."""
        if self._daq.task is self:
            self._daq.task = None

    def _check(self) -> None:
        """Raise DaqmxError if the device is gone."""
        if self._daq.gone:
            raise DaqmxError(GONE)
