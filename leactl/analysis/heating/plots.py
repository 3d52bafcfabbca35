"""Plots of a thermal fit: temperatures measured and fitted, residuals, resistance, and what may be carried how long."""

from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import Estimate, Plot, Series
from leactl.analysis.heating.network import NetworkFit, measured
from leactl.analysis.heating.record import Array
from leactl.analysis.heating.resistance import REFERENCE, ResistanceLine

DRAWN = 120  # points of a curve
NODES = ("winding", "housing")


def plots_of(fit: NetworkFit, line: ResistanceLine, currents: Sequence[Estimate]) -> tuple[Plot, ...]:
    """All of them, each curve in means of so many frames that it can be drawn."""
    points, lines, left = [], [], []
    for stretch, fitted, residual in zip(fit.stretches, fit.fitted, fit.residuals, strict=True):
        for node, name in enumerate(NODES):
            points.append(drawn(name, stretch.time, measured(stretch)[node]))
            lines.append(drawn(f"{name}, fitted", stretch.time, fitted[node]))
            left.append(drawn(name, stretch.time, residual[node]))
    ends = np.array([line.temperature.min(), line.temperature.max()])
    through = line.level * (1.0 + line.coefficient * (ends - REFERENCE))
    order = np.argsort(line.temperature)
    measurements = drawn("voltage over current", line.temperature[order], line.resistance[order])
    return (
        Plot("time [s]", "temperature [degC]", merged(points), tuple(lines)),
        Plot("time [s]", "measured less fitted [K]", merged(left), ()),
        Plot(
            "active windings [degC]",
            "resistance of two leads [ohm]",
            (measurements,),
            (Series("fit", tuple(ends.tolist()), tuple(through.tolist())),),
        ),
        plot_of_currents(currents),
    )


def drawn(label: str, x: Array, y: Array) -> Series:
    """A curve in means over even parts of what was seen."""
    seen = np.isfinite(y)
    x, y = x[seen], y[seen]
    parts = [part for part in np.array_split(np.arange(len(x)), min(DRAWN, len(x))) if len(part)]
    return Series(
        label, tuple(float(np.mean(x[part])) for part in parts), tuple(float(np.mean(y[part])) for part in parts)
    )


def merged(series: Sequence[Series]) -> tuple[Series, ...]:
    """Points of one label together, whichever stretch they are from."""
    labels = dict.fromkeys(one.label for one in series)
    return tuple(
        Series(
            label,
            tuple(x for one in series if one.label == label for x in one.x),
            tuple(y for one in series if one.label == label for y in one.y),
        )
        for label in labels
    )


def plot_of_currents(currents: Sequence[Estimate]) -> Plot:
    """Peak current over its duration, decade by decade, with both ends of the intervals as lines."""
    points, lines = [], []
    for label, motion in (("all phases alike", "s"), ("standing", "s_standing")):
        peaks = [one for one in currents if one.name.startswith("peak")]
        chosen = [one for one in peaks if one.name.removeprefix("peak_current_").lstrip("0123456789.") == motion]
        time = tuple(duration_of(one) for one in chosen)
        points.append(Series(label, time, tuple(one.value for one in chosen)))
        lines.append(Series(f"{label}, low", time, tuple(one.low for one in chosen)))
        lines.append(Series(f"{label}, high", time, tuple(one.high for one in chosen)))
    return Plot("duration [s]", "current [A]", tuple(points), tuple(lines), x_log=True)


def duration_of(peak: Estimate) -> float:
    """How long a peak current is carried [s]."""
    return float(peak.name.removeprefix("peak_current_").partition("s")[0])
