"""What measured the runs of a datasheet: each instrument once, with its runs and those that came after it was due."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from leactl.report.datasheet.runset import RunEntry, RunSet


@dataclass(frozen=True)
class InstrumentUse:
    """One instrument as runs know it."""

    device: str
    facts: tuple[tuple[str, str], ...]
    entries: tuple[RunEntry, ...]

    @property
    def known(self) -> dict[str, str]:
        """Model, serial number, firmware and calibration, each where it is known."""
        return dict(self.facts)

    @property
    def overdue(self) -> list[RunEntry]:
        """Runs that were recorded after its calibration was due."""
        due = self.known.get("calibration_due", "")
        return [entry for entry in self.entries if due and entry.about.get("created", "")[:10] > due]

    def as_json(self) -> dict[str, Any]:
        """What is known of it, and its runs by their labels."""
        runs = {"runs": [entry.label for entry in self.entries], "overdue": [entry.label for entry in self.overdue]}
        return {"device": self.device, **self.known, **runs}


def instruments_of(run_set: RunSet) -> list[InstrumentUse]:
    """The instruments of a set of runs; one that was changed or calibrated between runs stands once for each state."""
    used: dict[tuple[str, tuple[tuple[str, str], ...]], list[RunEntry]] = {}
    for entry in run_set.entries:
        for device, facts in entry.instruments.items():
            used.setdefault((device, tuple(facts.items())), []).append(entry)
    return [InstrumentUse(*key, tuple(entries)) for key, entries in sorted(used.items(), key=lambda pair: pair[0])]


def warnings_of(sets: Sequence[RunSet]) -> list[str]:
    """A line for each instrument whose calibration had run out when runs were recorded."""
    return [
        f"{use.device}: calibration was due {use.known['calibration_due']}, before"
        f" {', '.join(entry.label for entry in use.overdue)}"
        for run_set in sets
        for use in instruments_of(run_set)
        if use.overdue
    ]
