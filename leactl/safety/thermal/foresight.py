"""Forecast of the temperatures under a plan, before anything moves: peaks, where the limit is passed, waits that help.

The currents and speeds of a plan come from `demand`. Here the thermal bound is advanced over them, in steps that give
no lower temperature than the guard will compute during the run.
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
from leactl.safety.thermal.box import Array, Box
from leactl.safety.thermal.demand import Demand, HeldTorque, PlanState, held_after_either, states
from leactl.safety.thermal.guard import MARGIN_K, STEP_S, Budgets, GuardSettings
from leactl.safety.thermal.temperature_bound import LONGEST_STEP_S, ThermalBound, delay_bound
from leactl.safety.thermal.turning import LEAD_LOOSE_SHARE, detour, largest_acceleration

STEP_PARTS = 10  # samples of a step, where setpoints vary along a line
SPEED_FACTORS = np.array([0.95, 1.0, 1.05])  # true speeds over the planned one
LARGEST_STEP_RISE_K = 2.0  # of any node in one step, where setpoints are constant
LONGEST_CONSTANT_STEP_S = 2.0
SHORTEST_STEP_S = 1e-6  # rounding error of a sum of steps: a shorter remainder is no step
LONGEST_WAIT_S = 4 * 3600.0
# the search for a wait ends within the tolerance, and its result is rounded up to a multiple of the rounding
WAIT_ROUNDING_S, WAIT_TOLERANCE_S = 5.0, 1.0
LARGEST_LOOSE_SHARE = 0.1  # of a rotor's heat, for the rotor to count as turning
RATE_ROUNDING_HZ = 10.0  # a rate is rounded up to a multiple of this
FAST_RAD = 3.0  # of electrical angle in a step of the guard: a higher speed is treated as this speed


@dataclass(frozen=True)
class Passing:
    """Action, time and role at which a plan would take a winding past the limit."""

    action: int
    step: str
    time_s: float
    role: str


@dataclass(frozen=True)
class Forecast:
    """Temperatures that the windings may reach under a plan."""

    peaks: Mapping[str, float]  # degC, of each role's hottest phase
    passing: Passing | None
    turning_from_hz: float | None  # loop rate from which rotors count as turning; None if the plan's rate suffices


class Foresight:
    """Forecasts of plans on one bench, from one state of its windings."""

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
        self._marks: list[_Mark] = []  # of the latest plan, one at the beginning of each action
        self._interval = 0.0  # period of its cycles [s]
        acceleration = largest_acceleration(motors.values(), settings.most_current, settings.most_speed)
        self._detours = np.array([detour(motor, acceleration) for motor in motors.values()])
        self._turning_from_hz = 0.0  # loop rate from which rotors count as turning

    def forecast(self, plan: Plan) -> Forecast:
        """Forecast a plan from its start until its end, or until a winding may pass its limit."""
        self._bound.state, self._turning_from_hz = self._start, 0.0
        peaks = dict(zip(self._roles, self._bound.hottest().tolist(), strict=True))
        self._marks = [_Mark(self._start, {}, 0.0, peaks, ())]
        return self._forecast_from(plan, 0)

    def with_waits(self, plan: Plan) -> tuple[Plan, Forecast]:
        """Return the plan with waits that keep it below the limit, where waits can, and the forecast of that plan.

        A wait is inserted before the last action ahead of the hot step at whose beginning no current is demanded.
        """
        forecast = self.forecast(plan)
        while forecast.passing is not None and (waiting := self._wait_before(plan, forecast.passing)) is not None:
            plan, index = waiting
            forecast = self._forecast_from(plan, index)
        return plan, forecast

    def rest_before(self, plan: Plan) -> float | None:
        """Return the rest [s] that a plan needs before it: 0 if none is needed, None if no rest suffices."""
        if self.forecast(plan).passing is None:
            return 0.0
        return _shortest_wait(lambda wait: self.forecast(_with_wait(plan, 0, wait)).passing is None)

    def _wait_before(self, plan: Plan, passing: Passing) -> tuple[Plan, int] | None:
        """Return the plan with a wait before the hot action, and the index of the wait; None if no wait suffices.

        A wait before an earlier action would help even less.
        """
        index = _last_index_at_rest(plan, passing.action)

        def is_enough(wait: float) -> bool:
            until = passing.action + 2  # the plan is longer by one action
            return self._forecast_from(_with_wait(plan, index, wait), index, until).passing is None

        seconds = _shortest_wait(is_enough)
        return None if seconds is None else (_with_wait(plan, index, seconds), index)

    def _forecast_from(self, plan: Plan, start: int, until: int | None = None) -> Forecast:
        """Forecast a plan from action `start` up to and without action `until`, or to its end.

        Its actions before `start` have to equal those of the latest plan.
        """
        del self._marks[start + 1 :]
        mark, bound = self._marks[start], self._bound
        bound.state, self._demand.held, time, peaks = mark.state, mark.held, mark.time, dict(mark.peaks)
        open_conditions = mark.open_conditions
        limit = self._settings.limit - MARGIN_K
        for index, state in islice(enumerate(states(plan)), start, until):
            match plan.actions[index]:
                case When():
                    open_conditions = (*open_conditions, _BeforeCondition(bound.state, self._demand.held))
                case EndWhen():  # the actions under the condition may have been left out
                    before_condition, open_conditions = open_conditions[-1], open_conditions[:-1]
                    bound.state = np.maximum(bound.state, before_condition.state)
                    self._demand.held = held_after_either(self._demand.held, before_condition.held)
            ends_after, worst_state = time + state.shortest, bound.state
            for piece in self._pieces(plan, state):
                hottest_before, state_before = bound.hottest().tolist(), bound.state
                heat = piece.squares, piece.aligned, piece.speeds
                bound.step(piece.duration, *heat, self._settings.ambient, piece.delay)
                time += piece.duration
                if time - piece.duration < ends_after <= time:  # the action may end within this piece
                    worst_state = np.maximum(state_before, bound.state)
                elif time > ends_after:
                    worst_state = np.maximum(worst_state, bound.state)
                hottest_after = bound.hottest().tolist()
                for role, earlier, hottest in zip(self._roles, hottest_before, hottest_after, strict=True):
                    peaks[role] = max(peaks[role], hottest)
                    if not (hottest < limit or hottest < earlier):
                        return self._as_forecast(peaks, Passing(index, state.name, time, role))
            # a node that heats is hottest if the action ends late, a node that cools if it ends early
            if state.shortest < state.duration:
                bound.state = worst_state
            self._marks.append(_Mark(bound.state, self._demand.held, time, dict(peaks), open_conditions))
        return self._as_forecast(peaks, None)

    def _as_forecast(self, peaks: Mapping[str, float], passing: Passing | None) -> Forecast:
        """Return a forecast; it names a loop rate if rotors would turn too far in one cycle of the plan."""
        rate_is_too_low = self._turning_from_hz * self._interval > 1.0
        turning_from = RATE_ROUNDING_HZ * math.ceil(self._turning_from_hz / RATE_ROUNDING_HZ)
        return Forecast(peaks, passing, turning_from if rate_is_too_low else None)

    def _pieces(self, plan: Plan, state: PlanState) -> Iterator["_Piece"]:
        """Yield the heat of one action, step by step: no less than the guard will compute with its own steps.

        The guard's steps around the ends of an action contain a change of its currents, those in between do not.
        """
        time, self._interval = 0.0, 1.0 / plan.rate_Hz
        while (remaining := state.duration - time) > SHORTEST_STEP_S:
            guard_step = self._budgets.step(self._budgets.remaining(self._bound.hottest().tolist()))
            if state.constant:
                heats, electrical_speeds, speeds = self._demand.heats(plan, state, [0.0])
                squares = heats[:, 0]
                aligned, delay = self._best_alignment(
                    electrical_speeds,
                    guard_step,
                    np.ones((len(electrical_speeds), STEP_PARTS * round(LONGEST_STEP_S / guard_step))),
                )
                warming_rate = self._bound.fastest_warming(squares, aligned, speeds, self._settings.ambient)
                step = min(
                    remaining,
                    LONGEST_CONSTANT_STEP_S,
                    max(LARGEST_STEP_RISE_K / warming_rate if warming_rate > 0.0 else LONGEST_CONSTANT_STEP_S, 0.01),
                )
                if state.shortest < state.duration and time >= guard_step - SHORTEST_STEP_S:  # any step may be its last
                    aligned = _alignment_bound(electrical_speeds * guard_step)
                    delay = self._delay_bound(
                        np.full(len(aligned), max(0.25 * guard_step, 0.5 * (guard_step - state.duration))), guard_step
                    )
                elif time < guard_step - SHORTEST_STEP_S or remaining <= guard_step + SHORTEST_STEP_S:
                    # the guard's step in which a current begins or ends counts its heat as late, most if the current
                    # begins or ends at the middle of that step
                    step, aligned = min(step, guard_step), _alignment_bound(electrical_speeds * guard_step)
                    delay = self._delay_bound(
                        np.full(len(aligned), max(0.25 * guard_step, 0.5 * (guard_step - state.duration))), guard_step
                    )
                else:
                    step = min(step, remaining - guard_step)
            else:
                step = min(remaining, STEP_S)
                # a list of setpoints is sampled as the loop samples it: it may change between any two cycles
                sample_count_in_step = (
                    max(STEP_PARTS, math.ceil(step * plan.rate_Hz - 1e-6)) if state.listed else STEP_PARTS
                )
                times = [time + step * (sample + 0.5) / sample_count_in_step for sample in range(sample_count_in_step)]
                heats, electrical_speeds, speeds = self._demand.heats(plan, state, times)
                squares, steady_squares = np.mean(heats, axis=1), np.min(heats, axis=1)
                # the lowest current of a step flows all the time; what exceeds it may keep step with the rotor
                even_share = np.where(squares > 0.0, steady_squares / np.where(squares > 0.0, squares, 1.0), 0.0)
                aligned = 1.0 - (1.0 - _alignment_bound(electrical_speeds * step)) * even_share
                delay = self._delay_bound(np.full(len(squares), 0.25 * guard_step), guard_step)
                if remaining > guard_step and not state.listed:  # a list may change between any two cycles
                    sample_count = STEP_PARTS * int(min(LONGEST_STEP_S, remaining) / guard_step + SHORTEST_STEP_S)
                    times_ahead = [time + guard_step / STEP_PARTS * (sample + 0.5) for sample in range(sample_count)]
                    squares_ahead, speeds_ahead, _ = self._demand.squares(plan, state, times_ahead)
                    span_aligned, span_delay = self._best_alignment(speeds_ahead, guard_step, squares_ahead)
                    span_is_better = self._remaining_heat(span_aligned, span_delay) < self._remaining_heat(
                        aligned, delay
                    )
                    aligned, delay = (
                        np.where(span_is_better, span_aligned, aligned),
                        np.where(span_is_better, span_delay, delay),
                    )
            if (is_turning := (squares > 0.0) & (electrical_speeds * guard_step > 1.0)).any():
                rate_needed = math.sqrt(float(self._detours[is_turning].max()) / LARGEST_LOOSE_SHARE)
                self._turning_from_hz = max(self._turning_from_hz, rate_needed)
            aligned = np.minimum(aligned + self._detours * self._interval**2, 1.0)
            aligned[[role in state.leads for role in self._roles]] = LEAD_LOOSE_SHARE
            yield _Piece(step, squares, aligned, speeds, delay)
            time += step

    def _best_alignment(self, electrical_speeds: Array, guard_step: float, squares: Array) -> tuple[Array, Array]:
        """Return alignment and delay [s] of the heat of each role, shape (roles,), over the span with the lowest bound.

        Spans of 1, 2, .. steps of the guard are compared, each at the worst of the `SPEED_FACTORS`.

        Parameters
        ----------
        electrical_speeds : of the rotors [rad/s], shape (roles,); the drives keep them to 5 %.
        guard_step : step of the guard [s].
        squares : square currents in `STEP_PARTS` parts of each step [A^2], shape (roles, steps * STEP_PARTS).
        """
        is_fast = (electrical_speeds > FAST_RAD / guard_step)[:, None]
        electrical_speeds = np.minimum(electrical_speeds, FAST_RAD / guard_step)
        times = guard_step / STEP_PARTS * (np.arange(squares.shape[1]) + 0.5)
        step_ends = slice(STEP_PARTS - 1, None, STEP_PARTS)
        durations = guard_step * np.arange(1, squares.shape[1] // STEP_PARTS + 1)
        turn_phasors = np.exp(2j * electrical_speeds[:, None, None] * SPEED_FACTORS[:, None] * times)
        # changes of the current may keep step with a rotor that turns far between two parts: their heat is loose
        steady_squares = np.repeat(squares.reshape(len(squares), -1, STEP_PARTS).min(axis=2), STEP_PARTS, axis=1)
        steady_squares = np.where(is_fast, steady_squares, squares)
        heat, turning, loose = (
            squares[:, None, :],
            steady_squares[:, None, :] * turn_phasors,
            (squares - steady_squares)[:, None, :],
        )
        total, moment, phasor, phasor_moment, loose_total, loose_moment = (
            np.cumsum(density, axis=2)[:, :, step_ends]
            for density in (heat, heat * times, turning, turning * times, loose, loose * times)
        )
        middle = 0.5 * durations
        offset = moment - middle * total + loose_moment - middle * loose_total
        mean_delay = np.maximum(offset, 0.0) + np.abs(phasor_moment - middle * phasor)
        no_heat = total <= 0.0
        aligned = np.where(
            no_heat, 1.0, np.minimum((np.abs(phasor) + loose_total) / np.where(no_heat, 1.0, total), 1.0)
        )
        mean_delay = np.where(aligned < 1.0, mean_delay, 2.0 * np.maximum(moment - middle * total, 0.0))
        delay = self._delay_bound(mean_delay / np.where(no_heat, 1.0, total * (1.0 + aligned)), guard_step, durations)
        remaining = self._remaining_heat(aligned, delay)
        worst_factor = np.argmax(remaining, axis=1)
        span = np.argmin(np.take_along_axis(remaining, worst_factor[:, None, :], axis=1)[:, 0, :], axis=1)
        roles = np.arange(len(electrical_speeds))
        chosen_indices = roles, worst_factor[roles, span], span
        return aligned[chosen_indices], delay[chosen_indices]

    def _remaining_heat(self, aligned: Array, delay: Array) -> Array:
        """Return what a hottest phase keeps of its heat at the end of a span, up to a constant factor."""
        return (1.0 + aligned) * (1.0 + delay / self._bound.decay_s)

    def _delay_bound(self, mean_delay: Array, guard_step: float, durations: Array | None = None) -> Array:
        """Return the `delay_bound` [s] of heat over spans of these durations [s], or over single steps of the guard.

        mean_delay : time from the middle of the span to the mean time of a phase's heat [s].
        """
        lengths = np.asarray(guard_step) if durations is None else durations
        return delay_bound(mean_delay, lengths, self._interval, self._bound.decay_s)


class _BeforeCondition(NamedTuple):
    """State of the bound and held torques before actions under a condition, which may be left out."""

    state: Array
    held: Mapping[int, HeldTorque]


class _Mark(NamedTuple):
    """State of a forecast at the beginning of an action."""

    state: Array
    held: Mapping[int, HeldTorque]
    time: float  # s
    peaks: Mapping[str, float]  # degC, highest bound of each role's hottest phase until then
    open_conditions: tuple[_BeforeCondition, ...]  # one for each condition on which the action depends


class _Piece(NamedTuple):
    """Part of an action with its heat: arguments of `ThermalBound.step`."""

    duration: float
    squares: Array
    aligned: Array
    speeds: Array
    delay: Array


def _alignment_bound(electrical_angle: Array) -> Array:
    """Return an upper bound of |sin x / x|: the alignment of even heat while the electrical angle turns by x [rad]."""
    return np.asarray(1.0 / np.maximum(electrical_angle, 1.0), np.float64)


def _last_index_at_rest(plan: Plan, latest: int) -> int:
    """Return the index of the last action up to `latest` at whose beginning no current and no speed is demanded.

    Neither a drive nor a supply has a current then. The action depends on no condition that ends before `latest`,
    because a wait under such a condition might be left out.
    """
    last_at_rest, at_condition_starts = 0, []
    for index, state in enumerate(islice(states(plan), latest), start=1):
        action = plan.actions[index - 1]
        if isinstance(action, When):
            at_condition_starts.append(last_at_rest)
        elif isinstance(action, EndWhen):
            last_at_rest = at_condition_starts.pop()
        is_at_rest = not state.leads and all(
            state.modes.get(role, Mode.OFF) in (Mode.OFF, Mode.ANGLE) or profile.at(state.duration) == 0.0
            for role, profile in state.setpoints.items()
        )
        last_at_rest = index if is_at_rest else last_at_rest
    return last_at_rest


def _with_wait(plan: Plan, index: int, seconds: float) -> Plan:
    """Return the plan with a wait before the action of this index."""
    wait = Segment("cooldown", seconds, seconds, {}, {})
    return replace(plan, actions=(*plan.actions[:index], wait, *plan.actions[index:]))


def _shortest_wait(is_enough: Callable[[float], bool]) -> float | None:
    """Return the shortest wait [s] that is enough, by bisection and rounded up; None if `LONGEST_WAIT_S` is not."""
    if not is_enough(LONGEST_WAIT_S):
        return None
    low, high = 0.0, LONGEST_WAIT_S
    while high - low > WAIT_TOLERANCE_S:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if is_enough(middle) else (middle, high)
    return math.ceil(high / WAIT_ROUNDING_S) * WAIT_ROUNDING_S
