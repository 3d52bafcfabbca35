"""Find the stretches in which a channel holds a level, between changes that exceed its noise.

A setpoint repeats its level exactly, so that every change ends a stretch. In a reading, a level changes where the means
of the rows before and after differ by more than the scatter of such means (moving sums, MOSUM: Eichinger and Kirch,
Bernoulli 24, 2018). That scatter is estimated from the recording at the length of the means: the noise from row to row
underestimates it if the noise is coloured by a filter, a ripple or a control loop.
"""

import math
from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]
WINDOWS_PER_HOLD = 4  # windows in the shortest hold; those before and after a row leave half of the hold undisturbed
FEWEST_WINDOW_ROWS = 8  # rows of a window, so that its scatter can be estimated
CHANGE_STDS = 5.0  # standard deviations by which the means of two windows differ where a level changes
CALM_QUANTILE = 0.1  # quantile of change over scatter from which the scatter of means is first estimated
# |z| below which 20 % of a normal variable lie: half of the rows lie in holds, so 2 * CALM_QUANTILE
CALM_NORMAL_QUANTILE = 0.2533
SCATTER_ERROR_STDS = 2.0  # standard errors added to the estimated scatter of means
MOST_ROUNDS = 20  # iterations in which changes are left out; fewer if the estimate no longer changes
# a row is off its level beyond 2.5 times the 99.5 % quantile of deviations (7 sd if normal)
TAIL_QUANTILE, TAIL_MULTIPLE = 0.995, 2.5
ROUNDING_ERROR = 1e-9  # relative rounding error of a mean of equal numbers
MOST_DRIFT_SHARE = 0.25  # of the smallest step between levels; a level may drift by this beyond its noise


class LevelHold(NamedTuple):
    """A stretch of rows at one level."""

    first: int  # index of the first row
    after: int  # index of the row after the last
    level: float
    before: float  # value of the channel before the stretch; NaN if not known


class NotDistinct(Exception):
    """Levels cannot be distinguished from noise; the message says where."""


def find_holds(time: Array, values: Array, least_s: float, settle_s: float, is_setpoint: bool) -> list[LevelHold]:
    """Find the stretches of at least `least_s` in which a channel stays at one level.

    A single deviating row of a setpoint is ignored, two in sequence end a stretch; a stretch of a reading ends where
    its mean changes. Missing rows end a stretch if they last a quarter of `least_s` or more.

    Raises
    ------
    NotDistinct : a noisy channel without a change of level, or a level that wanders by more than noise explains.
    """
    finite_rows = np.flatnonzero(np.isfinite(values))
    if not len(finite_rows):
        return []
    stamps, levels = time[finite_rows], median_of_three(values[finite_rows])
    rounding_error = ROUNDING_ERROR * float(np.abs(levels).max())
    window = round(len(finite_rows) * least_s / WINDOWS_PER_HOLD / max(float(stamps[-1] - stamps[0]), least_s))
    # rows after which a channel has no value for long, for example a setpoint while its drive is in another mode
    silences = np.flatnonzero(np.diff(stamps, append=time[-1]) > least_s / WINDOWS_PER_HOLD) + 1

    def lasting_holds(holds: Iterable[LevelHold]) -> dict[LevelHold, LevelHold]:
        """Return the parts of holds that last `least_s`, in indices of all rows by those in indices of finite rows."""
        parts = {
            part: rows_among_all(part, finite_rows, silences, len(values))
            for part in split_at_silences(holds, silences)
        }
        ends = {part: float(time[min(hold.after, len(time) - 1)]) for part, hold in parts.items()}
        return {part: hold for part, hold in parts.items() if ends[part] - time[hold.first] >= least_s}

    holds = (
        lasting_holds(constant_stretches(levels, rounding_error)) if is_setpoint or window < FEWEST_WINDOW_ROWS else {}
    )
    if not holds and window >= FEWEST_WINDOW_ROWS:
        means = WindowMeans(levels, window)
        holds = lasting_holds(between_changes(levels, means, rounding_error))
        refuse_drift([*holds], levels, means, stamps, settle_s, rounding_error)
    return [*holds.values()]


def median_of_three(values: Array) -> Array:
    """Return the median of each row and its two neighbours, which removes single deviating rows and keeps edges."""
    if len(values) < 3:
        return values
    middle = np.median(np.stack([values[:-2], values[1:-1], values[2:]]), axis=0)
    return np.concatenate([values[:1], middle, values[-1:]])


def split_at_silences(holds: Iterable[LevelHold], silences: Rows) -> Iterator[LevelHold]:
    """Split holds at rows that follow a silence; `before` of a part after a silence is NaN."""
    for hold in holds:
        splits = silences[(silences > hold.first) & (silences < hold.after)].tolist()
        for first, after in pairwise([hold.first, *splits, hold.after]):
            yield hold._replace(first=first, after=after, before=math.nan if first in silences else hold.before)


def rows_among_all(hold: LevelHold, finite_rows: Rows, silences: Rows, rows: int) -> LevelHold:
    """Convert a hold from indices of finite rows to indices of all rows."""
    if hold.after in silences:
        after = int(finite_rows[hold.after - 1]) + 1
    else:
        after = int(finite_rows[hold.after]) if hold.after < len(finite_rows) else rows
    return hold._replace(first=int(finite_rows[hold.first]), after=after)


def constant_stretches(values: Array, rounding_error: float) -> list[LevelHold]:
    """Return the stretches in which the value is constant up to `rounding_error`."""
    changes = np.flatnonzero(np.abs(np.diff(values)) > rounding_error) + 1
    edges = [0, *changes.tolist(), len(values)]
    return [
        LevelHold(first, after, float(values[first]), float(values[first - 1]) if first else math.nan)
        for first, after in pairwise(edges)
    ]


class WindowMeans:
    """Moving means before and after each row, and the scatter of the rows in them."""

    def __init__(self, values: Array, window: int) -> None:
        rows = np.arange(len(values)) - 0.5 * (len(values) - 1)
        centred = values - values.mean()
        mean, square, moment = (window_means(column, window) for column in (centred, centred**2, rows * centred))
        # without the slope of a ramp, which is not noise
        middle = rows[: len(mean)] + 0.5 * (window - 1)
        slope_variance = (moment - middle * mean) ** 2 / ((window**2 - 1) / 12.0)
        variance = np.maximum(square - mean**2 - slope_variance, 0.0)
        self.window = window
        self.mean = mean  # of the window that begins at each row
        self.change = mean[window:] - mean[:-window]  # at row `window` and later: mean after the row minus mean before
        self.scatter = np.sqrt(0.5 * (variance[window:] + variance[:-window]))
        self.least_step = float(np.ptp(mean))  # from one level to the next
        self.correlation_factor = 0.0  # scatter of the means over the scatter of the rows in them

    def estimate_correlation_factor(self, rounding_error: float) -> None:
        """Estimate the scatter of window means relative to that of rows, from windows in which no level changes."""
        noisy = self.scatter > rounding_error
        if not noisy.any():
            return
        ratios = np.abs(self.change) / np.maximum(self.scatter, rounding_error)
        factor = float(np.quantile(ratios[noisy], CALM_QUANTILE)) / CALM_NORMAL_QUANTILE
        for _ in range(MOST_ROUNDS):
            changes = np.concatenate([[0], np.cumsum(ratios > CHANGE_STDS * factor)])
            rows = np.arange(len(ratios))
            low, high = np.maximum(rows - self.window, 0), np.minimum(rows + self.window + 1, len(ratios))
            calm_ratios = ratios[noisy & (changes[high] == changes[low])]  # no change within a window of these
            window_count = max(len(calm_ratios) / self.window, 1.0)
            previous_factor, factor = factor, math.sqrt(float(np.mean(calm_ratios**2))) if len(calm_ratios) else 0.0
            # an upper bound, since the windows are few
            factor *= 1.0 + SCATTER_ERROR_STDS / math.sqrt(2.0 * window_count)
            if factor == previous_factor:
                break
        self.correlation_factor = factor


def window_means(values: Array, window: int) -> Array:
    """Return the mean of each window of `window` rows, indexed by its first row."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray((sums[window:] - sums[:-window]) / window, np.float64)


def between_changes(values: Array, means: WindowMeans, rounding_error: float) -> list[LevelHold]:
    """Find the holds between changes of level, and extend them to all rows at the level.

    Raises
    ------
    NotDistinct : the channel varies without a change that exceeds its noise.
    """
    window = means.window
    if len(values) < 2 * window:
        return []
    means.estimate_correlation_factor(rounding_error)
    steps = np.abs(np.diff(values))
    # the noise of a reading that rarely changes by a count cannot be estimated: half a count is no change
    reading_step = float(steps[steps > rounding_error].min(initial=np.ptp(values))) + rounding_error
    is_calm = np.abs(means.change) <= np.maximum(
        CHANGE_STDS * means.correlation_factor * means.scatter, 0.5 * reading_step
    )
    if is_calm.all() and np.ptp(values) > rounding_error:
        raise NotDistinct("no change stands out of it")
    runs = [(first + window, after + window) for first, after in runs_of(is_calm)]
    if not (runs := [(first, after) for first, after in runs if after - first > window]):
        return []
    # where two runs meet, the level changed where the means differ most
    edges = [
        after + int(np.argmax(np.abs(means.change[after - window : first - window])))
        for (_, after), (first, _) in pairwise(runs)
    ]
    change_sizes = np.abs(means.change[np.asarray(edges, int) - window])
    means.least_step = float(change_sizes.min(initial=means.least_step))
    bounds = pairwise([0, *edges, len(values)])
    holds = [hold_from_run(values, run, part, window, reading_step) for run, part in zip(runs, bounds, strict=True)]
    return [hold for hold in holds if hold is not None]


def hold_from_run(
    values: Array, run: tuple[int, int], bounds: tuple[int, int], window: int, reading_step: float
) -> LevelHold | None:
    """Extend a run of rows without change to the neighbouring rows at its level; None if no row is at that level."""
    first, after = run
    level = float(np.median(values[first:after]))
    # without the rows whose windows reach into a change, if enough rows remain
    undisturbed = values[first + window // 2 : after - window // 2]
    deviations = (undisturbed if len(undisturbed) >= window else values[first:after]) - level
    row_tolerance = max(TAIL_MULTIPLE * float(np.quantile(np.abs(deviations), TAIL_QUANTILE)), reading_step)
    mean_tolerance = max(
        CHANGE_STDS * float(np.std(moving_mean(deviations, window // WINDOWS_PER_HOLD))), 0.5 * reading_step
    )
    rows_at_level = bounds[0] + np.flatnonzero(np.abs(values[bounds[0] : bounds[1]] - level) <= row_tolerance)
    if not len(rows_at_level):
        return None
    begin, end = int(rows_at_level[0]), int(rows_at_level[-1]) + 1
    means_at_level = begin + np.flatnonzero(
        np.abs(moving_mean(values[begin:end] - level, window // WINDOWS_PER_HOLD)) <= mean_tolerance
    )
    if not len(means_at_level):
        return None
    start = int(means_at_level[0])
    return LevelHold(
        start, int(means_at_level[-1]) + 1, level, level_before(values, start, level, row_tolerance, window)
    )


def runs_of(is_chosen: npt.NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Yield the first row and the row after the last of each run of True."""
    edges = np.flatnonzero(np.diff(is_chosen, prepend=False, append=False))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def moving_mean(values: Array, rows: int) -> Array:
    """Return the centred moving mean over `rows` rows."""
    from scipy.ndimage import uniform_filter1d

    return np.asarray(uniform_filter1d(values, rows, mode="nearest"), np.float64)


def level_before(values: Array, first: int, level: float, tolerance: float, window: int) -> float:
    """Return the value before a level: that of the last row off the level, else the mean of the rows before it.

    NaN if there are no rows before it.
    """
    preceding = values[max(first - window, 0) : first]
    rows_off_level = preceding[np.abs(preceding - level) > tolerance]
    if len(rows_off_level):
        return float(rows_off_level[-1])
    return float(preceding.mean()) if len(preceding) else math.nan


def refuse_drift(
    holds: list[LevelHold], values: Array, means: WindowMeans, stamps: Array, settle_s: float, rounding_error: float
) -> None:
    """Raise NotDistinct if a level drifts by more than its noise explains and by more than a share of the steps.

    Raises
    ------
    NotDistinct : a level drifts too much; the message has the start of its hold.
    """
    for hold in holds:
        first = int(np.searchsorted(stamps, stamps[hold.first] + settle_s))
        hold_means = means.mean[first : max(hold.after - means.window, first)]
        window_count = (hold.after - first) / means.window
        if window_count < 2.0:
            continue
        row_variance = float(np.var(values[first : hold.after])) - float(np.var(hold_means))
        expected_variance = 0.5 * means.correlation_factor**2 * max(row_variance, 0.0)
        excess_variance = float(np.var(hold_means)) - expected_variance * (
            1.0 + CHANGE_STDS * math.sqrt(2.0 / window_count)
        )
        wander = 2.0 * math.sqrt(max(excess_variance, 0.0))
        if wander > max(MOST_DRIFT_SHARE * means.least_step, rounding_error):
            start_text = f"{stamps[hold.first]:.6g} s"
            raise NotDistinct(f"from {start_text} on it wanders by {wander:.3g} and shows no change of level")
