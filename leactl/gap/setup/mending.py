"""Compare a channel with its expected value, as logged and as mended, and draw both errors.

Of all channels, the one whose squared error loses the largest share by mending is drawn.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.binned_means import bin_count, bin_edges, bin_of, means
from leactl.gap.diagnosis import Picture, ResidualBin
from leactl.gap.setup.delays import STRETCHES
from leactl.gap.setup.expected_channels import ExpectedChannel, direct_pairs, modelled_pairs
from leactl.gap.signals.record import Record
from leactl.gap.signals.smoothing import slope, smooth
from leactl.model.nominal import Model
from leactl.quantities import UNITS
from leactl.vocabulary.variable import VARIABLES, Variable

Array = npt.NDArray[np.float64]
OVER_TIME = {"clock_drift", "dropped_samples", "frozen_channel", "repeated_samples", "clipped_channel"}
FEWEST_EDGES = 3  # of two bins; a picture of one bin shows no shape


@dataclass(frozen=True, eq=False)
class ChannelError:
    """Error of a channel of one run against its expected value, as logged and as mended; shape (samples,)."""

    pair: ExpectedChannel  # of the mended run
    logged: Array
    mended: Array
    samples: npt.NDArray[np.intp]  # indices in the run at which both errors are known
    interval: float  # s, between samples of the mended run


def mended_picture(
    name: str, before: Sequence[Record], after: Sequence[Record], model: Model
) -> tuple[Picture, float] | None:
    """Return the picture of the channel whose error mending removes most of, and the share removed; None without one.

    Parameters
    ----------
    name : name of the fault; for one of `OVER_TIME` the error is multiplied by the sign of the slope, over time.
    before, after : the same runs as logged and as mended.
    """
    groups: dict[tuple[str, str, str, str], list[ChannelError]] = {}  # by quantity, role, reference and set-up
    for logged, mended in zip(before, after, strict=True):
        pairs = {(pair.key, pair.reference_label): pair for pair in every_pair(logged, model)}
        for pair in every_pair(mended, model):
            error = channel_error(logged, mended, pairs.get((pair.key, pair.reference_label)), pair)
            if error is not None:
                groups.setdefault((*pair.key, pair.reference_label, mended.mechanical), []).append(error)
    shares = {key: removed_share(group) for key, group in groups.items()}
    if not shares:
        return None
    best_mended = max(shares, key=lambda key: shares[key])
    quantity, role, _, mechanical = best_mended
    picture = residual_picture(groups[best_mended], (quantity, role, mechanical), name in OVER_TIME)
    return None if picture is None else (picture, shares[best_mended])


def every_pair(record: Record, model: Model) -> Iterator[ExpectedChannel]:
    """Yield every channel of a run that has an expected value."""
    yield from direct_pairs(record, model)
    yield from modelled_pairs(record, model)


def channel_error(
    logged: Record, mended: Record, before: ExpectedChannel | None, after: ExpectedChannel
) -> ChannelError | None:
    """Return the error of a channel as logged and as mended; None if either is not known at any sample."""
    if before is None or logged.fast is None or mended.fast is None:
        return None
    valid = logged.fast.all_valid(*before.inputs) & mended.fast.all_valid(*after.inputs)
    errors = [smooth(pair.measured) - smooth(pair.expected) for pair in (before, after)]
    samples = np.flatnonzero(valid)
    if not len(samples):
        return None
    return ChannelError(after, errors[0][samples], errors[1][samples], samples, mended.fast.interval)


def removed_share(group: Sequence[ChannelError]) -> float:
    """Return the share of a channel's squared error in all runs that mending removes; 0 without an error as logged."""
    logged_square = sum(float(np.sum(error.logged**2)) for error in group)
    mended_square = sum(float(np.sum(error.mended**2)) for error in group)
    return 1.0 - mended_square / logged_square if logged_square > 0.0 else 0.0


def values_drawn_over(error: ChannelError, over_time: bool) -> Array:
    """Return the values over which an error is drawn: time since the run's first sample [s], or the pair's variable."""
    if over_time:
        return np.asarray(error.interval * error.samples, np.float64)
    pair = error.pair
    return smooth(pair.expected if pair.drawn_over is None else pair.drawn_over)[error.samples]


def residual_picture(group: Sequence[ChannelError], channel: tuple[str, str, str], over_time: bool) -> Picture | None:
    """Return the picture of a channel's error in bins of its `variable`, or of time; None with too few bins.

    `channel` is quantity, role and mechanical set-up. Over time, an error is multiplied by the sign of the slope of
    the expected value, so that a channel that is late has the same sign in both directions.
    """
    signs = [
        np.sign(slope(smooth(error.pair.expected), 1.0))[error.samples] if over_time else np.ones(len(error.samples))
        for error in group
    ]
    before = np.concatenate([error.logged * sign for error, sign in zip(group, signs, strict=True)])
    after = np.concatenate([error.mended * sign for error, sign in zip(group, signs, strict=True)])
    values = np.concatenate([values_drawn_over(error, over_time) for error in group])
    stretches = np.concatenate(
        [run * STRETCHES + error.samples * STRETCHES // (int(error.samples[-1]) + 1) for run, error in enumerate(group)]
    )
    edges = bin_edges(values, before - after, bin_count(float(len(np.unique(stretches)))))
    if len(edges) < FEWEST_EDGES:
        return None
    bin_of_row, bins = bin_of(values, edges), len(edges) - 1
    binned_sides = [means(error, bin_of_row, stretches, bins) for error in (before, after)]
    counts = np.bincount(bin_of_row[bin_of_row >= 0], minlength=bins)
    pair = group[0].pair
    variable: Variable = "time" if over_time else pair.variable
    columns = zip(
        edges[:-1].tolist(),
        edges[1:].tolist(),
        counts.tolist(),
        *(row.tolist() for binned in binned_sides for row in (binned.mean, binned.low, binned.high)),
        strict=True,
    )
    return Picture(
        variable,
        VARIABLES[variable].units,
        None,
        f"rate of change of the value expected from {pair.reference_label}" if over_time else None,
        *channel,
        "set-up",
        UNITS[channel[0]],
        binned_sides[0].rms(counts),
        binned_sides[1].rms(counts),
        binned_sides[0].off_zero,
        binned_sides[1].off_zero,
        tuple(ResidualBin(*row) for row in columns),
    )
