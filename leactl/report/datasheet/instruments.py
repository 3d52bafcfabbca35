"""Instruments that measured the runs of a datasheet, and the runs that were recorded after a calibration was due."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from leactl.report.datasheet.runset import RunEntry, RunSet


@dataclass(frozen=True)
class InstrumentUse:
    """One instrument in one state of calibration, and the runs that it measured."""

    device: str
    facts: tuple[tuple[str, str], ...]  # names and values: model, serial number, firmware, calibration
    entries: tuple[RunEntry, ...]

    @property
    def known_facts(self) -> dict[str, str]:
        """Return model, serial number, firmware and calibration by name, without those that are not known."""
        return dict(self.facts)

    @property
    def overdue(self) -> list[RunEntry]:
        """Return the runs that were recorded after the calibration was due."""
        due_date = self.known_facts.get("calibration_due", "")
        return [entry for entry in self.entries if due_date and entry.about.get("created", "")[:10] > due_date]

    def as_json(self) -> dict[str, Any]:
        """Return the known facts of the instrument and the labels of its runs, as JSON takes them."""
        runs = {"runs": [entry.label for entry in self.entries], "overdue": [entry.label for entry in self.overdue]}
        return {"device": self.device, **self.known_facts, **runs}


def instruments_of(run_set: RunSet) -> list[InstrumentUse]:
    """Return the instruments of a set of runs, one entry for each state of calibration, sorted by device."""
    entries_by_use: dict[tuple[str, tuple[tuple[str, str], ...]], list[RunEntry]] = {}
    for entry in run_set.entries:
        for device, facts in entry.instruments.items():
            entries_by_use.setdefault((device, tuple(facts.items())), []).append(entry)
    return [
        InstrumentUse(*use, tuple(entries)) for use, entries in sorted(entries_by_use.items(), key=lambda pair: pair[0])
    ]


def warnings_of(sets: Sequence[RunSet]) -> list[str]:
    """Return a line for each instrument whose calibration was overdue when runs were recorded."""
    return [
        f"{use.device}: calibration was due {use.known_facts['calibration_due']}, before"
        f" {', '.join(entry.label for entry in use.overdue)}"
        for run_set in sets
        for use in instruments_of(run_set)
        if use.overdue
    ]
