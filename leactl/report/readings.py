"""The readings of every channel over a short run: mean, standard deviation, and age of the last value."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leactl.runfile.read.reader import Channel, Run


@dataclass(frozen=True)
class ChannelSummary:
    """The readings of one channel; None where it has too few values."""

    quantity: str
    role: str
    device: str
    location: str
    unit: str
    samples: int
    mean: float | None
    standard_deviation: float | None
    age_s: float | None  # of the last value at the run's last sample


def readings(run: Run) -> list[ChannelSummary]:
    """Return a summary of every channel of a run, without the setpoints of drives that followed none."""
    quantities_and_roles = dict.fromkeys((spec.quantity, spec.role) for specs in run.streams.values() for spec in specs)
    channels = [channel for quantity, role in quantities_and_roles for channel in run.channels(quantity, role)]
    run_end = max((float(channel.time[-1]) for channel in channels if len(channel.time)), default=math.nan)
    summaries = [_reading(channel, run_end) for channel in channels]
    return [summary for summary in summaries if summary.samples or not summary.quantity.endswith("_reference")]


def _reading(channel: Channel, run_end: float) -> ChannelSummary:
    finite = np.isfinite(channel.values)
    values = channel.values[finite]
    return ChannelSummary(
        channel.quantity,
        channel.role,
        channel.device,
        channel.location,
        channel.units,
        len(values),
        float(values.mean()) if len(values) else None,
        float(values.std(ddof=1)) if len(values) > 1 else None,
        run_end - float(channel.time[finite][-1]) if len(values) else None,
    )


def table(channels: Sequence[ChannelSummary]) -> str:
    """Return the summaries as a table of text."""
    lines = [f"{'quantity':<26} {'role':<6} {'mean':>12} {'std':>12} {'unit':<6} {'age/s':>7}  device"]
    for channel in channels:
        numbers = f"{_shown(channel.mean):>12} {_shown(channel.standard_deviation):>12}"
        age = "-" if channel.age_s is None else f"{channel.age_s:.3f}"
        source = f"{channel.device} {channel.location}".rstrip()
        lines.append(f"{channel.quantity:<26} {channel.role:<6} {numbers} {channel.unit:<6} {age:>7}  {source}")
    return "\n".join(lines)


def _shown(value: float | None) -> str:
    return "-" if value is None else f"{value:.6g}"
