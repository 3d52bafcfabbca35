"""Resistance between two leads against the temperature of the active windings, which carry the current.

Paper, section "Thermal Dynamics": R = R0 (1 + alpha (T - T0)), voltage over current while the supply is on. Temperatures
carry the camera's noise, which would lower the slope; the readings before and after serve as instrument, since noise
from frame to frame is not in them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.heating.record import Array, Stretch
from leactl.analysis.heating.scatter import parts_of, scatter_of, spread_of_sums
from leactl.errors import NotIdentifiable

REFERENCE = 25.0  # degC, at which the resistance is told
PACE_S = 1.0  # means that the line goes through
SWITCHING_S = 1.0  # after the current is switched on and before it is switched off, that are left out
FEWEST = 30  # means


@dataclass(frozen=True, eq=False)
class ResistanceLine:
    """R = level (1 + coefficient (T - 25 degC)) of two leads in series."""

    level: float  # ohm
    coefficient: float  # 1/K
    noise: Array  # covariance of both as (ohm, 1/K), from noise
    drift: Array  # the same from drift
    dof: float  # that the drift rests on
    r_squared: float
    temperature: Array  # degC, what the line goes through
    resistance: Array  # ohm


def resistance_line(stretches: Sequence[Stretch], lags: Sequence[float], place: str) -> ResistanceLine:
    """Fit the resistance over the active windings' temperature.

    Raises
    ------
    NotIdentifiable : the current was on for too short a time; `place` opens the message.
    """
    found = [means_while_on(one, lag) for one, lag in zip(stretches, lags, strict=True)]
    time, temperature, around, resistance = (np.concatenate(column) for column in zip(*found, strict=True))
    if len(time) < FEWEST or np.ptp(around) <= 0.0:
        raise NotIdentifiable(f"{place}: current and active windings were measured together for less than {FEWEST} s")
    design = np.column_stack([np.ones(len(time)), temperature - REFERENCE])
    instruments = np.column_stack([np.ones(len(time)), around - REFERENCE])
    inverse = np.linalg.inv(instruments.T @ design)
    level, slope = inverse @ (instruments.T @ resistance)
    left = resistance - design @ np.array([level, slope])
    edges = np.cumsum([0, *(len(one[0]) for one in found)])
    there = [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True) if b > a]
    parts = parts_of([time[at] for at in there], [left[None, at] for at in there], [instruments[None, at] for at in there])
    scatter = scatter_of(parts)
    sums = [spread_of_sums(part, scatter) for part in parts]
    # of (level, slope) first, then of the coefficient, which is slope over level
    turn = np.array([[1.0, 0.0], [-slope / level**2, 1.0 / level]]) @ inverse
    noise, drift = (turn @ sum(one[k] for one in sums) @ turn.T for k in (0, 1))
    about = float(np.sum((resistance - resistance.mean()) ** 2))
    return ResistanceLine(
        float(level),
        float(slope / level),
        noise,
        drift,
        scatter.dof,
        1.0 - float(left @ left) / about,
        temperature,
        resistance,
    )


def means_while_on(stretch: Stretch, lag: float) -> tuple[Array, Array, Array, Array]:
    """Time [s], temperature of the active windings, that around each mean [degC], and resistance [ohm]."""
    supply, stamps = stretch.supply, stretch.time - lag
    size = int((supply.time[-1] - supply.time[0]) / PACE_S) + 1
    by_supply = ((supply.time - supply.time[0]) / PACE_S).astype(np.int64)
    by_camera = np.clip(((stamps - supply.time[0]) / PACE_S).astype(np.int64), 0, size - 1)
    off = np.bincount(by_supply[~supply.on], minlength=size) > 0
    reach = round(SWITCHING_S / PACE_S)
    switching = np.convolve(off, np.ones(2 * reach + 1), "same") > 0
    readings = np.bincount(by_supply, minlength=size)
    seen = np.isfinite(stretch.active)
    frames = np.bincount(by_camera[seen], minlength=size)
    with np.errstate(invalid="ignore", divide="ignore"):
        temperature = np.bincount(by_camera[seen], stretch.active[seen], size) / frames
        resistance = np.bincount(by_supply, supply.voltage, size) / np.bincount(by_supply, supply.current, size)
    around = np.full(size, np.nan)
    around[1:-1] = 0.5 * (temperature[2:] + temperature[:-2])
    good = (readings > 0) & ~switching & np.isfinite(temperature) & np.isfinite(around) & np.isfinite(resistance)
    time = supply.time[0] + PACE_S * (np.arange(size) + 0.5)
    return time[good], temperature[good], around[good], resistance[good]
