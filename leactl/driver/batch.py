"""Records that other programs make of a run: what a driver reads out of their files, and how their clock is tied.

A camera's program or a drive maker's tool samples by a clock of its own and leaves files behind. Such a device takes no
part in the control loop: its stamps mean nothing on the run's clock until the whole record has been seen, and a row
that is in a run file is never moved again. The record joins the run after its end (`leactl runs attach`).
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
Above = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
AtLeastZero = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
Place = Annotated[str, StringConstraints(strict=True, pattern=r"^[^/]+/[^/]+$")]  # stream/channel
Called = Annotated[str, StringConstraints(strict=True, pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")]


@dataclass(frozen=True, eq=False)
class FileRecord:
    """What the files of one device hold, on the device's own clock."""

    stream: str
    channels: tuple[ChannelSpec, ...]
    time: Array  # s on the own clock, strictly increasing
    values: Array  # (rows, channels), NaN where nothing was measured
    began: float | None  # own time zero in s since 1970 UTC; None where the clock tells no date or no zone
    resolution: float  # of a stamp [s]
    told: tuple[str, ...]  # dialect, units and clock as they were read, and what is wrong with the record
    files: tuple[Path, ...]


class OffsetEstimate(Block):
    """Find a clock's offset from two channels that measured the same."""

    channel: Called
    against: Place
    within_s: Above = 1.0


class Onset(Block):
    """Find a clock's offset from events: `against` jumps, and from then on `channel` rises or falls."""

    channel: Called
    against: Place
    jump: Above  # of `against`, in its units
    fit_s: Above = 5.0  # of the channel, before and after
    within_s: Above = 60.0


class RecordClock(Block):
    """How the stamps of a record are tied to the clock of the run; one way has to be chosen."""

    wall_within_s: Above | None = None  # both clocks show the time of day, and agree within this (95 %)
    offset_s: Number | None = None  # added to the record's own stamps
    offset_within_s: AtLeastZero | None = None  # what that offset is good for (95 %)
    estimate: OffsetEstimate | None = None
    onset: Onset | None = None
    near_s: Number | None = None  # the offset that `estimate` or `onset` is sought around; by the wall clocks, else 0
    delays_within_s: AtLeastZero = 0.0  # by which the channels that are compared may lag each other (95 %)
    drift_within_ppm: Above = 100.0  # of one clock against the other (95 %), before the record tells more

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        ways = ("wall_within_s", "offset_s", "estimate", "onset")
        given = [name for name in ways if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"give one of {', '.join(ways)}; {' and '.join(given) or 'none'} is given")
        if (self.offset_s is None) != (self.offset_within_s is None):
            raise ValueError("offset_s and offset_within_s go together: an offset without its error is a guess")
        return self


class RecordSettings(DriverSettings):
    """What every device has whose readings come in files."""

    clock: RecordClock | None = None
    # Where its program leaves files; what comes there during a run joins it. A relative one lies where the runs do.
    exports_folder: Annotated[str, Field(min_length=1)] | None = None


class ExportFolder:
    """Where a program leaves its exports; those of a run are the files that were not there before it."""

    def __init__(self, folder: str | None) -> None:
        self.folder = Path(folder) if folder else None
        self._before: dict[Path, int] = {}

    @property
    def absent(self) -> bool:
        """Whether there is no such folder, or none that may be looked into."""
        return not (self.folder and os.path.isdir(self.folder))  # noqa: PTH112 (is_dir raises where it may not look)

    def look(self) -> None:
        """Remember what is there now."""
        self._before = self._files()

    def fresh(self) -> list[Path]:
        """Files that have come or changed since the last look, by name: frame2 before frame10."""
        return sorted((path for path, was in self._files().items() if self._before.get(path) != was), key=number_order)

    def _files(self) -> dict[Path, int]:
        found: dict[Path, int] = {}
        with suppress(OSError):  # no such folder, or none that can be read: nothing comes from there
            for path in self.folder.iterdir() if self.folder else ():
                with suppress(FileNotFoundError):  # gone since it was listed
                    if path.is_file():
                        found[path] = path.stat().st_mtime_ns
        return found


def number_order(path: Path) -> list[tuple[int, str]]:
    """What sorts files by name, the numbers in their names by value."""
    parts = re.split(r"([0-9]+)", str(path))  # text, number, text, ...
    return [(int(part), part) if odd else (0, part) for part, odd in zip(parts, itertools.cycle((False, True)))]


def in_number_order(paths: Sequence[Path]) -> None:
    """See that files whose order is all that tells their time are not in the order of their names as text.

    Raises
    ------
    InputError : a list that a shell has sorted has frame10 before frame2.
    """
    expected = sorted(paths, key=number_order)
    if list(paths) == sorted(paths) != expected:
        at = next(k for k, (given, meant) in enumerate(zip(paths, expected, strict=True)) if given != meant)
        told = f"comes where {expected[at].name} was expected; give the files in the order of their numbers"
        raise InputError(f"{paths[at]}: {told}")


@runtime_checkable
class BatchSource(Protocol):
    """A device whose readings come in files, whole records at a time."""

    @property
    def clock(self) -> RecordClock | None:
        """How its records are tied to a run, as the settings say; None where whoever attaches one has to say."""

    @property
    def channels(self) -> tuple[ChannelSpec, ...]:
        """What its records hold."""

    @property
    def exports(self) -> ExportFolder:
        """Where its files come in; `open` looks there, so that those of a run are known after it."""

    def read_files(self, paths: Sequence[Path]) -> FileRecord:
        """Read one record from its files.

        Raises
        ------
        InputError : everything that is wrong with them, one line each.
        """
