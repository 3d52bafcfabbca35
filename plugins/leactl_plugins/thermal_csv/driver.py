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
        """Return an emulated camera that measures the actuator of this role.

        Raises
        ------
        InputError : no folder for exports is set, or the settings are for frames of pixels.
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
        """Alignment of the camera's clock with that of a run."""
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
        InputError : a file cannot be read or is ambiguous, or a channel has no number.
        """
        if self.settings.matrix:
            files = [read_matrices(paths, self.settings)]
        else:
            files = [read_series(path, self.settings) for path in paths]
        time, values, zero = join_files(files)
        starts = np.cumsum([0, *(len(camera_file.clock.time) for camera_file in files)])

        def where(row: int) -> str:
            file_index = int(np.searchsorted(starts, row, side="right")) - 1
            return files[file_index].where(row - int(starts[file_index]))

        time_settings = self.settings.time
        resolution = max(camera_file.clock.resolution for camera_file in files)
        ordered = order_rows(time, values, where, time_settings.backward, resolution, time_settings.frame_rate_Hz)
        empty_channels = [
            spec.name for spec, column in zip(self.channels, ordered.values.T, strict=True) if np.isnan(column).all()
        ]
        if empty_channels:
            raise InputError(f"{paths[0]}: no number at all in {', '.join(empty_channels)}")
        remarks = list(dict.fromkeys(text for camera_file in files for text in camera_file.remarks))
        return FileRecord(
            stream=self.name,
            channels=self.channels,
            time=ordered.time - ordered.time[0],
            values=ordered.values,
            began=None if zero is None else zero + float(ordered.time[0]),
            resolution=resolution,
            remarks=(*remarks, *ordered.remarks),
            files=tuple(paths),
        )


def join_files(camera_files: Sequence[CameraFile]) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], float | None]:
    """Return times [s] and values of all parts on one clock, and its zero [s since 1970] (None if unknown).

    Raises
    ------
    InputError : some parts have a date or zone and others have none.
    """
    midnights = [camera_file.clock.midnight for camera_file in camera_files]
    known_midnights = [moment.timestamp() for moment in midnights if moment is not None]
    days = [camera_file.clock.day for camera_file in camera_files]
    for moments in (midnights, days):
        if None in moments and any(moments):
            raise InputError(f"{camera_files[moments.index(None)].where(0)}: no day or no zone, which other files have")
    zero = min(known_midnights) if known_midnights else None
    if zero is not None:
        shifts = [moment - zero for moment in known_midnights]
    else:
        known_days = [day for day in days if day is not None]
        shifts = [(day - min(known_days)).total_seconds() for day in known_days] or [0.0] * len(camera_files)
    time = np.concatenate(
        [camera_file.clock.time + shift for camera_file, shift in zip(camera_files, shifts, strict=True)]
    )
    return time, np.concatenate([camera_file.values for camera_file in camera_files]), zero
