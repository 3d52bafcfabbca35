"""Channels that gave no number any more before their run ended."""

import math
from typing import NamedTuple

import numpy as np

from leactl.analysis.quality.gate import NOT_MEASURED
from leactl.runfile.read.reader import Run
from leactl.safety.limits import Limits

OF_AGE = 0.5  # of the age at which the bench trips, from which on a channel counts as silent


class Silence(NamedTuple):
    """A channel's device, and when its last number came; NaN where none ever came."""

    device: str
    since: float  # s

    def __str__(self) -> str:
        return "gave no number" if math.isnan(self.since) else f"fell silent at {self.since:.2f} s"


def silences(run: Run, limits: Limits, period: float) -> dict[tuple[str, str], Silence]:
    """The channels of a run that fell silent, by quantity and role; `period` is that of the loop [s]."""
    ends = [run.time(stream)[-1] for stream in run.streams if run.rows[stream]]
    silent = {}
    for stream, specs in run.streams.items():
        age = limits.cyclic_age(period) if stream == "loop" else limits.age_s
        for spec in specs:
            if spec.quantity.endswith("_reference") or spec.quantity in NOT_MEASURED:
                continue
            channel = run.channel_at(f"{stream}/{spec.name}")
            stamps = channel.time[np.isfinite(channel.values)]
            since = float(stamps[-1]) if len(stamps) else math.nan
            if not max(ends, default=0.0) - since <= OF_AGE * age:
                silent[spec.quantity, spec.role] = Silence(spec.device, since)
    return silent
