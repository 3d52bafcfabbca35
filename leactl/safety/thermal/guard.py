"""The thermal guard of a bench: counts the heat of every cycle, bounds the windings, trips and limits currents.

Heat is the larger of the current that a drive reports and the current that is demanded of it, squared, times the
measured time between cycles, at the angles that the rotor passed in each. The bound is advanced every `STEP_S` where
the largest current could take a winding to its limit before the next step, else every `COLD_STEP_S`; budgets of heat
are checked every `LOOK_INTERVAL_S`, or `COLD_LOOK_INTERVAL_S`. The bound must hold for some time ahead: a drive that
loses its host continues with its last current until its own watchdog stops it. The bound is therefore also computed
`reserve_s` ahead, for the current that flows and a rotor that stands at one electrical angle.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from leactl.model.motor import Motor
from leactl.safety.thermal.box import PHASE_SHARE, Array, Box, Range
from leactl.safety.thermal.temperature_bound import HOTTEST, LONGEST_STEP_S, MEAN, ThermalBound
from leactl.safety.thermal.turning import (
    FIELDS,
    HEAT,
    LEAD_LOOSE_SHARE,
    VELOCITY,
    Rotor,
    Span,
    highest_speed,
    largest_acceleration,
)

LOOK_INTERVAL_S, COLD_LOOK_INTERVAL_S = 0.01, 0.1
STEP_S, COLD_STEP_S = 0.1, 1.0
LONGEST_TIME_LEFT_S, STEP_GROWTH = 3600.0, 1.15  # longest time left that is computed, and growth of its steps
HORIZON_S = 1.0  # time ahead for which the allowed current keeps a winding below its limit
# a bench is stopped at this margin below the limit: the largest current heats by as much in LOOK_INTERVAL_S
MARGIN_K = 0.5
# where a phase that takes two thirds of the heat warms more slowly, all heat counts as loose
LOOSE_WARMING_K_PER_S = 0.05
SCALING_MARGIN_K = 1.0  # a current is scaled to stay this far below the limit: more than MARGIN_K, so as not to trip


@dataclass(frozen=True)
class GuardSettings:
    """Limits and ambient temperature of the bench under guard."""

    limit: float  # degC, of the hottest phase
    ambient: float  # degC, as in the bench file
    most_current: float  # A, limit of the bench
    most_speed: float  # rad/s, limit of the bench
    reserve_s: float  # how long a drive may continue without its host


class Budgets:
    """Heat that may pass before the bounds have to be advanced."""

    def __init__(self, boxes: Sequence[Box], settings: GuardSettings) -> None:
        self._limit = settings.limit - MARGIN_K
        self._largest_heat = settings.most_current**2 * (max(HORIZON_S, settings.reserve_s) + COLD_STEP_S)
        # K per A^2 s of a phase that takes two thirds of the heat, at its limit and without cooling
        self.heating = [
            box.current_gain**2
            * PHASE_SHARE
            * box.phase_resistance.high
            * max(1.0, 1.0 + box.resistance_coefficient.high * (settings.limit - box.reference_temperature))
            / (box.winding_capacitance.low / 3.0)
            for box in boxes
        ]

    def remaining(self, hottest: Iterable[float]) -> list[float]:
        """Return the budget of each actuator [A^2 s], given bounds of the hottest phases [degC]."""
        return [(self._limit - bound) / heating for bound, heating in zip(hottest, self.heating, strict=True)]

    def step(self, budgets: Iterable[float]) -> float:
        """Return how long a step may be [s]: `COLD_STEP_S` if the largest current exhausts no budget [A^2 s] in it."""
        return COLD_STEP_S if all(self._largest_heat < budget for budget in budgets) else STEP_S


class ThermalGuard:
    """Bounds of all actuators of a bench, and estimates for display; the estimates come from boxes without width."""

    def __init__(self, motors: Mapping[str, Motor], settings: GuardSettings, start: Mapping[str, Array]) -> None:
        """Begin from bounds of hottest phase, mean of the phases and housing [degC] of each role.

        Raises
        ------
        InputError : a motor without tolerances.
        """
        self.roles, self._settings = tuple(motors), settings
        self.limit = settings.limit  # degC, of the hottest phase of any role
        self.boxes = {role: Box.of(motor) for role, motor in motors.items()}
        self.ambient = settings.ambient  # degC, as in the bench file
        boxes = list(self.boxes.values())
        self._bound = ThermalBound([*boxes, *(Box.exact(motor) for motor in motors.values())], settings.ambient)
        nodes = np.stack([start[role] for role in self.roles], axis=1)
        self._bound.set(np.concatenate([nodes, nodes], axis=1))
        # for each role the cycles since the last step, appended by the supervisor: duration [s], heat [A^2 s], angle
        # [rad] and velocity [rad/s], one after the other
        self.logs: list[list[float]] = [[] for _ in boxes]
        self.flowing = [0.0] * len(boxes)  # A^2 of the latest cycle
        self.leads: dict[int, float] = {}  # A^2 by role index, of a q-axis current that heats like that through leads
        self.undriven: frozenset[int] = frozenset()  # indices of roles without a drive: only a supply heats them
        self.due = -math.inf  # when `check` is to be called again
        acceleration = largest_acceleration(motors.values(), settings.most_current, settings.most_speed)
        self.rotors = [Rotor(motor, settings.most_speed, acceleration) for motor in motors.values()]
        # how many numbers of each log are counted, and the heat in them and through leads since the last step [A^2 s]
        self._counted, self._squares = [0] * len(boxes), [0.0] * len(boxes)
        # heat through leads since the last step [A^2 s], and its moments about the beginning of the step [A^2 s^2]
        self._lead_heat, self._lead_moments = [0.0] * len(boxes), [0.0] * len(boxes)
        self._longest_gap = 0.0  # s, between two looks since the last step
        self._speeds = [0.0] * len(boxes)  # rad/s, the highest in the last step
        self._heat_budgets = Budgets(boxes, settings)
        self._counted_at = self.advanced = 0.0  # s, when heat was counted last and up to when the bounds are advanced
        self._step = STEP_S
        # the state of the bound at the beginning of the latest spans, and these spans, one of each actuator
        self._anchor, self._spans = self._bound.state, [Span() for _ in boxes]
        self._memory_fault: Callable[[], str] = str
        self._budgets = [-math.inf] * len(boxes)
        # `aligned` of `ThermalBound.step` for the flowing currents, if no rotor turns
        self._flowing_alignment = [1.0] * len(boxes)
        # degC by role: upper bound of the hottest phase, and estimate of the mean of the phases for display alone
        self.hottest = {role: float(nodes[HOTTEST, index]) for index, role in enumerate(self.roles)}
        self.estimate = {role: float(nodes[MEAN, index]) for index, role in enumerate(self.roles)}
        self.allowed = dict.fromkeys(self.roles, math.inf)
        self.node_bounds = {role: nodes[:, index] for index, role in enumerate(self.roles)}  # degC, bounds of all nodes

    def remember(self, storage_fault: Callable[[], str]) -> None:
        """Store the function that returns why the bounds cannot be stored, or an empty string.

        It is called after each step, and any reason stops the bench.
        """
        self._memory_fault = storage_fault

    def resistances(self, role: str) -> Range:
        """Return the range of a phase's resistance [ohm] between the coldest air and the bound of the hottest phase."""
        box = self.boxes[role]
        coldest = self._settings.ambient - box.ambient_rise - box.reference_temperature
        warmest = self.hottest[role] - box.reference_temperature
        rise_low, rise_high = box.resistance_coefficient.low, box.resistance_coefficient.high
        return Range(
            box.phase_resistance.low * (1.0 + min(rise_low * coldest, rise_high * coldest)),
            box.phase_resistance.high * (1.0 + max(rise_low * warmest, rise_high * warmest)),
        )

    def begin(self, now: float) -> None:
        """Start the clock: heat is counted from this time [s]."""
        self.advanced = self._counted_at = self.due = now

    def check(self, now: float) -> str:
        """Count the heat and advance the bounds if they are due; return why the bench must stop, or an empty string."""
        if now < self._counted_at:
            return "the clock of the bench has gone backwards: no bound of a winding's temperature holds"
        interval = LOOK_INTERVAL_S if self._step == STEP_S else COLD_LOOK_INTERVAL_S
        self.due = now + interval
        self._look(now)
        elapsed = now - self.advanced
        if elapsed < self._step:
            for square, flowing, budget in zip(self._squares, self.flowing, self._budgets, strict=True):
                if square + flowing * self._settings.reserve_s > budget:
                    break
            else:
                return ""
        return self._advance(now, elapsed) if elapsed > 0.0 else ""

    def end(self, now: float) -> None:
        """Bring `node_bounds` to the end of the run.

        They cover the time until now and another `reserve_s`, for which drives may continue.
        """
        reserve = self._settings.reserve_s
        standstill, uncounted_time = [1.0] * len(self.roles), max(now - self._counted_at, 0.0)
        speed_limit = self._settings.most_speed
        self._speeds = [
            max(speed, highest_speed(log[VELOCITY::FIELDS], speed_limit))
            for speed, log in zip(self._speeds, self.logs, strict=True)
        ]
        self._look(max(now, self._counted_at))
        elapsed = max(now - self.advanced, 0.0)
        nodes = self._bound.nodes()
        if elapsed > 0.0:
            squares = [
                (square + flowing * uncounted_time) / elapsed
                for square, flowing in zip(self._squares, self.flowing, strict=True)
            ]
            self._bound.step(elapsed, *self._twice(squares, standstill, self._speeds), self._settings.ambient)
            nodes = self._bound.nodes()
        self._bound.step(
            reserve, *self._twice(self.flowing, standstill, self._speeds), self._settings.ambient, delay=0.0
        )
        self.advanced = now
        self._clear_logs()
        self._set_node_bounds(np.maximum(nodes, self._bound.nodes()))

    def _set_node_bounds(self, nodes: Array) -> None:
        self.node_bounds = {role: nodes[:, index] for index, role in enumerate(self.roles)}

    def _look(self, now: float) -> None:
        """Add the heat since the last look to that of this step."""
        elapsed = now - self._counted_at
        self._longest_gap = max(self._longest_gap, elapsed)
        for index, log in enumerate(self.logs):
            self._squares[index] += sum(log[self._counted[index] + HEAT :: FIELDS])
            self._counted[index] = len(log)
        for index, square in self.leads.items():
            heat = square * elapsed
            self._squares[index] += heat
            self._lead_heat[index] += heat
            self._lead_moments[index] += heat * (self._counted_at - self.advanced + 0.5 * elapsed)
            has_no_drive = index in self.undriven
            self.flowing[index] = square if has_no_drive else max(self.flowing[index], square)
            self._flowing_alignment[index] = LEAD_LOOSE_SHARE if has_no_drive else 1.0
        self._counted_at = now

    def _clear_logs(self) -> None:
        """Clear the logs and sums for the next step; the logs stay the same lists: the supervisor appends to them."""
        for log in self.logs:
            log.clear()
        self._counted = [0] * len(self.roles)
        self._squares, self._lead_heat, self._lead_moments = ([0.0] * len(self.roles) for _ in range(3))
        self._longest_gap = 0.0

    def _advance(self, now: float, duration: float) -> str:
        """Advance the bounds by one step; return why the bench must stop, or an empty string."""
        if now > self._counted_at:
            self._look(now)
        new_spans = []
        lead_heat = zip(self._lead_heat, self._lead_moments, strict=True)
        actuators = zip(self.rotors, self.logs, self._squares, lead_heat, self._heat_budgets.heating, strict=True)
        for rotor, log, square, (through_leads, moment), heating in actuators:
            if square * heating < LOOSE_WARMING_K_PER_S * duration:
                span = rotor.loose_span(square - through_leads, log[VELOCITY::FIELDS], duration)
            else:
                span = rotor.span(np.reshape(log, (-1, FIELDS)), duration)
            span.add_lead_heat(through_leads, moment, self._longest_gap)
            new_spans.append(span)
        self._speeds = [span.speed for span in new_spans]
        self._clear_logs()
        self._follow(new_spans)
        self.advanced = now
        return self._judge(self._speeds) or self._memory_fault()

    def _follow(self, new_spans: list[Span]) -> None:
        """Advance the bound by the new spans, or by the latest spans joined with them, from where the latest began.

        Either gives a bound. The joined spans are taken if they leave less of the same heat in a phase, as they do
        while rotors crawl.
        """
        bound, decay = self._bound, self._bound.decay_s
        joined_spans = [earlier.joined(new_span) for earlier, new_span in zip(self._spans, new_spans, strict=True)]
        has_gap = any(rotor.path_has_gap for rotor in self.rotors)  # no angles by the velocity are comparable across it
        can_join = not has_gap and self._spans[0].duration > 0.0 and joined_spans[0].duration <= LONGEST_STEP_S
        if can_join and self._remaining_heat(joined_spans, joined_spans) < self._remaining_heat(
            self._spans, joined_spans
        ):
            self._spans = joined_spans
            bound.state = self._anchor
        else:
            self._anchor, self._spans = bound.state, new_spans
        spans = self._spans
        duration = spans[0].duration
        heat = self._twice(
            [span.square / duration for span in spans], [span.aligned for span in spans], [span.speed for span in spans]
        )
        delays = [span.delay(decay) for span in spans]
        bound.step(duration, *heat, self._settings.ambient, np.array(delays + delays))

    def _remaining_heat(self, spans: list[Span], heat_spans: list[Span]) -> float:
        """Return what the hottest phases keep of `heat` if it is distributed as in `spans`, up to a constant factor."""
        decay = self._bound.decay_s
        return sum(
            heat_span.square * (1.0 + span.aligned) * (1.0 + span.delay(decay) / decay)
            for heat_span, span in zip(heat_spans, spans, strict=True)
        )

    def _judge(self, speeds: list[float]) -> str:
        """Set budgets and allowed currents from the bounds now and ahead; return why the bench must stop, or "".

        speeds : highest speed of each rotor [rad/s].
        """
        settings, bound = self._settings, self._bound
        nodes = bound.nodes()
        hottest, estimates = nodes[HOTTEST], nodes[MEAN, len(self.roles) :]
        self._set_node_bounds(nodes)
        hottest_before = list(self.hottest.values())
        for index, role in enumerate(self.roles):
            self.hottest[role], self.estimate[role] = float(hottest[index]), float(estimates[index])
        self._budgets = self._heat_budgets.remaining(self.hottest.values())
        self._step = self._heat_budgets.step(self._budgets)
        if self._step > STEP_S:
            self.allowed = dict.fromkeys(self.roles, math.inf)
            return ""
        standstill = [1.0] * len(self.roles)
        at_reserve = self._hottest_after(self.flowing, self._flowing_alignment, speeds, settings.reserve_s)
        at_highest_current = self._hottest_after(
            [settings.most_current**2] * len(self.roles), standstill, speeds, HORIZON_S
        )
        cause = ""
        for index, role in enumerate(self.roles):
            # a winding that starts above the limit may cool: stopping would not cool it any faster
            is_cooling = at_reserve[index] < hottest[index] < hottest_before[index]
            if not (is_cooling or max(hottest[index], at_reserve[index]) < settings.limit - MARGIN_K):
                cause = cause or (
                    f"{role} winding: its hottest phase may be at {hottest[index]:.1f} degC, and at"
                    f" {at_reserve[index]:.1f} degC {settings.reserve_s:g} s on; the limit is {settings.limit:g} degC"
                )
            self.allowed[role] = math.inf
            if not at_highest_current[index] < settings.limit - SCALING_MARGIN_K:
                without_current = self._hottest_after([0.0] * len(self.roles), standstill, speeds, HORIZON_S)[index]
                self.allowed[role] = self._scaled_current(without_current, at_highest_current[index])
        return cause

    def _scaled_current(self, lowest: float, highest: float) -> float:
        """Return the current [A] that keeps a winding `SCALING_MARGIN_K` below the limit, linear in its square.

        lowest, highest : temperatures ahead with no current and with the largest current [degC]; a line between the two
            bounds the temperature with any square current in between.
        """
        headroom = self._settings.limit - SCALING_MARGIN_K - lowest
        if not (headroom > 0.0 and math.isfinite(highest)):
            return 0.0
        return self._settings.most_current * math.sqrt(min(1.0, headroom / (highest - lowest)))

    def _hottest_after(self, squares: list[float], aligned: list[float], speeds: list[float], duration: float) -> Array:
        """Return the bounds of the hottest phases [degC] after a duration [s] of this heat; the state is kept."""
        state = self._bound.state
        self._bound.step(duration, *self._twice(squares, aligned, speeds), self._settings.ambient, delay=0.0)
        hottest = self._bound.hottest()
        self._bound.state = state
        return hottest

    @staticmethod
    def _twice(squares: list[float], aligned: list[float], speeds: list[float]) -> tuple[Array, Array, Array]:
        """Return the arguments as arrays, each twice: for the bounds and for the estimates."""
        return np.array(squares + squares), np.array(aligned + aligned), np.array(speeds + speeds)

    def time_left(self) -> dict[str, float]:
        """Return the time [s] until the bound of each role reaches the limit at its present current; inf beyond 1 h.

        May be called from another thread at any time: it works on a copy.
        """
        bound, speeds = copy(self._bound), list(self._speeds)
        heat = self._twice(list(self.flowing), list(self._flowing_alignment), speeds)
        times, time, step = dict.fromkeys(self.roles, math.inf), 0.0, STEP_S
        while time < LONGEST_TIME_LEFT_S and math.inf in times.values():
            bound.step(step, *heat, self._settings.ambient, delay=0.0)
            time, step = time + step, step * STEP_GROWTH
            for role, hottest in zip(self.roles, bound.hottest(), strict=False):
                if math.isinf(times[role]) and not hottest < self._settings.limit - MARGIN_K:
                    times[role] = time
        return times
