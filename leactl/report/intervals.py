"""Values with their 95 % intervals below each other on one axis, the paper's figure as a stroke beside each."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leactl.report.chart import DRAWING_SIZE, TICKS, across, axis, legend, tick_text
from leactl.report.html import Html, tag
from leactl.report.plot import PlotAxis

STRIP_HEIGHT = 20.0  # units of the drawing of one row, down


@dataclass(frozen=True)
class Interval:
    """One row; what is not known is NaN."""

    label: str
    style: str
    value: float
    low: float
    high: float
    paper: str = ""  # the paper's figure as it is printed


def intervals(rows: Sequence[Interval], x_label: str) -> Html:
    """A strip for each row over one axis with ticks."""
    marks = [paper_value(row.paper) for row in rows]
    x = axis([np.array([row.value, row.low, row.high, mark]) for row, mark in zip(rows, marks, strict=True)], TICKS[0])
    ticks = {across(x, value): tick_text(value, text) for value, text in x.ticks.items()}
    strips: list[Html] = []
    for row, mark in zip(rows, marks, strict=True):
        strips += [tag("span", row.label, class_="strip-label"), strip(row, mark, x, list(ticks))]
    keys = [("line", "95 % interval")] + ([("paper", "LEA in the paper")] if np.isfinite(marks).any() else [])
    below = tag("div", *(tag("span", tick, style=f"left:{at / 10:.4g}%") for at, tick in ticks.items()), class_="x")
    return tag("div", legend(keys), *strips, below, tag("div", x_label, class_="x-label"), class_="chart strips")


def strip(row: Interval, mark: float, x: PlotAxis, ticks: Sequence[float]) -> Html:
    """One row's drawing."""
    middle = STRIP_HEIGHT / 2.0
    paths = [tag("path", d="".join(f"M{at} 0V{STRIP_HEIGHT:g}" for at in ticks), class_="grid")]
    if math.isfinite(mark):
        paths.append(tag("path", d=f"M{across(x, mark)} 0V{STRIP_HEIGHT:g}", class_="curve paper"))
    if math.isfinite(row.low) and math.isfinite(row.high):
        whisker = f"M{across(x, row.low)} {middle:g}H{across(x, row.high)}"
        paths.append(tag("path", d=whisker, class_=f"curve line {row.style}"))
    if math.isfinite(row.value):
        paths.append(tag("path", d=f"M{across(x, row.value)} {middle:g}h0", class_=f"marks {row.style}"))
    reading = f"{row.value:.6g}, 95 % from {row.low:.6g} to {row.high:.6g}" if math.isfinite(row.value) else "not known"
    return tag(
        "svg",
        *paths,
        viewBox=f"0 0 {DRAWING_SIZE:g} {STRIP_HEIGHT:g}",
        preserveAspectRatio="none",
        role="img",
        aria_label=f"{row.label}: {reading}",
        class_="strip",
    )


def paper_value(text: str) -> float:
    """The number that a figure of the paper begins with; NaN for a bound or for none."""
    match = re.match(r"[-+]?\d+(\.\d+)?([eE][-+]?\d+)?", text)
    return float(match[0]) if match else math.nan
