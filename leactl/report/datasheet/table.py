"""The table of a datasheet as its template takes it: a group of rows for each experiment, a column for each set."""

import math
from collections.abc import Sequence
from typing import Any

from leactl.analysis.estimate import Estimate
from leactl.report.datasheet.figures import heading, plain, pretty
from leactl.report.datasheet.rows import DatasheetCell, DatasheetRow
from leactl.report.datasheet.runset import RunSet
from leactl.report.datasheet.sheet import Section
from leactl.report.terminal import interval_text, value_text


def columns(sets: Sequence[RunSet]) -> list[str]:
    """Return the headings of the table."""
    columns_of_sets = [*(run_set.name for run_set in sets), "difference"]
    values = columns_of_sets if len(sets) > 1 else ["actuator", "value ± std", "95 % interval"]
    return ["quantity", "condition", *values, "units", "LEA in the paper", "from"]


def groups(sets: Sequence[RunSet], section: Section, anchor: str) -> list[dict[str, Any]]:
    """Return the rows of each experiment; the title of a measured experiment links to its figures.

    Parameters
    ----------
    anchor : first part of the ids of the link targets, as in `section_content`.
    """
    return [
        {
            "title": heading(experiment),
            "target": f"{anchor}-{experiment}" if any(map(measured, rows)) else "",
            "rows": [row_content(sets, row) for row in rows],
        }
        for experiment, rows in section.rows.items()
    ]


def measured(row: DatasheetRow) -> bool:
    """Return whether a set of runs has an estimate for this row."""
    return any(cell.estimate is not None for cell in row.cells)


def row_content(sets: Sequence[RunSet], row: DatasheetRow) -> dict[str, Any]:
    """Return the texts of one row; a list has lines below each other."""
    return {
        "name": plain(row.name),
        "known": measured(row),
        "condition": row.condition,
        "actuator": row.actuator,
        "by_set": [
            (run_set.name, [*value_and_interval(cell), cell.whose])
            for run_set, cell in zip(sets, row.cells, strict=True)
        ],
        "difference": difference_content(row.difference),
        "units": "" if row.units == "1" else pretty(row.units),
        "paper": row.paper,
        "entries": [entry for cell in row.cells for entry in cell.entries],
    }


def value_and_interval(cell: DatasheetCell) -> list[str]:
    """Return the value and the 95 % interval of a cell as texts, or why it has no value."""
    if cell.estimate is None:
        return [cell.lacks, ""]
    return [value_text(cell.estimate), interval_text(cell.estimate)]


def difference_content(difference: Estimate | None) -> dict[str, Any] | None:
    """Return the difference of two sets as text, marked strong if its interval excludes zero; None without a std."""
    if difference is None or not math.isfinite(difference.std):
        return None
    return {
        "lines": [value_text(difference), interval_text(difference)],
        "strong": difference.low > 0.0 or difference.high < 0.0,
    }
