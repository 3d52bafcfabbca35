"""The figures of a datasheet: the plots of the analyses, with conditions overlaid and sets of runs side by side."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from leactl.analysis.estimate import Plot, Series
from leactl.report.chart import Area, Chart, Key, Layer, LineMarks, PointMarks, chart
from leactl.report.datasheet.rows import DatasheetRow, ordered_conditions
from leactl.report.datasheet.runset import GroupResult, RunEntry, RunSet
from leactl.report.intervals import Interval, IntervalChart, intervals

COLOUR_COUNT = 6  # number of colours that the colour-blind can tell apart; classes s0 to s5 of datasheet.css
MARK_STYLES = ("dot", "ring", "square")
MOST_SHARED_KINDS = 2  # kinds of points (labels of series) in a figure that several conditions share
MOST_LEGEND_LINES = 2  # lines without points in a legend; if there are more, their names are on the lines
DENSE_POINTS = 40  # of a series; more points are drawn small, or as a line if no line was fitted to them
SPELLINGS = {"emf": "EMF", "coulomb": "Coulomb", "rmse": "RMSE"}
PRINTED_UNITS = {"degC": "°C", "ohm": "Ω", "mohm": "mΩ", "uH": "µH"}
UNIT = re.compile(rf"(?<![\w])({'|'.join(PRINTED_UNITS)})(?![\w])")


@dataclass(frozen=True)
class Figure:
    """One chart before its axes are known."""

    caption: str
    plot: Plot  # the first of the overlaid plots, for the labels of the axes
    layers: tuple[Layer, ...]
    keys: tuple[Key, ...]  # entries of the legend; empty for one entry for each layer
    entries: tuple[RunEntry, ...]


class LinkedChart(NamedTuple):
    """A chart with its caption, and the runs that the caption links to."""

    caption: str
    entries: tuple[RunEntry, ...]
    chart: Chart


def figures(sets: Sequence[RunSet], motors: Sequence[str], experiment: str) -> list[LinkedChart]:
    """Return the charts of all plots of one experiment; the charts of two sets of runs have the same axes.

    Parameters
    ----------
    motors : the motor of each set.
    """
    results_by_set = [run_set.results_of(motor, experiment) for run_set, motor in zip(sets, motors, strict=True)]
    all_results = [group for results in results_by_set for group in results]
    measured_conditions = {group.condition for group in all_results}
    condition_order = [condition for condition in ordered_conditions(all_results) if condition in measured_conditions]
    colours = {condition: f"s{index % COLOUR_COUNT}" for index, condition in enumerate(condition_order)}
    results_by_set = [
        sorted(results, key=lambda group: condition_order.index(group.condition)) for results in results_by_set
    ]
    plot_count = max((len(group.result.plots) for group in all_results), default=0)
    charts = []
    for index in range(plot_count):
        drawings_by_set = [figures_of(results, index, colours) for results in results_by_set]
        for set_index, drawings in enumerate(drawings_by_set):
            other_drawings = drawings_by_set[:set_index] + drawings_by_set[set_index + 1 :]
            other_layers = [
                layer for set_drawings in other_drawings for drawing in set_drawings for layer in drawing.layers
            ]
            caption_prefix = f"{sets[set_index].name}: " if len(sets) > 1 else ""
            charts += [linked_chart(drawing, other_layers, caption_prefix) for drawing in drawings]
    return charts


def linked_chart(drawing: Figure, included_in_axes: Sequence[Layer], caption_prefix: str) -> LinkedChart:
    """Return the chart of a figure with its caption and runs; its axes also contain the layers `included_in_axes`."""
    axis_labels = pretty(drawing.plot.x_label), pretty(drawing.plot.y_label)
    drawn_chart = chart(drawing.layers, *axis_labels, included_in_axes, drawing.keys, drawing.plot.x_log)
    return LinkedChart(f"{caption_prefix}{drawing.caption}", drawing.entries, drawn_chart)


def figures_of(results: Sequence[GroupResult], index: int, colours: Mapping[str, str]) -> list[Figure]:
    """Return figures of plot `index` of the results.

    The conditions of an actuator share one figure if they have the same axes, few series of points, and a colour each.
    """
    results_with_plot = [group for group in results if index < len(group.result.plots)]
    drawings = []
    for actuator in dict.fromkeys(group.actuator for group in results_with_plot):
        actuator_results = [group for group in results_with_plot if group.actuator == actuator]
        point_kinds = {series.label for group in actuator_results for series in group.result.plots[index].points}
        axis_labels = {
            (group.result.plots[index].x_label, group.result.plots[index].y_label) for group in actuator_results
        }
        is_shared = (
            len(point_kinds) <= MOST_SHARED_KINDS
            and len(axis_labels) == 1
            and 1 < len(actuator_results) <= COLOUR_COUNT
        )
        for shared_groups in [actuator_results] if is_shared else [[group] for group in actuator_results]:
            plots = [group.result.plots[index] for group in shared_groups]
            entries = tuple(entry for group in shared_groups for entry in group.entries)
            layers, keys = overlaid_layers(shared_groups, plots, colours) if is_shared else (plot_layers(plots[0]), [])
            caption_parts = (subject(plots[0]), actuator, "" if is_shared else shared_groups[0].condition)
            drawings.append(
                Figure(", ".join(filter(None, caption_parts)), plots[0], tuple(layers), tuple(keys), entries)
            )
    return drawings


def plot_layers(plot: Plot) -> list[Layer]:
    """Return the layers of one plot: a colour for each series of points and its fitted lines, grey for other lines."""
    if plot.bands:
        return map_layers(plot)
    colours = {series.label: f"s{index % COLOUR_COUNT}" for index, series in enumerate(plot.points)}
    marks = {series.label: MARK_STYLES[index % len(MARK_STYLES)] for index, series in enumerate(plot.points)}
    layers: list[Layer] = []
    names_on_lines = len({line.label for line in plot.lines if not kind_of(line, colours)}) > MOST_LEGEND_LINES
    for line in plot.lines:
        kind = kind_of(line, colours)
        style = f"line {colours[kind]}" if kind == line.label else f"line thin {colours.get(kind, 'other')}"
        layers.append(LineMarks(line.label, style, *arrays(line), connected=True, labelled=names_on_lines and not kind))
    layers += [
        point_layer(series, series.label, colours[series.label], marks[series.label], plot) for series in plot.points
    ]
    return points_first(layers)


def map_layers(plot: Plot) -> list[Layer]:
    """Return the layers of a map: coloured bands, contours labelled with their level, a mark at each measured point."""
    bands: list[Layer] = [
        Area(band.label, f"b{index}", band.polygons) for index, band in enumerate(plot.bands) if band.polygons
    ]
    contours = [LineMarks(line.label, "contour", *arrays(line), connected=True, labelled=True) for line in plot.lines]
    x, y = (np.concatenate([arrays(series)[axis] for series in plot.points]) for axis in (0, 1))
    return [*bands, *contours, PointMarks("measured", "fine other", x, y)]


def subject(plot: Plot) -> str:
    """Return `y over x`, the names of a plot's axes without units."""
    return f"{plot.y_label.partition(' [')[0]} over {plot.x_label.partition(' [')[0]}"


def overlaid_layers(
    results: Sequence[GroupResult], plots: Sequence[Plot], colours: Mapping[str, str]
) -> tuple[list[Layer], list[Key]]:
    """Return layers and legend of overlaid conditions: a colour for each condition, a mark for each kind of points."""
    point_kinds = list(dict.fromkeys(series.label for plot in plots for series in plot.points))
    layers: list[Layer] = []
    for group, plot in zip(results, plots, strict=True):
        colour = colours[group.condition]
        for line in plot.lines:
            is_fit = kind_of(line, dict.fromkeys(point_kinds)) == line.label
            layers.append(
                LineMarks(
                    group.condition,
                    f"line {colour}" if is_fit else f"line thin {colour}",
                    *arrays(line),
                    connected=True,
                )
            )
        layers += [
            point_layer(series, series.label, colour, MARK_STYLES[point_kinds.index(series.label)], plot)
            for series in plot.points
        ]
    keys = [(f"line {colours[group.condition]}", group.condition) for group in results]
    keys += (
        [(f"{MARK_STYLES[index]} other", kind) for index, kind in enumerate(point_kinds)]
        if len(point_kinds) > 1
        else []
    )
    return points_first(layers), keys


def point_layer(series: Series, name: str, colour: str, mark: str, plot: Plot) -> Layer:
    """Return the layer of a series of points: marks, or a line through more than DENSE_POINTS in ascending order of x.

    Points to which a line was fitted stay marks. A horizontal line does not count: it is a threshold or a mean.
    """
    x, y = arrays(series)
    has_fit = any(line.label.startswith(series.label) or len(set(line.y)) > 1 for line in plot.lines)
    if len(x) > DENSE_POINTS and not has_fit and bool(np.all(np.diff(x) > 0.0)):
        return LineMarks(name, f"line {colour}", x, y)
    is_dense = max(len(drawn_series.x) for drawn_series in plot.points) > DENSE_POINTS
    return PointMarks(name, f"fine {colour}" if is_dense else f"{mark} {colour}", x, y)


def points_first(layers: Sequence[Layer]) -> list[Layer]:
    """Return the layers with points before lines: later layers are drawn on top, where points would hide lines."""
    return sorted(layers, key=lambda layer: isinstance(layer, LineMarks))


def kind_of(line: Series, kinds: dict[str, str] | dict[str, None]) -> str:
    """Return the kind of points that a line belongs to: the longest name that its label begins with; empty if none."""
    return max((kind for kind in kinds if line.label.startswith(kind)), key=len, default="")


def arrays(series: Series) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of a series as arrays of the same length."""
    return np.asarray(series.x, np.float64), np.asarray(series.y, np.float64)


def over_conditions(rows: Sequence[DatasheetRow], sets: Sequence[RunSet]) -> list[tuple[str, IntervalChart]]:
    """Return a name and a chart of 95 % intervals for each result with several intervals, over conditions or sets."""
    charts = []
    for name in dict.fromkeys(row.name for row in rows):
        rows_of_result = [row for row in rows if row.name == name]
        interval_rows = [
            Interval(
                ", ".join(
                    filter(
                        None, (row.condition, row.actuator, sets[set_index].name if len(sets) > 1 else "", cell.whose)
                    )
                )
                or "all",
                f"dot s{set_index % COLOUR_COUNT}",
                cell.estimate.value,
                cell.estimate.low,
                cell.estimate.high,
                row.paper,
            )
            for row in rows_of_result
            for set_index, cell in enumerate(row.cells)
            if cell.estimate is not None and np.isfinite(cell.estimate.std)
        ]
        if len(interval_rows) > 1:
            label = pretty(f"{plain(name)} [{rows_of_result[0].units}]")
            charts.append((plain(name), intervals(interval_rows, label)))
    return charts


def plain(name: str) -> str:
    """Return the name of a result or an experiment in words: `back_emf_constant` as `back EMF constant`."""
    words = re.split("[_-]", name)
    return " ".join(SPELLINGS.get(word, word) for word in words)


def heading(name: str) -> str:
    """Return a name in words that begin with a capital letter."""
    text = plain(name)
    return text[:1].upper() + text[1:]


def pretty(text: str) -> str:
    """Return a text with units as they are printed: `N*m/s^2` as `N·m/s²`, and without the unit `[1]` of a ratio."""
    printed = text.replace("*", "·").replace("^2", "²").replace("^3", "³").replace(" [1]", "")
    return UNIT.sub(lambda match: PRINTED_UNITS[match[0]], printed)
