"""Noise and drift in the residuals of a thermal fit, and the covariance of the unknowns that follows from them.

A camera drifts between its own calibrations and the air of a room moves, so that neighbouring frames share their error
and do not count as independent readings. Noise is white and independent at each node; drift is correlated over a decay
time and between the nodes. Both are estimated by restricted maximum likelihood in the frequency domain (Whittle, 1953;
Patterson & Thompson, 1971), which accounts for the part of the scatter that the fit absorbed. The covariance of the
unknowns is that of plain least squares under such residuals.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from leactl.analysis.heating.record import Array

LEAST_BIN_S = 1.0  # width of a bin
MOST_BINS = 4000  # bins of a record
SHORTEST_DECAY_BINS, LONGEST_DECAY_SHARE = 2.0, 0.1  # of a drift: bins, and share of the length of all records
DECAY_STARTS_S = (10.0, 200.0)  # starting values of a drift's decay time


@dataclass(frozen=True, eq=False)
class BinnedResiduals:
    """Residuals and derivatives of one record in bins of even length."""

    pace: float  # s
    residuals: Array  # (nodes, bins), means [K]; zero in a bin without a frame
    columns: Array  # (nodes, bins, unknowns), sums of the derivatives over the frames of a bin
    # Products are summed over frames for the noise: sums over a bin would lose changes of the derivatives within it,
    # as after the current is switched.
    products: Array  # (nodes, unknowns, unknowns), of columns over all frames, times the mean number of frames in a bin


@dataclass(frozen=True, eq=False)
class Scatter:
    """Noise and drift of residuals in bins of even length, at least `LEAST_BIN_S` each."""

    noise: Array  # (nodes,), variance of the noise of a bin
    drift: Array  # (nodes, nodes), covariance of the drift
    decay_time: float  # s, of the drift's autocorrelation
    span: float  # s, length of all records
    noise_without_drift: Array  # (nodes,), variance of the noise of a bin in a model without drift
    drift_weight: float  # of the model with drift against that without, after Akaike (Burnham & Anderson, 2002, 2.9)

    @property
    def model_average(self) -> Self:
        """Return the average of the models with and without drift by their weights: chance alone may show a drift."""
        noise = self.drift_weight * self.noise + (1.0 - self.drift_weight) * self.noise_without_drift
        return replace(self, noise=noise, drift=self.drift_weight * self.drift)

    @property
    def dof(self) -> float:
        """Return the degrees of freedom of the drift's variance: length of the records over twice the decay time."""
        return max(self.span / (2.0 * self.decay_time) - 1.0, 1.0)


def binned_residuals(
    times: Sequence[Array], residuals: Sequence[Array], columns: Sequence[Array]
) -> list[BinnedResiduals]:
    """Average residuals and sum derivatives in bins of each record.

    Parameters
    ----------
    times : of each record [s], (frames,).
    residuals : of each record, (nodes, frames), NaN where missing.
    columns : derivatives of each record, (nodes, frames, unknowns).
    """
    binned_records = []
    for time, residual, column in zip(times, residuals, columns, strict=True):
        pace = max(LEAST_BIN_S, float(time[-1] - time[0]) / MOST_BINS, 2.0 * float(np.median(np.diff(time))))
        bin_of_frame = ((time - time[0]) / pace).astype(np.int64)
        bin_count = int(bin_of_frame[-1]) + 1
        products = np.zeros((len(residual), column.shape[2], column.shape[2]))
        means, sums = (
            np.zeros((len(residual), bin_count)),
            np.zeros((len(residual), bin_count, column.shape[2])),
        )
        for node, row in enumerate(residual):
            finite = np.isfinite(row)
            count = np.bincount(bin_of_frame[finite], minlength=bin_count)
            means[node] = np.bincount(bin_of_frame[finite], row[finite], bin_count) / np.maximum(count, 1)
            products[node] = column[node][finite].T @ column[node][finite] * np.mean(count[count > 0])
            for unknown in range(column.shape[2]):
                sums[node, :, unknown] = np.bincount(bin_of_frame[finite], column[node][finite, unknown], bin_count)
        binned_records.append(BinnedResiduals(pace, means, sums, products))
    return binned_records


def scatter_of(bins: Sequence[BinnedResiduals]) -> Scatter:
    """Estimate noise and drift by restricted maximum likelihood."""
    from scipy.optimize import minimize

    nodes = len(bins[0].residuals)
    span = sum(record_bins.pace * record_bins.residuals.shape[1] for record_bins in bins)
    rms = np.array(
        [
            max(math.sqrt(np.mean(np.concatenate([record_bins.residuals[node] for record_bins in bins]) ** 2)), 1e-9)
            for node in range(nodes)
        ]
    )
    spectra = _spectra(bins, rms)
    low, high = (
        math.log(SHORTEST_DECAY_BINS * bins[0].pace),
        math.log(max(LONGEST_DECAY_SHARE * span, 4.0 * bins[0].pace)),
    )
    lower_triangle = [(row, column) for row in range(nodes) for column in range(row + 1)]
    bounds = [(-14.0, 3.0)] * nodes + [(-3.0, 3.0)] * len(lower_triangle) + [(low, high)]

    def unpacked(point: Array) -> Scatter:
        root = np.zeros((nodes, nodes))
        for (row, column), value in zip(lower_triangle, point[nodes:-1], strict=True):
            root[row, column] = value
        noise = np.exp(point[:nodes])
        return Scatter(noise, root @ root.T, math.exp(point[-1]), span, noise, 1.0)

    def cost(point: Array) -> float:
        return _negative_log_likelihood(unpacked(point), spectra)

    solutions = []
    for decay_time in DECAY_STARTS_S:
        start = [math.log(0.7)] * nodes + [0.3 if row == column else 0.0 for row, column in lower_triangle]
        starting_point = np.array([*start, min(max(math.log(decay_time), low), high)])
        solutions.append(minimize(cost, starting_point, method="L-BFGS-B", bounds=bounds))
    best = min(solutions, key=lambda solution: float(solution.fun))
    drift_terms = len(lower_triangle)
    bounds_without_drift = bounds[:nodes] + [(0.0, 0.0)] * drift_terms + [(low, low)]
    without_drift = minimize(
        cost, [0.0] * (nodes + drift_terms) + [low], method="L-BFGS-B", bounds=bounds_without_drift
    )
    weight_of_drift = 1.0 / (1.0 + math.exp(min(drift_terms + 1 - 0.5 * (without_drift.fun - best.fun), 700.0)))
    with_drift, scale = unpacked(best.x), np.outer(rms, rms)
    noise_without_drift = np.exp(without_drift.x[:nodes]) * rms**2
    return Scatter(
        with_drift.noise * rms**2,
        with_drift.drift * scale,
        with_drift.decay_time,
        span,
        noise_without_drift,
        weight_of_drift,
    )


def covariance_of_sums(record_bins: BinnedResiduals, scatter: Scatter) -> tuple[Array, Array]:
    """Return the covariance of sums of residuals weighted by the derivatives, by noise and by drift.

    Both have shape (unknowns, unknowns).
    """
    bin_count = record_bins.columns.shape[1]
    padded = np.fft.rfft(record_bins.columns, 2 * bin_count, axis=1)
    weight = _multiplicity(2 * bin_count) / (2 * bin_count)
    shape = drift_spectrum(scatter.decay_time, record_bins.pace, 2 * bin_count) * weight
    by_noise = np.tensordot(scatter.noise, record_bins.products, 1)
    mixed = np.einsum("nm,mfl->nfl", scatter.drift, padded)
    by_drift = np.einsum("nfk,nfl,f->kl", padded.conj(), mixed, shape, optimize=True).real
    return np.asarray(by_noise), np.asarray(by_drift)


def drift_spectrum(decay_time: float, pace: float, size: int) -> Array:
    """Return the power spectrum of a drift of unit variance, sampled in bins, at the frequencies of a real transform.

    Decay time and pace are in s; `size` is the number of bins that are transformed.
    """
    decay = math.exp(-pace / decay_time)
    angles = 2.0 * np.pi * np.arange(size // 2 + 1) / size
    return np.asarray((1.0 - decay**2) / (1.0 - 2.0 * decay * np.cos(angles) + decay**2), np.float64)


def _multiplicity(size: int) -> Array:
    """Return how often each frequency of a real transform occurs in the complex one: 2, or 1 at the ends."""
    weight = np.full(size // 2 + 1, 2.0)
    weight[0] = 1.0
    if size % 2 == 0:
        weight[-1] = 1.0
    return weight


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Transforms of one record, real and imaginary parts in sequence, weighted by how often each frequency counts."""

    residuals: Array  # (nodes, parts), over the rms of the residuals
    columns: Array  # (nodes, parts, unknowns), each column normalised over all records
    size: int  # bins
    pace: float  # s


def _spectra(bins: Sequence[BinnedResiduals], rms: Array) -> list[Spectrum]:
    columns = [record_bins.columns / rms[:, None, None] for record_bins in bins]
    length = np.sqrt(sum(np.sum(transform**2, axis=(0, 1)) for transform in columns))
    length[length == 0.0] = 1.0
    spectra = []
    for record_bins, column in zip(bins, columns, strict=True):
        size = record_bins.residuals.shape[1]
        weight = np.sqrt(_multiplicity(size) / size)
        residual_transform = np.fft.rfft(record_bins.residuals / rms[:, None], axis=1) * weight
        column_transform = np.fft.rfft(column / length, axis=1) * weight[:, None]
        rows, stacked = (
            np.concatenate([transform.real, transform.imag], axis=1)
            for transform in (residual_transform, column_transform)
        )
        spectra.append(Spectrum(rows, stacked, size, record_bins.pace))
    return spectra


def _negative_log_likelihood(scatter: Scatter, spectra: Sequence[Spectrum]) -> float:
    """Return minus twice the logarithm of the restricted likelihood.

    A rotation of the nodes makes noise and drift independent at each frequency and gives the noise variance one.
    """
    root = 1.0 / np.sqrt(scatter.noise)
    drifts, vectors = np.linalg.eigh(scatter.drift * np.outer(root, root))
    rotation = vectors.T * root
    total, rows, columns = 0.0, [], []
    for spectrum in spectra:
        shape = drift_spectrum(scatter.decay_time, spectrum.pace, spectrum.size)
        density = 1.0 + np.maximum(drifts, 0.0)[:, None] * shape
        total += float(_multiplicity(spectrum.size) @ np.log(density).sum(axis=0)) + spectrum.size * float(
            np.log(scatter.noise).sum()
        )
        scale = 1.0 / np.sqrt(np.tile(density, 2))
        rows.append(((rotation @ spectrum.residuals) * scale).ravel())
        columns.append(
            (np.tensordot(rotation, spectrum.columns, 1) * scale[:, :, None]).reshape(-1, spectrum.columns.shape[2])
        )
    all_rows, all_columns = np.concatenate(rows), np.concatenate(columns)
    information, projection = all_columns.T @ all_columns, all_columns.T @ all_rows
    information += 1e-12 * np.trace(information) * np.eye(len(information))
    explained = float(projection @ np.linalg.solve(information, projection))
    return total + float(all_rows @ all_rows) + float(np.linalg.slogdet(information)[1]) - explained
