"""Starting point of the fit of a thermal network: a thin record, first guesses, the lag of the camera's clock."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import correlate, correlation_lags

from leactl.analysis.heating.record import FEWEST_FRAMES, LONGEST_LAG_S, Array, HeatingRecord, SupplyRecord
from leactl.errors import NotIdentifiable

THIN_INTERVAL_S = 2.0  # between the frames of the thin record that the first fit takes
BYPASS_SHARES = (0.05, 0.4)  # first guesses of the share of heat that bypasses the housing
CAPACITANCE_RATIOS = (10.0, 40.0)  # first guesses of the housing's capacitance over the winding's
LAG_RESOLUTION_S, SLOPE_SPAN_S = 0.5, 6.0  # steps of the search for a lag, and the time over which slopes are taken
LEAST_PEAK_RATIO = 6.0  # peak of the correlation over the median of its magnitude; a lower peak shows no lag
LAG_MARGIN_S = 1.0  # error of the lag after the search; frames so near the ends of the supply's record are left out


def frames_with_known_heat(record: HeatingRecord, lag: float) -> HeatingRecord:
    """Return a record with only the frames at which its heat is known; the camera's clock is late by `lag` [s].

    Raises
    ------
    NotIdentifiable : fewer than `FEWEST_FRAMES` such frames have both temperatures.
    """
    first_and_last = record.supply.time[[0, -1]] + lag + np.array([LAG_MARGIN_S, -LAG_MARGIN_S])
    start, stop = np.searchsorted(record.time, first_and_last)
    frames = slice(int(start), int(stop))
    kept_record = replace(
        record, **{name: getattr(record, name)[frames] for name in ("time", "winding", "housing", "active")}
    )
    if np.isfinite(kept_record.winding + kept_record.housing).sum() < FEWEST_FRAMES:
        raise NotIdentifiable(
            f"{record.run_path}: the camera's clock is {lag:g} s late by the supply's, so that few frames have a heat"
        )
    return kept_record


def thin_record(record: HeatingRecord) -> HeatingRecord:
    """Return a record whose frames and heat are averaged over `THIN_INTERVAL_S`."""
    supply = record.supply
    edges = np.arange(supply.time[0], supply.time[-1], THIN_INTERVAL_S)
    heat = np.concatenate([[0.0], np.diff(np.interp(edges, supply.time, energy(supply)))]) / THIN_INTERVAL_S
    root = np.sqrt(np.maximum(heat, 0.0))  # current and voltage at 1 ohm, so that their product is the heat
    mean_supply = SupplyRecord(edges, current=root, voltage=root, means=True)
    ambient = None if record.ambient is None else np.interp(edges, supply.time, record.ambient)
    bins = ((record.time - record.time[0]) / THIN_INTERVAL_S).astype(np.int64)
    columns = {name: _bin_means(bins, getattr(record, name)) for name in ("time", "winding", "housing", "active")}
    within_supply = np.isfinite(columns["time"]) & (columns["time"] < edges[-1])
    columns_within_supply = {name: column[within_supply] for name, column in columns.items()}
    return replace(record, **columns_within_supply, supply=mean_supply, ambient=ambient)


def energy(supply: SupplyRecord) -> Array:
    """Return the electrical energy that was supplied up to each stamp [J], shape (readings,)."""
    if supply.means:
        return np.concatenate([[0.0], np.cumsum(supply.heat[1:] * np.diff(supply.time))])
    return np.asarray(cumulative_trapezoid(supply.heat, supply.time, initial=0.0), np.float64)


def starting_points(thin_records: Sequence[HeatingRecord]) -> list[Array]:
    """Return starting points for the fit of a two-node network, from the record with the largest rise.

    The record counts as nearly steady at its end, so that rises over heat give the resistances; its housing's time to
    half of its rise gives the time constant. No rise shows the share of heat that bypasses the housing or the ratio of
    the capacitances: each pair of `BYPASS_SHARES` and `CAPACITANCE_RATIOS` gives one starting point.

    Returns
    -------
    Arrays of five: conductance of the winding to the air [W/K], then the logarithms of the resistances winding to
    housing and housing to air [K/W] and of the capacitances of winding and housing [J/K].
    """
    hottest = max(thin_records, key=lambda record: float(np.nanmax(record.winding) - np.nanmin(record.winding)))
    housing, winding, supply = hottest.housing, hottest.winding, hottest.supply
    ambient = float(np.nanmin(housing)) if hottest.ambient is None else float(np.mean(hottest.ambient))
    winding_rise, housing_rise = float(np.nanmax(winding)) - ambient, float(np.nanmax(housing)) - ambient
    housing_rise, winding_over_housing = (
        max(housing_rise, 0.1 * winding_rise, 1e-3),
        max(winding_rise - housing_rise, 0.01 * winding_rise, 1e-3),
    )
    heat = float(np.mean(supply.heat[supply.on]))
    above_half_rise = np.flatnonzero(housing - ambient > 0.5 * housing_rise)
    time_constant = (
        max(float(hottest.time[above_half_rise[0]] - hottest.time[0]), THIN_INTERVAL_S) / math.log(2.0)
        if len(above_half_rise)
        else 1e3  # s
    )
    points = []
    for share in BYPASS_SHARES:
        heat_into_housing = heat * (1.0 - share)
        winding_housing, housing_ambient = winding_over_housing / heat_into_housing, housing_rise / heat_into_housing
        for capacitance_ratio in CAPACITANCE_RATIOS:
            housing_capacitance = time_constant / housing_ambient
            winding_capacitance = housing_capacitance / capacitance_ratio
            logarithms = np.log([winding_housing, housing_ambient, winding_capacitance, housing_capacitance])
            points.append(np.array([share / (winding_housing + housing_ambient), *logarithms]))
    return points


def starting_lag(record: HeatingRecord) -> float:
    """Estimate the lag of the camera's clock [s] by correlating bends of the temperature with steps of the heat.

    Zero if the record is too short or the correlation has no clear peak.
    """
    supply = record.supply
    edges = np.arange(supply.time[0], supply.time[-1], LAG_RESOLUTION_S)
    heat = np.diff(np.interp(edges, supply.time, energy(supply))) / LAG_RESOLUTION_S
    finite = np.isfinite(record.winding)
    grid = np.arange(record.time[0], record.time[-1], LAG_RESOLUTION_S)
    bins = np.clip(((record.time - grid[0]) / LAG_RESOLUTION_S).astype(np.int64), 0, len(grid) - 1)[finite]
    count = np.bincount(bins, minlength=len(grid))
    means = np.bincount(bins, record.winding[finite], len(grid)) / np.maximum(count, 1)
    has_frames = count > 0
    winding = np.interp(grid, grid[has_frames], means[has_frames])
    span_steps = round(SLOPE_SPAN_S / LAG_RESOLUTION_S)
    if min(len(heat), len(winding)) < 6 * span_steps:
        return 0.0
    energies = np.cumsum(heat)
    heat_steps, temperature_bends = (_change_of_rise(values, span_steps) for values in (energies, winding))
    correlation = correlate(temperature_bends, heat_steps)
    lags = correlation_lags(len(temperature_bends), len(heat_steps)) * LAG_RESOLUTION_S + float(
        grid[0] + 0.5 * LAG_RESOLUTION_S - edges[1]
    )
    correlation = correlation[np.abs(lags) <= LONGEST_LAG_S]
    lags = lags[np.abs(lags) <= LONGEST_LAG_S]
    peak = int(np.argmax(correlation))
    median_magnitude = float(np.median(np.abs(correlation)))
    return float(lags[peak]) if correlation[peak] > LEAST_PEAK_RATIO * median_magnitude else 0.0


def _change_of_rise(values: Array, span: int) -> Array:
    """Return the rise over the span after each sample minus the rise over the span before; `span` is in samples."""
    return values[2 * span :] - 2.0 * values[span:-span] + values[: -2 * span]


def _bin_means(bins: np.ndarray[tuple[int], np.dtype[np.int64]], values: Array) -> Array:
    """Return the mean of the finite values in each bin; NaN for a bin without finite values."""
    finite = np.isfinite(values)
    counts = np.bincount(bins[finite], minlength=int(bins[-1]) + 1)
    sums = np.bincount(bins[finite], values[finite], len(counts))
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
