"""Recordings of an Elmo drive's internal recorder, read from the text files that the maker's tool saves.

The drive samples faster than its bus can transfer. A recording is attached to the run afterwards; the clocks are
aligned by a common signal, since the recorder's clock begins with the recording and has no time of day.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from leactl.driver.clock import Clock
from leactl.driver.contract import Confirmation, Driver
from leactl.driver.far_end import BuslessEmulator, Physics
from leactl.driver.file_records import Array, ExportFolder, FileRecord, RecordClock
from leactl.errors import InputError
from leactl.quantities import ChannelSpec
from leactl.tables.number_format import Numbers, read_numbers
from leactl.tables.row_order import order_rows
from leactl.tables.text_table import Table, common_unit, read_table, unit_of
from leactl.units import CONVERSIONS, SECONDS, converter
from leactl_plugins.elmo.scales import CountedPosition
from leactl_plugins.elmo_recorder_csv.settings import CURRENTS, ElmoRecorderCsvSettings, RecordedSignal

SECONDS_NAMED = {**SECONDS, "sec": 1.0, "seconds": 1.0, "msec": 1e-3, "usec": 1e-6, "µs": 1e-6}
INTERVAL_TOLERANCE = 0.01  # range of the intervals over their median; a recorder samples by a timer


class ElmoRecorderCsv(Driver):
    """One drive whose recordings are saved as text."""

    Settings = ElmoRecorderCsvSettings
    transport = "none"
    summary = "recordings of Elmo drives by the text files that the maker's tool saves"
    example: ClassVar[Mapping[str, Any]] = {
        "signals": {
            "current": {"column": "Active Current", "quantity": "q_axis_current"},
            "velocity": {"column": "Velocity", "quantity": "velocity"},
            "angle": {"column": "Position", "quantity": "angle"},
        },
        "time_column": "Time",
        "counts_per_turn": 40000,
    }

    def __init__(self, name: str, role: str, settings: ElmoRecorderCsvSettings, port: Any, clock: Clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        self.exports = ExportFolder(settings.exports_folder)

    def safe_state(self, deadline_s: float) -> Confirmation:
        """Confirm at once: files move nothing."""
        return Confirmation(True, "reads files only")

    def open(self) -> None:
        """Remember the present files, so that later ones are known to belong to the run."""
        self.exports.look()

    def close(self) -> None:
        """Do nothing: no file stays open."""

    @classmethod
    def far_end(cls, settings: ElmoRecorderCsvSettings, role: str, physics: Physics) -> BuslessEmulator:
        """A recorder inside the emulated drive of this role.

        Raises
        ------
        InputError : no folder is set that its tool could save to.
        """
        from leactl_plugins.elmo_recorder_csv.emulator import RecorderEmulator

        if settings.exports_folder is None:
            raise InputError("exports_folder: an emulated recorder needs a folder that its tool saves to")
        return RecorderEmulator(Path(settings.exports_folder), f"recorder-{role}", settings, physics.machine(role))

    @property
    def clock(self) -> RecordClock | None:
        """How the recorder's clock is aligned with that of a run."""
        return self.settings.clock

    @property
    def channels(self) -> tuple[ChannelSpec, ...]:
        """One channel for each signal; its location distinguishes it from the same quantity over the bus."""
        return tuple(
            ChannelSpec(name, signal.quantity, self.role, self.name, signal.column, "recorder", dtype="f8")
            for name, signal in self.settings.signals.items()
        )

    def read_files(self, paths: Sequence[Path]) -> FileRecord:
        """Read one recording.

        Raises
        ------
        InputError : a file that cannot be read, or that has two readings.
        """
        if len(paths) != 1:
            raise InputError(f"{len(paths)} files; a recording is one file, attach them one by one")
        settings = self.settings
        timed = [settings.time_column] if settings.time_column else []
        headings = [*timed, *(signal.column for signal in settings.signals.values())]
        table = read_table(paths[0], settings, headings, every_row=not timed)
        headings_by_signal = {name: table.heading(signal.column) for name, signal in settings.signals.items()}
        time_heading = table.heading(settings.time_column) if settings.time_column else ""
        columns = {
            heading: table.column(heading)
            for heading in dict.fromkeys([*filter(None, [time_heading]), *headings_by_signal.values()])
        }
        numbers, convention = read_numbers(columns, settings, table.place, {})
        time, time_remark = self._time(table, numbers.get(time_heading), time_heading)
        wrap_remarks: list[str] = []
        values = np.stack(
            [
                self._convert(table, headings_by_signal[name], signal, numbers, wrap_remarks)
                for name, signal in settings.signals.items()
            ],
            axis=1,
        )

        def where(row: int) -> str:
            return table.place(time_heading or next(iter(headings_by_signal.values())), row)

        rows = order_rows(time, values, where)
        empty = [name for name, column in zip(headings_by_signal, rows.values.T, strict=True) if np.isnan(column).all()]
        if empty:
            raise InputError(f"{paths[0]}: no number at all in {', '.join(empty)}")
        interval = float(np.median(np.diff(rows.time))) if len(rows.time) > 1 else 0.0
        read_as = [
            f"{headings_by_signal[name]} as {self._unit(table, headings_by_signal[name], signal)}"
            for name, signal in settings.signals.items()
        ]
        remarks = (*table.remarks, str(convention), *read_as, *wrap_remarks, time_remark, *rows.remarks)
        return FileRecord(
            self.name, self.channels, rows.time - rows.time[0], rows.values, None, interval, remarks, tuple(paths)
        )

    def _time(self, table: Table, stamps: Numbers | None, heading: str) -> tuple[Array, str]:
        settings = self.settings
        if stamps is None:
            interval = settings.interval_s or math.nan
            return interval * np.arange(len(table.rows), dtype=np.float64), f"one row each {interval:g} s, as set"
        named = common_unit(heading, stamps.units, f"{table.path}: {heading!r}")
        units = settings.time_units or (named if named in SECONDS_NAMED else None)
        if units is None:
            raise InputError(f"{table.path}: {heading!r} names no unit of time; time_units decides")
        if settings.time_units and named in SECONDS_NAMED and SECONDS_NAMED[named] != SECONDS_NAMED[units]:
            raise InputError(f"{table.path}: {heading!r} is in {named}; time_units says {units}")
        time = stamps.values * SECONDS_NAMED[units]
        steps = np.diff(time)
        if len(steps) and float(np.ptp(steps)) > INTERVAL_TOLERANCE * float(np.median(steps)):
            return time, f"stamps in {units}, UNEVEN: {steps.min():.6g} to {steps.max():.6g} s apart"
        return time, f"stamps in {units}"

    def _unit(self, table: Table, heading: str, signal: RecordedSignal) -> str:
        named = unit_of(heading)
        if signal.units is not None:
            if (
                named
                and (signal.takes(named) or any(named in units for units in CONVERSIONS.values()))
                and named != signal.units
                and not {named, signal.units} <= {*signal.counted}
            ):
                raise InputError(f"{table.path}: {heading!r} is in {named}; units say {signal.units}")
            return signal.units
        if not named:
            raise InputError(f"{table.path}: {heading!r} names no unit; units of the signal decide")
        if not signal.takes(named):
            raise InputError(f"{table.path}: {heading!r} is in {named!r}, which does not measure {signal.quantity}")
        return named

    def _convert(
        self,
        table: Table,
        heading: str,
        signal: RecordedSignal,
        numbers_by_heading: dict[str, Numbers],
        wrap_remarks: list[str],
    ) -> Array:
        numbers, units, settings = numbers_by_heading[heading], self._unit(table, heading, signal), self.settings
        if numbers.over_range:
            raise InputError(
                f"{table.path}: {heading!r} holds {next(iter(numbers.over_range))!r}; a number was expected"
            )
        in_cells = [text for text in numbers.units if text]
        if in_cells and in_cells != [units]:
            raise InputError(f"{table.path}: {heading!r} holds numbers in {', '.join(in_cells)}; {units} was expected")
        values = numbers.values
        if units in signal.counted:
            if settings.counts_per_turn is None:
                raise InputError(f"{table.path}: {heading!r} is in {units}; counts_per_turn is needed")
            if signal.quantity.removesuffix("_reference") == "angle":
                values = self._unwrap(table, heading, values, wrap_remarks)
            return settings.sign * values * (2.0 * math.pi / settings.counts_per_turn)
        conversion = converter(units, signal.quantity)
        assert conversion is not None
        values = conversion.factor * (values - conversion.zero)
        if signal.quantity in CURRENTS:
            values = values * settings.current_convention.to_q_axis
        signed: Array = values if signal.quantity == "bus_voltage" else settings.sign * values
        return signed

    def _unwrap(self, table: Table, heading: str, counts: Array, wrap_remarks: list[str]) -> Array:
        """Counts that continue where the drive's own counts wrap at the end of its range.

        Raises
        ------
        InputError : counts beyond the range.
        """
        if self.settings.position_range is None:
            return counts
        low, high = self.settings.position_range
        beyond = np.flatnonzero((counts < low) | (counts > high))
        if len(beyond):
            raise InputError(
                f"{table.place(heading, int(beyond[0]))}: {counts[beyond[0]]:.0f} counts; the drive's position_range"
                f" ends at {low} and {high}: give that of its object 0x607B, or null where it does not wrap"
            )
        position = CountedPosition(low, high)
        shifts = np.zeros(len(counts))
        shift, wraps = 0, []
        for row in np.flatnonzero(np.isfinite(counts)):
            shown = round(counts[row])
            position.counts = position.nearest(shown)
            if position.counts - shown != shift:
                shift = position.counts - shown
                wraps.append(int(row))
            shifts[row] = shift
        if wraps:
            wrap_remarks.append(
                f"{heading} wraps {len(wraps)} times at the end of {low} to {high} counts, first at"
                f" {table.place(heading, wraps[0])}: unwrapped"
            )
        unwrapped: Array = counts + shifts
        return unwrapped
