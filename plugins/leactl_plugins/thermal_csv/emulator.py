"""Emulator of the camera's program, which exports regions over time or frames, and of a camera aimed at a bench."""

import math
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from pathlib import Path

from leactl.tables.writing import TableDialect, new_export
from leactl_plugins.thermal_csv.settings import ThermalCsvSettings

SYMBOLS = {"degC": "°C", "degF": "°F", "K": "K"}
FROM_CELSIUS: dict[str, Callable[[float], float]] = {
    "degC": lambda value: value,
    "degF": lambda value: value * 1.8 + 32.0,
    "K": lambda value: value + 273.15,
}
FRAME_RATE_HZ = 30.0
LEAD_S = 7.3  # time for which the program has recorded before the bench begins
CLOCK_FAST_PPM = 40.0  # by which the camera's clock is faster than the bench's
BLOCK_S = 1.0  # time between two writes of the program
DAY = datetime(2026, 1, 1)  # date on the clock of a camera that was never set


def series(
    stamps: Sequence[str],
    columns: dict[str, Sequence[float]],
    dialect: TableDialect,
    unit: str = "degC",
    time_heading: str = "Time",
    above: Sequence[str] = (),
    unit_in_cells: bool = False,
) -> bytes:
    """Return the bytes of a file with a series of regions.

    Parameters
    ----------
    columns : temperatures [degC] by heading.
    above : lines above the headings.
    """
    lines = [
        dialect.head(),
        *(line + dialect.line_end for line in above),
        heading(columns, dialect, unit, time_heading),
    ]
    unit_suffix = f" {SYMBOLS[unit]}" if unit_in_cells else ""
    for k, stamp in enumerate(stamps):
        values = [FROM_CELSIUS[unit](column[k]) for column in columns.values()]
        cells = [dialect.number(value) + ("" if math.isnan(value) else unit_suffix) for value in values]
        lines.append(dialect.row([stamp, *cells]))
    return dialect.encoded("".join(lines), is_first=True)


def heading(
    columns: Sequence[str] | dict[str, Sequence[float]], dialect: TableDialect, unit: str, time_heading: str
) -> str:
    """Return the line of headings, with units in brackets."""
    return dialect.row([time_heading, *(f"{name} ({SYMBOLS[unit]})" for name in columns)])


def matrix(
    frames: Sequence[Sequence[Sequence[float]]],
    above: Sequence[Sequence[str]],
    dialect: TableDialect,
    unit: str = "degC",
) -> bytes:
    """Return the bytes of a file with frames of pixels [degC], each below its own lines of text (`above`)."""
    lines = [dialect.head()]
    for frame, text_lines in zip(frames, above, strict=True):
        lines += [line + dialect.line_end for line in text_lines]
        lines += [dialect.row([dialect.number(FROM_CELSIUS[unit](value)) for value in row]) for row in frame]
        lines.append(dialect.line_end)
    return dialect.encoded("".join(lines), is_first=True)


class CameraEmulator:
    """A camera aimed at a bench; its program writes a series into a folder while it runs.

    The program records before the bench begins, by the camera's own clock.
    """

    def __init__(self, folder: Path, name: str, settings: ThermalCsvSettings, regions: dict[str, Callable[[], float]]):
        self._folder, self._name, self._settings, self._regions = folder, name, settings, regions
        self._dialect = TableDialect.of(settings)
        self._period = 1.0 / (settings.time.frame_rate_Hz or FRAME_RATE_HZ)  # s on the camera's clock
        self._file: Path | None = None
        self._frame_count = 0
        self._pending_lines: list[str] = []
        self._write_failed = False

    @property
    def due(self) -> float:
        """Time at which the next frame is taken [s on the clock of the bench]."""
        return self._frame_count * self._period / (1.0 + 1e-6 * CLOCK_FAST_PPM) - LEAD_S

    def tick(self, now: float) -> None:
        """Take the frames up to `now` [s]; write the frames of `BLOCK_S` together."""
        while self.due <= now + 1e-9:
            self._frame_count += 1
            cells = [self._dialect.number(FROM_CELSIUS[self._unit](read())) for read in self._regions.values()]
            self._pending_lines.append(self._dialect.row([self._stamp(), *cells]))
        if len(self._pending_lines) * self._period >= BLOCK_S:
            self._write()

    @property
    def _unit(self) -> str:
        return self._settings.unit or "degC"

    def _stamp(self) -> str:
        """Return the stamp of the present frame, in the form of the settings."""
        elapsed_s = (self._frame_count - 1) * self._period
        time = self._settings.time
        if time.kind == "frame":
            return str(self._frame_count)
        if time.kind == "wall":
            day = datetime.fromisoformat(time.date) if time.date else DAY
            return (day + timedelta(seconds=elapsed_s)).isoformat(" ", "milliseconds")
        return TableDialect(decimal=self._dialect.decimal, decimals=3).number(elapsed_s)

    def _write(self) -> None:
        """Write the pending frames; if the disk fails, the program stops writing and the bench continues without it."""
        text = "".join(self._pending_lines)
        self._pending_lines.clear()
        if self._write_failed:
            return
        try:
            if self._file is None:
                self._file = new_export(self._folder, self._name)
                text = self._head() + text
            with self._file.open("ab") as file:
                file.write(self._dialect.encoded(text, is_first=False))
        except OSError:
            self._write_failed = True

    def _head(self) -> str:
        """Return the line of headings."""
        time_column = self._settings.time.column or "Time"
        time_heading = f"{time_column} (s)" if self._settings.time.kind in (None, "elapsed") else time_column
        columns = [str(region.column) for region in self._settings.regions.values()]
        return heading(columns, self._dialect, self._unit, time_heading)
