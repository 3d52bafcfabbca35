"""NI converter at a motor's leads, which samples by its own clock; the driver takes the samples in blocks.

The stamps are those of the sample clock at the rate that the device accepted. The multiplexer converts one input after
the other; each channel states its delay. Each sample that the device lost is NaN, and a notice reports the loss.
"""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from leactl.driver.clock import Clock
from leactl.driver.contract import Confirmation, Driver, Identity, SampleBlock, StreamSpec
from leactl.driver.far_end import BuslessEmulator, Physics
from leactl.errors import DeviceError, InputError, NoAnswer
from leactl.quantities import ChannelSpec
from leactl_plugins.ni_daq.acquisition import OVERRUNS, SAFE, Acquisition, DaqmxError, Library
from leactl_plugins.ni_daq.settings import NiDaqSettings

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

READ_PERIOD_S = 0.02  # a read takes about 0.1 ms however many samples it returns
LONGEST_SILENCE_S = 1.0  # after a longer time without a sample, the device has stopped by itself
RATE_TOLERANCE = 0.01  # relative difference from the requested rate; a larger one would make it another experiment
MOST_RESTARTS = 3  # after overruns, in one run
REPORTED_GAIN_S = 1e-3  # gain of the device's clock from one notice to the next


class NiDaq(Driver):
    """One converter and the line-to-line voltages at its inputs."""

    Settings = NiDaqSettings
    transport = "none"
    summary = "NI multifunction converter through NI-DAQmx (line-to-line voltages; USB-6218 and its kin)"
    example: ClassVar[Mapping[str, Any]] = {
        "library": "emulated",
        "inputs": [
            {"name": "ab", "quantity": "phase_voltage_ab", "role": "test", "channel": "ai0", "range_V": 10.0},
            {"name": "bc", "quantity": "phase_voltage_bc", "role": "test", "channel": "ai1", "range_V": 10.0},
        ],
    }

    def __init__(self, name: str, role: str, settings: NiDaqSettings, port: Library | None, clock: Clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        self._port, self._clock = port, clock
        self._task: Acquisition | None = None
        self._running = self._ended = False
        self._started_at = self._read_due_at = self._last_sample_at = math.nan
        self._count = self._remaining = 0  # samples since the start, and samples that a finite acquisition still lacks
        self._last_stamp = -math.inf  # stamp of the last row
        self._restarts, self._clock_gain_s = 0, 0.0
        self._out_of_range = [0] * len(settings.inputs)  # readings outside the range that no notice has reported yet
        self._notices: list[str] = []
        self._identity = Identity()

    def safe_state(self, deadline_s: float) -> Confirmation:
        """Confirm at once: the device only measures."""
        return SAFE

    def open(self) -> None:
        """Reserve the device, configure clock and inputs, and check the resulting rate.

        Raises
        ------
        InputError : the bench file chooses another library than its bench has; neither takes the other's place.
        DeviceError : NI's driver or package is not installed, or the device is absent, in use, another one, or refuses
            a setting.
        """
        settings = self.settings
        expected_library, bench_text = (
            ("nidaqmx", "not emulated in this process") if self._port is None else ("emulated", "emulated")
        )
        if settings.library != expected_library:
            raise InputError(
                f"{self.name}: library '{settings.library}' on a bench that is {bench_text}; {expected_library} was"
                " expected"
            )
        self._remaining = settings.samples or 0
        task = self._acquire()
        self._identity = Identity(f"NI {task.product}", task.serial_number)
        if settings.product and task.product != settings.product:
            self.close()
            raise DeviceError(f"{self.name}: '{settings.device}' is a {task.product}; {settings.product} was expected")
        if abs(task.rate_Hz / settings.rate_Hz - 1.0) > RATE_TOLERANCE:
            self.close()
            raise DeviceError(f"{self.name}: samples at {task.rate_Hz:g} Hz; {settings.rate_Hz:g} Hz were asked for")
        spacing_text = (
            f", each input {1e6 / task.convert_Hz:.3g} us after the one before" if len(settings.inputs) > 1 else ""
        )
        self._notices.append(
            f"{task.product} samples at {task.rate_Hz:.9g} Hz, {settings.rate_Hz:g} Hz were asked for{spacing_text}"
        )
        self._notices += task.warnings

    def _acquire(self) -> Acquisition:
        """Reserve and configure the device for the samples that remain."""
        from leactl_plugins.ni_daq.nidaqmx_library import NidaqmxLibrary

        try:
            self._task = (self._port or NidaqmxLibrary()).acquire(self.settings, self._remaining or None)
        except DeviceError as error:
            raise self._name_device(error) from None
        return self._task

    def identity(self) -> Identity:
        """Return product type and serial number from NI-DAQmx, which reports no firmware."""
        return self._identity

    def close(self) -> None:
        """Release the device."""
        task, self._task, self._running = self._task, None, False
        if task is not None:
            task.close()

    @classmethod
    def far_end(cls, settings: NiDaqSettings, role: str, physics: Physics) -> BuslessEmulator:
        """Return a converter at the leads of the emulated motors, in place of NI-DAQmx."""
        from leactl_plugins.ni_daq.emulator import EmulatedDaq

        return EmulatedDaq(settings, physics)

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """One stream of all inputs; once the device is open, each channel has its skew by the multiplexer."""
        settings, task = self.settings, self._task
        input_spacing_s = 1.0 / task.convert_Hz if task is not None and len(settings.inputs) > 1 else 0.0
        channels = tuple(
            ChannelSpec(
                daq_input.name,
                daq_input.quantity,
                daq_input.role,
                self.name,
                f"{daq_input.role} {daq_input.quantity.replace('_', ' ')}",
                skew_s=index * input_spacing_s,
                scale_std=1e-6 * settings.scale_std_ppm,
            )
            for index, daq_input in enumerate(settings.inputs)
        )
        return (StreamSpec(self.name, channels, settings.rate_Hz, ends=settings.samples is not None),)

    def take(self) -> Sequence[SampleBlock]:
        """Return the samples of the last 20 ms; the first call starts the sample clock. Never waits.

        Raises
        ------
        DeviceError : the device is gone or refuses, or has lost samples too often.
        NoAnswer : the sample clock has stopped.
        """
        task, now = self._task, self._clock.now()
        if task is None or self._ended or now < self._read_due_at:
            return ()
        blocks: list[SampleBlock] = []
        try:
            if not self._running:
                self._begin(task)
                return ()
            blocks += self._read_samples(task)
        except DaqmxError as error:
            if error.code not in OVERRUNS or self._restarts == MOST_RESTARTS:
                raise self._name_device(error) from None
            blocks += self._resume(error)
        if not self._ended and now - self._last_sample_at > LONGEST_SILENCE_S:
            raise NoAnswer(
                f"{self.name}: no sample for {now - self._last_sample_at:.3g} s; the sample clock stands still"
            )
        return blocks

    def notices(self) -> Sequence[str]:
        """Return notices of rate, warnings of NI-DAQmx, samples lost or out of range, and gain of the sample clock."""
        for index, count in enumerate(self._out_of_range):
            if count:
                daq_input = self.settings.inputs[index]
                self._notices.append(
                    f"input {daq_input.name}: {count} samples beyond +-{daq_input.range_V:g} V are NaN"
                )
                self._out_of_range[index] = 0
        notices, self._notices = self._notices, []
        return notices

    def _begin(self, task: Acquisition) -> None:
        """Start the sample clock."""
        self._started_at = self._clock.now()  # read before the call, so that no stamp is later than its sample
        task.start()
        self._running, self._count = True, 0
        self._last_sample_at = self._clock.now()
        self._read_due_at = self._last_sample_at + READ_PERIOD_S

    def _read_samples(self, task: Acquisition) -> list[SampleBlock]:
        """Read the samples since the last call, with their stamps."""
        import numpy as np

        volts = task.read()
        now = self._clock.now()
        self._read_due_at = now + READ_PERIOD_S
        sample_count = volts.shape[1]
        if not sample_count:
            return []
        self._last_sample_at = now
        self._shift_back(now, sample_count, task)
        times = self._started_at + np.arange(self._count, self._count + sample_count) / task.rate_Hz
        self._count += sample_count
        if self._remaining:
            self._remaining -= sample_count
            if self._remaining <= 0:
                self._end(f"the acquisition of {self.settings.samples} samples is complete")
        return [self._sample_block(times, self._scale(volts))]

    def _shift_back(self, now: float, samples: int, task: Acquisition) -> None:
        """Shift the stamps back if the device's clock has run ahead of the bench's, so that none is in the future."""
        input_count = len(self.settings.inputs)
        newest_stamp = (
            self._started_at + (self._count + samples - 1) / task.rate_Hz + (input_count - 1) / task.convert_Hz
        )
        first_stamp = self._started_at + self._count / task.rate_Hz
        lead = min(newest_stamp - now, 0.5 * (first_stamp - self._last_stamp))
        if lead > 0.0:
            self._started_at -= lead
            earlier_gain, self._clock_gain_s = self._clock_gain_s, self._clock_gain_s + lead
            if self._clock_gain_s // REPORTED_GAIN_S > earlier_gain // REPORTED_GAIN_S:
                self._notices.append(
                    f"the sample clock has gained {1e3 * self._clock_gain_s:.3g} ms on the bench's so far"
                )

    def _scale(self, volts: "NDArray[np.float64]") -> "NDArray[np.float64]":
        """Convert samples (inputs, samples) [V] to values (samples, inputs); NaN beyond the range of an input."""
        import numpy as np

        values = np.empty(volts.T.shape)
        for index, daq_input in enumerate(self.settings.inputs):
            is_out_of_range = ~(np.abs(volts[index]) < daq_input.range_V * (1.0 - 2.0**-15))
            if is_out_of_range.any():
                self._out_of_range[index] += int(is_out_of_range.sum())
                volts[index, is_out_of_range] = np.nan
            values[:, index] = daq_input.sign * daq_input.scale_per_V * volts[index]
        return values

    def _sample_block(self, times: "NDArray[np.float64]", values: "NDArray[np.float64]") -> SampleBlock:
        self._last_stamp = float(times[-1])
        return SampleBlock(self.name, times, values)

    def _resume(self, error: DaqmxError) -> list[SampleBlock]:
        """Restart after an overrun; return a NaN for each lost sample."""
        import numpy as np

        assert self._task is not None
        rate = self._task.rate_Hz
        self._task.close()
        gap_begin, now = self._started_at + self._count / rate, self._clock.now()
        lost_count = max(0, math.floor((now - gap_begin) * rate))
        if self._remaining:
            lost_count = min(lost_count, self._remaining)
            self._remaining -= lost_count
        self._restarts += 1
        self._notices.append(f"{lost_count} samples are lost, and NaN, after {error}")
        if self.settings.samples is not None and not self._remaining:
            self._end("the acquisition is complete, its end lost")
        else:
            self._begin(self._acquire())
        times = gap_begin + np.arange(lost_count) / rate
        return (
            [self._sample_block(times, np.full((lost_count, len(self.settings.inputs)), np.nan))] if lost_count else []
        )

    def _end(self, text: str) -> None:
        """End the acquisition with a notice."""
        self._ended = True
        self._notices.append(text)

    def _name_device(self, error: DeviceError) -> DeviceError:
        """Return an error with this device's name at its beginning."""
        if str(error).startswith(f"{self.name}:"):
            return error
        return DeviceError(f"{self.name}: {error}")
