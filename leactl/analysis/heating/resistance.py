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
PACE_S, READINGS = 1.0, 3  # means that the line goes through: over so long, and over so many readings and frames
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
    """Fit the resistance over the active windings' temperature.

    Raises
    ------
    NotIdentifiable : the current was on for too short a time; `place` opens the message.
    """
    found = [while_on(*one) for one in zip(fit.stretches, fit.lags, fit.rates, strict=True)]
    time, temperature, around, rate, resistance = (np.concatenate(column) for column in zip(*found, strict=True))
    if len(time) < FEWEST or np.ptp(around) <= 0.0:
        raise NotIdentifiable(
            f"{place}: the current was on, and the active windings seen, for too short a time to tell their resistance;"
            f" {LEAST_ON_S:g} s are needed"
        )
    design = np.column_stack([np.ones(len(time)), temperature - REFERENCE])
    instruments = np.column_stack([np.ones(len(time)), around - REFERENCE])
    inverse = np.linalg.inv(instruments.T @ design)
    level, slope = inverse @ (instruments.T @ resistance)
    left = resistance - design @ np.array([level, slope])
    edges = np.cumsum([0, *(len(one[0]) for one in found)])
    there = [slice(a, b) for a, b in itertools.pairwise(edges.tolist()) if b > a]
    parts = binned_residuals(
        [time[at] for at in there], [left[None, at] for at in there], [instruments[None, at] for at in there]
    )
    scatter = scatter_of(parts).weighed
    sums = [covariance_of_sums(part, scatter) for part in parts]
    # of (level, slope) first, then of the coefficient, which is slope over level
    turn = np.array([[1.0, 0.0], [-slope / level**2, 1.0 / level]]) @ inverse
    noise, drift = (turn @ sum(one[k] for one in sums) @ turn.T for k in (0, 1))
    late = turn @ (instruments.T @ (slope * rate))
    reading = max(float(np.median(np.diff(one.supply.time))) for one in fit.stretches)
    about = float(np.sum((resistance - resistance.mean()) ** 2))
    return ResistanceLine(
        float(level),
        float(slope / level),
        noise,
        drift,
        reading**2 / 12.0 * np.outer(late, late),
        scatter.dof,
        1.0 - float(left @ left) / about if about > 0.0 else math.nan,
        temperature,
        resistance,
    )


def while_on(stretch: HeatingRecord, lag: float, rates: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Means: time [s], active windings, these by the means around [degC], winding's rate [K/s], resistance [ohm]."""
    supply, stamps = stretch.supply, stretch.time - lag
    changes = np.flatnonzero(np.diff(supply.on.astype(np.int8), prepend=0, append=0))
    held = np.zeros(len(supply.time), bool)
    for first, last in zip(changes[::2], changes[1::2] - 1, strict=True):
        began = supply.time[first] + (SETTLING_S if first else 0.0)
        held |= (supply.time > began) & (supply.time < supply.time[last] - SWITCHING_S)
    pace = max(PACE_S, READINGS * float(max(np.median(np.diff(clock)) for clock in (supply.time, stamps))))
    by_supply, by_camera = (((clock - supply.time[0]) / pace).astype(np.int64) for clock in (supply.time, stamps))
    size = int(by_supply[-1]) + 1
    seen = np.isfinite(stretch.active) & (by_camera < size)
    whole = np.bincount(by_supply[held], minlength=size) == np.bincount(by_supply, minlength=size)
    with np.errstate(invalid="ignore", divide="ignore"):
        frames = np.bincount(by_camera[seen], minlength=size)
        temperature, rate, moment = (
            np.bincount(by_camera[seen], column[seen], size) / frames for column in (stretch.active, rates[0], stamps)
        )
        time = np.bincount(by_supply, supply.time, size) / np.bincount(by_supply, minlength=size)
        temperature += rate * (time - moment)
        resistance = np.bincount(by_supply, supply.voltage, size) / np.bincount(by_supply, supply.current, size)
    around = np.full(size, np.nan)
    around[1:-1] = 0.5 * (temperature[2:] + temperature[:-2])
    good = whole & np.isfinite(temperature) & np.isfinite(around) & np.isfinite(resistance)
    return time[good], temperature[good], around[good], rate[good], resistance[good]
