"""The thermal guard of a bench: heat in, every cycle; a bound, a trip and the current that may still flow, out.

Heat is the larger of what a drive reports and what it is asked for, by the measured time between cycles. The bound is
advanced every `STEP_S`, and from `SOONEST_S` on where the heat since then could take a winding to its limit. It must
hold for longer than now: a drive that loses its host goes on with its last current until its own watchdog stops it, so
that the bound is looked at `reserve_s` ahead, at the current that flows and standing at one electrical angle.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from leactl.model.motor import Motor
from leactl.safety.thermal.bound import HOTTEST, MEAN, ThermalBound
from leactl.safety.thermal.box import PHASE_SHARE, Array, Box

STEP_S = 0.1
SOONEST_S = 0.01
HORIZON_S = 1.0  # over which a current is scaled down as the limit comes near
MARGIN_K = 0.5  # below the limit, where a bench is stopped: what the largest current heats in SOONEST_S
SCALED_K = 1.0  # below the limit, where scaling ends, so that a hold that is scaled is not stopped


@dataclass(frozen=True)
class GuardSettings:
    """What a guard needs to know of its bench."""

    limit: float  # degC, of the hottest phase
    ambient: float  # degC, as told
    most_current: float  # A, that the bench lets pass
    most_speed: float  # rad/s, the same
    reserve_s: float  # that a drive may go on for without its host


class _Heat:
    """What one actuator has taken since the last step: integrals of i^2, of i^2 at its electrical angle, and speed."""

    __slots__ = ("aligned_cos", "aligned_sin", "angle", "latest", "poles", "speed", "square")

    def __init__(self, poles: int) -> None:
        self.poles, self.latest, self.angle = 2.0 * poles, 0.0, 0.0
        self.clear()

    def clear(self) -> None:
        self.square = self.aligned_cos = self.aligned_sin = self.speed = 0.0


class ThermalGuard:
    """Bounds of all actuators of a bench, beside estimates for display: the same network in a box without width."""

    def __init__(self, motors: Mapping[str, Motor], settings: GuardSettings, start: Mapping[str, Array]) -> None:
        """Begin from bounds of hottest phase, mean of the phases and housing [degC] of each role.

        Raises
        ------
        InputError : a motor without tolerances.
        """
        self.roles, self._settings = tuple(motors), settings
        boxes = [Box.of(motor) for motor in motors.values()]
        self._bound = ThermalBound([*boxes, *(Box.exact(motor) for motor in motors.values())], settings.ambient)
        nodes = np.stack([start[role] for role in self.roles], axis=1)
        self._bound.set(np.concatenate([nodes, nodes], axis=1))
        self._heats = [_Heat(motor.pole_pairs) for motor in motors.values()]
        # degC per A^2 s of a phase that takes two thirds of the heat, at its limit, cooling left out
        self._heating = [
            box.current_gain**2
            * PHASE_SHARE
            * box.phase_resistance.high
            * max(1.0, 1.0 + box.resistance_coefficient.high * (settings.limit - box.reference_temperature))
            / (box.winding_capacitance.low / 3.0)
            for box in boxes
        ]
        self._advanced = self._cycle = 0.0
        self._budgets = [-math.inf] * len(boxes)
        self.hottest = {role: float(nodes[HOTTEST, k]) for k, role in enumerate(self.roles)}
        self.allowed = dict.fromkeys(self.roles, math.inf)

    def begin(self, now: float) -> None:
        """Time counts from here."""
        self._advanced = self._cycle = now

    def heat(self, index: int, now: float, current: float, asked: float, angle: float, velocity: float) -> None:
        """Take in one cycle of one actuator; what is not a number is taken at its worst.

        Parameters
        ----------
        current, asked : measured and asked for [A].
        angle, velocity : of the rotor [rad], [rad/s].
        """
        heat, elapsed = self._heats[index], now - self._cycle
        if elapsed < 0.0:
            elapsed = math.inf  # a clock that goes backwards leaves no bound
        measured, wanted = abs(current), abs(asked)
        if measured != measured:
            measured = self._settings.most_current
        flowing = measured if measured > wanted else wanted
        square = flowing * flowing
        # a stall of the loop is longer than a cycle: whatever was larger before or after it may have flowed meanwhile
        taken = (square if square > heat.latest else heat.latest) * elapsed
        heat.latest = square
        heat.square += taken
        speed = abs(velocity)
        if speed != speed:
            speed = self._settings.most_speed
            velocity = 0.0
        if speed > heat.speed:
            heat.speed = speed
        if angle != angle:
            angle = heat.angle + velocity * elapsed
        heat.angle = angle
        turned = heat.poles * angle
        heat.aligned_cos += taken * math.cos(turned)
        heat.aligned_sin += taken * math.sin(turned)

    def check(self, now: float) -> str:
        """End a cycle; gives why the bench must stop, and nothing where it may go on."""
        self._cycle = now
        since = now - self._advanced
        if 0.0 <= since < STEP_S:
            for heat, budget in zip(self._heats, self._budgets, strict=True):
                if heat.square + heat.latest * self._settings.reserve_s > budget and since >= SOONEST_S:
                    break
            else:
                return ""
        return self._advance(now, since)

    def _advance(self, now: float, duration: float) -> str:
        squares = [heat.square / duration for heat in self._heats]
        aligned = [
            min(1.0, math.hypot(heat.aligned_cos, heat.aligned_sin) / heat.square) if heat.square > 0.0 else 0.0
            for heat in self._heats
        ]
        speeds = [heat.speed for heat in self._heats]
        self._bound.step(duration, *self._twice(squares, aligned, speeds), self._settings.ambient)
        self._advanced = now
        for heat in self._heats:
            heat.clear()
        return self._judge(speeds)

    def _judge(self, speeds: list[float]) -> str:
        """Look ahead from where the bound stands: trip, scale, and how much heat may pass before the next look."""
        settings, bound = self._settings, self._bound
        hottest = bound.hottest()
        flowing = [heat.latest for heat in self._heats]
        held = self._ahead(flowing, speeds, settings.reserve_s)
        most = self._ahead([settings.most_current**2] * len(self.roles), speeds, HORIZON_S)
        cause = ""
        for k, role in enumerate(self.roles):
            self.hottest[role] = float(hottest[k])
            if not max(hottest[k], held[k]) < settings.limit - MARGIN_K:
                cause = cause or (
                    f"{role} winding: its hottest phase may be at {hottest[k]:.1f} degC, and at {held[k]:.1f} degC"
                    f" {settings.reserve_s:g} s on; the limit is {settings.limit:g} degC"
                )
            self.allowed[role] = math.inf
            if not most[k] < settings.limit - SCALED_K:
                least = self._ahead([0.0] * len(self.roles), speeds, HORIZON_S)[k]
                self.allowed[role] = self._between(least, most[k])
            self._budgets[k] = (settings.limit - MARGIN_K - self.hottest[role]) / self._heating[k]
        return cause

    def _between(self, least: float, most: float) -> float:
        """The current that ends below the limit, where the temperature is no more than a line in its square."""
        room = self._settings.limit - SCALED_K - least
        if not (room > 0.0 and math.isfinite(most)):
            return 0.0
        return self._settings.most_current * math.sqrt(min(1.0, room / (most - least)))

    def _ahead(self, squares: list[float], speeds: list[float], duration: float) -> Array:
        """Hottest phases after some time at these currents, held at one electrical angle."""
        kept = self._bound.state
        standing = [1.0] * len(squares)
        self._bound.step(duration, *self._twice(squares, standing, speeds), self._settings.ambient)
        found = self._bound.hottest()
        self._bound.state = kept
        return found

    @staticmethod
    def _twice(squares: list[float], aligned: list[float], speeds: list[float]) -> tuple[Array, Array, Array]:
        """For the bounds and for the estimates."""
        return np.array(squares + squares), np.array(aligned + aligned), np.array(speeds + speeds)

    def nodes(self) -> dict[str, Array]:
        """Bounds of hottest phase, mean of the phases and housing of each role [degC]."""
        found = self._bound.nodes()
        return {role: found[:, k] for k, role in enumerate(self.roles)}

    def estimates(self) -> dict[str, float]:
        """Estimate of each winding's mean temperature [degC], for display alone."""
        found = self._bound.nodes()[MEAN, len(self.roles) :]
        return {role: float(value) for role, value in zip(self.roles, found, strict=True)}
