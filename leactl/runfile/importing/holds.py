"""Where a channel holds a level: stretches between changes that stand out of its noise.

A setpoint repeats its level exactly, and every change of it counts. In a reading, changes are where the means of the
rows before and behind differ by more than such means scatter (moving sums, MOSUM: Eichinger and Kirch, Bernoulli 24,
2018). How much they scatter is taken from the recording itself and at that very length: noise of neighbouring rows
says too little where it is coloured, by a filter, a ripple or a loop.
"""

import math
from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]
WINDOWS = 4  # in the shortest hold: two of them to either side of a row leave half of that hold undisturbed
FEWEST = 8  # rows of a window, whose scatter has to be known
CHANGE = 5.0  # standard deviations that two windows' means differ by where a level changes
CALM = 0.1  # share of rows by which the scatter of means is first estimated
CALM_NORMAL = 0.2533  # standard deviations of a normal variable below which twice that share is: half lie in holds
UNSURE = 2.0  # standard errors that the scatter of means may be more than a recording shows
MOST_ROUNDS = 20  # of leaving out the changes that stand out, which end sooner where nothing more is left out
TAIL, BEYOND = 0.995, 2.5  # a row is off its level by so many times what that share of rows is off: 7 sd where normal
ROUNDED = 1e-9  # of a channel's largest value, that a mean of equal numbers may be off by
WANDERS = 0.25  # of the least step from one level to the next, that a level may wander by beyond its noise


class LevelHold(NamedTuple):
    """A stretch of rows at one level."""

    first: int
    after: int  # the row behind it
    level: float
    before: float  # where the channel was when it came; NaN where no row says so


class NotDistinct(Exception):
    """Levels that cannot be told from noise; the message says where."""


def find_holds(time: Array, values: Array, least_s: float, settle_s: float, is_setpoint: bool) -> list[LevelHold]:
    """Stretches of `least_s` or more in which a channel stays at its level.

    One row off a setpoint's level is a stray, two in a row end a stretch; a reading's stretch ends where its mean
    changes. What is missing ends neither, but for a silence of a quarter of `least_s`.

    Raises
    ------
    NotDistinct : a noisy channel without a change of level, or a level that wanders by more than noise explains.
    """
    finite_rows = np.flatnonzero(np.isfinite(values))
    if not len(finite_rows):
        return []
    stamps, levels = time[finite_rows], median_of_three(values[finite_rows])
    rounded = ROUNDED * float(np.abs(levels).max())
    window = round(len(finite_rows) * least_s / WINDOWS / max(float(stamps[-1] - stamps[0]), least_s))
    # rows behind which a channel is silent for long, as a setpoint is in another mode of its drive
    silences = np.flatnonzero(np.diff(stamps, append=time[-1]) > least_s / WINDOWS) + 1

    def lasting(holds: Iterable[LevelHold]) -> dict[LevelHold, LevelHold]:
        """Parts of holds that last long enough, by known rows and among all."""
        parts = {
            part: rows_among_all(part, finite_rows, silences, len(values))
            for part in split_at_silences(holds, silences)
        }
        ends = {part: float(time[min(whole.after, len(time) - 1)]) for part, whole in parts.items()}
        return {part: whole for part, whole in parts.items() if ends[part] - time[whole.first] >= least_s}

    holds = lasting(constant_stretches(levels, rounded)) if is_setpoint or window < FEWEST else {}
    if not holds and window >= FEWEST:
        means = WindowMeans(levels, window)
        holds = lasting(between_changes(levels, means, rounded))
        refuse_wandering([*holds], levels, means, stamps, settle_s, rounded)
    return [*holds.values()]


def median_of_three(values: Array) -> Array:
    """The median of each row and its neighbours: a row by itself is gone, an edge stays where it is."""
    if len(values) < 3:
        return values
    middle = np.median(np.stack([values[:-2], values[1:-1], values[2:]]), axis=0)
    return np.concatenate([values[:1], middle, values[-1:]])


def split_at_silences(holds: Iterable[LevelHold], silences: Rows) -> Iterator[LevelHold]:
    """The parts of holds between silences; what came before one is not known behind it."""
    for hold in holds:
        inside = silences[(silences > hold.first) & (silences < hold.after)].tolist()
        for first, after in pairwise([hold.first, *inside, hold.after]):
            yield hold._replace(first=first, after=after, before=math.nan if first in silences else hold.before)


def rows_among_all(hold: LevelHold, known: Rows, silences: Rows, rows: int) -> LevelHold:
    """A hold of known rows among all: up to the next known one, or to the last one before a silence."""
    if hold.after in silences:
        after = int(known[hold.after - 1]) + 1
    else:
        after = int(known[hold.after]) if hold.after < len(known) else rows
    return hold._replace(first=int(known[hold.first]), after=after)


def constant_stretches(values: Array, rounded: float) -> list[LevelHold]:
    """Stretches that repeat a value exactly."""
    changes = np.flatnonzero(np.abs(np.diff(values)) > rounded) + 1
    edges = [0, *changes.tolist(), len(values)]
    return [
        LevelHold(first, after, float(values[first]), float(values[first - 1]) if first else math.nan)
        for first, after in pairwise(edges)
    ]


class WindowMeans:
    """Means and scatter of the rows before and behind each row."""

    def __init__(self, values: Array, window: int) -> None:
        rows = np.arange(len(values)) - 0.5 * (len(values) - 1)
        centred = values - values.mean()
        mean, square, moment = (window_means(column, window) for column in (centred, centred**2, rows * centred))
        # without a slope, which is no noise: what a ramp leaves beside it is
        middle = rows[: len(mean)] + 0.5 * (window - 1)
        sloping = (moment - middle * mean) ** 2 / ((window**2 - 1) / 12.0)
        variance = np.maximum(square - mean**2 - sloping, 0.0)
        self.window = window
        self.mean = mean  # of the window that begins at each row
        self.change = mean[window:] - mean[:-window]  # from `window` rows before each row, the first of which is that
        self.scatter = np.sqrt(0.5 * (variance[window:] + variance[:-window]))
        self.least_step = float(np.ptp(mean))  # from one level to the next
        self.colour = 0.0  # by how much means scatter, of the scatter of the rows in them

    def estimate_colour(self, rounded: float) -> None:
        """Find how much means scatter where no level changes."""
        noisy = self.scatter > rounded
        if not noisy.any():
            return
        ratios = np.abs(self.change) / np.maximum(self.scatter, rounded)
        colour = float(np.quantile(ratios[noisy], CALM)) / CALM_NORMAL
        for _ in range(MOST_ROUNDS):
            changes = np.concatenate([[0], np.cumsum(ratios > CHANGE * colour)])
            rows = np.arange(len(ratios))
            low, high = np.maximum(rows - self.window, 0), np.minimum(rows + self.window + 1, len(ratios))
            calm = ratios[noisy & (changes[high] == changes[low])]  # no change within a window of these
            windows = max(len(calm) / self.window, 1.0)
            before, colour = colour, math.sqrt(float(np.mean(calm**2))) if len(calm) else 0.0
            colour *= 1.0 + UNSURE / math.sqrt(2.0 * windows)  # it is known from few windows
            if colour == before:
                break
        self.colour = colour


def window_means(values: Array, window: int) -> Array:
    """The mean of every window, by the row that it begins at."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray((sums[window:] - sums[:-window]) / window, np.float64)


def between_changes(values: Array, means: WindowMeans, rounded: float) -> list[LevelHold]:
    """Stretches between changes of level, each by the rows around that are no change."""
    window = means.window
    if len(values) < 2 * window:
        return []
    means.estimate_colour(rounded)
    steps = np.abs(np.diff(values))
    # a reading that flickers by a count now and then has no noise to go by: half a count is no change
    count = float(steps[steps > rounded].min(initial=np.ptp(values))) + rounded
    calm = np.abs(means.change) <= np.maximum(CHANGE * means.colour * means.scatter, 0.5 * count)
    if calm.all() and np.ptp(values) > rounded:
        raise NotDistinct("no change stands out of it")
    runs = [(first + window, after + window) for first, after in runs_of(calm)]
    if not (runs := [(first, after) for first, after in runs if after - first > window]):
        return []
    # where two runs meet, the level changed where the means differ most
    edges = [
        after + int(np.argmax(np.abs(means.change[after - window : first - window])))
        for (_, after), (first, _) in pairwise(runs)
    ]
    sizes = np.abs(means.change[np.asarray(edges, int) - window])
    means.least_step = float(sizes.min(initial=means.least_step))
    bounds = pairwise([0, *edges, len(values)])
    holds = [hold_around(values, run, part, window, count) for run, part in zip(runs, bounds, strict=True)]
    return [hold for hold in holds if hold is not None]


def hold_around(
    values: Array, run: tuple[int, int], bounds: tuple[int, int], window: int, count: float
) -> LevelHold | None:
    """The rows around a run without change that are at its level, one by one and as means; none where none is."""
    first, after = run
    level = float(np.median(values[first:after]))
    # without the rows whose windows reach into a change, where enough are left
    inner = values[first + window // 2 : after - window // 2]
    off = (inner if len(inner) >= window else values[first:after]) - level
    near = max(BEYOND * float(np.quantile(np.abs(off), TAIL)), count)
    sway = max(CHANGE * float(np.std(moving_mean(off, window // WINDOWS))), 0.5 * count)
    by_row = bounds[0] + np.flatnonzero(np.abs(values[bounds[0] : bounds[1]] - level) <= near)
    if not len(by_row):
        return None
    begin, end = int(by_row[0]), int(by_row[-1]) + 1
    by_mean = begin + np.flatnonzero(np.abs(moving_mean(values[begin:end] - level, window // WINDOWS)) <= sway)
    if not len(by_mean):
        return None
    start = int(by_mean[0])
    return LevelHold(start, int(by_mean[-1]) + 1, level, level_before(values, start, level, near, window))


def runs_of(chosen: npt.NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """First row and row after of each run of chosen ones."""
    edges = np.flatnonzero(np.diff(chosen, prepend=False, append=False))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def moving_mean(values: Array, rows: int) -> Array:
    """The mean of so many rows around each."""
    from scipy.ndimage import uniform_filter1d

    return np.asarray(uniform_filter1d(values, rows, mode="nearest"), np.float64)


def level_before(values: Array, first: int, level: float, near: float, window: int) -> float:
    """Where a channel was before it came to a level: the last row off it, or the mean of some where none is."""
    before = values[max(first - window, 0) : first]
    off = before[np.abs(before - level) > near]
    if len(off):
        return float(off[-1])
    return float(before.mean()) if len(before) else math.nan


def refuse_wandering(
    holds: list[LevelHold], values: Array, means: WindowMeans, stamps: Array, settle_s: float, rounded: float
) -> None:
    """Refuse a level that wanders by more than its noise explains, and not by little beside a step.

    Raises
    ------
    NotDistinct : that it does.
    """
    for hold in holds:
        first = int(np.searchsorted(stamps, stamps[hold.first] + settle_s))
        inside = means.mean[first : max(hold.after - means.window, first)]
        count = (hold.after - first) / means.window
        if count < 2.0:
            continue
        rows = float(np.var(values[first : hold.after])) - float(np.var(inside))
        expected = 0.5 * means.colour**2 * max(rows, 0.0)
        beyond = float(np.var(inside)) - expected * (1.0 + CHANGE * math.sqrt(2.0 / count))
        wander = 2.0 * math.sqrt(max(beyond, 0.0))
        if wander > max(WANDERS * means.least_step, rounded):
            begin = f"{stamps[hold.first]:.6g} s"
            raise NotDistinct(f"from {begin} on it wanders by {wander:.3g} and shows no change of level")
