"""Define the plan of a run: every action of a protocol in order, with numbers in place of parameters.

Setpoints are absolute and in the SI unit of the role's mode. A role that a segment does not name keeps its setpoint.
Engaging a role sets its setpoint to zero, except in angle mode, which holds the present angle.
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


FEWEST_WINDOW_SAMPLES = 3  # in the window of a criterion: two samples always lie on a line, without deviation


class SetpointProfile(Protocol):
    """A setpoint as a function of the time since its segment's start."""

    def at(self, time: float) -> float:
        """Return the setpoint at a time [s]: before the start the first setpoint, after the end the last one."""

    @property
    def low(self) -> float:
        """Lowest setpoint."""

    @property
    def high(self) -> float:
        """Highest setpoint."""


@dataclass(frozen=True)
class Constant:
    """A constant setpoint."""

    value: float

    def at(self, time: float) -> float:
        """Return the setpoint."""
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
    """A setpoint that changes from `start` to `stop` at a constant rate."""

    start: float
    stop: float
    duration: float

    def at(self, time: float) -> float:
        """Return the setpoint on the straight line; exact at both ends."""
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
    # the same values as Python floats, whose access takes a third of the time of an array's element
    numbers: "memoryview[float]" = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "numbers", memoryview(self.values))  # type: ignore[arg-type]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Samples) and self.period == other.period and self._value_bytes == other._value_bytes

    __hash__ = None  # type: ignore[assignment]  # an array has none

    def at(self, time: float) -> float:
        """Return the latest sample; a time that is early by up to a millionth of a period counts as on time."""
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
    def _value_bytes(self) -> bytes:
        return self.values.tobytes()


@dataclass(frozen=True)
class SoughtSetpoint:
    """A constant setpoint between two ends, which a search chooses while the plan is executed."""

    low: float
    high: float

    def at(self, time: float) -> float:
        """Return the end of larger magnitude, the worst case of the setpoint."""
        return max(self.low, self.high, key=abs)


@dataclass(frozen=True)
class Until:
    """Criterion that ends a segment early: low <= statistic of a channel over a window <= high.

    An open bound is infinite.
    """

    quantity: str
    role: str
    statistic: str  # mean, std or slope, the last per second
    window_s: float
    low: float
    high: float
    required: bool  # whether the run fails if it is never met

    def __str__(self) -> str:
        unit = UNITS[self.quantity] + ("/s" if self.statistic == "slope" else "")
        statistic_text = f"{self.statistic} of {self.role} {self.quantity} over {self.window_s:g} s"
        return f"{statistic_text} in {self.low:g} .. {self.high:g} {unit}"


@dataclass(frozen=True)
class Search:
    """A bisection between two setpoints, until the outcome changes within an interval of `resolution` or less."""

    name: str
    role: str
    quantity: str  # of the setpoint
    first: float
    second: float
    resolution: float
    required: bool  # whether the run fails if both ends have the same outcome

    @property
    def halvings(self) -> int:
        """Number of halvings; 1e-9 absorbs the rounding error if the quotient is a power of two."""
        return max(0, math.ceil(math.log2(abs(self.second - self.first) / self.resolution) - 1e-9))

    @property
    def trials(self) -> int:
        """Number of trials: two ends, and one for each halving."""
        return 2 + self.halvings

    def __str__(self) -> str:
        unit = UNITS[self.quantity]
        interval = f"{self.role} {self.first:g} .. {self.second:g} {unit}"
        return f"{self.trials} trials, {interval} to {self.resolution:g} {unit}"


@dataclass(frozen=True)
class SearchTrial:
    """One trial of a search, counted from 1; the first two are at the ends."""

    search: Search
    number: int


@dataclass(frozen=True)
class Segment:
    """Setpoints over a duration, which is 0 for a jump; analyses leave out the first `settle_s`.

    With `until`, the duration is the longest possible one, and setpoints are constant, so that they are the same
    whenever the segment ends. A trial has a criterion; a setpoint that its search has not chosen yet is
    `SoughtSetpoint`.
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
    """Put roles into modes; `Mode.OFF` releases the drive."""

    modes: Mapping[str, Mode]


@dataclass(frozen=True)
class WaitUntil:
    """Wait until low <= value <= high, infinite if a side is open; fail after the timeout."""

    quantity: str
    role: str
    low: float
    high: float
    timeout_s: float


@dataclass(frozen=True)
class Tare:
    """Set the zero of every sensor that can be tared, to the mean of `samples` readings."""

    samples: int


@dataclass(frozen=True)
class Prompt:
    """Ask the operator for an action and its confirmation."""

    text: str


@dataclass(frozen=True)
class Hang(Prompt):
    """Ask the operator to hang a weight on the torque sensor's arm, or to remove all; `torque` is then applied."""

    torque: float  # N*m, in the sense of the shaft, by standard gravity


@dataclass(frozen=True)
class SetRecordRate:
    """Record at this rate from now on; 0 pauses."""

    rate_Hz: float  # noqa: N815 (a unit keeps its letter)


@dataclass(frozen=True)
class SetSupply:
    """Set the limits [V, A] of the supply at each role's leads and switch it on; None switches it off."""

    outputs: Mapping[str, tuple[float, float] | None]


MET, NOT_MET = CRITERION_OUTCOMES = ("met", "not_met")
BRACKETED, NOT_IDENTIFIABLE = SEARCH_OUTCOMES = ("bracketed", "not_identifiable")
BISECTING = "bisecting"  # outcome of a search that has not ended


@dataclass(frozen=True)
class StepOutcome:
    """Condition: the latest step or search of this name ended with this outcome."""

    step: str
    outcome: str  # of a criterion or a search

    def __str__(self) -> str:
        return f"{self.step} is {self.outcome}"


@dataclass(frozen=True)
class InRange:
    """Condition: low <= newest value <= high, infinite if open; a missing value does not meet it."""

    quantity: str
    role: str
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.role} {self.quantity} in {self.low:g} .. {self.high:g} {UNITS[self.quantity]}"


@dataclass(frozen=True)
class When:
    """The actions up to the matching `EndWhen` are executed if the condition is met, and skipped otherwise.

    Modes, setpoints and outputs are the same before and after them, so that skipping changes nothing later.
    """

    condition: StepOutcome | InRange


@dataclass(frozen=True)
class EndWhen:
    """End of the latest `When` that is still open."""


Action = Segment | Engage | WaitUntil | Tare | Prompt | SetRecordRate | SetSupply | When | EndWhen


@dataclass(frozen=True)
class Acceptance:
    """Bounds of a result of the analysis, infinite if open."""

    result: str
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class ChannelBounds:
    """Bounds of a channel in every step of a name, or in all steps; infinite if open."""

    channel: str
    role: str
    step: str  # name; empty: every step
    statistic: str  # mean, min, max or std over the step without its settle time
    low: float
    high: float
    unit: str
    stop: bool = False  # whether the run ends as soon as a bound is exceeded

    @property
    def bounds(self) -> str:
        """Both bounds, as text for a person."""
        return f"{self.low:g} to {self.high:g} was required"


@dataclass(frozen=True)
class SearchLimit:
    """Bounds that must contain the whole final interval of every search of a name; infinite if open."""

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
    analysis: str  # empty if the protocol names none
    rate_Hz: float  # noqa: N815
    record_Hz: float  # noqa: N815
    parameters: Mapping[str, Any]  # resolved: --set overrides the condition, which overrides the default
    condition: str
    actions: tuple[Action, ...]
    acceptance: tuple[Acceptance | ChannelBounds | SearchLimit, ...]
    text: str  # the protocol file, byte for byte
    separates: tuple[str, ...] = ()  # effects that its runs can tell apart
    needs: tuple[str, ...] = ()  # quantities that the bench must measure
    wants: tuple[str, ...] = ()  # quantities that its analysis uses; a record of them may be attached after the run
    attended: bool = False  # whether a person stays by the bench and can switch off a supply

    @property
    def duration_s(self) -> float:
        """Longest duration of segments and taring; waits, prompts and enabling are not included."""
        return math.fsum(map(self._duration_of, self.actions))

    @property
    def adaptive(self) -> bool:
        """Whether any segment may end early or be skipped."""
        return any(isinstance(action, When) or getattr(action, "until", None) is not None for action in self.actions)

    def searches(self) -> list[tuple[Search, float]]:
        """Return every search in order, with its longest duration [s] without rests."""
        trials = [action for action in self.actions if isinstance(action, Segment) and action.trial is not None]
        first_trials = [action for action in trials if action.trial is not None and action.trial.number == 1]
        return [
            (segment.trial.search, segment.trial.search.trials * segment.duration_s)
            for segment in first_trials
            if segment.trial is not None
        ]

    def peaks(self) -> dict[tuple[str, str], float]:
        """Return the largest magnitude of each setpoint by (role, quantity); supplies count with their current."""
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
        """Return one row for each action, which starts when the previous one ends."""
        rows = []
        start = 0.0
        for action, modes in self._with_modes():
            if isinstance(action, Segment):
                texts = [f"{role} {_profile_text(profile, modes[role])}" for role, profile in action.setpoints.items()]
                if action.until is not None:
                    texts.append(f"at most {action.duration_s:g} s, until {action.until}")
                if action.trial is not None:
                    texts.append(f"trial {action.trial.number} of {action.trial.search.trials}")
                rows.append(TimelineRow(start, action.name, action.duration_s, action.settle_s, ", ".join(texts)))
                start += action.duration_s
            else:
                rows.append(
                    TimelineRow(
                        start, _ACTION_NAMES[type(action)], self._duration_of(action), 0.0, _action_text(action)
                    )
                )
                start += self._duration_of(action)
        return rows

    def _duration_of(self, action: Action) -> float:
        """Return the duration of an action [s]; taring takes one reading per cycle."""
        if isinstance(action, Tare):
            return action.samples / self.rate_Hz
        return action.duration_s if isinstance(action, Segment) else 0.0

    def _with_modes(self) -> Iterator[tuple[Action, dict[str, Mode]]]:
        """Yield each action with the modes by role after it; the dictionary is the same object each time."""
        modes: dict[str, Mode] = {}
        for action in self.actions:
            if isinstance(action, Engage):
                modes.update(action.modes)
            yield action, modes


_ACTION_NAMES: dict[type, str] = {
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


def _profile_text(profile: SetpointProfile, mode: Mode) -> str:
    """Return a setpoint profile as text with its unit."""
    unit = UNITS[SETPOINT_QUANTITY[mode]]
    if isinstance(profile, Ramp):
        return f"{profile.start:g} -> {profile.stop:g} {unit}"
    if profile.low == profile.high:
        return f"{profile.low:g} {unit}"
    return f"{profile.low:g} .. {profile.high:g} {unit}"


def _action_text(action: Action) -> str:
    """Return the settings of an action that is no segment, as text; empty if it has none."""
    match action:
        case Engage(modes):
            return ", ".join(f"{role} {mode.value}" for role, mode in modes.items())
        case WaitUntil(quantity, role, low, high, timeout_s):
            return f"{role} {quantity} in {low:g} .. {high:g} {UNITS[quantity]}, at most {timeout_s:g} s"
        case SetSupply(outputs):
            output_texts = {
                role: f"{output[0]:g} V, {output[1]:g} A" if output else "off" for role, output in outputs.items()
            }
            return ", ".join(f"{role} {text}" for role, text in output_texts.items())
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
