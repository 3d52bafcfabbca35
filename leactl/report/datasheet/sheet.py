"""The contents of a datasheet: sections by motor with rows of results, notes on the whole, and both as JSON."""

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

NO_MOTOR = "motor not named"


@dataclass(frozen=True)
class Section:
    """The rows of one motor, or of two that are compared."""

    motors: tuple[str, ...]  # one for each set
    rows: dict[str, list[DatasheetRow]]  # by experiment; also of experiments that the paper has and no run measured
    unlisted: list[str]  # experiments without a run and without a figure in the paper

    @property
    def title(self) -> str:
        """Return the distinct names of the motors of the section."""
        return " and ".join(dict.fromkeys(motor or NO_MOTOR for motor in self.motors))


@dataclass(frozen=True)
class Datasheet:
    """One set of runs, or two that are compared."""

    sets: tuple[RunSet, ...]

    @cached_property
    def sections(self) -> list[Section]:
        """Return a section for each motor; two sets with one motor each share one section even if the motors differ."""
        motors_of_sets = [run_set.motors for run_set in self.sets]
        if all(len(motors) == 1 for motors in motors_of_sets):
            motors_of_sections = [tuple(motors[0] for motors in motors_of_sets)]
        else:
            motors_of_sections = [
                (motor,) * len(motors_of_sets)
                for motor in dict.fromkeys(motor for motors in motors_of_sets for motor in motors)
            ]
        return [section_of(self.sets, motors) for motors in motors_of_sections]

    @property
    def notes(self) -> list[str]:
        """Return notes on the whole sheet: motors, emulated runs, late calibrations, runs not analysed, differences."""
        notes = []
        motors = list(dict.fromkeys(motor or NO_MOTOR for run_set in self.sets for motor in run_set.motors))
        if len(motors) > 1:
            notes.append(
                f"runs are of {len(motors)} motors: {', '.join(motors)}; figures of one say nothing of another"
            )
        entries = [entry for run_set in self.sets for entry in run_set.entries]
        emulated_count = sum(entry.simulated for entry in entries)
        if emulated_count:
            notes.append(
                f"{emulated_count} of {len(entries)} runs are from an emulated bench: no machine was measured in these"
            )
        faulty_entries = [entry for entry in entries if entry.fault]
        notes += warnings_of(self.sets)
        if faulty_entries:
            notes.append(f"nothing came of {', '.join(entry.label for entry in faulty_entries)}: see the list of runs")
        if len(self.sets) > 1:
            notes.append(
                f"difference: {self.sets[1].name} less {self.sets[0].name}, the two taken as independent; an error that"
                " their instruments have in common is not in a difference, which is then known better than told here"
            )
            notes += [line for section in self.sections for line in without_common_condition(self.sets, section)]
        return notes

    def refuse_empty(self) -> None:
        """Raise if no run of the sheet was analysed.

        Raises
        ------
        InputError : no run was analysed; a line for each run says why.
        """
        if not any(run_set.results for run_set in self.sets):
            raise InputError([f"{entry.path}: {entry.fault}" for run_set in self.sets for entry in run_set.entries])

    def as_json(self) -> dict[str, Any]:
        """Return runs, instruments, rows, verdicts and notes as JSON takes them."""
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
    """Return a note on each experiment that both sets measured, but under different conditions alone."""
    lines = []
    for experiment in section.rows:
        conditions_by_set = [
            dict.fromkeys(group.condition or "no condition" for group in run_set.results_of(motor, experiment))
            for run_set, motor in zip(sets, section.motors, strict=True)
        ]
        if all(conditions_by_set) and not set.intersection(*map(set, conditions_by_set)):
            sets_text = " and ".join(
                f"{run_set.name} under {', '.join(conditions)}"
                for run_set, conditions in zip(sets, conditions_by_set, strict=True)
            )
            lines.append(
                f"{experiment}: not compared, measured in {sets_text}; `leactl run --condition` names a condition"
            )
    return lines


def section_of(sets: Sequence[RunSet], motors: tuple[str, ...]) -> Section:
    """Return the section with the rows of every experiment that was measured or that the paper has.

    Experiments with an estimate come first, then those whose runs could not be analysed, then those not measured. In
    each of these parts, experiments of the paper come first.
    """
    experiments = sorted(names(), key=lambda name: (not figures_by_condition(name), name))
    rows_by_experiment = {name: sorted(rows(sets, motors, name), key=_missing_rank) for name in experiments}
    present_rows = {name: table_rows for name, table_rows in rows_by_experiment.items() if table_rows}
    ranked_rows = sorted(present_rows.items(), key=lambda item: min(map(_missing_rank, item[1])))
    return Section(motors, dict(ranked_rows), unlisted(sets, motors))


def _missing_rank(row: DatasheetRow) -> int:
    """Return 0 for a row with an estimate, 1 where no run could be analysed, 2 where nothing was measured."""
    if any(cell.estimate is not None for cell in row.cells):
        return 0
    return 2 if all(cell.lacks == NOT_MEASURED for cell in row.cells) else 1
