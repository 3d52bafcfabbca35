"""Resistance between two leads over the temperature of the active windings, which carry the current.

Paper, section "Thermal Dynamics": R = R0 (1 + alpha (T - T0)), voltage over current while the supply is on.
The camera's noise in the temperatures would lower the slope of a plain fit; the mean of the temperatures before and
after serves as instrumental variable, since its noise is independent. The clocks are aligned by the switching of the
current, whose moment between two readings is not known. They may differ by half a reading; the error that this causes
while the winding warms is part of the uncertainty.
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
LEAST_BIN_S, FEWEST_READINGS_IN_BIN = 1.0, 3  # width of a bin, and readings and frames in it
FEWEST_BINS = 30
LEAST_ON_S = SETTLING_S + (FEWEST_BINS + 2) * LEAST_BIN_S + SWITCHING_S  # each bin needs a neighbour before and after


@dataclass(frozen=True, eq=False)
class ResistanceLine:
    """R = level (1 + coefficient (T - 25 degC)) of two leads in series."""

    level: float  # ohm
    coefficient: float  # 1/K
    noise: Array  # covariance of both as (ohm, 1/K), from noise
    drift: Array  # the same from drift
    timing: Array  # the same from the unknown difference of the clocks
    dof: float  # degrees of freedom of the drift's variance
    r_squared: float
    temperature: Array  # degC, of the points that the line is fitted to
    resistance: Array  # ohm, of these points


def resistance_line(fit: NetworkFit, error_prefix: str) -> ResistanceLine:
    """Fit the resistance of two leads over the temperature of the active windings.

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
        raise NotIdentifiable(
            f"{error_prefix}: the current was on, and the active windings seen, for too short a time to tell their"
            f" resistance; {LEAST_ON_S:g} s are needed"
        )
    design = np.column_stack([np.ones(len(time)), temperature - REFERENCE_TEMPERATURE])
    instruments = np.column_stack([np.ones(len(time)), neighbour_temperature - REFERENCE_TEMPERATURE])
    inverse = np.linalg.inv(instruments.T @ design)
    level, slope = inverse @ (instruments.T @ resistance)
    residuals = resistance - design @ np.array([level, slope])
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
    jacobian = np.array([[1.0, 0.0], [-slope / level**2, 1.0 / level]]) @ inverse
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
        temperature,
        resistance,
    )


def means_while_on(record: HeatingRecord, lag: float, rates: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return means over bins while the current is on, shape (bins,) each.

    They are time [s], temperature of the active windings [degC], mean of the temperatures in the bins before and after
    [degC], rate of the winding's temperature [K/s], and resistance [ohm].
    """
    supply, stamps = record.supply, record.time - lag
    changes = np.flatnonzero(np.diff(supply.on.astype(np.int8), prepend=0, append=0))
    steady = np.zeros(len(supply.time), bool)
    for first, last in zip(changes[::2], changes[1::2] - 1, strict=True):
        start = supply.time[first] + (SETTLING_S if first else 0.0)
        steady |= (supply.time > start) & (supply.time < supply.time[last] - SWITCHING_S)
    bin_width = max(
        LEAST_BIN_S, FEWEST_READINGS_IN_BIN * float(max(np.median(np.diff(clock)) for clock in (supply.time, stamps)))
    )
    by_supply, by_camera = (((clock - supply.time[0]) / bin_width).astype(np.int64) for clock in (supply.time, stamps))
    bins = int(by_supply[-1]) + 1
    valid = np.isfinite(record.active) & (by_camera < bins)
    bin_complete = np.bincount(by_supply[steady], minlength=bins) == np.bincount(by_supply, minlength=bins)
    with np.errstate(invalid="ignore", divide="ignore"):
        frames = np.bincount(by_camera[valid], minlength=bins)
        temperature, rate, frame_time = (
            np.bincount(by_camera[valid], column[valid], bins) / frames for column in (record.active, rates[0], stamps)
        )
        time = np.bincount(by_supply, supply.time, bins) / np.bincount(by_supply, minlength=bins)
        temperature += rate * (time - frame_time)
        resistance = np.bincount(by_supply, supply.voltage, bins) / np.bincount(by_supply, supply.current, bins)
    neighbour_temperature = np.full(bins, np.nan)
    neighbour_temperature[1:-1] = 0.5 * (temperature[2:] + temperature[:-2])
    usable = bin_complete & np.isfinite(temperature) & np.isfinite(neighbour_temperature) & np.isfinite(resistance)
    return time[usable], temperature[usable], neighbour_temperature[usable], rate[usable], resistance[usable]
