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
AMPLITUDE = math.sqrt(2.0 / 3.0)  # of a phase current, per ampere of the power-invariant q axis
TURN = 2.0 * math.pi
FARTHEST_TURNS = 1024.0  # up to there, single precision resolves 0.4 mrad
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
        self._turn = settings.sign * TURN  # rad per turn of the drive
        self._torque_per_ampere = self._most_current = self._most_turns_s = NAN
        self._identity = Identity()
        self._version: tuple[int, ...] = ()
        self._versions: list[tuple[int, ...]] = []  # received since the first query
        self._beat, self._version_came = [False], [False]  # whether each arrived since the last wait
        self._heard_until = -math.inf
        self.axis_state, self.errors = 0, 0
        self._values_before: dict[str, float] = {}  # parameters that are restored at `close`
        self._safe = False  # whether it has confirmed to be idle, and got no demand since
        self._turns = NAN  # turns, reported position of the shaft
        self._bus_voltage_due = -math.inf
        self._rows: list[Row] = []
        self._answers = Answers(2)
        self._reported, self._quiet_until = IrregularAnswers(), -math.inf
        self._supervised = False  # whether `feed` was called since the last input, so that the next may be sent
        self._mode, self._reference, self._value = Mode.OFF, ANGLE, 0.0
        self._control_mode = self._input_mode = 0
        self._enable_by, self._ask_at = math.inf, -math.inf
        self._asked_closed_loop = False
        self._followed = [NAN, NAN, NAN]  # current, velocity and angle references in force since the last query
        self.values = [NAN] * len(self.loop_channels)

    def safe_state(self, deadline_s: float) -> Confirmation:
        """Set the axis idle, from any state, over a new connection if needed; never raises."""
        self._follow(Mode.OFF)
        until = self._clock.now() + deadline_s
        reason = "no time was left"
        while self._clock.now() < until:
            try:
                self._connect()
                self._port.take_waiting()  # drop frames sent before the command
                self._set_state(AxisState.IDLE)
                soon = min(until, self._clock.now() + 0.25)
                # the version first, so that the heartbeat was sent after the command
                heard = self._wait_for_version(soon) and self._wait_for_heartbeat(soon)
            except DeviceError as error:
                heard, reason = False, str(error)
                self._clock.sleep_until(min(until, self._clock.now() + 0.01))
            else:
                reason = f"state {self.axis_state}" if heard else "no heartbeat"
            if heard and self.axis_state == AxisState.IDLE:
                self._safe = True
                return Confirmation(True, "axis idle")
            if not heard:
                with suppress(DeviceError):
                    self._port.reopen()
        return Confirmation(False, f"not confirmed within {deadline_s:g} s: {reason}")

    def stop_now(self) -> None:
        """Send the command that sets the axis idle, without waiting; over a new connection if needed."""
        self._follow(Mode.OFF)
        send_at_once(self._set_idle, self._port, lambda: self._connected)

    def _set_idle(self) -> None:
        self._connect()
        self._set_state(AxisState.IDLE)

    def open(self) -> None:
        """Connect to the drive, set it idle, check its firmware, read its scales, and set its watchdog's timeout.

        Raises
        ------
        DeviceError : the drive is absent, shares its node, has another firmware than the table, or refuses a setting;
            `DeviceFault` if it has an error.
        """
        self._connect()
        self._answers, self._safe, self._values_before = Answers(2), False, {}
        self._set_state(AxisState.IDLE)
        self._identify()
        self._set_until_close(endpoints.HEARTBEAT_PERIOD, self.settings.heartbeat_ms)  # it may have sent none so far
        if not self._wait_for_heartbeat(self._clock.now() + 0.5):
            raise NoAnswer(f"{self.name}: node {self.settings.node} answers, and sends no heartbeat")
        self._clear_errors()
        if self.axis_state != AxisState.IDLE:
            raise DeviceError(f"{self.name}: the axis does not become idle, state {self.axis_state}")
        self._read_scales()
        self._set_until_close(endpoints.WATCHDOG_TIMEOUT, self.settings.host_silence_s)
        self._set_until_close(endpoints.ENCODER_PERIOD, 0)
        self._set_until_close(endpoints.CURRENT_PERIOD, 0)
        self._values_before[endpoints.ENABLE_WATCHDOG] = self._parameters.read(endpoints.ENABLE_WATCHDOG)

    def close(self) -> None:
        """Stop listening and close the bus; the changed parameters of a safe drive are restored."""
        if self._connected:
            if self._safe:
                with suppress(DeviceError):  # the drive is safe; parameters that stay changed do no harm
                    for path, value in reversed(self._values_before.items()):
                        self._parameters.write(path, value)
            self._connected = False
            for identifier in self._listeners():
                self._port.listen(identifier, None)
            self._port.close()

    @classmethod
    def far_end(cls, settings: OdriveSettings, role: str, physics: Physics) -> CanEmulator:
        """A drive at this node that turns the bench's motor."""
        from leactl_plugins.odrive_can.emulator import OdriveEmulator

        return OdriveEmulator(
            settings.node,
            physics.machine(role),
            settings.table,
            torque_constant=settings.emulated_torque_constant_Nm_per_A,
            current_soft_max=settings.emulated_current_soft_max_A,
        )

    def identity(self) -> Identity:
        """Hardware and firmware as read when it was opened; the protocol has no message for a serial number."""
        return self._identity

    # -- one cycle ---------------------------------------------------------------------------------------------------

    @property
    def loop_channels(self) -> tuple[ChannelSpec, ...]:
        """Channels of `values`: the readings, and the references that were in force until they were queried."""
        return drive_channels(self.role, self.name)

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """The bus voltage and current, queried at their own rate."""
        channels = (
            ChannelSpec("vbus", "bus_voltage", self.role, self.name, "DC link voltage"),
            ChannelSpec("ibus", "bus_current", self.role, self.name, "DC link current"),
        )
        return (StreamSpec(f"{self.name}_supply", channels),)

    @property
    def engaged(self) -> bool:
        """Whether the axis reports closed loop, after it has reported the demanded mode and an armed watchdog."""
        return (
            self._asked_closed_loop
            and self.axis_state == AxisState.CLOSED_LOOP_CONTROL
            and (self._enable_by == -math.inf or self._is_ready())
        )

    def command(self, value: float) -> None:
        """Set the demand of the engaged mode (A, rad/s or rad) for the next cycle.

        Raises
        ------
        InputError : not finite, or above the drive's limit, at which it would clip the demand without a message.
        """
        if self._reference == CURRENT:
            most, units, where = self._most_current, "A", endpoints.CURRENT_SOFT_MAX
        elif self._reference == VELOCITY:
            most, units, where = TURN * self._most_turns_s, "rad/s", endpoints.VELOCITY_LIMIT
        else:
            most, units, where = TURN * FARTHEST_TURNS, "rad", "single precision"
        if not abs(value) <= most:
            raise InputError(f"{self.name}: a demand of {value:g} {units} is above {most:g} {units} ({where})")
        self._value = value

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
        """Collect the readings; NaN for one that did not arrive.

        Raises
        ------
        DeviceFault : the drive has an error, or left operation by itself.
        NoAnswer : its heartbeat stayed away, or it did not enter operation in time.
        """
        answers, values = self._answers, self.values
        came = self._port.pump_until(answers.came, deadline)
        values[0], values[1], values[2] = self._followed
        self._followed = [NAN, NAN, NAN]
        if self._mode is not Mode.OFF:
            self._followed[self._reference] = self._value
        engaged, now = self.engaged, self._clock.now()
        values[6] = 1.0 if engaged else 0.0
        if not came or answers.watched:
            encoder, iq, _ = answers.end(now)
            if not iq:
                values[3] = values[6] = NAN
            if not encoder:
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
            self._answers.watched = True  # an answer that came twice would shift all later ones

    def take(self) -> list[Row]:
        """Bus voltages since the last call."""
        rows, self._rows = self._rows, []
        return rows

    def notices(self) -> list[str]:
        """Notices: irregular answers, and a full bus."""
        lines, now = [], self._clock.now()
        irregular = self._answers.irregular
        if irregular != self._reported and (now >= self._quiet_until or self._mode is Mode.OFF):
            self._quiet_until, self._reported = now + NOTICE_PERIOD_S, replace(irregular)
            lines.append(str(irregular))
        return lines + self._port.notices()

    # -- entering operation ------------------------------------------------------------------------------------------

    def _follow(self, mode: Mode) -> None:
        """Change to a mode with zero demand; earlier reports of the drive belong to the mode before."""
        self._mode, self._value = mode, 0.0
        self._reference, self._control_mode, self._input_mode = REFERENCES_AND_MODES.get(mode, (ANGLE, 0, 0))
        self._enable_by, self._ask_at = math.inf, -math.inf
        self._asked_closed_loop, self.axis_state = False, AxisState.UNDEFINED
        for path in READ_BACK_PARAMETERS:
            self._parameters.reported.pop(path, None)

    def _ask_back(self) -> None:
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
            self._value = self._turns * self._turn
        if math.isnan(self._turns) or now < self._ask_at or self.axis_state == AxisState.UNDEFINED:
            return  # until the drive has reported its angle and its state
        if not self._asked_closed_loop and self.axis_state != AxisState.IDLE:
            self._set_state(AxisState.IDLE)
        elif not self._is_ready():
            self._send(Command.SET_CONTROLLER_MODE, MODES.pack(self._control_mode, self._input_mode))
            self._parameters.send(endpoints.ENABLE_WATCHDOG, 1)
            self._ask_back()
        elif self.axis_state != AxisState.CLOSED_LOOP_CONTROL:
            if not self._supervised:
                return
            self._send_input()  # before closed loop, so that the axis never follows an input left by another host
            self._set_state(AxisState.CLOSED_LOOP_CONTROL)
            self._ask_back()  # a drive that has restarted since its report obeys, with other parameters
            self._asked_closed_loop = True
        self._ask_at = now + STEP_PAUSE_S

    def _send_input(self) -> None:
        if self._reference == VELOCITY:
            self._send(Command.SET_INPUT_VEL, TWO_FLOATS.pack(self._value / self._turn, 0.0))
        elif self._mode is Mode.ANGLE:
            self._send(Command.SET_INPUT_POS, POSITION.pack(self._value / self._turn, 0, 0))
        elif self._reference == CURRENT:
            self._send(Command.SET_INPUT_TORQUE, ONE_FLOAT.pack(self._value * self._torque_per_ampere))
        else:
            self._send(Command.SET_INPUT_TORQUE, ONE_FLOAT.pack(0.0))

    def _check_operation(self, now: float, engaged: bool) -> None:
        """Raise the reason why the drive is not in operation although it should be."""
        if self.errors:
            raise DeviceFault(f"{self.name}: {error_names(self.errors)}")
        if now > self._heard_until:
            raise NoAnswer(f"{self.name}: no heartbeat of node {self.settings.node} for {self._silence:.3f} s")
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
            missing = "" if self._is_ready() else "; it has not shown the mode asked for and an armed watchdog"
            raise NoAnswer(f"{self.name}: not in operation after {ENABLE_TIME_S:g} s: state {self.axis_state}{missing}")

    # -- set-up ------------------------------------------------------------------------------------------------------

    def _connect(self) -> None:
        if not self._connected:
            self._port.open()
            self._connected = True
            for identifier, listener in self._listeners().items():
                self._port.listen(identifier, listener)
        elif self._port.bus is None:
            self._port.reopen()

    def _listeners(self) -> dict[int, Any]:
        return {
            self._base | Command.GET_VERSION: self._on_version,
            self._base | Command.HEARTBEAT: self._on_heartbeat,
            self._base | Command.TX_SDO: self._parameters.on_frame,
            self._base | Command.GET_ENCODER_ESTIMATES: self._on_encoder,
            self._base | Command.GET_IQ: self._on_iq,
            self._base | Command.GET_BUS_VOLTAGE_CURRENT: self._on_bus,
        }

    def _identify(self) -> None:
        """Check that one drive of this node answers and has the firmware of the table of endpoints."""
        self._versions.clear()
        asked = next((count for count in (1, 2, 3) if self._wait_for_version(self._clock.now() + 0.25)), 0)
        if not asked:
            raise NoAnswer(f"{self.name}: node {self.settings.node} does not tell its version; node, bit rate, power?")
        if self._is_shared(asked):
            raise DeviceError(
                f"{self.name}: two drives answer as node {self.settings.node}; connect one of them alone and give it"
                " another axis0.config.can.node_id"
            )
        protocol, (board, firmware) = self._version[0], hardware_and_firmware(self._version)
        self._identity = Identity(f"ODrive {board}", "", firmware)
        table = self.settings.table
        if protocol != PROTOCOL:
            raise DeviceError(f"{self.name}: speaks protocol {protocol}; {PROTOCOL} of firmware 0.6 was expected")
        if (firmware, board) != (table.firmware, table.hardware):
            raise DeviceError(
                f"{self.name}: firmware {firmware} on hardware {board}; '{self.settings.endpoints}' is of"
                f" {table.firmware} on {table.hardware}"
            )

    def _is_shared(self, asked: int) -> bool:
        """Return whether two drives answer as this node: different versions came, or too many at each repeated query.

        A disturbed end of frame makes a sender repeat a frame that has arrived (ISO 11898-1): one frame too many may be
        of one drive. A second drive answers every query.
        """
        self._port.pump_until((False,), self._clock.now() + SECOND_ANSWER_S)
        if len(self._versions) <= asked:
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
        before = self._parameters.read(path)
        self._parameters.write(path, value)
        self._values_before[path] = before

    def _clear_errors(self) -> None:
        """Clear the error that the end of an earlier host left, and other errors if the settings say so."""
        if self.errors and (self.settings.reset_fault_at_start or self.errors == WATCHDOG_TIMER_EXPIRED):
            self._send(Command.CLEAR_ERRORS, b"\x00")
            soon = self._clock.now() + 0.25
            if not (self._wait_for_version(soon) and self._wait_for_heartbeat(soon)):
                raise NoAnswer(f"{self.name}: does not answer after its errors were cleared")
        if self.errors:
            raise DeviceFault(
                f"{self.name}: {error_names(self.errors)}; reset_fault_at_start: true clears it when its cause is gone"
            )

    def _read_scales(self) -> None:
        read = self._parameters.read
        constant, most, turns = (
            read(path) for path in (endpoints.TORQUE_CONSTANT, endpoints.CURRENT_SOFT_MAX, endpoints.VELOCITY_LIMIT)
        )
        if not (math.isfinite(constant) and constant > 0.0):
            raise DeviceError(f"{self.name}: {endpoints.TORQUE_CONSTANT} is {constant:g}; more than 0 was expected")
        self._torque_per_ampere = self.settings.sign * constant * AMPLITUDE
        self._most_current, self._most_turns_s = most / AMPLITUDE, turns

    def _wait_for_version(self, until: float) -> bool:
        """Query the version; returns whether it came, and with it, as frames keep their order, all earlier frames."""
        self._version_came[0] = False
        self._send(Command.GET_VERSION)
        return self._port.pump_until(self._version_came, until)

    def _wait_for_heartbeat(self, until: float) -> bool:
        """Wait for the next heartbeat; returns whether one came."""
        self._beat[0] = False
        return self._port.pump_until(self._beat, until)

    # -- frames ------------------------------------------------------------------------------------------------------

    def _send(self, command: Command, data: bytes = b"") -> None:
        self._port.send(self._base | command, data)

    def _set_state(self, state: AxisState) -> None:
        self._send(Command.SET_AXIS_STATE, STATE.pack(state))

    @property
    def _silence(self) -> float:
        """Longest allowed silence of a drive [s]: three of its heartbeats plus a margin for the host."""
        return 1e-3 * (3 * self.settings.heartbeat_ms + self.settings.watchdog_ms)

    def _on_version(self, data: bytearray, _timestamp: float) -> None:
        if len(data) == VERSION.size:
            self._version, self._version_came[0] = VERSION.unpack(data), True
            self._versions.append(self._version)

    def _on_heartbeat(self, data: bytearray, _timestamp: float) -> None:
        if len(data) == HEARTBEAT.size:
            self.errors, self.axis_state, *_ = HEARTBEAT.unpack(data)
            self._beat[0] = True
            self._heard_until = self._clock.now() + self._silence

    def _on_encoder(self, data: bytearray, _timestamp: float) -> None:
        if len(data) == TWO_FLOATS.size:
            answers = self._answers
            if answers.watched and not answers.take(ENCODER, self._clock.now()):
                return
            self._turns, turns_s = TWO_FLOATS.unpack(data)
            self.values[4], self.values[5] = turns_s * self._turn, self._turns * self._turn
            answers.came[ENCODER] = True

    def _on_iq(self, data: bytearray, _timestamp: float) -> None:
        if len(data) == TWO_FLOATS.size:
            answers = self._answers
            if answers.watched:
                if not answers.take(IQ, self._clock.now()):
                    return
            elif not answers.came[ENCODER]:
                answers.leave_out()
                return
            self.values[3] = self.settings.sign * TWO_FLOATS.unpack(data)[1] / AMPLITUDE
            answers.came[IQ] = True

    def _on_bus(self, data: bytearray, _timestamp: float) -> None:
        if len(data) == TWO_FLOATS.size:
            self._rows.append(Row(f"{self.name}_supply", self._clock.now(), TWO_FLOATS.unpack(data)))
