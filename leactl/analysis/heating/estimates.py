"""Estimates of a thermal fit, and notes on how well the record determines them."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leactl.analysis.estimate import NAN, Estimate, Noted
from leactl.analysis.heating.network import NetworkFit, camera_temperatures
from leactl.analysis.heating.parameters import (
    LINE_RESISTANCE,
    NAMES,
    RESISTANCE_COEFFICIENT,
    UNITS,
    FittedParameters,
    Instruments,
    Uncertainty,
    correlation_matrix,
    natural_covariance,
    natural_parameters,
    parallel_resistance,
    readings_on,
)
from leactl.analysis.heating.record import Array, HeatingRecord
from leactl.analysis.heating.resistance import ResistanceLine
from leactl.analysis.statistics.regression import t_quantile

STEADY_K, STEADY_S = 1.0, 1800.0  # largest change of a steady state, and the time over which it is taken
END_AVERAGE_S = 60.0  # over which temperatures are averaged at the beginning and the end of that time
NOTED_CORRELATION = 0.7  # of two parameters; a note names larger correlations
NOTED_OVER_NOISE = 1.05  # residuals over the noise from frame to frame; a note names a larger ratio
REPORTED_STDS = 3.0  # standard deviations of a lag or an offset; a note names larger ones
FEWEST_TIME_CONSTANTS = 1.0  # slow ones, which a record must cover to determine a steady state
STEADY_STATE_RESULTS = (  # results that follow from the steady state
    "winding_ambient_resistance",
    "housing_ambient_resistance",
    "parallel_thermal_resistance",
    "continuous_current",
    "continuous_current_standing",
)


def network_results(parameters: FittedParameters, time_constants: float) -> Noted[list[Estimate]]:
    """Estimate the network's five parameters and its thermal resistance from winding to air.

    `time_constants` is the longest heating or cooling of the record in slow time constants. Below one, parameters that
    follow from the steady state are NaN: they would be those of the model, not of the record.
    """
    notes = []
    estimates = [
        parameters.estimate(name, units, lambda shifted, index=index: float(natural_parameters(shifted)[index]))  # type: ignore[misc]
        for index, (name, units) in enumerate(zip(NAMES[:5], UNITS[:5], strict=True))
    ]
    estimates.append(parameters.estimate("parallel_thermal_resistance", "K/W", parallel_resistance))
    if time_constants < FEWEST_TIME_CONSTANTS:
        estimates = [
            without_value(estimate) if estimate.name in STEADY_STATE_RESULTS else estimate for estimate in estimates
        ]
        notes.append(
            f"heating and cooling were followed for {time_constants:.2g} time constants of the housing at the longest,"
            f" {FEWEST_TIME_CONSTANTS:g} is the least that tells a steady state"
        )
    notes += notes_on_missing(estimates)
    if not math.isfinite(estimates[0].value):
        conductance, std = parameters.point[0], math.sqrt(parameters.covariance[0, 0])
        if (highest := conductance + t_quantile(math.inf) * std) > 0.0:
            notes.append(f"winding_ambient_resistance is above {1.0 / highest:.3g} K/W (97.5 %)")
    return Noted(estimates, tuple(notes))


def notes_on_missing(estimates: Sequence[Estimate]) -> list[str]:
    """Return a note for each estimate that has no value."""
    return [
        f"{estimate.name} is not identifiable from this record"
        for estimate in estimates
        if not math.isfinite(estimate.value)
    ]


def without_value(estimate: Estimate) -> Estimate:
    """Return an estimate with value, uncertainty and interval replaced by NaN."""
    return replace(estimate, value=NAN, std=NAN, low=NAN, high=NAN)


def slow_constants_seen(fit: NetworkFit) -> float:
    """Return the longest heating or cooling without a break, in slow time constants of the network.

    The record before the first heating counts as cooling only if the winding was still warm.
    """
    longest_s = 0.0
    for record in fit.records:
        is_on, time, winding = record.supply.on, record.supply.time, record.winding
        edges = [0, *(np.flatnonzero(np.diff(is_on)) + 1).tolist(), len(is_on) - 1]
        rise = np.nanmax(winding) - np.nanmin(winding)
        started_warm = winding[np.isfinite(winding)][0] - np.nanmin(winding) > 0.5 * rise
        for start, stop in itertools.pairwise(edges):
            if start or is_on[0] or started_warm:
                longest_s = max(longest_s, float(time[stop] - time[start]))
    return longest_s * -float(np.max(fit.network.modes()[0]))


def resistance_results(
    parameters: FittedParameters, line: ResistanceLine, phase_to_line_ratio: float
) -> Noted[list[Estimate]]:
    """Estimate the resistance at 25 degC, of two leads and of a phase, and its temperature coefficient.

    `phase_to_line_ratio` is the resistance of a phase over that between two leads.
    """
    estimates = [
        parameters.estimate("line_resistance", "ohm", lambda shifted: float(shifted.point[LINE_RESISTANCE])),
        parameters.estimate(
            "phase_resistance", "ohm", lambda shifted: phase_to_line_ratio * float(shifted.point[LINE_RESISTANCE])
        ),
        parameters.estimate(
            "resistance_coefficient", "1/K", lambda shifted: float(shifted.point[RESISTANCE_COEFFICIENT])
        ),
    ]
    r_squared = Estimate("resistance_r_squared", line.r_squared, NAN, NAN, NAN, "1")
    return Noted([*estimates, r_squared], tuple(notes_on_missing(estimates)))


def residual_results(fit: NetworkFit, uncertainty: Uncertainty) -> Noted[list[Estimate]]:
    """Return the root mean squares of the residuals [K], and their ratio to the noise from frame to frame.

    If the ratio is above `NOTED_OVER_NOISE`, a note states the size and the decay time of the drift.
    """
    residuals = [np.concatenate([residual[node] for residual in fit.residuals]) for node in (0, 1)]
    rms_by_node = [math.sqrt(float(np.nanmean(node_residuals**2))) for node_residuals in residuals]
    rms_of_both = math.sqrt(float(np.nanmean(np.concatenate(residuals) ** 2)))
    noise_by_node = [noise_of([camera_temperatures(record)[node] for record in fit.records]) for node in (0, 1)]
    frame_counts = [int(np.isfinite(node_residuals).sum()) for node_residuals in residuals]
    expected_rms = math.sqrt(
        sum(count * std**2 for count, std in zip(frame_counts, noise_by_node, strict=True)) / sum(frame_counts)
    )
    over_noise = rms_of_both / expected_rms if expected_rms > 0.0 else NAN
    drifts, decay_time = np.sqrt(np.diag(uncertainty.scatter.drift)), uncertainty.scatter.decay_time
    note = (
        f"residuals are {over_noise:.2f} times the noise from frame to frame: a drift of {drifts[0]:.2g} K at the"
        f" winding and {drifts[1]:.2g} K at the housing that lasts {decay_time:.0f} s, by the camera, the air or a heat"
        " flow that two bodies cannot show; the intervals include it"
    )
    in_kelvin = {"rmse": rms_of_both, "rmse_winding": rms_by_node[0], "rmse_housing": rms_by_node[1]}
    estimates = [
        *(Estimate(name, value, NAN, NAN, NAN, "K") for name, value in in_kelvin.items()),
        Estimate("rmse_over_noise", over_noise, NAN, NAN, NAN, "1"),
    ]
    return Noted(estimates, (note,) if over_noise > NOTED_OVER_NOISE else ())


def noise_of(columns: Sequence[Array]) -> float:
    """Return the noise from frame to frame [K], by second differences, to which a smooth curve contributes little.

    NaN if no three finite frames follow each other. The second difference of white noise has six times its variance.
    """
    second_differences = np.concatenate([column[2:] - 2.0 * column[1:-1] + column[:-2] for column in columns])
    second_differences = second_differences[np.isfinite(second_differences)]
    return math.sqrt(float(np.mean(second_differences**2)) / 6.0) if len(second_differences) else NAN


def steadiness(records: Sequence[HeatingRecord]) -> Noted[list[Estimate]]:
    """Return the largest change of winding or housing in the last half hour of heating [K].

    The value is NaN if no record was heated for half an hour; a note names a missing value, or one above `STEADY_K`.
    """
    changes = []
    for record in records:
        heated_times = record.supply.time[record.supply.on]
        if not len(heated_times):
            continue
        stop = float(heated_times[-1])
        start = max(stop - STEADY_S, float(record.time[0]))
        if stop - start < 0.99 * STEADY_S or not record.supply.on[record.supply.time > start + END_AVERAGE_S].any():
            changes.append(NAN)
            continue
        early_frames, late_frames = (
            (record.time >= begin) & (record.time < begin + END_AVERAGE_S) for begin in (start, stop - END_AVERAGE_S)
        )
        with np.errstate(invalid="ignore"):
            node_changes = [
                float(np.nanmean(row[late_frames]) - np.nanmean(row[early_frames]))
                for row in camera_temperatures(record)
            ]
        changes.append(max(node_changes, key=abs))
    finite_changes = [change for change in changes if math.isfinite(change)]
    peak_change = max(finite_changes, key=abs, default=NAN)
    notes = []
    if not finite_changes:
        notes.append("heated for less than 30 min: no steady state, and results that depend on one have wide intervals")
    elif abs(peak_change) > STEADY_K:
        notes.append(
            f"no steady state: {peak_change:+.1f} K in the last 30 min of heating, at most {STEADY_K:g} K was expected;"
            " results that depend on one have wider intervals"
        )
    return Noted([Estimate("change_in_30_min", peak_change, NAN, NAN, NAN, "K")], tuple(notes))


def camera_results(fit: NetworkFit, uncertainty: Uncertainty, offset_std: float) -> Noted[list[Estimate]]:
    """Return the lag of the camera's clock [s] and the camera's offsets [K]; an empty list for several records.

    `offset_std` is the standard uncertainty of the camera's zero [K]. Notes name the lags and offsets of all records
    that exceed `REPORTED_STDS` standard deviations; a lag must also exceed two frames of the camera.
    """
    units = {"lag": "s", "offset_winding": "K", "offset_housing": "K"}
    estimates, notes = [], []
    for number, record in enumerate(fit.records):
        for name, unit in units.items():
            index = fit.index_of(number, name)
            if index is None:
                continue
            variance = uncertainty.noise[index, index] + uncertainty.drift[index, index]
            value, std = float(fit.point[index]), math.sqrt(variance)
            half_width = t_quantile(math.inf) * std
            estimates.append(Estimate(f"camera_{name}", value, std, value - half_width, value + half_width, unit))
            if name == "lag" and abs(value) > max(REPORTED_STDS * std, 2.0 * float(np.median(np.diff(record.time)))):
                notes.append(
                    f"{record.run_path}: the camera's clock is {value:.2f} s behind the supply's; taken into account"
                )
            if name != "lag" and abs(value) > REPORTED_STDS * math.hypot(offset_std, std):
                notes.append(
                    f"{record.run_path}: {name.removeprefix('offset_')} reads {value:+.1f} K off the sensor of the air,"
                    f" more than the camera's {offset_std:g} K explain: units, emissivity, or air of another place"
                )
    return Noted(estimates if len(fit.records) == 1 else [], tuple(notes))


def remarks(parameters: FittedParameters, records: Sequence[HeatingRecord], instruments: Instruments) -> list[str]:
    """Return notes on correlations, the assumed uncertainties of the instruments, and the range of the ambient."""
    correlation, notes = correlation_matrix(natural_covariance(parameters)), []
    correlated_pairs = [
        (abs(correlation[row, column]), row, column)
        for row in range(5)
        for column in range(row)
        if abs(correlation[row, column]) > NOTED_CORRELATION
    ]
    correlations = [
        f"{correlation[row, column]:+.2f} of {NAMES[column]} and {NAMES[row]}"
        for _, row, column in sorted(correlated_pairs, reverse=True)[:4]
    ]
    if correlations:
        notes.append(f"correlations: {'; '.join(correlations)}")
    notes.append(
        f"standard uncertainties taken: camera {instruments.camera_offset:g} K and {instruments.camera_gain:.2%} of the"
        f" rise, voltage {instruments.voltage_gain:.2%}, current {instruments.current_gain:.2%}"
    )
    for name in ("current", "voltage"):
        readings = readings_on(records, name)
        if all(np.ptp(values) == 0.0 for values in readings):
            levels = " and ".join(f"{level:g}" for level in sorted({float(values[0]) for values in readings}))
            notes.append(f"line_{name} reads {levels} throughout: its resolution does not show; give {name}_gain_std")
    ambient_ranges = [float(np.ptp(_part_means(record.ambient))) for record in records if record.ambient is not None]
    if max(ambient_ranges, default=0.0) > STEADY_K:
        notes.append(
            f"the air changed by {max(ambient_ranges):.1f} K; the network is driven by its measured temperature"
        )
    return notes


def _part_means(ambient: Array) -> Array:
    """Return means of the ambient temperature [degC] over equal parts, 50 to 99 for 50 readings or more."""
    part_size = max(len(ambient) // 50, 1)
    return np.array([float(np.mean(part)) for part in np.array_split(ambient, max(len(ambient) // part_size, 1))])
