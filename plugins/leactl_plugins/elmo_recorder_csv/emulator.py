"""Emulator of the drive's recorder: it samples at a fixed interval and saves a text file when its buffer is full."""

import math
from pathlib import Path

from leactl.driver.far_end import Machine
from leactl.errors import InputError
from leactl.tables.writing import TableDialect, new_export
from leactl_plugins.elmo_recorder_csv.settings import CURRENTS, ElmoRecorderCsvSettings, RecordedSignal

BUFFER_SAMPLES = 16384  # samples of all signals together (recorder of the Gold line, by an open client's notes)
INTERVAL_S = 1e-3
TRIGGER_S = 0.5  # time of the trigger
MACHINE_QUANTITIES = ("q_axis_current", "velocity", "angle", "bus_voltage")
UNITS = {"q_axis_current": "A", "velocity": "cnt/sec", "angle": "cnt", "bus_voltage": "V"}


class RecorderEmulator:
    """A recorder that fills its buffer once, with the tool that saves it."""

    def __init__(self, folder: Path, name: str, settings: ElmoRecorderCsvSettings, machine: Machine) -> None:
        if unknown := [s.quantity for s in settings.signals.values() if s.quantity not in MACHINE_QUANTITIES]:
            known = ", ".join(MACHINE_QUANTITIES)
            raise InputError(f"signals: an emulated recorder has no {', '.join(unknown)}; it has {known}")
        self._folder, self._name, self._settings, self._machine = folder, name, settings, machine
        self._interval = settings.interval_s or INTERVAL_S
        self._samples = BUFFER_SAMPLES // len(settings.signals)
        self._dialect = TableDialect.of(settings, decimals=6)
        self._rows: list[list[float]] = []
        self._starts = TRIGGER_S
        self._saved = False

    @property
    def due(self) -> float:
        """Time of the next sample [s]."""
        return math.inf if self._saved else self._starts + len(self._rows) * self._interval

    def tick(self, now: float) -> None:
        """Take a sample; save the buffer if it is full."""
        if self._saved or now < self.due - 1e-9:
            return
        if not self._rows:
            self._starts = now
        reads = dict(zip(MACHINE_QUANTITIES, (*self._machine.read(), self._machine.bus_voltage), strict=True))
        signals = self._settings.signals.values()
        self._rows.append([self._recorded_value(signal, reads[signal.quantity]) for signal in signals])
        if len(self._rows) == self._samples:
            self._save()

    def _recorded_value(self, signal: RecordedSignal, value: float) -> float:
        settings = self._settings
        if signal.quantity == "bus_voltage":
            return value
        if signal.quantity in CURRENTS:
            return settings.sign * value / settings.current_convention.to_q_axis
        return settings.sign * value * (settings.counts_per_turn or 1) / (2.0 * math.pi)

    def _save(self) -> None:
        settings, dialect = self._settings, self._dialect
        named = [f"{signal.column} [{UNITS[signal.quantity]}]" for signal in settings.signals.values()]
        timed = [f"{settings.time_column} [s]"] if settings.time_column else []
        lines = [dialect.row([*timed, *named])]
        for k, row in enumerate(self._rows):
            stamp = [dialect.number(k * self._interval)] if timed else []
            lines.append(dialect.row([*stamp, *(dialect.number(value) for value in row)]))
        new_export(self._folder, self._name).write_bytes(dialect.encoded("".join(lines), is_first=True))
        self._saved = True
