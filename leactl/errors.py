"""Define every error that leactl raises on purpose, each with the exit status that a shell script sees.

LeactlError (1)
 +- InputError (2)          a file, an option or a run that cannot be used
 |   +- MissingChannel      a run lacks a quantity that the question needs
 |   +- NotIdentifiable     the data cannot answer the question
 |   +- NotWritten          a file cannot be written (leactl.runfile.publish)
 |   +- RecordingFailed     the file of a run cannot be written any more (leactl.runfile.write.writer)
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

_AT_LINE_AND_COLUMN = re.compile(r"(.+?):(\d+):(\d+)  (.*)", re.DOTALL)  # as yamlfile writes the position of a fault
_FILE_AND_MESSAGE = re.compile(r"(.+?): (.*)", re.DOTALL)
_INPUT_ENDINGS = (".h5", ".partial", ".yaml", ".yml", ".csv", ".json", ".mat")  # of files that a command reads
_LINE_OF_TABLE = re.compile(r"line (\d+)\b")  # as leactl.tables writes the line of a row


class LeactlError(Exception):
    """Root of the tree; the message is one line that a person can act on."""

    exit_status = 1


class InputError(LeactlError):
    """An input cannot be used; the message has one line for each of its faults."""

    exit_status = 2

    def __init__(self, faults: str | Sequence[str]) -> None:
        self.faults: list[str] = [faults] if isinstance(faults, str) else list(faults)
        super().__init__("\n".join(self.faults))

    def as_json(self) -> list[dict[str, Any]]:
        """Return every fault as a JSON object; file, line and column are null for a fault that lies in no file."""
        return [_fields_of_fault(fault) for fault in self.faults]


def _fields_of_fault(fault: str) -> dict[str, Any]:
    """Split the line of a fault into file, line, column and message."""
    at_line, in_file = _AT_LINE_AND_COLUMN.fullmatch(fault), _FILE_AND_MESSAGE.fullmatch(fault)
    if at_line:
        file, line, column, message = at_line.groups()
        return {"file": file, "line": int(line), "column": int(column), "message": message}
    if in_file and (in_file[1].endswith(_INPUT_ENDINGS) or Path(in_file[1]).exists()):
        table_line = _LINE_OF_TABLE.match(in_file[2])
        return {
            "file": in_file[1],
            "line": int(table_line[1]) if table_line else None,
            "column": None,
            "message": in_file[2],
        }
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
    """The machine has no bus of this kind, so that it cannot have commanded any device on such a bus."""


class AcceptanceFailed(LeactlError):
    """The run is complete and an acceptance limit of its protocol was not met."""

    exit_status = 6
