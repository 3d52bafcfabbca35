"""What the residuals of a thermal fit say of its uncertainty: noise from frame to frame, and drift that lasts.

A camera drifts between its own calibrations and the air of a room moves, so that neighbouring frames are off alike and
their number means little. Noise is white and by itself at each node; drift decays over a time of its own and both nodes
may share it. Both are found by restricted maximum likelihood in the frequency domain (Whittle, 1953; Patterson &
Thompson, 1971), which counts what the fit has taken out of the residuals. The covariance of the unknowns is that of
plain least squares under such residuals.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from leactl.analysis.heating.record import Array

PACE_S = 1.0  # residuals are looked at as means over this long, or over 1/4000 of a stretch
MOST = 4000
SOONEST, LATEST = 2.0, 0.1  # paces, part of a stretch: how long a drift may last
TRIES = (10.0, 200.0)  # s


@dataclass(frozen=True, eq=False)
class BinnedResiduals:
    """Residuals and columns of one stretch in bins: sums for the estimate, means for what it is held against."""

    pace: float  # s
    residuals: Array  # (nodes, bins), means [K]; zero where nothing was seen
    columns: Array  # (nodes, bins, unknowns), sums over the frames seen
    # Of noise from frame to frame, sums would miss what goes up and down within a bin, as columns do after a switch.
    products: Array  # (nodes, unknowns, unknowns), of columns over all frames, times the mean number of frames in a bin


@dataclass(frozen=True, eq=False)
class Scatter:
    """Noise and drift of residuals in bins of `PACE_S`."""

    noise: Array  # (nodes,), variance of the noise of a bin
    drift: Array  # (nodes, nodes), covariance of the drift
    lasts: float  # s, that a drift decays over
    span: float  # s, of record behind it
    calm: Array  # (nodes,), variance of the noise of a bin if there is no drift
    seen: float  # weight of the drift against none, after Akaike (Burnham & Anderson, 2002, section 2.9)

    @property
    def weighed(self) -> Self:
        """The mean of both by their weights: of little data, chance alone makes a drift as large as the noise."""
        noise = self.seen * self.noise + (1.0 - self.seen) * self.calm
        return replace(self, noise=noise, drift=self.seen * self.drift)

    @property
    def dof(self) -> float:
        """Degrees of freedom that the drift's variance rests on: a piece of record for each time that it lasts."""
        return max(self.span / (2.0 * self.lasts) - 1.0, 1.0)


def binned_residuals(
    times: Sequence[Array], residuals: Sequence[Array], columns: Sequence[Array]
) -> list[BinnedResiduals]:
    """Stretches in bins; residuals of shape (nodes, frames), NaN where missing, columns (nodes, frames, unknowns)."""
    found = []
    for time, left, column in zip(times, residuals, columns, strict=True):
        pace = max(PACE_S, float(time[-1] - time[0]) / MOST, 2.0 * float(np.median(np.diff(time))))
        bins = ((time - time[0]) / pace).astype(np.int64)
        size = int(bins[-1]) + 1
        products = np.zeros((len(left), column.shape[2], column.shape[2]))
        means, sums = np.zeros((len(left), size)), np.zeros((len(left), size, column.shape[2]))
        for node, row in enumerate(left):
            seen = np.isfinite(row)
            count = np.bincount(bins[seen], minlength=size)
            means[node] = np.bincount(bins[seen], row[seen], size) / np.maximum(count, 1)
            products[node] = column[node][seen].T @ column[node][seen] * np.mean(count[count > 0])
            for k in range(column.shape[2]):
                sums[node, :, k] = np.bincount(bins[seen], column[node][seen, k], size)
        found.append(BinnedResiduals(pace, means, sums, products))
    return found


def scatter_of(parts: Sequence[BinnedResiduals]) -> Scatter:
    """Noise and drift by restricted maximum likelihood."""
    from scipy.optimize import minimize

    nodes = len(parts[0].residuals)
    span = sum(part.pace * part.residuals.shape[1] for part in parts)
    spread = np.array(
        [max(math.sqrt(np.mean(np.concatenate([p.residuals[n] for p in parts]) ** 2)), 1e-9) for n in range(nodes)]
    )
    spectra = _spectra(parts, spread)
    low, high = math.log(SOONEST * parts[0].pace), math.log(max(LATEST * span, 4.0 * parts[0].pace))
    lower = [(n, k) for n in range(nodes) for k in range(n + 1)]
    bounds = [(-14.0, 3.0)] * nodes + [(-3.0, 3.0)] * len(lower) + [(low, high)]

    def unpacked(point: Array) -> Scatter:
        root = np.zeros((nodes, nodes))
        for (n, k), value in zip(lower, point[nodes:-1], strict=True):
            root[n, k] = value
        noise = np.exp(point[:nodes])
        return Scatter(noise, root @ root.T, math.exp(point[-1]), span, noise, 1.0)

    def cost(point: Array) -> float:
        return _unlikelihood(unpacked(point), spectra)

    found = []
    for lasts in TRIES:
        start = [math.log(0.7)] * nodes + [0.3 if n == k else 0.0 for n, k in lower]
        begin = np.array([*start, min(max(math.log(lasts), low), high)])
        found.append(minimize(cost, begin, method="L-BFGS-B", bounds=bounds))
    best = min(found, key=lambda one: float(one.fun))
    still = bounds[:nodes] + [(0.0, 0.0)] * len(lower) + [(low, low)]
    calm = minimize(cost, [0.0] * (nodes + len(lower)) + [low], method="L-BFGS-B", bounds=still)
    seen = 1.0 / (1.0 + math.exp(min(len(lower) + 1 - 0.5 * (calm.fun - best.fun), 700.0)))
    told, scale = unpacked(best.x), np.outer(spread, spread)
    without = np.exp(calm.x[:nodes]) * spread**2
    return Scatter(told.noise * spread**2, told.drift * scale, told.lasts, span, without, seen)


def covariance_of_sums(part: BinnedResiduals, scatter: Scatter) -> tuple[Array, Array]:
    """Covariance of sums of residuals weighted by the columns, by noise and by drift: (unknowns, unknowns) each."""
    bins = part.columns.shape[1]
    padded = np.fft.rfft(part.columns, 2 * bins, axis=1)
    weight = _halves(2 * bins) / (2 * bins)
    shape = drift_spectrum(scatter.lasts, part.pace, 2 * bins) * weight
    by_noise = np.tensordot(scatter.noise, part.products, 1)
    mixed = np.einsum("nm,mfl->nfl", scatter.drift, padded)
    by_drift = np.einsum("nfk,nfl,f->kl", padded.conj(), mixed, shape, optimize=True).real
    return np.asarray(by_noise), np.asarray(by_drift)


def drift_spectrum(lasts: float, pace: float, size: int) -> Array:
    """Spectrum of a drift of unit variance in bins, at the frequencies of a real transform."""
    stays = math.exp(-pace / lasts)
    turn = 2.0 * np.pi * np.arange(size // 2 + 1) / size
    return np.asarray((1.0 - stays**2) / (1.0 - 2.0 * stays * np.cos(turn) + stays**2), np.float64)


def _halves(size: int) -> Array:
    """How often each frequency of a real transform counts."""
    weight = np.full(size // 2 + 1, 2.0)
    weight[0] = 1.0
    if size % 2 == 0:
        weight[-1] = 1.0
    return weight


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Transforms of one stretch, real and imaginary parts one after the other, each weighted by how often it counts."""

    residuals: Array  # (nodes, parts), over their spread
    columns: Array  # (nodes, parts, unknowns), over theirs
    size: int  # bins
    pace: float  # s


def _spectra(parts: Sequence[BinnedResiduals], spread: Array) -> list[Spectrum]:
    columns = [part.columns / spread[:, None, None] for part in parts]
    length = np.sqrt(sum(np.sum(one**2, axis=(0, 1)) for one in columns))
    length[length == 0.0] = 1.0
    found = []
    for part, column in zip(parts, columns, strict=True):
        size = part.residuals.shape[1]
        weight = np.sqrt(_halves(size) / size)
        left = np.fft.rfft(part.residuals / spread[:, None], axis=1) * weight
        turned = np.fft.rfft(column / length, axis=1) * weight[:, None]
        rows, stacked = (np.concatenate([one.real, one.imag], axis=1) for one in (left, turned))
        found.append(Spectrum(rows, stacked, size, part.pace))
    return found


def _unlikelihood(told: Scatter, spectra: Sequence[Spectrum]) -> float:
    """Minus twice the logarithm of the restricted likelihood.

    Noise and drift are made independent at each frequency by one turn for all, in which noise has variance one.
    """
    root = 1.0 / np.sqrt(told.noise)
    drifts, vectors = np.linalg.eigh(told.drift * np.outer(root, root))
    turn = vectors.T * root
    total, rows, columns = 0.0, [], []
    for one in spectra:
        shape = drift_spectrum(told.lasts, one.pace, one.size)
        density = 1.0 + np.maximum(drifts, 0.0)[:, None] * shape
        total += float(_halves(one.size) @ np.log(density).sum(axis=0)) + one.size * float(np.log(told.noise).sum())
        scale = 1.0 / np.sqrt(np.tile(density, 2))
        rows.append(((turn @ one.residuals) * scale).ravel())
        columns.append((np.tensordot(turn, one.columns, 1) * scale[:, :, None]).reshape(-1, one.columns.shape[2]))
    row, column = np.concatenate(rows), np.concatenate(columns)
    informed, crossed = column.T @ column, column.T @ row
    informed += 1e-12 * np.trace(informed) * np.eye(len(informed))
    taken = float(crossed @ np.linalg.solve(informed, crossed))
    return total + float(row @ row) + float(np.linalg.slogdet(informed)[1]) - taken
