"""Plots of a thermal fit: measured and fitted temperatures, residuals, resistance, and peak current over duration."""

from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import Estimate, Plot, Series
from leactl.analysis.heating.network import NetworkFit, camera_temperatures
from leactl.analysis.heating.record import Array
from leactl.analysis.heating.resistance import REFERENCE_TEMPERATURE, ResistanceLine
from leactl.model.winding import resistance_ratio

MOST_POINTS = 120  # of a curve
NODES = ("winding", "housing")


def plots_of(fit: NetworkFit, line: ResistanceLine, currents: Sequence[Estimate]) -> tuple[Plot, ...]:
    """Plot temperatures, residuals, resistance and currents."""
    measured_points, lines, residual_points = [], [], []
    for record, fitted, residual in zip(fit.records, fit.fitted, fit.residuals, strict=True):
        for node, name in enumerate(NODES):
            measured_points.append(thinned_curve(name, record.time, camera_temperatures(record)[node]))
            lines.append(thinned_curve(f"{name}, fitted", record.time, fitted[node]))
            residual_points.append(thinned_curve(name, record.time, residual[node]))
    temperatures = np.array([line.temperature.min(), line.temperature.max()])
    resistances = line.level * resistance_ratio(temperatures, line.coefficient, REFERENCE_TEMPERATURE)
    order = np.argsort(line.temperature)
    measurements = thinned_curve("voltage over current", line.temperature[order], line.resistance[order])
    return (
        Plot("time [s]", "temperature [degC]", merged_by_label(measured_points), tuple(lines)),
        Plot("time [s]", "measured less fitted [K]", merged_by_label(residual_points), ()),
        Plot(
            "active windings [degC]",
            "resistance of two leads [ohm]",
            (measurements,),
            (Series("fit", tuple(temperatures.tolist()), tuple(resistances.tolist())),),
        ),
        plot_of_currents(currents),
    )


def thinned_curve(label: str, x: Array, y: Array) -> Series:
    """Return a curve of at most `MOST_POINTS` points, each the mean over an even part of the finite values, if any."""
    finite = np.isfinite(y)
    x, y = x[finite], y[finite]
    if not len(x):
        return Series(label, (), ())
    parts = np.array_split(np.arange(len(x)), min(MOST_POINTS, len(x)))
    return Series(
        label,
        tuple(float(np.mean(x[indices])) for indices in parts),
        tuple(float(np.mean(y[indices])) for indices in parts),
    )


def merged_by_label(series: Sequence[Series]) -> tuple[Series, ...]:
    """Join the points of each label over all records."""
    labels = dict.fromkeys(curve.label for curve in series)
    return tuple(
        Series(
            label,
            tuple(x for curve in series if curve.label == label for x in curve.x),
            tuple(y for curve in series if curve.label == label for y in curve.y),
        )
        for label in labels
    )


def plot_of_currents(currents: Sequence[Estimate]) -> Plot:
    """Plot peak current over its duration, with both ends of the intervals as lines."""
    points, lines = [], []
    for label, motion in (("all phases alike", "s"), ("standing", "s_standing")):
        peaks = [peak for peak in currents if peak.name.startswith("peak")]
        peaks_of_motion = [
            peak for peak in peaks if peak.name.removeprefix("peak_current_").lstrip("0123456789.") == motion
        ]
        time = tuple(duration_of(peak) for peak in peaks_of_motion)
        points.append(Series(label, time, tuple(peak.value for peak in peaks_of_motion)))
        lines.append(Series(f"{label}, low", time, tuple(peak.low for peak in peaks_of_motion)))
        lines.append(Series(f"{label}, high", time, tuple(peak.high for peak in peaks_of_motion)))
    return Plot("duration [s]", "current [A]", tuple(points), tuple(lines), x_log=True)


def duration_of(peak: Estimate) -> float:
    """Return how long a peak current is carried [s], from its name."""
    return float(peak.name.removeprefix("peak_current_").partition("s")[0])
