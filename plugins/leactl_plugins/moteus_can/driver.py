"""mjbots moteus controllers over CAN-FD: each cycle, one frame with command and query, and one with the answer.

All modes are the controller's position mode with some of its parts switched off, because only there does a command
expire by itself. The README of this plug-in lists the sources, and what has to be verified on a real controller.
"""

import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, ClassVar

from leactl.driver.can_port import CanPort
from leactl.driver.clock import Clock
from leactl.driver.contract import SAFE_STATE_S, Confirmation, Driver, Identity, Mode, Row, StreamSpec, drive_channels
from leactl.driver.far_end import CanEmulator, Physics
from leactl.driver.safe_state import send_at_once
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer
from leactl.quantities import ChannelSpec
from leactl_plugins.moteus_can import configuration as conf
from leactl_plugins.moteus_can.configuration import Configuration
from leactl_plugins.moteus_can.exchange import ControllerExchange, query
from leactl_plugins.moteus_can.multiplex import REPLY_REQUESTED, Resolution, identifier, parse, write
from leactl_plugins.moteus_can.probe import IDENTITY_QUERY, MoteusProbe, identity_of
from leactl_plugins.moteus_can.registers import (
    MAP_VERSION,
    TORQUE_FACTOR,
    OperatingMode,
    Register,
    fault_text,
    limit_text,
)
from leactl_plugins.moteus_can.settings import HOST, MoteusSettings

CURRENT, VELOCITY, ANGLE = range(3)  # indices of the references in `values`
REFERENCES = {Mode.CURRENT: CURRENT, Mode.VELOCITY: VELOCITY, Mode.ANGLE: ANGLE}
AMPLITUDE_PER_Q_AXIS = math.sqrt(2.0 / 3.0)  # of a phase current, per ampere of the power-invariant q axis
TURN = 2.0 * math.pi
FARTHEST_TURNS = 1024.0  # up to this position, single precision resolves 0.4 mrad
ENABLE_TIME_S = 2.0  # time for the controller to enter operation
MOST_TRIES = 3  # of the identity query: a frame may get lost
SECOND_ANSWER_S = 0.01  # time for a second controller of the same number to answer too
NOTICE_PERIOD_S = 1.0  # at most one notice of a kind in this time
LEAST_COMPARED_AMPLITUDE_A = 1.0  # at lower currents, torque and current are not compared
COMPARED_SAMPLES = 50  # of torque and current, whose sums are compared
TORQUE_RATIO_TOLERANCE = 0.05  # relative; a wrong factor or gear makes a larger difference
STATED_VALUE_TOLERANCE = 0.01  # relative difference from a value that the bench file states
NAN = math.nan

STOP = write(Register.MODE, [OperatingMode.STOPPED], Resolution.INT8)
FOLLOW_POSITION = write(Register.MODE, [OperatingMode.POSITION], Resolution.INT8)
STATUS = query(
    (Register.MODE, 1, Resolution.INT8),
    (Register.POSITION, 4, Resolution.FLOAT),  # with velocity, torque and q-axis current
    (Register.FAULT, 1, Resolution.INT8),
    (Register.COMMAND_TIMEOUT, 1, Resolution.FLOAT),
)
WITH_SUPPLY = query(  # instead of the time-out: a frame with a command has no room for both
    (Register.MODE, 1, Resolution.INT8),
    (Register.POSITION, 4, Resolution.FLOAT),
    (Register.FAULT, 1, Resolution.INT8),
    (Register.VOLTAGE, 2, Resolution.FLOAT),  # with the temperature
)
ZERO_PARAMETERS = {
    conf.VOLTAGE_MODE: "currents would be volts",
    conf.FIXED_VOLTAGE: "neither encoder nor current loop would be used",
    conf.BEMF_FEEDFORWARD: "the controller refuses it without a limit of acceleration, and none is sent",
}
"""Parameters that must be 0, with the reason."""


class MoteusCan(Driver):
    """One controller, commanded and asked for its readings in one frame every cycle."""

    Settings = MoteusSettings
    transport = "can"
    summary = "mjbots moteus r4, c1, n1 or x1 over CAN-FD (register map 5)"
    example: ClassVar[Mapping[str, Any]] = {"node": 3}
    probe = MoteusProbe()

    def __init__(self, name: str, role: str, settings: MoteusSettings, port: CanPort, clock: Clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        self._port, self._clock = port, clock
        self._command_identifier, self._answer_identifier = (
            identifier(HOST | REPLY_REQUESTED, settings.node),
            identifier(settings.node, HOST),
        )
        self._configuration = Configuration(name, port, HOST, settings.node, settings.answer_timeout_s)
        self._connected = False
        self._rad_per_turn = settings.sign * TURN  # rad, of one turn of the controller
        self._torque_per_ampere = self._highest_current = self._highest_turns_per_s = NAN
        self._lowest_turns, self._highest_turns = -FARTHEST_TURNS, FARTHEST_TURNS
        self._identity = Identity()
        self._original_timeout_mode: float | None = None  # restored at `close`; None: unchanged
        self._safe = False  # whether it has confirmed to be safe, and has got no demand since
        self._exchange = ControllerExchange(port, self._command_identifier)
        self._last_answer: dict[int, float] = {}  # by register
        self._heard_until = -math.inf  # time [s] by which the next answer has to arrive
        self.reported_mode: int | None = None  # since the last change of the demanded mode; None until one is reported
        self.fault = 0
        self._reported_timeout = NAN  # s, for which a command is valid
        self._shaft_turns = NAN  # turns, position of the shaft as last reported
        self._supply_due = -math.inf
        # whether the next query has to ask for the supply, and whether the last one did
        self._asks_supply_next = self._asked_supply_last = False
        self._rows: list[Row] = []
        self._limit_code, self._reported_limit_code = 0, 0
        self._quiet_until = -math.inf
        self._supervised = False  # whether `feed` was called since the last command, so that the next may be sent
        self._mode, self._reference, self._demanded_value = Mode.OFF, ANGLE, 0.0
        self._timeout_mode = NAN  # as read back since the last change of the demanded mode
        self._is_prepared = False  # whether it has since then reported to be stopped, with the time-out mode of `open`
        self._enable_by = math.inf
        self._current_sum = self._torque_sum = 0.0  # sums, whose ratio is the torque per ampere of the controller
        self._sample_count = 0
        # current, velocity and angle, since the last query
        self._references_in_force = [NAN, NAN, NAN]
        self.values = [NAN] * len(self.loop_channels)

    def safe_state(self, deadline_s: float) -> Confirmation:
        """Stop the controller, from any state, over a new connection if needed; never raises.

        Only the answer to a frame with a stop command, or to a later one, confirms the stop. A controller in fault has
        no power at its output, and a stop would clear the fault: if a fault is known, the controller is only queried.
        """
        return self._stop(deadline_s, self.reported_mode == OperatingMode.FAULT)

    def _stop(self, deadline_s: float, in_fault: bool) -> Confirmation:
        """Stop the controller; if it is in fault, only query it, and confirm the fault as a safe state."""
        self._follow(Mode.OFF)
        deadline = self._clock.now() + deadline_s
        reason, cleared_fault_text = "no time was left", ""
        while self._clock.now() < deadline:
            try:
                self._connect()
                command = b"" if in_fault else STOP
                is_answered = self._exchange.is_answered(command, STATUS, min(deadline, self._clock.now() + 0.25))
            except DeviceError as error:
                is_answered, reason = False, str(error)
                self._clock.sleep_until(min(deadline, self._clock.now() + 0.01))
            else:
                reason = f"mode {self.reported_mode}" if is_answered else "no answer"
            if not is_answered:
                with suppress(DeviceError):
                    self._port.reopen()
                continue
            if self.reported_mode == OperatingMode.STOPPED or (in_fault and self.reported_mode == OperatingMode.FAULT):
                self._safe = True
                return Confirmation(
                    True,
                    f"in fault, without power: {fault_text(self.fault)}"
                    if in_fault
                    else f"stopped{cleared_fault_text}",
                )
            if self.reported_mode == OperatingMode.FAULT:
                cleared_fault_text = f"; it was in fault: {fault_text(self.fault)}"
            in_fault = False
            self._clock.sleep_until(min(deadline, self._clock.now() + 0.001))  # the controller obeys in its next loop
        return Confirmation(False, f"not confirmed within {deadline_s:g} s: {reason}")

    def stop_now(self) -> None:
        """Send the command that stops the controller, without waiting; over a new connection if needed.

        A controller that has reported a fault has no power at its output, and is left in fault.
        """
        in_fault = self.reported_mode == OperatingMode.FAULT
        self._follow(Mode.OFF)
        self.reported_mode = int(OperatingMode.FAULT) if in_fault else None

        def send() -> None:
            self._connect()
            self._exchange.ask(b"" if in_fault else STOP, STATUS)

        send_at_once(send, self._port, lambda: self._connected)

    def open(self) -> None:
        """Identify the controller, check its faults, stop it, read its scales, and set its reaction to a time-out.

        Raises
        ------
        DeviceError : it is absent, has another register map, shares its number, or holds a setting with which it cannot
            be driven or that contradicts the bench file.
        DeviceFault : it is in fault.
        """
        self._connect()
        self._safe, self._original_timeout_mode = False, None
        self._exchange.begin()
        self._identify()
        if self.reported_mode == OperatingMode.FAULT and not self.settings.reset_fault_at_start:
            raise DeviceFault(
                f"{self.name}: {fault_text(self.fault)}; reset_fault_at_start: true clears it when its cause is gone"
            )
        confirmation = self._stop(SAFE_STATE_S, in_fault=False)
        if not confirmation.safe:
            raise DeviceError(f"{self.name}: the controller does not stop: {confirmation.detail}")
        self._safe = False
        self._read_scales()
        timeout_mode = self._configuration.read(conf.TIMEOUT_MODE)
        if timeout_mode != conf.TIMEOUT_STOPPED:
            self._configuration.write(conf.TIMEOUT_MODE, conf.TIMEOUT_STOPPED)
            self._original_timeout_mode = timeout_mode
        self._heard_until = self._clock.now() + self.settings.host_silence_s

    def close(self) -> None:
        """Stop listening and close the bus; the time-out mode of a safe controller is restored."""
        if self._connected:
            if self._safe and self._original_timeout_mode is not None:
                with suppress(DeviceError):  # the controller is safe; a changed time-out mode does no harm
                    self._configuration.write(conf.TIMEOUT_MODE, self._original_timeout_mode)
            self._connected = False
            self._port.listen_fd(self._answer_identifier, None)
            self._port.close()

    @classmethod
    def far_end(cls, settings: MoteusSettings, role: str, physics: Physics) -> CanEmulator:
        """Return an emulated controller of this number that turns the bench's motor."""
        from leactl_plugins.moteus_can.emulator import MoteusEmulator

        return MoteusEmulator(
            settings.node,
            physics.machine(role),
            torque_constant=settings.torque_constant_Nm_per_A,
            max_current=settings.max_current_A,
        )

    def identity(self) -> Identity:
        """Return model number, serial number as `moteus_tool --info` prints it, and firmware, as read at `open`."""
        return self._identity

    # -- one cycle ---------------------------------------------------------------------------------------------------

    @property
    def loop_channels(self) -> tuple[ChannelSpec, ...]:
        """Channels of `values`: the references that were in force until the query, and the readings."""
        return drive_channels(self.role, self.name)

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """Stream of the bus voltage and the board's temperature, which are queried at their own rate."""
        channels = (
            ChannelSpec("vbus", "bus_voltage", self.role, self.name, "DC link voltage"),
            ChannelSpec("drive_temperature", "drive_temperature", self.role, self.name, "temperature of the board"),
        )
        return (StreamSpec(f"{self.name}_supply", channels),)

    @property
    def engaged(self) -> bool:
        """Whether the controller reports position mode, and commands that expire after the demanded time."""
        return (
            self._mode is not Mode.OFF
            and self._is_prepared
            and self.reported_mode == OperatingMode.POSITION
            and abs(self._reported_timeout - self.settings.host_silence_s) <= conf.READ_BACK_TOLERANCE
        )

    def engage(self, mode: Mode) -> None:
        """Begin to enter operation in this mode with zero demand; in angle mode the present angle is held.

        Raises
        ------
        InputError : the drive has no such mode.
        """
        if mode not in REFERENCES:
            raise InputError(f"{self.name}: mode '{mode}' is none that a moteus follows: {', '.join(REFERENCES)}")
        self._follow(mode)
        self._safe = False
        self._enable_by = self._clock.now() + ENABLE_TIME_S

    def release(self) -> None:
        """Begin to leave operation; no current flows once the drive has left it."""
        self._follow(Mode.OFF)

    def command(self, value: float) -> None:
        """Set the demand of the engaged mode (A, rad/s or rad) for the next cycle.

        Raises
        ------
        InputError : not finite, or beyond the controller's limits, to which it would clip the demand.
        """
        if self._reference == CURRENT:
            low, high, units, source = -self._highest_current, self._highest_current, "A", conf.MAX_CURRENT
        elif self._reference == VELOCITY:
            highest_velocity = TURN * self._highest_turns_per_s
            low, high, units, source = -highest_velocity, highest_velocity, "rad/s", conf.MAX_VELOCITY
        else:
            low, high = sorted((self._lowest_turns * self._rad_per_turn, self._highest_turns * self._rad_per_turn))
            units, source = "rad", f"{conf.POSITION_MIN}, {conf.POSITION_MAX} and single precision"
        if not low <= value <= high:
            raise InputError(
                f"{self.name}: a demand of {value:g} {units} is outside {low:g} to {high:g} {units} ({source})"
            )
        self._demanded_value = value

    def begin_cycle(self) -> None:
        """Send this cycle's command and the query of the readings in one frame.

        Commands keep the controller in operation: one is sent only after a supervised cycle.
        """
        command = b""
        if self._mode is not Mode.OFF and self._is_prepared:
            command = self._demand() if self._supervised else b""
        elif self.reported_mode not in (OperatingMode.STOPPED, OperatingMode.FAULT):  # a stop would clear a fault
            command = STOP
        elif self._mode is not Mode.OFF and math.isnan(self._timeout_mode):
            self._read_timeout_mode()
        # at most every second query, so that the time-out is reported as well
        asks_supply = (
            self._asks_supply_next and not self._asked_supply_last and (self._mode is Mode.OFF or self.engaged)
        )
        self._supervised, self._asked_supply_last = False, asks_supply
        self._asks_supply_next = self._asks_supply_next and not asks_supply
        self._exchange.ask(command, WITH_SUPPLY if asks_supply else STATUS)

    def end_cycle(self, deadline: float) -> None:
        """Collect the readings; they are NaN if they did not arrive.

        Raises
        ------
        DeviceFault : the controller has a fault, its command has expired, or it left operation by itself.
        NoAnswer : it does not answer, or did not enter operation in time.
        """
        values = self.values
        has_answered = self._port.pump_until(self._exchange.came, deadline)
        values[0], values[1], values[2] = self._references_in_force
        self._references_in_force = [NAN, NAN, NAN]
        if self._mode is not Mode.OFF:
            self._references_in_force[self._reference] = self._demanded_value
        now, engaged = self._clock.now(), self.engaged
        if has_answered:
            answer = self._last_answer
            values[3] = self.settings.sign * answer[Register.Q_CURRENT] / AMPLITUDE_PER_Q_AXIS
            values[4] = answer[Register.VELOCITY] * self._rad_per_turn
            values[5] = answer[Register.POSITION] * self._rad_per_turn
            values[6] = 1.0 if engaged else 0.0
        else:
            self._exchange.give_up()
            values[3:7] = [NAN] * 4
        if engaged:
            self._enable_by = -math.inf  # from now on, only the controller itself can leave operation
            if has_answered:
                self._check_torque_per_ampere(self._last_answer)
        self._check_operation(now, engaged)

    def feed(self) -> None:
        """Allow the next command, which is valid for the watchdog's time; query the supply if that is due."""
        self._supervised = True
        now = self._clock.now()
        if now >= self._supply_due:
            self._supply_due = now + self.settings.supply_period_s
            self._asks_supply_next = True

    def take(self) -> list[Row]:
        """Return the bus voltages and temperatures since the last call."""
        rows, self._rows = self._rows, []
        return rows

    def notices(self) -> list[str]:
        """Return notices of irregular and unreadable answers, of changed limits of the output, and of a full bus."""
        lines, now = [], self._clock.now()
        if now >= self._quiet_until or self._mode is Mode.OFF:
            lines += self._exchange.notices()
            if self._limit_code != self._reported_limit_code:
                self._reported_limit_code = self._limit_code
                lines.append(
                    f"the output is limited by {limit_text(self._limit_code)}"
                    if self._limit_code
                    else "nothing limits the output any more"
                )
            self._quiet_until = now + NOTICE_PERIOD_S if lines else self._quiet_until
        return lines + self._port.notices()

    # -- entering operation ------------------------------------------------------------------------------------------

    def _follow(self, mode: Mode) -> None:
        """Change to a mode with zero demand; earlier reports of the controller belong to the previous mode."""
        self._mode, self._demanded_value = mode, 0.0
        self._reference = REFERENCES.get(mode, ANGLE)
        self._enable_by, self._supervised = math.inf, False
        self._is_prepared, self.reported_mode, self._reported_timeout = False, None, NAN
        self._timeout_mode = NAN
        self._configuration.begin_reading(conf.TIMEOUT_MODE)

    def _read_timeout_mode(self) -> None:
        """Continue to query the time-out mode, which a controller loses when it restarts."""
        timeout_mode = self._configuration.continue_reading()
        self._timeout_mode = NAN if timeout_mode is None else timeout_mode

    def _demand(self) -> bytes:
        """Return the command of the mode; before operation, the demanded angle is the present one."""
        if self._reference == ANGLE and not self.engaged:
            if not abs(self._shaft_turns) <= FARTHEST_TURNS:
                return b""  # no command until the position of the shaft is known
            self._demanded_value = self._shaft_turns * self._rad_per_turn
        position, velocity, torque, loop_scale = NAN, 0.0, 0.0, 1.0
        if self._reference == CURRENT:
            torque, loop_scale = self._demanded_value * self._torque_per_ampere, 0.0
        elif self._reference == VELOCITY:
            velocity = self._demanded_value / self._rad_per_turn
        else:
            position = self._demanded_value / self._rad_per_turn
        return (
            FOLLOW_POSITION
            + write(Register.COMMAND_POSITION, [position, velocity, torque, loop_scale, loop_scale, NAN])
            + write(Register.COMMAND_TIMEOUT, [self.settings.host_silence_s, -1.0, -1.0])  # no limits of a profile
            + write(Register.COMMAND_ILIMIT_SCALE, [loop_scale], Resolution.INT8)
        )

    def _check_operation(self, now: float, engaged: bool) -> None:
        """Raise the reason why the drive is not in operation although it should be."""
        self._expect_one_controller()
        if self.reported_mode == OperatingMode.FAULT:
            raise DeviceFault(f"{self.name}: {fault_text(self.fault)}")
        if now > self._heard_until:
            raise NoAnswer(
                f"{self.name}: no answer of node {self.settings.node} in its own cycle for"
                f" {self.settings.host_silence_s:.3f} s; {self._exchange.irregular.late} came later"
            )
        if self._mode is Mode.OFF or engaged:
            return
        state = f"mode {self.reported_mode}, commands valid for {self._reported_timeout:g} s"
        if self._is_prepared and self.reported_mode == OperatingMode.TIMEOUT:
            raise DeviceFault(
                f"{self.name}: no command came for {self.settings.watchdog_ms} ms and it has stopped by itself: {state}"
            )
        if self._enable_by == -math.inf:
            raise DeviceFault(f"{self.name}: left operation by itself: {state}")
        if not (math.isnan(self._timeout_mode) or self._timeout_mode == conf.TIMEOUT_STOPPED):
            raise DeviceFault(
                f"{self.name}: {conf.TIMEOUT_MODE} is {self._timeout_mode:g} although {conf.TIMEOUT_STOPPED} was set"
                " when it was opened: it has restarted, or another host has set it; open it again"
            )
        if now > self._enable_by:
            hint = "" if abs(self._shaft_turns) <= FARTHEST_TURNS else f"; the shaft is at {self._shaft_turns:g} turns"
            if math.isnan(self._timeout_mode):
                hint += f"; {conf.TIMEOUT_MODE} was not answered"
            raise NoAnswer(f"{self.name}: not in operation after {ENABLE_TIME_S:g} s: {state}{hint}")

    def _check_torque_per_ampere(self, answer: Mapping[int, float]) -> None:
        """Raise DeviceError if the controller's torque per ampere differs from the one by which currents are sent.

        The controller computes its torque from its current, so their ratio is the factor by which it divides demands.
        """
        current, torque = answer[Register.Q_CURRENT], answer[Register.TORQUE]
        if not abs(current) >= LEAST_COMPARED_AMPLITUDE_A:
            return
        self._current_sum += abs(current)
        self._torque_sum += math.copysign(1.0, current) * torque
        self._sample_count += 1
        if self._sample_count < COMPARED_SAMPLES:
            return
        reported_ratio, used_ratio = (
            self._torque_sum / self._current_sum,
            abs(self._torque_per_ampere) / AMPLITUDE_PER_Q_AXIS,
        )
        self._current_sum, self._torque_sum, self._sample_count = 0.0, 0.0, 0
        if abs(reported_ratio - used_ratio) > TORQUE_RATIO_TOLERANCE * used_ratio:
            raise DeviceError(
                f"{self.name}: shows {reported_ratio:.4g} N*m per A of amplitude at its output, {used_ratio:.4g} was"
                f" expected of {conf.KV} and {conf.RATIO}: are its motor.rotation_ values set?"
            )

    # -- set-up ------------------------------------------------------------------------------------------------------

    def _connect(self) -> None:
        """Open the bus and listen to the controller; open it again if it was lost."""
        if not self._connected:
            self._port.open()
            self._connected = True
            self._port.listen_fd(self._answer_identifier, self._on_frame)
        elif self._port.bus is None:
            self._port.reopen()

    def _identify(self) -> None:
        """Check that one controller of this number answers and has the known register map.

        Raises
        ------
        NoAnswer : no controller of this number reports its identity.
        DeviceError : two controllers answer, or the register map is another one.
        """
        now = self._clock.now
        timeout = self.settings.answer_timeout_s
        attempts = (self._exchange.is_answered(b"", IDENTITY_QUERY, now() + timeout) for _ in range(MOST_TRIES))
        if not any(attempts):
            raise NoAnswer(
                f"{self.name}: node {self.settings.node} does not tell who it is; number, power, bit rates of 1 and"
                " 5 Mbit/s, a bus with options: {fd: true}?"
            )
        self._identity = identity_of(self._last_answer)
        map_version = int(self._last_answer[Register.REGISTER_MAP_VERSION])
        if map_version != MAP_VERSION:
            raise DeviceError(
                f"{self.name}: firmware {self._identity.firmware} has register map {map_version}; {MAP_VERSION} was"
                " expected"
            )
        self._port.pump_until((False,), now() + SECOND_ANSWER_S)
        self._expect_one_controller()

    def _expect_one_controller(self) -> None:
        """Raise DeviceError if another controller has the same number."""
        if self._exchange.second_controller:
            raise DeviceError(
                f"{self.name}: two controllers answer as node {self.settings.node}; connect one of them alone and give"
                " it another id.id"
            )

    def _read_scales(self) -> None:
        """Read the scales and limits of demands, and compare them with the bench file.

        Raises
        ------
        DeviceError : the controller is not calibrated, is configured for another kind of control, or differs from the
            bench file.
        """
        read = self._configuration.read
        for parameter, reason in ZERO_PARAMETERS.items():
            if (value := read(parameter)) != 0.0:
                raise DeviceError(f"{self.name}: {parameter} is {value:g}; 0 was expected: {reason}")
        positive_values = {
            parameter: read(parameter) for parameter in (conf.KV, conf.RATIO, conf.MAX_CURRENT, conf.MAX_VELOCITY)
        }
        for parameter, value in positive_values.items():
            if not (math.isfinite(value) and value > 0.0):
                raise DeviceError(
                    f"{self.name}: {parameter} is {value:g}; more than 0 was expected: calibrate it first"
                )
        torque_constant, highest_amplitude = TORQUE_FACTOR / positive_values[conf.KV], positive_values[conf.MAX_CURRENT]
        for setting, expected, value in (
            ("torque_constant_Nm_per_A", self.settings.torque_constant_Nm_per_A, torque_constant),
            ("max_current_A", self.settings.max_current_A, highest_amplitude),
        ):
            if expected is not None and not abs(value - expected) <= STATED_VALUE_TOLERANCE * expected:
                raise DeviceError(f"{self.name}: holds {value:.5g} for {setting}; the bench file says {expected:g}")
        self._torque_per_ampere = (
            self.settings.sign * torque_constant / positive_values[conf.RATIO] * AMPLITUDE_PER_Q_AXIS
        )
        self._highest_current, self._highest_turns_per_s = (
            highest_amplitude / AMPLITUDE_PER_Q_AXIS,
            positive_values[conf.MAX_VELOCITY],
        )
        low, high = read(conf.POSITION_MIN), read(conf.POSITION_MAX)
        self._lowest_turns = max(-FARTHEST_TURNS, low) if math.isfinite(low) else -FARTHEST_TURNS
        self._highest_turns = min(FARTHEST_TURNS, high) if math.isfinite(high) else FARTHEST_TURNS

    # -- frames ------------------------------------------------------------------------------------------------------

    def _on_frame(self, data: bytearray, _timestamp: float) -> None:
        """Pass on text to the configuration, and take an answer to the last query."""
        frame = bytes(data)
        try:
            reply = parse(frame)
        except ValueError as error:
            self._exchange.count_unreadable(str(error))
            return
        if reply.text is not None and not reply.values:
            self._configuration.on_text(reply.text)
        elif self._exchange.accept(reply, frame):
            self._take_answer(reply.values)

    def _take_answer(self, values: dict[int, float]) -> None:
        """Store the answer to the last query, by register."""
        self._last_answer = values
        self._heard_until = self._clock.now() + self.settings.host_silence_s
        self.reported_mode, self.fault = int(values[Register.MODE]), int(values[Register.FAULT])
        self._reported_timeout = values.get(Register.COMMAND_TIMEOUT, self._reported_timeout)
        self._shaft_turns = values.get(Register.POSITION, NAN)
        if Register.VOLTAGE in values:
            supply = (values[Register.VOLTAGE], values[Register.TEMPERATURE])
            self._rows.append(Row(f"{self.name}_supply", self._clock.now(), supply))
        if self.reported_mode == OperatingMode.STOPPED:
            self._is_prepared = self._timeout_mode == conf.TIMEOUT_STOPPED
        self._limit_code = 0 if self.reported_mode == OperatingMode.FAULT else self.fault
