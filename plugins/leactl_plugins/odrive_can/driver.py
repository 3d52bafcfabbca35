"""ODrive motor controllers over CAN: CAN Simple of firmware 0.6, one query per cycle for each reading.

The README of this plug-in lists the sources, and what has to be verified on a real drive.
"""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, ClassVar

from leactl.driver.answer_matching import Answers, IrregularAnswers
from leactl.driver.can_port import CanPort
from leactl.driver.clock import Clock
from leactl.driver.contract import Confirmation, Identity, Mode, Row, StreamSpec, drive_channels
from leactl.driver.engaging_drive import EngagingDrive
from leactl.driver.far_end import CanEmulator, Physics
from leactl.driver.safe_state import send_at_once
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer
from leactl.quantities import ChannelSpec
from leactl_plugins.odrive_can import endpoints
from leactl_plugins.odrive_can.can_simple import (
    HEARTBEAT,
    MODES,
    NODE_SHIFT,
    ONE_FLOAT,
    POSITION,
    PROTOCOL,
    REPEATED_QUERIES,
    STATE,
    TWO_FLOATS,
    VERSION,
    WATCHDOG_TIMER_EXPIRED,
    AxisState,
    Command,
    ControlMode,
    InputMode,
    error_names,
    hardware_and_firmware,
)
from leactl_plugins.odrive_can.parameters import Parameters
from leactl_plugins.odrive_can.probe import OdriveProbe
from leactl_plugins.odrive_can.settings import OdriveSettings

CURRENT, VELOCITY, ANGLE = range(3)  # indices of the references in `values`
REFERENCES_AND_MODES = {
    Mode.CURRENT: (CURRENT, ControlMode.TORQUE, InputMode.PASSTHROUGH),
    Mode.TORQUE_PROFILE: (CURRENT, ControlMode.TORQUE, InputMode.TORQUE_RAMP),
    Mode.VELOCITY: (VELOCITY, ControlMode.VELOCITY, InputMode.PASSTHROUGH),
    Mode.ANGLE: (ANGLE, ControlMode.POSITION, InputMode.PASSTHROUGH),
}
READ_BACK_PARAMETERS = (
    endpoints.CONTROL_MODE,
    endpoints.INPUT_MODE,
    endpoints.ENABLE_WATCHDOG,
    endpoints.WATCHDOG_TIMEOUT,
)
ENCODER, IQ = range(2)  # the readings that are queried every cycle
AMPLITUDE_PER_Q_AXIS = math.sqrt(2.0 / 3.0)  # of a phase current, per ampere of the power-invariant q axis
TURN = 2.0 * math.pi
FARTHEST_TURNS = 1024.0  # up to this position, single precision resolves 0.4 mrad
ENABLE_TIME_S = 2.0  # time for the drive to enter operation
STEP_PAUSE_S = 0.1  # time for the drive to report one step towards operation, before the step is repeated
SECOND_ANSWER_S = 0.01  # time for a second drive of the same node to answer too
NOTICE_PERIOD_S = 1.0  # at most one notice of irregular answers in this time
NAN = math.nan


class OdriveCan(EngagingDrive):
    """One axis; its readings are queried and its input is sent every cycle, which also feeds its watchdog."""

    Settings = OdriveSettings
    transport = "can"
    summary = "ODrive S1, Pro or Micro over CAN (CAN Simple, firmware 0.6)"
    example: ClassVar[Mapping[str, Any]] = {"node": 3, "endpoints": endpoints.EMULATED_TABLE}
    modes = REFERENCES_AND_MODES
    enable_time_s = ENABLE_TIME_S
    probe = OdriveProbe()

    def __init__(self, name: str, role: str, settings: OdriveSettings, port: CanPort, clock: Clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        self._port, self._clock = port, clock
        self._base = settings.node << NODE_SHIFT
        self._parameters = Parameters(name, port, settings.node, settings.table, settings.answer_timeout_s)
        self._connected = False
        self._rad_per_turn = settings.sign * TURN  # rad per turn of the drive
        self._torque_per_ampere = self._highest_current = self._highest_turns_per_s = NAN
        self._identity = Identity()
        self._version: tuple[int, ...] = ()
        self._versions: list[tuple[int, ...]] = []  # received since the list was last cleared
        # whether each came since the last wait; lists, because the port watches their items
        self._heartbeat_came, self._version_came = [False], [False]
        self._heard_until = -math.inf  # time [s] by which the next heartbeat has to arrive
        self.axis_state, self.errors = 0, 0
        self._original_values: dict[str, float] = {}  # of parameters that are restored at `close`, by path
        self._safe = False  # whether it has confirmed to be idle, and has got no demand since
        self._shaft_turns = NAN  # turns, position of the shaft as last reported
        self._bus_voltage_due = -math.inf
        self._rows: list[Row] = []
        self._answers = Answers(2)
        self._reported_irregular, self._quiet_until = IrregularAnswers(), -math.inf
        self._supervised = False  # whether `feed` was called since the last input, so that the next may be sent
        self._mode, self._reference, self._demanded_value = Mode.OFF, ANGLE, 0.0
        self._control_mode = self._input_mode = 0
        self._enable_by, self._next_step_at = math.inf, -math.inf
        self._asked_closed_loop = False
        # current, velocity and angle, since the last query
        self._references_in_force = [NAN, NAN, NAN]
        self.values = [NAN] * len(self.loop_channels)

    def safe_state(self, deadline_s: float) -> Confirmation:
        """Set the axis idle, from any state, over a new connection if needed; never raises."""
        self._follow(Mode.OFF)
        deadline = self._clock.now() + deadline_s
        reason = "no time was left"
        while self._clock.now() < deadline:
            try:
                self._connect()
                self._port.take_waiting()  # drop frames sent before the command
                self._set_state(AxisState.IDLE)
                answer_deadline = min(deadline, self._clock.now() + 0.25)
                # the version first, so that the heartbeat was sent after the command
                has_answered = self._wait_for_version(answer_deadline) and self._wait_for_heartbeat(answer_deadline)
            except DeviceError as error:
                has_answered, reason = False, str(error)
                self._clock.sleep_until(min(deadline, self._clock.now() + 0.01))
            else:
                reason = f"state {self.axis_state}" if has_answered else "no heartbeat"
            if has_answered and self.axis_state == AxisState.IDLE:
                self._safe = True
                return Confirmation(True, "axis idle")
            if not has_answered:
                with suppress(DeviceError):
                    self._port.reopen()
        return Confirmation(False, f"not confirmed within {deadline_s:g} s: {reason}")

    def stop_now(self) -> None:
        """Send the command that sets the axis idle, without waiting; over a new connection if needed."""
        self._follow(Mode.OFF)
        send_at_once(self._set_idle, self._port, lambda: self._connected)

    def _set_idle(self) -> None:
        """Send the command that sets the axis idle."""
        self._connect()
        self._set_state(AxisState.IDLE)

    def open(self) -> None:
        """Connect to the drive, set it idle, check its firmware, read its scales, and set its watchdog's timeout.

        Raises
        ------
        DeviceError : the drive is absent, shares its node, has another firmware than the table, or refuses a setting.
        DeviceFault : it has an error.
        """
        self._connect()
        self._answers, self._safe, self._original_values = Answers(2), False, {}
        self._set_state(AxisState.IDLE)
        self._identify()
        self._set_until_close(endpoints.HEARTBEAT_PERIOD, self.settings.heartbeat_ms)  # it may not have sent any so far
        if not self._wait_for_heartbeat(self._clock.now() + 0.5):
            raise NoAnswer(f"{self.name}: node {self.settings.node} answers, and sends no heartbeat")
        self._clear_errors()
        if self.axis_state != AxisState.IDLE:
            raise DeviceError(f"{self.name}: the axis does not become idle, state {self.axis_state}")
        self._read_scales()
        self._set_until_close(endpoints.WATCHDOG_TIMEOUT, self.settings.host_silence_s)
        self._set_until_close(endpoints.ENCODER_PERIOD, 0)
        self._set_until_close(endpoints.CURRENT_PERIOD, 0)
        self._original_values[endpoints.ENABLE_WATCHDOG] = self._parameters.read(endpoints.ENABLE_WATCHDOG)

    def close(self) -> None:
        """Stop listening and close the bus; the changed parameters of a safe drive are restored."""
        if self._connected:
            if self._safe:
                with suppress(DeviceError):  # the drive is safe; parameters that stay changed do no harm
                    for path, value in reversed(self._original_values.items()):
                        self._parameters.write(path, value)
            self._connected = False
            for identifier in self._listeners():
                self._port.listen(identifier, None)
            self._port.close()

    @classmethod
    def far_end(cls, settings: OdriveSettings, role: str, physics: Physics) -> CanEmulator:
        """Return an emulated drive at this node that turns the bench's motor."""
        from leactl_plugins.odrive_can.emulator import OdriveEmulator

        return OdriveEmulator(
            settings.node,
            physics.machine(role),
            settings.table,
            torque_constant=settings.emulated_torque_constant_Nm_per_A,
            current_soft_max=settings.emulated_current_soft_max_A,
        )

    def identity(self) -> Identity:
        """Return hardware and firmware as read at `open`; the protocol has no message for a serial number."""
        return self._identity

    # -- one cycle ---------------------------------------------------------------------------------------------------

    @property
    def loop_channels(self) -> tuple[ChannelSpec, ...]:
        """Channels of `values`: the readings, and the references that were in force until they were queried."""
        return drive_channels(self.role, self.name)

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """Stream of the bus voltage and current, which are queried at their own rate."""
        channels = (
            ChannelSpec("vbus", "bus_voltage", self.role, self.name, "DC link voltage"),
            ChannelSpec("ibus", "bus_current", self.role, self.name, "DC link current"),
        )
        return (StreamSpec(f"{self.name}_supply", channels),)

    @property
    def engaged(self) -> bool:
        """Whether the axis reports closed loop, and has before reported the demanded mode and an armed watchdog."""
        return (
            self._asked_closed_loop
            and self.axis_state == AxisState.CLOSED_LOOP_CONTROL
            and (self._enable_by == -math.inf or self._is_ready())
        )

    def command(self, value: float) -> None:
        """Set the demand of the engaged mode (A, rad/s or rad) for the next cycle.

        Raises
        ------
        InputError : not finite, or above the drive's limit, to which it would clip the demand without a message.
        """
        if self._reference == CURRENT:
            highest, units, source = self._highest_current, "A", endpoints.CURRENT_SOFT_MAX
        elif self._reference == VELOCITY:
            highest, units, source = TURN * self._highest_turns_per_s, "rad/s", endpoints.VELOCITY_LIMIT
        else:
            highest, units, source = TURN * FARTHEST_TURNS, "rad", "single precision"
        if not abs(value) <= highest:
            raise InputError(f"{self.name}: a demand of {value:g} {units} is above {highest:g} {units} ({source})")
        self._demanded_value = value

    def begin_cycle(self) -> None:
        """Send this cycle's demand, and query the readings.

        Demands alone feed the drive's watchdog: one is sent only after a supervised cycle.
        """
        answers = self._answers
        if answers.watched:
            self._port.take_waiting()
            answers.begin(self._clock.now())
        answers.came[ENCODER] = answers.came[IQ] = False
        if self._mode is Mode.OFF:
            if self.axis_state != AxisState.IDLE:
                self._set_state(AxisState.IDLE)  # until the drive reports it
        elif self._enable_by > -math.inf and not self.engaged:
            self._go_towards_operation(self._clock.now())
        if self._supervised:
            self._supervised = False
            self._send_input()
        self._send(Command.GET_ENCODER_ESTIMATES)
        self._send(Command.GET_IQ)

    def end_cycle(self, deadline: float) -> None:
        """Collect the readings; a reading that did not arrive is NaN.

        Raises
        ------
        DeviceFault : the drive has an error, or left operation by itself.
        NoAnswer : its heartbeat stayed away, or it did not enter operation in time.
        """
        answers, values = self._answers, self.values
        all_came = self._port.pump_until(answers.came, deadline)
        values[0], values[1], values[2] = self._references_in_force
        self._references_in_force = [NAN, NAN, NAN]
        if self._mode is not Mode.OFF:
            self._references_in_force[self._reference] = self._demanded_value
        engaged, now = self.engaged, self._clock.now()
        values[6] = 1.0 if engaged else 0.0
        if not all_came or answers.watched:
            encoder_came, iq_came, _ = answers.end(now)
            if not iq_came:
                values[3] = values[6] = NAN
            if not encoder_came:
                values[4] = values[5] = NAN
        if engaged:
            self._enable_by = -math.inf  # from now on, only the drive itself can leave operation
        self._check_operation(now, engaged)

    def feed(self) -> None:
        """Allow the next demand, which feeds the drive's watchdog; query the bus voltage if that is due."""
        self._supervised = True
        now = self._clock.now()
        if now >= self._bus_voltage_due:
            self._bus_voltage_due = now + self.settings.bus_voltage_period_s
            self._send(Command.GET_BUS_VOLTAGE_CURRENT)
            self._answers.watched = True  # an answer that came twice would shift all later answers

    def take(self) -> list[Row]:
        """Return the bus voltages and currents since the last call."""
        rows, self._rows = self._rows, []
        return rows

    def notices(self) -> list[str]:
        """Return notices of irregular answers and of a full bus."""
        lines, now = [], self._clock.now()
        irregular = self._answers.irregular
        if irregular != self._reported_irregular and (now >= self._quiet_until or self._mode is Mode.OFF):
            self._quiet_until, self._reported_irregular = now + NOTICE_PERIOD_S, replace(irregular)
            lines.append(str(irregular))
        return lines + self._port.notices()

    # -- entering operation ------------------------------------------------------------------------------------------

    def _follow(self, mode: Mode) -> None:
        """Change to a mode with zero demand; earlier reports of the drive belong to the previous mode."""
        self._mode, self._demanded_value = mode, 0.0
        self._reference, self._control_mode, self._input_mode = REFERENCES_AND_MODES.get(mode, (ANGLE, 0, 0))
        self._enable_by, self._next_step_at = math.inf, -math.inf
        self._asked_closed_loop, self.axis_state = False, AxisState.UNDEFINED
        for path in READ_BACK_PARAMETERS:
            self._parameters.reported.pop(path, None)

    def _query_again(self) -> None:
        """Query again the parameters that the drive must report before it is engaged."""
        for path in READ_BACK_PARAMETERS:
            self._parameters.reported.pop(path, None)
            self._parameters.ask(path)

    def _is_ready(self) -> bool:
        """Return whether the drive reports the demanded mode, and a watchdog armed with the time set at `open`."""
        has_reported = self._parameters.has_reported
        return (
            has_reported(endpoints.CONTROL_MODE, self._control_mode)
            and has_reported(endpoints.INPUT_MODE, self._input_mode)
            and has_reported(endpoints.ENABLE_WATCHDOG, 1.0)
            and has_reported(endpoints.WATCHDOG_TIMEOUT, self.settings.host_silence_s)
        )

    def _go_towards_operation(self, now: float) -> None:
        """Take the next step towards operation: idle, demanded mode, armed watchdog, closed loop.

        In angle mode, the present angle is held until then.
        """
        if self._reference == ANGLE:
            self._demanded_value = self._shaft_turns * self._rad_per_turn
        if math.isnan(self._shaft_turns) or now < self._next_step_at or self.axis_state == AxisState.UNDEFINED:
            return  # until the drive has reported its angle and its state
        if not self._asked_closed_loop and self.axis_state != AxisState.IDLE:
            self._set_state(AxisState.IDLE)
        elif not self._is_ready():
            self._send(Command.SET_CONTROLLER_MODE, MODES.pack(self._control_mode, self._input_mode))
            self._parameters.send(endpoints.ENABLE_WATCHDOG, 1)
            self._query_again()
        elif self.axis_state != AxisState.CLOSED_LOOP_CONTROL:
            if not self._supervised:
                return
            self._send_input()  # before closed loop, so that the axis never follows an input left by another host
            self._set_state(AxisState.CLOSED_LOOP_CONTROL)
            self._query_again()  # a drive that has restarted since its report obeys, with other parameters
            self._asked_closed_loop = True
        self._next_step_at = now + STEP_PAUSE_S

    def _send_input(self) -> None:
        """Send the demand as the input of the mode."""
        if self._reference == VELOCITY:
            self._send(Command.SET_INPUT_VEL, TWO_FLOATS.pack(self._demanded_value / self._rad_per_turn, 0.0))
        elif self._mode is Mode.ANGLE:
            self._send(Command.SET_INPUT_POS, POSITION.pack(self._demanded_value / self._rad_per_turn, 0, 0))
        elif self._reference == CURRENT:
            self._send(Command.SET_INPUT_TORQUE, ONE_FLOAT.pack(self._demanded_value * self._torque_per_ampere))
        else:
            self._send(Command.SET_INPUT_TORQUE, ONE_FLOAT.pack(0.0))

    def _check_operation(self, now: float, engaged: bool) -> None:
        """Raise the reason why the drive is not in operation although it should be."""
        if self.errors:
            raise DeviceFault(f"{self.name}: {error_names(self.errors)}")
        if now > self._heard_until:
            raise NoAnswer(f"{self.name}: no heartbeat of node {self.settings.node} for {self._longest_silence:.3f} s")
        if self._mode is Mode.OFF or engaged:
            return
        if self._enable_by == -math.inf:
            raise DeviceFault(f"{self.name}: left operation by itself, state {self.axis_state}")
        expected, timeout = self.settings.host_silence_s, self._parameters.reported.get(endpoints.WATCHDOG_TIMEOUT)
        if timeout is not None and not self._parameters.reads_back_as(timeout, expected):
            raise DeviceFault(
                f"{self.name}: {endpoints.WATCHDOG_TIMEOUT} is {timeout:g} s although {expected:g} s was set when it"
                " was opened: it has restarted, or another host has set it; open it again"
            )
        if now > self._enable_by:
            unready_text = "" if self._is_ready() else "; it has not shown the mode asked for and an armed watchdog"
            raise NoAnswer(
                f"{self.name}: not in operation after {ENABLE_TIME_S:g} s: state {self.axis_state}{unready_text}"
            )

    # -- set-up ------------------------------------------------------------------------------------------------------

    def _connect(self) -> None:
        """Open the bus and listen to the drive; open it again if it was lost."""
        if not self._connected:
            self._port.open()
            self._connected = True
            for identifier, listener in self._listeners().items():
                self._port.listen(identifier, listener)
        elif self._port.bus is None:
            self._port.reopen()

    def _listeners(self) -> dict[int, Any]:
        """Return the listeners to the drive's frames, by CAN identifier."""
        return {
            self._base | Command.GET_VERSION: self._on_version,
            self._base | Command.HEARTBEAT: self._on_heartbeat,
            self._base | Command.TX_SDO: self._parameters.on_frame,
            self._base | Command.GET_ENCODER_ESTIMATES: self._on_encoder,
            self._base | Command.GET_IQ: self._on_iq,
            self._base | Command.GET_BUS_VOLTAGE_CURRENT: self._on_bus,
        }

    def _identify(self) -> None:
        """Check that one drive of this node answers and has the firmware of the table of endpoints.

        Raises
        ------
        NoAnswer : no drive of this node reports its version.
        DeviceError : two drives answer, or the protocol, firmware or hardware is another one.
        """
        self._versions.clear()
        query_count = next((count for count in (1, 2, 3) if self._wait_for_version(self._clock.now() + 0.25)), 0)
        if not query_count:
            raise NoAnswer(f"{self.name}: node {self.settings.node} does not tell its version; node, bit rate, power?")
        if self._is_shared(query_count):
            raise DeviceError(
                f"{self.name}: two drives answer as node {self.settings.node}; connect one of them alone and give it"
                " another axis0.config.can.node_id"
            )
        protocol, (hardware, firmware) = self._version[0], hardware_and_firmware(self._version)
        self._identity = Identity(f"ODrive {hardware}", "", firmware)
        table = self.settings.table
        if protocol != PROTOCOL:
            raise DeviceError(f"{self.name}: speaks protocol {protocol}; {PROTOCOL} of firmware 0.6 was expected")
        if (firmware, hardware) != (table.firmware, table.hardware):
            raise DeviceError(
                f"{self.name}: firmware {firmware} on hardware {hardware}; '{self.settings.endpoints}' is of"
                f" {table.firmware} on {table.hardware}"
            )

    def _is_shared(self, query_count: int) -> bool:
        """Return whether two drives answer as this node: different versions came, or too many at each repeated query.

        A disturbed end of frame makes a sender repeat a frame that has arrived (ISO 11898-1): one frame too many may be
        of one drive. A second drive answers every query.
        """
        self._port.pump_until((False,), self._clock.now() + SECOND_ANSWER_S)
        if len(self._versions) <= query_count:
            return False
        for _ in range(REPEATED_QUERIES):
            if len(set(self._versions)) > 1:
                return True
            self._versions.clear()
            self._wait_for_version(self._clock.now() + 0.25)
            self._port.pump_until((False,), self._clock.now() + SECOND_ANSWER_S)
            if len(self._versions) > 1:
                return True
        return False

    def _set_until_close(self, path: str, value: float) -> None:
        """Set a parameter that is restored at `close`."""
        original_value = self._parameters.read(path)
        self._parameters.write(path, value)
        self._original_values[path] = original_value

    def _clear_errors(self) -> None:
        """Clear the error that the end of an earlier host has left, and other errors if the settings say so.

        Raises
        ------
        DeviceFault : an error remains.
        """
        if self.errors and (self.settings.reset_fault_at_start or self.errors == WATCHDOG_TIMER_EXPIRED):
            self._send(Command.CLEAR_ERRORS, b"\x00")
            answer_deadline = self._clock.now() + 0.25
            if not (self._wait_for_version(answer_deadline) and self._wait_for_heartbeat(answer_deadline)):
                raise NoAnswer(f"{self.name}: does not answer after its errors were cleared")
        if self.errors:
            raise DeviceFault(
                f"{self.name}: {error_names(self.errors)}; reset_fault_at_start: true clears it when its cause is gone"
            )

    def _read_scales(self) -> None:
        """Read the scale of the current and the limits of demands; raise DeviceError if the scale is not positive."""
        read = self._parameters.read
        torque_constant, highest_amplitude, highest_turns_per_s = (
            read(path) for path in (endpoints.TORQUE_CONSTANT, endpoints.CURRENT_SOFT_MAX, endpoints.VELOCITY_LIMIT)
        )
        if not (math.isfinite(torque_constant) and torque_constant > 0.0):
            raise DeviceError(
                f"{self.name}: {endpoints.TORQUE_CONSTANT} is {torque_constant:g}; more than 0 was expected"
            )
        self._torque_per_ampere = self.settings.sign * torque_constant * AMPLITUDE_PER_Q_AXIS
        self._highest_current, self._highest_turns_per_s = highest_amplitude / AMPLITUDE_PER_Q_AXIS, highest_turns_per_s

    def _wait_for_version(self, deadline: float) -> bool:
        """Query the version; return whether it came, and with it all earlier frames, since frames keep their order."""
        self._version_came[0] = False
        self._send(Command.GET_VERSION)
        return self._port.pump_until(self._version_came, deadline)

    def _wait_for_heartbeat(self, deadline: float) -> bool:
        """Wait for the next heartbeat; return whether it came."""
        self._heartbeat_came[0] = False
        return self._port.pump_until(self._heartbeat_came, deadline)

    # -- frames ------------------------------------------------------------------------------------------------------

    def _send(self, command: Command, data: bytes = b"") -> None:
        self._port.send(self._base | command, data)

    def _set_state(self, state: AxisState) -> None:
        self._send(Command.SET_AXIS_STATE, STATE.pack(state))

    @property
    def _longest_silence(self) -> float:
        """Longest allowed silence of a drive [s]: three of its heartbeats plus a margin for the host."""
        return 1e-3 * (3 * self.settings.heartbeat_ms + self.settings.watchdog_ms)

    def _on_version(self, data: bytearray, _timestamp: float) -> None:
        if len(data) == VERSION.size:
            self._version, self._version_came[0] = VERSION.unpack(data), True
            self._versions.append(self._version)

    def _on_heartbeat(self, data: bytearray, _timestamp: float) -> None:
        if len(data) == HEARTBEAT.size:
            self.errors, self.axis_state, *_ = HEARTBEAT.unpack(data)
            self._heartbeat_came[0] = True
            self._heard_until = self._clock.now() + self._longest_silence

    def _on_encoder(self, data: bytearray, _timestamp: float) -> None:
        """Take position and velocity, the first answer of a cycle."""
        if len(data) == TWO_FLOATS.size:
            answers = self._answers
            if answers.watched and not answers.take(ENCODER, self._clock.now()):
                return
            self._shaft_turns, turns_per_s = TWO_FLOATS.unpack(data)
            self.values[4], self.values[5] = turns_per_s * self._rad_per_turn, self._shaft_turns * self._rad_per_turn
            answers.came[ENCODER] = True

    def _on_iq(self, data: bytearray, _timestamp: float) -> None:
        """Take the measured current, the second answer of a cycle."""
        if len(data) == TWO_FLOATS.size:
            answers = self._answers
            if answers.watched:
                if not answers.take(IQ, self._clock.now()):
                    return
            elif not answers.came[ENCODER]:
                answers.leave_out()
                return
            self.values[3] = self.settings.sign * TWO_FLOATS.unpack(data)[1] / AMPLITUDE_PER_Q_AXIS
            answers.came[IQ] = True

    def _on_bus(self, data: bytearray, _timestamp: float) -> None:
        if len(data) == TWO_FLOATS.size:
            self._rows.append(Row(f"{self.name}_supply", self._clock.now(), TWO_FLOATS.unpack(data)))
