"""The one supervisor: every setpoint passes through it to a device, every sample on its way to the file.

It holds the only references to the drives and supplies that the runner may command. A trip latches; every end brings
all devices to their safe state in a fixed order, and says what could not be confirmed.
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
STALL_CYCLES = 2.5  # between two, from which a loop has stalled
SETPOINT_QUANTITY = {
    Mode.CURRENT: CURRENT_REFERENCE,
    Mode.TORQUE_PROFILE: CURRENT_REFERENCE,
    Mode.VELOCITY: "velocity_reference",
    Mode.ANGLE: "angle_reference",
}
DEFAULTS = Interlocks()
NAN = math.nan  # by a name of this module in what runs every cycle
NOTHING_PASSES = (NAN, NAN)


class Axis(NamedTuple):
    """A drive under supervision: the device as a driver and as a motion device."""

    driver: Driver
    motion: MotionDevice


@dataclass(slots=True)
class _Guarded:
    axis: Axis
    panel: Panel
    current: int  # where the q-axis current stands among the values
    direct: int | None  # where the d-axis current stands, of a drive that measures it
    velocity: int | None
    angle: int | None
    tracking: CurrentTracking
    quantity: str = "setpoint"  # that the engaged mode sets
    bounds: tuple[float, float] = UNLIMITED
    heats: bool = False  # whether the engaged mode sets a current
    demand: float = 0.0  # A, of a current reference
    asked: float = 0.0  # A^2 of a current reference, which heats
    held: float = 0.0  # A^2, the same as the exchange before left it, which its reading tells of
    scaled: bool = False  # whether its last setpoint was more than the winding may carry
    path: AnglePath | None = None  # in angle mode alone

    def turn_to(self, mode: Mode, limits: Limits, now: float) -> None:
        """Take the limits of what this mode sets."""
        quantity = SETPOINT_QUANTITY.get(mode)
        self.quantity, self.heats = quantity or "setpoint", quantity == CURRENT_REFERENCE
        self.demand, self.asked, self.path = 0.0, 0.0, None
        self.tracking.turn_to(mode in (Mode.CURRENT, Mode.OFF))  # of a profile, only the drive knows its ramp
        if mode is Mode.ANGLE:
            self.bounds = limits.of("angle_reference") or UNLIMITED  # the path bounds each step
            self.path = AnglePath(self.measured_angle, now)
        else:
            self.bounds = (limits.of(quantity) or NOTHING_PASSES) if quantity else UNLIMITED

    @property
    def places(self) -> tuple[int, int | None, int | None, int | None]:
        """Where q-axis current, d-axis current, angle and velocity stand among the values."""
        return self.current, self.direct, self.angle, self.velocity

    @property
    def measured_angle(self) -> float:
        """The angle of the last exchange; NaN where none came."""
        return math.nan if self.angle is None else self.axis.motion.values[self.angle]


class Supervisor:
    """Limits, interlocks, thermal guard, latch, and the orderly end."""

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
        """The guard knows the axes by the same roles.

        A role without a torque model is not held against the torque sensor: nothing couples the two. Without voltage
        needs every current counts as one that the bus can drive, and no voltage tells of a current.
        """
        self._limits, self._interlocks, self._clock, self._others = limits, interlocks, clock, list(others)
        self._thermal, self._worst = guard, limits.current_A**2
        self._period = 0.0
        self.tripped: str = ""
        self.warnings: list[str] = []
        self._voltage_needs = voltage_needs or {}
        now = clock.now()
        self._axes = {role: self._guard(role, axis, now) for role, axis in axes.items()}
        streams = [
            stream for device in (*[axis.driver for axis in axes.values()], *others) for stream in device.streams
        ]
        self._own = {stream.name: self._panel(stream.channels, limits.age_s, now) for stream in streams}
        self._lasting = [self._own[stream.name] for stream in streams if not stream.ends]
        leads = Leads(guard)
        self._measured = MeasuredStreams(guard, streams, self.trip, leads)
        self.supplies = Supplies(others, limits, guard, leads, self.refuse_latched, self.trip)
        self._heating_streams = self._measured.streams | self.supplies.streams
        guard.undriven = frozenset(place for place, role in enumerate(guard.roles) if role not in self._axes)
        panels = [*[guarded.panel for guarded in self._axes.values()], *self._own.values()]
        self._stuck = Stuck(panels, interlocks)
        self._velocities = self._by_angle()
        self._pace = Pace(interlocks.loop_overruns, interlocks.clock, self.trip, now)
        self._disk = Disk(interlocks.disk_space, self.trip, self.warnings.append)
        self._witnesses = [*self._by_torque(torque_models or {}), *self._by_voltage()]
        self._due = self._ages_due = -math.inf
        # by names of their own: `check` runs in every cycle
        self._witnessed = [witnesses.logged for witnesses in self._witnesses]
        self._judged = [
            (place, each, each.tracking, each.axis.motion, *each.places, each.panel.look, guard.logs[place])
            for role, each in self._axes.items()
            for place in [guard.roles.index(role)]
        ]
        guard.begin(now)
        self._heating = guard.flowing, math.inf
        self.windings = guard.estimate, guard.hottest  # degC by role, kept up to date
        self.time_left, self.winding_limit = guard.time_left, guard.limit

    def _panel(self, channels: Sequence[ChannelSpec], age: float, now: float) -> Panel:
        panel = Panel(channels, self._limits, self._interlocks, self.trip, self.warnings.append)
        panel.begin(now, age)
        return panel

    def _guard(self, role: str, axis: Axis, now: float) -> _Guarded:
        channels = axis.motion.loop_channels
        place = {channel.quantity: index for index, channel in enumerate(channels)}
        panel = self._panel(channels, self._limits.cyclic_age(0.0), now)
        need = self._voltage_needs.get(role, VoltageNeed())
        settings = self._interlocks.current_disagreement
        tracking = CurrentTracking(role, axis.motion, settings, self._limits, need, self.trip)
        tracking.turn_to(judges=True)
        direct, velocity, angle = (place.get(name) for name in ("d_axis_current", "velocity", "angle"))
        return _Guarded(axis, panel, place["q_axis_current"], direct, velocity, angle, tracking)

    def _by_torque(self, models: Mapping[str, TorqueModel]) -> list[Witnesses]:
        """What holds currents against the torque sensor, where there is one."""
        settings = self._interlocks.torque_disagreement
        if settings is None or not models:
            return []
        for panel in self._own.values():
            for watch in panel.watches:
                if (watch.channel.quantity, watch.channel.role) == ("torque", "test"):
                    panel.values = panel.values or [math.nan] * len(panel.watches)  # until the first reading
                    senses = {role: 1.0 if role == "test" else -1.0 for role in models}
                    told = [self._account(role, ByTorque(settings, models[role], senses[role])) for role in models]
                    accounts = [account for account in told if account is not None]
                    return [Witnesses(settings.for_s, panel, watch.index, accounts, self.trip)] if accounts else []
        return []

    def _by_voltage(self) -> list[Witnesses]:
        """What holds currents against the voltages at their windings, where drives tell those."""
        settings = self._interlocks.voltage_disagreement
        if settings is None:
            return []
        witnesses = []
        for role, guarded in self._axes.items():
            for watch in guarded.panel.watches:
                if watch.channel.quantity == "q_axis_voltage" and role in self._voltage_needs:
                    constant = self._voltage_needs[role].back_emf_constant
                    by_voltage = ByVoltage(watch.label, settings, constant, partial(self._thermal.resistances, role))
                    account = self._account(role, by_voltage)
                    if account is not None:
                        witnesses.append(Witnesses(settings.for_s, guarded.panel, watch.index, [account], self.trip))
        return witnesses

    def _by_angle(self) -> Velocities | None:
        """What holds velocities against angles."""
        settings, guard = self._interlocks.velocity_disagreement, self._thermal
        rotors = {role: rotor for role, rotor in zip(guard.roles, guard.rotors, strict=True) if role in self._axes}
        return None if settings is None else Velocities(settings, rotors, self.trip)

    def _account(self, role: str, witness: ByTorque | ByVoltage) -> Account | None:
        """The current of a role, where its drive tells it and how fast it turns."""
        guarded = self._axes.get(role)
        if guarded is None or guarded.velocity is None:
            return None
        return Account(f"{role} q_axis_current", witness, guarded.panel, guarded.current, guarded.velocity)

    def begin(self, period: float) -> None:
        """The loop begins: ages count from here, for opening devices and making a file take what time they take."""
        now, self._period = self._clock.now(), period
        guard = self._thermal
        guard.begin(now)
        self._heating = guard.flowing, STALL_CYCLES * period
        for guarded in self._axes.values():
            guarded.panel.begin(now, self._limits.cyclic_age(period))
        for panel in self._own.values():
            panel.begin(now, self._limits.age_s)
        self._pace.begin(period, now)
        for witnesses in self._witnesses:
            witnesses.begin(period, now)
        self._due = self._ages_due = -math.inf

    # -- commands ----------------------------------------------------------------------------------------------------

    def refuse_latched(self) -> None:
        """Let nothing begin after a trip.

        Raises
        ------
        SafetyTrip : one is latched.
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
        guarded = self._axes[role]
        guarded.axis.motion.engage(mode)  # what the drive refuses leaves the limits as they are
        guarded.turn_to(mode, self._limits, self._clock.now())

    def release(self, role: str) -> None:
        """Let a drive leave operation; always allowed."""
        guarded = self._axes[role]
        guarded.turn_to(Mode.OFF, self._limits, self._clock.now())
        guarded.axis.motion.release()

    def engaged(self, role: str) -> bool:
        """True once the drive itself reports that it follows its setpoint."""
        return self._axes[role].axis.motion.engaged

    def scales(self, role: str) -> bool:
        """True while the winding may not carry all of the current that was asked for last."""
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
        guarded = self._axes[role]
        low, high = guarded.bounds
        if not low <= value <= high:
            self.trip(f"{role} {guarded.quantity} of {value:g} is outside the limits {guarded.bounds}")
        if guarded.heats:
            allowed = self._thermal.allowed[role]
            if not -allowed <= value <= allowed:
                value = self._scaled(role, guarded, value, allowed)
            elif guarded.scaled:
                guarded.scaled = False
            if value != guarded.demand:
                guarded.tracking.ask(value)
            guarded.demand, guarded.asked = value, value * value
        if guarded.path is not None:
            self._judge_angle(role, guarded.path, value)
        guarded.axis.motion.command(value)

    def _scaled(self, role: str, guarded: _Guarded, value: float, allowed: float) -> float:
        """As much of a current as the winding may carry; said once each time that this becomes less than all of it."""
        if not guarded.scaled:
            guarded.scaled = True
            self.warnings.append(
                f"{role} current of {value:g} A is scaled down, to {allowed:.1f} A at first: the hottest phase"
                f" may be at {self._thermal.hottest[role]:.1f} degC"
            )
        return math.copysign(allowed, value)

    def _judge_angle(self, role: str, path: AnglePath, value: float) -> None:
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
        for place, guarded, tracking, motion, where, direct, angle, velocity, look, log in self._judged:
            values = motion.values
            look(values, now)
            if guarded.path is not None:
                guarded.path.exchanged(guarded.measured_angle, motion.engaged, now)
            current = values[where]
            if tracking.low <= current and current <= tracking.high:
                tracking.since = NAN
            else:
                speed = NAN if velocity is None else values[velocity]
                tracking.look(current, speed, now)
            square, asked = current * current, guarded.asked
            if direct is not None:
                square += values[direct] ** 2  # it makes no torque, and as much heat
            if not square >= guarded.held:  # a reading that is no number is the worst that may flow
                square = guarded.held if square == square else self._worst
            # a stall of the loop is longer than a cycle: what flowed before it may have gone on
            heat = (square if on_time or square > flowing[place] else flowing[place]) * elapsed
            log += (
                elapsed,
                heat,
                NAN if angle is None else values[angle],
                NAN if velocity is None else values[velocity],
            )
            guarded.held = asked
            flowing[place] = square if square > asked else asked
        for rows, evidence, place, drive, velocity, current, other, second in self._witnessed:
            read = drive.values
            rows.append((evidence.values[place], read[velocity], read[current], other.values[second]))
        if now >= self._due:
            self._look_at_all(now)

    def _look_at_all(self, now: float) -> None:
        """What need not be looked at in every cycle: windings, ages of the devices' own streams, what stands still."""
        guard = self._thermal
        if now >= guard.due:
            too_hot = guard.check(now)
            if too_hot:
                self.trip(too_hot)
            if self._velocities is not None:
                servoed = any(guarded.path is not None for guarded in self._axes.values())
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
        """Judge a sample of a device's own stream, or many.

        Raises
        ------
        SafetyTrip : the value is outside its limits, or the device names a fault such as saturation.
        """
        if self.tripped:
            raise SafetyTrip(self.tripped)
        if isinstance(row, SampleBlock):
            self._own[row.stream].look_through(row)
            self._measured.look_through(row)
            return
        stream, time, values, fault = row  # at once: each by its name takes as long
        if fault:
            self.trip(fault)
        self._own[stream].look(values, time)
        if stream in self._heating_streams:
            self._measured.look(row)
            self.supplies.look(row)

    def free_space(self, free_bytes: float) -> None:
        """Judge what is left on the disk that takes the recording.

        Raises
        ------
        SafetyTrip : too little.
        """
        self._disk.look(free_bytes)

    def take_warnings(self) -> list[str]:
        """What has crossed a warning since the last call, one line a crossing."""
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
        """Let nothing pass from here on, take the setpoint from every drive, and cut every supply at the leads."""
        self.tripped = self.tripped or cause or "the run has ended"
        for guarded in self._axes.values():
            with suppress(Exception):  # a driver that breaks here is switched off by `make_safe`, and hides no trip
                guarded.axis.motion.release()
        self.supplies.cut()

    # -- the end -----------------------------------------------------------------------------------------------------

    def make_safe(self) -> dict[str, Confirmation]:
        """Bring every device to its safe state: test drive, load drive, then the rest; never raises."""
        drives = [self._axes[role].axis.driver for role in ("test", "load") if role in self._axes]
        safe = safe_state.make_safe((*drives, *self._others))
        with suppress(Exception):  # what flowed last is not in the bounds yet that the next run starts from
            self._thermal.end(self._clock.now())
        return safe
