"""The thermal guard of a bench: heat in, every cycle; a bound, a trip and the current that may still flow, out.

Heat is the larger of what a drive reports and what it is asked for, by the measured time between cycles, at the angles
that the rotor passed in each. The bound is advanced every `STEP_S` where anything that may flow could take a winding to
its limit before the next step, else every `COLD_STEP_S`; budgets are looked at every `LOOK_S`, or `COLD_LOOK_S`. It
must hold for longer than now: a drive that loses its host goes on with its last current until its own watchdog stops
it, so that the bound is looked at `reserve_s` ahead, at the current that flows and standing at one electrical angle.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from leactl.model.motor import Motor
from leactl.safety.thermal.bound import HOTTEST, LONGEST_STEP_S, MEAN, ThermalBound
from leactl.safety.thermal.box import PHASE_SHARE, Array, Box, Range
from leactl.safety.thermal.turning import FIELDS, HEAT, LED_LOOSE, VELOCITY, Rotor, Span, fastest, top

LOOK_S, COLD_LOOK_S = 0.01, 0.1
STEP_S, COLD_STEP_S = 0.1, 1.0
LONGEST_LEFT_S, GROWTH = 3600.0, 1.15  # that a time left is told up to, and of the steps to it
HORIZON_S = 1.0  # over which a current is scaled down as the limit comes near
MARGIN_K = 0.5  # below the limit, where a bench is stopped: what the largest current heats in LOOK_S
LITTLE_K_S = 0.05  # that heat may warm a phase by, if it takes two thirds, without being looked at any closer
SCALED_K = 1.0  # below the limit, where scaling ends, so that a hold that is scaled is not stopped


@dataclass(frozen=True)
class GuardSettings:
    """What a guard needs to know of its bench."""

    limit: float  # degC, of the hottest phase
    ambient: float  # degC, as told
    most_current: float  # A, that the bench lets pass
    most_speed: float  # rad/s, the same
    reserve_s: float  # that a drive may go on for without its host


class Budgets:
    """How much heat may pass before a bound is looked at again."""

    def __init__(self, boxes: Sequence[Box], settings: GuardSettings) -> None:
        self._limit = settings.limit - MARGIN_K
        self._most = settings.most_current**2 * (max(HORIZON_S, settings.reserve_s) + COLD_STEP_S)
        # degC per A^2 s of a phase that takes two thirds of the heat, at its limit, cooling left out
        self.heating = [
            box.current_gain**2
            * PHASE_SHARE
            * box.phase_resistance.high
            * max(1.0, 1.0 + box.resistance_coefficient.high * (settings.limit - box.reference_temperature))
            / (box.winding_capacitance.low / 3.0)
            for box in boxes
        ]

    def left(self, hottest: Iterable[float]) -> list[float]:
        """Of each actuator [A^2 s], from bounds of the hottest phases [degC]."""
        return [(self._limit - one) / heating for one, heating in zip(hottest, self.heating, strict=True)]

    def step(self, budgets: Iterable[float]) -> float:
        """How long a step may be [s]: the longer one where nothing that may flow takes any winding to its limit."""
        return COLD_STEP_S if all(self._most < budget for budget in budgets) else STEP_S


class ThermalGuard:
    """Bounds of all actuators of a bench, beside estimates for display: the same network in a box without width."""

    def __init__(self, motors: Mapping[str, Motor], settings: GuardSettings, start: Mapping[str, Array]) -> None:
        """Begin from bounds of hottest phase, mean of the phases and housing [degC] of each role.

        Raises
        ------
        InputError : a motor without tolerances.
        """
        self.roles, self._settings = tuple(motors), settings
        self.limit = settings.limit  # degC, of the hottest phase of any role
        self.boxes = {role: Box.of(motor) for role, motor in motors.items()}
        self.told_ambient = settings.ambient  # degC
        boxes = list(self.boxes.values())
        self._bound = ThermalBound([*boxes, *(Box.exact(motor) for motor in motors.values())], settings.ambient)
        nodes = np.stack([start[role] for role in self.roles], axis=1)
        self._bound.set(np.concatenate([nodes, nodes], axis=1))
        # of each role the cycles since the last step, to which the supervisor adds: how long it took [s], heat [A^2 s],
        # angle [rad] and velocity [rad/s], one after the other
        self.logs: list[list[float]] = [[] for _ in boxes]
        self.flowing = [0.0] * len(boxes)  # A^2 of the latest cycle
        self.leads: dict[int, float] = {}  # A^2 that heats like what flows through two leads, where any may
        self.undriven: frozenset[int] = frozenset()  # roles without a drive, by their places: nothing else heats them
        self.due = -math.inf  # when `check` is to be called again
        turned = fastest(motors.values(), settings.most_current, settings.most_speed)
        self.rotors = [Rotor(motor, settings.most_speed, turned) for motor in motors.values()]
        # how much of each log is counted, and heat in that and through leads [A^2 s]
        self._counted, self._squares = [0] * len(boxes), [0.0] * len(boxes)
        self._led, self._led_moments = [0.0] * len(boxes), [0.0] * len(boxes)  # A^2 s, A^2 s^2 of the latter by now
        self._unseen = 0.0  # s, between two looks of this step at the longest
        self._speeds = [0.0] * len(boxes)  # rad/s, the highest in the last step
        self._budgets_of = Budgets(boxes, settings)
        self._looked = self.advanced = 0.0  # s, when heat was counted and until when the bounds hold
        self._step = STEP_S
        # the bound as it stood when the span began that is looked at as one step, and what that span leaves of a phase
        self._anchor, self._spans = self._bound.state, [Span() for _ in boxes]
        self._forgotten: Callable[[], str] = str
        self._budgets = [-math.inf] * len(boxes)
        self._standing = [1.0] * len(boxes)  # how far what flows stands at one electrical angle where no rotor turns
        self.hottest = {role: float(nodes[HOTTEST, k]) for k, role in enumerate(self.roles)}  # degC, at the most
        self.estimate = {role: float(nodes[MEAN, k]) for k, role in enumerate(self.roles)}  # degC, for display alone
        self.allowed = dict.fromkeys(self.roles, math.inf)
        self.kept = {role: nodes[:, k] for k, role in enumerate(self.roles)}  # bounds of all nodes, for a memory

    def remember(self, fault: Callable[[], str]) -> None:
        """Ask here why the bounds cannot be kept beyond this process; a guard that is forgotten stops the bench."""
        self._forgotten = fault

    def resistances(self, role: str) -> Range:
        """Of a phase, from what it is at the coldest ambient to what it is where its bound stands [ohm]."""
        box = self.boxes[role]
        coldest = self._settings.ambient - box.ambient_rise - box.reference_temperature
        warmest = self.hottest[role] - box.reference_temperature
        slow, fast = box.resistance_coefficient.low, box.resistance_coefficient.high
        return Range(
            box.phase_resistance.low * (1.0 + min(slow * coldest, fast * coldest)),
            box.phase_resistance.high * (1.0 + max(slow * warmest, fast * warmest)),
        )

    def begin(self, now: float) -> None:
        """Time counts from here."""
        self.advanced = self._looked = self.due = now

    def check(self, now: float) -> str:
        """Look at heat and rotors; gives why the bench must stop, and nothing where it may go on."""
        if now < self._looked:
            return "the clock of the bench has gone backwards: no bound of a winding's temperature holds"
        every = LOOK_S if self._step == STEP_S else COLD_LOOK_S
        self.due = now + every
        self._look(now)
        since = now - self.advanced
        if since < self._step:
            for square, flowing, budget in zip(self._squares, self.flowing, self._budgets, strict=True):
                if square + flowing * self._settings.reserve_s > budget:
                    break
            else:
                return ""
        return self._advance(now, since) if since > 0.0 else ""

    def end(self, now: float) -> None:
        """No cycle comes any more: bring `kept` to now, and to what may flow until drives stop by themselves."""
        reserve = self._settings.reserve_s
        standing, on = [1.0] * len(self.roles), max(now - self._looked, 0.0)
        most = self._settings.most_speed
        self._speeds = [
            max(speed, top(log[VELOCITY::FIELDS], most)) for speed, log in zip(self._speeds, self.logs, strict=True)
        ]
        self._look(max(now, self._looked))
        since = max(now - self.advanced, 0.0)
        nodes = self._bound.nodes()
        if since > 0.0:
            squares = [
                (square + flowing * on) / since for square, flowing in zip(self._squares, self.flowing, strict=True)
            ]
            self._bound.step(since, *self._twice(squares, standing, self._speeds), self._settings.ambient)
            nodes = self._bound.nodes()
        self._bound.step(reserve, *self._twice(self.flowing, standing, self._speeds), self._settings.ambient, late=0.0)
        self.advanced = now
        self._forget()
        self._keep(np.maximum(nodes, self._bound.nodes()))

    def _keep(self, nodes: Array) -> None:
        self.kept = {role: nodes[:, k] for k, role in enumerate(self.roles)}

    def _look(self, now: float) -> None:
        """Count the heat since the last look."""
        since = now - self._looked
        self._unseen = max(self._unseen, since)
        for index, log in enumerate(self.logs):
            self._squares[index] += sum(log[self._counted[index] + HEAT :: FIELDS])
            self._counted[index] = len(log)
        for index, square in self.leads.items():
            heat = square * since
            self._squares[index] += heat
            self._led[index] += heat
            self._led_moments[index] += heat * (self._looked - self.advanced + 0.5 * since)
            alone = index in self.undriven
            self.flowing[index] = square if alone else max(self.flowing[index], square)
            self._standing[index] = LED_LOOSE if alone else 1.0
        self._looked = now

    def _forget(self) -> None:
        """The next step begins; the supervisor keeps the lists."""
        for log in self.logs:
            log.clear()
        self._counted = [0] * len(self.roles)
        self._squares, self._led, self._led_moments = ([0.0] * len(self.roles) for _ in range(3))
        self._unseen = 0.0

    def _advance(self, now: float, duration: float) -> str:
        if now > self._looked:
            self._look(now)
        fresh = []
        led = zip(self._led, self._led_moments, strict=True)
        lanes = zip(self.rotors, self.logs, self._squares, led, self._budgets_of.heating, strict=True)
        for rotor, log, square, (through_leads, moment), heating in lanes:
            if square * heating < LITTLE_K_S * duration:
                span = rotor.unlooked_at(square - through_leads, log[VELOCITY::FIELDS], duration)
            else:
                span = rotor.span(np.reshape(log, (-1, FIELDS)), duration)
            span.lead(through_leads, moment, self._unseen)
            fresh.append(span)
        self._speeds = [span.speed for span in fresh]
        self._forget()
        self._follow(fresh)
        self.advanced = now
        return self._judge(self._speeds) or self._forgotten()

    def _follow(self, fresh: list[Span]) -> None:
        """One step of the bound: from where the last one ended, or over again from where the span began.

        Either is a bound. The longer one is taken where it leaves less of the same heat in a phase: where rotors crawl.
        """
        bound, decay = self._bound, self._bound.decay_s
        joined = [before.joined(after) for before, after in zip(self._spans, fresh, strict=True)]
        gap = any(rotor.lost for rotor in self.rotors)  # across which no two angles by the velocity belong together
        longer = not gap and self._spans[0].duration > 0.0 and joined[0].duration <= LONGEST_STEP_S
        if longer and self._left(joined, joined) < self._left(self._spans, joined):
            self._spans = joined
            bound.state = self._anchor
        else:
            self._anchor, self._spans = bound.state, fresh
        spans = self._spans
        whole = spans[0].duration
        heat = self._twice(
            [span.square / whole for span in spans], [s.aligned for s in spans], [s.speed for s in spans]
        )
        late = [span.late(decay) for span in spans]
        bound.step(whole, *heat, self._settings.ambient, np.array(late + late))

    def _left(self, spans: list[Span], heat: list[Span]) -> float:
        """Of some heat, what the hottest phases keep if it is shared as in these spans."""
        decay = self._bound.decay_s
        return sum(
            one.square * (1.0 + span.aligned) * (1.0 + span.late(decay) / decay)
            for one, span in zip(heat, spans, strict=True)
        )

    def _judge(self, speeds: list[float]) -> str:
        """Look ahead from where the bound stands: trip, scale, and how much heat may pass before the next look."""
        settings, bound = self._settings, self._bound
        nodes = bound.nodes()
        hottest, estimates = nodes[HOTTEST], nodes[MEAN, len(self.roles) :]
        self._keep(nodes)
        before = list(self.hottest.values())
        for k, role in enumerate(self.roles):
            self.hottest[role], self.estimate[role] = float(hottest[k]), float(estimates[k])
        self._budgets = self._budgets_of.left(self.hottest.values())
        self._step = self._budgets_of.step(self._budgets)
        if self._step > STEP_S:
            self.allowed = dict.fromkeys(self.roles, math.inf)
            return ""
        still = [1.0] * len(self.roles)
        held = self._ahead(self.flowing, self._standing, speeds, settings.reserve_s)
        most = self._ahead([settings.most_current**2] * len(self.roles), still, speeds, HORIZON_S)
        cause = ""
        for k, role in enumerate(self.roles):
            # what starts above the limit may cool there: no stop would cool it any faster
            cools = held[k] < hottest[k] < before[k]
            if not (cools or max(hottest[k], held[k]) < settings.limit - MARGIN_K):
                cause = cause or (
                    f"{role} winding: its hottest phase may be at {hottest[k]:.1f} degC, and at {held[k]:.1f} degC"
                    f" {settings.reserve_s:g} s on; the limit is {settings.limit:g} degC"
                )
            self.allowed[role] = math.inf
            if not most[k] < settings.limit - SCALED_K:
                least = self._ahead([0.0] * len(self.roles), still, speeds, HORIZON_S)[k]
                self.allowed[role] = self._between(least, most[k])
        return cause

    def _between(self, least: float, most: float) -> float:
        """The current that ends below the limit, where the temperature is no more than a line in its square."""
        room = self._settings.limit - SCALED_K - least
        if not (room > 0.0 and math.isfinite(most)):
            return 0.0
        return self._settings.most_current * math.sqrt(min(1.0, room / (most - least)))

    def _ahead(self, squares: list[float], aligned: list[float], speeds: list[float], duration: float) -> Array:
        """Hottest phases after some time at these currents."""
        kept = self._bound.state
        self._bound.step(duration, *self._twice(squares, aligned, speeds), self._settings.ambient, late=0.0)
        hottest = self._bound.hottest()
        self._bound.state = kept
        return hottest

    @staticmethod
    def _twice(squares: list[float], aligned: list[float], speeds: list[float]) -> tuple[Array, Array, Array]:
        """For the bounds and for the estimates."""
        return np.array(squares + squares), np.array(aligned + aligned), np.array(speeds + speeds)

    def time_left(self) -> dict[str, float]:
        """How long each role could go on as it does before its bound reaches the limit [s]; infinite beyond an hour.

        From another thread at any time: it works on a copy.
        """
        bound, speeds = copy(self._bound), list(self._speeds)
        heat = self._twice(list(self.flowing), list(self._standing), speeds)
        left, time, step = dict.fromkeys(self.roles, math.inf), 0.0, STEP_S
        while time < LONGEST_LEFT_S and math.inf in left.values():
            bound.step(step, *heat, self._settings.ambient, late=0.0)
            time, step = time + step, step * GROWTH
            for role, hottest in zip(self.roles, bound.hottest(), strict=False):
                if math.isinf(left[role]) and not hottest < self._settings.limit - MARGIN_K:
                    left[role] = time
        return left
