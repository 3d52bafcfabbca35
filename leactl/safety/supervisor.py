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
STALL_CYCLES = 2.5  # periods between two checks, from which on the loop has stalled
SETPOINT_QUANTITY = {
    Mode.CURRENT: CURRENT_REFERENCE,
    Mode.TORQUE_PROFILE: CURRENT_REFERENCE,
    Mode.VELOCITY: "velocity_reference",
    Mode.ANGLE: "angle_reference",
}
DEFAULTS = Interlocks()
NAN = math.nan  # a name of this module is faster in code that runs every cycle
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
    current: int  # index of the q-axis current among the values
    direct: int | None  # index of the d-axis current, if the drive measures it
    velocity: int | None
    angle: int | None
    tracking: CurrentTracking
    quantity: str = "setpoint"  # of the engaged mode
    bounds: tuple[float, float] = UNLIMITED
    heats: bool = False  # whether the engaged mode sets a current
    demand: float = 0.0  # A, of a current reference
    demand_square: float = 0.0  # A^2, of a current reference, which heats
    previous_square: float = 0.0  # A^2, the same at the exchange before, to which the present reading belongs
    scaled: bool = False  # whether the last setpoint was more than the winding may carry
    path: AnglePath | None = None  # in angle mode alone

    def turn_to(self, mode: Mode, limits: Limits, now: float) -> None:
        """Take the limits of the setpoints of this mode."""
        quantity = SETPOINT_QUANTITY.get(mode)
        self.quantity, self.heats = quantity or "setpoint", quantity == CURRENT_REFERENCE
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
        return self.current, self.direct, self.angle, self.velocity

    @property
    def measured_angle(self) -> float:
        """The angle of the last exchange; NaN where none came."""
        return math.nan if self.angle is None else self.axis.motion.values[self.angle]


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

        A role without a torque model is not compared with the torque sensor: nothing couples the two. Without voltage
        needs the bus counts as able to drive every current, and no current is compared with a voltage.
        """
        self._limits, self._interlocks, self._clock, self._others = limits, interlocks, clock, list(others)
        self._thermal, self._worst = guard, limits.current_A**2
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
        self._lasting = [self._panels[stream.name] for stream in streams if not stream.ends]
        leads = Leads(guard)
        self._measured = MeasuredStreams(guard, streams, self.trip, leads)
        self.supplies = Supplies(others, limits, guard, leads, self.refuse_latched, self.trip)
        self._heating_streams = self._measured.streams | self.supplies.streams
        guard.undriven = frozenset(index for index, role in enumerate(guard.roles) if role not in self._axes)
        panels = [*[drive.panel for drive in self._axes.values()], *self._panels.values()]
        self._stuck = Stuck(panels, interlocks)
        self._velocities = self._by_angle()
        self._pace = Pace(interlocks.loop_overruns, interlocks.clock, self.trip, now)
        self._disk = Disk(interlocks.disk_space, self.trip, self.warnings.append)
        self._witnesses = [*self._by_torque(torque_models or {}), *self._by_voltage()]
        self._due = self._ages_due = -math.inf
        # gathered once: `check` runs in every cycle
        self._witnessed = [witnesses.log_with_sources for witnesses in self._witnesses]
        self._judged = [
            (index, item, item.tracking, item.axis.motion, *item.indices, item.panel.look, guard.logs[index])
            for role, item in self._axes.items()
            for index in [guard.roles.index(role)]
        ]
        guard.begin(now)
        self._heating = guard.flowing, math.inf
        self.windings = guard.estimate, guard.hottest  # degC by role, kept up to date
        self.time_left, self.winding_limit = guard.time_left, guard.limit

    def _panel(self, channels: Sequence[ChannelSpec], age: float, now: float) -> Panel:
        panel = Panel(channels, self._limits, self._interlocks, self.trip, self.warnings.append)
        panel.begin(now, age)
        return panel

    def _supervise(self, role: str, axis: Axis, now: float) -> _SupervisedDrive:
        """Return a drive with the state of its supervision at the start."""
        channels = axis.motion.loop_channels
        indices = {channel.quantity: index for index, channel in enumerate(channels)}
        panel = self._panel(channels, self._limits.cyclic_age(0.0), now)
        need = self._voltage_needs.get(role, VoltageNeed())
        settings = self._interlocks.current_disagreement
        tracking = CurrentTracking(role, axis.motion, settings, self._limits, need, self.trip)
        tracking.turn_to(judges=True)
        direct, velocity, angle = (indices.get(name) for name in ("d_axis_current", "velocity", "angle"))
        return _SupervisedDrive(axis, panel, indices["q_axis_current"], direct, velocity, angle, tracking)

    def _by_torque(self, models: Mapping[str, TorqueModel]) -> list[Witnesses]:
        """Return the comparison of currents with the torque sensor, in a list that is empty without one."""
        settings = self._interlocks.torque_disagreement
        if settings is None or not models:
            return []
        for panel in self._panels.values():
            for watch in panel.watches:
                if (watch.channel.quantity, watch.channel.role) == ("torque", "test"):
                    panel.values = panel.values or [math.nan] * len(panel.watches)  # until the first reading
                    senses = {role: 1.0 if role == "test" else -1.0 for role in models}
                    drives = [self._account(role, ByTorque(settings, models[role], senses[role])) for role in models]
                    accounts = [account for account in drives if account is not None]
                    return [Witnesses(settings.for_s, panel, watch.index, accounts, self.trip)] if accounts else []
        return []

    def _by_voltage(self) -> list[Witnesses]:
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

    def _by_angle(self) -> Velocities | None:
        """Return the comparison of velocities with angles, or None where no interlock asks for it."""
        settings, guard = self._interlocks.velocity_disagreement, self._thermal
        rotors = {role: rotor for role, rotor in zip(guard.roles, guard.rotors, strict=True) if role in self._axes}
        return None if settings is None else Velocities(settings, rotors, self.trip)

    def _account(self, role: str, witness: ByTorque | ByVoltage) -> Account | None:
        """Return the account of a role's current, or None without a drive that reports its velocity."""
        drive = self._axes.get(role)
        if drive is None or drive.velocity is None:
            return None
        return Account(f"{role} q_axis_current", witness, drive.panel, drive.current, drive.velocity)

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
        self._due = self._ages_due = -math.inf

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
        """True once the drive itself reports that it follows its setpoint."""
        return self._axes[role].axis.motion.engaged

    def scales(self, role: str) -> bool:
        """True while the winding may not carry all of the current that was commanded last."""
        return self._axes[role].scaled

    def command(self, role: str, value: float) -> None:
        """Pass a setpoint on, in the unit of the engaged mode.

        Raises
        ------
        SafetyTrip : a trip is latched, or the setpoint is outside the limits, or an angle is further from the one
            before than the shaft may turn in the time between; nothing is passed on.
        """
        if self.tripped:
            raise SafetyTrip(self.tripped)
        drive = self._axes[role]
        low, high = drive.bounds
        if not low <= value <= high:
            self.trip(f"{role} {drive.quantity} of {value:g} is outside the limits {drive.bounds}")
        if drive.heats:
            allowed = self._thermal.allowed[role]
            if not -allowed <= value <= allowed:
                value = self._scale(role, drive, value, allowed)
            elif drive.scaled:
                drive.scaled = False
            if value != drive.demand:
                drive.tracking.ask(value)
            drive.demand, drive.demand_square = value, value * value
        if drive.path is not None:
            self._judge_angle(role, drive.path, value)
        drive.axis.motion.command(value)

    def _scale(self, role: str, drive: _SupervisedDrive, value: float, allowed: float) -> float:
        """Return the part of a current [A] that the winding may carry; warn once as scaling begins."""
        if not drive.scaled:
            drive.scaled = True
            self.warnings.append(
                f"{role} current of {value:g} A is scaled down, to {allowed:.1f} A at first: the hottest phase"
                f" may be at {self._thermal.hottest[role]:.1f} degC"
            )
        return math.copysign(allowed, value)

    def _judge_angle(self, role: str, path: AnglePath, value: float) -> None:
        """Trip on an angle setpoint that is further away than the shaft may turn; note it for the next exchange."""
        if math.isnan(path.sent):
            self.trip(f"{role} angle_reference of {value:g} rad while the shaft's angle is not known")
        now, period = self._clock.now(), self._period
        # a segment may end half a cycle late; after a stall the shaft must not be sent to where it would be without one
        elapsed = min(max(now - path.sent_at, period), CYCLES_OF_SILENCE * period) + 0.5 * period
        limit = self._limits.velocity_rad_s
        reach = max(limit * elapsed, self._limits.angle_leap_rad or 0.0)
        if not abs(value - path.sent) <= reach * (1 + 1e-9):
            self.trip(
                f"{role} angle_reference of {value:g} rad is {abs(value - path.sent):.4g} rad from {path.sent:.4g} rad;"
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
        elapsed = now - pace.last
        if elapsed >= 0.0 and now <= pace.latest:
            pace.last = now
            pace.latest += pace.period
        else:
            pace.look(now)
        flowing, stall = self._heating
        on_time = elapsed < stall
        for index, drive, tracking, motion, q_axis, direct, angle, velocity, look, log in self._judged:
            values = motion.values
            look(values, now)
            if drive.path is not None:
                drive.path.update(drive.measured_angle, motion.engaged, now)
            current = values[q_axis]
            if tracking.low <= current and current <= tracking.high:
                tracking.since = NAN
            else:
                speed = NAN if velocity is None else values[velocity]
                tracking.look(current, speed, now)
            square, demand_square = current * current, drive.demand_square
            if direct is not None:
                square += values[direct] ** 2  # the d-axis current makes no torque, but as much heat
            if not square >= drive.previous_square:  # a reading that is no number counts as the largest current
                square = drive.previous_square if square == square else self._worst
            # in a stall, longer than a cycle, the current before it may have continued
            heat = (square if on_time or square > flowing[index] else flowing[index]) * elapsed
            log += (
                elapsed,
                heat,
                NAN if angle is None else values[angle],
                NAN if velocity is None else values[velocity],
            )
            drive.previous_square = demand_square
            flowing[index] = square if square > demand_square else demand_square
        for rows, evidence, index, first, velocity, current, second, second_current in self._witnessed:
            readings = first.values
            rows.append((evidence.values[index], readings[velocity], readings[current], second.values[second_current]))
        if now >= self._due:
            self._check_what_is_due(now)

    def _check_what_is_due(self, now: float) -> None:
        """Judge what is not due in every cycle: windings, ages of the other streams, stuck channels, second sensors."""
        guard = self._thermal
        if now >= guard.due:
            too_hot = guard.check(now)
            if too_hot:
                self.trip(too_hot)
            if self._velocities is not None:
                servoed = any(drive.path is not None for drive in self._axes.values())
                self._velocities.look(guard.advanced, () if servoed else self._axes)
        if now >= self._ages_due:
            self._ages_due = min((panel.check_age(now) for panel in self._lasting), default=math.inf)
        if now >= self._stuck.due:
            self._stuck.look(now)
        due = min(guard.due, self._ages_due, self._stuck.due)
        for witnesses in self._witnesses:
            witnesses.look(now)
            due = min(due, witnesses.due)
        self._due = due

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
        SafetyTrip : there is too little.
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
        """Bring every device to its safe state: test drive, load drive, then the rest; never raises."""
        drives = [self._axes[role].axis.driver for role in ("test", "load") if role in self._axes]
        safe = safe_state.make_safe((*drives, *self._others))
        with suppress(Exception):  # the bounds that the next run starts from lack the last heat so far
            self._thermal.end(self._clock.now())
        return safe
