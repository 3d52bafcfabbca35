"""Localise the gap: the distance of the model in each channel, and the smallest region that holds most of it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.binned_means import (
    best_sign,
    bin_count,
    bin_edges,
    bin_of,
    first_that_follows,
    fold_angle,
    last_reversal,
    periods_of,
    repeats,
)
from leactl.gap.diagnosis import LEAST_GAP_FLOORS, MOST_REPLAY_MISS, Cause, Region, Where
from leactl.gap.replay.comparison import Compared
from leactl.gap.signals.record import Clocked, Record
from leactl.gap.signals.smoothing import smooth, speeds
from leactl.quantities import UNITS
from leactl.vocabulary.effect import effect_definition
from leactl.vocabulary.variable import VARIABLES

Array = npt.NDArray[np.float64]
REGION_SHARE = 0.8  # share of the squared residual that a region holds
REGION_BINS = 12  # number of bins at whose edges a region may begin and end
MOST_REGION_DATA = 0.75  # share of the samples; `smallest_region` returns no larger region
# units of variables that are no quantity of a channel
OTHER_UNITS = {"direction": "1", "frequency": "Hz", "time": "s", "time_since_reversal": "s"}
MOST_PROFILES = 5  # largest number of entries that get a profile
PROFILE_BINS = 24  # bins of a profile
FEWEST_BIN_SAMPLES = 8  # samples of a bin that is drawn
OMITTED_SHARE = 0.002  # share of the data at either end that a profile leaves out


@dataclass(frozen=True, eq=False)
class Profile:
    """Residuals of one channel over one variable: mean and standard deviation in each bin, for each model."""

    quantity: str
    role: str
    mechanical: str
    units: str
    variable: str
    variable_units: str
    low: Array  # edges of the bins
    high: Array
    mean: Array  # measured minus simulated; a row for each of nominal, calibrated and augmented
    std: Array


def where(records: Sequence[Record], channels: Sequence[Compared], effects: Sequence[Cause] = ()) -> tuple[Where, ...]:
    """Return one entry for each quantity, role and set-up, the largest ratio of calibrated distance to floor first.

    effects : effects of the augmented model; where they close a gap, its region is in a variable that they act in.
    """
    by_name = {record.name: record for record in records}
    groups: dict[tuple[str, str, str], list[Compared]] = {}
    for channel in channels:
        groups.setdefault((channel.quantity, channel.role, channel.mechanical), []).append(channel)
    entries = []
    for (quantity, role, mechanical), group in groups.items():
        nominal, calibrated = (rms([channel.squares(k) for channel in group]) for k in (0, 1))
        floor = practical_floor(group)
        region, share_in_region = None, 0.0
        if calibrated > LEAST_GAP_FLOORS * floor:
            records_and_channels = [(by_name[channel.run], channel) for channel in group]
            acting = effects if closes_most(group, floor) else ()
            region, share_in_region = region_of_effects(records_and_channels, acting) or smallest_region(
                records_and_channels
            )
        units = UNITS.get(quantity, "")
        entries.append(Where(quantity, role, mechanical, units, nominal, calibrated, floor, region, share_in_region))
    return tuple(sorted(entries, key=lambda entry: -entry.calibrated_rms / max(entry.floor_rms, 1e-300)))


def profiles(records: Sequence[Record], channels: Sequence[Compared], entries: Sequence[Where]) -> tuple[Profile, ...]:
    """Return the profiles of the first entries that have a gap, over the variable of their region, else over time."""
    by_name = {record.name: record for record in records}
    drawn_profiles = []
    for entry in entries[:MOST_PROFILES]:
        if entry.calibrated_rms <= LEAST_GAP_FLOORS * entry.floor_rms:
            continue
        key = (entry.quantity, entry.role, entry.mechanical)
        group = [channel for channel in channels if (channel.quantity, channel.role, channel.mechanical) == key]
        variable = entry.region.variable if entry.region else "time"
        units = OTHER_UNITS.get(variable, UNITS.get(variable, ""))
        values, residuals = [], []
        for channel in group:
            series = variable_of(by_name[channel.run], channel, variable)
            if series is not None:
                # interpolated signs are rounded back to -1, 0, 1
                series = np.round(series) if variable == "direction" else series
                values.append(fold_angle(series, 1.0) if entry.region and entry.region.within_turn else series)
                residuals.append(channel.measured - np.stack(channel.replayed))
        low, high, mean, std = bin_statistics(np.concatenate(values), np.concatenate(residuals, axis=1))
        drawn_profiles.append(Profile(*key, entry.units, variable, units, low, high, mean, std))
    return tuple(drawn_profiles)


def bin_statistics(values: Array, residuals: Array) -> tuple[Array, Array, Array, Array]:
    """Return edges, mean and standard deviation of bins with enough samples: low, high, mean and std.

    Bins are equally wide, or one for each level of a variable with few levels. Mean and std have shape (models, bins).

    values : variable at each sample.
    residuals : shape (models, samples).
    """
    levels = np.unique(values)
    if len(levels) <= PROFILE_BINS // 2:
        half_width = 0.25 * float(np.min(np.diff(levels))) if len(levels) > 1 else 0.5
        low, high = levels - half_width, levels + half_width
    else:
        lowest, highest = np.quantile(values, (OMITTED_SHARE, 1.0 - OMITTED_SHARE))
        edges = np.linspace(lowest, highest, PROFILE_BINS + 1)
        low, high = edges[:-1], edges[1:]
    masks = [(values >= lower) & (values <= upper) for lower, upper in zip(low, high, strict=True)]
    has_enough = np.asarray([int(mask.sum()) >= FEWEST_BIN_SAMPLES for mask in masks])
    residuals_of_bins = [residuals[:, mask] for mask, is_drawn in zip(masks, has_enough, strict=True) if is_drawn]
    shape = (len(residuals_of_bins), len(residuals))  # of an array that keeps a row for each model even without any bin
    mean = np.asarray([residuals_of_bin.mean(axis=1) for residuals_of_bin in residuals_of_bins]).reshape(shape).T
    std = np.asarray([residuals_of_bin.std(axis=1) for residuals_of_bin in residuals_of_bins]).reshape(shape).T
    return low[has_enough], high[has_enough], mean, std


def practical_floor(compared_runs: Sequence[Compared]) -> float:
    """Return the noise floor of a channel, raised by the error that a replay of the right model would have.

    Sticking and restarts make such a replay miss by a few times the noise. The part of the calibrated distance that
    the augmented model has as well, up to `MOST_REPLAY_MISS` floors, is therefore no gap.
    """
    floor = rms([channel.floor_squares() for channel in compared_runs])
    calibrated, augmented = (rms([channel.squares(model) for channel in compared_runs]) for model in (1, 2))
    common_miss = min(max(floor, min(calibrated, augmented)), MOST_REPLAY_MISS * floor)
    squares_beyond_miss = floor**2 + calibrated**2 - common_miss**2
    return calibrated * floor / math.sqrt(squares_beyond_miss) if squares_beyond_miss > 0.0 else floor


def rms(squares: Sequence[Array]) -> float:
    """Return the root mean square of several runs together from their squares."""
    return float(np.sqrt(np.mean(np.concatenate(list(squares)))))


def closes_most(compared_runs: Sequence[Compared], floor: float) -> bool:
    """Return whether the augmented model explains most of the calibrated model's squares beyond the floor."""
    calibrated, augmented = (rms([channel.squares(model) for channel in compared_runs]) ** 2 for model in (1, 2))
    return calibrated - augmented > 0.5 * (calibrated - floor**2)


@dataclass(frozen=True, eq=False)
class GapOverVariable:
    """Gap of a channel over a variable that an effect acts in."""

    quantity: str
    values: Array
    within_turn: bool  # of an angle: whole turns are taken off
    squares: Array  # squared residuals of the calibrated model
    explained: float  # share of the augmented model's difference from the calibrated one that follows the variable


def region_of_effects(
    records_and_channels: Sequence[tuple[Record, Compared]], effects: Sequence[Cause]
) -> tuple[Region | None, float] | None:
    """Return the interval of an effect's variable that holds most of the gap, and its share; None if there is none.

    The interval may hold any share of the data.
    """
    quantities_and_periods = [
        (quantity, periods_of(cause)) for cause in effects for quantity in region_quantities(cause.effect)
    ]
    views = [
        view
        for quantity, periods in quantities_and_periods
        if (view := over_quantity(records_and_channels, quantity, periods)) is not None
    ]
    best = first_that_follows(views, lambda view: view.explained)
    if best is None or (interval := narrowest_interval(best.values, best.squares)) is None:
        return None
    low, high, share, _ = interval
    units = OTHER_UNITS.get(best.quantity, UNITS.get(best.quantity, ""))
    return Region(best.quantity, low, high, units, best.within_turn), share


def region_quantities(effect: str) -> list[str]:
    """Return the quantities in which the region of an effect's gap is given."""
    quantities = [VARIABLES[variable].quantity for variable in effect_definition(effect).acts_over]
    return [quantity for quantity in quantities if quantity is not None]


def over_quantity(
    records_and_channels: Sequence[tuple[Record, Compared]], quantity: str, periods: float
) -> GapOverVariable | None:
    """Return the gap of a channel over a quantity, folded within a turn if it repeats; None where no run has it."""
    values, differences, squares, signs, block_count = [], [], [], [], 0
    for record, channel in records_and_channels:
        series = variable_of(record, channel, quantity)
        if series is None:
            continue
        direction = variable_of(record, channel, "direction")
        values.append(series)
        differences.append(channel.replayed[2] - channel.replayed[1])
        squares.append(channel.squares(1))
        signs.append(np.sign(direction) if direction is not None else np.zeros_like(series))
        block_count += len(np.unique(channel.block))
    if not values:
        return None
    series, difference, sign = (np.concatenate(rows) for rows in (values, differences, signs))

    def explained(folded_values: Array) -> float:
        """Return the share of the difference that follows a variable, times the sign of the direction or not."""
        bins = bin_of(folded_values, bin_edges(folded_values, difference, bin_count(block_count)))
        return best_sign(difference, bins, {"velocity": sign}).explained

    within_turn = quantity == "angle" and repeats(series, periods, explained)
    shown_values = fold_angle(series, 1.0) if within_turn else series
    folded_values = fold_angle(series, periods) if within_turn else series
    return GapOverVariable(quantity, shown_values, within_turn, np.concatenate(squares), explained(folded_values))


def smallest_region(records_and_channels: Sequence[tuple[Record, Compared]]) -> tuple[Region | None, float]:
    """Return the interval of any variable with the least data that holds most of the squared residual, and its share.

    The residual is that of the calibrated model; None and zero where no interval is narrow enough.
    """
    best_region: tuple[float, Region, float] | None = None
    for variable in variables(records_and_channels):
        values, squares = [], []
        for record, channel in records_and_channels:
            series = variable_of(record, channel, variable)
            if series is not None:
                values.append(series)
                squares.append(channel.squares(1))
        if not values:
            continue
        interval = narrowest_interval(np.concatenate(values), np.concatenate(squares))
        if interval is None:
            continue
        low, high, share, data_share = interval
        if data_share < MOST_REGION_DATA and (best_region is None or data_share < best_region[0]):
            units = OTHER_UNITS.get(variable, UNITS.get(variable, ""))
            best_region = (data_share, Region(variable, low, high, units), share)
    return (None, 0.0) if best_region is None else (best_region[1], best_region[2])


def variables(records_and_channels: Sequence[tuple[Record, Compared]]) -> list[str]:
    """Return the variables that a region may be given in for these runs."""
    names = ["time"]
    for record, _ in records_and_channels:
        for clock in (record.fast, record.slow):
            if clock is not None:
                names += [quantity for quantity, role in clock.values if role == "test" and quantity not in names]
        if record.fast is not None and ("angle", "test") in record.fast.values:
            names += [name for name in ("direction", "time_since_reversal") if name not in names]
    return names


def variable_of(record: Record, channel: Compared, variable: str) -> Array | None:
    """Return a variable at the samples of a compared channel; None where the run lacks it."""
    if variable == "time":
        return channel.time
    clock = record.fast
    if variable in ("direction", "time_since_reversal"):
        if clock is None or (speed := speed_of(clock)) is None:
            return None
        series = np.sign(speed) if variable == "direction" else time_since_reversal(speed, clock.interval)
        return np.interp(channel.time, clock.since_begin, series)
    for source in (record.fast, record.slow):
        if source is not None and (values := source.get(variable)) is not None:
            return np.interp(channel.time, source.since_begin, values)
    if variable == "velocity" and clock is not None and (speed := speed_of(clock)) is not None:
        return np.interp(channel.time, clock.since_begin, speed)
    return None


def speed_of(clock: Clocked) -> Array | None:
    """Return the smoothed speed of the angle [rad/s]; None where the clock has no angle."""
    angle = clock.get("angle")
    return smooth(speeds(angle, clock.interval), 4.0) if angle is not None else None


def time_since_reversal(speed: Array, interval: float) -> Array:
    """Return at each sample the time [s] since the sign of the speed last changed, or since the first sample."""
    return np.asarray((np.arange(len(speed)) - last_reversal(speed)) * interval, np.float64)


def narrowest_interval(values: Array, squares: Array) -> tuple[float, float, float, float] | None:
    """Return low, high, share of squares and share of samples of the interval that holds most of the squares.

    It is the one with the fewest samples among those with `REGION_SHARE` of the squares; None if the variable is
    constant, or the squares are zero.
    """
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    cumulative = np.concatenate([[0.0], np.cumsum(squares[order])])
    if cumulative[-1] <= 0.0 or ordered[0] == ordered[-1]:
        return None
    cut_positions = np.linspace(0, len(order), REGION_BINS + 1).astype(np.intp)[:-1]
    # a cut within a level, such as one direction, moves to the beginning of the level
    edges = np.append(np.unique(np.searchsorted(ordered, ordered[cut_positions])), len(order))
    best_slice: tuple[int, int] | None = None
    for begin in range(len(edges) - 1):
        for end in range(begin + 1, len(edges)):
            if cumulative[edges[end]] - cumulative[edges[begin]] >= REGION_SHARE * cumulative[-1]:
                if best_slice is None or edges[end] - edges[begin] < best_slice[1] - best_slice[0]:
                    best_slice = (int(edges[begin]), int(edges[end]))
                break
    if best_slice is None:
        return None
    start, stop = best_slice
    share = float((cumulative[stop] - cumulative[start]) / cumulative[-1])
    return float(ordered[start]), float(ordered[stop - 1]), share, (stop - start) / len(order)
