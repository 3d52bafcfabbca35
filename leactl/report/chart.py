"""Charts for pages: curves are SVG that stretches to any width, labels are HTML around it and keep their size.

All coordinates are computed here; the template `parts.html` writes the elements.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.report.plot import PlotAxis

Array = npt.NDArray[np.float64]
MOST_TICKS = (5, 5)  # along x and y, approximately: at 360 px, x labels have 47 px each
DRAWING_SIZE = 1000.0  # width and height of the drawing in its units; templates have the same in their `viewBox`
GAP_STEPS = 10.0  # multiple of the median step of a curve; points further apart are not connected
LONGEST_TICK_TEXT = 7  # characters


class SvgPath(NamedTuple):
    """One path of a drawing."""

    d: str  # commands of SVG
    style: str  # CSS classes


@dataclass(frozen=True, eq=False)
class LineMarks:
    """A line through points."""

    name: str
    style: str
    x: Array
    y: Array
    connected: bool = False  # connect all points, however far apart
    labelled: bool = False  # print its name on the line and not in the legend

    def extent(self) -> tuple[Array, Array]:
        """Return all x and y values, which the axes have to contain."""
        return self.x, self.y

    def paths(self, x: PlotAxis, y: PlotAxis) -> list[SvgPath]:
        """Return the path, interrupted where a value is not finite and where points are missing."""
        path, pen = [], "M"
        steps = np.diff(self.x, prepend=self.x[:1])
        all_connected = self.connected or len(steps) <= 2
        follows_gap = steps == np.inf if all_connected else steps > GAP_STEPS * np.nanmedian(steps)
        for x_value, y_value, after_gap in zip(self.x.tolist(), self.y.tolist(), follows_gap.tolist(), strict=True):
            if not (math.isfinite(x_value) and math.isfinite(y_value)):
                pen = "M"
                continue
            path.append(f"{'M' if after_gap else pen}{across(x, x_value)} {down(y, y_value)}")
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
        """Return strokes of almost no length: the ends of a stroke keep their shape in a stretched drawing.

        A PDF paints a stroke of zero length only if its ends are round (ISO 32000, 8.5.3.2), so that one with square
        ends is 0.1 long.
        """
        stroke = "h0.1" if "square" in self.style.split() else "h0"
        points = zip(*map(np.ndarray.tolist, self.extent()), strict=True)
        commands = "".join(f"M{across(x, x_value)} {down(y, y_value)}{stroke}" for x_value, y_value in points)
        hole_paths = [SvgPath(commands, "marks hole")] if "ring" in self.style.split() else []
        return [SvgPath(commands, f"marks {self.style}"), *hole_paths]


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
        for low, high, mean, std in np.stack([self.low, self.high, self.mean, self.std], axis=1).tolist():
            left, right = across(x, low), across(x, high)
            bars.append(f"M{left} {down(y, mean - std)}H{right}V{down(y, mean + std)}H{left}Z")
            strokes.append(f"M{left} {down(y, mean)}H{right}")
        return [SvgPath("".join(bars), f"area {self.style}"), SvgPath("".join(strokes), f"curve {self.style}")]


@dataclass(frozen=True)
class AxisRange:
    """A shaded part of one axis."""

    name: str
    style: str
    low: float
    high: float
    upright: bool = True  # True: a range of x; False: of y

    def extent(self) -> tuple[Array, Array]:
        """Return both ends of a range of y, which the axis has to contain; a range of x is cut at the axes instead."""
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
        """Return one path with all polygons."""
        rings = [
            "L".join(f"{across(x, x_value)} {down(y, y_value)}" for x_value, y_value in polygon)
            for polygon in self.polygons
        ]
        return [SvgPath("".join(f"M{ring}Z" for ring in rings), f"band {self.style}")]


Layer = LineMarks | PointMarks | Bins | AxisRange | Area
Key = tuple[str, str]  # of a legend: style and name
Tick = tuple[str, str]  # position on the axis in percent, and text
NO_CURVE = LineMarks("", "", np.empty(0), np.empty(0))


class LineLabel(NamedTuple):
    """The name of a line, and its position in the chart in percent."""

    text: str
    left: str
    top: str


@dataclass(frozen=True)
class Chart:
    """A chart with computed coordinates, as its template takes it."""

    keys: Sequence[Key]
    x_ticks: Sequence[Tick]
    x_label: str
    y_ticks: Sequence[Tick]
    y_label: str
    x_ends: str  # both ends of the x axis, in the units of its quantity
    y_ends: str
    description: str
    paths: Sequence[SvgPath]  # in the order of drawing
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
    included_in_axes: Sequence[Layer] = (),
    keys: Sequence[Key] = (),
    x_log: bool = False,
) -> Chart:
    """Return a chart of the layers drawn over each other, with ticks at round numbers and a legend.

    Parameters
    ----------
    included_in_axes : layers that are not drawn, such as those of a neighbouring chart, which the axes contain too.
    keys : style and name of each entry of the legend; by default those of the layers, each name once.
    """
    extents = [layer.extent() for layer in (*layers, *included_in_axes)]
    x, y = (
        axis([extent[0] for extent in extents], MOST_TICKS[0], x_log),
        axis([extent[1] for extent in extents], MOST_TICKS[1]),
    )
    if not keys:
        legend_layers = [layer for layer in layers if not (isinstance(layer, LineMarks) and layer.labelled)]
        # reversed, so that the first layer of each name gives the style
        style_of_name = {layer.name: layer.style for layer in reversed(legend_layers)}
        keys = [(style_of_name[name], name) for name in reversed(style_of_name)]
    x_ticks = {across(x, value): tick_text(value, text) for value, text in x.ticks.items()}
    y_ticks = {down(y, value): tick_text(value, text) for value, text in y.ticks.items()}
    vertical_lines = [f"M{position} 0V{DRAWING_SIZE:g}" for position in x_ticks]
    horizontal_lines = [f"M0 {position}H{DRAWING_SIZE:g}" for position in y_ticks]
    grid = "".join([*vertical_lines, *horizontal_lines])
    return Chart(
        keys=keys,
        x_ticks=[(percent(position), text) for position, text in x_ticks.items()],
        x_label=x_label,
        y_ticks=[(percent(position), text) for position, text in y_ticks.items()],
        y_label=y_label,
        x_ends=f"{x.low:.12g} {x.high:.12g}",
        y_ends=f"{y.low:.12g} {y.high:.12g}",
        description=f"{y_label} over {x_label}: {', '.join(name for _, name in keys)}",
        paths=[SvgPath(grid, "grid"), *(path for layer in layers for path in layer.paths(x, y))],
        labels=labels_on_lines(layers, x, y),
    )


def labels_on_lines(layers: Sequence[Layer], x: PlotAxis, y: PlotAxis) -> list[LineLabel]:
    """Return the labels of the lines that carry their name, each at the middle of the longest line of that name."""
    longest_lines: dict[str, LineMarks] = {}
    for layer in layers:
        if (
            isinstance(layer, LineMarks)
            and layer.labelled
            and len(layer.x) > len(longest_lines.get(layer.name, NO_CURVE).x)
        ):
            longest_lines[layer.name] = layer
    labels = []
    for name, line in longest_lines.items():
        middle_index = len(line.x) // 2
        left, top = across(x, float(line.x[middle_index])), down(y, float(line.y[middle_index]))
        labels.append(LineLabel(name, percent(left), percent(top)))
    return labels


def axis(values: Sequence[Array], ticks: int, log: bool = False) -> PlotAxis:
    """Return an axis that contains all finite values; a logarithmic axis contains those above zero."""
    all_values = np.concatenate(values)
    finite = all_values[np.isfinite(all_values) & ((all_values > 0.0) | (not log))]
    return PlotAxis([float(finite.min()), float(finite.max())] if len(finite) else [0.0, 1.0], ticks, log)


def across(x: PlotAxis, value: float) -> float:
    """Return the x coordinate of a value in the drawing, from 0 at the left to `DRAWING_SIZE`, cut at both ends."""
    return round(DRAWING_SIZE * min(max(x.share(value), 0.0), 1.0), 1)


def down(y: PlotAxis, value: float) -> float:
    """Return the y coordinate of a value in the drawing, from 0 at the top to `DRAWING_SIZE`, cut at both ends."""
    return round(DRAWING_SIZE * min(max(1.0 - y.share(value), 0.0), 1.0), 1)


def percent(coordinate: float) -> str:
    """Return a coordinate of the drawing in percent of its width or height."""
    return f"{100.0 * coordinate / DRAWING_SIZE:.4g}%"


def tick_text(value: float, text: str) -> str:
    """Return the text of a tick; in place of a text that is too long, the value with three digits."""
    return text if len(text) <= LONGEST_TICK_TEXT else f"{value:.3g}"
