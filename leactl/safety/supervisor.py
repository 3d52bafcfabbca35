"""The supervisor: every setpoint passes through it to a device, and it judges every sample that is recorded.

It holds the only references to the drives and supplies that the runner may command. A trip latches; at every end all
devices are brought to their safe state in a fixed order, and each confirms it or not.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, NoReturn

from leactl.driver import safe_state
from leactl.driver.clock import Clock
from leactl.driver.contract import Confirmation, Driver, Mode, MotionDevice, Row, SampleBlock
from leactl.errors import SafetyTrip
from leactl.quantities import ChannelSpec
from leactl.safety.angle_path import AnglePath
from leactl.safety.cross_checks import Stuck, Velocities
from leactl.safety.current_tracking import CurrentTracking, VoltageNeed
from leactl.safety.disk import Disk
from leactl.safety.interlocks import Interlocks
from leactl.safety.limits import CYCLES_OF_SILENCE, Limits
from leactl.safety.pace import Pace
from leactl.safety.supplies import Supplies
from leactl.safety.thermal.guard import ThermalGuard
from leactl.safety.thermal.measured import Leads, MeasuredStreams
from leactl.safety.watching import UNLIMITED, Panel
from leactl.safety.witnesses import Account, ByTorque, ByVoltage, TorqueModel, Witnesses

CURRENT_REFERENCE = "q_axis_current_reference"
STALL_CYCLES = 2.5  # the loop has stalled if at least as many periods pass between two checks
SETPOINT_QUANTITY = {
    Mode.CURRENT: CURRENT_REFERENCE,
    Mode.TORQUE_PROFILE: CURRENT_REFERENCE,
    Mode.VELOCITY: "velocity_reference",
    Mode.ANGLE: "angle_reference",
}
DEFAULTS = Interlocks()
NAN = math.nan  # code that runs in every cycle looks a name of this module up faster than an attribute of `math`
NOTHING_PASSES = (NAN, NAN)


class Axis(NamedTuple):
    """A drive under supervision: the device as a driver and as a motion device."""

    driver: Driver
    motion: MotionDevice


@dataclass(slots=True)
class _SupervisedDrive:
    """A drive with the state of its supervision."""

    axis: Axis
    panel: Panel
    current_index: int  # index of the q-axis current among the values
    direct_current_index: int | None  # index of the d-axis current, if the drive measures it
    velocity_index: int | None
    angle_index: int | None
    tracking: CurrentTracking
    quantity: str = "setpoint"  # of the engaged mode
    bounds: tuple[float, float] = UNLIMITED
    sets_current: bool = False  # whether the engaged mode sets a current
    demand: float = 0.0  # A, of a current reference
    demand_square: float = 0.0  # A^2, of a current reference, which heats
    previous_square: float = 0.0  # A^2, `demand_square` at the previous exchange, to which the present reading belongs
    is_scaled: bool = False  # whether the last setpoint was more than the winding may carry
    path: AnglePath | None = None  # in angle mode alone

    def turn_to(self, mode: Mode, limits: Limits, now: float) -> None:
        """Begin supervision of this mode: take the limits of its setpoints, and forget the last demand."""
        quantity = SETPOINT_QUANTITY.get(mode)
        self.quantity, self.sets_current = quantity or "setpoint", quantity == CURRENT_REFERENCE
        self.demand, self.demand_square, self.path = 0.0, 0.0, None
        self.tracking.turn_to(mode in (Mode.CURRENT, Mode.OFF))  # only the drive knows the ramp of a profile
        if mode is Mode.ANGLE:
            self.bounds = limits.of("angle_reference") or UNLIMITED  # the path bounds each step
            self.path = AnglePath(self.measured_angle, now)
        else:
            self.bounds = (limits.of(quantity) or NOTHING_PASSES) if quantity else UNLIMITED

    @property
    def indices(self) -> tuple[int, int | None, int | None, int | None]:
        """Indices of q-axis current, d-axis current, angle and velocity among the values."""
        return self.current_index, self.direct_current_index, self.angle_index, self.velocity_index

    @property
    def measured_angle(self) -> float:
        """Angle of the last exchange [rad]; NaN if the drive measures none or the reading did not come."""
        return math.nan if self.angle_index is None else self.axis.motion.values[self.angle_index]


class Supervisor:
    """Passes setpoints on within limits, judges samples, trips, latches, and makes all devices safe at the end."""

    def __init__(
        self,
        limits: Limits,
        axes: Mapping[str, Axis],
        others: Sequence[Driver],
        clock: Clock,
        guard: ThermalGuard,
        interlocks: Interlocks = DEFAULTS,
        torque_models: Mapping[str, TorqueModel] | None = None,
        voltage_needs: Mapping[str, VoltageNeed] | None = None,
    ) -> None:
        """Supervise the drives `axes`, by role, and the devices `others`; `guard` uses the same roles.

        The current of a role without a torque model is not compared with the torque sensor, as nothing couples the two.
        Without voltage needs the bus counts as able to drive every current, and no current is compared with a voltage.
        """
        self._limits, self._interlocks, self._clock, self._others = limits, interlocks, clock, list(others)
        self._thermal, self._largest_square = guard, limits.current_A**2
        self._period = 0.0
        self.tripped: str = ""
        self.warnings: list[str] = []
        self._voltage_needs = voltage_needs or {}
        now = clock.now()
        self._axes = {role: self._supervise(role, axis, now) for role, axis in axes.items()}
        streams = [
            stream for device in (*[axis.driver for axis in axes.values()], *others) for stream in device.streams
        ]
        self._panels = {stream.name: self._panel(stream.channels, limits.age_s, now) for stream in streams}
        self._unending_panels = [self._panels[stream.name] for stream in streams if not stream.ends]
        leads = Leads(guard)
        self._measured = MeasuredStreams(guard, streams, self.trip, leads)
        self.supplies = Supplies(others, limits, guard, leads, self.refuse_latched, self.trip)
        self._heating_streams = self._measured.streams | self.supplies.streams
        guard.undriven = frozenset(index for index, role in enumerate(guard.roles) if role not in self._axes)
        panels = [*[drive.panel for drive in self._axes.values()], *self._panels.values()]
        self._stuck = Stuck(panels, interlocks)
        self._velocities = self._velocity_check()
        self._pace = Pace(interlocks.loop_overruns, interlocks.clock, self.trip, now)
        self._disk = Disk(interlocks.disk_space, self.trip, self.warnings.append)
        self._witnesses = [*self._torque_witnesses(torque_models or {}), *self._voltage_witnesses()]
        self._next_due = self._ages_due = -math.inf
        # gathered once: `check` runs in every cycle
        self._witnessed = [witnesses.log_with_sources for witnesses in self._witnesses]
        self._exchanged = [
            (index, drive, drive.tracking, drive.axis.motion, *drive.indices, drive.panel.look, guard.logs[index])
            for role, drive in self._axes.items()
            for index in [guard.roles.index(role)]
        ]
        guard.begin(now)
        self._heating = guard.flowing, math.inf
        self.windings = guard.estimate, guard.hottest  # degC by role, kept up to date
        self.time_left, self.winding_limit = guard.time_left, guard.limit

    def _panel(self, channels: Sequence[ChannelSpec], age: float, now: float) -> Panel:
        """Return a panel of channels that may be `age` [s] old, counted from now."""
        panel = Panel(channels, self._limits, self._interlocks, self.trip, self.warnings.append)
        panel.begin(now, age)
        return panel

    def _supervise(self, role: str, axis: Axis, now: float) -> _SupervisedDrive:
        """Return a drive with the state of its supervision at the start."""
        channels = axis.motion.loop_channels
        indices = {channel.quantity: index for index, channel in enumerate(channels)}
        panel = self._panel(channels, self._limits.cyclic_age(0.0), now)
        voltage_need = self._voltage_needs.get(role, VoltageNeed())
        settings = self._interlocks.current_disagreement
        tracking = CurrentTracking(role, axis.motion, settings, self._limits, voltage_need, self.trip)
        tracking.turn_to(judges=True)
        direct_current_index, velocity_index, angle_index = (
            indices.get(name) for name in ("d_axis_current", "velocity", "angle")
        )
        return _SupervisedDrive(
            axis, panel, indices["q_axis_current"], direct_current_index, velocity_index, angle_index, tracking
        )

    def _torque_witnesses(self, models: Mapping[str, TorqueModel]) -> list[Witnesses]:
        """Return the comparison of currents with the torque sensor in a list, or an empty list if none is possible."""
        settings = self._interlocks.torque_disagreement
        if settings is None or not models:
            return []
        for panel in self._panels.values():
            for watch in panel.watches:
                if (watch.channel.quantity, watch.channel.role) == ("torque", "test"):
                    panel.values = panel.values or [math.nan] * len(panel.watches)  # until the first reading
                    senses = {role: 1.0 if role == "test" else -1.0 for role in models}
                    drive_accounts = [
                        self._account(role, ByTorque(settings, models[role], senses[role])) for role in models
                    ]
                    accounts = [account for account in drive_accounts if account is not None]
                    return [Witnesses(settings.for_s, panel, watch.index, accounts, self.trip)] if accounts else []
        return []

    def _voltage_witnesses(self) -> list[Witnesses]:
        """Return a comparison of current and winding voltage for each drive that reports the voltage."""
        settings = self._interlocks.voltage_disagreement
        if settings is None:
            return []
        witnesses = []
        for role, drive in self._axes.items():
            for watch in drive.panel.watches:
                if watch.channel.quantity == "q_axis_voltage" and role in self._voltage_needs:
                    constant = self._voltage_needs[role].back_emf_constant
                    by_voltage = ByVoltage(watch.label, settings, constant, partial(self._thermal.resistances, role))
                    account = self._account(role, by_voltage)
                    if account is not None:
                        witnesses.append(Witnesses(settings.for_s, drive.panel, watch.index, [account], self.trip))
        return witnesses

    def _velocity_check(self) -> Velocities | None:
        """Return the comparison of velocities with angles, or None if no interlock asks for it."""
        settings, guard = self._interlocks.velocity_disagreement, self._thermal
        rotors = {role: rotor for role, rotor in zip(guard.roles, guard.rotors, strict=True) if role in self._axes}
        return None if settings is None else Velocities(settings, rotors, self.trip)

    def _account(self, role: str, witness: ByTorque | ByVoltage) -> Account | None:
        """Return the account of a role's current, or None if the role has no drive that reports its velocity."""
        drive = self._axes.get(role)
        if drive is None or drive.velocity_index is None:
            return None
        return Account(f"{role} q_axis_current", witness, drive.panel, drive.current_index, drive.velocity_index)

    def begin(self, period: float) -> None:
        """Begin with cycles of `period` [s].

        Ages of readings count from now: opening devices and making a file may have taken any time.
        """
        now, self._period = self._clock.now(), period
        guard = self._thermal
        guard.begin(now)
        self._heating = guard.flowing, STALL_CYCLES * period
        for drive in self._axes.values():
            drive.panel.begin(now, self._limits.cyclic_age(period))
        for panel in self._panels.values():
            panel.begin(now, self._limits.age_s)
        self._pace.begin(period, now)
        for witnesses in self._witnesses:
            witnesses.begin(period, now)
        self._next_due = self._ages_due = -math.inf

    # -- commands ----------------------------------------------------------------------------------------------------

    def refuse_latched(self) -> None:
        """Raise if a trip is latched.

        Raises
        ------
        SafetyTrip : a trip is latched.
        """
        if self.tripped:
            raise SafetyTrip(self.tripped)

    def engage(self, role: str, mode: Mode) -> None:
        """Let a drive enter operation with zero demand.

        Raises
        ------
        SafetyTrip : a trip is latched.
        """
        self.refuse_latched()
        drive = self._axes[role]
        drive.axis.motion.engage(mode)  # if the drive refuses, the limits stay as they are
        drive.turn_to(mode, self._limits, self._clock.now())

    def release(self, role: str) -> None:
        """Let a drive leave operation; always allowed."""
        drive = self._axes[role]
        drive.turn_to(Mode.OFF, self._limits, self._clock.now())
        drive.axis.motion.release()

    def engaged(self, role: str) -> bool:
        """Return whether the drive itself reports that it follows its setpoint."""
        return self._axes[role].axis.motion.engaged

    def scales(self, role: str) -> bool:
        """Return whether the winding may not carry all of the current that was commanded last."""
        return self._axes[role].is_scaled

    def command(self, role: str, value: float) -> None:
        """Pass a setpoint on to the drive of a role, in the unit of the engaged mode.

        Raises
        ------
        SafetyTrip : a trip is latched, or the setpoint is outside the limits, or an angle is further from the previous
            setpoint than the shaft may turn in the time between; nothing is passed on.
        """
        if self.tripped:
            raise SafetyTrip(self.tripped)
        drive = self._axes[role]
        low, high = drive.bounds
        if not low <= value <= high:
            self.trip(f"{role} {drive.quantity} of {value:g} is outside the limits {drive.bounds}")
        if drive.sets_current:
            allowed = self._thermal.allowed[role]
            if not -allowed <= value <= allowed:
                value = self._scale(role, drive, value, allowed)
            elif drive.is_scaled:
                drive.is_scaled = False
            if value != drive.demand:
                drive.tracking.ask(value)
            drive.demand, drive.demand_square = value, value * value
        if drive.path is not None:
            self._judge_angle(role, drive.path, value)
        drive.axis.motion.command(value)

    def _scale(self, role: str, drive: _SupervisedDrive, value: float, allowed: float) -> float:
        """Return the part of a current [A] that the winding may carry; warn once as scaling begins."""
        if not drive.is_scaled:
            drive.is_scaled = True
            self.warnings.append(
                f"{role} current of {value:g} A is scaled down, to {allowed:.1f} A at first: the hottest phase"
                f" may be at {self._thermal.hottest[role]:.1f} degC"
            )
        return math.copysign(allowed, value)

    def _judge_angle(self, role: str, path: AnglePath, value: float) -> None:
        """Trip on an angle setpoint [rad] further away than the shaft may turn, else note it for the next exchange."""
        if math.isnan(path.base_angle):
            self.trip(f"{role} angle_reference of {value:g} rad while the shaft's angle is not known")
        now, period = self._clock.now(), self._period
        # a segment may end half a cycle late; after a stall the shaft must not be sent as far as without the stall
        elapsed = min(max(now - path.base_time, period), CYCLES_OF_SILENCE * period) + 0.5 * period
        limit = self._limits.velocity_rad_s
        reach = max(limit * elapsed, self._limits.angle_leap_rad or 0.0)
        if not abs(value - path.base_angle) <= reach * (1 + 1e-9):
            self.trip(
                f"{role} angle_reference of {value:g} rad is {abs(value - path.base_angle):.4g} rad"
                f" from {path.base_angle:.4g} rad;"
                f" {limit * elapsed:.4g} rad can be reached in a cycle at the velocity limit of {limit:g} rad/s,"
                f" and angle_leap_rad is {self._limits.angle_leap_rad or 'not given'}"
            )
        path.ask(value, now)

    # -- samples -----------------------------------------------------------------------------------------------------

    def check(self, now: float) -> None:
        """Judge the exchange that has just ended.

        Raises
        ------
        SafetyTrip : a value is outside its limits, a channel is too old, or a winding may become too hot.
        """
        if self.tripped:
            raise SafetyTrip(self.tripped)
        pace = self._pace
        elapsed = now - pace.previous_check
        if elapsed >= 0.0 and now <= pace.check_deadline:
            pace.previous_check = now
            pace.check_deadline += pace.period
        else:
            pace.judge_late(now)
        flowing, shortest_stall = self._heating
        is_on_time = elapsed < shortest_stall
        for (
            index,
            drive,
            tracking,
            motion,
            current_index,
            direct_current_index,
            angle_index,
            velocity_index,
            look,
            log,
        ) in self._exchanged:
            values = motion.values
            look(values, now)
            if drive.path is not None:
                drive.path.update(drive.measured_angle, motion.engaged, now)
            current = values[current_index]
            if tracking.low <= current and current <= tracking.high:
                tracking.since = NAN
            else:
                speed = NAN if velocity_index is None else values[velocity_index]
                tracking.look(current, speed, now)
            square, demand_square = current * current, drive.demand_square
            if direct_current_index is not None:
                square += values[direct_current_index] ** 2  # the d-axis current makes no torque, but as much heat
            if not square >= drive.previous_square:  # a reading that is NaN counts as the largest current
                square = drive.previous_square if square == square else self._largest_square
            # during a stall the current that flowed before it may have continued
            heat = (square if is_on_time or square > flowing[index] else flowing[index]) * elapsed
            log += (
                elapsed,
                heat,
                NAN if angle_index is None else values[angle_index],
                NAN if velocity_index is None else values[velocity_index],
            )
            drive.previous_square = demand_square
            flowing[index] = square if square > demand_square else demand_square
        for (
            witness_log,
            evidence,
            index,
            first_panel,
            velocity_index,
            first_index,
            second_panel,
            second_index,
        ) in self._witnessed:
            readings = first_panel.values
            witness_log.append(
                (
                    evidence.values[index],
                    readings[velocity_index],
                    readings[first_index],
                    second_panel.values[second_index],
                )
            )
        if now >= self._next_due:
            self._check_what_is_due(now)

    def _check_what_is_due(self, now: float) -> None:
        """Judge what is not due in every cycle: windings, ages of device streams, stuck channels, second sensors."""
        guard = self._thermal
        if now >= guard.due:
            too_hot = guard.check(now)
            if too_hot:
                self.trip(too_hot)
            if self._velocities is not None:
                in_angle_mode = any(drive.path is not None for drive in self._axes.values())
                self._velocities.look(guard.advanced, () if in_angle_mode else self._axes)
        if now >= self._ages_due:
            self._ages_due = min((panel.check_age(now) for panel in self._unending_panels), default=math.inf)
        if now >= self._stuck.due:
            self._stuck.look(now)
        due = min(guard.due, self._ages_due, self._stuck.due)
        for witnesses in self._witnesses:
            witnesses.look(now)
            due = min(due, witnesses.due)
        self._next_due = due

    def receive(self, row: Row | SampleBlock) -> None:
        """Judge a sample, or a block of samples, of a device that samples by its own clock.

        Raises
        ------
        SafetyTrip : the value is outside its limits, or the device names a fault such as saturation.
        """
        if self.tripped:
            raise SafetyTrip(self.tripped)
        if isinstance(row, SampleBlock):
            self._panels[row.stream].look_through(row)
            self._measured.look_through(row)
            return
        stream, time, values, fault = row  # one unpacking takes as long as one access by name
        if fault:
            self.trip(fault)
        self._panels[stream].look(values, time)
        if stream in self._heating_streams:
            self._measured.look(row)
            self.supplies.look(row)

    def free_space(self, free_bytes: float) -> None:
        """Judge the free space on the disk of the recording [bytes].

        Raises
        ------
        SafetyTrip : less space is free than the interlocks require.
        """
        self._disk.look(free_bytes)

    def take_warnings(self) -> list[str]:
        """Return the warnings since the last call, one line each, and clear them."""
        warnings = list(self.warnings)
        self.warnings.clear()
        return warnings

    def trip(self, cause: str) -> NoReturn:
        """Latch a trip and end the run; the first cause stays.

        Raises
        ------
        SafetyTrip : always.
        """
        self.latch(cause)
        raise SafetyTrip(self.tripped)

    def latch(self, cause: str) -> None:
        """Latch a trip: refuse all commands from now on, release every drive, and switch off every supply at leads."""
        self.tripped = self.tripped or cause or "the run has ended"
        for drive in self._axes.values():
            with suppress(
                Exception
            ):  # a driver that fails here is made safe by `make_safe` later, and must hide no trip
                drive.axis.motion.release()
        self.supplies.cut()

    # -- the end -----------------------------------------------------------------------------------------------------

    def make_safe(self) -> dict[str, Confirmation]:
        """Bring every device to its safe state: test drive, load drive, then the other devices; never raise.

        Return the confirmation of each device by its name.
        """
        drives = [self._axes[role].axis.driver for role in ("test", "load") if role in self._axes]
        confirmations = safe_state.make_safe((*drives, *self._others))
        with suppress(Exception):  # the bounds that the next run starts from lack the last heat so far
            self._thermal.end(self._clock.now())
        return confirmations
