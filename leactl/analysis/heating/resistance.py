"""Resistance between two leads against the temperature of the active windings, which carry the current.

Paper, section "Thermal Dynamics": R = R0 (1 + alpha (T - T0)), voltage over current while the supply is on.
Temperatures carry the camera's noise, which would lower the slope; the readings before and after serve as instrument,
since noise from frame to frame is not in them. When a current was switched between two readings is not known, so that
clocks that were aligned by it may be off by half a reading; what that makes of a winding that warms is part of the
uncertainty.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from leactl.analysis.heating.network import NetworkFit
from leactl.analysis.heating.record import Array, HeatingRecord
from leactl.analysis.heating.scatter import binned_residuals, covariance_of_sums, scatter_of
from leactl.errors import NotIdentifiable

REFERENCE = 25.0  # degC, at which the resistance is told
SETTLING_S = 30.0  # after it is switched on: the surface that a camera sees is behind the copper
SWITCHING_S = 2.0  # before it is switched off
PACE_S, READINGS = 1.0, 3  # bins of the line: at least so long [s], and so many readings and frames
FEWEST = 30  # means
LEAST_ON_S = SETTLING_S + (FEWEST + 2) * PACE_S + SWITCHING_S  # each mean lies between two others


@dataclass(frozen=True, eq=False)
class ResistanceLine:
    """R = level (1 + coefficient (T - 25 degC)) of two leads in series."""

    level: float  # ohm
    coefficient: float  # 1/K
    noise: Array  # covariance of both as (ohm, 1/K), from noise
    drift: Array  # the same from drift
    timing: Array  # the same from what is not known of the clocks
    dof: float  # that the drift rests on
    r_squared: float
    temperature: Array  # degC, what the line goes through
    resistance: Array  # ohm


def resistance_line(fit: NetworkFit, place: str) -> ResistanceLine:
    """Fit the resistance of two leads over the temperature of the active windings.

    Raises
    ------
    NotIdentifiable : the current was on for too short a time; `place` opens the message.
    """
    readings = [while_on(*record_sums) for record_sums in zip(fit.records, fit.lags, fit.rates, strict=True)]
    time, temperature, neighbour_temperature, rate, resistance = (
        np.concatenate(column) for column in zip(*readings, strict=True)
    )
    if len(time) < FEWEST or np.ptp(neighbour_temperature) <= 0.0:
        raise NotIdentifiable(
            f"{place}: the current was on, and the active windings seen, for too short a time to tell their resistance;"
            f" {LEAST_ON_S:g} s are needed"
        )
    design = np.column_stack([np.ones(len(time)), temperature - REFERENCE])
    instruments = np.column_stack([np.ones(len(time)), neighbour_temperature - REFERENCE])
    inverse = np.linalg.inv(instruments.T @ design)
    level, slope = inverse @ (instruments.T @ resistance)
    residuals = resistance - design @ np.array([level, slope])
    edges = np.cumsum([0, *(len(record_sums[0]) for record_sums in readings)])
    record_slices = [slice(a, b) for a, b in itertools.pairwise(edges.tolist()) if b > a]
    bins = binned_residuals(
        [time[part] for part in record_slices],
        [residuals[None, part] for part in record_slices],
        [instruments[None, part] for part in record_slices],
    )
    scatter = scatter_of(bins).weighed
    sums = [covariance_of_sums(record_bins, scatter) for record_bins in bins]
    # of (level, slope) first, then of the coefficient, which is slope over level
    jacobian = np.array([[1.0, 0.0], [-slope / level**2, 1.0 / level]]) @ inverse
    noise, drift = (jacobian @ sum(record_sums[k] for record_sums in sums) @ jacobian.T for k in (0, 1))
    timing_slopes = jacobian @ (instruments.T @ (slope * rate))
    reading_interval = max(float(np.median(np.diff(record_sums.supply.time))) for record_sums in fit.records)
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


def while_on(record: HeatingRecord, lag: float, rates: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return means over bins while the current is on, shape (bins,) each.

    They are time [s], temperature of the active windings [degC], the mean of that in the bins before and after [degC],
    rate of the winding's temperature [K/s], and resistance [ohm].
    """
    supply, stamps = record.supply, record.time - lag
    changes = np.flatnonzero(np.diff(supply.on.astype(np.int8), prepend=0, append=0))
    steady = np.zeros(len(supply.time), bool)
    for first, last in zip(changes[::2], changes[1::2] - 1, strict=True):
        began = supply.time[first] + (SETTLING_S if first else 0.0)
        steady |= (supply.time > began) & (supply.time < supply.time[last] - SWITCHING_S)
    bin_width = max(PACE_S, READINGS * float(max(np.median(np.diff(clock)) for clock in (supply.time, stamps))))
    by_supply, by_camera = (((clock - supply.time[0]) / bin_width).astype(np.int64) for clock in (supply.time, stamps))
    bins = int(by_supply[-1]) + 1
    frame_seen = np.isfinite(record.active) & (by_camera < bins)
    bin_complete = np.bincount(by_supply[steady], minlength=bins) == np.bincount(by_supply, minlength=bins)
    with np.errstate(invalid="ignore", divide="ignore"):
        frames = np.bincount(by_camera[frame_seen], minlength=bins)
        temperature, rate, moment = (
            np.bincount(by_camera[frame_seen], column[frame_seen], bins) / frames
            for column in (record.active, rates[0], stamps)
        )
        time = np.bincount(by_supply, supply.time, bins) / np.bincount(by_supply, minlength=bins)
        temperature += rate * (time - moment)
        resistance = np.bincount(by_supply, supply.voltage, bins) / np.bincount(by_supply, supply.current, bins)
    neighbour_temperature = np.full(bins, np.nan)
    neighbour_temperature[1:-1] = 0.5 * (temperature[2:] + temperature[:-2])
    usable = bin_complete & np.isfinite(temperature) & np.isfinite(neighbour_temperature) & np.isfinite(resistance)
    return time[usable], temperature[usable], neighbour_temperature[usable], rate[usable], resistance[usable]
