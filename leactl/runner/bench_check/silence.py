"""Find channels that stopped giving numbers before their run ended."""

import math
from typing import NamedTuple

import numpy as np

from leactl.analysis.quality.channel_plausibility import NOT_MEASURED
from leactl.runfile.read.reader import Run
from leactl.safety.limits import Limits

SILENT_SHARE = 0.5  # of the age at which the bench trips; a channel counts as silent from this share on


class Silence(NamedTuple):
    """A channel that fell silent: its device, and the time of its last number."""

    device: str
    since: float  # s; NaN if no number ever came

    def __str__(self) -> str:
        return "gave no number" if math.isnan(self.since) else f"fell silent at {self.since:.2f} s"


def silences(run: Run, limits: Limits, period: float) -> dict[tuple[str, str], Silence]:
    """Return the channels of a run that fell silent, by quantity and role.

    Parameters
    ----------
    period : of the loop [s].
    """
    stream_ends = [run.time(stream)[-1] for stream in run.streams if run.rows[stream]]
    silent = {}
    for stream, specs in run.streams.items():
        trip_age = limits.cyclic_age(period) if stream == "loop" else limits.age_s
        for spec in specs:
            if spec.quantity.endswith("_reference") or spec.quantity in NOT_MEASURED:
                continue
            channel = run.channel_at(f"{stream}/{spec.name}")
            number_times = channel.time[np.isfinite(channel.values)]
            since = float(number_times[-1]) if len(number_times) else math.nan
            if not max(stream_ends, default=0.0) - since <= SILENT_SHARE * trip_age:
                silent[spec.quantity, spec.role] = Silence(spec.device, since)
    return silent
