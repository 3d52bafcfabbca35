"""Plots of a thermal fit: measured and fitted temperatures, residuals, resistance, and peak current over duration."""

from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import Estimate, Plot, Series
from leactl.analysis.heating.network import NetworkFit, camera_temperatures
from leactl.analysis.heating.record import Array
from leactl.analysis.heating.resistance import REFERENCE_TEMPERATURE, ResistanceLine
from leactl.model.winding import resistance_ratio

MOST_POINTS = 120  # of a curve in a figure
NODES = ("winding", "housing")


def plots_of(fit: NetworkFit, line: ResistanceLine, currents: Sequence[Estimate]) -> tuple[Plot, ...]:
    """Return the plots of temperatures, residuals, resistance and currents of a fit."""
    measured_points, fitted_lines, residual_points = [], [], []
    for record, fitted_temperatures, residual in zip(fit.records, fit.fitted_temperatures, fit.residuals, strict=True):
        for node, name in enumerate(NODES):
            measured_points.append(thinned_curve(name, record.time, camera_temperatures(record)[node]))
            fitted_lines.append(thinned_curve(f"{name}, fitted", record.time, fitted_temperatures[node]))
            residual_points.append(thinned_curve(name, record.time, residual[node]))
    end_temperatures = np.array([line.temperature.min(), line.temperature.max()])
    end_resistances = line.level * resistance_ratio(end_temperatures, line.coefficient, REFERENCE_TEMPERATURE)
    order = np.argsort(line.temperature)
    measured_resistance = thinned_curve("voltage over current", line.temperature[order], line.resistance[order])
    return (
        Plot("time [s]", "temperature [degC]", merged_by_label(measured_points), tuple(fitted_lines)),
        Plot("time [s]", "measured less fitted [K]", merged_by_label(residual_points), ()),
        Plot(
            "active windings [degC]",
            "resistance of two leads [ohm]",
            (measured_resistance,),
            (Series("fit", tuple(end_temperatures.tolist()), tuple(end_resistances.tolist())),),
        ),
        plot_of_currents(currents),
    )


def thinned_curve(label: str, x: Array, y: Array) -> Series:
    """Return a curve of at most `MOST_POINTS` points, each the mean over an equal part of the finite points, if any."""
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
    """Return one series for each label, with the points of all records."""
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
    """Return the plot of peak current over its duration, with both ends of the intervals as lines."""
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
    """Return how long the actuator can carry a peak current [s], as its name says."""
    return float(peak.name.removeprefix("peak_current_").partition("s")[0])
