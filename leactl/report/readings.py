"""Summaries of the readings of each channel over a short run: mean, standard deviation, age of the last value."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leactl.runfile.read.reader import Channel, Run


@dataclass(frozen=True)
class ChannelSummary:
    """Summary of the readings of one channel; a figure is None if the channel has too few values for it."""

    quantity: str
    role: str
    device: str
    location: str
    unit: str
    samples: int
    mean: float | None
    standard_deviation: float | None
    age_s: float | None  # of its last value, at the last sample of any channel


def readings(run: Run) -> list[ChannelSummary]:
    """Return a summary of every channel of a run, without setpoint channels that have no value."""
    quantities_and_roles = dict.fromkeys((spec.quantity, spec.role) for specs in run.streams.values() for spec in specs)
    channels = [channel for quantity, role in quantities_and_roles for channel in run.channels(quantity, role)]
    run_end = max((float(channel.time[-1]) for channel in channels if len(channel.time)), default=math.nan)
    summaries = [_summary(channel, run_end) for channel in channels]
    return [summary for summary in summaries if summary.samples or not summary.quantity.endswith("_reference")]


def _summary(channel: Channel, run_end: float) -> ChannelSummary:
    """Return the summary of a channel's finite values; ages are at `run_end` [s]."""
    is_finite = np.isfinite(channel.values)
    values = channel.values[is_finite]
    return ChannelSummary(
        channel.quantity,
        channel.role,
        channel.device,
        channel.location,
        channel.units,
        len(values),
        float(values.mean()) if len(values) else None,
        float(values.std(ddof=1)) if len(values) > 1 else None,
        run_end - float(channel.time[is_finite][-1]) if len(values) else None,
    )


def table(channels: Sequence[ChannelSummary]) -> str:
    """Return the summaries as a text table."""
    lines = [f"{'quantity':<26} {'role':<6} {'mean':>12} {'std':>12} {'unit':<6} {'age/s':>7}  device"]
    for channel in channels:
        numbers = f"{_value_text(channel.mean):>12} {_value_text(channel.standard_deviation):>12}"
        age = "-" if channel.age_s is None else f"{channel.age_s:.3f}"
        source = f"{channel.device} {channel.location}".rstrip()
        lines.append(f"{channel.quantity:<26} {channel.role:<6} {numbers} {channel.unit:<6} {age:>7}  {source}")
    return "\n".join(lines)


def _value_text(value: float | None) -> str:
    """Return a value with six significant digits; `-` for None."""
    return "-" if value is None else f"{value:.6g}"
