"""A chart of values with their 95 % intervals, a row each over one axis, with the paper's figure as a stroke."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from leactl.report.chart import TICKS, Key, SvgPath, Tick, across, axis, percent, tick_text
from leactl.report.plot import PlotAxis

STRIP_HEIGHT = 20.0  # units of the drawing of one row, down; the template's `viewBox` says it too


@dataclass(frozen=True)
class Interval:
    """One row of the chart; a value or an end that is not known is NaN."""

    label: str
    style: str
    value: float
    low: float
    high: float
    paper: str = ""  # the paper's figure as it is printed


class Strip(NamedTuple):
    """One row as its template takes it."""

    label: str
    description: str
    paths: list[SvgPath]


class IntervalChart(NamedTuple):
    """The whole chart as its template takes it."""

    keys: list[Key]
    strips: list[Strip]
    x_ticks: list[Tick]
    x_label: str


def intervals(rows: Sequence[Interval], x_label: str) -> IntervalChart:
    """Return the rows below each other over one axis with ticks and a legend."""
    marks = [paper_value(row.paper) for row in rows]
    x = axis([np.array([row.value, row.low, row.high, mark]) for row, mark in zip(rows, marks, strict=True)], TICKS[0])
    ticks = {across(x, value): tick_text(value, text) for value, text in x.ticks.items()}
    keys = [("line", "95 % interval")] + ([("paper", "LEA in the paper")] if np.isfinite(marks).any() else [])
    strips = [strip(row, mark, x, list(ticks)) for row, mark in zip(rows, marks, strict=True)]
    return IntervalChart(keys, strips, [(percent(at), text) for at, text in ticks.items()], x_label)


def strip(row: Interval, mark: float, x: PlotAxis, ticks: Sequence[float]) -> Strip:
    """Return the drawing of one row; `mark` is the paper's value, NaN where it has none."""
    middle = STRIP_HEIGHT / 2.0
    paths = [SvgPath("".join(f"M{at} 0V{STRIP_HEIGHT:g}" for at in ticks), "grid")]
    if math.isfinite(mark):
        paths.append(SvgPath(f"M{across(x, mark)} 0V{STRIP_HEIGHT:g}", "curve paper"))
    if math.isfinite(row.low) and math.isfinite(row.high):
        whisker = f"M{across(x, row.low)} {middle:g}H{across(x, row.high)}"
        paths.append(SvgPath(whisker, f"curve line {row.style}"))
    if math.isfinite(row.value):
        paths.append(SvgPath(f"M{across(x, row.value)} {middle:g}h0", f"marks {row.style}"))
    reading = f"{row.value:.6g}, 95 % from {row.low:.6g} to {row.high:.6g}" if math.isfinite(row.value) else "not known"
    return Strip(row.label, f"{row.label}: {reading}", paths)


def paper_value(text: str) -> float:
    """Return the number that a figure of the paper begins with; NaN for a bound or for no figure."""
    match = re.match(r"[-+]?\d+(\.\d+)?([eE][-+]?\d+)?", text)
    return float(match[0]) if match else math.nan
