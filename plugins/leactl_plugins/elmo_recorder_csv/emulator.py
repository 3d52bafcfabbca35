"""Emulator of the drive's recorder: it samples at a fixed interval and saves a text file when its buffer is full."""

import math
from pathlib import Path

from leactl.driver.far_end import Machine
from leactl.errors import InputError
from leactl.tables.writing import TableDialect, new_export
from leactl_plugins.elmo_recorder_csv.settings import CURRENTS, ElmoRecorderCsvSettings, RecordedSignal

BUFFER_SAMPLES = 16384  # of all signals together (recorder of the Gold line, by the notes of an open client)
INTERVAL_S = 1e-3  # between samples, if the settings state none
TRIGGER_S = 0.5  # time at which the recording starts
MACHINE_QUANTITIES = ("q_axis_current", "velocity", "angle", "bus_voltage")
UNITS = {"q_axis_current": "A", "velocity": "cnt/sec", "angle": "cnt", "bus_voltage": "V"}


class RecorderEmulator:
    """Recorder that fills its buffer once, and the tool that saves it."""

    def __init__(self, folder: Path, name: str, settings: ElmoRecorderCsvSettings, machine: Machine) -> None:
        if unknown_quantities := [
            signal.quantity for signal in settings.signals.values() if signal.quantity not in MACHINE_QUANTITIES
        ]:
            known_quantities = ", ".join(MACHINE_QUANTITIES)
            raise InputError(
                f"signals: an emulated recorder has no {', '.join(unknown_quantities)}; it has {known_quantities}"
            )
        self._folder, self._name, self._settings, self._machine = folder, name, settings, machine
        self._interval = settings.interval_s or INTERVAL_S
        self._buffer_rows = BUFFER_SAMPLES // len(settings.signals)
        self._dialect = TableDialect.of(settings, decimals=6)
        self._rows: list[list[float]] = []
        self._started_at = TRIGGER_S
        self._is_saved = False

    @property
    def due(self) -> float:
        """Time of the next sample [s]."""
        return math.inf if self._is_saved else self._started_at + len(self._rows) * self._interval

    def tick(self, now: float) -> None:
        """Take a sample; save the buffer if it is full."""
        if self._is_saved or now < self.due - 1e-9:
            return
        if not self._rows:
            self._started_at = now
        readings = dict(zip(MACHINE_QUANTITIES, (*self._machine.read(), self._machine.bus_voltage), strict=True))
        signals = self._settings.signals.values()
        self._rows.append([self._recorded_value(signal, readings[signal.quantity]) for signal in signals])
        if len(self._rows) == self._buffer_rows:
            self._save()

    def _recorded_value(self, signal: RecordedSignal, value: float) -> float:
        """Return a value of the machine in the drive's unit, convention and sign."""
        settings = self._settings
        if signal.quantity == "bus_voltage":
            return value
        if signal.quantity in CURRENTS:
            return settings.sign * value / settings.current_convention.to_q_axis
        return settings.sign * value * (settings.counts_per_turn or 1) / (2.0 * math.pi)

    def _save(self) -> None:
        """Write the recording to a new file."""
        settings, dialect = self._settings, self._dialect
        signal_headings = [f"{signal.column} [{UNITS[signal.quantity]}]" for signal in settings.signals.values()]
        time_headings = [f"{settings.time_column} [s]"] if settings.time_column else []
        lines = [dialect.row([*time_headings, *signal_headings])]
        for k, row in enumerate(self._rows):
            stamp = [dialect.number(k * self._interval)] if time_headings else []
            lines.append(dialect.row([*stamp, *(dialect.number(value) for value in row)]))
        new_export(self._folder, self._name).write_bytes(dialect.encoded("".join(lines), is_first=True))
        self._is_saved = True
