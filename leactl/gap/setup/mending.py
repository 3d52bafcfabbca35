"""Measure the gap that a fault of the set-up opens: a channel minus its expected value, as logged and mended."""

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


@dataclass(frozen=True, eq=False)
class Off:
    """Error of a channel of a run against its expected value, as logged and mended."""

    pair: ExpectedChannel  # of the mended run
    before: Array
    after: Array
    at: npt.NDArray[np.intp]  # samples of the run
    interval: float  # s, of the mended run


def mended_picture(
    name: str, before: Sequence[Record], after: Sequence[Record], model: Model
) -> tuple[Picture, float] | None:
    """Return the picture of the channel whose error mending removes most of, and the share removed; None without one.

    Parameters
    ----------
    name : name of the fault; for one of `OVER_TIME` the error is multiplied by the sign of the slope, over time.
    before, after : the same runs as logged and as mended.
    """
    groups: dict[tuple[str, str, str, str], list[Off]] = {}
    for logged, mended in zip(before, after, strict=True):
        pairs = {(pair.key, pair.reference_label): pair for pair in every_pair(logged, model)}
        for pair in every_pair(mended, model):
            if (rows := rows_of(logged, mended, pairs.get((pair.key, pair.reference_label)), pair)) is not None:
                groups.setdefault((*pair.key, pair.reference_label, mended.mechanical), []).append(rows)
    shares = {key: share_of(group) for key, group in groups.items()}
    if not shares:
        return None
    worst_channel = max(shares, key=lambda key: shares[key])
    quantity, role, _, mechanical = worst_channel
    picture = drawn_of(groups[worst_channel], (quantity, role, mechanical), name in OVER_TIME)
    return None if picture is None else (picture, shares[worst_channel])


def every_pair(record: Record, model: Model) -> Iterator[ExpectedChannel]:
    """Yield every channel of a run that has an expected value."""
    yield from direct_pairs(record, model)
    yield from modelled_pairs(record, model)


def rows_of(logged: Record, mended: Record, before: ExpectedChannel | None, after: ExpectedChannel) -> Off | None:
    """Return the error of a channel as logged and mended; None where one of both is not known."""
    if before is None or logged.fast is None or mended.fast is None:
        return None
    valid = logged.fast.all_valid(*before.inputs) & mended.fast.all_valid(*after.inputs)
    errors = [smooth(pair.measured) - smooth(pair.expected) for pair in (before, after)]
    samples = np.flatnonzero(valid)
    return Off(after, errors[0][samples], errors[1][samples], samples, mended.fast.interval) if len(samples) else None


def sides_of(group: Sequence[Off]) -> tuple[list[Array], list[Array]]:
    """Return the errors of a channel in every run, before and after mending."""
    return [rows.before for rows in group], [rows.after for rows in group]


def share_of(group: Sequence[Off]) -> float:
    """Return the share of a channel's squared error that mending removes."""
    squares_before, squares_after = (sum(float(np.sum(error**2)) for error in side) for side in sides_of(group))
    return 1.0 - squares_after / squares_before if squares_before > 0.0 else 0.0


def drawn_over(pair: ExpectedChannel) -> Array:
    """Return the values of the variable that the error of a channel is drawn over."""
    return smooth(pair.expected if pair.drawn_over is None else pair.drawn_over)


def drawn_of(group: Sequence[Off], channel: tuple[str, str, str], over_time: bool) -> Picture | None:
    """Return the picture of a channel's error in bins of its `variable`, or of time; None with too few bins."""
    signs = [
        np.sign(slope(smooth(off.pair.expected), 1.0))[off.at] if over_time else np.ones(len(off.at)) for off in group
    ]
    before, after = (
        np.concatenate([off * sign for off, sign in zip(side, signs, strict=True)]) for side in sides_of(group)
    )
    values = np.concatenate([off.interval * off.at if over_time else drawn_over(off.pair)[off.at] for off in group])
    stretches = np.concatenate(
        [number * STRETCHES + off.at * STRETCHES // (int(off.at[-1]) + 1) for number, off in enumerate(group)]
    )
    edges = bin_edges(values, before - after, bin_count(float(len(np.unique(stretches)))))
    if len(edges) < 3:
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
        f"change of what {pair.reference_label} makes of it" if over_time else None,
        *channel,
        "set-up",
        UNITS[channel[0]],
        binned_sides[0].rms(counts),
        binned_sides[1].rms(counts),
        binned_sides[0].off_zero,
        binned_sides[1].off_zero,
        tuple(ResidualBin(*row) for row in columns),
    )
