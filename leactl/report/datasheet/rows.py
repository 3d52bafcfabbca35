"""The table of a datasheet: a row for each result, condition and actuator, a cell for each set of runs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from leactl.analysis.analyze import names
from leactl.analysis.anova.pooled import difference, over_actuators, widest
from leactl.analysis.estimate import Estimate
from leactl.report.datasheet.runset import GroupResult, RunEntry, RunSet
from leactl.report.terminal import figures_by_condition, paper_figures, units_in_paper

NOT_MEASURED = "not measured"


@dataclass(frozen=True)
class DatasheetCell:
    """The estimate of one result from one set of runs; without an estimate, `lacks` says why."""

    estimate: Estimate | None
    entries: tuple[RunEntry, ...] = ()
    lacks: str = ""
    actuators: tuple[str, ...] = ()  # that it is of
    whose: str = ""  # which those are, where it is compared and the set has others

    @property
    def actuator(self) -> str:
        """Return the actuator's name, or the number of actuators that were pooled; empty where none was measured."""
        return f"{len(self.actuators)} actuators" if len(self.actuators) > 1 else "".join(self.actuators)


@dataclass(frozen=True)
class DatasheetRow:
    """One result under one condition, with a cell for each set of runs."""

    experiment: str
    name: str
    condition: str
    actuator: str  # or how many were pooled
    cells: tuple[DatasheetCell, ...]
    paper: str  # its figure of the LEA; empty where it has none

    @property
    def units(self) -> str:
        """Return the units of the first estimate; those of the paper's figure where there is no estimate."""
        measured = (cell.estimate.units for cell in self.cells if cell.estimate is not None)
        return next(measured, units_in_paper().get(self.name, ""))

    @property
    def difference(self) -> Estimate | None:
        """Return the second set's estimate less the first's; None where either is not known."""
        known = [cell.estimate for cell in self.cells if cell.estimate is not None]
        if len(known) < 2 or not all(math.isfinite(estimate.value) for estimate in known):
            return None
        return difference(known[0], known[1])

    def as_json(self, sets: Sequence[RunSet]) -> dict[str, Any]:
        """Return the row as JSON takes it; what is not known is null."""
        difference = self.difference if len(self.cells) > 1 else None
        row = {
            "experiment": self.experiment,
            "name": self.name,
            "condition": self.condition,
            "actuator": self.actuator,
            "units": self.units,
            "paper": self.paper or None,
            "values": [
                {
                    "set": run_set.name,
                    "runs": [entry.label for entry in cell.entries],
                    "actuators": list(cell.actuators),
                    "lacks": cell.lacks or None,
                }
                | estimate_json(cell.estimate)
                for run_set, cell in zip(sets, self.cells, strict=True)
            ],
        }
        return row | ({"difference": estimate_json(difference)} if len(self.cells) > 1 else {})


def estimate_json(estimate: Estimate | None) -> dict[str, float | None]:
    """Return value, std, low and high of an estimate; all are None without one."""
    row = {} if estimate is None else estimate.as_json()
    return {key: row.get(key) for key in ("value", "std", "low", "high")}


def rows(sets: Sequence[RunSet], motors: Sequence[str], experiment: str) -> list[DatasheetRow]:
    """Return the rows of one experiment; motor k is that of set k.

    One set has a row for each actuator, and a pooled row where several have the result. Two sets have pooled cells
    alone, side by side.
    """
    answers = [run_set.answers_of(motor, experiment) for run_set, motor in zip(sets, motors, strict=True)]
    faulty = [
        [entry for entry in run_set.entries if entry.fault and (entry.motor, entry.experiment) == (motor, experiment)]
        for run_set, motor in zip(sets, motors, strict=True)
    ]
    all_answers = [answer for answers_of_set in answers for answer in answers_of_set]
    table_rows = []
    for name in result_names(experiment, all_answers):
        for condition in conditions(experiment, all_answers, name):
            paper = paper_figures(experiment, condition).get(name, "")
            cells = [
                cells_of(answers_of_set, entries, name, condition)
                for answers_of_set, entries in zip(answers, faulty, strict=True)
            ]
            shown: list[tuple[DatasheetCell, ...]]
            if len(sets) == 1:
                pooled = pooled_cell(cells[0])
                shown = [(cell,) for cell in [*cells[0], *([pooled] if len(pooled.actuators) > 1 else [])]]
            else:
                shown = [
                    tuple(
                        with_actuator_names(pooled_cell(cells_of_set), run_set, motor)
                        for cells_of_set, run_set, motor in zip(cells, sets, motors, strict=True)
                    )
                ]
            table_rows += [DatasheetRow(experiment, name, condition, shared_actuator(row), row, paper) for row in shown]
    return table_rows


def result_names(experiment: str, answers: Sequence[GroupResult]) -> list[str]:
    """Return the names of an experiment's rows: the paper's results, or those with an interval where it has none.

    A part of another result, such as that of one direction alone, is in the list of all results only.
    """
    in_paper = dict.fromkeys(name for paper_row in figures_by_condition(experiment).values() for name in paper_row)
    if in_paper:
        return list(in_paper)
    known: dict[str, None] = {}
    for answer in answers:
        parents: list[str] = []
        for estimate in answer.result.results:
            part = any(estimate.name.startswith(f"{parent}_") for parent in parents)
            parents += [] if part else [estimate.name]
            if not part and not math.isnan(estimate.low):
                known[estimate.name] = None
    return list(known)


def conditions(experiment: str, answers: Sequence[GroupResult], name: str) -> list[str]:
    """Return the conditions of a result, the paper's first in its order; one empty name where there is none."""
    in_paper = [
        label
        for label, paper_values in figures_by_condition(experiment).items()
        if label != "any" and name in paper_values
    ]
    measured = {answer.condition for answer in answers} | set(in_paper)
    return [label for label in ordered_conditions(answers) if label in measured] or [""]


def ordered_conditions(answers: Sequence[GroupResult]) -> list[str]:
    """Return the paper's conditions in its order, then others: the same order for every set of runs."""
    papers = [label for each in names() for label in figures_by_condition(each) if label != "any"]
    return list(dict.fromkeys([*papers, *(answer.condition for answer in answers)]))


def cells_of(
    answers: Sequence[GroupResult], faulty: Sequence[RunEntry], name: str, condition: str
) -> list[DatasheetCell]:
    """Return a cell for each actuator that was measured, or one empty cell where none was."""
    of_condition = [answer for answer in answers if answer.condition == condition]
    estimates = [
        (answer, estimate) for answer in of_condition for estimate in answer.result.results if estimate.name == name
    ]
    if not estimates:
        lost = tuple(entry for entry in faulty if condition in ("", entry.group[1]))
        return [DatasheetCell(None, lost, "not analysed" if lost else NOT_MEASURED)]
    return [DatasheetCell(estimate, answer.entries, actuators=(answer.actuator,)) for answer, estimate in estimates]


def pooled_cell(cells: Sequence[DatasheetCell]) -> DatasheetCell:
    """Pool the cells of several actuators: the mean of their values, or bounds that hold for all where none has one."""
    pairs = [(cell, cell.estimate) for cell in cells if cell.estimate is not None]
    valued = [(cell, estimate) for cell, estimate in pairs if math.isfinite(estimate.value)]
    bounded = [
        (cell, estimate) for cell, estimate in pairs if not (math.isnan(estimate.low) and math.isnan(estimate.high))
    ]
    chosen = valued or bounded or pairs
    if len(chosen) < 2:
        return chosen[0][0] if chosen else cells[0]
    pooled = (over_actuators if valued else widest)([estimate for _, estimate in chosen])
    entries = tuple(entry for cell, _ in chosen for entry in cell.entries)
    return DatasheetCell(pooled, entries, actuators=tuple(name for cell, _ in chosen for name in cell.actuators))


def with_actuator_names(cell: DatasheetCell, run_set: RunSet, motor: str) -> DatasheetCell:
    """Return the cell with its actuators named in `whose` where the set has other actuators too."""
    actuators = {entry.group[0] for entry in run_set.entries if entry.experiment and entry.motor == motor}
    if not cell.actuators or actuators <= set(cell.actuators):
        return cell
    return replace(cell, whose=f"of {', '.join(name or 'one without a name' for name in cell.actuators)} alone")


def shared_actuator(cells: Sequence[DatasheetCell]) -> str:
    """Return the actuator that all cells with an estimate are of; empty where they differ."""
    actuators = dict.fromkeys(cell.actuator for cell in cells if cell.estimate is not None)
    return next(iter(actuators)) if len(actuators) == 1 else ""


def unlisted(sets: Sequence[RunSet], motors: Sequence[str]) -> list[str]:
    """Return the experiments that have neither a run nor a figure in the paper."""
    measured = {
        entry.experiment
        for run_set, motor in zip(sets, motors, strict=True)
        for entry in run_set.entries
        if entry.motor == motor
    }
    return [name for name in names() if name not in measured and not figures_by_condition(name)]
