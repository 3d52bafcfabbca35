"""Resistance between two leads over the temperature of the active windings, which carry the current.

Paper, section "Thermal Dynamics": R = R0 (1 + alpha (T - T0)), voltage over current while the supply is on.
The camera's noise in the temperatures would lower the slope of a plain fit; the mean of the temperatures before and
after serves as instrumental variable, since its noise is independent. The clocks are aligned by the switching of the
current, whose moment between two readings is not known. They may differ by half a reading interval; the error that
this causes while the winding warms is part of the uncertainty.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from leactl.analysis.heating.network import NetworkFit
from leactl.analysis.heating.record import Array, HeatingRecord
from leactl.analysis.heating.scatter import binned_residuals, covariance_of_sums, scatter_of
from leactl.errors import NotIdentifiable

REFERENCE_TEMPERATURE = 25.0  # degC, of the resistance that is stated
SETTLING_S = 30.0  # left out after the current is switched on: the surface that a camera sees lags the copper
SWITCHING_S = 2.0  # left out before the current is switched off
SHORTEST_BIN_S, FEWEST_READINGS_IN_BIN = 1.0, 3  # width of a bin, and readings as well as frames in it
FEWEST_BINS = 30


@dataclass(frozen=True, eq=False)
class ResistanceLine:
    """Fitted line R = level (1 + coefficient (T - 25 degC)) of the resistance between two leads."""

    level: float  # ohm
    coefficient: float  # 1/K
    noise: Array  # covariance of level and coefficient by noise, shape (2, 2)
    drift: Array  # their covariance by drift
    timing: Array  # their covariance by the unknown difference of the clocks
    dof: float  # degrees of freedom of the drift's variance
    r_squared: float
    changes: dict[str, float]  # by run: relative change of the resistance from the first run, where it is fitted
    temperature: Array  # degC, of the points that the line is fitted to
    resistance: Array  # ohm, of these points


def resistance_line(fit: NetworkFit, error_prefix: str) -> ResistanceLine:
    """Fit the resistance of two leads over the temperature of the active windings.

    Where the heat of a run is fitted relative to that of the first run, so is its resistance: voltage and current are
    read by the same supply.

    Raises
    ------
    NotIdentifiable : the current was on for too short a time; `error_prefix` opens the message.
    """
    means_by_record = [
        means_while_on(record, lag, rates) for record, lag, rates in zip(fit.records, fit.lags, fit.rates, strict=True)
    ]
    time, temperature, neighbour_temperature, rate, resistance = (
        np.concatenate(column) for column in zip(*means_by_record, strict=True)
    )
    if len(time) < FEWEST_BINS or np.ptp(neighbour_temperature) <= 0.0:
        widest_bin = max(bin_width_of(record) for record in fit.records)
        raise NotIdentifiable(
            f"{error_prefix}: the current was on, and the active windings seen, for too short a time to tell their"
            f" resistance; about {shortest_on_time(widest_bin):.0f} s are needed"
        )
    path_of_point = np.repeat([record.run_path for record in fit.records], [len(means[0]) for means in means_by_record])
    changed_runs = [path for path in fit.heat_changes if (path_of_point == path).any()]
    # a change of r in R = r R + level + slope (T - 25 degC), with the readings themselves on the right
    changed = [np.where(path_of_point == path, resistance, 0.0) for path in changed_runs]
    design = np.column_stack([np.ones(len(time)), temperature - REFERENCE_TEMPERATURE, *changed])
    instruments = np.column_stack([np.ones(len(time)), neighbour_temperature - REFERENCE_TEMPERATURE, *changed])
    inverse = np.linalg.inv(instruments.T @ design)
    level, slope, *changes = coefficients = inverse @ (instruments.T @ resistance)
    residuals = resistance - design @ coefficients
    edges = np.cumsum([0, *(len(means[0]) for means in means_by_record)])
    record_slices = [slice(start, stop) for start, stop in itertools.pairwise(edges.tolist()) if stop > start]
    bins = binned_residuals(
        [time[of_record] for of_record in record_slices],
        [residuals[None, of_record] for of_record in record_slices],
        [instruments[None, of_record] for of_record in record_slices],
    )
    scatter = scatter_of(bins).model_average
    sums = [covariance_of_sums(record_bins, scatter) for record_bins in bins]
    # from (level, slope) to (level, coefficient); the coefficient is slope over level
    jacobian = np.array([[1.0, 0.0], [-slope / level**2, 1.0 / level]]) @ inverse[:2]
    noise, drift = (jacobian @ sum(record_sums[source] for record_sums in sums) @ jacobian.T for source in (0, 1))
    timing_slopes = jacobian @ (instruments.T @ (slope * rate))
    reading_interval = max(float(np.median(np.diff(record.supply.time))) for record in fit.records)
    total_square = float(np.sum((resistance - resistance.mean()) ** 2))
    return ResistanceLine(
        float(level),
        float(slope / level),
        noise,
        drift,
        reading_interval**2 / 12.0 * np.outer(timing_slopes, timing_slopes),
        scatter.dof,
        1.0 - float(residuals @ residuals) / total_square if total_square > 0.0 else math.nan,
        dict(zip(changed_runs, map(float, changes), strict=True)),
        temperature,
        resistance,
    )


def shortest_on_time(bin_width: float) -> float:
    """Return how long the current has to be on [s] for enough bins of this width [s], each between two others."""
    return SETTLING_S + (FEWEST_BINS + 2) * bin_width + SWITCHING_S


def bin_width_of(record: HeatingRecord) -> float:
    """Return the width [s] of bins that hold enough readings of the supply and enough frames."""
    intervals = (np.median(np.diff(clock)) for clock in (record.supply.time, record.time))
    return max(SHORTEST_BIN_S, FEWEST_READINGS_IN_BIN * float(max(intervals)))


def means_while_on(record: HeatingRecord, lag: float, rates: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return means over the bins in which the current is on throughout, shape (bins,) each.

    They are time [s], temperature of the active windings [degC], mean of the temperatures in the bins before and after
    [degC], rate of the winding's temperature [K/s], and resistance [ohm]. `lag` [s] is that of the camera's
    clock, `rates` are those of the fitted temperatures [K/s], shape (2, frames).
    """
    supply, stamps = record.supply, record.time - lag
    switch_indices = np.flatnonzero(np.diff(supply.on.astype(np.int8), prepend=0, append=0))
    settled = np.zeros(len(supply.time), bool)
    for first, last in zip(switch_indices[::2], switch_indices[1::2] - 1, strict=True):
        start = supply.time[first] + (SETTLING_S if first else 0.0)
        settled |= (supply.time > start) & (supply.time < supply.time[last] - SWITCHING_S)
    bin_width = bin_width_of(record)
    bin_of_reading, bin_of_frame = (
        np.floor((clock - supply.time[0]) / bin_width).astype(np.int64) for clock in (supply.time, stamps)
    )
    bin_count = int(bin_of_reading[-1]) + 1
    valid_frames = np.isfinite(record.active) & (bin_of_frame >= 0) & (bin_of_frame < bin_count)
    bin_complete = np.bincount(bin_of_reading[settled], minlength=bin_count) == np.bincount(
        bin_of_reading, minlength=bin_count
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        frames_in_bin = np.bincount(bin_of_frame[valid_frames], minlength=bin_count)
        temperature, rate, frame_time = (
            np.bincount(bin_of_frame[valid_frames], column[valid_frames], bin_count) / frames_in_bin
            for column in (record.active, rates[0], stamps)
        )
        time = np.bincount(bin_of_reading, supply.time, bin_count) / np.bincount(bin_of_reading, minlength=bin_count)
        temperature += rate * (time - frame_time)
        resistance = np.bincount(bin_of_reading, supply.voltage, bin_count) / np.bincount(
            bin_of_reading, supply.current, bin_count
        )
    neighbour_temperature = np.full(bin_count, np.nan)
    neighbour_temperature[1:-1] = 0.5 * (temperature[2:] + temperature[:-2])
    usable = bin_complete & np.isfinite(temperature) & np.isfinite(neighbour_temperature) & np.isfinite(resistance)
    return time[usable], temperature[usable], neighbour_temperature[usable], rate[usable], resistance[usable]
