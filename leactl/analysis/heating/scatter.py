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

SHORTEST_BIN_S = 1.0  # width of a bin
MOST_BINS = 4000  # of a record; longer records have wider bins
SHORTEST_DECAY_BINS, LONGEST_DECAY_SHARE = 2.0, 0.1  # decay of a drift in bins, and over the length of all records
DECAY_STARTS_S = (10.0, 200.0)  # starting values of a drift's decay time


@dataclass(frozen=True, eq=False)
class BinnedResiduals:
    """Residuals and derivatives of one record in bins of equal length."""

    bin_width: float  # s
    residuals: Array  # (nodes, bins), means [K]; zero in a bin without a frame
    columns: Array  # (nodes, bins, unknowns), sums of the derivatives over the frames of a bin
    # Products are summed over frames for the noise: sums over a bin would lose changes of the derivatives within it,
    # as after the current is switched.
    products: Array  # (nodes, unknowns, unknowns), of columns over all frames, times the mean number of frames in a bin


@dataclass(frozen=True, eq=False)
class Scatter:
    """Noise and drift of residuals in bins of equal length, at least `SHORTEST_BIN_S` each."""

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
    """Return averaged residuals and summed derivatives in bins of each record.

    Parameters
    ----------
    times : stamps of the frames of each record [s], (frames,).
    residuals : of each record [K], (nodes, frames), NaN where missing.
    columns : derivatives of the fitted values of each record, (nodes, frames, unknowns).
    """
    binned_records = []
    for time, record_residuals, derivatives in zip(times, residuals, columns, strict=True):
        bin_width = max(SHORTEST_BIN_S, float(time[-1] - time[0]) / MOST_BINS, 2.0 * float(np.median(np.diff(time))))
        bin_of_frame = ((time - time[0]) / bin_width).astype(np.int64)
        bin_count = int(bin_of_frame[-1]) + 1
        products = np.zeros((len(record_residuals), derivatives.shape[2], derivatives.shape[2]))
        mean_residuals, derivative_sums = (
            np.zeros((len(record_residuals), bin_count)),
            np.zeros((len(record_residuals), bin_count, derivatives.shape[2])),
        )
        for node, node_residuals in enumerate(record_residuals):
            finite = np.isfinite(node_residuals)
            frames_in_bin = np.bincount(bin_of_frame[finite], minlength=bin_count)
            mean_residuals[node] = np.bincount(bin_of_frame[finite], node_residuals[finite], bin_count) / np.maximum(
                frames_in_bin, 1
            )
            products[node] = (
                derivatives[node][finite].T @ derivatives[node][finite] * np.mean(frames_in_bin[frames_in_bin > 0])
            )
            for unknown in range(derivatives.shape[2]):
                derivative_sums[node, :, unknown] = np.bincount(
                    bin_of_frame[finite], derivatives[node][finite, unknown], bin_count
                )
        binned_records.append(BinnedResiduals(bin_width, mean_residuals, derivative_sums, products))
    return binned_records


def scatter_of(bins: Sequence[BinnedResiduals]) -> Scatter:
    """Estimate noise and drift by restricted maximum likelihood, with and without drift."""
    from scipy.optimize import minimize

    nodes = len(bins[0].residuals)
    span = sum(record_bins.bin_width * record_bins.residuals.shape[1] for record_bins in bins)
    rms = np.array(
        [
            max(math.sqrt(np.mean(np.concatenate([record_bins.residuals[node] for record_bins in bins]) ** 2)), 1e-9)
            for node in range(nodes)
        ]
    )
    spectra = _spectra(bins, rms)
    shortest_log_decay, longest_log_decay = (
        math.log(SHORTEST_DECAY_BINS * bins[0].bin_width),
        math.log(max(LONGEST_DECAY_SHARE * span, 4.0 * bins[0].bin_width)),
    )
    lower_triangle = [(row, column) for row in range(nodes) for column in range(row + 1)]
    bounds = [(-14.0, 3.0)] * nodes + [(-3.0, 3.0)] * len(lower_triangle) + [(shortest_log_decay, longest_log_decay)]

    def scatter_at(point: Array) -> Scatter:
        root = np.zeros((nodes, nodes))
        for (row, column), value in zip(lower_triangle, point[nodes:-1], strict=True):
            root[row, column] = value
        noise = np.exp(point[:nodes])
        return Scatter(noise, root @ root.T, math.exp(point[-1]), span, noise, 1.0)

    def deviance_at(point: Array) -> float:
        return _restricted_deviance(scatter_at(point), spectra)

    optima = []
    for decay_time in DECAY_STARTS_S:
        start = [math.log(0.7)] * nodes + [0.3 if row == column else 0.0 for row, column in lower_triangle]
        starting_point = np.array([*start, min(max(math.log(decay_time), shortest_log_decay), longest_log_decay)])
        optima.append(minimize(deviance_at, starting_point, method="L-BFGS-B", bounds=bounds))
    best = min(optima, key=lambda optimum: float(optimum.fun))
    drift_terms = len(lower_triangle)
    bounds_without_drift = bounds[:nodes] + [(0.0, 0.0)] * drift_terms + [(shortest_log_decay, shortest_log_decay)]
    without_drift = minimize(
        deviance_at,
        [0.0] * (nodes + drift_terms) + [shortest_log_decay],
        method="L-BFGS-B",
        bounds=bounds_without_drift,
    )
    drift_weight = 1.0 / (1.0 + math.exp(min(drift_terms + 1 - 0.5 * (without_drift.fun - best.fun), 700.0)))
    with_drift, scale = scatter_at(best.x), np.outer(rms, rms)
    noise_without_drift = np.exp(without_drift.x[:nodes]) * rms**2
    return Scatter(
        with_drift.noise * rms**2,
        with_drift.drift * scale,
        with_drift.decay_time,
        span,
        noise_without_drift,
        drift_weight,
    )


def covariance_of_sums(record_bins: BinnedResiduals, scatter: Scatter) -> tuple[Array, Array]:
    """Return the covariance by noise, and that by drift, of the sums of residuals times derivatives.

    Both have shape (unknowns, unknowns).
    """
    bin_count = record_bins.columns.shape[1]
    transform = np.fft.rfft(record_bins.columns, 2 * bin_count, axis=1)
    weight = _multiplicity(2 * bin_count) / (2 * bin_count)
    density = drift_spectrum(scatter.decay_time, record_bins.bin_width, 2 * bin_count) * weight
    by_noise = np.tensordot(scatter.noise, record_bins.products, 1)
    drift_transform = np.einsum("nm,mfl->nfl", scatter.drift, transform)
    by_drift = np.einsum("nfk,nfl,f->kl", transform.conj(), drift_transform, density, optimize=True).real
    return np.asarray(by_noise), np.asarray(by_drift)


def drift_spectrum(decay_time: float, bin_width: float, size: int) -> Array:
    """Return the power spectrum of a drift of unit variance, sampled in bins, at the frequencies of a real transform.

    `decay_time` and `bin_width` are in s; `size` is the number of bins that are transformed.
    """
    decay = math.exp(-bin_width / decay_time)
    angles = 2.0 * np.pi * np.arange(size // 2 + 1) / size
    return np.asarray((1.0 - decay**2) / (1.0 - 2.0 * decay * np.cos(angles) + decay**2), np.float64)


def _multiplicity(size: int) -> Array:
    """Return how often each frequency of a real transform occurs in the complex transform.

    That is twice, but once for frequency zero and, if `size` is even, for the highest frequency.
    """
    weight = np.full(size // 2 + 1, 2.0)
    weight[0] = 1.0
    if size % 2 == 0:
        weight[-1] = 1.0
    return weight


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Fourier transforms of one record, real before imaginary parts, weighted by how often each frequency counts."""

    residuals: Array  # (nodes, parts), over the rms of the residuals
    columns: Array  # (nodes, parts, unknowns), each column normalised over all records
    size: int  # bins
    bin_width: float  # s


def _spectra(bins: Sequence[BinnedResiduals], rms: Array) -> list[Spectrum]:
    """Return the spectrum of each record; `rms` is that of the residuals of each node, shape (nodes,)."""
    scaled_columns = [record_bins.columns / rms[:, None, None] for record_bins in bins]
    norms = np.sqrt(sum(np.sum(transform**2, axis=(0, 1)) for transform in scaled_columns))
    norms[norms == 0.0] = 1.0
    spectra = []
    for record_bins, derivatives in zip(bins, scaled_columns, strict=True):
        size = record_bins.residuals.shape[1]
        weight = np.sqrt(_multiplicity(size) / size)
        residual_transform = np.fft.rfft(record_bins.residuals / rms[:, None], axis=1) * weight
        column_transform = np.fft.rfft(derivatives / norms, axis=1) * weight[:, None]
        residual_parts, column_parts = (
            np.concatenate([transform.real, transform.imag], axis=1)
            for transform in (residual_transform, column_transform)
        )
        spectra.append(Spectrum(residual_parts, column_parts, size, record_bins.bin_width))
    return spectra


def _restricted_deviance(scatter: Scatter, spectra: Sequence[Spectrum]) -> float:
    """Return the restricted deviance: minus twice the logarithm of the restricted likelihood.

    A rotation of the nodes makes noise and drift independent at each frequency and gives the noise variance one.
    """
    noise_scale = 1.0 / np.sqrt(scatter.noise)
    drift_variances, vectors = np.linalg.eigh(scatter.drift * np.outer(noise_scale, noise_scale))
    rotation = vectors.T * noise_scale
    log_determinant, whitened_residuals, whitened_columns = 0.0, [], []
    for spectrum in spectra:
        drift_density = drift_spectrum(scatter.decay_time, spectrum.bin_width, spectrum.size)
        density = 1.0 + np.maximum(drift_variances, 0.0)[:, None] * drift_density
        log_determinant += float(_multiplicity(spectrum.size) @ np.log(density).sum(axis=0)) + spectrum.size * float(
            np.log(scatter.noise).sum()
        )
        scale = 1.0 / np.sqrt(np.tile(density, 2))
        whitened_residuals.append(((rotation @ spectrum.residuals) * scale).ravel())
        whitened_columns.append(
            (np.tensordot(rotation, spectrum.columns, 1) * scale[:, :, None]).reshape(-1, spectrum.columns.shape[2])
        )
    residuals, all_columns = np.concatenate(whitened_residuals), np.concatenate(whitened_columns)
    information, projection = all_columns.T @ all_columns, all_columns.T @ residuals
    information += 1e-12 * np.trace(information) * np.eye(len(information))
    explained = float(projection @ np.linalg.solve(information, projection))
    return log_determinant + float(residuals @ residuals) + float(np.linalg.slogdet(information)[1]) - explained
