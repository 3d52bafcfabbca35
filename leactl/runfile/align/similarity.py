"""Align two channels that measured the same quantity: first by their correlation, then by ties along the record.

The alignment is refused if another shift fits as well, or if the channels change too little to be compared.
"""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.runfile.align.alignment import NORMAL_95, Alignment, Tie, autocorrelated_variance, fit_alignment
from leactl.runfile.align.correlation_peaks import FEWEST_COMMON_SAMPLES, REJECTION_STDS, is_at_end_of_search, peaks

Array = npt.NDArray[np.float64]
LEAST_CORRELATION = 0.8  # two channels with a lower correlation have measured different quantities
# as a share of the squares that the best shift explains; a shift that explains less may fit by chance
LEAST_EXPLAINED_SHARE = 1.0 / 3.0
BLOCKS = 12  # parts of the common time, each of which gives a tie
FEWEST_BLOCK_SAMPLES = 30
SMALLEST_TIE_SD = 0.01  # as a share of the sampling interval, for the error of linear interpolation


def ties_by_similarity(
    time: Array, values: Array, reference_time: Array, reference: Array, shift: float, rate: float = 1.0
) -> list[Tie]:
    """Compute ties of two channels that measured the same quantity, one for each block of their common time.

    Near the right shift, the channel equals the scaled reference plus the reference's derivative times the error of the
    shift. Noise of the reference would bias an estimate of that error towards zero; therefore the channel's own
    derivative serves as instrumental variable. The channels are compared at the stamps of the slower one, to which the
    faster one is interpolated.

    Parameters
    ----------
    time, values : stamps on the device's clock [s] and values of the channel, shape (n,).
    reference_time, reference : stamps on the run's clock [s] and values of the reference, shape (m,).
    shift, rate : approximate alignment: run time = shift + rate * device time.
    """
    finite, reference_finite = np.isfinite(values), np.isfinite(reference)
    time, values, reference_time, reference = (
        shift + rate * time[finite],
        values[finite],
        reference_time[reference_finite],
        reference[reference_finite],
    )
    channel_is_faster = float(np.median(np.diff(time))) < float(np.median(np.diff(reference_time)))
    grid = reference_time if channel_is_faster else time
    interval = float(np.median(np.diff(grid)))
    start, stop = max(time[0], reference_time[0]) + interval, min(time[-1], reference_time[-1]) - interval
    grid = grid[(grid > start) & (grid < stop)]
    channel, channel_slope = value_and_slope(grid, time, values, interval)
    reference_values, reference_slope = value_and_slope(grid, reference_time, reference, interval)
    reference_sd = float(np.std(reference_values))
    if len(grid) < FEWEST_COMMON_SAMPLES or reference_sd == 0.0:
        return []
    gain = math.copysign(
        float(np.std(channel)) / reference_sd,
        float((channel - channel.mean()) @ (reference_values - reference_values.mean())),
    )
    scaled_reference = np.stack([reference_values, np.ones(len(grid))], axis=1)
    delay_response, instrument, residual = (
        residual_of(scaled_reference, column) for column in (gain * reference_slope, channel_slope, channel)
    )
    if not float(instrument @ delay_response):
        return []
    blocks = np.array_split(np.arange(len(grid)), max(1, min(BLOCKS, len(grid) // FEWEST_BLOCK_SAMPLES)))
    # the noise is estimated from all blocks together, since a single block has too few samples
    common_shift = float(instrument @ residual) / float(instrument @ delay_response)
    scores = instrument * (residual - common_shift * delay_response)
    noise = sum(autocorrelated_variance(scores[block]) for block in blocks) / float(instrument @ instrument)
    ties = []
    for block in blocks:
        block_delay, block_instrument, block_residual = delay_response[block], instrument[block], residual[block]
        projection = float(block_instrument @ block_delay)
        sd = (
            math.hypot(
                math.sqrt(noise * float(block_instrument @ block_instrument)) / abs(projection),
                SMALLEST_TIE_SD * interval,
            )
            if projection
            else math.inf
        )
        if sd < 0.5 * (grid[block[-1]] - grid[block[0]]):
            time_of_tie = float(np.average(grid[block], weights=channel_slope[block] ** 2))
            ties.append(
                Tie(
                    (time_of_tie - shift) / rate,
                    time_of_tie + float(block_instrument @ block_residual) / projection,
                    sd,
                )
            )
    return ties


def residual_of(regressors: Array, column: Array) -> Array:
    """Return the residual of a column (n,) after least squares on regressors (n, k)."""
    residual: Array = column - regressors @ np.linalg.lstsq(regressors, column, rcond=None)[0]
    return residual


def value_and_slope(grid: Array, time: Array, values: Array, interval: float) -> tuple[Array, Array]:
    """Return a channel interpolated at the times of a grid [s], and its central difference over +-`interval` [s]."""
    later_values, earlier_values = np.interp(grid + interval, time, values), np.interp(grid - interval, time, values)
    return np.interp(grid, time, values), (later_values - earlier_values) / (2.0 * interval)


def misfit(channel: tuple[Array, Array], reference: tuple[Array, Array], better: Alignment, worse: Alignment) -> float:
    """Return the excess squared residual of `worse` over `better`, in standard deviations, at their common samples.

    If both fit equally well, their squared residuals are noise of the same kind, and the excess is as uncertain as the
    sum for `better`. A change within one sampling interval does not count, since the time of an edge in it is unknown.
    """
    (time, values), (reference_time, reference_values) = channel, reference
    interval = float(np.median(np.diff(reference_time)))
    # no more samples than the reference has, since interpolated samples between two of its samples share their noise
    stride = max(1, round(interval / float(np.median(np.diff(time)))))
    time, values = time[::stride], values[::stride]
    interval = max(interval, float(np.median(np.diff(time))))
    better_stamps, worse_stamps = better.on_run(time), worse.on_run(time)
    is_common = np.logical_and.reduce(
        [(stamps >= reference_time[0]) & (stamps <= reference_time[-1]) for stamps in (better_stamps, worse_stamps)]
    )
    if is_common.sum() < FEWEST_COMMON_SAMPLES:
        return 0.0

    def regressors_at(stamps: Array) -> Array:
        """Return the reference at stamps on the run's clock, beside a column of ones, shape (n, 2)."""
        return np.stack([np.interp(stamps, reference_time, reference_values), np.ones(len(stamps))], axis=1)

    observed = values[is_common]
    regressors = regressors_at(better_stamps[is_common])
    coefficients = np.linalg.lstsq(regressors, observed, rcond=None)[0]
    squared_residual = (observed - regressors @ coefficients) ** 2
    excess_squares = residual_of(regressors_at(worse_stamps[is_common]), observed) ** 2 - squared_residual
    half_interval = 0.5 * interval
    interval_change = (
        regressors_at(better_stamps[is_common] + half_interval)
        - regressors_at(better_stamps[is_common] - half_interval)
    ) @ coefficients
    # the change over an interval also contains the noise of two samples, which is no edge
    edge_squares = max(float(interval_change @ interval_change) - 2.0 * float(squared_residual.sum()), 0.0)
    sd = math.sqrt(2.0 * autocorrelated_variance(squared_residual, least_share=1.0))
    return (float(excess_squares.sum()) - edge_squares) / max(sd, 1e-12 * float(observed @ observed), 1e-300)


def align_by_similarity(
    channel: tuple[Array, Array],
    reference: tuple[Array, Array],
    within_s: float,
    channels_text: str,
    near_s: float = 0.0,
    drift_within: float = 0.0,
    systematic: float = 0.0,
) -> Alignment:
    """Align two channels that measured the same quantity, each given as (stamps, values).

    Parameters
    ----------
    near_s, within_s : the offsets from near_s - within_s to near_s + within_s are searched.
    channels_text : names of both channels, for messages.
    drift_within : bound of the drift; 0 gives one offset for the whole record.
    systematic : constant delay between the two channels (95 %) [s].

    Raises
    ------
    InputError : the channels do not correlate, change too little relative to their noise, or correlate as well at
        another offset.
    """
    finite, reference_finite = np.isfinite(channel[1]), np.isfinite(reference[1])
    channel, reference = (
        (channel[0][finite], channel[1][finite]),
        (reference[0][reference_finite], reference[1][reference_finite]),
    )
    candidates = peaks(*channel, *reference, within_s, near_s)
    highest_correlation = max((peak.correlation for peak in candidates), default=0.0)
    if highest_correlation < LEAST_CORRELATION:
        raise InputError(
            f"{channels_text} correlate by {highest_correlation:.2f} at best; expected {LEAST_CORRELATION} within"
            f" {within_s:g} s"
        )
    # a short part of a record may fit by chance; if it fits better than the whole record, neither is certain
    most_explained = max(peak.explained_squares for peak in candidates if peak.correlation >= LEAST_CORRELATION)
    best_peak = next(peak for peak in candidates if peak.explained_squares >= LEAST_EXPLAINED_SHARE * most_explained)
    method = f"likeness of {channels_text} ({best_peak.correlation:.3f})"
    alignment = align_near(channel, reference, best_peak.shift, method, drift_within, systematic)
    for rival_peak in candidates:
        is_long = rival_peak.explained_squares >= LEAST_EXPLAINED_SHARE * most_explained
        if (
            rival_peak is best_peak
            or is_at_end_of_search(rival_peak, within_s, near_s)
            or not (is_long or rival_peak.correlation >= LEAST_CORRELATION)
        ):
            continue
        alternative = align_near(channel, reference, rival_peak.shift, method, drift_within, systematic)
        is_equally_good = misfit(channel, reference, alignment, alternative) <= REJECTION_STDS
        if is_equally_good if is_long else misfit(channel, reference, alternative, alignment) > REJECTION_STDS:
            raise InputError(
                f"{channels_text} are as alike at {best_peak.shift:.6g} s as at {rival_peak.shift:.6g} s;"
                " a smaller within_s around the true one (near_s), or another signal, decides"
            )
    if is_at_end_of_search(best_peak, within_s, near_s):
        raise InputError(
            f"{channels_text} are likest at {best_peak.shift:.6g} s, where the search ends; expected a peak before that"
        )
    if not alignment.ties:
        raise InputError(f"{channels_text} change too little beside their noise to tell when")
    return alignment


def align_near(
    channel: tuple[Array, Array],
    reference: tuple[Array, Array],
    shift: float,
    method: str,
    drift_within: float,
    systematic: float,
) -> Alignment:
    """Refine an alignment from a first shift [s]; if no tie can be fitted, return the shift with zero ties."""
    alignment = Alignment(method, shift, 1.0, (0.0, 0.0, 0.0), systematic, NORMAL_95, 0)
    for _ in range(2):
        ties = ties_by_similarity(*channel, *reference, alignment.offset, alignment.rate)
        if not ties:
            return replace(alignment, ties=0)
        alignment = fit_alignment(method, ties, drift_within, systematic)
    return alignment
