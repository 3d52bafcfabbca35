"""NI converter at a motor's leads: it samples by its own clock, and the driver takes the samples in blocks.

The stamps are those of the sample clock at the rate that the device accepted; the multiplexer converts each input
later by its position, which the channel states. Each sample that the device lost is NaN, and a notice reports it.
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
LONGEST_SILENCE_S = 1.0  # after more time without a sample, the device has stopped by itself
RATE_TOLERANCE = 0.01  # relative difference from the requested rate; with more it is another experiment
MOST_RESTARTS = 3  # after overruns, in one run
REPORTED_SLIP_S = 1e-3  # step of the clock's slip from one notice to the next


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
        self._start = self._due = self._heard = math.nan
        self._count = self._remaining = 0  # samples since the start, and still to come of a finite acquisition
        self._last = -math.inf  # stamp of the last row
        self._restarts, self._slip = 0, 0.0
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
        DeviceError : NI's driver or package is not installed, or the device is absent, another one, in use, or refuses.
        """
        settings = self.settings
        expected, where = (
            ("nidaqmx", "not emulated in this process") if self._port is None else ("emulated", "emulated")
        )
        if settings.library != expected:
            raise InputError(
                f"{self.name}: library '{settings.library}' on a bench that is {where}; {expected} was expected"
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
        turns = f", each input {1e6 / task.convert_Hz:.3g} us after the one before" if len(settings.inputs) > 1 else ""
        self._notices.append(
            f"{task.product} samples at {task.rate_Hz:.9g} Hz, {settings.rate_Hz:g} Hz were asked for{turns}"
        )
        self._notices += task.warnings

    def _acquire(self) -> Acquisition:
        from leactl_plugins.ni_daq.nidaqmx_library import NidaqmxLibrary

        try:
            self._task = (self._port or NidaqmxLibrary()).acquire(self.settings, self._remaining or None)
        except DeviceError as error:
            raise self._name_device(error) from None
        return self._task

    def identity(self) -> Identity:
        """Product type and serial number from NI-DAQmx, which reports no firmware."""
        return self._identity

    def close(self) -> None:
        """Release the device."""
        task, self._task, self._running = self._task, None, False
        if task is not None:
            task.close()

    @classmethod
    def far_end(cls, settings: NiDaqSettings, role: str, physics: Physics) -> BuslessEmulator:
        """A converter at the leads of the emulated motors, in place of NI-DAQmx."""
        from leactl_plugins.ni_daq.emulator import EmulatedDaq

        return EmulatedDaq(settings, physics)

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """One stream of all inputs; once the device is open, each channel has its skew by the multiplexer."""
        settings, task = self.settings, self._task
        turn = 1.0 / task.convert_Hz if task is not None and len(settings.inputs) > 1 else 0.0
        channels = tuple(
            ChannelSpec(
                item.name,
                item.quantity,
                item.role,
                self.name,
                f"{item.role} {item.quantity.replace('_', ' ')}",
                skew_s=index * turn,
                scale_std=1e-6 * settings.scale_std_ppm,
            )
            for index, item in enumerate(settings.inputs)
        )
        return (StreamSpec(self.name, channels, settings.rate_Hz, ends=settings.samples is not None),)

    def take(self) -> Sequence[SampleBlock]:
        """Samples of the last 20 ms; the first call starts the sample clock; never waits.

        Raises
        ------
        DeviceError : the device is gone or refuses, or has lost samples too often; `NoAnswer` where it has stopped.
        """
        task, now = self._task, self._clock.now()
        if task is None or self._ended or now < self._due:
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
        if not self._ended and now - self._heard > LONGEST_SILENCE_S:
            raise NoAnswer(f"{self.name}: no sample for {now - self._heard:.3g} s; the sample clock stands still")
        return blocks

    def notices(self) -> Sequence[str]:
        """Notices: resulting rate, warnings of NI-DAQmx, samples lost or out of range, drift of the sample clock."""
        for index, count in enumerate(self._out_of_range):
            if count:
                item = self.settings.inputs[index]
                self._notices.append(f"input {item.name}: {count} samples beyond +-{item.range_V:g} V are NaN")
                self._out_of_range[index] = 0
        notices, self._notices = self._notices, []
        return notices

    def _begin(self, task: Acquisition) -> None:
        self._start = self._clock.now()  # before the call, so that no stamp is later than its sample
        task.start()
        self._running, self._count = True, 0
        self._heard = self._clock.now()
        self._due = self._heard + READ_PERIOD_S

    def _read_samples(self, task: Acquisition) -> list[SampleBlock]:
        import numpy as np

        volts = task.read()
        now = self._clock.now()
        self._due = now + READ_PERIOD_S
        samples = volts.shape[1]
        if not samples:
            return []
        self._heard = now
        self._shift_back(now, samples, task)
        times = self._start + np.arange(self._count, self._count + samples) / task.rate_Hz
        self._count += samples
        if self._remaining:
            self._remaining -= samples
            if self._remaining <= 0:
                self._end(f"the acquisition of {self.settings.samples} samples is complete")
        return [self._block(times, self._scale(volts))]

    def _shift_back(self, now: float, samples: int, task: Acquisition) -> None:
        """Shift the stamps back if the device's clock has run ahead of the bench's, so that none is in the future."""
        inputs = len(self.settings.inputs)
        newest = self._start + (self._count + samples - 1) / task.rate_Hz + (inputs - 1) / task.convert_Hz
        first = self._start + self._count / task.rate_Hz
        ahead = min(newest - now, 0.5 * (first - self._last))
        if ahead > 0.0:
            self._start -= ahead
            before, self._slip = self._slip, self._slip + ahead
            if self._slip // REPORTED_SLIP_S > before // REPORTED_SLIP_S:
                self._notices.append(f"the sample clock has gained {1e3 * self._slip:.3g} ms on the bench's so far")

    def _scale(self, volts: "NDArray[np.float64]") -> "NDArray[np.float64]":
        """Convert samples (inputs, samples) [V] to values (samples, inputs); NaN beyond the range of an input."""
        import numpy as np

        values = np.empty(volts.T.shape)
        for index, item in enumerate(self.settings.inputs):
            beyond = ~(np.abs(volts[index]) < item.range_V * (1.0 - 2.0**-15))
            if beyond.any():
                self._out_of_range[index] += int(beyond.sum())
                volts[index, beyond] = np.nan
            values[:, index] = item.sign * item.scale_per_V * volts[index]
        return values

    def _block(self, times: "NDArray[np.float64]", values: "NDArray[np.float64]") -> SampleBlock:
        self._last = float(times[-1])
        return SampleBlock(self.name, times, values)

    def _resume(self, error: DaqmxError) -> list[SampleBlock]:
        """Restart after an overrun; each lost sample becomes a NaN."""
        import numpy as np

        assert self._task is not None
        rate = self._task.rate_Hz
        self._task.close()
        begun, now = self._start + self._count / rate, self._clock.now()
        lost = max(0, math.floor((now - begun) * rate))
        if self._remaining:
            lost = min(lost, self._remaining)
            self._remaining -= lost
        self._restarts += 1
        self._notices.append(f"{lost} samples are lost, and NaN, after {error}")
        if self.settings.samples is not None and not self._remaining:
            self._end("the acquisition is complete, its end lost")
        else:
            self._begin(self._acquire())
        times = begun + np.arange(lost) / rate
        return [self._block(times, np.full((lost, len(self.settings.inputs)), np.nan))] if lost else []

    def _end(self, text: str) -> None:
        self._ended = True
        self._notices.append(text)

    def _name_device(self, error: DeviceError) -> DeviceError:
        """The error with this device's name at its beginning."""
        if str(error).startswith(f"{self.name}:"):
            return error
        return DeviceError(f"{self.name}: {error}")
