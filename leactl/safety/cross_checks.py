"""Checks of one channel against others: readings that are stuck, and velocities that contradict the angle."""

import math
from collections.abc import Container, Mapping, Sequence

from leactl.safety.interlocks import Interlocks, VelocityDisagreement
from leactl.safety.thermal.turning import Rotor
from leactl.safety.watching import Panel, Trip, Watch

TEMPERATURE_STUCK_S = 600.0  # for a temperature without `stuck_s`: noise or drift shows in steps below 0.1 degC
TURNING_RAD_S = 0.1  # mean speed over a stretch, far above a velocity's offset; below, a repeated value is no fault
MOST_CYCLES_APART = 3  # between the measurements of a torque and of a current that arrive in one cycle
COMPARISONS_PER_STRETCH = 16  # of a channel with the others; one in each cycle would cost more


class _StillChannel:
    """One channel over one stretch of time: its first value, and the values of other channels to compare."""

    def __init__(self, panel: Panel, watch: Watch, stuck_s: float) -> None:
        self.panel, self.watch, self.stuck_s = panel, watch, stuck_s
        self.value, self.began, self.ends = math.nan, -math.inf, -math.inf
        # rad, for an angle or a velocity: position of the shaft and its extremes, by the other of the two
        self.shaft_angle, self.lowest_angle, self.highest_angle = 0.0, 0.0, 0.0
        self.shaft_updated_at = -math.inf
        self.compared_at, self.next_comparison = -math.inf, -math.inf  # with the other channels
        self.nan_since = math.nan  # since when this channel has been NaN while a comparison was due; NaN: it is not
        self.reference_values: list[list[float]] = []  # for each panel, the first number of each channel in the stretch
        self.others_unchanged = True  # in the stretch so far
        role = watch.channel.role
        indices = {peer.channel.quantity: peer.index for peer in panel.watches if peer.channel.role == role}
        quantity = watch.channel.quantity
        self.velocity = indices.get("velocity") if quantity == "angle" else None
        self.angle = indices.get("angle") if quantity == "velocity" else None
        self.enabled = indices.get("drive_enabled") if quantity == "q_axis_current" else None

    def is_read(self) -> bool:
        """Return whether the latest reading is a number."""
        value = self.panel.values[self.watch.index]
        return value == value

    def is_off(self) -> bool:
        """Return whether this is the current of a drive that is off, which may report 0 without measuring a current."""
        return self.enabled is not None and self.value == 0.0 and self.panel.values[self.enabled] == 0.0

    def begin(self, panels: Sequence[Panel], now: float) -> None:
        """Begin a stretch with the present values of all channels."""
        self.value, self.began, self.ends = self.panel.values[self.watch.index], now, now + self.stuck_s
        self.shaft_updated_at = self.compared_at = now
        self.next_comparison = now + self.stuck_s / COMPARISONS_PER_STRETCH
        self.nan_since = math.nan
        self.shaft_angle = 0.0 if self.angle is None else self.panel.values[self.angle]
        self.lowest_angle = self.highest_angle = self.shaft_angle
        self.others_unchanged = True
        self.reference_values = [list(panel.values) for panel in panels]

    def update_shaft(self, now: float) -> None:
        """Update the position of the shaft, for an angle by the velocity and for a velocity by the angle.

        A velocity or angle that is NaN leaves the position as it is. The extremes count: a shaft that swings comes back
        to where it began, and stands still at each end.
        """
        values = self.panel.values
        if self.velocity is not None and values[self.velocity] == values[self.velocity]:
            self.shaft_angle += values[self.velocity] * (now - self.shaft_updated_at)
        elif self.angle is not None and values[self.angle] == values[self.angle]:
            self.shaft_angle = values[self.angle]
        self.shaft_updated_at = now
        if not self.shaft_angle >= self.lowest_angle:  # also where the first angle was NaN
            self.lowest_angle = self.shaft_angle
        if not self.shaft_angle <= self.highest_angle:
            self.highest_angle = self.shaft_angle

    def is_stuck(self) -> bool:
        """Return whether this channel should have changed.

        That is the case if another channel has changed; for an angle or a velocity, if the other of the two shows that
        the shaft has moved.
        """
        if self.velocity is None and self.angle is None:
            return not self.others_unchanged
        return self.highest_angle - self.lowest_angle > TURNING_RAD_S * self.stuck_s


class Stuck:
    """Trips if a channel has repeated one value for its `stuck_s` while another channel changed.

    Exceptions: A shaft at rest repeats its angle and its velocity, so that either of the two trips only if the other
    shows a motion of more than `TURNING_RAD_S` times `stuck_s` in the same time. The current of a drive that is off may
    be exactly 0, and the time for which it is does not count. A sample that is NaN is ignored.

    Time is divided into stretches of `stuck_s` that follow one another: a channel that freezes trips one to two
    stretches later, and a channel that changes is not compared again until its next stretch begins. Of a block of
    samples, the last one is compared.
    """

    def __init__(self, panels: Sequence[Panel], interlocks: Interlocks) -> None:
        self._panels = panels
        self._channels: list[_StillChannel] = []
        for owner, watch in ((panel, watch) for panel in panels for watch in panel.watches):
            quantity, role = watch.channel.quantity, watch.channel.role
            shortest = min((entry.stuck_s for entry in interlocks.of(quantity, role) if entry.stuck_s), default=None)
            if shortest is None and watch.temperature:
                shortest = TEMPERATURE_STUCK_S
            if shortest is not None:
                self._channels.append(_StillChannel(owner, watch, shortest))
        self._still: list[_StillChannel] = []
        self._next = -math.inf
        self.due = -math.inf if self._channels else math.inf

    def look(self, now: float) -> None:
        """Compare the channels; call it in every cycle once `due` has come.

        Raises
        ------
        SafetyTrip : by way of the watch's `trip`.
        """
        self._still = [
            item
            for item in self._still
            if (value := item.panel.values[item.watch.index]) == item.value or value != value
        ]
        for item in self._still:
            if item.velocity is not None or item.angle is not None:
                item.update_shaft(now)
            elif now >= item.next_comparison:
                self._compare_others(item, now)
        if now >= self._next:
            self._begin_stretches(now)
        self.due = -math.inf if self._still else self._next

    def _begin_stretches(self, now: float) -> None:
        """End the stretches that are over, and begin the next."""
        for item in self._channels:
            if now >= item.ends and item.panel.values and item.is_read():
                if item in self._still and item.is_stuck():
                    watch = item.watch
                    operating = " of operation" if item.ends > item.began + item.stuck_s else ""
                    hint = "; one resolved so coarsely needs a longer stuck_s" if watch.temperature else ""
                    watch.trip(
                        f"{watch.label} has been exactly {item.value:.6g} {watch.unit} for {item.stuck_s:g} s"
                        f"{operating} while others moved: stuck{hint}"
                    )
                item.begin(self._panels, now)
                if item not in self._still:
                    self._still.append(item)
        self._next = min(item.ends for item in self._channels)

    def _compare_others(self, item: _StillChannel, now: float) -> None:
        """Compare the other channels; time for which the drive is off or the channel NaN lengthens the stretch."""
        if not item.is_read():  # it is not known either whether a drive is off
            item.nan_since = item.nan_since if item.nan_since <= now else now
            return
        if item.nan_since <= now:  # that time counts neither as operation nor as a stretch
            item.ends += now - item.nan_since
            item.compared_at += now - item.nan_since
            item.nan_since = math.nan
        since, item.compared_at = now - item.compared_at, now
        item.next_comparison = now + item.stuck_s / COMPARISONS_PER_STRETCH
        if item.is_off():
            item.ends += since
        elif item.others_unchanged:
            item.others_unchanged = not self._others_changed(item)

    def _others_changed(self, item: _StillChannel) -> bool:
        """Return whether any other channel differs from its first number in the stretch."""
        for panel, before in zip(self._panels, item.reference_values, strict=True):
            for watch in panel.watches:
                index = watch.index
                if watch is item.watch or not before:
                    continue
                value = panel.values[index]
                if before[index] != before[index]:
                    before[index] = value
                elif abs(value - before[index]) > 0.0:  # NaN compares false: what is absent does not move
                    return True
        return False


class Velocities:
    """Trips on a velocity that contradicts the angle, by the motion that the guard's rotors have measured.

    An angle that changes unevenly from cycle to cycle is no measure of the speed at one moment: the unevenness is added
    to the tolerance. Nothing is judged in angle mode, where a drive goes from one setpoint to the next and rests when
    it is sampled.
    """

    def __init__(self, settings: VelocityDisagreement, rotors: Mapping[str, Rotor], trip: Trip) -> None:
        self._settings, self._rotors, self._trip = settings, rotors, trip
        self._contradicted_s = dict.fromkeys(rotors, 0.0)  # s, for which each velocity has contradicted its angle
        self._advanced = math.nan

    def look(self, advanced: float, judged: Container[str]) -> None:
        """Judge the step of the guard that has ended at the time `advanced`, once, for the roles in `judged`.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        step, self._advanced = advanced - self._advanced, advanced
        if not step > 0.0:
            return
        settings = self._settings
        for role, rotor in self._rotors.items():
            motion = rotor.motion
            if motion is None or role not in judged:
                self._contradicted_s[role] = 0.0
                continue
            allowed = settings.tolerance_rad_s + 0.01 * settings.share_percent * motion.speed + motion.unsteady
            contradicted_s = self._contradicted_s[role] + step if motion.difference > allowed else 0.0
            self._contradicted_s[role] = contradicted_s
            if contradicted_s >= settings.for_s:
                self._trip(
                    f"{role} velocity is {motion.difference:.3g} rad/s from the change of the angle in the mean of"
                    f" {contradicted_s:.3g} s, at {motion.speed:.3g} rad/s; {allowed:.3g} rad/s are allowed:"
                    " is it noisy, or are the two of different shafts?"
                )
