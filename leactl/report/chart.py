"""Charts for pages: curves are SVG stretched to any width, labels are HTML beside it and keep their size."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.report.html import Html, joined, tag
from leactl.report.plot import PlotAxis

Array = npt.NDArray[np.float64]
TICKS = (5, 5)  # at most about so many along x and y: at 360 px, x labels have 47 px each
DRAWING_SIZE = 1000.0  # units of the drawing, across and down
GAP_STEPS = 10.0  # usual steps of a curve, beyond which its points do not belong together
LONGEST_TICK_TEXT = 7  # characters


@dataclass(frozen=True, eq=False)
class LineMarks:
    """A line through points."""

    name: str
    style: str
    x: Array
    y: Array
    whole: bool = False  # from end to end, however far its points are from each other
    labelled: bool = False  # its name stands on the line, and not in the legend

    def reach(self) -> tuple[Array, Array]:
        """What the axes have to hold."""
        return self.x, self.y

    def drawn(self, x: PlotAxis, y: PlotAxis) -> Html:
        """The path; a gap where a value is not finite, and where points were left out."""
        path, pen = [], "M"
        steps = np.diff(self.x, prepend=self.x[:1])
        follows_gap = steps > GAP_STEPS * np.nanmedian(steps) if len(steps) > 2 and not self.whole else steps == np.inf
        for x_value, y_value, starts_anew in zip(self.x.tolist(), self.y.tolist(), follows_gap.tolist(), strict=True):
            if not (math.isfinite(x_value) and math.isfinite(y_value)):
                pen = "M"
                continue
            path.append(f"{'M' if starts_anew else pen}{across(x, x_value)} {down(y, y_value)}")
            pen = "L"
        return tag("path", d="".join(path), class_=f"curve {self.style}")


@dataclass(frozen=True, eq=False)
class PointMarks:
    """A mark at each point; `style` says which."""

    name: str
    style: str
    x: Array
    y: Array

    def reach(self) -> tuple[Array, Array]:
        """What the axes have to hold."""
        finite = np.isfinite(self.x) & np.isfinite(self.y)
        return self.x[finite], self.y[finite]

    def drawn(self, x: PlotAxis, y: PlotAxis) -> Html:
        """Strokes of next to no length: their ends are the marks, and keep their shape in a drawing that is stretched.

        A PDF paints a stroke of no length with round ends alone (ISO 32000, 8.5.3.2): one with square ends has a tenth.
        """
        stroke = "h0.1" if "square" in self.style.split() else "h0"
        pairs = zip(*map(np.ndarray.tolist, self.reach()), strict=True)
        d = "".join(f"M{across(x, a)} {down(y, b)}{stroke}" for a, b in pairs)
        marks = tag("path", d=d, class_=f"marks {self.style}")
        return joined([marks, tag("path", d=d, class_="marks hole")]) if "ring" in self.style.split() else marks


@dataclass(frozen=True, eq=False)
class Bins:
    """Mean and standard deviation in bins: a bar about a stroke each."""

    name: str
    style: str
    low: Array
    high: Array
    mean: Array
    std: Array

    def reach(self) -> tuple[Array, Array]:
        """What the axes have to hold."""
        return np.concatenate([self.low, self.high]), np.concatenate([self.mean - self.std, self.mean + self.std])

    def drawn(self, x: PlotAxis, y: PlotAxis) -> Html:
        """Two paths: bars and strokes."""
        bars, strokes = [], []
        for a, b, mean, std in np.stack([self.low, self.high, self.mean, self.std], axis=1).tolist():
            start, end = across(x, a), across(x, b)
            bars.append(f"M{start} {down(y, mean - std)}H{end}V{down(y, mean + std)}H{start}Z")
            strokes.append(f"M{start} {down(y, mean)}H{end}")
        return joined(
            [
                tag("path", d="".join(bars), class_=f"area {self.style}"),
                tag("path", d="".join(strokes), class_=f"curve {self.style}"),
            ]
        )


@dataclass(frozen=True)
class AxisRange:
    """A part of one axis that is shaded."""

    name: str
    style: str
    low: float
    high: float
    upright: bool = True  # a part of x; else of y

    def reach(self) -> tuple[Array, Array]:
        """A part of x is cut at the axes; one of y has to be seen."""
        return np.empty(0), np.empty(0) if self.upright else np.asarray([self.low, self.high])

    def drawn(self, x: PlotAxis, y: PlotAxis) -> Html:
        """One rectangle across the other axis."""
        if self.upright:
            path = f"M{across(x, self.low)} 0H{across(x, self.high)}V{DRAWING_SIZE:g}H{across(x, self.low)}Z"
        else:
            path = f"M0 {down(y, self.low)}H{DRAWING_SIZE:g}V{down(y, self.high)}H0Z"
        return tag("path", d=path, class_=f"area {self.style}")


@dataclass(frozen=True, eq=False)
class Area:
    """Polygons of one colour, corners (x, y) each."""

    name: str
    style: str
    polygons: Sequence[Sequence[tuple[float, float]]]

    def reach(self) -> tuple[Array, Array]:
        """All corners."""
        corners = np.array([corner for polygon in self.polygons for corner in polygon]).reshape(-1, 2)
        return corners[:, 0], corners[:, 1]

    def drawn(self, x: PlotAxis, y: PlotAxis) -> Html:
        """One path."""
        rings = ["L".join(f"{across(x, a)} {down(y, b)}" for a, b in polygon) for polygon in self.polygons]
        return tag("path", d="".join(f"M{ring}Z" for ring in rings), class_=f"band {self.style}")


Layer = LineMarks | PointMarks | Bins | AxisRange | Area
Key = tuple[str, str]
NO_CURVE = LineMarks("", "", np.empty(0), np.empty(0))


def chart(
    layers: Sequence[Layer],
    x_label: str,
    y_label: str,
    beside: Sequence[Layer] = (),
    keys: Sequence[Key] = (),
    x_log: bool = False,
) -> Html:
    """Layers over each other, with ticks at round numbers and a legend.

    Parameters
    ----------
    beside : layers of another chart, which the axes are to hold too.
    keys : of the legend, style and name each; by default those of the layers, once a name.
    """
    extents = [layer.reach() for layer in (*layers, *beside)]
    x, y = axis([extent[0] for extent in extents], TICKS[0], x_log), axis([extent[1] for extent in extents], TICKS[1])
    if not keys:
        unnamed = [layer for layer in layers if not (isinstance(layer, LineMarks) and layer.labelled)]
        style_of_name = {layer.name: layer.style for layer in reversed(unnamed)}  # alike in name, the first has the key
        keys = [(style_of_name[name], name) for name in reversed(style_of_name)]
    x_ticks = {across(x, value): tick_text(value, text) for value, text in x.ticks.items()}
    y_ticks = {down(y, value): tick_text(value, text) for value, text in y.ticks.items()}
    grid = "".join([*(f"M{at} 0V{DRAWING_SIZE:g}" for at in x_ticks), *(f"M0 {at}H{DRAWING_SIZE:g}" for at in y_ticks)])
    drawing = tag(
        "svg",
        tag("path", d=grid, class_="grid"),
        *(layer.drawn(x, y) for layer in layers),
        viewBox=f"0 0 {DRAWING_SIZE:g} {DRAWING_SIZE:g}",
        preserveAspectRatio="none",
        data_x=f"{x.low:.12g} {x.high:.12g}",
        data_y=f"{y.low:.12g} {y.high:.12g}",
        role="img",
        aria_label=f"{y_label} over {x_label}: {', '.join(name for _, name in keys)}",
    )
    return tag(
        "div",
        legend(keys),
        tag("div", y_label, class_="y-label"),
        tag("div", *(tag("span", tick, style=f"top:{at / 10:.4g}%") for at, tick in y_ticks.items()), class_="y"),
        tag("div", drawing, *names_on_lines(layers, x, y), class_="drawing"),
        tag("div", *(tag("span", tick, style=f"left:{at / 10:.4g}%") for at, tick in x_ticks.items()), class_="x"),
        tag("div", x_label, class_="x-label"),
        class_="chart",
    )


def names_on_lines(layers: Sequence[Layer], x: PlotAxis, y: PlotAxis) -> list[Html]:
    """The names of lines that are labelled, each in the middle of the longest of its name."""
    longest: dict[str, LineMarks] = {}
    for layer in layers:
        if isinstance(layer, LineMarks) and layer.labelled and len(layer.x) > len(longest.get(layer.name, NO_CURVE).x):
            longest[layer.name] = layer
    labels = []
    for name, line in longest.items():
        middle = len(line.x) // 2
        x_percent, y_percent = across(x, float(line.x[middle])) / 10, down(y, float(line.y[middle])) / 10
        labels.append(tag("span", name, class_="on-line", style=f"left:{x_percent:.4g}%;top:{y_percent:.4g}%"))
    return labels


def legend(entries: Iterable[Key]) -> Html:
    """A swatch and a name each."""
    items = [tag("span", tag("i", class_=f"swatch {style}"), name, class_="key") for style, name in entries]
    return tag("div", *items, class_="legend")


def axis(values: Sequence[Array], ticks: int, log: bool = False) -> PlotAxis:
    """An axis over all finite values, on a logarithmic one over those above zero."""
    pooled = np.concatenate(values)
    finite = pooled[np.isfinite(pooled) & ((pooled > 0.0) | (not log))]
    return PlotAxis([float(finite.min()), float(finite.max())] if len(finite) else [0.0, 1.0], ticks, log)


def across(x: PlotAxis, value: float) -> float:
    """Where a value lies in the drawing, from the left, cut at its edges."""
    return round(DRAWING_SIZE * min(max(x.share(value), 0.0), 1.0), 1)


def down(y: PlotAxis, value: float) -> float:
    """Where a value lies in the drawing, from the top, cut at its edges."""
    return round(DRAWING_SIZE * min(max(1.0 - y.share(value), 0.0), 1.0), 1)


def tick_text(value: float, text: str) -> str:
    """A tick's text; a long one with an exponent."""
    return text if len(text) <= LONGEST_TICK_TEXT else f"{value:.3g}"
