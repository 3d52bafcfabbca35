"""Elmo Gold servo drive over CANopen (CiA 301, CiA 402): SYNC exchange of PDOs, set up by SDO, both heartbeats.

Objects and defaults after Elmo's Gold EDS (CANedsGoldV005_0); the README of this plug-in lists the sources.
"""

import math
import struct
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, ClassVar

from leactl.driver.answer_matching import Answers, IrregularAnswers
from leactl.driver.can_port import NMT_ID, CanPort
from leactl.driver.clock import Clock
from leactl.driver.contract import Confirmation, Driver, Identity, Mode, Row, StreamSpec, drive_channels
from leactl.driver.far_end import CanEmulator, Physics
from leactl.driver.safe_state import send_at_once
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer
from leactl.quantities import ChannelSpec
from leactl_plugins.elmo.scales import CountedPosition
from leactl_plugins.elmo_can import cia402, emergency
from leactl_plugins.elmo_can.cia402 import FAULT_STATES, DriveState
from leactl_plugins.elmo_can.commissioning import ALL_MODES, RANGE_OF_32_BITS, Commissioning, SetpointTime, event_tpdo
from leactl_plugins.elmo_can.probe import ElmoProbe
from leactl_plugins.elmo_can.sdo import Sdo
from leactl_plugins.elmo_can.settings import ElmoSettings

NMT_START, NMT_PRE_OPERATIONAL = 0x01, 0x80
BOOT_UP, OPERATIONAL = 0x00, 0x05
NETWORK_STATES = {0x00: "boot-up", 0x04: "stopped", 0x7F: "pre-operational"}
INTERNAL_LIMIT = 0x0800  # statusword bit 11
NOTICE_PERIOD_S = 1.0  # at most one notice of a kind in this time: a drive may reach and leave its limit every cycle
MODES = {Mode.OFF: 0, Mode.TORQUE_PROFILE: 4, Mode.ANGLE: 8, Mode.VELOCITY: 9, Mode.CURRENT: 10}
CURRENT, VELOCITY, ANGLE = range(3)  # indices of the references in `values`
REFERENCES = {
    Mode.CURRENT: CURRENT,
    Mode.TORQUE_PROFILE: CURRENT,
    Mode.VELOCITY: VELOCITY,
    Mode.ANGLE: ANGLE,
    Mode.OFF: ANGLE,  # the reference is NaN, as nothing is commanded
}
STATUS, MOTION, VOLTAGE = range(3)  # the TPDOs that answer every SYNC
# names for the code of every cycle: access to an enum's attribute takes ten times as long (Python 3.11)
OFF, ENABLED = Mode.OFF, DriveState.ENABLED
DISABLE_VOLTAGE, ENABLE_OPERATION = cia402.DISABLE_VOLTAGE, cia402.ENABLE_OPERATION
ENABLE_TIME_S = 2.0  # time for the drive to enter operation
DISABLE_VOLTAGE_BY_SDO = bytes.fromhex("2b40600000000000")
BUS_VOLTAGE = bytes.fromhex("796000")  # index and subindex in an SDO frame
READ_BUS_VOLTAGE = bytes.fromhex("4079600000000000")
STO_STATUS = bytes.fromhex("862000")  # of the safe torque off (Elmo's Gold EDS)
READ_STO_STATUS = bytes.fromhex("4086200000000000")
# first byte of an answer with four bytes; 0x42 does not state their number (CiA 301, 7.2.4.3.5)
FOUR_BYTE_COMMANDS = (0x43, 0x42)
DOWNLOAD_COMMANDS = (1, 6)  # first three bits of a client's request to write: at once or in segments, and in blocks
SDO_PAUSE_S = 0.02  # time between two SDO requests, because a drive takes one at a time
NAN, NEVER = math.nan, -math.inf
LONGEST_DELAY_S = 0.05  # of an answer; the supervisor allows a reading this age at 60 Hz and above
MOST_CLOCK_DRIFT = 2e-4  # s/s; the drive's clock may be faster than the host's by this

_torque_demand = struct.Struct("<Hhb")
_motion_demand = struct.Struct("<ii")
_status = struct.Struct("<Hbhh")
_motion = struct.Struct("<ii")


class _AnswerDelay:
    """Delay of the drive's answers beyond the shortest one, by the drive's own clock."""

    def __init__(self) -> None:
        # last clock of the drive [us], unwrapped from 32 bits, and the time [s] at which it arrived
        self._drive_us, self._seen_at = 0, NAN
        # least time of the host minus that of the drive [s], and the number of late answers in sequence
        self._least_offset, self._late_in_sequence = math.inf, 0

    def see(self, drive_us: int, now: float) -> float:
        """Return the delay of an answer that arrived now [s]; 0 unless it and the one before exceed `LONGEST_DELAY_S`.

        `drive_us`: clock of the drive in the answer [us].
        """
        elapsed_us = (
            (drive_us - self._drive_us + 0x80000000 & 0xFFFFFFFF) - 0x80000000
            if self._seen_at == self._seen_at
            else drive_us
        )
        elapsed_s = now - self._seen_at if self._seen_at == self._seen_at else 0.0
        self._drive_us, self._seen_at = self._drive_us + elapsed_us, now
        offset = now - 1e-6 * self._drive_us
        self._least_offset = min(self._least_offset + MOST_CLOCK_DRIFT * elapsed_s, offset)
        delay = offset - self._least_offset
        # a single late answer may be due to a delay of the host
        self._late_in_sequence = self._late_in_sequence + 1 if delay > LONGEST_DELAY_S else 0
        return delay if self._late_in_sequence >= 2 else 0.0


class _SignsOfLife:
    """Times [s] of the drive's last heartbeat and of the host's frames that are not sent every cycle."""

    def __init__(self) -> None:
        self.answer_delay = _AnswerDelay()
        self.heard_until = NEVER  # by when the next heartbeat of the drive has to arrive
        self.heartbeat_sent_at = NEVER  # last heartbeat of the host
        self.sdo_requested_at = NEVER  # last request of the bus voltage or of the safe torque off
        self.feed_due_at = NEVER  # when `feed` has to send the next frame


class _DriveCondition:
    """What is known of a drive, and noted for the run, apart from the exchange of every cycle."""

    def __init__(self) -> None:
        self.started = False  # whether the node was commanded to start
        self.operational = False  # whether it has reported since then to be operational
        self.highest_per_mille = 0  # highest current that it allows, in per mille of its rated current
        self.modes = ALL_MODES  # bits of its supported modes
        self.voltage_refused = False  # whether 0x6079 was answered otherwise than by four bytes
        self.sto_requested = False  # whether 0x2086 was requested since the drive was commanded to enter operation
        self.sto_status: int | None = None  # value of 0x2086; None until it is answered
        self.other_master_text = ""  # what another master has done; empty if nothing
        self.is_read_by_others = False  # whether another master has read objects
        self.safe = False  # whether it has confirmed to be safe, and got no demand since
        self.setpoint_time: SetpointTime | None = None  # of the drive before `pace` changed it
        self.rows: list[Row] = []
        self.notices: list[str] = []
        self.limiting_quiet_until = self.answers_quiet_until = -math.inf  # times before which no notice is added
        self.reported_irregular = IrregularAnswers()
        self.identity = Identity()


class ElmoCan(Driver):
    """One Elmo Gold drive; its PDO exchange is one SYNC a cycle.

    It has 28 attributes: with more than 29, Python 3.11 to 3.13 keep them in a dictionary, and every access costs more.
    """

    Settings = ElmoSettings
    transport = "can"
    summary = "Elmo Gold servo drive over CANopen (CiA 402)"
    example: ClassVar[Mapping[str, Any]] = {"node": 1, "counts_per_turn": 40000}
    synchronised = True
    probe = ElmoProbe()

    def __init__(self, name: str, role: str, settings: ElmoSettings, port: CanPort, clock: Clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        self._port, self._clock = port, clock
        self._node = settings.node
        self._sdo = Sdo(port, settings.node, settings.sdo_timeout_s)
        self._opened = False
        self._angle_per_count = settings.sign * 2 * math.pi / settings.counts_per_turn
        self._current_per_mille = NAN
        self.state = DriveState.NOT_READY
        self.statusword = 0
        self._reported_mode = 0
        self._turn_to(Mode.OFF)
        self._enable_by = math.inf
        self._answers = self._expected_answers()
        self._emergency = ""
        self._life = _SignsOfLife()
        self._position = CountedPosition(*RANGE_OF_32_BITS)
        self._condition = _DriveCondition()
        self._references_in_force = self._demanded_references
        self.values = [NAN] * len(self.loop_channels)

    def safe_state(self, deadline_s: float) -> Confirmation:
        """Take the drive out of operation, from any state, over a new connection if needed; never raises."""
        self._turn_to(Mode.OFF)
        deadline = self._clock.now() + deadline_s
        reason = "no time was left"
        while self._clock.now() < deadline:
            try:
                statusword = self._disable_voltage(deadline)
            except DeviceError as error:
                reason = str(error)
                try:
                    self._port.reopen()
                    self._send_nmt(NMT_PRE_OPERATIONAL)  # a node that was told to stop answers no SDO until it is woken
                except DeviceError as reopen_error:
                    reason = str(reopen_error)
                    self._clock.sleep_until(min(deadline, self._clock.now() + 0.01))
                continue
            state = cia402.state_of(statusword)
            if state not in (DriveState.ENABLED, DriveState.QUICK_STOP, DriveState.FAULT_REACTION):
                self._take_status(statusword, self._reported_mode)
                self._condition.safe = True
                return Confirmation(True, f"{state}, statusword 0x{statusword:04X}")
            reason = f"still {state}, statusword 0x{statusword:04X}"
        return Confirmation(False, f"not confirmed within {deadline_s:g} s: {reason}")

    def _disable_voltage(self, deadline: float) -> int:
        """Disable the voltage and read the statusword; no wait ends after `deadline` [s]."""
        self._sdo.wait_no_longer_than(deadline)
        try:
            self._connect()
            self._send_demand(cia402.DISABLE_VOLTAGE)
            self._port.sync()
            self._sdo.write(0x6040, 0, "u16", cia402.DISABLE_VOLTAGE)
            return self._sdo.read(0x6041, 0, "u16")
        finally:
            self._sdo.wait_no_longer_than(math.inf)

    def stop_now(self) -> None:
        """Send the command that disables the voltage, without waiting; over a new connection if needed.

        It is sent by PDO, for a drive that is mapped and operational, and by SDO, for one set up by another program.
        """
        self._turn_to(Mode.OFF)
        send_at_once(self._disable_by_pdo_and_sdo, self._port, lambda: self._opened)

    def _disable_by_pdo_and_sdo(self) -> None:
        """Send the command that disables the voltage by PDO and by SDO."""
        self._connect()
        self._send_demand(cia402.DISABLE_VOLTAGE)
        self._port.sync()
        self._port.send(0x600 + self._node, DISABLE_VOLTAGE_BY_SDO)

    def open(self) -> None:
        """Identify the drive, disable it, read its scales, arm its monitoring of the host, map its PDOs, start it.

        Raises
        ------
        DeviceError : the drive is absent or another one, contradicts the bench file, refuses a setting, or its dead-man
            cannot be armed.
        DeviceFault : it is in fault, or another master acts on it.
        """
        self._condition = _DriveCondition()
        self._sdo.surplus = 0  # answers before belong to an earlier start, or to a stop, which awaits none
        self._connect()
        self._emergency = ""  # if the drive is still in fault, its state says so
        setup = self._setup()
        try:
            setup.check_identity()
        except NoAnswer:
            self._send_nmt(NMT_PRE_OPERATIONAL)  # a node that was told to stop answers no SDO until it is woken
            setup.check_identity()
        setup.disable_voltage()
        if setup.leave_fault():
            self._emergency = self._condition.other_master_text
        self._condition.identity = setup.identity()
        setup.check_scales()
        setup.clear_offsets()
        self._condition.modes = setup.supported_modes()
        self._position = CountedPosition(*setup.position_range())
        self._current_per_mille, self._condition.highest_per_mille = setup.read_scales()
        self._turn_to(Mode.OFF)
        setup.check_alone()
        setup.arm_dead_man()
        # heartbeats sent before no longer count: writing 0x1016 ends the monitoring
        self._life.heartbeat_sent_at = self._life.feed_due_at = NEVER
        self._life.answer_delay = _AnswerDelay()
        self._answers = self._expected_answers()
        self._send_nmt(NMT_PRE_OPERATIONAL)
        setup.map_pdos()
        setup.start_heartbeat()
        self._send_nmt(NMT_START)
        self._note_heartbeat()
        self._condition.started = True
        if self._emergency:
            raise DeviceFault(f"{self.name}: {self._emergency}")

    def identity(self) -> Identity:
        """Return name, serial number and software version (0x1008 to 0x100A, 0x1018) as read at `open`."""
        return self._condition.identity

    def close(self) -> None:
        """Stop listening and close the bus; a safe drive gets its setpoint time back and its monitoring ends."""
        if self._opened:
            if self._condition.safe and self._condition.started:
                with suppress(DeviceError):  # the drive is safe; settings that stay changed do no harm
                    self._restore_settings()
            self._opened = False
            for identifier in self._listeners():
                self._port.listen(identifier, None)
            self._port.close()

    def _restore_settings(self) -> None:
        """End the monitoring of the host, and restore the drive's setpoint time."""
        setup = self._setup()
        setup.disarm_dead_man()
        if self._condition.setpoint_time is not None:
            setup.set_setpoint_time(self._condition.setpoint_time)

    def _setup(self) -> Commissioning:
        return Commissioning(self.name, self.settings, self._sdo, self._clock)

    @classmethod
    def far_end(cls, settings: ElmoSettings, role: str, physics: Physics) -> CanEmulator:
        """Return an emulated drive at this node, with the rating of the settings, that turns the bench's motor."""
        from leactl_plugins.elmo_can.emulator import ElmoEmulator

        voltage, clock = settings.q_axis_voltage, settings.drive_clock
        return ElmoEmulator(
            settings.node,
            physics.machine(role),
            rated_current_ma=settings.emulated_rated_current_mA,
            counts_per_turn=settings.counts_per_turn,
            q_axis_per_ampere=settings.current_convention.to_q_axis,
            voltage_object=(voltage.index, voltage.subindex, voltage.type, voltage.scale_V) if voltage else None,
            clock_object=(clock.index, clock.subindex) if clock else None,
        )

    # -- one cycle ---------------------------------------------------------------------------------------------------

    @property
    def loop_channels(self) -> tuple[ChannelSpec, ...]:
        """Channels of `values`: readings, and the references that were in force until the drive sampled them."""
        voltage = (ChannelSpec("vq", "q_axis_voltage", self.role, self.name, f"{self.role} q axis voltage"),)
        return drive_channels(self.role, self.name) + (voltage if self.settings.q_axis_voltage else ())

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """Stream of the bus voltage, which is read by SDO at its own rate (0x6079 cannot be mapped)."""
        channel = ChannelSpec("vbus", "bus_voltage", self.role, self.name, "DC link voltage")
        return (StreamSpec(f"{self.name}_supply", (channel,)),)

    def engage(self, mode: Mode) -> None:
        """Begin to enter operation in this mode with zero demand; in angle mode the present angle is held.

        Raises
        ------
        InputError : the drive has no such mode.
        """
        if mode not in MODES or mode is Mode.OFF:
            raise InputError(f"{self.name}: mode '{mode}' is not one a drive can follow")
        if not self._condition.modes >> MODES[mode] - 1 & 1:
            raise InputError(
                f"{self.name}: the drive has no mode {MODES[mode]}, which '{mode}' needs (0x6502:"
                f" 0x{self._condition.modes:08X})"
            )
        self._turn_to(mode)
        self._position.located = self._condition.safe = self._condition.sto_requested = False
        self._condition.sto_status = None
        self._enable_by = self._clock.now() + ENABLE_TIME_S

    def pace(self, period: float) -> None:
        """Set the time between setpoints [s]; the drive's own value is restored at `close`."""
        setup, condition = self._setup(), self._condition
        if condition.setpoint_time is None:
            condition.setpoint_time = setup.setpoint_time()
        setup.expect_setpoints_every(period, condition.setpoint_time)

    def release(self) -> None:
        """Begin to leave operation; no current flows once the drive has left it."""
        self._turn_to(Mode.OFF)

    def command(self, value: float) -> None:
        """Set the demand of the engaged mode (A, rad/s or rad) for the next cycle.

        Raises
        ------
        InputError : not finite, outside the range of the drive's object, or a current that the drive does not let flow.
        """
        scale, largest_raw_demand, origin = self._angle_per_count, 0x7FFFFFFF, 0
        is_current = self._reference == CURRENT
        if is_current:
            scale, largest_raw_demand = self._current_per_mille, self._condition.highest_per_mille
        elif self._mode is Mode.ANGLE:
            # unwrapping fails beyond half the range
            largest_raw_demand, origin = self._position.half_span - 1, self._position.counts
        demand = value / scale
        if not -largest_raw_demand <= demand - origin <= largest_raw_demand:
            largest_demand = largest_raw_demand * abs(scale)
            if is_current and largest_raw_demand < 0x7FFF:
                raise InputError(
                    f"{self.name}: a demand of {value:g} A is above the {largest_demand:g} A that the drive lets flow"
                    f" (0x6072, 0x6073: {largest_raw_demand} per mille of its rated current)"
                )
            raise InputError(
                f"{self.name}: a demand of {value:g} is outside what the drive can hold ({largest_demand:g})"
            )
        self._raw_demand = round(demand)

    def begin_cycle(self) -> None:
        """Send this cycle's demand; it acts at the next SYNC."""
        answers = self._answers
        if answers.watched:
            self._port.take_waiting()
            answers.begin(self._clock.now())
        came = answers.came
        came[STATUS] = came[MOTION] = False
        if len(self.values) > 7:
            came[VOLTAGE] = False
        if self._mode is OFF or not self._position.located:
            self._send_demand(DISABLE_VOLTAGE)
        elif self.state is ENABLED:
            self._send_demand(ENABLE_OPERATION)
        else:
            if self._reference == ANGLE:
                self._raw_demand = self._position.counts  # hold where the shaft is at the moment operation begins
            self._send_demand(self._towards_enabled())

    def _towards_enabled(self) -> int:
        """Return the next controlword towards operation.

        Raises
        ------
        DeviceError : no heartbeat was sent recently, so that the drive does not monitor the host.
        """
        consumer_time = self.settings.host_silence_s
        if self._clock.now() - self._life.heartbeat_sent_at > consumer_time:
            raise DeviceError(
                f"{self.name}: is not enabled: no heartbeat was sent in {consumer_time:g} s, its dead-man is not armed"
            )
        controlword = cia402.towards_enabled(self.state)
        if controlword == ENABLE_OPERATION and self._reported_mode != self._mode_number:
            return cia402.SWITCH_ON  # if enabled now, it would follow the last demand of the previous mode
        return controlword

    def end_cycle(self, deadline: float) -> None:
        """Collect the drive's samples of the last SYNC; NaN for those that did not arrive.

        Raises
        ------
        DeviceFault : the drive is in fault, sent an emergency message, or left operation by itself.
        NoAnswer : the drive's own heartbeat stayed away, or it did not enter operation in time.
        """
        answers = self._answers
        all_came = self._port.pump_until(answers.came, deadline)
        values, engaged = self.values, self.engaged
        # in force until the SYNC at which the drive sampled
        values[0], values[1], values[2] = self._references_in_force
        demanded_references = self._references_in_force = self._demanded_references
        demanded_references[self._reference] = self._raw_demand * self._scale
        values[6] = 1.0 if engaged else 0.0
        now = self._clock.now()
        if not all_came or answers.watched:
            self._clear_missing(now)
        if engaged and now <= self._life.heard_until and not self._emergency:
            self._enable_by = NEVER  # from now on, only the drive itself can leave operation
        else:
            self._check_operation(now)

    def _clear_missing(self, now: float) -> None:
        """Set to NaN the values that are not known to answer this cycle's SYNC."""
        values = self.values
        status, motion, voltage = self._answers.end(now)
        if not status:
            values[3] = values[6] = NAN
        if not motion:
            values[4] = values[5] = NAN
        if not voltage and len(values) > 7:
            values[7] = NAN

    def feed(self) -> None:
        """Send the host's heartbeat once a third of the consumer time has passed; ask for the bus voltage."""
        now, life = self._clock.now(), self._life
        if now < life.feed_due_at:
            return
        settings = self.settings
        heartbeat_period = settings.consumer_heartbeat_ms / 3000
        if now - life.heartbeat_sent_at >= heartbeat_period:
            self._port.send(0x700 + settings.host_node, bytes((OPERATIONAL,)))
            life.heartbeat_sent_at = now
        if now - life.sdo_requested_at >= settings.bus_voltage_period_s:
            life.sdo_requested_at = now
            self._port.send(0x600 + self._node, READ_BUS_VOLTAGE)
        self._answers.watched = True  # from the next SYNC on: an answer that came twice would shift all later answers
        life.feed_due_at = min(
            life.heartbeat_sent_at + heartbeat_period, life.sdo_requested_at + settings.bus_voltage_period_s
        )

    def notices(self) -> list[str]:
        """Return lines for each start of a limited demand, for irregular answers and for a full bus.

        The drive reports a limited demand by bit 11 of the statusword.
        """
        condition, irregular = self._condition, self._answers.irregular
        now = self._clock.now()
        if irregular != condition.reported_irregular and (now >= condition.answers_quiet_until or self._mode is OFF):
            condition.answers_quiet_until = now + NOTICE_PERIOD_S
            condition.reported_irregular = replace(irregular)
            condition.notices.append(str(irregular))
        notices, condition.notices = condition.notices + self._port.notices(), []
        return notices

    def take(self) -> list[Row]:
        """Return the bus voltages since the last call."""
        condition = self._condition
        if not condition.rows:
            return condition.rows
        rows, condition.rows = condition.rows, []
        return rows

    def reset_fault(self) -> None:
        """Reset a latched fault by the 0 -> 1 edge of bit 7 (CiA 402, transition 15: holding 0x80 never resets).

        Raises
        ------
        DeviceFault : the drive is still in fault, because the cause persists.
        """
        self._setup().reset_fault()
        self._emergency = self._condition.other_master_text

    # -- set-up ------------------------------------------------------------------------------------------------------

    def _connect(self) -> None:
        """Open the bus and listen to the drive; open it again if it was lost."""
        if not self._opened:
            self._port.open()
            self._opened = True
            for identifier, listener in self._listeners().items():
                self._port.listen(identifier, listener)
        elif self._port.bus is None:
            self._port.reopen()

    def _listeners(self) -> dict[int, Any]:
        """Return the listeners to frames of the drive and of other masters, by CAN identifier."""
        event_number = event_tpdo(self.settings)
        change_listener = {} if event_number is None else {0x180 + 0x100 * event_number + self._node: self._on_change}
        master_listeners: dict[int, Any] = {}
        if not self._port.returns_own:  # frames that the port returns may be the host's own
            master_listeners = dict.fromkeys(
                (base + self._node for base in range(0x200, 0x600, 0x100)), self._on_other_demand
            )
            master_listeners[0x600 + self._node] = self._on_other_request
            master_listeners[0x700 + self.settings.host_node] = self._on_other_host
        return {
            0x080 + self._node: self._on_emergency,
            0x180 + self._node: self._on_status,
            0x280 + self._node: self._on_motion,
            0x380 + self._node: self._on_voltage,
            0x480 + self._node: self._on_clock,
            0x580 + self._node: self._on_sdo,
            0x700 + self._node: self._on_heartbeat,
            **change_listener,
            **master_listeners,
        }

    def _send_nmt(self, command: int) -> None:
        self._port.send(NMT_ID, bytes((command, self._node)))

    def _expected_answers(self) -> Answers:
        """Return a new counter of the answers to SYNCs: status, motion and, if mapped, voltage."""
        return Answers(2 if self.settings.q_axis_voltage is None else 3)

    def _turn_to(self, mode: Mode) -> None:
        """Change to a mode with zero demand."""
        self._mode, self._mode_number, self._raw_demand = mode, MODES[mode], 0
        self._reference: int = REFERENCES[mode]
        scale = self._current_per_mille if self._reference == CURRENT else self._angle_per_count
        self._scale = NAN if mode is Mode.OFF else scale  # A, rad/s or rad per unit of the raw demand
        # current, velocity and angle; NaN for those that the mode does not command
        self._demanded_references: list[float] = [NAN, NAN, NAN]
        self._take_status(self.statusword, self._reported_mode)

    def _take_status(self, statusword: int, mode_number: int) -> None:
        """Store the drive's state; it is engaged if operation is enabled in the demanded mode."""
        self.statusword, self.state, self._reported_mode = statusword, cia402.state_of(statusword), mode_number
        self.engaged = self._mode is not OFF and self.state is ENABLED and mode_number == self._mode_number

    # -- frames ------------------------------------------------------------------------------------------------------

    def _send_demand(self, controlword: int) -> None:
        """Send a controlword with the present demand."""
        reference, raw_demand = self._reference, self._raw_demand
        torque = raw_demand if reference == CURRENT else 0
        self._port.send(0x200 + self._node, _torque_demand.pack(controlword, torque, self._mode_number))
        if (
            (reference == CURRENT and controlword == ENABLE_OPERATION)
            or self._mode is OFF
            or not self._position.located
        ):
            return
        # in every mode until the drive is in operation, so that it never follows a target left by another master
        position = self._position
        angle = raw_demand if reference == ANGLE else position.counts
        velocity = raw_demand if reference == VELOCITY else 0
        self._port.send(0x300 + self._node, _motion_demand.pack(position.wrapped(angle), velocity))

    def _on_status(self, data: bytearray, _timestamp: float) -> None:
        """Take state, mode and current from the TPDO that comes first after a SYNC."""
        if len(data) == 7:
            statusword, mode_number, _torque, current = _status.unpack(data)
            # even of a late answer, which is the newest status
            if statusword != self.statusword or mode_number != self._reported_mode:
                if statusword & ~self.statusword & INTERNAL_LIMIT:
                    self._note_limiting(statusword)
                self._take_status(statusword, mode_number)
            answers = self._answers
            if answers.watched and not answers.take(STATUS, self._clock.now()):
                return
            self.values[3] = current * self._current_per_mille
            answers.came[STATUS] = True
        else:
            self._refuse_length(1, data, 7)

    def _on_motion(self, data: bytearray, _timestamp: float) -> None:
        """Take position and velocity from the TPDO that comes second after a SYNC."""
        if len(data) == 8:
            answers = self._answers
            if answers.watched:
                if not answers.take(MOTION, self._clock.now()):
                    return
            elif not answers.came[STATUS]:
                answers.leave_out()
                return
            counts, speed = _motion.unpack(data)
            position = self._position
            if not -position.half_span <= counts - position.counts < position.half_span:
                counts = position.nearest(counts)
            values, scale = self.values, self._angle_per_count
            position.counts, values[4], values[5] = counts, speed * scale, counts * scale
            answers.came[MOTION] = position.located = True
        else:
            self._refuse_length(2, data, 8)

    def _refuse_length(self, number: int, data: bytearray, expected: int) -> None:
        """End the run for a PDO of another length than mapped; before the node's start, an old mapping may be valid."""
        if self._condition.started and not self._emergency:
            self._emergency = (
                f"TPDO{number} has {len(data)} bytes, {expected} were mapped: another master has mapped it since"
            )

    def _on_voltage(self, data: bytearray, _timestamp: float) -> None:
        """Take the q-axis voltage from the TPDO that comes third after a SYNC."""
        voltage = self.settings.q_axis_voltage
        if voltage is None:
            return
        length = 2 if voltage.type == "i16" else 4
        if len(data) == length:
            answers = self._answers
            if answers.watched:
                if not answers.take(VOLTAGE, self._clock.now()):
                    return
            elif not answers.came[MOTION]:
                answers.leave_out()
                return
            self.values[7] = int.from_bytes(data, "little", signed=True) * voltage.scale_V
            answers.came[VOLTAGE] = True
        else:
            self._refuse_length(3, data, length)

    def _on_clock(self, data: bytearray, _timestamp: float) -> None:
        """End the run if the drive's answers are late by its own clock."""
        if self.settings.drive_clock is not None and len(data) == 4:
            delay = self._life.answer_delay.see(int.from_bytes(data, "little"), self._clock.now())
            if delay:
                self._emergency = (
                    f"its answers are {delay:.3f} s late by its own clock; {LONGEST_DELAY_S:g} s are allowed"
                )

    def _on_change(self, data: bytearray, _timestamp: float) -> None:
        """Notice that the drive leaves operation between two SYNCs: the held controlword would enable it again."""
        state = cia402.state_of(int.from_bytes(data, "little"))
        has_left_operation = self._enable_by == NEVER and self._mode is not OFF and state is not ENABLED
        # a fault stays, and its emergency message says more
        if has_left_operation and state not in FAULT_STATES and not self._emergency:
            self._emergency = f"left operation by itself, {state}, statusword 0x{int.from_bytes(data, 'little'):04X}"

    def _on_other_host(self, _data: bytearray, _timestamp: float) -> None:
        """Report that another device sends heartbeats with the host's node."""
        node = self.settings.host_node
        self._report_other_master(
            f"another device sends heartbeats as node {node} (0x{0x700 + node:03X}), so that the drive would not notice"
            " the host's end; give host_node a number that no device on the bus has"
        )

    def _report_other_master(self, text: str) -> None:
        """End the run, or refuse the start, because of what another master does.

        Resetting a fault does not excuse it.
        """
        self._condition.other_master_text = self._condition.other_master_text or text
        self._emergency = self._emergency or text

    def _on_other_demand(self, data: bytearray, _timestamp: float) -> None:
        """Report a demand of another master, which the drive may have followed already."""
        self._report_other_master(
            f"another master on the bus sends demands to node {self._node} ({bytes(data).hex() or 'an empty PDO'})"
        )

    def _on_other_request(self, data: bytearray, _timestamp: float) -> None:
        """Report an SDO request of another master: a write ends the run, a read is reported once."""
        condition = self._condition
        request_text = f"by SDO ({bytes(data).hex() or 'empty'})"
        if data and data[0] >> 5 in DOWNLOAD_COMMANDS:
            self._report_other_master(f"another master on the bus writes to node {self._node} {request_text}")
        elif not condition.is_read_by_others:
            condition.is_read_by_others = True
            condition.notices.append(
                f"another master on the bus reads from node {self._node} {request_text}; answers to both may be mixed"
                " up"
            )

    def _on_sdo(self, data: bytearray, timestamp: float) -> None:
        """Take the bus voltage or the status of the safe torque off; pass other answers on to the present transfer."""
        has_four_bytes = len(data) == 8 and data[0] in FOUR_BYTE_COMMANDS
        if data[1:4] == STO_STATUS:
            if has_four_bytes:
                self._condition.sto_status = int.from_bytes(data[4:8], "little")
        elif data[1:4] != BUS_VOLTAGE:
            self._sdo.on_frame(data, timestamp)
        elif has_four_bytes:
            self._condition.rows.append(
                Row(f"{self.name}_supply", self._clock.now(), (int.from_bytes(data[4:8], "little") * 1e-3,))
            )
        elif not self._condition.voltage_refused:
            self._condition.voltage_refused = True
            self._condition.notices.append(
                f"0x6079 (bus voltage) is answered by {bytes(data).hex()}; 43796000 and four bytes were expected: there"
                " is no bus voltage"
            )

    def _on_heartbeat(self, data: bytearray, _timestamp: float) -> None:
        """Receive a heartbeat, of which only "operational" is a sign of life.

        Heartbeats from before the node's start may still arrive after it.
        """
        state, condition = (data[0] & 0x7F if data else -1), self._condition
        if state == OPERATIONAL:
            condition.operational = condition.started
            self._note_heartbeat()
        elif condition.started and (condition.operational or state == BOOT_UP) and not self._emergency:
            state_text = NETWORK_STATES.get(state, f"heartbeat {bytes(data).hex() or 'empty'}")
            self._emergency = f"node {self._node} rebooted or left the operational state ({state_text})"

    def _note_heartbeat(self) -> None:
        """Set the time by which the next heartbeat has to arrive."""
        self._life.heard_until = self._clock.now() + self._longest_silence

    @property
    def _longest_silence(self) -> float:
        """Longest time between two heartbeats [s]: three of their periods and the consumer heartbeat time."""
        return 3e-3 * self.settings.producer_heartbeat_ms + 1e-3 * self.settings.consumer_heartbeat_ms

    def _note_limiting(self, statusword: int) -> None:
        """Add a notice that the drive limits its demand."""
        now, condition = self._clock.now(), self._condition
        if now >= condition.limiting_quiet_until:
            condition.limiting_quiet_until = now + NOTICE_PERIOD_S
            condition.notices.append(f"the drive limits its demand by itself (bit 11 of statusword 0x{statusword:04X})")

    def _on_emergency(self, data: bytearray, _timestamp: float) -> None:
        if len(data) != emergency.LENGTH or emergency.code_of(data) != emergency.CODE_RESET:
            self._emergency = emergency.describe(data)

    def _check_operation(self, now: float) -> None:
        """Raise the reason why the drive is not in operation although it should be."""
        if self._emergency:
            raise DeviceFault(f"{self.name}: {self._emergency}")
        if now > self._life.heard_until:
            silence = now - self._life.heard_until + self._longest_silence
            raise NoAnswer(f"{self.name}: no heartbeat of node {self._node} for {silence:.3f} s")
        if self.state in FAULT_STATES:
            raise DeviceFault(f"{self.name}: {self.state}, statusword 0x{self.statusword:04X}")
        if self._mode is OFF:
            return
        if self._enable_by == NEVER:
            raise DeviceFault(
                f"{self.name}: left operation by itself, {self.state}, statusword 0x{self.statusword:04X}"
            )
        condition, life = self._condition, self._life
        if (
            now > self._enable_by - ENABLE_TIME_S / 2
            and not condition.sto_requested
            and now > life.sdo_requested_at + SDO_PAUSE_S
        ):
            condition.sto_requested, life.sdo_requested_at = True, now
            self._port.send(0x600 + self._node, READ_STO_STATUS)
        if now > self._enable_by:
            text = f"{self.name}: not in operation after {ENABLE_TIME_S:g} s: {self.state}, 0x{self.statusword:04X}"
            if self._reported_mode != self._mode_number:
                raise NoAnswer(f"{text}, mode {self._reported_mode} (0x6061) where {self._mode_number} was asked for")
            sto_status = condition.sto_status
            sto_text = "" if sto_status is None else f", safe torque off 0x2086 is 0x{sto_status:08X}"
            raise NoAnswer(f"{text}{sto_text}; look at its safe torque off, its inhibit inputs and its brake")
