"""Where the fit of a thermal network begins: a thinned record, first guesses, how late the camera's clock may be."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import correlate, correlation_lags

from leactl.analysis.heating.record import FEWEST, LONGEST_LAG_S, Array, HeatingRecord, SupplyRecord
from leactl.errors import NotIdentifiable

THIN_S = 2.0  # pace of the record that the first fit goes by
SHARES, BODIES = (0.05, 0.4), (10.0, 40.0)  # first tries: heat past the housing, housing's capacitance over winding's
LAG_PACE_S, LAG_SPAN_S = 0.5, 6.0  # paces of the search for a lag; slopes are those over a span
LAG_EDGE = 6.0  # times what other lags give, by which one has to stand out
MARGIN_S = 1.0  # that a lag may be off by after the search


def covered(stretch: HeatingRecord, lag: float) -> HeatingRecord:
    """The frames of a stretch at which its heat is known, where the camera's clock is late by a lag [s].

    Raises
    ------
    NotIdentifiable : too few are left.
    """
    ends = stretch.supply.time[[0, -1]] + lag + np.array([MARGIN_S, -MARGIN_S])
    first, last = np.searchsorted(stretch.time, ends)
    part = slice(int(first), int(last))
    found = replace(
        stretch, **{name: getattr(stretch, name)[part] for name in ("time", "winding", "housing", "active")}
    )
    if np.isfinite(found.winding + found.housing).sum() < FEWEST:
        raise NotIdentifiable(
            f"{stretch.place}: the camera's clock is {lag:g} s late by the supply's, so that few frames have a heat"
        )
    return found


def thinned(stretch: HeatingRecord) -> HeatingRecord:
    """Means over `THIN_S` of frames and heat."""
    supply = stretch.supply
    edges = np.arange(supply.time[0], supply.time[-1], THIN_S)
    heat = np.concatenate([[0.0], np.diff(np.interp(edges, supply.time, energy(supply)))]) / THIN_S
    means = SupplyRecord(edges, heat, np.ones(len(edges)), True)
    ambient = None if stretch.ambient is None else np.interp(edges, supply.time, stretch.ambient)
    bins = ((stretch.time - stretch.time[0]) / THIN_S).astype(np.int64)
    columns = {name: _binned(bins, getattr(stretch, name)) for name in ("time", "winding", "housing", "active")}
    there = np.isfinite(columns["time"]) & (columns["time"] < edges[-1])
    kept = {name: column[there] for name, column in columns.items()}
    return replace(stretch, **kept, supply=means, ambient=ambient)


def energy(supply: SupplyRecord) -> Array:
    """What went in up to each stamp [J]."""
    if supply.means:
        return np.concatenate([[0.0], np.cumsum(supply.heat[1:] * np.diff(supply.time))])
    return np.asarray(cumulative_trapezoid(supply.heat, supply.time, initial=0.0), np.float64)


def guesses(thin: Sequence[HeatingRecord]) -> list[Array]:
    """First tries of the five parameters of the network, from the hottest stretch."""
    hottest = max(thin, key=lambda one: float(np.nanmax(one.winding) - np.nanmin(one.winding)))
    housing, winding, supply = hottest.housing, hottest.winding, hottest.supply
    cold = float(np.nanmin(housing)) if hottest.ambient is None else float(np.mean(hottest.ambient))
    rise, warmed = float(np.nanmax(winding)) - cold, float(np.nanmax(housing)) - cold
    warmed, across = max(warmed, 0.1 * rise, 1e-3), max(rise - warmed, 0.01 * rise, 1e-3)
    heat = float(np.mean(supply.heat[supply.on]))
    half = np.flatnonzero(housing - cold > 0.5 * warmed)
    constant = max(float(hottest.time[half[0]] - hottest.time[0]), THIN_S) / math.log(2.0) if len(half) else 1e3
    found = []
    for share in SHARES:
        through = heat * (1.0 - share)
        wh, ha = across / through, warmed / through
        for bodies in BODIES:
            body = constant / ha
            found.append(np.array([share / (wh + ha), *np.log([wh, ha, body / bodies, body])]))
    return found


def starting_lag(stretch: HeatingRecord) -> float:
    """How late the camera's clock seems to be [s]: where its slopes change as the heat does; zero where none does."""
    supply = stretch.supply
    edges = np.arange(supply.time[0], supply.time[-1], LAG_PACE_S)
    heat = np.diff(np.interp(edges, supply.time, energy(supply))) / LAG_PACE_S
    seen = np.isfinite(stretch.winding)
    grid = np.arange(stretch.time[0], stretch.time[-1], LAG_PACE_S)
    bins = np.clip(((stretch.time - grid[0]) / LAG_PACE_S).astype(np.int64), 0, len(grid) - 1)[seen]
    count = np.bincount(bins, minlength=len(grid))
    means = np.bincount(bins, stretch.winding[seen], len(grid)) / np.maximum(count, 1)
    there = count > 0
    winding = np.interp(grid, grid[there], means[there])
    span = round(LAG_SPAN_S / LAG_PACE_S)
    if min(len(heat), len(winding)) < 6 * span:
        return 0.0
    summed = np.cumsum(heat)
    steps, bends = (_bend(values, span) for values in (summed, winding))
    likeness = correlate(bends, steps)
    lags = correlation_lags(len(bends), len(steps)) * LAG_PACE_S + float(grid[0] + 0.5 * LAG_PACE_S - edges[0])
    likeness = likeness[np.abs(lags) <= LONGEST_LAG_S]
    lags = lags[np.abs(lags) <= LONGEST_LAG_S]
    best = int(np.argmax(likeness))
    typical = float(np.median(np.abs(likeness)))
    return float(lags[best]) if likeness[best] > LAG_EDGE * typical else 0.0


def _bend(values: Array, span: int) -> Array:
    """Slope over the span after less that over the span before."""
    return values[2 * span :] - 2.0 * values[span:-span] + values[: -2 * span]


def _binned(bins: np.ndarray[tuple[int], np.dtype[np.int64]], values: Array) -> Array:
    seen = np.isfinite(values)
    count = np.bincount(bins[seen], minlength=int(bins[-1]) + 1)
    total = np.bincount(bins[seen], values[seen], len(count))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
