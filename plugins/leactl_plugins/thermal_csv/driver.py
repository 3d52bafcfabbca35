"""Thermal camera read by its exported files: temperatures of regions [degC] on the camera's own clock.

The camera takes no part in the control loop. Its program exports a file, before, during or after the run; the record is
read as a whole, and its clock is aligned with the run's afterwards.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from leactl.driver.clock import Clock
from leactl.driver.contract import Confirmation, Driver
from leactl.driver.far_end import BuslessEmulator, Physics
from leactl.driver.file_records import ExportFolder, FileRecord, RecordClock
from leactl.errors import InputError
from leactl.quantities import ChannelSpec
from leactl.tables.row_order import order_rows
from leactl_plugins.thermal_csv.read_matrices import read_matrices
from leactl_plugins.thermal_csv.read_series import CameraFile, read_series
from leactl_plugins.thermal_csv.settings import ThermalCsvSettings


class ThermalCsv(Driver):
    """One camera whose program exports text."""

    Settings = ThermalCsvSettings
    transport = "none"
    summary = "thermal camera by the text files that its program exports (Fotric 616C, FLIR and others)"
    example: ClassVar[Mapping[str, Any]] = {
        "regions": {"active_1": {"column": "Active 1", "quantity": "winding_temperature"}},
        "time": {"column": "Time", "kind": "elapsed", "frame_rate_Hz": 30.0},
        "unit": "degC",
    }

    def __init__(self, name: str, role: str, settings: ThermalCsvSettings, port: Any, clock: Clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        self.exports = ExportFolder(settings.exports_folder)

    def safe_state(self, deadline_s: float) -> Confirmation:
        """Confirm at once: the camera only measures."""
        return Confirmation(True, "measures only")

    def open(self) -> None:
        """Remember the present files, so that later ones are known to belong to the run."""
        self.exports.look()

    def close(self) -> None:
        """Do nothing: no file stays open."""

    @classmethod
    def far_end(cls, settings: ThermalCsvSettings, role: str, physics: Physics) -> BuslessEmulator:
        """A camera that measures the emulated actuator of this role.

        Raises
        ------
        InputError : no folder of exports is set, or the settings are for frames.
        """
        from leactl_plugins.thermal_csv.emulator import CameraEmulator

        if settings.exports_folder is None:
            raise InputError("exports_folder: an emulated camera needs a folder that its program exports to")
        if settings.matrix:
            raise InputError("regions: an emulated camera exports a series of columns, no frames")
        regions = {name: physics.reading(region.quantity, role, name) for name, region in settings.regions.items()}
        return CameraEmulator(Path(settings.exports_folder), "camera", settings, regions)

    @property
    def clock(self) -> RecordClock | None:
        """How the camera's clock is aligned with that of a run."""
        return self.settings.clock

    @property
    def channels(self) -> tuple[ChannelSpec, ...]:
        """One channel for each region, with the region's name as location."""
        return tuple(
            ChannelSpec(
                name, region.quantity, self.role, self.name, region.column or f"{region.statistic} of {name}", name
            )
            for name, region in self.settings.regions.items()
        )

    def read_files(self, paths: Sequence[Path]) -> FileRecord:
        """Read a record from one export, from its parts in order, or from files with one frame each.

        Raises
        ------
        InputError : a file cannot be read or is ambiguous.
        """
        if self.settings.matrix:
            files = [read_matrices(paths, self.settings)]
        else:
            files = [read_series(path, self.settings) for path in paths]
        time, values, began = join_files(files)
        starts = np.cumsum([0, *(len(sheet.clock.time) for sheet in files)])

        def where(row: int) -> str:
            part = int(np.searchsorted(starts, row, side="right")) - 1
            return files[part].where(row - int(starts[part]))

        times = self.settings.time
        resolution = max(sheet.clock.resolution for sheet in files)
        rows = order_rows(time, values, where, times.backward, resolution, times.frame_rate_Hz)
        empty = [spec.name for spec, column in zip(self.channels, rows.values.T, strict=True) if np.isnan(column).all()]
        if empty:
            raise InputError(f"{paths[0]}: no number at all in {', '.join(empty)}")
        remarks = list(dict.fromkeys(text for sheet in files for text in sheet.remarks))
        return FileRecord(
            stream=self.name,
            channels=self.channels,
            time=rows.time - rows.time[0],
            values=rows.values,
            began=None if began is None else began + float(rows.time[0]),
            resolution=resolution,
            remarks=(*remarks, *rows.remarks),
            files=tuple(paths),
        )


def join_files(sheets: Sequence[CameraFile]) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], float | None]:
    """Times [s] and values of all parts on one clock, and its zero in s since 1970 (None if unknown).

    Raises
    ------
    InputError : some parts have a date or zone and others have none.
    """
    midnights = [sheet.clock.midnight for sheet in sheets]
    known_midnights = [moment.timestamp() for moment in midnights if moment is not None]
    days = [sheet.clock.day for sheet in sheets]
    for dates in (midnights, days):
        if None in dates and any(dates):
            raise InputError(f"{sheets[dates.index(None)].where(0)}: no day or no zone, which other files have")
    began = min(known_midnights) if known_midnights else None
    if began is not None:
        shifts = [moment - began for moment in known_midnights]
    else:
        dated = [day for day in days if day is not None]
        shifts = [(day - min(dated)).total_seconds() for day in dated] or [0.0] * len(sheets)
    time = np.concatenate([sheet.clock.time + shift for sheet, shift in zip(sheets, shifts, strict=True)])
    return time, np.concatenate([sheet.values for sheet in sheets]), began
