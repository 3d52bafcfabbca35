"""The table of a datasheet in HTML: experiments below each other, two sets of runs beside each other."""

import math
from collections.abc import Sequence

from leactl.analysis.estimate import Estimate
from leactl.report.datasheet.figures import heading, plain, pretty
from leactl.report.datasheet.rows import DatasheetCell, DatasheetRow
from leactl.report.datasheet.runset import RunEntry, RunSet
from leactl.report.datasheet.sheet import Section
from leactl.report.html import Html, escaped, joined, tag
from leactl.report.terminal import interval_text, value_text


def rows_table(sets: Sequence[RunSet], section: Section, anchor: str) -> Html:
    """Return the table of all rows; the name of a measured experiment links to its figures."""
    several = len(sets) > 1
    headings = ["quantity", "condition"] + ([] if several else ["actuator"])
    headings += [*(run_set.name for run_set in sets), "difference"] if several else ["value ± std", "95 % interval"]
    headings += ["units", "LEA in the paper", "from"]
    head = tag("thead", tag("tr", *(tag("th", heading, scope="col") for heading in headings)))
    bodies = []
    for experiment, experiment_rows in section.rows.items():
        measured = any(cell.estimate is not None for row in experiment_rows for cell in row.cells)
        name = heading(experiment)
        title = tag("a", name, href=f"#{anchor}-{experiment}") if measured else name
        opening = tag("tr", tag("th", title, scope="rowgroup", colspan=str(len(headings))), class_="group")
        bodies.append(tag("tbody", opening, *(table_row(row, several, headings) for row in experiment_rows)))
    return tag("div", tag("table", head, *bodies, class_="datasheet"), class_="scroll", tabindex="0")


def table_row(row: DatasheetRow, several: bool, headings: Sequence[str]) -> Html:
    """Return one row; each cell carries its heading, which a narrow screen shows beside it."""
    cells: list[str] = [row.condition] + ([] if several else [row.actuator])
    if several:
        cells += [in_lines(*value_and_interval(cell), cell.whose) for cell in row.cells]
        cells.append(difference_cell(row.difference))
    else:
        cells += value_and_interval(row.cells[0])
    sources = [entry for cell in row.cells for entry in cell.entries]
    cells += ["" if row.units == "1" else pretty(row.units), row.paper, links(sources)]
    lacking = all(cell.estimate is None for cell in row.cells)
    wraps = ["short"] * (len(cells) - 2) + ["wrap"] * 2
    data = [
        tag("td", cell, data_label=heading, class_=wrap)
        for cell, heading, wrap in zip(cells, headings[1:], wraps, strict=True)
    ]
    return tag("tr", tag("th", plain(row.name), scope="row"), *data, class_="lacking" if lacking else "known")


def value_and_interval(cell: DatasheetCell) -> list[str]:
    """Return a cell's value and 95 % interval as text, or why it has none."""
    if cell.estimate is None:
        return [cell.lacks, ""]
    return [value_text(cell.estimate), interval_text(cell.estimate)]


def in_lines(first: str, *others: str) -> Html:
    """Return texts below each other, without empty ones."""
    return joined([escaped(first), *(tag("span", other, class_="second") for other in others if other)])


def difference_cell(difference: Estimate | None) -> Html:
    """Return the difference of two sets, strong where its interval excludes zero; empty without an uncertainty."""
    if difference is None or not math.isfinite(difference.std):
        return Html("")
    cell = in_lines(value_text(difference), interval_text(difference))
    return tag("strong", cell) if difference.low > 0.0 or difference.high < 0.0 else cell


def links(entries: Sequence[RunEntry]) -> Html:
    """Return the labels of runs, each a link to its row in the list of runs."""
    return joined(
        [tag("a", entry.label, href=f"#{entry.label}", title=entry.about.get("run_id", "")) for entry in entries], ", "
    )
