"""Charts for pages: curves are SVG stretched to any width, labels are HTML beside it and keep their size.

All coordinates are worked out here; `parts.html` of the templates writes the elements.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.report.plot import PlotAxis

Array = npt.NDArray[np.float64]
TICKS = (5, 5)  # about the most along x and y: at 360 px, x labels have 47 px each
DRAWING_SIZE = 1000.0  # units of the drawing, across and down; the templates' `viewBox` says it too
GAP_STEPS = 10.0  # median steps of a curve; points further apart are not connected
LONGEST_TICK_TEXT = 7  # characters


class SvgPath(NamedTuple):
    """One path of a drawing: its commands as SVG has them, and its classes."""

    d: str
    style: str


@dataclass(frozen=True, eq=False)
class LineMarks:
    """A line through points."""

    name: str
    style: str
    x: Array
    y: Array
    whole: bool = False  # connect all points, however far apart
    labelled: bool = False  # its name stands on the line, and not in the legend

    def extent(self) -> tuple[Array, Array]:
        """Return all x and y values, which the axes have to contain."""
        return self.x, self.y

    def paths(self, x: PlotAxis, y: PlotAxis) -> list[SvgPath]:
        """Return the path, interrupted where a value is not finite and where points are missing."""
        path, pen = [], "M"
        steps = np.diff(self.x, prepend=self.x[:1])
        follows_gap = steps > GAP_STEPS * np.nanmedian(steps) if len(steps) > 2 and not self.whole else steps == np.inf
        for x_value, y_value, starts_anew in zip(self.x.tolist(), self.y.tolist(), follows_gap.tolist(), strict=True):
            if not (math.isfinite(x_value) and math.isfinite(y_value)):
                pen = "M"
                continue
            path.append(f"{'M' if starts_anew else pen}{across(x, x_value)} {down(y, y_value)}")
            pen = "L"
        return [SvgPath("".join(path), f"curve {self.style}")]


@dataclass(frozen=True, eq=False)
class PointMarks:
    """A mark at each point; `style` names its shape and colour."""

    name: str
    style: str
    x: Array
    y: Array

    def extent(self) -> tuple[Array, Array]:
        """Return x and y of the finite points, which the axes have to contain."""
        finite = np.isfinite(self.x) & np.isfinite(self.y)
        return self.x[finite], self.y[finite]

    def paths(self, x: PlotAxis, y: PlotAxis) -> list[SvgPath]:
        """Return strokes of almost no length: their ends are the marks, whose shape a stretched drawing keeps.

        A PDF paints a stroke of zero length only if its ends are round (ISO 32000, 8.5.3.2), so that one with square
        ends is 0.1 long.
        """
        stroke = "h0.1" if "square" in self.style.split() else "h0"
        pairs = zip(*map(np.ndarray.tolist, self.extent()), strict=True)
        d = "".join(f"M{across(x, a)} {down(y, b)}{stroke}" for a, b in pairs)
        hole = [SvgPath(d, "marks hole")] if "ring" in self.style.split() else []
        return [SvgPath(d, f"marks {self.style}"), *hole]


@dataclass(frozen=True, eq=False)
class Bins:
    """Mean and standard deviation in bins: each bin is a stroke at its mean inside a bar of two standard deviations."""

    name: str
    style: str
    low: Array
    high: Array
    mean: Array
    std: Array

    def extent(self) -> tuple[Array, Array]:
        """Return the edges of the bins and the ends of their bars, which the axes have to contain."""
        return np.concatenate([self.low, self.high]), np.concatenate([self.mean - self.std, self.mean + self.std])

    def paths(self, x: PlotAxis, y: PlotAxis) -> list[SvgPath]:
        """Return two paths: the bars, and the strokes over them."""
        bars, strokes = [], []
        for a, b, mean, std in np.stack([self.low, self.high, self.mean, self.std], axis=1).tolist():
            start, end = across(x, a), across(x, b)
            bars.append(f"M{start} {down(y, mean - std)}H{end}V{down(y, mean + std)}H{start}Z")
            strokes.append(f"M{start} {down(y, mean)}H{end}")
        return [SvgPath("".join(bars), f"area {self.style}"), SvgPath("".join(strokes), f"curve {self.style}")]


@dataclass(frozen=True)
class AxisRange:
    """A shaded part of one axis."""

    name: str
    style: str
    low: float
    high: float
    upright: bool = True  # a part of x; else of y

    def extent(self) -> tuple[Array, Array]:
        """Return both ends of a part of y, which the axis has to contain; a part of x is cut at the axes instead."""
        return np.empty(0), np.empty(0) if self.upright else np.asarray([self.low, self.high])

    def paths(self, x: PlotAxis, y: PlotAxis) -> list[SvgPath]:
        """Return one rectangle that reaches across the other axis."""
        if self.upright:
            path = f"M{across(x, self.low)} 0H{across(x, self.high)}V{DRAWING_SIZE:g}H{across(x, self.low)}Z"
        else:
            path = f"M0 {down(y, self.low)}H{DRAWING_SIZE:g}V{down(y, self.high)}H0Z"
        return [SvgPath(path, f"area {self.style}")]


@dataclass(frozen=True, eq=False)
class Area:
    """Polygons of one colour, each a sequence of corners (x, y)."""

    name: str
    style: str
    polygons: Sequence[Sequence[tuple[float, float]]]

    def extent(self) -> tuple[Array, Array]:
        """Return x and y of all corners, which the axes have to contain."""
        corners = np.array([corner for polygon in self.polygons for corner in polygon]).reshape(-1, 2)
        return corners[:, 0], corners[:, 1]

    def paths(self, x: PlotAxis, y: PlotAxis) -> list[SvgPath]:
        """Return one path of all polygons."""
        rings = ["L".join(f"{across(x, a)} {down(y, b)}" for a, b in polygon) for polygon in self.polygons]
        return [SvgPath("".join(f"M{ring}Z" for ring in rings), f"band {self.style}")]


Layer = LineMarks | PointMarks | Bins | AxisRange | Area
Key = tuple[str, str]  # of a legend: style and name
Tick = tuple[str, str]  # where on the axis its text stands, and the text
NO_CURVE = LineMarks("", "", np.empty(0), np.empty(0))


class LineLabel(NamedTuple):
    """The name of a line and the place on the line where it stands."""

    text: str
    left: str
    top: str


@dataclass(frozen=True)
class Chart:
    """A chart with its coordinates worked out, as its template takes it."""

    keys: Sequence[Key]
    x_ticks: Sequence[Tick]
    x_label: str
    y_ticks: Sequence[Tick]
    y_label: str
    x_ends: str  # in the quantity's units
    y_ends: str
    description: str
    paths: Sequence[SvgPath]  # in the order in which they are drawn over each other
    labels: Sequence[LineLabel]


@dataclass(frozen=True)
class CaptionedChart:
    """A chart and the text over it."""

    caption: str
    chart: Chart


def chart(
    layers: Sequence[Layer],
    x_label: str,
    y_label: str,
    beside: Sequence[Layer] = (),
    keys: Sequence[Key] = (),
    x_log: bool = False,
) -> Chart:
    """Return a chart of the layers drawn over each other, with ticks at round numbers and a legend.

    Parameters
    ----------
    beside : layers of another chart, which the axes contain too.
    keys : style and name of each entry of the legend; by default those of the layers, each name once.
    """
    extents = [layer.extent() for layer in (*layers, *beside)]
    x, y = axis([extent[0] for extent in extents], TICKS[0], x_log), axis([extent[1] for extent in extents], TICKS[1])
    if not keys:
        unnamed = [layer for layer in layers if not (isinstance(layer, LineMarks) and layer.labelled)]
        style_of_name = {layer.name: layer.style for layer in reversed(unnamed)}  # alike in name, the first has the key
        keys = [(style_of_name[name], name) for name in reversed(style_of_name)]
    x_ticks = {across(x, value): tick_text(value, text) for value, text in x.ticks.items()}
    y_ticks = {down(y, value): tick_text(value, text) for value, text in y.ticks.items()}
    grid = "".join([*(f"M{at} 0V{DRAWING_SIZE:g}" for at in x_ticks), *(f"M0 {at}H{DRAWING_SIZE:g}" for at in y_ticks)])
    return Chart(
        keys=keys,
        x_ticks=[(percent(at), text) for at, text in x_ticks.items()],
        x_label=x_label,
        y_ticks=[(percent(at), text) for at, text in y_ticks.items()],
        y_label=y_label,
        x_ends=f"{x.low:.12g} {x.high:.12g}",
        y_ends=f"{y.low:.12g} {y.high:.12g}",
        description=f"{y_label} over {x_label}: {', '.join(name for _, name in keys)}",
        paths=[SvgPath(grid, "grid"), *(path for layer in layers for path in layer.paths(x, y))],
        labels=labels_on_lines(layers, x, y),
    )


def labels_on_lines(layers: Sequence[Layer], x: PlotAxis, y: PlotAxis) -> list[LineLabel]:
    """Return the labels of the lines that carry their name, each at the middle of the longest line of that name."""
    longest: dict[str, LineMarks] = {}
    for layer in layers:
        if isinstance(layer, LineMarks) and layer.labelled and len(layer.x) > len(longest.get(layer.name, NO_CURVE).x):
            longest[layer.name] = layer
    labels = []
    for name, line in longest.items():
        middle = len(line.x) // 2
        left, top = across(x, float(line.x[middle])), down(y, float(line.y[middle]))
        labels.append(LineLabel(name, percent(left), percent(top)))
    return labels


def axis(values: Sequence[Array], ticks: int, log: bool = False) -> PlotAxis:
    """Return an axis over all finite values; a logarithmic axis is over those above zero."""
    pooled = np.concatenate(values)
    finite = pooled[np.isfinite(pooled) & ((pooled > 0.0) | (not log))]
    return PlotAxis([float(finite.min()), float(finite.max())] if len(finite) else [0.0, 1.0], ticks, log)


def across(x: PlotAxis, value: float) -> float:
    """Return the x coordinate of a value in the drawing, from 0 at the left to `DRAWING_SIZE`, cut at both ends."""
    return round(DRAWING_SIZE * min(max(x.share(value), 0.0), 1.0), 1)


def down(y: PlotAxis, value: float) -> float:
    """Return the y coordinate of a value in the drawing, from 0 at the top to `DRAWING_SIZE`, cut at both ends."""
    return round(DRAWING_SIZE * min(max(1.0 - y.share(value), 0.0), 1.0), 1)


def percent(coordinate: float) -> str:
    """Return a coordinate of the drawing as a part of its width or height."""
    return f"{100.0 * coordinate / DRAWING_SIZE:.4g}%"


def tick_text(value: float, text: str) -> str:
    """Return the text of a tick; a text that is too long becomes three digits with an exponent."""
    return text if len(text) <= LONGEST_TICK_TEXT else f"{value:.3g}"
