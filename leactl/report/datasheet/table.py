"""The table of a datasheet in HTML: experiments below each other, two sets of runs beside each other."""

from collections.abc import Sequence

from leactl.report.datasheet.figures import plain, pretty
from leactl.report.datasheet.rows import Cell, Row
from leactl.report.datasheet.runset import Entry, RunSet
from leactl.report.datasheet.sheet import Section
from leactl.report.html import Html, joined, tag
from leactl.report.terminal import interval_text, value_text


def rows_table(sets: Sequence[RunSet], section: Section, place: str) -> Html:
    """All rows; the name of an experiment that was measured leads to its figures."""
    several = len(sets) > 1
    headings = ["quantity", "condition"] + ([] if several else ["actuator"])
    for own in sets:
        headings += [own.name if several else "value ± std", "95 % interval"]
    headings += (["difference", "95 % interval"] if several else []) + ["units", "LEA in the paper", "from"]
    head = tag("thead", tag("tr", *(tag("th", heading, scope="col") for heading in headings)))
    bodies = []
    for experiment, own_rows in section.rows.items():
        measured = any(cell.estimate is not None for row in own_rows for cell in row.cells)
        name = plain(experiment).capitalize()
        title = tag("a", name, href=f"#{place}-{experiment}") if measured else name
        opening = tag("tr", tag("th", title, scope="rowgroup", colspan=str(len(headings))), class_="group")
        bodies.append(tag("tbody", opening, *(row_of(row, several) for row in own_rows)))
    return tag("div", tag("table", head, *bodies, class_="datasheet"), class_="scroll", tabindex="0")


def row_of(row: Row, several: bool) -> Html:
    """One result."""
    cells: list[str] = [row.condition] + ([] if several else [row.actuator])
    for cell in row.cells:
        cells += shown(cell)
    if several:
        found = row.difference
        cells += [value_text(found), interval_text(found)] if found is not None else ["", ""]
    sources = [entry for cell in row.cells for entry in cell.entries]
    cells += ["" if row.units == "1" else pretty(row.units), row.paper, links(sources)]
    lacking = all(cell.estimate is None for cell in row.cells)
    data = (tag("td", cell) for cell in cells)
    return tag("tr", tag("th", plain(row.name), scope="row"), *data, class_="lacking" if lacking else "known")


def shown(cell: Cell) -> list[str]:
    """Value and interval, or why there is none."""
    if cell.estimate is None:
        return [cell.lacks, ""]
    return [value_text(cell.estimate), interval_text(cell.estimate)]


def links(entries: Sequence[Entry]) -> Html:
    """Short names of runs, each a link to where it is listed."""
    return joined(
        [tag("a", one.label, href=f"#{one.label}", title=one.about.get("run_id", "")) for one in entries], ", "
    )
