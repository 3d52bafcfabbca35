"""Checks of one channel against others: readings that are stuck, and velocities that contradict the angle."""

import math
from collections.abc import Container, Mapping, Sequence

from leactl.safety.interlocks import Interlocks, VelocityDisagreement
from leactl.safety.thermal.turning import Rotor
from leactl.safety.watching import Panel, Trip, Watch

TEMPERATURE_STUCK_S = 600.0  # for a temperature without `stuck_s`: noise or drift shows in steps below 0.1 degC
# mean speed over a stretch, far above a velocity's offset; a shaft that turns more slowly may repeat a value
TURNING_RAD_S = 0.1
MOST_CYCLES_APART = 3  # between the measurements of a torque and of a current that arrive in one cycle
COMPARISONS_PER_STRETCH = 16  # of a channel with the others; one in each cycle would take more time


class _StillChannel:
    """One channel over one stretch of time: its first value, and the values of other channels to compare."""

    def __init__(self, panel: Panel, watch: Watch, stuck_s: float) -> None:
        self.panel, self.watch, self.stuck_s = panel, watch, stuck_s
        self.first_value, self.began_at, self.ends_at = math.nan, -math.inf, -math.inf
        # rad, position of the shaft and its extremes: for an angle by the velocity, for a velocity by the angle
        self.shaft_angle, self.lowest_angle, self.highest_angle = 0.0, 0.0, 0.0
        self.shaft_updated_at = -math.inf
        self.compared_at, self.next_comparison = -math.inf, -math.inf  # with the other channels
        # s, since when this channel has been NaN while a comparison was due; NaN if it is not
        self.nan_since = math.nan
        self.reference_values: list[list[float]] = []  # for each panel, the first number of each channel in the stretch
        self.others_unchanged = True  # in the stretch so far
        role = watch.channel.role
        indices = {peer.channel.quantity: peer.index for peer in panel.watches if peer.channel.role == role}
        quantity = watch.channel.quantity
        self.velocity_index = indices.get("velocity") if quantity == "angle" else None
        self.angle_index = indices.get("angle") if quantity == "velocity" else None
        self.enabled_index = indices.get("drive_enabled") if quantity == "q_axis_current" else None

    def is_read(self) -> bool:
        """Return whether the latest reading is a number."""
        value = self.panel.values[self.watch.index]
        return value == value

    def is_off(self) -> bool:
        """Return whether this is the current of a drive that is off, which may report 0 without measuring a current."""
        return (
            self.enabled_index is not None and self.first_value == 0.0 and self.panel.values[self.enabled_index] == 0.0
        )

    def begin(self, panels: Sequence[Panel], now: float) -> None:
        """Begin a stretch with the present values of all channels."""
        self.first_value, self.began_at, self.ends_at = self.panel.values[self.watch.index], now, now + self.stuck_s
        self.shaft_updated_at = self.compared_at = now
        self.next_comparison = now + self.stuck_s / COMPARISONS_PER_STRETCH
        self.nan_since = math.nan
        self.shaft_angle = 0.0 if self.angle_index is None else self.panel.values[self.angle_index]
        self.lowest_angle = self.highest_angle = self.shaft_angle
        self.others_unchanged = True
        self.reference_values = [list(panel.values) for panel in panels]

    def update_shaft(self, now: float) -> None:
        """Update the position of the shaft, for an angle by the velocity and for a velocity by the angle.

        A velocity or angle that is NaN leaves the position as it is. The extremes are kept, because a shaft that swings
        comes back to where it began.
        """
        values = self.panel.values
        if self.velocity_index is not None and values[self.velocity_index] == values[self.velocity_index]:
            self.shaft_angle += values[self.velocity_index] * (now - self.shaft_updated_at)
        elif self.angle_index is not None and values[self.angle_index] == values[self.angle_index]:
            self.shaft_angle = values[self.angle_index]
        self.shaft_updated_at = now
        if not self.shaft_angle >= self.lowest_angle:  # also where the first angle was NaN
            self.lowest_angle = self.shaft_angle
        if not self.shaft_angle <= self.highest_angle:
            self.highest_angle = self.shaft_angle

    def is_stuck(self) -> bool:
        """Return whether this channel should have changed.

        It should if another channel has changed. An angle should instead if the velocity shows that the shaft has
        moved, and a velocity if the angle shows it.
        """
        if self.velocity_index is None and self.angle_index is None:
            return not self.others_unchanged
        return self.highest_angle - self.lowest_angle > TURNING_RAD_S * self.stuck_s


class Stuck:
    """Trips if a channel has repeated one value for its `stuck_s` while another channel changed.

    There are exceptions. A shaft at rest repeats its angle and its velocity, so that either of the two trips only if
    the other shows a motion of more than `TURNING_RAD_S` times `stuck_s` in the same time. The current of a drive that
    is off may be exactly 0, and the time for which it is 0 does not count. A sample that is NaN is ignored.

    Time is divided into stretches of `stuck_s` that follow one another: a channel that freezes trips one to two
    stretches later, and a channel that changes is not compared again until its next stretch begins. Only the last
    sample of a block is compared.
    """

    def __init__(self, panels: Sequence[Panel], interlocks: Interlocks) -> None:
        self._panels = panels
        self._channels: list[_StillChannel] = []
        for watching_panel, watch in ((panel, watch) for panel in panels for watch in panel.watches):
            quantity, role = watch.channel.quantity, watch.channel.role
            shortest_stuck_s = min(
                (entry.stuck_s for entry in interlocks.of(quantity, role) if entry.stuck_s), default=None
            )
            if shortest_stuck_s is None and watch.is_temperature:
                shortest_stuck_s = TEMPERATURE_STUCK_S
            if shortest_stuck_s is not None:
                self._channels.append(_StillChannel(watching_panel, watch, shortest_stuck_s))
        self._unchanged: list[_StillChannel] = []
        self._next_stretch_at = -math.inf
        self.due = -math.inf if self._channels else math.inf

    def look(self, now: float) -> None:
        """Compare the channels; to be called in every cycle from the time `due` on.

        Raises
        ------
        SafetyTrip : by way of the watch's `trip`.
        """
        self._unchanged = [
            channel
            for channel in self._unchanged
            if (value := channel.panel.values[channel.watch.index]) == channel.first_value or value != value
        ]
        for channel in self._unchanged:
            if channel.velocity_index is not None or channel.angle_index is not None:
                channel.update_shaft(now)
            elif now >= channel.next_comparison:
                self._compare_others(channel, now)
        if now >= self._next_stretch_at:
            self._begin_stretches(now)
        self.due = -math.inf if self._unchanged else self._next_stretch_at

    def _begin_stretches(self, now: float) -> None:
        """End the stretches that are over, trip on channels that were stuck in them, and begin the next stretches."""
        for channel in self._channels:
            if now >= channel.ends_at and channel.panel.values and channel.is_read():
                if channel in self._unchanged and channel.is_stuck():
                    watch = channel.watch
                    of_operation = " of operation" if channel.ends_at > channel.began_at + channel.stuck_s else ""
                    hint = "; one resolved so coarsely needs a longer stuck_s" if watch.is_temperature else ""
                    watch.trip(
                        f"{watch.label} has been exactly {channel.first_value:.6g} {watch.unit} for"
                        f" {channel.stuck_s:g} s{of_operation} while others moved: stuck{hint}"
                    )
                channel.begin(self._panels, now)
                if channel not in self._unchanged:
                    self._unchanged.append(channel)
        self._next_stretch_at = min(channel.ends_at for channel in self._channels)

    def _compare_others(self, channel: _StillChannel, now: float) -> None:
        """Note whether any other channel has changed; time while the drive is off or this channel NaN does not count.

        Such time lengthens the stretch.
        """
        if not channel.is_read():  # whether the drive is off is not known either
            channel.nan_since = channel.nan_since if channel.nan_since <= now else now
            return
        if channel.nan_since <= now:  # that time counts neither as operation nor as a stretch
            channel.ends_at += now - channel.nan_since
            channel.compared_at += now - channel.nan_since
            channel.nan_since = math.nan
        elapsed, channel.compared_at = now - channel.compared_at, now
        channel.next_comparison = now + channel.stuck_s / COMPARISONS_PER_STRETCH
        if channel.is_off():
            channel.ends_at += elapsed
        elif channel.others_unchanged:
            channel.others_unchanged = not self._others_changed(channel)

    def _others_changed(self, channel: _StillChannel) -> bool:
        """Return whether any other channel differs from its first number in the stretch."""
        for panel, reference in zip(self._panels, channel.reference_values, strict=True):
            for watch in panel.watches:
                index = watch.index
                if watch is channel.watch or not reference:
                    continue
                value = panel.values[index]
                if reference[index] != reference[index]:
                    reference[index] = value
                elif abs(value - reference[index]) > 0.0:  # false for NaN: an absent value is no change
                    return True
        return False


class Velocities:
    """Trips on a velocity that contradicts the angle in the motion that the guard's rotors have measured.

    An angle that changes unevenly from cycle to cycle is no measure of the speed at one moment: the unevenness is added
    to the tolerance. Nothing is judged in angle mode, where a drive goes from one setpoint to the next and rests when
    it is sampled.
    """

    def __init__(self, settings: VelocityDisagreement, rotors: Mapping[str, Rotor], trip: Trip) -> None:
        self._settings, self._rotors, self._trip = settings, rotors, trip
        self._contradicted_s = dict.fromkeys(rotors, 0.0)  # s, for which each velocity has contradicted its angle
        self._advanced = math.nan

    def look(self, advanced: float, judged_roles: Container[str]) -> None:
        """Judge the step of the guard that has ended at the time `advanced` [s], once, for the roles in `judged_roles`.

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
            if motion is None or role not in judged_roles:
                self._contradicted_s[role] = 0.0
                continue
            allowed = settings.tolerance_rad_s + 0.01 * settings.share_percent * motion.speed + motion.unsteadiness
            contradicted_s = self._contradicted_s[role] + step if motion.difference > allowed else 0.0
            self._contradicted_s[role] = contradicted_s
            if contradicted_s >= settings.for_s:
                self._trip(
                    f"{role} velocity is {motion.difference:.3g} rad/s from the change of the angle in the mean of"
                    f" {contradicted_s:.3g} s, at {motion.speed:.3g} rad/s; {allowed:.3g} rad/s are allowed:"
                    " is it noisy, or are the two of different shafts?"
                )
