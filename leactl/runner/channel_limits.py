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
MOST_OPEN_STEPS = 2  # the latest two steps of a limit still take readings: some of the former come after its end


@dataclass
class _StepStatistics:
    """Statistics of a channel in one step, in the unit of the limit."""

    start: float  # s since the run's start, of the judged part
    stop: float = math.inf  # s since the run's start
    count: int = 0
    mean: float = 0.0
    squares: float = 0.0  # sum of squared distances from the mean (Welford 1962)
    low: float = math.inf
    high: float = -math.inf

    def take(self, value: float) -> None:
        """Count a reading."""
        self.count += 1
        deviation = value - self.mean
        self.mean += deviation / self.count
        self.squares += deviation * (value - self.mean)
        self.low, self.high = min(self.low, value), max(self.high, value)

    def statistic(self, name: str) -> float:
        """Return a statistic by its name; NaN if there are too few readings."""
        if not self.count:
            return math.nan
        if name == "std":
            return math.sqrt(self.squares / (self.count - 1)) if self.count > 1 else math.nan
        return {"mean": self.mean, "min": self.low, "max": self.high}[name]


@dataclass
class _WatchedLimit:
    """One limit on one channel, with the statistics of its steps."""

    limit: ChannelBounds
    location: str  # of the channel; empty if it states none
    factor: float  # from the channel's unit to the limit's
    zero: float  # in the limit's unit, added after the factor
    windows: list[_StepStatistics] = field(default_factory=list)
    is_broken: bool = False

    @property
    def subject(self) -> str:
        """The statistic, channel and step, for a person."""
        limit = self.limit
        in_step = f" in step {limit.step}" if limit.step else ""
        return f"{limit.statistic} of {limit.role} {limit.channel}{f' {self.location}' * bool(self.location)}{in_step}"

    def wanted(self) -> str:
        """Return the required bounds, for a person."""
        limit = self.limit
        if math.isinf(limit.low):
            return f"at most {limit.high:g} was required"
        return f"{limit.low:g} or more was required" if math.isinf(limit.high) else limit.bounds

    def take(self, time: float, value: float) -> str:
        """Count a reading [s, unit of the channel]; return a message if it is the first to break the limit, or ""."""
        window = next((step for step in self.windows[-MOST_OPEN_STEPS:] if step.start <= time < step.stop), None)
        if window is None or not math.isfinite(value):
            return ""
        converted = value * self.factor + self.zero
        window.take(converted)
        limit = self.limit
        is_too_high = limit.statistic == "max" and converted > limit.high
        if self.is_broken or not (is_too_high or (limit.statistic == "min" and converted < limit.low)):
            return ""
        self.is_broken = True
        return f"acceptance: {self.subject} is {converted:.6g} {limit.unit}, {self.wanted()}"

    def verdict(self) -> "LimitVerdict":
        """Return the verdict, with the statistic of the step in which it is furthest outside or nearest to a bound."""
        limit = self.limit
        values = [window.statistic(limit.statistic) for window in self.windows]
        known_values = [value for value in values if math.isfinite(value)]
        worst_value = max(known_values, key=lambda value: max(limit.low - value, value - limit.high), default=math.nan)
        is_met = bool(known_values) and len(known_values) == len(values) and limit.low <= worst_value <= limit.high
        row = {
            "channel": limit.channel,
            "role": limit.role,
            "step": limit.step,
            "statistic": limit.statistic,
            "value": worst_value if math.isfinite(worst_value) else None,
            "units": limit.unit,
            "met": is_met,
        }
        row |= {"location": self.location} if self.location else {}
        if known_values and len(known_values) == len(values):
            summary = f"{self.subject} is {worst_value:.6g} {limit.unit}"
        else:
            summary = (
                f"{self.subject} is not known, nothing was read in {len(values) - len(known_values)} of"
                f" {len(values)} steps"
            )
        return LimitVerdict(limit, row, is_met, summary if is_met else f"{summary}, {self.wanted()}")


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
        self._by_stream: dict[str, list[tuple[int, _WatchedLimit]]] = {}
        self._watched_limits: list[_WatchedLimit] = []
        for limit in limits:
            limits_before = len(self._watched_limits)
            for stream, channels in streams.items():
                for column, channel in enumerate(channels):
                    if (channel.quantity, channel.role) == (limit.channel, limit.role):
                        watched = _WatchedLimit(limit, channel.location, *_conversion(limit))
                        self._watched_limits.append(watched)
                        self._by_stream.setdefault(stream, []).append((column, watched))
            if len(self._watched_limits) == limits_before:
                raise InputError(
                    f"acceptance: bench '{bench}' measures no {limit.channel} of role '{limit.role}' to judge"
                )

        self.any = bool(limits)

    def enter(self, step: str, start: float) -> None:
        """Begin the judged part of a step [s since the run's start]."""
        for watched in self._watched_limits:
            if watched.limit.step in ("", step):
                watched.windows.append(_StepStatistics(start))

    def leave(self, step: str, stop: float) -> None:
        """End a step [s since the run's start]."""
        for watched in self._watched_limits:
            if watched.limit.step in ("", step) and watched.windows:
                watched.windows[-1].stop = stop

    def receive(self, stream: str, time: float, values: Sequence[float], note: Note) -> None:
        """Count a row of readings, and note each limit that it breaks.

        Raises
        ------
        AcceptanceFailed : a broken limit that stops the run.
        """
        for column, watched in self._by_stream.get(stream, ()):
            message = watched.take(time, values[column])
            if message:
                note("warning", message)
                if watched.limit.stop:
                    raise AcceptanceFailed(message)

    def watches(self, stream: str) -> bool:
        """Return whether a limit is on a channel of the stream."""
        return stream in self._by_stream

    def verdicts(self) -> list[LimitVerdict]:
        """Return the verdict on every limit."""
        return [watched.verdict() for watched in self._watched_limits]


def _conversion(limit: ChannelBounds) -> tuple[float, float]:
    """Return factor and zero from the unit of the channel to that of the limit; a deviation has no zero."""
    conversion = converter(limit.unit, limit.channel)
    assert conversion is not None  # the protocol was checked
    assert conversion.target == UNITS[limit.channel]
    return 1.0 / conversion.factor, 0.0 if limit.statistic == "std" else conversion.zero
