"""Progress of a run for its views: written by the loop, read at any time from another thread."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from leactl.quantities import ChannelSpec

WARM_DEGC = 50.0  # the time to a winding's limit is shown above this temperature


@dataclass
class Progress:
    """State of a run; plain values only, so that a reader needs no lock."""

    title: str
    total_s: float
    streams: Mapping[str, tuple[ChannelSpec, ...]]
    values: Sequence[float] = ()  # of stream "loop"
    device_values: Mapping[str, Sequence[float]] = field(default_factory=dict)  # newest row of every other stream
    # degC by role: estimate, and bound of the hottest phase
    windings: tuple[Mapping[str, float], Mapping[str, float]] = ({}, {})
    winding_limit: float = math.nan  # degC, that no bound may pass
    time_left: Callable[[], Mapping[str, float]] = dict  # s by role, until the limit at the present current
    step: str = ""
    prompt: str = ""
    hint: str = ""  # keys that the operator may press
    pause: str = ""  # text on a pause that is wanted or lasts
    warnings: list[str] = field(default_factory=list)  # of interlocks, in the order of their crossing
    view_fault: str = ""  # failure of the view, which is no fault of the run
    time_s: float = 0.0  # start of the newest cycle, since the run's start
    done_s: float = 0.0  # duration of the part of the plan that is done
    began: float = field(default_factory=time.monotonic)  # s by `time.monotonic`

    @property
    def share(self) -> float:
        """Part of the plan that is done."""
        return min(1.0, self.done_s / self.total_s) if self.total_s > 0 else 0.0

    @property
    def left_s(self) -> float:
        """Wall time that the rest of the plan takes at the pace so far [s]; NaN before there is a pace."""
        share = self.share
        return (time.monotonic() - self.began) * (1 - share) / share if share > 0 else float("nan")

    def time_to_limit(self) -> Mapping[str, float]:
        """Return the time until each winding's bound reaches its limit at the present current [s], by role.

        It is empty while no bound is above `WARM_DEGC`.
        """
        return self.time_left() if max(self.windings[1].values(), default=0.0) > WARM_DEGC else {}
