"""Interface of an acquisition, real or emulated, and the names of NI-DAQmx's errors."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from leactl.driver.contract import Confirmation
from leactl.errors import DeviceError
from leactl_plugins.ni_daq.settings import NiDaqSettings

OVERRUNS = (-200279, -200222, -200361, -200019)  # codes: samples were lost, and the acquisition has stopped
SAFE = Confirmation(True, "measures only")
ERRORS = {  # code: NI's name for it, and what to do
    -200220: ("INVALID_DEVICE_ID", "no such device: `leactl doctor` lists those that there are; mend settings.device"),
    -200170: ("PHYSICAL_CHAN_DOES_NOT_EXIST", "the device has no such input: mend settings.inputs"),
    -200279: ("SAMPLES_NO_LONGER_AVAILABLE", "the buffer was overwritten before it was read: lower rate_Hz"),
    -200278: ("SAMPLES_WILL_NEVER_BE_AVAILABLE", "the acquisition ended sooner"),
    -200284: ("SAMPLES_NOT_YET_AVAILABLE", "the sample clock stands still"),
    -200222: ("ACQ_STOPPED_TO_PREVENT_INPUT_BUFFER_OVERWRITE", "the buffer was full: lower rate_Hz"),
    -200361: ("INPUT_FIFO_OVERFLOW_2", "the bus took the samples too late: plug it into a port of its own"),
    -200019: ("ADC_OVERRUN", "the converter is asked too often: lower rate_Hz, or leave inputs out"),
    -50103: ("PAL_RESOURCE_RESERVED", "another program holds the device: end it"),
    -200088: ("INVALID_TASK", "the task is gone: the device was reset"),
    -200077: ("INVALID_ATTRIBUTE_VALUE", "the device does not take one of the settings: see its data sheet"),
    -200081: ("SAMPLE_RATE_NUM_CHANS_CONVERT_PERIOD_COMBO", "too fast for so many inputs: lower rate_Hz"),
    -200332: ("SAMP_RATE_TOO_HIGH", "faster than the device: lower rate_Hz"),
    -201003: ("DEV_CANNOT_BE_ACCESSED", "the device is gone: check cable and power"),
    -88710: ("RUNTIME_ABORTING_ROUTING", "the device was taken away in mid-run: check cable and power"),
    -88708: ("RESOURCE_NOT_IN_POOL_ROUTING", "the device is not in a state to be used: unplug it and plug it in again"),
}


class DaqmxError(DeviceError):
    """Error of NI-DAQmx, with its code, its name if it is known, and a hint."""

    def __init__(self, code: int, text: str = "") -> None:
        self.code = code
        name, hint = ERRORS.get(code, ("", ""))
        description = hint or next((line.strip() for line in text.splitlines() if line.strip()), "no description")
        super().__init__(f"NI-DAQmx {code}{f' ({name})' if name else ''}: {description}")


class Acquisition(Protocol):
    """One configured task of a device; every method raises `DaqmxError` for an error of NI-DAQmx."""

    product: str
    serial_number: str  # as on its label; empty if the device reports none
    rate_Hz: float  # noqa: N815 (as the device coerced it)
    convert_Hz: float  # noqa: N815 (from one input to the next)
    warnings: list[str]  # of the device, one line each

    def start(self) -> None:
        """Start sampling."""

    def read(self) -> NDArray[np.float64]:
        """Return the samples since the last call, (inputs, samples), V; never waits."""

    def close(self) -> None:
        """Stop sampling and release the device; never raises."""


class Library(Protocol):
    """Factory of acquisitions."""

    def acquire(self, settings: NiDaqSettings, samples: int | None) -> Acquisition:
        """Reserve the device and configure it for `samples` samples of each input, or without end if None."""
