"""What no channel shows by itself: a reading that stands still while others move, and two torques that disagree."""

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from leactl.safety.interlocks import Interlocks, TorqueDisagreement
from leactl.safety.watching import Panel, Watch

TEMPERATURE_STUCK_S = 600.0  # a temperature without a word on it: at a thousandth of a kelvin none stands still so long
TURNING_RAD_S = 0.1  # far above the noise of a velocity: below, nothing is said of an angle or a velocity that stands
APART_CYCLES = 3  # that a torque and a current which stand side by side may have been measured apart
NAN = math.nan  # by a name of this module in what runs every cycle
OTHERS_EVERY = 16  # cycles in which others are looked at: that they move at all shows soon enough


class _Still:
    """One channel over one stretch of time: the value that it began with, and what it is held against."""

    def __init__(self, panel: Panel, watch: Watch, stuck_s: float) -> None:
        self.panel, self.watch, self.stuck_s = panel, watch, stuck_s
        self.value, self.began, self.ends = math.nan, -math.inf, -math.inf
        self.stood_at = math.nan  # the angle when it began
        self.others: list[Sequence[float]] = []
        self.alone = True  # so far: no other channel has moved
        place = {other.channel.quantity: other.index for other in panel.watches}
        quantity = watch.channel.quantity
        self.velocity = place.get("velocity") if quantity == "angle" else None
        self.angle = place.get("angle") if quantity == "velocity" else None

    def turns(self, now: float) -> bool | None:
        """Of an angle or a velocity, whether the other of the two tells that the shaft turns; None of any else."""
        values = self.panel.values
        if self.velocity is not None:
            return abs(values[self.velocity]) > TURNING_RAD_S
        if self.angle is not None:
            return abs(values[self.angle] - self.stood_at) > TURNING_RAD_S * (now - self.began)
        return None


class Stuck:
    """Trips on a channel that repeats one value through a whole stretch of its `stuck_s` while any other moves.

    A shaft at rest repeats its angle and its velocity: each of the two is stuck only while the other tells of motion.
    Stretches follow one another, so that it takes between one and two of them; a channel that has moved once costs
    nothing until its next.
    """

    def __init__(self, panels: Sequence[Panel], interlocks: Interlocks) -> None:
        self._panels = panels
        self._channels: list[_Still] = []
        for owner, watch in ((panel, watch) for panel in panels for watch in panel.watches):
            quantity, role = watch.channel.quantity, watch.channel.role
            shortest = min((entry.stuck_s for entry in interlocks.of(quantity, role) if entry.stuck_s), default=None)
            if shortest is None and watch.temperature:
                shortest = TEMPERATURE_STUCK_S
            if shortest is not None:
                self._channels.append(_Still(owner, watch, shortest))
        self._still: list[_Still] = []
        self._next, self._looks = -math.inf, 0
        self.due = -math.inf if self._channels else math.inf

    def look(self, now: float) -> None:
        """Compare; call it in every cycle once `due` has come.

        Raises
        ------
        SafetyTrip : by way of the watch's `trip`.
        """
        self._still = [item for item in self._still if item.panel.values[item.watch.index] == item.value]
        self._looks += 1
        if not self._looks % OTHERS_EVERY:
            self._still = [item for item in self._still if self._is_judged(item, now)]
        if now >= self._next:
            self._turn(now)
        self.due = -math.inf if self._still else self._next

    def _turn(self, now: float) -> None:
        """End the stretches that are over, and begin the next."""
        for item in self._channels:
            if now >= item.ends and item.panel.values:
                if item in self._still and not item.alone:
                    watch = item.watch
                    watch.trip(
                        f"{watch.label} has been exactly {item.value:.6g} {watch.unit} for {item.stuck_s:g} s while"
                        " others moved: stuck"
                    )
                item.value, item.began, item.ends = item.panel.values[item.watch.index], now, now + item.stuck_s
                item.stood_at = math.nan if item.angle is None else item.panel.values[item.angle]
                item.alone = True
                item.others = [tuple(panel.values) for panel in self._panels]
                if item not in self._still:
                    self._still.append(item)
        self._next = min(item.ends for item in self._channels)

    def _is_judged(self, item: _Still, now: float) -> bool:
        """Look at what others do meanwhile; False where the shaft rests, so that this stretch tells nothing."""
        turns = item.turns(now)
        item.alone = item.alone and not (self._others_moved(item) if turns is None else turns)
        return turns is not False

    def _others_moved(self, item: _Still) -> bool:
        for panel, before in zip(self._panels, item.others, strict=True):
            for watch in panel.watches:
                index = watch.index
                if watch is not item.watch and before and abs(panel.values[index] - before[index]) > 0.0:
                    return True  # NaN compares false: what is absent does not move
        return False


class TorqueModel(NamedTuple):
    """What a motor file says of the torque that reaches the shaft, SI."""

    torque_constant: float
    coulomb_friction: float
    viscous_damping: float
    rotor_inertia: float


class TorqueEstimates:
    """Kt i of the test actuator against the torque sensor.

    The sensor sees Kt i less friction and less what accelerates the rotor. Friction at rest has any sign and size up to
    the Coulomb friction, so that its bound is allowed for, and |J acceleration| from the velocities of two cycles. The
    two are not read at the same moment: what Kt i has gone through within `APART_CYCLES` is allowed for too.
    """

    def __init__(
        self, settings: TorqueDisagreement, model: TorqueModel, sensor: tuple[Panel, Watch], drive: Panel
    ) -> None:
        self._settings, self._model = settings, model
        (self._sensor, self._watch), self._drive = sensor, drive
        place = {watch.channel.quantity: watch.index for watch in drive.watches}
        self._current, self._speed, self._torque = place["q_axis_current"], place["velocity"], self._watch.index
        self._torque_constant = model.torque_constant
        self._least = settings.tolerance_Nm + model.coulomb_friction
        self._since = math.nan
        self._velocity, self._at = math.nan, -math.inf
        self._currents: deque[float] = deque(maxlen=APART_CYCLES + 1)

    def look(self, now: float) -> None:
        """Judge the newest sensor reading, which there must be, by the exchange that has just ended.

        Raises
        ------
        SafetyTrip : by way of the watch's `trip`.
        """
        values, least = self._drive.values, self._least
        apart = self._sensor.values[self._torque] - self._torque_constant * values[self._current]
        if -least <= apart <= least:
            self._since = NAN
        else:
            self._look_closer(apart, values[self._current], values[self._speed], now)

    def _look_closer(self, apart: float, current: float, velocity: float, now: float) -> None:
        # from one closer look to the next: at the first the acceleration is unknown, and counts as none for a cycle
        acceleration = (velocity - self._velocity) / (now - self._at) if now > self._at else 0.0
        self._velocity, self._at = velocity, now
        if current == current:
            self._currents.append(current)
        allowed = self._least + self._model.viscous_damping * abs(velocity)
        allowed += self._model.rotor_inertia * abs(acceleration)
        allowed += self._torque_constant * (max(self._currents, default=0.0) - min(self._currents, default=0.0))
        if not abs(apart) > allowed:  # NaN: its age tells
            self._since = math.nan
            return
        if not self._since <= now:
            self._since = now
        if now - self._since >= self._settings.for_s:
            self._watch.trip(
                f"{self._watch.label} is {apart:+.4g} N*m from Kt i at {current:.4g} A for {now - self._since:.3g} s;"
                f" {allowed:.4g} N*m are explained by friction, inertia and the tolerance of"
                f" {self._settings.tolerance_Nm:g} N*m"
            )
