"""Records that other programs make during a run: what a driver reads from their files, and how their clock is aligned.

A camera's program or a drive maker's tool samples by its own clock and writes files. Such a device takes no part in the
control loop: its stamps can be put on the run's clock only when the whole record is known, and rows of a run file are
never moved. The record is therefore attached after the run (`leactl runs attach`).
"""

import itertools
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Protocol, Self, runtime_checkable

import numpy as np
import numpy.typing as npt
from pydantic import Field, StringConstraints, model_validator

from leactl.driver.contract import DriverSettings
from leactl.errors import InputError
from leactl.quantities import ChannelSpec
from leactl.yamlblock import Block

Array = npt.NDArray[np.float64]
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
NonNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
ChannelPath = Annotated[str, StringConstraints(strict=True, pattern=r"^[^/]+/[^/]+$")]  # stream/channel
ChannelName = Annotated[str, StringConstraints(strict=True, pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")]


@dataclass(frozen=True, eq=False)
class FileRecord:
    """Content of the files of one device, on the device's own clock."""

    stream: str
    channels: tuple[ChannelSpec, ...]
    time: Array  # (rows,), s on the device's clock, strictly increasing
    values: Array  # (rows, channels), NaN where nothing was measured
    began: float | None  # zero of the device's clock, s since 1970 UTC; None if it has no date or no zone
    resolution: float  # of the stamps [s]
    remarks: tuple[str, ...]  # dialect, units and clock as they were read, and doubts about the record
    files: tuple[Path, ...]


class OffsetEstimate(Block):
    """Estimate a clock's offset from two channels that measured the same quantity."""

    channel: ChannelName
    against: ChannelPath
    within_s: Positive = 1.0


class Onset(Block):
    """Estimate a clock's offset from events: when `against` jumps, `channel` begins to rise or fall."""

    channel: ChannelName
    against: ChannelPath
    jump: Positive  # of `against`, in its units
    fit_s: Positive = 5.0  # fitted length of the channel before and after the event
    within_s: Positive = 60.0


class RecordClock(Block):
    """How the stamps of a record are aligned with the clock of the run; exactly one method is given."""

    wall_within_s: Positive | None = None  # both clocks show the time of day, and agree within this (95 %)
    offset_s: Number | None = None  # added to the record's own stamps
    offset_within_s: NonNegative | None = None  # uncertainty of that offset (95 %)
    estimate: OffsetEstimate | None = None
    onset: Onset | None = None
    near_s: Number | None = None  # centre of the search of `estimate` or `onset`; default by the wall clocks, else 0
    delays_within_s: NonNegative = 0.0  # bound of the delay between the compared channels (95 %)
    drift_within_ppm: Positive = 100.0  # bound of the drift between the clocks (95 %), as prior

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        methods = ("wall_within_s", "offset_s", "estimate", "onset")
        stated = [name for name in methods if getattr(self, name) is not None]
        if len(stated) != 1:
            raise ValueError(f"give one of {', '.join(methods)}; {' and '.join(stated) or 'none'} is given")
        if (self.offset_s is None) != (self.offset_within_s is None):
            raise ValueError("offset_s and offset_within_s go together: an offset without its error is a guess")
        return self


class RecordSettings(DriverSettings):
    """Settings of every device whose readings come in files."""

    clock: RecordClock | None = None
    # Folder of the program's exports; files that appear there during a run are attached to it. A relative path lies in
    # the directory of the runs.
    exports_folder: Annotated[str, Field(min_length=1)] | None = None


class ExportFolder:
    """Folder of a program's exports; the exports of a run are the files that are new or changed since its start."""

    def __init__(self, folder: str | None) -> None:
        self.folder = Path(folder) if folder else None
        self._remembered_ns: dict[Path, int] = {}

    @property
    def absent(self) -> bool:
        """Whether the folder does not exist or may not be read."""
        return not (self.folder and os.path.isdir(self.folder))  # noqa: PTH112 (is_dir raises where it may not look)

    def look(self) -> None:
        """Remember the present files."""
        self._remembered_ns = self._files()

    def fresh(self) -> list[Path]:
        """Return the files that are new or changed since the last `look`, sorted by name with numbers by value."""
        return sorted(
            (path for path, mtime_ns in self._files().items() if self._remembered_ns.get(path) != mtime_ns),
            key=number_order,
        )

    def _files(self) -> dict[Path, int]:
        """Return the time of modification [ns] of each file in the folder."""
        modified_ns: dict[Path, int] = {}
        with suppress(OSError):  # a folder that is absent or cannot be read has no files
            for path in self.folder.iterdir() if self.folder else ():
                with suppress(FileNotFoundError):  # gone since it was listed
                    if path.is_file():
                        modified_ns[path] = path.stat().st_mtime_ns
        return modified_ns


def number_order(path: Path) -> list[tuple[int, str]]:
    """Return a sort key of file names that orders numbers by value: frame2 before frame10."""
    parts = re.split(r"([0-9]+)", str(path))  # text, number, text, ...
    return [
        (int(part), part) if is_number else (0, part) for part, is_number in zip(parts, itertools.cycle((False, True)))
    ]


def refuse_text_order(paths: Sequence[Path]) -> None:
    """Raise InputError if files of frames are sorted as text (frame10 before frame2): their order is their only time.

    Raises
    ------
    InputError : the files are in text order and not in the order of their numbers.
    """
    expected = sorted(paths, key=number_order)
    if list(paths) == sorted(paths) != expected:
        index = next(
            number
            for number, (path, sorted_path) in enumerate(zip(paths, expected, strict=True))
            if path != sorted_path
        )
        message = f"comes where {expected[index].name} was expected; give the files in the order of their numbers"
        raise InputError(f"{paths[index]}: {message}")


@runtime_checkable
class BatchSource(Protocol):
    """A device whose readings come in files, whole records at a time."""

    @property
    def clock(self) -> RecordClock | None:
        """How its records are aligned with a run; None if the settings do not state it."""

    @property
    def channels(self) -> tuple[ChannelSpec, ...]:
        """Channels of its records."""

    @property
    def exports(self) -> ExportFolder:
        """Folder of its files; `open` calls `look`, so that the files of a run are known after it."""

    def read_files(self, paths: Sequence[Path]) -> FileRecord:
        """Read one record from its files.

        Raises
        ------
        InputError : all faults of the files, one line each.
        """
