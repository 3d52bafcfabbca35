"""What a map says at each setpoint, a row for each of one axis; folded on a screen, open on paper."""

import math

import numpy as np

from leactl.analysis.estimate import Grid
from leactl.report.datasheet.figures import plain, pretty
from leactl.report.datasheet.runset import GroupResult
from leactl.report.datasheet.table import links
from leactl.report.html import Html, table, tag

UNITS = {"_rad_s": "rad/s", "_Nm": "N*m", "_V": "V", "_A": "A", "_W": "W", "_1": "1"}  # of a name's end
NOT_HELD = "-"


def map_of(grid: Grid, answer: GroupResult) -> Html:
    """One map by its first quantity, the axis with more setpoints downwards; the others are for `analyze --json`."""
    (quantity, rows), axes = next(iter(grid.values.items())), list(grid.axes.items())
    cells = np.array(rows)
    if len(axes[1][1]) > len(axes[0][1]):
        cells, axes = cells.T, axes[::-1]
    (down, setpoints), (across, others) = axes
    headings = [f"{with_unit(down)} \\ {with_unit(across)}", *(f"{one:.4g}" for one in others)]
    body = [[f"{one:.4g}", *map(cell, row)] for one, row in zip(setpoints, cells.tolist(), strict=True)]
    whose = ", ".join(filter(None, (plain(grid.name), answer.actuator, answer.condition)))
    title = tag("summary", f"Values at every setpoint: {whose}")
    said = tag("p", f"{with_unit(quantity).capitalize()} at {cells.size} setpoints, from ", links(answer.entries))
    return tag("details", title, said, table(headings, body, "map"))


def with_unit(name: str) -> str:
    """A quantity with its unit, from a name that ends in it."""
    end = next((one for one in UNITS if name.endswith(one)), "")
    return pretty(f"{plain(name.removesuffix(end))} [{UNITS[end]}]") if end else plain(name)


def cell(value: float) -> str:
    """Three digits; a dash where the bench did not hold the setpoint."""
    if not math.isfinite(value):
        return NOT_HELD
    return f"{value + 0.0:#.3g}".rstrip(".")  # no negative zero
