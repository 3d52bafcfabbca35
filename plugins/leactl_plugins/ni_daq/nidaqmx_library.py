"""NI-DAQmx through NI's package `nidaqmx`, which is imported when a device is acquired."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leactl.errors import DeviceError
from leactl_plugins.ni_daq.acquisition import DaqmxError
from leactl_plugins.ni_daq.settings import NiDaqSettings

BUFFER_S = 10.0  # time for which a host may stall before samples are lost
TERMINALS = {"differential": "DIFF", "rse": "RSE", "nrse": "NRSE"}


class NidaqmxLibrary:
    """Factory of acquisitions by NI's package."""

    def __init__(self) -> None:
        try:
            import nidaqmx
        except ImportError:
            raise DeviceError("the package nidaqmx is not installed: pip install 'leactl[nidaqmx]'") from None
        self._nidaqmx = nidaqmx

    def acquire(self, settings: NiDaqSettings, samples: int | None) -> "NidaqmxTask":
        """Reserve the device and configure it.

        Raises
        ------
        DaqmxError : the device is absent, in use, or refuses a setting.
        DeviceError : NI's driver is not installed here.
        """
        return NidaqmxTask(self._nidaqmx, settings, samples)


class NidaqmxTask:
    """One task of NI-DAQmx."""

    def __init__(self, nidaqmx: Any, settings: NiDaqSettings, samples: int | None) -> None:
        from nidaqmx.stream_readers import AnalogMultiChannelReader

        self.warnings: list[str] = []
        self._input_count = len(settings.inputs)
        with converted_errors(), warnings.catch_warnings(record=True) as caught_warnings:
            warnings.simplefilter("always")
            device = nidaqmx.system.Device(settings.device)
            self.product: str = device.product_type
            self.serial_number = _serial_number(nidaqmx, device)
            self._task = nidaqmx.Task()
            try:
                self._configure(nidaqmx, settings, samples)
                self.rate_Hz: float = self._task.timing.samp_clk_rate
                self.convert_Hz: float = self._task.timing.ai_conv_rate if self._input_count > 1 else self.rate_Hz
            except BaseException:
                self.close()
                raise
        self.warnings = [" ".join(str(warning.message).split()) for warning in caught_warnings]
        self._stream = self._task.in_stream
        self._reader = AnalogMultiChannelReader(self._stream)

    def _configure(self, nidaqmx: Any, settings: NiDaqSettings, samples: int | None) -> None:
        """Add the inputs to the task, and configure its sample clock."""
        constants = nidaqmx.constants
        for daq_input in settings.inputs:
            self._task.ai_channels.add_ai_voltage_chan(
                f"{settings.device}/{daq_input.channel}",
                terminal_config=constants.TerminalConfiguration[TERMINALS[daq_input.terminals]],
                min_val=-daq_input.range_V,
                max_val=daq_input.range_V,
            )
        mode = constants.AcquisitionType.CONTINUOUS if samples is None else constants.AcquisitionType.FINITE
        self._task.timing.cfg_samp_clk_timing(
            settings.rate_Hz,
            sample_mode=mode,
            samps_per_chan=round(BUFFER_S * settings.rate_Hz) if samples is None else samples,
        )

    def start(self) -> None:
        """Start sampling."""
        with converted_errors():
            self._task.start()

    def read(self) -> NDArray[np.float64]:
        """Return the samples since the last call, (inputs, samples), V."""
        with converted_errors():
            sample_count = self._stream.avail_samp_per_chan
            values = np.empty((self._input_count, sample_count))
            if sample_count:
                self._reader.read_many_sample(values, sample_count, timeout=0.0)
        return values

    def close(self) -> None:
        """Stop sampling and release the device."""
        with suppress(DeviceError), converted_errors():
            self._task.close()


def _serial_number(nidaqmx: Any, device: Any) -> str:
    """Return the serial number in hexadecimal digits, as on labels; empty if the device reports none."""
    try:
        number = int(device.serial_num)
    except nidaqmx.errors.DaqError:
        return ""
    return f"{number:X}" if number else ""


@contextmanager
def converted_errors() -> Iterator[None]:
    """Convert NI-DAQmx's errors in the block to DaqmxError."""
    from nidaqmx.errors import DaqError, DaqFunctionNotSupportedError, DaqNotFoundError, DaqNotSupportedError

    try:
        yield
    except DaqError as error:
        raise DaqmxError(error.error_code, str(error)) from None
    except DaqNotFoundError:
        raise DeviceError("NI-DAQmx is not installed on this machine: install NI's driver (ni.com/downloads)") from None
    except (DaqNotSupportedError, DaqFunctionNotSupportedError) as error:
        raise DeviceError(" ".join(str(error).split())) from None
