"""Prepare channels of a run for plots: choose them by name, cut them to a part of the run, thin them by bins."""

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError, MissingChannel
from leactl.quantities import ChannelSpec
from leactl.runfile.read.reader import Channel, Run

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ChannelTrace:
    """A channel over a part of the run; if thinned, two points for each bin: its lowest and highest value."""

    name: str  # stream/channel
    channel: Channel
    time: Array  # s since the run's start
    values: Array  # NaN where nothing was measured
    samples_per_bin: float  # 1 if the trace has every sample

    def as_json(self) -> dict[str, Any]:
        """Return the trace as a JSON object; a missing sample is null."""
        channel = self.channel
        return {
            "name": self.name,
            "quantity": channel.quantity,
            "role": channel.role,
            "units": channel.units,
            "samples_per_bin": self.samples_per_bin,
            "time_s": self.time.tolist(),
            "values": [value if math.isfinite(value) else None for value in self.values.tolist()],
        }


def channel_names(run: Run, words: list[str]) -> list[str]:
    """Return `stream/channel` of the channels that `words` choose; of all channels if `words` is empty.

    Parameters
    ----------
    words : each a channel's name, `stream/channel`, a quantity, or `quantity:role`.

    Raises
    ------
    MissingChannel : a word chooses no channel; the message lists the channels of the run.
    """
    return chosen_channels(run.streams, words, f"{run.path}: ", "the run")


def chosen_channels(
    streams: Mapping[str, Sequence[ChannelSpec]], words: Sequence[str], message_prefix: str, owner: str
) -> list[str]:
    """Return `stream/channel` of the channels that `words` choose, as `channel_names`.

    Parameters
    ----------
    message_prefix, owner : beginning of an error's message, and name of the object that has the channels.

    Raises
    ------
    MissingChannel : a word chooses no channel; the message lists the channels.
    """
    specs_by_name = {f"{stream}/{spec.name}": spec for stream, specs in streams.items() for spec in specs}
    chosen: list[str] = []
    for word in words:
        matches = [
            name
            for name, spec in specs_by_name.items()
            if word in (name, spec.name, spec.quantity, f"{spec.quantity}:{spec.role}")
        ]
        if not matches:
            nearest = difflib.get_close_matches(word, [spec.name for spec in specs_by_name.values()], 1)
            hint = f"; did you mean {nearest[0]!r}" if nearest else ""
            raise MissingChannel(
                f"{message_prefix}no channel {word!r}{hint}; {owner} has {', '.join(specs_by_name) or 'none'}"
            )
        chosen += [name for name in matches if name not in chosen]
    return chosen if words else list(specs_by_name)


def part_of_run(run: Run, step: str, start: float | None, stop: float | None) -> tuple[float, float]:
    """Return start and stop [s] of a part of the run, given by the name of its steps, by times, or both.

    Raises
    ------
    InputError : the run has no step of this name, no samples, or stop is not after start.
    """
    if step:
        steps = [item for item in run.steps if item.name == step]
        if not steps:
            names = ", ".join(dict.fromkeys(item.name for item in run.steps)) or "none"
            raise InputError(f"{run.path}: no step {step!r}; the run has {names}")
        start = steps[0].start if start is None else start
        stop = steps[-1].stop if stop is None else stop
    times = [run.time(stream) for stream, rows in run.rows.items() if rows]
    if not times:
        raise InputError(f"{run.path}: no samples to plot")
    start = min(float(time[0]) for time in times) if start is None else start
    stop = max(float(time[-1]) for time in times) if stop is None else stop
    if not stop > start:
        raise InputError(f"{run.path}: nothing between {start:g} s and {stop:g} s; --to has to be after --from")
    return start, stop


def channel_trace(run: Run, name: str, start: float, stop: float, bins: int) -> ChannelTrace:
    """Return a channel of a run between two times [s], as `trace_of` does."""
    return trace_of(name, run.channel_at(name), start, stop, bins)


def trace_of(name: str, channel: Channel, start: float, stop: float, bins: int) -> ChannelTrace:
    """Return a channel between two times [s]: its samples, or the range in each bin if there are over two per bin."""
    is_inside = (channel.time >= start) & (channel.time <= stop)
    time, values = channel.time[is_inside], channel.values[is_inside]
    if len(time) <= 2 * bins:
        return ChannelTrace(name, channel, time, values, 1.0)
    edges = np.linspace(start, stop, bins + 1)
    bin_of = np.clip(np.searchsorted(edges, time, side="right") - 1, 0, bins - 1)
    low, high = np.full(bins, np.inf), np.full(bins, -np.inf)
    finite = np.isfinite(values)
    np.minimum.at(low, bin_of[finite], values[finite])
    np.maximum.at(high, bin_of[finite], values[finite])
    is_empty = low > high
    low[is_empty], high[is_empty] = np.nan, np.nan
    centres = (edges[:-1] + edges[1:]) / 2
    return ChannelTrace(name, channel, np.repeat(centres, 2), np.stack([low, high], axis=1).ravel(), len(time) / bins)
