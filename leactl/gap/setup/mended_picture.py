"""Draw the error of the channel that the mending of a fault improves most, as logged and as mended.

The error is the channel minus its expected value; the channel drawn is the one whose squared error shrinks by the
largest share.
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
# their error changes in the course of a run
FAULTS_DRAWN_OVER_TIME = frozenset(
    {"clock_drift", "dropped_samples", "frozen_channel", "repeated_samples", "clipped_channel"}
)
FEWEST_EDGES = 3  # bin edges, for two bins: a picture of one bin shows no shape


@dataclass(frozen=True, eq=False)
class ChannelDeviation:
    """Deviation of a channel of one run from its expected value, as logged and as mended.

    Arrays have shape (samples,).
    """

    expected_channel: ExpectedChannel  # of the mended run
    logged: Array
    mended: Array
    sample_indices: npt.NDArray[np.intp]  # indices in the run at which both errors are known
    interval: float  # s, between samples of the mended run


def mended_picture(
    fault_name: str, logged_records: Sequence[Record], mended_records: Sequence[Record], model: Model
) -> tuple[Picture, float] | None:
    """Return the picture of the channel whose squared error shrinks by the largest share, and that share.

    The result is None if no channel has a known error, or if the error of that channel fills too few bins.

    Parameters
    ----------
    fault_name : faults of `FAULTS_DRAWN_OVER_TIME` are drawn over time, all others over the channel's variable.
    logged_records, mended_records : the same runs as logged and as mended.
    """
    groups: dict[tuple[str, str, str, str], list[ChannelDeviation]] = {}  # by quantity, role, reference and set-up
    for logged, mended in zip(logged_records, mended_records, strict=True):
        logged_channels = {
            (channel.key, channel.reference_label): channel for channel in expected_channels(logged, model)
        }
        for channel in expected_channels(mended, model):
            deviation = channel_deviation(
                logged, mended, logged_channels.get((channel.key, channel.reference_label)), channel
            )
            if deviation is not None:
                groups.setdefault((*channel.key, channel.reference_label, mended.mechanical), []).append(deviation)
    shares = {key: removed_share(group) for key, group in groups.items()}
    if not shares:
        return None
    drawn_key = max(shares, key=lambda key: shares[key])
    quantity, role, _, mechanical = drawn_key
    picture = residual_picture(groups[drawn_key], (quantity, role, mechanical), fault_name in FAULTS_DRAWN_OVER_TIME)
    return None if picture is None else (picture, shares[drawn_key])


def expected_channels(record: Record, model: Model) -> Iterator[ExpectedChannel]:
    """Yield every channel of a run that has an expected value."""
    yield from direct_pairs(record, model)
    yield from modelled_pairs(record, model)


def channel_deviation(
    logged: Record, mended: Record, logged_channel: ExpectedChannel | None, mended_channel: ExpectedChannel
) -> ChannelDeviation | None:
    """Return the deviation of a channel as logged and as mended; None if no sample has both."""
    if logged_channel is None or logged.fast is None or mended.fast is None:
        return None
    valid = logged.fast.all_valid(*logged_channel.inputs) & mended.fast.all_valid(*mended_channel.inputs)
    logged_error, mended_error = (
        smooth(expected_channel.measured) - smooth(expected_channel.expected)
        for expected_channel in (logged_channel, mended_channel)
    )
    sample_indices = np.flatnonzero(valid)
    if not len(sample_indices):
        return None
    return ChannelDeviation(
        mended_channel, logged_error[sample_indices], mended_error[sample_indices], sample_indices, mended.fast.interval
    )


def removed_share(group: Sequence[ChannelDeviation]) -> float:
    """Return the share of a channel's squared error in all runs that mending removes; 0 if the logged error is zero."""
    logged_square = sum(float(np.sum(deviation.logged**2)) for deviation in group)
    mended_square = sum(float(np.sum(deviation.mended**2)) for deviation in group)
    return 1.0 - mended_square / logged_square if logged_square > 0.0 else 0.0


def values_drawn_over(deviation: ChannelDeviation, over_time: bool) -> Array:
    """Return the values over which an error is drawn, shape (samples,).

    They are the time since the run's first sample [s], or the values of the channel's variable.
    """
    if over_time:
        return np.asarray(deviation.interval * deviation.sample_indices, np.float64)
    expected_channel = deviation.expected_channel
    return smooth(expected_channel.expected if expected_channel.drawn_over is None else expected_channel.drawn_over)[
        deviation.sample_indices
    ]


def residual_picture(
    group: Sequence[ChannelDeviation], channel: tuple[str, str, str], over_time: bool
) -> Picture | None:
    """Return the picture of a channel's error in bins of its variable, or of time if `over_time`.

    `channel` is quantity, role and mechanical set-up. Over time, an error is multiplied by the sign of the slope of
    the expected value, so that a channel that is late has the same sign in both directions. The result is None with
    too few bins.
    """
    signs = [
        np.sign(slope(smooth(deviation.expected_channel.expected), 1.0))[deviation.sample_indices]
        if over_time
        else np.ones(len(deviation.sample_indices))
        for deviation in group
    ]
    logged_error = np.concatenate([deviation.logged * sign for deviation, sign in zip(group, signs, strict=True)])
    mended_error = np.concatenate([deviation.mended * sign for deviation, sign in zip(group, signs, strict=True)])
    values = np.concatenate([values_drawn_over(deviation, over_time) for deviation in group])
    # numbered through all runs: samples of one stretch count as one independent group
    stretches = np.concatenate(
        [
            run * STRETCHES + deviation.sample_indices * STRETCHES // (int(deviation.sample_indices[-1]) + 1)
            for run, deviation in enumerate(group)
        ]
    )
    edges = bin_edges(values, logged_error - mended_error, bin_count(float(len(np.unique(stretches)))))
    if len(edges) < FEWEST_EDGES:
        return None
    bin_of_row, bins = bin_of(values, edges), len(edges) - 1
    logged_means, mended_means = (means(error, bin_of_row, stretches, bins) for error in (logged_error, mended_error))
    counts = np.bincount(bin_of_row[bin_of_row >= 0], minlength=bins)
    expected_channel = group[0].expected_channel
    variable: Variable = "time" if over_time else expected_channel.variable
    quantity, role, mechanical = channel
    return Picture(
        variable=variable,
        variable_units=VARIABLES[variable].units,
        periods=None,
        along=f"rate of change of the value expected from {expected_channel.reference_label}" if over_time else None,
        quantity=quantity,
        role=role,
        mechanical=mechanical,
        equation="set-up",
        units=UNITS[quantity],
        before_rms=logged_means.rms(counts),
        after_rms=mended_means.rms(counts),
        off_zero_before=logged_means.off_zero,
        off_zero_after=mended_means.off_zero,
        bins=tuple(
            ResidualBin(
                low=float(edges[index]),
                high=float(edges[index + 1]),
                count=int(counts[index]),
                before=float(logged_means.mean[index]),
                before_low=float(logged_means.low[index]),
                before_high=float(logged_means.high[index]),
                after=float(mended_means.mean[index]),
                after_low=float(mended_means.low[index]),
                after_high=float(mended_means.high[index]),
            )
            for index in range(bins)
        ),
    )
