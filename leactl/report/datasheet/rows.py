"""The table of a datasheet: a row for each result, condition and actuator, a cell for each set of runs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from leactl.analysis.analyze import names
from leactl.analysis.anova.pooled import difference, over_actuators, widest
from leactl.analysis.estimate import Estimate
from leactl.report.datasheet.runset import GroupResult, RunEntry, RunSet
from leactl.report.terminal import figures, printed, units_in_paper

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
        if len(known) < 2 or not all(math.isfinite(one.value) for one in known):
            return None
        return difference(known[0], known[1])

    def as_json(self, sets: Sequence[RunSet]) -> dict[str, Any]:
        """The row for a script; what is not known is null."""
        found = self.difference if len(self.cells) > 1 else None
        told = {
            "experiment": self.experiment,
            "name": self.name,
            "condition": self.condition,
            "actuator": self.actuator,
            "units": self.units,
            "paper": self.paper or None,
            "values": [
                {
                    "set": one.name,
                    "runs": [entry.label for entry in cell.entries],
                    "actuators": list(cell.actuators),
                    "lacks": cell.lacks or None,
                }
                | numbers(cell.estimate)
                for one, cell in zip(sets, self.cells, strict=True)
            ],
        }
        return told | ({"difference": numbers(found)} if len(self.cells) > 1 else {})


def numbers(estimate: Estimate | None) -> dict[str, float | None]:
    """Value, std and interval as JSON takes them."""
    row = {} if estimate is None else estimate.as_json()
    return {key: row.get(key) for key in ("value", "std", "low", "high")}


def rows(sets: Sequence[RunSet], motors: Sequence[str], experiment: str) -> list[DatasheetRow]:
    """Rows of one experiment; motor k is that of set k.

    One set has a row for each actuator, and one for all where several know the result; of two sets only what all of
    each know together is side by side.
    """
    answers = [
        [one for one in own.answers if (one.motor, one.experiment) == (motor, experiment)]
        for own, motor in zip(sets, motors, strict=True)
    ]
    faulty = [
        [one for one in own.entries if one.fault and (one.motor, one.experiment) == (motor, experiment)]
        for own, motor in zip(sets, motors, strict=True)
    ]
    every = [one for own in answers for one in own]
    found = []
    for name in result_names(experiment, every):
        for condition in conditions(experiment, every, name):
            paper = figures(experiment, condition).get(name, "")
            cells = [cells_of(own, lost, name, condition) for own, lost in zip(answers, faulty, strict=True)]
            shown: list[tuple[DatasheetCell, ...]]
            if len(sets) == 1:
                whole = together(cells[0])
                shown = [(cell,) for cell in [*cells[0], *([whole] if len(whole.actuators) > 1 else [])]]
            else:
                shown = [
                    tuple(
                        attributed(together(of_set), own, motor)
                        for of_set, own, motor in zip(cells, sets, motors, strict=True)
                    )
                ]
            found += [DatasheetRow(experiment, name, condition, who(row), row, paper) for row in shown]
    return found


def result_names(experiment: str, answers: Sequence[GroupResult]) -> list[str]:
    """Results for the table: those that the paper has; of an experiment that it has not, those with an interval.

    A result that is a part of another, such as that of one direction alone, is left to the list of all results.
    """
    in_paper = dict.fromkeys(name for figures_ in printed(experiment).values() for name in figures_)
    if in_paper:
        return list(in_paper)
    known: dict[str, None] = {}
    for answer in answers:
        parents: list[str] = []
        for item in answer.result.results:
            part = any(item.name.startswith(f"{parent}_") for parent in parents)
            parents += [] if part else [item.name]
            if not part and not math.isnan(item.low):
                known[item.name] = None
    return list(known)


def conditions(experiment: str, answers: Sequence[GroupResult], name: str) -> list[str]:
    """Conditions of a result: those of the paper in its order, then others; one without a name where there is none."""
    own = [label for label, figures_ in printed(experiment).items() if label != "any" and name in figures_]
    measured = {answer.condition for answer in answers} | set(own)
    return [label for label in ordered_conditions(answers) if label in measured] or [""]


def ordered_conditions(answers: Sequence[GroupResult]) -> list[str]:
    """Conditions of the paper in its order, then others: the same for every set of runs, however theirs was drawn."""
    papers = [label for each in names() for label in printed(each) if label != "any"]
    return list(dict.fromkeys([*papers, *(answer.condition for answer in answers)]))


def cells_of(
    answers: Sequence[GroupResult], faulty: Sequence[RunEntry], name: str, condition: str
) -> list[DatasheetCell]:
    """A cell for each actuator that was measured; an empty one where none was."""
    own = [answer for answer in answers if answer.condition == condition]
    found = [(answer, item) for answer in own for item in answer.result.results if item.name == name]
    if not found:
        lost = tuple(one for one in faulty if condition in ("", one.group[1]))
        return [DatasheetCell(None, lost, "not analysed" if lost else NOT_MEASURED)]
    return [DatasheetCell(item, answer.entries, actuators=(answer.actuator,)) for answer, item in found]


def together(cells: Sequence[DatasheetCell]) -> DatasheetCell:
    """What actuators say together: the mean of those that know a value, or else the bounds that hold for all."""
    pairs = [(cell, cell.estimate) for cell in cells if cell.estimate is not None]
    valued = [(cell, item) for cell, item in pairs if math.isfinite(item.value)]
    bounded = [(cell, item) for cell, item in pairs if not (math.isnan(item.low) and math.isnan(item.high))]
    told = valued or bounded or pairs
    if len(told) < 2:
        return told[0][0] if told else cells[0]
    estimate = (over_actuators if valued else widest)([item for _, item in told])
    entries = tuple(entry for cell, _ in told for entry in cell.entries)
    return DatasheetCell(estimate, entries, actuators=tuple(name for cell, _ in told for name in cell.actuators))


def attributed(cell: DatasheetCell, own: RunSet, motor: str) -> DatasheetCell:
    """The cell with the names of its actuators where its set has others besides."""
    every = {entry.group[0] for entry in own.entries if entry.experiment and entry.motor == motor}
    if not cell.actuators or every <= set(cell.actuators):
        return cell
    return replace(cell, whose=f"of {', '.join(name or 'one without a name' for name in cell.actuators)} alone")


def who(cells: Sequence[DatasheetCell]) -> str:
    """The actuator of a row, where its cells have the same one."""
    told = dict.fromkeys(cell.actuator for cell in cells if cell.estimate is not None)
    return next(iter(told)) if len(told) == 1 else ""


def unlisted(sets: Sequence[RunSet], motors: Sequence[str]) -> list[str]:
    """Experiments without a run and without a figure in the paper."""
    measured = {
        one.experiment for own, motor in zip(sets, motors, strict=True) for one in own.entries if one.motor == motor
    }
    return [name for name in names() if name not in measured and not printed(name)]
