"""Every trial of a driver in a process of its own: one that hangs or takes the process with it is a finding too."""

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
from leactl.emulation.trial import drives, lifetime, measuring, probing, supplies
from leactl.emulation.trial.stand import Broken, Stand, example_of
from leactl.errors import InputError, LeactlError

WALL_S = 10.0  # of a trial, all of which wait by emulated time alone
Trial = Callable[[Stand], None]


@dataclass(frozen=True)
class TrialResult:
    """One trial: what has to hold, and what does not; empty where it does."""

    name: str
    fault: str


def try_driver(driver: type[Driver]) -> list[TrialResult]:
    """Make a driver and its far end anew for each trial, and try it; a fault is a line.

    Raises
    ------
    InputError : it cannot be tried, for it has no `example` of settings or no far end.
    """
    with tempfile.TemporaryDirectory() as folder:
        return [
            TrialResult(plain(trial), alone(trial, driver, Path(folder))) for trial in trials_of(driver, Path(folder))
        ]


def trials_of(driver: type[Driver], folder: Path) -> tuple[Trial, ...]:
    """What a driver of this kind has to pass.

    Raises
    ------
    InputError : its `example` is refused by its own settings, or it has no far end.
    """
    try:
        example_of(driver, folder)
    except ValueError as error:
        raise InputError(f"its `example` is no settings of one: {' '.join(str(error).split())}") from None
    stand = Stand(driver, folder)
    outputs = lifetime.OF_OUTPUTS if isinstance(stand.driver, MotionDevice | PowerSupply) else ()
    return (*_of_its_kind(stand), *lifetime.TRIALS, *outputs, *(probing.TRIALS if driver.probe is not None else ()))


def _of_its_kind(stand: Stand) -> tuple[Trial, ...]:
    if isinstance(stand.driver, MotionDevice):
        return drives.TRIALS
    if isinstance(stand.driver, PowerSupply):
        return supplies.TRIALS
    if isinstance(stand.driver, BatchSource):
        return measuring.RECORDS
    return measuring.STREAMS


def plain(trial: Trial) -> str:
    """The name of a trial in words."""
    return trial.__name__.replace("_", " ")


def alone(trial: Trial, driver: type[Driver], folder: Path) -> str:
    """Run one trial in a process of its own; gives what is wrong, or nothing.

    Where processes cannot be forked it runs in this one, and one that hangs has to be interrupted.
    """
    if not hasattr(os, "fork"):
        return outcome(trial, driver, folder)
    reads, writes = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        code = 1
        with suppress(BaseException):  # whatever a driver does, this process ends here
            os.write(writes, json.dumps(outcome(trial, driver, folder)).encode())
            code = 0
        os._exit(code)
    os.close(writes)
    try:
        return answer_of(reads)
    finally:
        os.close(reads)
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def answer_of(reads: int) -> str:
    """What a trial's process has told, within its time."""
    told, end = b"", time.monotonic() + WALL_S
    while left := max(end - time.monotonic(), 0.0):
        if not select.select([reads], [], [], left)[0]:
            break
        part = os.read(reads, 65536)
        if not part:
            return str(json.loads(told)) if told else "it has taken the process with it"
        told += part
    return f"it hangs: more than {WALL_S:g} s where no time passes but on the bench's clock"


def outcome(trial: Trial, driver: type[Driver], folder: Path) -> str:
    """Run one trial here."""
    try:
        trial(Stand(driver, Path(tempfile.mkdtemp(dir=folder))))
    except Broken as broken:
        return str(broken)
    except LeactlError as error:
        return f"{type(error).__name__}: {error}"
    except Exception as error:  # noqa: BLE001 (a driver may break in any way, and that is what is to be told)
        return f"breaks with {type(error).__name__}: {error}"
    return ""
