"""Rows of a datasheet: one for each result, condition and actuator, with a cell for each set of runs."""

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
    actuators: tuple[str, ...] = ()  # whose results the estimate pools
    whose: str = ""  # text with the names of these actuators if the set has others too; else empty

    @property
    def actuator(self) -> str:
        """Return the name of the actuator, or the number of pooled actuators as text; empty without an estimate."""
        return f"{len(self.actuators)} actuators" if len(self.actuators) > 1 else "".join(self.actuators)


@dataclass(frozen=True)
class DatasheetRow:
    """One result under one condition, with a cell for each set of runs."""

    experiment: str
    name: str
    condition: str
    actuator: str  # its name, or the number of pooled actuators as text
    cells: tuple[DatasheetCell, ...]
    paper: str  # figure of the paper for the LEA; empty where the paper has none

    @property
    def units(self) -> str:
        """Return the units of the first estimate, or else those of the paper's figure."""
        measured_units = (cell.estimate.units for cell in self.cells if cell.estimate is not None)
        return next(measured_units, units_in_paper().get(self.name, ""))

    @property
    def difference(self) -> Estimate | None:
        """Return the estimate of the second set minus that of the first; None unless both are known."""
        estimates = [cell.estimate for cell in self.cells if cell.estimate is not None]
        if len(estimates) < 2 or not all(math.isfinite(estimate.value) for estimate in estimates):
            return None
        return difference(estimates[0], estimates[1])

    def as_json(self, sets: Sequence[RunSet]) -> dict[str, Any]:
        """Return the row as JSON takes it; unknown values are null."""
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
    """Return value, std, low and high of an estimate; all are None without an estimate."""
    estimate_fields = {} if estimate is None else estimate.as_json()
    return {key: estimate_fields.get(key) for key in ("value", "std", "low", "high")}


def rows(sets: Sequence[RunSet], motors: Sequence[str], experiment: str) -> list[DatasheetRow]:
    """Return the rows of one experiment.

    With one set, a result has a row for each actuator, and a pooled row where several actuators have it. With two sets,
    a result has one row with the pooled cell of each set.

    Parameters
    ----------
    motors : the motor of each set.
    """
    results_by_set = [run_set.results_of(motor, experiment) for run_set, motor in zip(sets, motors, strict=True)]
    faulty_entries_by_set = [
        [entry for entry in run_set.entries if entry.fault and (entry.motor, entry.experiment) == (motor, experiment)]
        for run_set, motor in zip(sets, motors, strict=True)
    ]
    all_results = [group for results in results_by_set for group in results]
    table_rows = []
    for name in result_names(experiment, all_results):
        for condition in conditions(experiment, all_results, name):
            paper = paper_figures(experiment, condition).get(name, "")
            cells_by_set = [
                cells_of(results, faulty_entries, name, condition)
                for results, faulty_entries in zip(results_by_set, faulty_entries_by_set, strict=True)
            ]
            cells_of_rows: list[tuple[DatasheetCell, ...]]
            if len(sets) == 1:
                pooled_over_actuators = pooled_cell(cells_by_set[0])
                cells_of_rows = [
                    (cell,)
                    for cell in [
                        *cells_by_set[0],
                        *([pooled_over_actuators] if len(pooled_over_actuators.actuators) > 1 else []),
                    ]
                ]
            else:
                cells_of_rows = [
                    tuple(
                        with_actuator_names(pooled_cell(cells), run_set, motor)
                        for cells, run_set, motor in zip(cells_by_set, sets, motors, strict=True)
                    )
                ]
            table_rows += [
                DatasheetRow(experiment, name, condition, shared_actuator(cells), cells, paper)
                for cells in cells_of_rows
            ]
    return table_rows


def result_names(experiment: str, results: Sequence[GroupResult]) -> list[str]:
    """Return the names of the results of an experiment that have rows.

    These are the results of the paper. For an experiment that is not in the paper, they are all results with an
    interval, without parts of another result, such as that of one direction alone.
    """
    paper_names = dict.fromkeys(name for paper_row in figures_by_condition(experiment).values() for name in paper_row)
    if paper_names:
        return list(paper_names)
    names_with_interval: dict[str, None] = {}
    for group in results:
        parents: list[str] = []
        for estimate in group.result.results:
            is_part = any(estimate.name.startswith(f"{parent}_") for parent in parents)
            parents += [] if is_part else [estimate.name]
            if not is_part and not math.isnan(estimate.low):
                names_with_interval[estimate.name] = None
    return list(names_with_interval)


def conditions(experiment: str, results: Sequence[GroupResult], name: str) -> list[str]:
    """Return the conditions of a result, those of the paper first, in its order; one empty name without a condition."""
    paper_conditions = [
        label
        for label, paper_values in figures_by_condition(experiment).items()
        if label != "any" and name in paper_values
    ]
    known_conditions = {group.condition for group in results} | set(paper_conditions)
    return [label for label in ordered_conditions(results) if label in known_conditions] or [""]


def ordered_conditions(results: Sequence[GroupResult]) -> list[str]:
    """Return the conditions of all experiments of the paper, then the other conditions of the results.

    The order is the same for every set of runs.
    """
    paper_conditions = [label for experiment in names() for label in figures_by_condition(experiment) if label != "any"]
    return list(dict.fromkeys([*paper_conditions, *(group.condition for group in results)]))


def cells_of(
    results: Sequence[GroupResult], faulty_entries: Sequence[RunEntry], name: str, condition: str
) -> list[DatasheetCell]:
    """Return a cell of one result for each actuator that has it, or one cell without an estimate that says why.

    Parameters
    ----------
    results : those of one set of runs under all conditions.
    faulty_entries : runs of the set that could not be analysed.
    """
    results_under_condition = [group for group in results if group.condition == condition]
    estimates = [
        (group, estimate)
        for group in results_under_condition
        for estimate in group.result.results
        if estimate.name == name
    ]
    if not estimates:
        entries_not_analysed = tuple(entry for entry in faulty_entries if condition in ("", entry.group[1]))
        return [DatasheetCell(None, entries_not_analysed, "not analysed" if entries_not_analysed else NOT_MEASURED)]
    return [DatasheetCell(estimate, group.entries, actuators=(group.actuator,)) for group, estimate in estimates]


def pooled_cell(cells: Sequence[DatasheetCell]) -> DatasheetCell:
    """Pool the cells of several actuators: the mean of their values, or, without values, bounds that hold for all."""
    measured_cells = [(cell, cell.estimate) for cell in cells if cell.estimate is not None]
    cells_with_value = [(cell, estimate) for cell, estimate in measured_cells if math.isfinite(estimate.value)]
    cells_with_bound = [
        (cell, estimate)
        for cell, estimate in measured_cells
        if not (math.isnan(estimate.low) and math.isnan(estimate.high))
    ]
    pooled_cells = cells_with_value or cells_with_bound or measured_cells
    if len(pooled_cells) < 2:
        return pooled_cells[0][0] if pooled_cells else cells[0]
    pooled = (over_actuators if cells_with_value else widest)([estimate for _, estimate in pooled_cells])
    entries = tuple(entry for cell, _ in pooled_cells for entry in cell.entries)
    return DatasheetCell(pooled, entries, actuators=tuple(name for cell, _ in pooled_cells for name in cell.actuators))


def with_actuator_names(cell: DatasheetCell, run_set: RunSet, motor: str) -> DatasheetCell:
    """Return the cell; if the set has further actuators of this motor, the cell names its own in `whose`."""
    actuators = {entry.group[0] for entry in run_set.entries if entry.experiment and entry.motor == motor}
    if not cell.actuators or actuators <= set(cell.actuators):
        return cell
    return replace(cell, whose=f"of {', '.join(name or 'one without a name' for name in cell.actuators)} alone")


def shared_actuator(cells: Sequence[DatasheetCell]) -> str:
    """Return the actuator that all cells with an estimate share; empty if they differ."""
    actuators = dict.fromkeys(cell.actuator for cell in cells if cell.estimate is not None)
    return next(iter(actuators)) if len(actuators) == 1 else ""


def unlisted(sets: Sequence[RunSet], motors: Sequence[str]) -> list[str]:
    """Return the experiments that have neither a run nor a figure in the paper."""
    measured_experiments = {
        entry.experiment
        for run_set, motor in zip(sets, motors, strict=True)
        for entry in run_set.entries
        if entry.motor == motor
    }
    return [name for name in names() if name not in measured_experiments and not figures_by_condition(name)]
