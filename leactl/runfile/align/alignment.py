"""One clock tied to another: offset and drift from points that both have seen, with their uncertainty.

Every method gives ties, moments that stand on both clocks, each with its standard deviation. A straight line through
them is the alignment. What one clock may drift against the other is known beforehand within a bound; it enters as a
prior on the slope, so that a single tie gives an offset that is worth less the further away it is looked at.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.runfile.align.similarity import FAR_APART, FEWEST_COMMON, ends_search, peaks

Array = npt.NDArray[np.float64]
NORMAL_95 = 1.959964
LIKENESS = 0.8  # correlation below which two channels did not measure the same
LEAST_SHARE = 0.05  # a channel's noise and its own derivative cancel from sample to sample
LEAST_PART = 1.0 / 3.0  # of what the best shift explains: a record's part that explains less may fit by chance
BLOCKS = 12  # of the common time, each of which gives a tie
FEWEST_IN_BLOCK = 30  # samples
LEAST_DRIFT = 1e-12
LEAST_SD = 0.01  # of the sampling interval: between samples lies a straight line


class Tie(NamedTuple):
    """One moment on both clocks."""

    own: float  # s
    run: float  # s
    sd: float  # s, of their difference


@dataclass(frozen=True)
class Alignment:
    """run time = offset + rate * own time."""

    method: str
    offset: float  # s
    rate: float
    covariance: tuple[float, float, float]  # of offset and rate: s^2, s, 1; before `systematic`
    systematic: float  # s, 95 %: delays that no tie shows
    quantile: float  # of what the covariance is multiplied by for 95 %
    ties: int

    def on_run(self, own: Array) -> Array:
        """Stamps on the run's clock."""
        return np.asarray(self.offset + self.rate * own, np.float64)

    def uncertainty(self, own: float) -> float:
        """Half the 95 % interval of a stamp on the run's clock [s]."""
        a, ab, b = self.covariance
        return math.hypot(self.quantile * math.sqrt(max(a + 2 * own * ab + own * own * b, 0.0)), self.systematic)

    def told(self, own: float = 0.0) -> str:
        """One line for people, with what a stamp at `own` is worth."""
        drift = f", drift {self.drift_ppm:+.3g} +- {self.drift_uncertainty_ppm:.2g} ppm" if self.covariance[2] else ""
        at = float(self.on_run(np.array([own]))[0])
        when = f" at {own:.6g} s of its own" if own else ""
        return f"offset {at - own:.6g} +- {self.uncertainty(own):.2g} s (95 %){when}{drift}, by {self.method}"

    @property
    def drift_ppm(self) -> float:
        """How much faster the run's clock goes."""
        return 1e6 * (self.rate - 1.0)

    @property
    def drift_uncertainty_ppm(self) -> float:
        """Half the 95 % interval of the drift."""
        return 1e6 * self.quantile * math.sqrt(max(self.covariance[2], 0.0))


def tied(method: str, ties: Sequence[Tie], drift_within: float, systematic: float) -> Alignment:
    """The line through ties.

    Parameters
    ----------
    drift_within : what the rate is known to be within of 1 beforehand (95 %).
    systematic : delays between what the ties compare that stay the same (95 %) [s].
    """
    own = np.array([tie.own for tie in ties])
    shift = np.array([tie.run - tie.own for tie in ties])
    weight = 1.0 / np.array([tie.sd for tie in ties]) ** 2
    centre = float(np.average(own, weights=weight))
    u = own - centre
    prior = (max(drift_within, LEAST_DRIFT) / NORMAL_95) ** -2
    normal = np.array([[weight.sum(), (weight * u).sum()], [(weight * u).sum(), (weight * u * u).sum() + prior]])
    covariance = np.linalg.inv(normal)
    mean, slope = covariance @ np.array([(weight * shift).sum(), (weight * u * shift).sum()])
    free = len(ties) - (2 if drift_within > LEAST_DRIFT else 1)
    quantile = NORMAL_95
    if free >= 1:
        from scipy.stats import t

        # ties that scatter by more than they claim are worth less; fewer than they claim is luck
        scatter = float((weight * (shift - mean - slope * u) ** 2).sum()) / free
        covariance = covariance * max(scatter, 1.0)
        quantile = float(t.ppf(0.975, free)) if scatter > 1.0 else NORMAL_95
    at_zero = np.array([[1.0, -centre], [0.0, 1.0]])
    a, b = at_zero @ covariance @ at_zero.T
    return Alignment(
        method, float(mean - slope * centre), 1.0 + float(slope), (a[0], a[1], b[1]), systematic, quantile, len(ties)
    )


def ties_by_likeness(
    time: Array, values: Array, base: Array, reference: Array, shift: float, rate: float = 1.0
) -> list[Tie]:
    """Ties of two channels that measured the same, one for each block of their common time.

    Near the shift that `lag` has found the channel is a scaled reference plus its derivative times what the shift still
    lacks. Noise of the reference would draw that towards nothing; the channel's own derivative is the instrument that
    it is estimated with. Both are compared where the slower one was sampled; the finer one is interpolated.
    """
    good, sound = np.isfinite(values), np.isfinite(reference)
    time, values, base, reference = shift + rate * time[good], values[good], base[sound], reference[sound]
    fine = float(np.median(np.diff(time))) < float(np.median(np.diff(base)))
    grid = base if fine else time
    interval = float(np.median(np.diff(grid)))
    first, last = max(time[0], base[0]) + interval, min(time[-1], base[-1]) - interval
    grid = grid[(grid > first) & (grid < last)]
    own, own_slope = with_slope(grid, time, values, interval)
    there, slope = with_slope(grid, base, reference, interval)
    spread = float(np.std(there))
    if len(grid) < FEWEST_COMMON or spread == 0.0:
        return []
    gain = math.copysign(float(np.std(own)) / spread, float((own - own.mean()) @ (there - there.mean())))
    level = np.stack([there, np.ones(len(grid))], axis=1)
    delayed, instrument, found = (apart_from(level, column) for column in (gain * slope, own_slope, own))
    if not float(instrument @ delayed):
        return []
    parts = np.array_split(np.arange(len(grid)), max(1, min(BLOCKS, len(grid) // FEWEST_IN_BLOCK)))
    # a block's own noise, known from a few samples, would make a poor weight: that of all blocks counts
    common = float(instrument @ found) / float(instrument @ delayed)
    scores = instrument * (found - common * delayed)
    noise = sum(autocorrelated(scores[part]) for part in parts) / float(instrument @ instrument)
    ties = []
    for part in parts:
        x, z, y = delayed[part], instrument[part], found[part]
        shared = float(z @ x)
        sd = math.hypot(math.sqrt(noise * float(z @ z)) / abs(shared), LEAST_SD * interval) if shared else math.inf
        if sd < 0.5 * (grid[part[-1]] - grid[part[0]]):
            at = float(np.average(grid[part], weights=own_slope[part] ** 2))
            ties.append(Tie((at - shift) / rate, at + float(z @ y) / shared, sd))
    return ties


def apart_from(others: Array, column: Array) -> Array:
    """What of a column the others do not make up."""
    rest: Array = column - others @ np.linalg.lstsq(others, column, rcond=None)[0]
    return rest


def with_slope(grid: Array, time: Array, values: Array, interval: float) -> tuple[Array, Array]:
    """A channel and its central difference over one interval to either side, where another one was sampled."""
    ahead, behind = np.interp(grid + interval, time, values), np.interp(grid - interval, time, values)
    return np.interp(grid, time, values), (ahead - behind) / (2.0 * interval)


def autocorrelated(scores: Array, least: float = LEAST_SHARE) -> float:
    """Variance of the sum of correlated scores, after Newey and West (1987), Bartlett weights.

    Parameters
    ----------
    least : share of what it would be without correlation that it never falls below.
    """
    count = len(scores)
    lags = min(count - 1, 4 + int(4.0 * (count / 100.0) ** (2.0 / 9.0)))
    centred = scores - scores.mean()
    alone = total = float(centred @ centred)
    for k in range(1, lags + 1):
        total += 2.0 * (1.0 - k / (lags + 1.0)) * float(centred[k:] @ centred[:-k])
    return max(total, least * alone) * count / max(count - 3, 1)


def misfit(own: tuple[Array, Array], reference: tuple[Array, Array], better: Alignment, worse: Alignment) -> float:
    """By how many standard deviations one alignment misfits more than another, over the samples that both compare.

    Where both fit alike, the squares that they leave are noise of the same kind, whose sum is as uncertain as that of
    the better one shows. What one sampling interval changes tells nothing: where in it an edge lay is not seen.
    """
    (time, values), (base, there) = own, reference
    interval = float(np.median(np.diff(base)))
    # samples between those of the reference share its noise
    every = max(1, round(interval / float(np.median(np.diff(time)))))
    time, values = time[::every], values[::every]
    interval = max(interval, float(np.median(np.diff(time))))
    moved = [alignment.on_run(time) for alignment in (better, worse)]
    inside = np.logical_and.reduce([(stamps >= base[0]) & (stamps <= base[-1]) for stamps in moved])
    if inside.sum() < FEWEST_COMMON:
        return 0.0

    def levelled(stamps: Array) -> Array:
        return np.stack([np.interp(stamps, base, there), np.ones(len(stamps))], axis=1)

    seen = values[inside]
    model = levelled(moved[0][inside])
    gain = np.linalg.lstsq(model, seen, rcond=None)[0]
    left = (seen - model @ gain) ** 2
    more = apart_from(levelled(moved[1][inside]), seen) ** 2 - left
    half = 0.5 * interval
    step = (levelled(moved[0][inside] + half) - levelled(moved[0][inside] - half)) @ gain
    # the noise of two samples is in that step, too, and makes no edge
    unseen = max(float(step @ step) - 2.0 * float(left.sum()), 0.0)
    sd = math.sqrt(2.0 * autocorrelated(left, least=1.0))
    return (float(more.sum()) - unseen) / max(sd, 1e-12 * float(seen @ seen), 1e-300)


def by_likeness(
    own: tuple[Array, Array],
    reference: tuple[Array, Array],
    within: float,
    what: str,
    near: float = 0.0,
    drift_within: float = 0.0,
    systematic: float = 0.0,
) -> Alignment:
    """Tie two channels, each as stamps and values, that measured the same.

    Parameters
    ----------
    near, within : s, offsets that are looked at.
    drift_within : none, by default: one offset for the whole record.

    Raises
    ------
    InputError : they did not measure the same, do not change enough to tell when, or are as alike at another offset.
    """
    good, sound = np.isfinite(own[1]), np.isfinite(reference[1])
    own, reference = (own[0][good], own[1][good]), (reference[0][sound], reference[1][sound])
    found = peaks(*own, *reference, within, near)
    likeness = max((peak.likeness for peak in found), default=0.0)
    if likeness < LIKENESS:
        raise InputError(f"{what} correlate by {likeness:.2f} at best; expected {LIKENESS} within {within:g} s")
    # a short part of a record may fit by chance; where it fits better than the whole, neither is sure
    most = max(peak.explained for peak in found if peak.likeness >= LIKENESS)
    best = next(peak for peak in found if peak.explained >= LEAST_PART * most)
    method = f"likeness of {what} ({best.likeness:.3f})"
    alignment = placed(own, reference, best.shift, method, drift_within, systematic)
    for rival in found:
        whole = rival.explained >= LEAST_PART * most
        if rival is best or ends_search(rival, within, near) or not (whole or rival.likeness >= LIKENESS):
            continue
        other = placed(own, reference, rival.shift, method, drift_within, systematic)
        doubtful = misfit(own, reference, alignment, other) <= FAR_APART
        if doubtful if whole else misfit(own, reference, other, alignment) > FAR_APART:
            raise InputError(
                f"{what} are as alike at {best.shift:.6g} s as at {rival.shift:.6g} s; a smaller within_s around the"
                " true one (near_s), or another signal, decides"
            )
    if ends_search(best, within, near):
        raise InputError(f"{what} are likest at {best.shift:.6g} s, where the search ends; expected a peak before that")
    if not alignment.ties:
        raise InputError(f"{what} change too little beside their noise to tell when")
    return alignment


def placed(
    own: tuple[Array, Array],
    reference: tuple[Array, Array],
    shift: float,
    method: str,
    drift_within: float,
    systematic: float,
) -> Alignment:
    """The alignment near a shift; without ties, and at the shift itself, where the channels do not tell."""
    found = Alignment(method, shift, 1.0, (0.0, 0.0, 0.0), systematic, NORMAL_95, 0)
    for _ in range(2):
        ties = ties_by_likeness(*own, *reference, found.offset, found.rate)
        if not ties:
            return replace(found, ties=0)
        found = tied(method, ties, drift_within, systematic)
    return found
