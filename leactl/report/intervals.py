"""A chart of values with 95 % intervals: a row for each value over one axis, with the figure of the paper."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from leactl.report.chart import MOST_TICKS, Key, SvgPath, Tick, across, axis, percent, tick_text
from leactl.report.plot import PlotAxis

STRIP_HEIGHT = 20.0  # of the drawing of a row, in its units; the template has the same in its `viewBox`


@dataclass(frozen=True)
class Interval:
    """The data of one row of the chart; a value or an end of the interval that is not known is NaN."""

    label: str
    style: str
    value: float
    low: float
    high: float
    paper: str = ""  # figure of the paper, as printed there


class Strip(NamedTuple):
    """One row of the chart as the template takes it."""

    label: str
    description: str
    paths: list[SvgPath]


class IntervalChart(NamedTuple):
    """The whole chart as the template takes it."""

    keys: list[Key]
    strips: list[Strip]
    x_ticks: list[Tick]
    x_label: str


def intervals(rows: Sequence[Interval], x_label: str) -> IntervalChart:
    """Return the rows below each other over one axis with ticks and a legend."""
    paper_figures = [paper_value(row.paper) for row in rows]
    x = axis(
        [
            np.array([row.value, row.low, row.high, paper_figure])
            for row, paper_figure in zip(rows, paper_figures, strict=True)
        ],
        MOST_TICKS[0],
    )
    tick_texts = {across(x, value): tick_text(value, text) for value, text in x.ticks.items()}
    keys = [("line", "95 % interval")] + ([("paper", "LEA in the paper")] if np.isfinite(paper_figures).any() else [])
    strips = [
        strip(row, paper_figure, x, list(tick_texts)) for row, paper_figure in zip(rows, paper_figures, strict=True)
    ]
    return IntervalChart(keys, strips, [(percent(position), text) for position, text in tick_texts.items()], x_label)


def strip(row: Interval, paper_figure: float, x: PlotAxis, tick_positions: Sequence[float]) -> Strip:
    """Return the drawing of one row.

    Parameters
    ----------
    paper_figure : value of the paper; NaN if it has none.
    tick_positions : x coordinates of the ticks in the drawing.
    """
    middle_height = STRIP_HEIGHT / 2.0
    paths = [SvgPath("".join(f"M{position} 0V{STRIP_HEIGHT:g}" for position in tick_positions), "grid")]
    if math.isfinite(paper_figure):
        paths.append(SvgPath(f"M{across(x, paper_figure)} 0V{STRIP_HEIGHT:g}", "curve paper"))
    if math.isfinite(row.low) and math.isfinite(row.high):
        whisker = f"M{across(x, row.low)} {middle_height:g}H{across(x, row.high)}"
        paths.append(SvgPath(whisker, f"curve line {row.style}"))
    if math.isfinite(row.value):
        paths.append(SvgPath(f"M{across(x, row.value)} {middle_height:g}h0", f"marks {row.style}"))
    value_text = (
        f"{row.value:.6g}, 95 % from {row.low:.6g} to {row.high:.6g}" if math.isfinite(row.value) else "not known"
    )
    return Strip(row.label, f"{row.label}: {value_text}", paths)


def paper_value(text: str) -> float:
    """Return the number at the start of a figure of the paper; NaN if it does not begin with one, such as a bound."""
    match = re.match(r"[-+]?\d+(\.\d+)?([eE][-+]?\d+)?", text)
    return float(match[0]) if match else math.nan
