"""Limits on channels of a protocol's steps: watched while the run goes, judged when it has ended.

Every reading counts that the supervisor sees, recorded or not, from a step's settle part on. The largest and smallest
value are known to break a limit at once; mean and standard deviation when the step is over. What is missing (NaN) does
not count, and a limit for which nothing was read is not met.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from leactl.errors import AcceptanceFailed, InputError
from leactl.protocol.plan import ChannelBounds, SearchLimit
from leactl.quantities import UNITS, ChannelSpec
from leactl.units import converter

ACCEPTANCE = "acceptance"  # source of the events that tell how limits were kept
Note = Callable[[str, str], None]  # level and message of an event
AWAITED = 2  # steps of a limit that take readings: the last one, and the one before, whose readings come late


@dataclass
class _Window:
    """What a channel did in one step."""

    start: float
    stop: float = math.inf
    count: int = 0
    mean: float = 0.0
    squares: float = 0.0  # sum of squared distances from the mean (Welford 1962)
    low: float = math.inf
    high: float = -math.inf

    def take(self, value: float) -> None:
        self.count += 1
        step = value - self.mean
        self.mean += step / self.count
        self.squares += step * (value - self.mean)
        self.low, self.high = min(self.low, value), max(self.high, value)

    def statistic(self, name: str) -> float:
        """NaN where too little was read."""
        if not self.count:
            return math.nan
        if name == "std":
            return math.sqrt(self.squares / (self.count - 1)) if self.count > 1 else math.nan
        return {"mean": self.mean, "min": self.low, "max": self.high}[name]


@dataclass
class _Watched:
    """One limit on one channel."""

    limit: ChannelBounds
    location: str
    factor: float  # from the channel's unit to the limit's
    zero: float
    windows: list[_Window] = field(default_factory=list)
    broken: bool = False

    @property
    def what(self) -> str:
        """The channel and where it is judged, for a person."""
        limit = self.limit
        where = f" in step {limit.step}" if limit.step else ""
        return f"{limit.statistic} of {limit.role} {limit.channel}{f' {self.location}' * bool(self.location)}{where}"

    def wanted(self) -> str:
        """The bounds, for a person."""
        limit = self.limit
        if math.isinf(limit.low):
            return f"at most {limit.high:g} was required"
        return f"{limit.low:g} or more was required" if math.isinf(limit.high) else limit.bounds

    def take(self, time: float, value: float) -> str:
        """Count a reading; returns what it breaks at once, the first time that it does."""
        window = next((one for one in self.windows[-AWAITED:] if one.start <= time < one.stop), None)
        if window is None or not math.isfinite(value):
            return ""
        number = value * self.factor + self.zero
        window.take(number)
        limit = self.limit
        over = limit.statistic == "max" and number > limit.high
        if self.broken or not (over or (limit.statistic == "min" and number < limit.low)):
            return ""
        self.broken = True
        return f"acceptance: {self.what} is {number:.6g} {limit.unit}, {self.wanted()}"

    def verdict(self) -> "LimitVerdict":
        """The step in which the statistic is furthest out, or nearest to a bound."""
        limit = self.limit
        values = [window.statistic(limit.statistic) for window in self.windows]
        known = [value for value in values if math.isfinite(value)]
        worst = max(known, key=lambda value: max(limit.low - value, value - limit.high), default=math.nan)
        met = bool(known) and len(known) == len(values) and limit.low <= worst <= limit.high
        row = {
            "channel": limit.channel,
            "role": limit.role,
            "step": limit.step,
            "statistic": limit.statistic,
            "value": worst if math.isfinite(worst) else None,
            "units": limit.unit,
            "met": met,
        }
        row |= {"location": self.location} if self.location else {}
        if known and len(known) == len(values):
            told = f"{self.what} is {worst:.6g} {limit.unit}"
        else:
            told = f"{self.what} is not known, nothing was read in {len(values) - len(known)} of {len(values)} steps"
        return LimitVerdict(limit, row, met, told if met else f"{told}, {self.wanted()}")


@dataclass(frozen=True)
class LimitVerdict:
    """How one channel, or search, kept its limit."""

    limit: ChannelBounds | SearchLimit
    row: Mapping[str, Any]  # as --json tells it
    met: bool
    told: str


class ChannelLimits:
    """The channel limits of a plan on the streams of a bench.

    Raises
    ------
    InputError : the bench measures no such channel.
    """

    def __init__(
        self, limits: Sequence[ChannelBounds], streams: Mapping[str, Sequence[ChannelSpec]], bench: str
    ) -> None:
        self._by_stream: dict[str, list[tuple[int, _Watched]]] = {}
        self._every: list[_Watched] = []
        for limit in limits:
            before = len(self._every)
            for stream, channels in streams.items():
                for column, channel in enumerate(channels):
                    if (channel.quantity, channel.role) == (limit.channel, limit.role):
                        watched = _Watched(limit, channel.location, *_conversion(limit))
                        self._every.append(watched)
                        self._by_stream.setdefault(stream, []).append((column, watched))
            if len(self._every) == before:
                raise InputError(
                    f"acceptance: bench '{bench}' measures no {limit.channel} of role '{limit.role}' to judge"
                )

        self.any = bool(limits)

    def enter(self, step: str, start: float) -> None:
        """A step's judged part begins [s since the run's start]."""
        for watched in self._every:
            if watched.limit.step in ("", step):
                watched.windows.append(_Window(start))

    def leave(self, step: str, stop: float) -> None:
        """The step is over."""
        for watched in self._every:
            if watched.limit.step in ("", step) and watched.windows:
                watched.windows[-1].stop = stop

    def receive(self, stream: str, time: float, values: Sequence[float], note: Note) -> None:
        """Count a row of readings; a limit that it breaks is noted.

        Raises
        ------
        AcceptanceFailed : the limit is to stop the run.
        """
        for column, watched in self._by_stream.get(stream, ()):
            broken = watched.take(time, values[column])
            if broken:
                note("warning", broken)
                if watched.limit.stop:
                    raise AcceptanceFailed(broken)

    def watches(self, stream: str) -> bool:
        """Whether a limit is on a channel of the stream."""
        return stream in self._by_stream

    def verdicts(self) -> list[LimitVerdict]:
        """How every channel kept its limits."""
        return [watched.verdict() for watched in self._every]


def _conversion(limit: ChannelBounds) -> tuple[float, float]:
    """Factor and zero that take a number from the channel's unit to the limit's; a deviation has no zero."""
    conversion = converter(limit.unit, limit.channel)
    assert conversion is not None  # the protocol was checked
    assert conversion.target == UNITS[limit.channel]
    return 1.0 / conversion.factor, 0.0 if limit.statistic == "std" else conversion.zero
