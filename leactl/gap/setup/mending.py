"""How far a fault of a set-up opens a gap: a channel beside what it should read, as it was logged and once mended."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.binned_means import bin_count, bin_edges, bin_of, means
from leactl.gap.diagnosis import Picture, ResidualBin
from leactl.gap.setup.lateness import STRETCHES
from leactl.gap.setup.side_by_side import Pair, direct_pairs, modelled_pairs
from leactl.gap.signals.record import Record
from leactl.gap.signals.smoothing import slope, smooth
from leactl.model.nominal import Model
from leactl.quantities import UNITS
from leactl.vocabulary.variable import VARIABLES, Variable

Array = npt.NDArray[np.float64]
OVER_TIME = {"clock_drift", "dropped_samples", "frozen_channel", "repeated_samples", "clipped_channel"}


@dataclass(frozen=True, eq=False)
class Off:
    """What a channel of a run is off by, as logged and once mended."""

    pair: Pair  # mended
    before: Array
    after: Array
    at: npt.NDArray[np.intp]  # samples of the run


def mended_picture(
    name: str, before: Sequence[Record], after: Sequence[Record], model: Model
) -> tuple[Picture, float] | None:
    """The channel that a fault puts off most, over what it should read; and the share of that which mending takes.

    Parameters
    ----------
    name : of the fault; where it is one of time the residual is counted along the channel's slope, over time.
    before, after : the same runs as logged and mended.
    """
    groups: dict[tuple[str, str, str], list[Off]] = {}
    for logged, mended in zip(before, after, strict=True):
        pairs = {(pair.key, pair.against): pair for pair in every_pair(logged, model)}
        for pair in every_pair(mended, model):
            if (rows := rows_of(logged, mended, pairs.get((pair.key, pair.against)), pair)) is not None:
                groups.setdefault((pair.key[0], pair.against, mended.mechanical), []).append(rows)
    shares = {key: share_of(group) for key, group in groups.items()}
    if not shares:
        return None
    best = max(shares, key=lambda key: shares[key])
    role = groups[best][0].pair.key[1]
    drawn = drawn_of(groups[best], (best[0], role, best[2]), name in OVER_TIME, after)
    return None if drawn is None else (drawn, shares[best])


def every_pair(record: Record, model: Model) -> Iterator[Pair]:
    """Every channel of a run that something is known of."""
    yield from direct_pairs(record, model)
    yield from modelled_pairs(record, model)


def rows_of(logged: Record, mended: Record, before: Pair | None, after: Pair) -> Off | None:
    """What a channel is off by as logged and once mended, where both are known."""
    if before is None or logged.fast is None or mended.fast is None:
        return None
    valid = logged.fast.all_valid(*before.keys) & mended.fast.all_valid(*after.keys)
    off = [smooth(pair.reads) - smooth(pair.expected) for pair in (before, after)]
    at = np.flatnonzero(valid)
    return Off(after, off[0][at], off[1][at], at) if len(at) else None


def sides_of(group: Sequence[Off]) -> tuple[list[Array], list[Array]]:
    """What a channel is off by in every run, before and after."""
    return [off.before for off in group], [off.after for off in group]


def share_of(group: Sequence[Off]) -> float:
    """The share of what a channel is off by that goes, as it is logged where that is more."""
    before, after = (sum(float(np.sum(off**2)) for off in side) for side in sides_of(group))
    return 1.0 - after / before if before > 0.0 else 0.0


def drawn_of(
    group: Sequence[Off], channel: tuple[str, str, str], over_time: bool, records: Sequence[Record]
) -> Picture | None:
    """Means of what a channel is off by, in bins of what it should read, or of time."""
    intervals = {id(record.fast): record.fast.interval for record in records if record.fast is not None}
    interval = float(np.median(list(intervals.values())))
    signs = [
        np.sign(slope(smooth(off.pair.expected), 1.0))[off.at] if over_time else np.ones(len(off.at)) for off in group
    ]
    before, after = (
        np.concatenate([off * sign for off, sign in zip(side, signs, strict=True)]) for side in sides_of(group)
    )
    values = np.concatenate([interval * off.at if over_time else smooth(off.pair.expected)[off.at] for off in group])
    stretches = np.concatenate(
        [number * STRETCHES + off.at * STRETCHES // (int(off.at[-1]) + 1) for number, off in enumerate(group)]
    )
    edges = bin_edges(values, before - after, bin_count(float(len(np.unique(stretches)))))
    if len(edges) < 3:
        return None
    place, bins = bin_of(values, edges), len(edges) - 1
    drawn = [means(left, place, stretches, bins) for left in (before, after)]
    counts = np.bincount(place[place >= 0], minlength=bins)
    pair = group[0].pair
    variable: Variable = "time" if over_time else pair.variable
    columns = zip(
        edges[:-1].tolist(),
        edges[1:].tolist(),
        counts.tolist(),
        *(row.tolist() for own in drawn for row in (own.mean, own.low, own.high)),
        strict=True,
    )
    return Picture(
        variable,
        VARIABLES[variable].units,
        None,
        f"change of what {pair.against} makes of it" if over_time else None,
        *channel,
        "set-up",
        UNITS[channel[0]],
        drawn[0].rms(counts),
        drawn[1].rms(counts),
        drawn[0].off_zero,
        drawn[1].off_zero,
        tuple(ResidualBin(*row) for row in columns),
    )
