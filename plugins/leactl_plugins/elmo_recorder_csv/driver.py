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

SECONDS_BY_UNIT = {**SECONDS, "sec": 1.0, "seconds": 1.0, "msec": 1e-3, "usec": 1e-6, "µs": 1e-6}
INTERVAL_TOLERANCE = 0.01  # largest range of the intervals over their median; a recorder samples by a timer


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
        """Return an emulated recorder inside the drive of this role.

        Raises
        ------
        InputError : no folder is set to which its tool could save.
        """
        from leactl_plugins.elmo_recorder_csv.emulator import RecorderEmulator

        if settings.exports_folder is None:
            raise InputError("exports_folder: an emulated recorder needs a folder that its tool saves to")
        return RecorderEmulator(Path(settings.exports_folder), f"recorder-{role}", settings, physics.machine(role))

    @property
    def clock(self) -> RecordClock | None:
        """Alignment of the recorder's clock with that of a run."""
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
        InputError : there are several files, or the file cannot be read, is ambiguous, or lacks a signal's numbers.
        """
        if len(paths) != 1:
            raise InputError(f"{len(paths)} files; a recording is one file, attach them one by one")
        settings = self.settings
        time_headings = [settings.time_column] if settings.time_column else []
        headings = [*time_headings, *(signal.column for signal in settings.signals.values())]
        table = read_table(paths[0], settings, headings, every_row=not time_headings)
        headings_by_signal = {name: table.heading(signal.column) for name, signal in settings.signals.items()}
        time_heading = table.heading(settings.time_column) if settings.time_column else ""
        columns = {
            heading: table.column(heading)
            for heading in dict.fromkeys([*filter(None, [time_heading]), *headings_by_signal.values()])
        }
        numbers_by_heading, number_format = read_numbers(columns, settings, table.location, {})
        time, time_remark = self._row_times(table, numbers_by_heading.get(time_heading), time_heading)
        wrap_remarks: list[str] = []
        values = np.stack(
            [
                self._convert(table, headings_by_signal[name], signal, numbers_by_heading, wrap_remarks)
                for name, signal in settings.signals.items()
            ],
            axis=1,
        )

        def where(row: int) -> str:
            return table.location(time_heading or next(iter(headings_by_signal.values())), row)

        ordered = order_rows(time, values, where)
        empty_signals = [
            name for name, column in zip(headings_by_signal, ordered.values.T, strict=True) if np.isnan(column).all()
        ]
        if empty_signals:
            raise InputError(f"{paths[0]}: no number at all in {', '.join(empty_signals)}")
        interval = float(np.median(np.diff(ordered.time))) if len(ordered.time) > 1 else 0.0
        unit_remarks = [
            f"{headings_by_signal[name]} as {self._unit_of(table, headings_by_signal[name], signal)}"
            for name, signal in settings.signals.items()
        ]
        remarks = (*table.remarks, str(number_format), *unit_remarks, *wrap_remarks, time_remark, *ordered.remarks)
        return FileRecord(
            self.name,
            self.channels,
            ordered.time - ordered.time[0],
            ordered.values,
            None,
            interval,
            remarks,
            tuple(paths),
        )

    def _row_times(self, table: Table, stamps: Numbers | None, heading: str) -> tuple[Array, str]:
        """Return the times of the rows [s], and a remark on them; raise InputError if their unit is not clear."""
        settings = self.settings
        if stamps is None:
            interval = settings.interval_s or math.nan
            return interval * np.arange(len(table.rows), dtype=np.float64), f"one row each {interval:g} s, as set"
        stated_unit = common_unit(heading, stamps.units, f"{table.path}: {heading!r}")
        units = settings.time_units or (stated_unit if stated_unit in SECONDS_BY_UNIT else None)
        if units is None:
            raise InputError(f"{table.path}: {heading!r} names no unit of time; time_units decides")
        if (
            settings.time_units
            and stated_unit in SECONDS_BY_UNIT
            and SECONDS_BY_UNIT[stated_unit] != SECONDS_BY_UNIT[units]
        ):
            raise InputError(f"{table.path}: {heading!r} is in {stated_unit}; time_units says {units}")
        time = stamps.values * SECONDS_BY_UNIT[units]
        steps = np.diff(time)
        if len(steps) and float(np.ptp(steps)) > INTERVAL_TOLERANCE * float(np.median(steps)):
            return time, f"stamps in {units}, UNEVEN: {steps.min():.6g} to {steps.max():.6g} s apart"
        return time, f"stamps in {units}"

    def _unit_of(self, table: Table, heading: str, signal: RecordedSignal) -> str:
        """Return the unit of a signal's column; raise InputError if it is not clear or is not one of its quantity."""
        stated_unit = unit_of(heading)
        if signal.units is not None:
            if (
                stated_unit
                and (signal.takes(stated_unit) or any(stated_unit in units for units in CONVERSIONS.values()))
                and stated_unit != signal.units
                and not {stated_unit, signal.units} <= {*signal.counted}
            ):
                raise InputError(f"{table.path}: {heading!r} is in {stated_unit}; units say {signal.units}")
            return signal.units
        if not stated_unit:
            raise InputError(f"{table.path}: {heading!r} names no unit; units of the signal decide")
        if not signal.takes(stated_unit):
            raise InputError(
                f"{table.path}: {heading!r} is in {stated_unit!r}, which does not measure {signal.quantity}"
            )
        return stated_unit

    def _convert(
        self,
        table: Table,
        heading: str,
        signal: RecordedSignal,
        numbers_by_heading: dict[str, Numbers],
        wrap_remarks: list[str],
    ) -> Array:
        """Return a signal's column in its SI unit, with the sign of the settings; raise InputError if it is invalid."""
        numbers, units, settings = numbers_by_heading[heading], self._unit_of(table, heading, signal), self.settings
        if numbers.over_range:
            raise InputError(
                f"{table.path}: {heading!r} holds {next(iter(numbers.over_range))!r}; a number was expected"
            )
        cell_units = [text for text in numbers.units if text]
        if cell_units and cell_units != [units]:
            raise InputError(
                f"{table.path}: {heading!r} holds numbers in {', '.join(cell_units)}; {units} was expected"
            )
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
        signed_values: Array = values if signal.quantity == "bus_voltage" else settings.sign * values
        return signed_values

    def _unwrap(self, table: Table, heading: str, counts: Array, wrap_remarks: list[str]) -> Array:
        """Return counts that continue where the drive's own counts wrap at the end of its range.

        Raises
        ------
        InputError : there are counts beyond the range.
        """
        if self.settings.position_range is None:
            return counts
        low, high = self.settings.position_range
        rows_beyond = np.flatnonzero((counts < low) | (counts > high))
        if len(rows_beyond):
            raise InputError(
                f"{table.location(heading, int(rows_beyond[0]))}: {counts[rows_beyond[0]]:.0f} counts; the"
                f" drive's position_range ends at {low} and {high}: give that of its object 0x607B, or null"
                " where it does not wrap"
            )
        position = CountedPosition(low, high)
        shifts = np.zeros(len(counts))
        shift, wrapped_rows = 0, []
        for row in np.flatnonzero(np.isfinite(counts)):
            recorded_counts = round(counts[row])
            position.counts = position.nearest(recorded_counts)
            if position.counts - recorded_counts != shift:
                shift = position.counts - recorded_counts
                wrapped_rows.append(int(row))
            shifts[row] = shift
        if wrapped_rows:
            wrap_remarks.append(
                f"{heading} wraps {len(wrapped_rows)} times at the end of {low} to {high} counts, first at"
                f" {table.location(heading, wrapped_rows[0])}: unwrapped"
            )
        unwrapped: Array = counts + shifts
        return unwrapped
