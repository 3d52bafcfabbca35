"""A whole plan under the bound before anything moves: how hot each winding may become, where, and what wait would help.

What a plan asks of the drives is in `demand`; here it is followed as the guard will follow it, or a little ahead.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from leactl.driver.contract import Mode
from leactl.model.motor import Motor
from leactl.protocol.plan import EndWhen, Plan, Segment, When
from leactl.safety.thermal.bound import LONGEST_STEP_S, ThermalBound, lateness
from leactl.safety.thermal.box import Array, Box
from leactl.safety.thermal.demand import Demand, HeldTorque, PlanState, either, states
from leactl.safety.thermal.guard import MARGIN_K, STEP_S, Budgets, GuardSettings
from leactl.safety.thermal.turning import LED_LOOSE, detour, fastest

PARTS = 10  # samples of a step, where setpoints vary along a line
KEPT_TO = np.array([0.95, 1.0, 1.05])  # of a planned speed
COARSE_K = 2.0  # that a node may rise by in one step, where they do not
LONGEST_S = 2.0
LEAST_S = 1e-6  # rounding of a sum of steps, which is no step of its own
MOST_WAIT_S = 4 * 3600.0
WAIT_ROUNDING_S, WAIT_FOUND_TO_S = 5.0, 1.0
LITTLE, ROUND_HZ = 0.1, 10.0  # of the heat of a turning rotor that may be loose, and what a rate is rounded up to
FAST = 3.0  # rad of electrical angle in a step, from which on it shares its heat among the phases evenly


@dataclass(frozen=True)
class Passing:
    """Where a plan would pass the limit."""

    action: int
    step: str
    time_s: float
    role: str


@dataclass(frozen=True)
class Forecast:
    """What a plan does to the windings."""

    peaks: Mapping[str, float]  # degC, of each role's hottest phase
    passing: Passing | None
    turning_from_hz: float | None  # rate from which on rotors count as turning that stand by the rate of the plan


class Foresight:
    """Plans on one bench, from one state of its windings."""

    def __init__(self, motors: Mapping[str, Motor], settings: GuardSettings, start: Mapping[str, Array]) -> None:
        """Begin from bounds of hottest phase, mean of the phases and housing [degC] of each role.

        Raises
        ------
        InputError : a motor without tolerances.
        """
        self._demand, self._settings = Demand(motors, settings), settings
        self._roles = tuple(motors)
        boxes = [Box.of(motor) for motor in motors.values()]
        self._bound, self._budgets = ThermalBound(boxes, settings.ambient), Budgets(boxes, settings)
        self._bound.set(np.stack([start[role] for role in self._roles], axis=1))
        self._start = self._bound.state
        self._marks: list[_Mark] = []  # of the latest plan, as its actions begin
        self._interval = 0.0  # of its cycles [s]
        turned = fastest(motors.values(), settings.most_current, settings.most_speed)
        self._detours = np.array([detour(motor, turned) for motor in motors.values()])
        self._turning_from = 0.0  # Hz

    def forecast(self, plan: Plan) -> Forecast:
        """Follow a plan from its start until its end, or until a winding may pass its limit."""
        self._bound.state, self._turning_from = self._start, 0.0
        peaks = dict(zip(self._roles, self._bound.hottest().tolist(), strict=True))
        self._marks = [_Mark(self._start, {}, 0.0, peaks, ())]
        return self._go_on(plan, 0)

    def with_waits(self, plan: Plan) -> tuple[Plan, Forecast]:
        """The plan with a wait wherever it would pass the limit and one can help; the forecast is of that plan.

        A wait stands before an action at which no current is asked for, as near as there is one before the hot step.
        """
        forecast = self.forecast(plan)
        while forecast.passing is not None and (waiting := self._wait_before(plan, forecast.passing)) is not None:
            plan, place = waiting
            forecast = self._go_on(plan, place)
        return plan, forecast

    def rest_before(self, plan: Plan) -> float | None:
        """Rest [s] before a plan that keeps it below the limit: 0 where it needs none, None where none is enough."""
        if self.forecast(plan).passing is None:
            return 0.0
        return _shortest(lambda wait: self.forecast(_waiting(plan, 0, wait)).passing is None)

    def _wait_before(self, plan: Plan, passing: Passing) -> tuple[Plan, int] | None:
        """The plan with a wait, and where it stands; where the nearest place is of no use an earlier one is of less."""
        place = _last_at_rest(plan, passing.action)

        def enough(wait: float) -> bool:
            until = passing.action + 2  # the plan is longer by one action
            return self._go_on(_waiting(plan, place, wait), place, until).passing is None

        seconds = _shortest(enough)
        return None if seconds is None else (_waiting(plan, place, seconds), place)

    def _go_on(self, plan: Plan, place: int, until: int | None = None) -> Forecast:
        """Follow a plan from one of its actions, which a former one has come to, until another or its end."""
        del self._marks[place + 1 :]
        mark, bound = self._marks[place], self._bound
        bound.state, self._demand.held, time, peaks = mark.state, mark.held, mark.time, dict(mark.peaks)
        opened = mark.opened
        limit = self._settings.limit - MARGIN_K
        for index, state in islice(enumerate(states(plan)), place, until):
            match plan.actions[index]:
                case When():
                    opened = (*opened, _Before(bound.state, self._demand.held))
                case EndWhen():  # what lies between may have been left out
                    before, opened = opened[-1], opened[:-1]
                    bound.state = np.maximum(bound.state, before.state)
                    self._demand.held = either(self._demand.held, before.held)
            ends_after, worst = time + state.shortest, bound.state
            for piece in self._pieces(plan, state):
                before, former = bound.hottest().tolist(), bound.state
                heat = piece.squares, piece.aligned, piece.speeds
                bound.step(piece.duration, *heat, self._settings.ambient, piece.late)
                time += piece.duration
                if time - piece.duration < ends_after <= time:  # it may end within this piece
                    worst = np.maximum(former, bound.state)
                elif time > ends_after:
                    worst = np.maximum(worst, bound.state)
                after = bound.hottest().tolist()
                for role, was, hottest in zip(self._roles, before, after, strict=True):
                    peaks[role] = max(peaks[role], hottest)
                    if not (hottest < limit or hottest < was):
                        return self._found(peaks, Passing(index, state.name, time, role))
            if state.shortest < state.duration:  # what heats may have ended last, and what cools first
                bound.state = worst
            self._marks.append(_Mark(bound.state, self._demand.held, time, dict(peaks), opened))
        return self._found(peaks, None)

    def _found(self, peaks: Mapping[str, float], passing: Passing | None) -> Forecast:
        slow = self._turning_from * self._interval > 1.0
        return Forecast(peaks, passing, ROUND_HZ * math.ceil(self._turning_from / ROUND_HZ) if slow else None)

    def _pieces(self, plan: Plan, state: PlanState) -> Iterator["_Piece"]:
        """Heat of one action, step by step: no less than the guard will find, which takes steps of its own.

        The guard's steps around the ends of an action see its currents change, those in between do not.
        """
        time, self._interval = 0.0, 1.0 / plan.rate_Hz
        while (left := state.duration - time) > LEAST_S:
            own = self._budgets.step(self._budgets.left(self._bound.hottest().tolist()))
            if state.constant:
                heats, turned, speeds = self._demand.heats(plan, state, [0.0])
                squares = heats[:, 0]
                aligned, late = self._shared(turned, own, np.ones((len(turned), PARTS * round(LONGEST_STEP_S / own))))
                rate = self._bound.fastest(squares, aligned, speeds, self._settings.ambient)
                step = min(left, LONGEST_S, max(COARSE_K / rate if rate > 0.0 else LONGEST_S, 0.01))
                if state.shortest < state.duration and time >= own - LEAST_S:  # its last step may be any
                    aligned = _aligned(turned * own)
                    late = self._late(np.full(len(aligned), max(0.25 * own, 0.5 * (own - state.duration))), own)
                elif time < own - LEAST_S or left <= own + LEAST_S:
                    # the guard's step that sees a current begin or end counts it as late: most where that is its middle
                    step, aligned = min(step, own), _aligned(turned * own)
                    late = self._late(np.full(len(aligned), max(0.25 * own, 0.5 * (own - state.duration))), own)
                else:
                    step = min(step, left - own)
            else:
                step = min(left, STEP_S)
                # a list of setpoints is taken as the loop takes it: between its own samples anything may stand
                parts = max(PARTS, math.ceil(step * plan.rate_Hz - 1e-6)) if state.listed else PARTS
                at = [time + step * (k + 0.5) / parts for k in range(parts)]
                heats, turned, speeds = self._demand.heats(plan, state, at)
                squares, steady = np.mean(heats, axis=1), np.min(heats, axis=1)
                # what a current is at the least in a step is even; what it is beyond may keep step with the rotor
                even = np.where(squares > 0.0, steady / np.where(squares > 0.0, squares, 1.0), 0.0)
                aligned = 1.0 - (1.0 - _aligned(turned * step)) * even
                late = self._late(np.full(len(squares), 0.25 * own), own)
                if left > own and not state.listed:  # a list may change between any two of its own samples
                    count = PARTS * int(min(LONGEST_STEP_S, left) / own + LEAST_S)
                    ahead = [time + own / PARTS * (k + 0.5) for k in range(count)]
                    later, kept, _ = self._demand.squares(plan, state, ahead)
                    shared, lag = self._shared(kept, own, later)
                    better = self._kept(shared, lag) < self._kept(aligned, late)
                    aligned, late = np.where(better, shared, aligned), np.where(better, lag, late)
            if (turning := (squares > 0.0) & (turned * own > 1.0)).any():
                needed = math.sqrt(float(self._detours[turning].max()) / LITTLE)
                self._turning_from = max(self._turning_from, needed)
            aligned = np.minimum(aligned + self._detours * self._interval**2, 1.0)
            aligned[[role in state.leads for role in self._roles]] = LED_LOOSE
            yield _Piece(step, squares, aligned, speeds, late)
            time += step

    def _shared(self, turned: Array, own: float, squares: Array) -> tuple[Array, Array]:
        """Alignments and latenesses over the span that serves best to bound each, of 1, 2, .. guard's steps.

        Parameters
        ----------
        turned : electrical speeds [rad/s], shape (roles,), kept to 5 %.
        own : of the guard's steps [s].
        squares : square currents in as many `PARTS` of as many steps [A^2], shape (roles, parts).
        """
        fast = (turned > FAST / own)[:, None]
        turned = np.minimum(turned, FAST / own)
        times = own / PARTS * (np.arange(squares.shape[1]) + 0.5)
        ends = slice(PARTS - 1, None, PARTS)
        durations = own * np.arange(1, squares.shape[1] // PARTS + 1)
        turns = np.exp(2j * turned[:, None, None] * KEPT_TO[:, None] * times)
        # a rotor that passes much between two parts may keep step with what changes in them: that heat is loose
        steady = np.repeat(squares.reshape(len(squares), -1, PARTS).min(axis=2), PARTS, axis=1)
        steady = np.where(fast, steady, squares)
        heat, turning, loose = squares[:, None, :], steady[:, None, :] * turns, (squares - steady)[:, None, :]
        whole, moment, stood, moved, free, strayed = (
            np.cumsum(one, axis=2)[:, :, ends]
            for one in (heat, heat * times, turning, turning * times, loose, loose * times)
        )
        middle = 0.5 * durations
        even = moment - middle * whole + strayed - middle * free
        behind = np.maximum(even, 0.0) + np.abs(moved - middle * stood)
        none = whole <= 0.0
        aligned = np.where(none, 1.0, np.minimum((np.abs(stood) + free) / np.where(none, 1.0, whole), 1.0))
        behind = np.where(aligned < 1.0, behind, 2.0 * np.maximum(moment - middle * whole, 0.0))
        late = self._late(behind / np.where(none, 1.0, whole * (1.0 + aligned)), own, durations)
        kept = self._kept(aligned, late)
        worst = np.argmax(kept, axis=1)
        span = np.argmin(np.take_along_axis(kept, worst[:, None, :], axis=1)[:, 0, :], axis=1)
        roles = np.arange(len(turned))
        at = roles, worst[roles, span], span
        return aligned[at], late[at]

    def _kept(self, aligned: Array, late: Array) -> Array:
        """What a hottest phase keeps of its heat, but for a factor."""
        return (1.0 + aligned) * (1.0 + late / self._bound.decay_s)

    def _late(self, behind: Array, own: float, durations: Array | None = None) -> Array:
        """Lateness of spans of these durations [s], or of single steps, of a guard that takes steps of `own`."""
        whole = np.asarray(own) if durations is None else durations
        return lateness(behind, whole, self._interval, self._bound.decay_s)


class _Before(NamedTuple):
    """How everything stands before actions that may be left out."""

    state: Array
    held: Mapping[int, HeldTorque]


class _Mark(NamedTuple):
    """How everything stands as an action begins."""

    state: Array
    held: Mapping[int, HeldTorque]
    time: float  # s
    peaks: Mapping[str, float]  # degC, until then
    opened: tuple[_Before, ...]  # of each condition that the action is under


class _Piece(NamedTuple):
    """Part of an action, and the heat in it: arguments of `ThermalBound.step`."""

    duration: float
    squares: Array
    aligned: Array
    speeds: Array
    late: Array


def _aligned(turned: Array) -> Array:
    """|sin x / x| at the most, of currents that turn evenly by 2 x rad of twice the electrical angle."""
    return np.asarray(1.0 / np.maximum(turned, 1.0), np.float64)


def _last_at_rest(plan: Plan, before: int) -> int:
    """The last action, up to one, as which begins no current is asked for, from drive or supply, and no speed.

    It is under no condition that ends before that one, for a wait there might be left out.
    """
    place, opened = 0, []
    for index, state in enumerate(islice(states(plan), before), start=1):
        action = plan.actions[index - 1]
        if isinstance(action, When):
            opened.append(place)
        elif isinstance(action, EndWhen):
            place = opened.pop()
        resting = not state.leads and all(
            state.modes.get(role, Mode.OFF) in (Mode.OFF, Mode.ANGLE) or profile.at(state.duration) == 0.0
            for role, profile in state.setpoints.items()
        )
        place = index if resting else place
    return place


def _waiting(plan: Plan, place: int, seconds: float) -> Plan:
    """The plan with a wait before one of its actions."""
    wait = Segment("cooldown", seconds, seconds, {}, {})
    return replace(plan, actions=(*plan.actions[:place], wait, *plan.actions[place:]))


def _shortest(enough: Callable[[float], bool]) -> float | None:
    """The shortest wait [s] that is enough, rounded up; None where the longest is not."""
    if not enough(MOST_WAIT_S):
        return None
    low, high = 0.0, MOST_WAIT_S
    while high - low > WAIT_FOUND_TO_S:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if enough(middle) else (middle, high)
    return math.ceil(high / WAIT_ROUNDING_S) * WAIT_ROUNDING_S
