"""Outcomes of steps that later steps depend on: criteria, and searches with the setpoints that they choose."""

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

END_TRIALS = 2  # first trials of a search, at the ends of its interval


@dataclass
class Bisection:
    """State of a search: the remaining interval, and the outcomes of its trials."""

    search: Search
    met: list[bool] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.ends = [self.search.first, self.search.second]

    @property
    def setpoint(self) -> float:
        """Setpoint of the next trial: first each end, then the middle of the interval."""
        number = len(self.met)
        return self.ends[number] if number < END_TRIALS else 0.5 * (self.ends[0] + self.ends[1])

    @property
    def outcome(self) -> str:
        """Outcome of the search, or `BISECTING` while it is not finished."""
        if len(self.met) >= END_TRIALS and self.met[0] == self.met[1]:
            return NOT_IDENTIFIABLE
        return BRACKETED if len(self.met) == self.search.trials else BISECTING

    @property
    def bracket(self) -> tuple[float, float]:
        """The interval in which the outcome changes, in the unit of the setpoint; NaN while it is not known."""
        return (min(self.ends), max(self.ends)) if self.outcome == BRACKETED else (math.nan, math.nan)

    def take(self, met: bool) -> None:
        """Take the outcome of the trial at `setpoint`; keep the half interval at whose ends the outcomes differ."""
        setpoint = self.setpoint
        if len(self.met) >= END_TRIALS:
            self.ends[0 if met == self.met[0] else 1] = setpoint
        self.met.append(met)

    def __str__(self) -> str:
        name, unit = self.search.name, UNITS[self.search.quantity]
        if self.outcome == BRACKETED:
            low, high = self.bracket
            return f"{name}: the outcome changes between {low:g} and {high:g} {unit}, {high - low:.3g} {unit} apart"
        ends_text = f"{self.search.first:g} and {self.search.second:g} {unit}"
        return f"{name}: not identifiable, the criterion is {'met' if self.met[0] else 'not met'} at both {ends_text}"


class Outcomes:
    """The latest outcome of each step that has one, by name, and every search."""

    def __init__(self) -> None:
        self._latest: dict[str, str] = {}
        self.searches: list[Bisection] = []

    def chosen(self, segment: Segment) -> Segment:
        """Return a trial with the setpoint of its search, between the planned ends; return other segments unchanged."""
        trial = segment.trial
        if trial is None:
            return segment
        if trial.number == 1:
            self.searches.append(Bisection(trial.search))
        role, value = trial.search.role, self.searches[-1].setpoint
        planned_profile = segment.setpoints[role]
        if not planned_profile.low <= value <= planned_profile.high:
            raise AssertionError(f"{value:g} is not between {planned_profile.low:g} and {planned_profile.high:g}")
        parameters = {f"current_{UNITS[trial.search.quantity]}": value, **segment.parameters}
        return replace(segment, setpoints={role: Constant(value)}, parameters=parameters)

    def take(self, segment: Segment, met: bool) -> dict[str, Any]:
        """Take the outcome of a step with a criterion; return parameters of the search that it finishes, if any."""
        if segment.trial is None:
            self._latest[segment.name] = MET if met else NOT_MET
            return {}
        bisection = self.searches[-1]
        bisection.take(met)
        self._latest[segment.name] = bisection.outcome
        if bisection.outcome == BISECTING:
            return {}
        unit = UNITS[bisection.search.quantity]
        parameters: dict[str, Any] = {"bisect": bisection.outcome, f"resolution_{unit}": bisection.search.resolution}
        if bisection.outcome == BRACKETED:
            parameters |= dict(zip((f"lower_{unit}", f"upper_{unit}"), bisection.bracket, strict=True))
        return parameters

    def answer(self, search: Search) -> str:
        """Return the result of the latest search as text; empty while it is not finished.

        Raises
        ------
        DeviceError : both ends have the same outcome, and an interval is required.
        """
        bisection = self.searches[-1]
        if search.required and bisection.outcome == NOT_IDENTIFIABLE:
            raise DeviceError(str(bisection))
        return "" if bisection.outcome == BISECTING else str(bisection)

    def fulfils(self, condition: StepOutcome) -> bool:
        """Return whether the latest step of that name had the outcome; a step that was left out has none."""
        return self._latest.get(condition.step) == condition.outcome

    def verdicts(self, limits: Sequence[SearchLimit]) -> list[LimitVerdict]:
        """Return the verdict on every limit of a search; a search that was never done meets none."""
        return [self._verdict(limit) for limit in limits]

    def _verdict(self, limit: SearchLimit) -> LimitVerdict:
        """Return the verdict on the interval that covers the brackets of all passes of a search."""
        searches = [bisection for bisection in self.searches if bisection.search.name == limit.search]
        requirement = f"{limit.low:g} to {limit.high:g} {limit.unit} was required"
        row: dict[str, Any] = {"bisect": limit.search, "lower": None, "upper": None, "units": limit.unit, "met": False}
        if not searches or any(bisection.outcome != BRACKETED for bisection in searches):
            state = "has no interval in every pass" if searches else "was not done"
            return LimitVerdict(limit, row, False, f"{limit.search} {state}, {requirement}")
        conversion = converter(limit.unit, searches[0].search.quantity)
        assert conversion is not None  # the protocol was checked
        low = min(bisection.bracket[0] for bisection in searches) / conversion.factor
        high = max(bisection.bracket[1] for bisection in searches) / conversion.factor
        met = limit.low <= low and high <= limit.high
        row |= {"lower": low, "upper": high, "met": met}
        summary = f"{limit.search} is {low:.6g} to {high:.6g} {limit.unit}"
        return LimitVerdict(limit, row, met, summary if met else f"{summary}, {requirement}")
