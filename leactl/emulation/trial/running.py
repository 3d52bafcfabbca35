"""Run every trial of a driver in a separate process, so that a trial that hangs or crashes is also a finding."""

import json
import os
import select
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from leactl.driver.contract import Driver, MotionDevice, PowerSupply
from leactl.driver.file_records import BatchSource
from leactl.emulation.trial import drives, lifetime, measuring_devices, probing, supplies
from leactl.emulation.trial.stand import Broken, Stand, example_settings
from leactl.errors import InputError, LeactlError

TRIAL_TIMEOUT_S = 10.0  # by the wall clock; a trial itself only waits by emulated time
Trial = Callable[[Stand], None]


@dataclass(frozen=True)
class TrialResult:
    """Name of one trial, and its fault, which is empty if it passed."""

    name: str
    fault: str


def try_driver(driver: type[Driver]) -> list[TrialResult]:
    """Run all trials of a driver, each with a new driver and a new far end.

    Raises
    ------
    InputError : the driver has no `example` of settings or no far end.
    """
    with tempfile.TemporaryDirectory() as folder_name:
        folder = Path(folder_name)
        trials = trials_of(driver, folder)
        return [TrialResult(trial_name(trial), run_in_child(trial, driver, folder)) for trial in trials]


def trials_of(driver: type[Driver], folder: Path) -> tuple[Trial, ...]:
    """Return the trials that a driver of this kind has to pass.

    Raises
    ------
    InputError : the driver's `example` does not suit its `Settings`, or it has no far end.
    """
    try:
        example_settings(driver, folder)
    except ValueError as error:
        raise InputError(f"its `example` is no settings of one: {' '.join(str(error).split())}") from None
    stand = Stand(driver, folder)
    output_trials = lifetime.OUTPUT_TRIALS if isinstance(stand.driver, MotionDevice | PowerSupply) else ()
    return (
        *_trials_of_kind(stand),
        *lifetime.TRIALS,
        *output_trials,
        *(probing.TRIALS if driver.probe is not None else ()),
    )


def _trials_of_kind(stand: Stand) -> tuple[Trial, ...]:
    """Return the trials for drives, supplies, devices whose readings come in files, or other devices."""
    if isinstance(stand.driver, MotionDevice):
        return drives.TRIALS
    if isinstance(stand.driver, PowerSupply):
        return supplies.TRIALS
    if isinstance(stand.driver, BatchSource):
        return measuring_devices.RECORD_TRIALS
    cable_trials = () if stand.driver.transport == "none" else measuring_devices.CABLE_TRIALS
    return (*measuring_devices.STREAM_TRIALS, *cable_trials)


def trial_name(trial: Trial) -> str:
    """Return the name of a trial in words."""
    return trial.__name__.replace("_", " ")


def run_in_child(trial: Trial, driver: type[Driver], folder: Path) -> str:
    """Run one trial in a separate process; return its fault, or an empty text.

    If the system cannot fork, the trial runs in this process; one that hangs must then be interrupted by hand.
    """
    if not hasattr(os, "fork"):
        return run_in_this_process(trial, driver, folder)
    read_end, write_end = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        exit_code = 1
        with suppress(BaseException):  # whatever a driver does, this process ends here
            os.write(write_end, json.dumps(run_in_this_process(trial, driver, folder)).encode())
            exit_code = 0
        os._exit(exit_code)
    os.close(write_end)
    try:
        return read_fault(read_end)
    finally:
        os.close(read_end)
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def read_fault(pipe: int) -> str:
    """Return the fault that a trial's process sends through a pipe, or that it has crashed or hangs."""
    message, deadline = b"", time.monotonic() + TRIAL_TIMEOUT_S
    while time_left := max(deadline - time.monotonic(), 0.0):
        if not select.select([pipe], [], [], time_left)[0]:
            break
        received = os.read(pipe, 65536)
        if not received:
            return str(json.loads(message)) if message else "it has ended the process of the trial"
        message += received
    return f"it hangs: no end within {TRIAL_TIMEOUT_S:g} s, although only the bench's clock passes"


def run_in_this_process(trial: Trial, driver: type[Driver], folder: Path) -> str:
    """Run one trial in this process; return its fault, or an empty text."""
    try:
        trial(Stand(driver, Path(tempfile.mkdtemp(dir=folder))))
    except Broken as broken:
        return str(broken)
    except LeactlError as error:
        return f"{type(error).__name__}: {error}"
    except Exception as error:  # noqa: BLE001 (a driver may raise anything, and the trial reports it)
        return f"breaks with {type(error).__name__}: {error}"
    return ""
