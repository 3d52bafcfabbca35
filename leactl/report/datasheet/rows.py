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
    """What one set of runs says; without an estimate, `lacks` says why."""

    estimate: Estimate | None
    entries: tuple[RunEntry, ...] = ()
    lacks: str = ""
    actuators: tuple[str, ...] = ()  # that it is of
    whose: str = ""  # which those are, where it is compared and the set has others

    @property
    def actuator(self) -> str:
        """The actuator, or how many were put together; empty where none was measured."""
        return f"{len(self.actuators)} actuators" if len(self.actuators) > 1 else "".join(self.actuators)


@dataclass(frozen=True)
class DatasheetRow:
    """One result."""

    experiment: str
    name: str
    condition: str
    actuator: str  # or how many were pooled
    cells: tuple[DatasheetCell, ...]
    paper: str  # its figure of the LEA; empty where it has none

    @property
    def units(self) -> str:
        """Of the first that is known, of the paper's figure where none is."""
        measured = (cell.estimate.units for cell in self.cells if cell.estimate is not None)
        return next(measured, units_in_paper().get(self.name, ""))

    @property
    def difference(self) -> Estimate | None:
        """The second set less the first; None where either is not known."""
        known = [cell.estimate for cell in self.cells if cell.estimate is not None]
        if len(known) < 2 or not all(math.isfinite(estimate.value) for estimate in known):
            return None
        return difference(known[0], known[1])

    def as_json(self, sets: Sequence[RunSet]) -> dict[str, Any]:
        """The row for a script; what is not known is null."""
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
    """Value, std and interval as JSON takes them."""
    row = {} if estimate is None else estimate.as_json()
    return {key: row.get(key) for key in ("value", "std", "low", "high")}


def rows(sets: Sequence[RunSet], motors: Sequence[str], experiment: str) -> list[DatasheetRow]:
    """Rows of one experiment; motor k is that of set k.

    One set has a row for each actuator, and one for all where several know the result; of two sets only what all of
    each know together is side by side.
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
                whole = pooled_cell(cells[0])
                shown = [(cell,) for cell in [*cells[0], *([whole] if len(whole.actuators) > 1 else [])]]
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
    """Results for the table: those that the paper has; of an experiment that it has not, those with an interval.

    A result that is a part of another, such as that of one direction alone, is left to the list of all results.
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
    """Conditions of a result: those of the paper in its order, then others; one without a name where there is none."""
    in_paper = [
        label
        for label, paper_values in figures_by_condition(experiment).items()
        if label != "any" and name in paper_values
    ]
    measured = {answer.condition for answer in answers} | set(in_paper)
    return [label for label in ordered_conditions(answers) if label in measured] or [""]


def ordered_conditions(answers: Sequence[GroupResult]) -> list[str]:
    """Conditions of the paper in its order, then others: the same for every set of runs, however theirs was drawn."""
    papers = [label for each in names() for label in figures_by_condition(each) if label != "any"]
    return list(dict.fromkeys([*papers, *(answer.condition for answer in answers)]))


def cells_of(
    answers: Sequence[GroupResult], faulty: Sequence[RunEntry], name: str, condition: str
) -> list[DatasheetCell]:
    """A cell for each actuator that was measured; an empty one where none was."""
    of_condition = [answer for answer in answers if answer.condition == condition]
    estimates = [
        (answer, estimate) for answer in of_condition for estimate in answer.result.results if estimate.name == name
    ]
    if not estimates:
        lost = tuple(entry for entry in faulty if condition in ("", entry.group[1]))
        return [DatasheetCell(None, lost, "not analysed" if lost else NOT_MEASURED)]
    return [DatasheetCell(estimate, answer.entries, actuators=(answer.actuator,)) for answer, estimate in estimates]


def pooled_cell(cells: Sequence[DatasheetCell]) -> DatasheetCell:
    """What actuators say together: the mean of those that know a value, or else the bounds that hold for all."""
    pairs = [(cell, cell.estimate) for cell in cells if cell.estimate is not None]
    valued = [(cell, known) for cell, known in pairs if math.isfinite(known.value)]
    bounded = [(cell, known) for cell, known in pairs if not (math.isnan(known.low) and math.isnan(known.high))]
    chosen = valued or bounded or pairs
    if len(chosen) < 2:
        return chosen[0][0] if chosen else cells[0]
    estimate = (over_actuators if valued else widest)([known for _, known in chosen])
    entries = tuple(entry for cell, _ in chosen for entry in cell.entries)
    return DatasheetCell(estimate, entries, actuators=tuple(name for cell, _ in chosen for name in cell.actuators))


def with_actuator_names(cell: DatasheetCell, run_set: RunSet, motor: str) -> DatasheetCell:
    """The cell with the names of its actuators where its set has others besides."""
    actuators = {entry.group[0] for entry in run_set.entries if entry.experiment and entry.motor == motor}
    if not cell.actuators or actuators <= set(cell.actuators):
        return cell
    return replace(cell, whose=f"of {', '.join(name or 'one without a name' for name in cell.actuators)} alone")


def shared_actuator(cells: Sequence[DatasheetCell]) -> str:
    """The actuator of a row, where its cells have the same one."""
    actuators = dict.fromkeys(cell.actuator for cell in cells if cell.estimate is not None)
    return next(iter(actuators)) if len(actuators) == 1 else ""


def unlisted(sets: Sequence[RunSet], motors: Sequence[str]) -> list[str]:
    """Experiments without a run and without a figure in the paper."""
    measured = {
        entry.experiment
        for run_set, motor in zip(sets, motors, strict=True)
        for entry in run_set.entries
        if entry.motor == motor
    }
    return [name for name in names() if name not in measured and not figures_by_condition(name)]
