"""How steps ended that later ones depend on: criteria, and searches with the setpoints that they choose."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from leactl.errors import DeviceError
from leactl.protocol.plan import (
    BISECTING,
    BRACKETED,
    MET,
    NOT_IDENTIFIABLE,
    NOT_MET,
    Constant,
    Search,
    SearchLimit,
    Segment,
    StepOutcome,
)
from leactl.quantities import UNITS
from leactl.runner.channel_limits import LimitVerdict
from leactl.units import converter

ENDS = 2  # trials of a search that are at its ends


@dataclass
class Bisection:
    """A search while it goes on: the interval that is left, and how its trials have ended."""

    search: Search
    met: list[bool] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.ends = [self.search.first, self.search.second]

    @property
    def setpoint(self) -> float:
        """What the next trial holds: either end, then the middle of the interval."""
        number = len(self.met)
        return self.ends[number] if number < ENDS else 0.5 * (self.ends[0] + self.ends[1])

    @property
    def outcome(self) -> str:
        """How the search has ended, or that it has not."""
        if len(self.met) >= ENDS and self.met[0] == self.met[1]:
            return NOT_IDENTIFIABLE
        return BRACKETED if len(self.met) == self.search.trials else BISECTING

    @property
    def bracket(self) -> tuple[float, float]:
        """The interval in which the outcome changes; NaN where it is not known."""
        return (min(self.ends), max(self.ends)) if self.outcome == BRACKETED else (math.nan, math.nan)

    def take(self, met: bool) -> None:
        """Keep the half at whose ends the outcome differs."""
        middle = self.setpoint
        if len(self.met) >= ENDS:
            self.ends[0 if met == self.met[0] else 1] = middle
        self.met.append(met)

    def __str__(self) -> str:
        name, unit = self.search.name, UNITS[self.search.quantity]
        if self.outcome == BRACKETED:
            low, high = self.bracket
            return f"{name}: the outcome changes between {low:g} and {high:g} {unit}, {high - low:.3g} {unit} apart"
        ends = f"{self.search.first:g} and {self.search.second:g} {unit}"
        return f"{name}: not identifiable, the criterion is {'met' if self.met[0] else 'not met'} at both {ends}"


class Outcomes:
    """The latest outcome of each step that has one, by name, and every search."""

    def __init__(self) -> None:
        self._latest: dict[str, str] = {}
        self.searches: list[Bisection] = []

    def chosen(self, segment: Segment) -> Segment:
        """A trial with the setpoint that its search has come to; it lies between the ends that were planned."""
        trial = segment.trial
        if trial is None:
            return segment
        if trial.number == 1:
            self.searches.append(Bisection(trial.search))
        role, value = trial.search.role, self.searches[-1].setpoint
        planned = segment.setpoints[role]
        if not planned.low <= value <= planned.high:
            raise AssertionError(f"{value:g} is not between {planned.low:g} and {planned.high:g}")
        told = {f"current_{UNITS[trial.search.quantity]}": value, **segment.parameters}
        return replace(segment, setpoints={role: Constant(value)}, parameters=told)

    def take(self, segment: Segment, met: bool) -> dict[str, Any]:
        """Keep how a step with a criterion ended; returns what its parameters tell of the search that it ends."""
        if segment.trial is None:
            self._latest[segment.name] = MET if met else NOT_MET
            return {}
        bisection = self.searches[-1]
        bisection.take(met)
        self._latest[segment.name] = bisection.outcome
        if bisection.outcome == BISECTING:
            return {}
        unit = UNITS[bisection.search.quantity]
        told: dict[str, Any] = {"bisect": bisection.outcome, f"resolution_{unit}": bisection.search.resolution}
        if bisection.outcome == BRACKETED:
            told |= dict(zip((f"lower_{unit}", f"upper_{unit}"), bisection.bracket, strict=True))
        return told

    def answer(self, search: Search) -> str:
        """What there is to tell of the latest search; empty while it goes on.

        Raises
        ------
        DeviceError : both ends have the same outcome, and an interval is required.
        """
        bisection = self.searches[-1]
        if search.required and bisection.outcome == NOT_IDENTIFIABLE:
            raise DeviceError(str(bisection))
        return "" if bisection.outcome == BISECTING else str(bisection)

    def fulfils(self, condition: StepOutcome) -> bool:
        """Whether the latest step of the name ended so; one that was left out has no outcome."""
        return self._latest.get(condition.step) == condition.outcome

    def verdicts(self, limits: Sequence[SearchLimit]) -> list[LimitVerdict]:
        """How every search kept its limits; one that was never done keeps none."""
        return [self._verdict(limit) for limit in limits]

    def _verdict(self, limit: SearchLimit) -> LimitVerdict:
        searches = [one for one in self.searches if one.search.name == limit.search]
        wanted = f"{limit.low:g} to {limit.high:g} {limit.unit} was required"
        row: dict[str, Any] = {"bisect": limit.search, "lower": None, "upper": None, "units": limit.unit, "met": False}
        if not searches or any(one.outcome != BRACKETED for one in searches):
            what = "has no interval in every pass" if searches else "was not done"
            return LimitVerdict(limit, row, False, f"{limit.search} {what}, {wanted}")
        conversion = converter(limit.unit, searches[0].search.quantity)
        assert conversion is not None  # the protocol was checked
        low = min(one.bracket[0] for one in searches) / conversion.factor
        high = max(one.bracket[1] for one in searches) / conversion.factor
        met = limit.low <= low and high <= limit.high
        row |= {"lower": low, "upper": high, "met": met}
        told = f"{limit.search} is {low:.6g} to {high:.6g} {limit.unit}"
        return LimitVerdict(limit, row, met, told if met else f"{told}, {wanted}")
