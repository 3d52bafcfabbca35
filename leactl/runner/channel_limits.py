"""Limits on channels in the steps of a protocol: watched during the run, judged when it has ended.

Every reading that the supervisor sees counts, recorded or not, after the settling part of a step. Limits of the largest
and smallest value are judged at once; limits of mean and standard deviation at the end of the step. A missing reading
(NaN) does not count, and a limit without readings is not met.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from leactl.errors import AcceptanceFailed, InputError
from leactl.protocol.plan import ChannelBounds, SearchLimit
from leactl.quantities import UNITS, ChannelSpec
from leactl.units import converter

ACCEPTANCE = "acceptance"  # source of the events that record verdicts on limits
Note = Callable[[str, str], None]  # level and message of an event
MOST_OPEN_STEPS = 2  # latest steps of a limit that still take readings: some of the last but one come late


@dataclass
class _Window:
    """Statistics of a channel in one step."""

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
        """Return a statistic by its name; NaN if there are too few readings."""
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
    def subject(self) -> str:
        """The statistic, channel and step, for a person."""
        limit = self.limit
        where = f" in step {limit.step}" if limit.step else ""
        return f"{limit.statistic} of {limit.role} {limit.channel}{f' {self.location}' * bool(self.location)}{where}"

    def wanted(self) -> str:
        """Return the required bounds, for a person."""
        limit = self.limit
        if math.isinf(limit.low):
            return f"at most {limit.high:g} was required"
        return f"{limit.low:g} or more was required" if math.isinf(limit.high) else limit.bounds

    def take(self, time: float, value: float) -> str:
        """Count a reading; return a message when it breaks the limit for the first time, else an empty string."""
        window = next((part for part in self.windows[-MOST_OPEN_STEPS:] if part.start <= time < part.stop), None)
        if window is None or not math.isfinite(value):
            return ""
        number = value * self.factor + self.zero
        window.take(number)
        limit = self.limit
        over = limit.statistic == "max" and number > limit.high
        if self.broken or not (over or (limit.statistic == "min" and number < limit.low)):
            return ""
        self.broken = True
        return f"acceptance: {self.subject} is {number:.6g} {limit.unit}, {self.wanted()}"

    def verdict(self) -> "LimitVerdict":
        """Return the verdict, with the statistic of the step that is furthest outside, or nearest to a bound."""
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
            summary = f"{self.subject} is {worst:.6g} {limit.unit}"
        else:
            summary = (
                f"{self.subject} is not known, nothing was read in {len(values) - len(known)} of {len(values)} steps"
            )
        return LimitVerdict(limit, row, met, summary if met else f"{summary}, {self.wanted()}")


@dataclass(frozen=True)
class LimitVerdict:
    """Verdict on the limit of one channel or search."""

    limit: ChannelBounds | SearchLimit
    row: Mapping[str, Any]  # of the output of --json
    met: bool
    summary: str


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
        """Begin the judged part of a step [s since the run's start]."""
        for watched in self._every:
            if watched.limit.step in ("", step):
                watched.windows.append(_Window(start))

    def leave(self, step: str, stop: float) -> None:
        """End a step [s since the run's start]."""
        for watched in self._every:
            if watched.limit.step in ("", step) and watched.windows:
                watched.windows[-1].stop = stop

    def receive(self, stream: str, time: float, values: Sequence[float], note: Note) -> None:
        """Count a row of readings, and note each limit that it breaks.

        Raises
        ------
        AcceptanceFailed : a broken limit that stops the run.
        """
        for column, watched in self._by_stream.get(stream, ()):
            broken = watched.take(time, values[column])
            if broken:
                note("warning", broken)
                if watched.limit.stop:
                    raise AcceptanceFailed(broken)

    def watches(self, stream: str) -> bool:
        """Return whether a limit is on a channel of the stream."""
        return stream in self._by_stream

    def verdicts(self) -> list[LimitVerdict]:
        """Return the verdict on every limit."""
        return [watched.verdict() for watched in self._every]


def _conversion(limit: ChannelBounds) -> tuple[float, float]:
    """Return factor and zero from the unit of the channel to that of the limit; a deviation has no zero."""
    conversion = converter(limit.unit, limit.channel)
    assert conversion is not None  # the protocol was checked
    assert conversion.target == UNITS[limit.channel]
    return 1.0 / conversion.factor, 0.0 if limit.statistic == "std" else conversion.zero
