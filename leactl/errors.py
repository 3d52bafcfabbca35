"""Every error that leactl raises on purpose, each with the exit status a shell script sees.

LeactlError (1)
 +- InputError (2)          a file, an option or a run that cannot be used
 |   +- MissingChannel      a run lacks a quantity that the question needs
 |   +- NotIdentifiable     the data cannot answer the question
 |   +- NotWritten          a file's place takes none (leactl.runfile.publish)
 |   +- RecordingFailed     the disk that was to hold a run takes no more (leactl.runfile.write.writer)
 +- SafetyTrip (3)          the supervisor stopped the bench
 +- Stopped (4)             a person stopped the run
 +- DeviceError (5)         a device or its bus failed
 |   +- NoAnswer            nothing came back in time
 |   +- DeviceFault         the device says it is in fault
 |   +- NoBus               the machine has no bus of this kind
 +- AcceptanceFailed (6)    an acceptance limit of the protocol was not met
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_PLACED = re.compile(r"(.+?):(\d+):(\d+)  (.*)", re.DOTALL)  # as yamlfile writes the place of a fault
_OF_A_FILE = re.compile(r"(.+?): (.*)", re.DOTALL)
_ENDINGS = (".h5", ".partial", ".yaml", ".yml", ".csv", ".json", ".mat")  # of files that a command reads
_AT_A_LINE = re.compile(r"line (\d+)\b")  # as readers of tables write it


class LeactlError(Exception):
    """Root of the tree: one line a person can act on."""

    exit_status = 1


class InputError(LeactlError):
    """An input that cannot be used: every fault found in it, one line each."""

    exit_status = 2

    def __init__(self, faults: str | Sequence[str]) -> None:
        self.faults: list[str] = [faults] if isinstance(faults, str) else list(faults)
        super().__init__("\n".join(self.faults))

    def as_json(self) -> list[dict[str, Any]]:
        """Every fault as JSON takes it; file, line and column are null where it stands in no file."""
        return [_parted(fault) for fault in self.faults]


def _parted(fault: str) -> dict[str, Any]:
    """A fault's line as file, line, column and message."""
    placed, of_a_file = _PLACED.fullmatch(fault), _OF_A_FILE.fullmatch(fault)
    if placed:
        file, line, column, message = placed.groups()
        return {"file": file, "line": int(line), "column": int(column), "message": message}
    if of_a_file and (of_a_file[1].endswith(_ENDINGS) or Path(of_a_file[1]).exists()):
        row = _AT_A_LINE.match(of_a_file[2])
        return {"file": of_a_file[1], "line": int(row[1]) if row else None, "column": None, "message": of_a_file[2]}
    return {"file": None, "line": None, "column": None, "message": fault}


class MissingChannel(InputError):
    """A run lacks a channel of the quantity and role that was asked for."""


class NotIdentifiable(InputError):
    """The data cannot determine the parameter that was asked for."""


class SafetyTrip(LeactlError):
    """The supervisor stopped the bench; the trip stays latched until a person resets it."""

    exit_status = 3


class Stopped(LeactlError):
    """A person stopped the run."""

    exit_status = 4


class DeviceError(LeactlError):
    """A device or the bus to it failed."""

    exit_status = 5


class NoAnswer(DeviceError):
    """A device did not answer within its time."""


class DeviceFault(DeviceError):
    """A device reports a fault of its own."""


class NoBus(DeviceError):
    """The machine has no bus of this kind: nothing that hangs on it can have been commanded from here."""


class AcceptanceFailed(LeactlError):
    """The run is complete and an acceptance limit of its protocol was not met."""

    exit_status = 6
