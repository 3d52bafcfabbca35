"""What a datasheet says: sections by motor, rows of results, runs; as JSON for scripts."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from leactl.analysis.analyze import names
from leactl.errors import InputError
from leactl.report.datasheet.instruments import instruments_of, warnings_of
from leactl.report.datasheet.rows import NOT_MEASURED, DatasheetRow, rows, unlisted
from leactl.report.datasheet.runset import RunSet
from leactl.report.terminal import figures_by_condition

NO_MOTOR = "motor not told"


@dataclass(frozen=True)
class Section:
    """One motor, or two that are compared."""

    motors: tuple[str, ...]  # one for each set
    rows: dict[str, list[DatasheetRow]]  # by experiment, those that were not measured among them
    unlisted: list[str]  # experiments without a run and without a figure in the paper

    @property
    def title(self) -> str:
        """Its motors."""
        return " and ".join(dict.fromkeys(motor or NO_MOTOR for motor in self.motors))


@dataclass(frozen=True)
class Datasheet:
    """One set of runs, or two that are compared."""

    sets: tuple[RunSet, ...]

    @cached_property
    def sections(self) -> list[Section]:
        """A section for each motor; two sets of one motor each are compared even where the motors differ."""
        motors_of_sets = [run_set.motors for run_set in self.sets]
        if all(len(motors) == 1 for motors in motors_of_sets):
            pairs = [tuple(motors[0] for motors in motors_of_sets)]
        else:
            pairs = [
                (motor,) * len(motors_of_sets)
                for motor in dict.fromkeys(motor for motors in motors_of_sets for motor in motors)
            ]
        return [section_of(self.sets, motors) for motors in pairs]

    @property
    def notes(self) -> list[str]:
        """What a reader of the whole must know."""
        notes = []
        motors = list(dict.fromkeys(motor or NO_MOTOR for run_set in self.sets for motor in run_set.motors))
        if len(motors) > 1:
            notes.append(
                f"runs are of {len(motors)} motors: {', '.join(motors)}; figures of one say nothing of another"
            )
        entries = [entry for run_set in self.sets for entry in run_set.entries]
        emulated = sum(entry.simulated for entry in entries)
        if emulated:
            notes.append(
                f"{emulated} of {len(entries)} runs are from an emulated bench: no machine was measured in these"
            )
        faulty = [entry for entry in entries if entry.fault]
        notes += warnings_of(self.sets)
        if faulty:
            notes.append(f"nothing came of {', '.join(entry.label for entry in faulty)}: see the list of runs")
        if len(self.sets) > 1:
            notes.append(
                f"difference: {self.sets[1].name} less {self.sets[0].name}, the two taken as independent; an error that"
                " their instruments have in common is not in a difference, which is then known better than told here"
            )
            notes += [line for section in self.sections for line in without_common_condition(self.sets, section)]
        return notes

    def refuse_empty(self) -> None:
        """Refuse a sheet without a figure.

        Raises
        ------
        InputError : why nothing came of each run, one line each.
        """
        if not any(entry.answers for entry in self.sets):
            raise InputError([f"{entry.path}: {entry.fault}" for run_set in self.sets for entry in run_set.entries])

    def as_json(self) -> dict[str, Any]:
        """The whole table with runs and notes."""
        return {
            "sets": [
                {
                    "name": run_set.name,
                    "runs": [
                        {
                            "label": entry.label,
                            "path": str(entry.path),
                            "motor": entry.motor,
                            "experiment": entry.experiment,
                            "simulated": entry.simulated,
                            **entry.about,
                            "fault": entry.fault or None,
                        }
                        for entry in run_set.entries
                    ],
                    "instruments": [use.as_json() for use in instruments_of(run_set)],
                }
                for run_set in self.sets
            ],
            "sections": [
                {
                    "motors": list(section.motors),
                    "rows": [row.as_json(self.sets) for table_rows in section.rows.values() for row in table_rows],
                    "not_measured": section.unlisted,
                    "verdicts": [
                        {
                            "set": run_set.name,
                            "experiment": experiment,
                            "name": comparison.name,
                            "sentence": comparison.sentence,
                        }
                        for run_set, motor in zip(self.sets, section.motors, strict=True)
                        for (compared_motor, experiment), verdict in run_set.verdicts.items()
                        if compared_motor == motor
                        for comparison in verdict.comparisons
                    ],
                }
                for section in self.sections
            ],
            "notes": self.notes,
        }


def without_common_condition(sets: Sequence[RunSet], section: Section) -> list[str]:
    """Return a line for each experiment that both sets measured, but under no condition in common."""
    lines = []
    for experiment in section.rows:
        measured = [
            dict.fromkeys(answer.condition or "no condition" for answer in run_set.answers_of(motor, experiment))
            for run_set, motor in zip(sets, section.motors, strict=True)
        ]
        if all(measured) and not set.intersection(*map(set, measured)):
            each = " and ".join(
                f"{run_set.name} under {', '.join(conditions)}"
                for run_set, conditions in zip(sets, measured, strict=True)
            )
            lines.append(f"{experiment}: not compared, measured in {each}; `leactl run --condition` names a condition")
    return lines


def section_of(sets: Sequence[RunSet], motors: tuple[str, ...]) -> Section:
    """Rows of every experiment that was measured or that the paper has.

    What is known comes first, then what runs did not tell, then what was not measured; of each the paper's first.
    """
    in_order = sorted(names(), key=lambda name: (not figures_by_condition(name), name))
    by_experiment = {name: sorted(rows(sets, motors, name), key=_unknown) for name in in_order}
    measured = {name: table_rows for name, table_rows in by_experiment.items() if table_rows}
    return Section(
        motors, dict(sorted(measured.items(), key=lambda pair: min(map(_unknown, pair[1])))), unlisted(sets, motors)
    )


def _unknown(row: DatasheetRow) -> int:
    """0 for a row with a figure, 1 for one of whose runs nothing came, 2 for one that was not measured."""
    if any(cell.estimate is not None for cell in row.cells):
        return 0
    return 2 if all(cell.lacks == NOT_MEASURED for cell in row.cells) else 1
