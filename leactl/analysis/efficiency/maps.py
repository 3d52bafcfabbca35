"""Efficiency maps as in the paper: torque over speed and current over voltage, driven points to the left of zero."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from leactl.analysis.efficiency.contours import Polygon, band_polygons, contours
from leactl.analysis.efficiency.means import MapMeans
from leactl.analysis.estimate import Band, Grid, Plot, Series
from leactl.analysis.statistics.regression import Array

CONTOUR_LEVELS = (-1.0, -0.5, 0.0, 0.2, 0.4, 0.5, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9)
EFFICIENCY_CLASSES = {  # lower and upper end of each class; the paper marks the first class in black
    "below -100 %": (-np.inf, -1.0),
    "-100 to 0 %": (-1.0, 0.0),
    "0 to 50 %": (0.0, 0.5),
    "50 % and more": (0.5, np.inf),
}
GRID_QUANTITIES = {  # attribute of `Balance`, by the column of a grid
    "efficiency_1": "efficiency", "torque_Nm": "torque", "velocity_rad_s": "speed", "q_axis_voltage_V": "voltage",
    "q_axis_current_A": "current", "electrical_W": "electrical", "mechanical_W": "mechanical", "loss_W": "loss",
    "copper_W": "copper", "friction_W": "friction",
}  # fmt: skip


def grid_of(means: MapMeans, name: str) -> Grid:
    """Return every quantity at every point of the grid; NaN at points that the bench did not hold."""
    columns = {key: means.over_map(quantity) for key, quantity in GRID_QUANTITIES.items()}
    columns["efficiency_std_1"] = np.where(means.counts > 0, means.std_over_map("efficiency"), np.nan)
    values = {key: tuple(tuple(row) for row in column.tolist()) for key, column in columns.items()}
    axes = {"velocity_rad_s": tuple(means.speeds.tolist()), "current_A": tuple(means.currents.tolist())}
    return Grid(name, axes, values)


def speeds_and_torques(maps: Sequence[MapMeans]) -> Plot:
    """Return the plot of efficiency over the magnitudes of speed and torque; the speed of driven points is negative."""

    def x(means: MapMeans) -> Array:
        return np.abs(means.over_map("speed")) * (1.0 if means.driving else -1.0)

    return _plot(
        maps,
        "speed, negative where driven [rad/s]",
        "shaft torque [N*m]",
        x,
        lambda means: np.abs(means.over_map("torque")),
    )


def currents_and_voltages(maps: Sequence[MapMeans]) -> Plot:
    """Return the plot of efficiency over voltage and current; the voltage is negative if the actuator gives power."""

    def x(means: MapMeans) -> Array:
        return np.asarray(means.over_map("voltage") * np.sign(means.over_map("current")))

    return _plot(
        maps,
        "voltage, negative where power is given [V]",
        "current [A]",
        x,
        lambda means: np.abs(means.over_map("current")),
    )


def _plot(
    maps: Sequence[MapMeans], x_label: str, y_label: str, x: Callable[[MapMeans], Array], y: Callable[[MapMeans], Array]
) -> Plot:
    """Return the plot of all maps, with points by class of efficiency, contour lines and bands."""
    points: dict[str, tuple[list[float], list[float]]] = {label: ([], []) for label in EFFICIENCY_CLASSES}
    lines = []
    level_ranges = list(itertools.pairwise((-np.inf, *CONTOUR_LEVELS, np.inf)))
    polygons: list[list[Polygon]] = [[] for _ in level_ranges]
    for means in maps:
        x_values, y_values, efficiency = x(means), y(means), means.over_map("efficiency")
        for label, (low, high) in EFFICIENCY_CLASSES.items():
            in_class = (efficiency >= low) & (efficiency < high)
            points[label][0].extend(x_values[in_class].tolist())
            points[label][1].extend(y_values[in_class].tolist())
        for level in CONTOUR_LEVELS:
            lines += [Series(f"{level:.0%}", *line) for line in contours(x_values, y_values, efficiency, level)]
        for level_polygons, (low, high) in zip(polygons, level_ranges, strict=True):
            level_polygons += band_polygons(x_values, y_values, efficiency, low, high)
    series = tuple(Series(label, tuple(xs), tuple(ys)) for label, (xs, ys) in points.items() if xs)
    bands = tuple(
        Band(band_label(*level_range), tuple(level_polygons))
        for level_range, level_polygons in zip(level_ranges, polygons, strict=True)
    )
    return Plot(x_label, y_label, series, tuple(lines), bands=bands)


def band_label(low: float, high: float) -> str:
    """Return the label of the band between two efficiencies, one of which may be infinite."""
    if low == -np.inf:
        return f"below {high:.0%}"
    return f"{low:.0%} and more" if high == np.inf else f"{low:.0%} to {high:.0%}"
