"""A plan: every action of a protocol in order, with numbers in place of names; what the runner executes.

Setpoints are absolute and SI, in the unit of the mode that the role is in. A role that a segment does not name keeps
its setpoint; engaging a role brings its setpoint to zero, except in angle mode, which holds the shaft where it is.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from leactl.driver.contract import Mode
from leactl.quantities import UNITS

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SETPOINT_QUANTITY = {
    Mode.CURRENT: "q_axis_current_reference",
    Mode.TORQUE_PROFILE: "q_axis_current_reference",
    Mode.VELOCITY: "velocity_reference",
    Mode.ANGLE: "angle_reference",
}


LEAST_SAMPLES = 3  # of a criterion's window: any two give a slope, and their deviation says nothing


class SetpointProfile(Protocol):
    """A setpoint over the time since its segment's start."""

    def at(self, time: float) -> float:
        """The setpoint at this time; before the start and after the end, the nearest one."""

    @property
    def low(self) -> float:
        """The lowest setpoint."""

    @property
    def high(self) -> float:
        """The highest setpoint."""


@dataclass(frozen=True)
class Constant:
    """One setpoint throughout."""

    value: float

    def at(self, time: float) -> float:
        """The setpoint."""
        return self.value

    @property
    def low(self) -> float:
        """The setpoint."""
        return self.value

    @property
    def high(self) -> float:
        """The setpoint."""
        return self.value


@dataclass(frozen=True)
class Ramp:
    """From one setpoint to another at a constant rate."""

    start: float
    stop: float
    duration: float

    def at(self, time: float) -> float:
        """The setpoint on the straight line; exact at both ends."""
        if time >= self.duration:
            return self.stop
        if time <= 0:
            return self.start
        value = self.start + (self.stop - self.start) * (time / self.duration)
        return min(max(value, self.low), self.high)

    @property
    def low(self) -> float:
        """The lower end."""
        return min(self.start, self.stop)

    @property
    def high(self) -> float:
        """The upper end."""
        return max(self.start, self.stop)


@dataclass(frozen=True, eq=False)
class Samples:
    """Setpoints at a constant period, each held until the next."""

    period: float
    values: "NDArray[np.float64]"
    # the same values; its elements are Python floats, at a third of the time that an array's take
    numbers: "memoryview[float]" = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "numbers", memoryview(self.values))  # type: ignore[arg-type]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Samples) and self.period == other.period and self._listed == other._listed

    __hash__ = None  # type: ignore[assignment]  # an array has none

    def at(self, time: float) -> float:
        """The latest sample; a loop that is early by a millionth of a period still takes the sample it is due."""
        index, numbers = int(time / self.period + 1e-6), self.numbers
        if index <= 0:
            return numbers[0]
        return numbers[index] if index < len(numbers) else numbers[-1]

    @cached_property
    def low(self) -> float:
        """The lowest sample."""
        return float(self.values.min())

    @cached_property
    def high(self) -> float:
        """The highest sample."""
        return float(self.values.max())

    @property
    def _listed(self) -> bytes:
        return self.values.tobytes()


@dataclass(frozen=True)
class Sought:
    """One setpoint throughout, which a search chooses between two ends while the plan is executed."""

    low: float
    high: float

    def at(self, time: float) -> float:
        """The end that is further from zero."""
        return max(self.low, self.high, key=abs)


@dataclass(frozen=True)
class Until:
    """Criterion that ends a segment early: low <= statistic of a channel over a window <= high, infinite where open."""

    quantity: str
    role: str
    statistic: str  # mean, std or slope, the last per second
    window_s: float
    low: float
    high: float
    required: bool  # whether the run fails where it is never met

    def __str__(self) -> str:
        unit = UNITS[self.quantity] + ("/s" if self.statistic == "slope" else "")
        what = f"{self.statistic} of {self.role} {self.quantity} over {self.window_s:g} s"
        return f"{what} in {self.low:g} .. {self.high:g} {unit}"


@dataclass(frozen=True)
class Search:
    """A bisection between two setpoints, until the interval in which a trial's outcome changes is narrow enough."""

    name: str
    role: str
    quantity: str  # of the setpoint
    first: float
    second: float
    resolution: float
    required: bool  # whether the run fails where both ends have the same outcome

    @property
    def halvings(self) -> int:
        """How often the interval is halved; a quotient that is a power of two may have a rounding error."""
        return max(0, math.ceil(math.log2(abs(self.second - self.first) / self.resolution) - 1e-9))

    @property
    def trials(self) -> int:
        """Both ends, and one for each halving."""
        return 2 + self.halvings

    def __str__(self) -> str:
        unit = UNITS[self.quantity]
        span = f"{self.role} {self.first:g} .. {self.second:g} {unit}"
        return f"{self.trials} trials, {span} to {self.resolution:g} {unit}"


@dataclass(frozen=True)
class SearchTrial:
    """One trial of a search, counted from 1: its first two are at the ends."""

    search: Search
    number: int


@dataclass(frozen=True)
class Segment:
    """Setpoints over a duration, which is 0 for a jump; the first `settle_s` are left out by analyses.

    With `until`, the duration is the longest; the setpoints are constant then, so that any end leaves the same ones.
    A trial has a criterion; a setpoint that its search is still to choose is `Sought`.
    """

    name: str
    duration_s: float
    settle_s: float
    setpoints: Mapping[str, SetpointProfile]  # role: profile
    parameters: Mapping[str, float | str]
    until: Until | None = None
    trial: SearchTrial | None = None


@dataclass(frozen=True)
class Engage:
    """Bring roles into modes; `Mode.OFF` releases."""

    modes: Mapping[str, Mode]


@dataclass(frozen=True)
class WaitUntil:
    """Wait until low <= value <= high, infinite where a side is open, and give up after the timeout."""

    quantity: str
    role: str
    low: float
    high: float
    timeout_s: float


@dataclass(frozen=True)
class Tare:
    """Take the mean of so many readings as the zero of every sensor that can be tared."""

    samples: int


@dataclass(frozen=True)
class Prompt:
    """Ask the operator to do something and to confirm it."""

    text: str


@dataclass(frozen=True)
class Hang(Prompt):
    """Ask the operator to hang a weight on the arm of the torque sensor, or to take all off; then this torque acts."""

    torque: float  # N*m, in the sense of the shaft, by standard gravity


@dataclass(frozen=True)
class SetRecordRate:
    """Record at this rate from here on; 0 pauses."""

    rate_Hz: float  # noqa: N815 (a unit keeps its letter)


@dataclass(frozen=True)
class SetSupply:
    """Have the supply at a role's leads put out no more than this voltage [V] and current [A]; None switches it off."""

    outputs: Mapping[str, tuple[float, float] | None]


MET, NOT_MET = CRITERION_OUTCOMES = ("met", "not_met")
BRACKETED, NOT_IDENTIFIABLE = SEARCH_OUTCOMES = ("bracketed", "not_identifiable")
BISECTING = "bisecting"  # of a search between its trials


@dataclass(frozen=True)
class StepOutcome:
    """Fulfilled where the latest step, or search, of a name ended so."""

    step: str
    outcome: str  # of a criterion or a search

    def __str__(self) -> str:
        return f"{self.step} is {self.outcome}"


@dataclass(frozen=True)
class InRange:
    """Fulfilled where low <= newest value <= high, infinite where open; a missing value fulfils nothing."""

    quantity: str
    role: str
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.role} {self.quantity} in {self.low:g} .. {self.high:g} {UNITS[self.quantity]}"


@dataclass(frozen=True)
class When:
    """What follows, up to its `EndWhen`, is executed where the condition is fulfilled, and left out elsewhere.

    Modes, setpoints and outputs are the same at both ends, so that what comes after is the same either way.
    """

    condition: StepOutcome | InRange


@dataclass(frozen=True)
class EndWhen:
    """End of the latest `When` that is still open."""


Action = Segment | Engage | WaitUntil | Tare | Prompt | SetRecordRate | SetSupply | When | EndWhen


@dataclass(frozen=True)
class Acceptance:
    """Bounds, infinite where open, that a result of the analysis must keep."""

    result: str
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class ChannelLimit:
    """Bounds, infinite where open, that a channel must keep in every step of a name, or in all steps."""

    channel: str
    role: str
    step: str  # "": every step
    statistic: str  # mean, min, max or std, of the step without its settle part
    low: float
    high: float
    unit: str
    stop: bool = False  # end the run as soon as it is broken

    @property
    def bounds(self) -> str:
        """Both bounds, for a person."""
        return f"{self.low:g} to {self.high:g} was required"


@dataclass(frozen=True)
class SearchLimit:
    """Bounds, infinite where open, that the interval of every search of a name must keep whole."""

    search: str
    low: float
    high: float
    unit: str


class TimelineRow(NamedTuple):
    """One line of the timeline."""

    start_s: float
    name: str
    duration_s: float
    settle_s: float
    setpoints: str


@dataclass(frozen=True)
class Plan:
    """A checked protocol, expanded."""

    name: str
    title: str
    setup: str
    analysis: str  # "" where the protocol names none
    rate_Hz: float  # noqa: N815
    record_Hz: float  # noqa: N815
    parameters: Mapping[str, Any]  # as resolved: --set over condition over default
    condition: str
    actions: tuple[Action, ...]
    acceptance: tuple[Acceptance | ChannelLimit | SearchLimit, ...]
    text: str  # the protocol file, byte for byte
    separates: tuple[str, ...] = ()  # effects of the gap's vocabulary that its runs tell apart
    needs: tuple[str, ...] = ()  # quantities without which its runs would be of no use
    wants: tuple[str, ...] = ()  # quantities that its analysis takes; what no device measures comes by another record
    attended: bool = False  # a person says that they stay by the bench, and switch off what stays on

    @property
    def duration_s(self) -> float:
        """Sum of the segments at their longest and of taring; waits, prompts and enabling take the time they take."""
        return math.fsum(map(self._lasts, self.actions))

    @property
    def adaptive(self) -> bool:
        """Whether any segment may end before its duration, or be left out."""
        return any(isinstance(action, When) or getattr(action, "until", None) is not None for action in self.actions)

    def searches(self) -> list[tuple[Search, float]]:
        """Every search in order, with how long it takes at the most, its rests left out."""
        trials = [action for action in self.actions if isinstance(action, Segment) and action.trial is not None]
        firsts = [action for action in trials if action.trial is not None and action.trial.number == 1]
        return [(one.trial.search, one.trial.search.trials * one.duration_s) for one in firsts if one.trial is not None]

    def peaks(self) -> dict[tuple[str, str], float]:
        """Largest magnitude of each setpoint, by role and quantity; of supplies the current."""
        peaks: dict[tuple[str, str], float] = {}
        for action, modes in self._with_modes():
            if isinstance(action, SetSupply):
                for role, output in action.outputs.items():
                    if output is not None:
                        peaks[role, "line_current"] = max(peaks.get((role, "line_current"), 0.0), output[1])
            if not isinstance(action, Segment):
                continue
            for role, profile in action.setpoints.items():
                key = role, SETPOINT_QUANTITY[modes[role]]
                peaks[key] = max(peaks.get(key, 0.0), abs(profile.low), abs(profile.high))
        return peaks

    def timeline(self) -> list[TimelineRow]:
        """One row an action, each starting where the one before ends."""
        rows = []
        start = 0.0
        for action, modes in self._with_modes():
            if isinstance(action, Segment):
                shown = [f"{role} {_shown(profile, modes[role])}" for role, profile in action.setpoints.items()]
                if action.until is not None:
                    shown.append(f"at most {action.duration_s:g} s, until {action.until}")
                if action.trial is not None:
                    shown.append(f"trial {action.trial.number} of {action.trial.search.trials}")
                rows.append(TimelineRow(start, action.name, action.duration_s, action.settle_s, ", ".join(shown)))
                start += action.duration_s
            else:
                rows.append(TimelineRow(start, _NAMES[type(action)], self._lasts(action), 0.0, _told(action)))
                start += self._lasts(action)
        return rows

    def _lasts(self, action: Action) -> float:
        """How long an action takes at the least; a reading to tare by comes once a cycle, however fast its sensor."""
        if isinstance(action, Tare):
            return action.samples / self.rate_Hz
        return action.duration_s if isinstance(action, Segment) else 0.0

    def _with_modes(self) -> Iterator[tuple[Action, dict[str, Mode]]]:
        modes: dict[str, Mode] = {}
        for action in self.actions:
            if isinstance(action, Engage):
                modes.update(action.modes)
            yield action, modes


_NAMES: dict[type, str] = {
    Engage: "mode",
    WaitUntil: "wait_until",
    Tare: "tare",
    Prompt: "prompt",
    Hang: "weigh",
    SetRecordRate: "record",
    SetSupply: "supply",
    When: "when",
    EndWhen: "end when",
}


def _shown(profile: SetpointProfile, mode: Mode) -> str:
    unit = UNITS[SETPOINT_QUANTITY[mode]]
    if isinstance(profile, Ramp):
        return f"{profile.start:g} -> {profile.stop:g} {unit}"
    if profile.low == profile.high:
        return f"{profile.low:g} {unit}"
    return f"{profile.low:g} .. {profile.high:g} {unit}"


def _told(action: Action) -> str:
    match action:
        case Engage(modes):
            return ", ".join(f"{role} {mode.value}" for role, mode in modes.items())
        case WaitUntil(quantity, role, low, high, timeout_s):
            return f"{role} {quantity} in {low:g} .. {high:g} {UNITS[quantity]}, at most {timeout_s:g} s"
        case SetSupply(outputs):
            shown = {role: f"{one[0]:g} V, {one[1]:g} A" if one else "off" for role, one in outputs.items()}
            return ", ".join(f"{role} {text}" for role, text in shown.items())
        case Tare(samples):
            return f"{samples} samples"
        case Prompt(text):
            return text
        case SetRecordRate(rate_hz):
            return f"{rate_hz:g} Hz" if rate_hz else "paused"
        case When(condition):
            return str(condition)
        case _:
            return ""
