"""The values behind an efficiency map, a row for each setpoint; folded on a screen, open on paper."""

import itertools
import math

from leactl.analysis.estimate import Grid
from leactl.report.datasheet.figures import plain, pretty
from leactl.report.datasheet.runset import Answer
from leactl.report.datasheet.table import links
from leactl.report.html import Html, table, tag

UNITS = {"_rad_s": "rad/s", "_Nm": "N*m", "_V": "V", "_A": "A", "_W": "W", "_1": "1"}  # of a name's end
NOT_HELD = "-"


def map_of(grid: Grid, answer: Answer) -> Html:
    """One map: both setpoints, then every quantity that was measured there."""
    setpoints = list(itertools.product(*grid.axes.values()))
    columns = [[value for row in rows for value in row] for rows in grid.values.values()]
    cells = [
        [*(f"{one:g}" for one in point), *map(cell, values)] for point, *values in zip(setpoints, *columns, strict=True)
    ]
    headings = [f"set {with_unit(name)}" for name in grid.axes] + [with_unit(name) for name in grid.values]
    whose = ", ".join(filter(None, (plain(grid.name), answer.actuator, answer.condition)))
    title = tag("summary", f"Values at every setpoint: {whose}")
    said = tag("p", f"Means at {len(setpoints)} setpoints, from ", links(answer.entries), class_="about")
    return tag("details", title, said, table(headings, cells, "map"))


def with_unit(name: str) -> str:
    """A quantity with its unit, from a name that ends in it."""
    end = next((one for one in UNITS if name.endswith(one)), "")
    return pretty(f"{plain(name.removesuffix(end))} [{UNITS[end]}]") if end else plain(name)


def cell(value: float) -> str:
    """Four digits; a dash where the bench did not hold the setpoint."""
    if not math.isfinite(value):
        return NOT_HELD
    return f"{value + 0.0:#.4g}".rstrip(".")  # no negative zero
