"""Elmo servo drives over RS-232: one exchange of commands and readings per cycle; a program in the drive monitors it.

The README of this plug-in lists the sources, and what has to be verified on a real drive.
"""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, ClassVar

from leactl.driver.answer_matching import IrregularAnswers
from leactl.driver.clock import Clock
from leactl.driver.contract import (
    Confirmation,
    Identity,
    Mode,
    OwnRecording,
    Row,
    StreamSpec,
    drive_channels,
)
from leactl.driver.conversation import Unreadable
from leactl.driver.engaging_drive import EngagingDrive
from leactl.driver.far_end import Physics, SerialEmulator
from leactl.driver.safe_state import send_at_once
from leactl.driver.serial_port import LONGEST_LINE, SerialPort
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer
from leactl.quantities import ChannelSpec
from leactl_plugins.elmo.scales import CountedPosition
from leactl_plugins.elmo_serial.commissioning import COUNTS_OF_32_BITS, READINGS, DriveLimits, SerialCommissioning
from leactl_plugins.elmo_serial.interpreter import SPOIL_COMMAND, CommandRefused, Interpreter, Replies
from leactl_plugins.elmo_serial.outliers import Outliers
from leactl_plugins.elmo_serial.probe import ElmoSerialProbe
from leactl_plugins.elmo_serial.settings import ElmoSerialSettings
from leactl_plugins.elmo_serial.status import StatusRegister, left_operation

CURRENT, VELOCITY, ANGLE = range(3)  # indices of the references in `values`
# index of the reference, and unit mode UM of the drive
REFERENCES_AND_UNIT_MODES = {Mode.CURRENT: (CURRENT, 1), Mode.VELOCITY: (VELOCITY, 2), Mode.ANGLE: (ANGLE, 5)}
DEMANDS = ("TC", "JV", "PA")  # commands that set the references, by index
MOTOR_OFF = SPOIL_COMMAND + b"MO=0;"
MOST_EXCHANGE_SHARE = 0.55  # share of a cycle that an exchange may take; the loop waits for 0.6 of it
ENABLE_TIME_S = 3.0  # time to enter operation, including the test of the dead-man before it
LONGEST_SAFE_TRY_S = 0.2  # time for one attempt to reach the safe state, with echo and lost bytes
RECONNECT_S = 0.01  # time between a failed attempt to connect and the next one
MOTOR_MUST_BE_ON = 58  # error number of a demand while the motor is off
SHORTEST_TIMEOUT_S = 0.02  # of an exchange in the loop; an adapter on USB delays bytes by up to 16 ms
LONGEST_UPLOAD = 20 + 8 * 0xFFFF  # bytes of one recorded signal
MOST_GARBLED_EXCHANGES = 3  # in sequence; with this many the run ends
NOTICE_PERIOD_S = 1.0  # at most one notice of each kind in this time
# bounds of the readings' noise; a larger deviation is reported
NOISE_BOUNDS = (("q-axis current [A]", 0.5), ("velocity [rad/s]", 0.2), ("angle [rad]", 0.02))
NAN = math.nan


class _Record:
    """Notices, rows and counts of one run, from `open` on."""

    def __init__(self) -> None:
        self.irregular_answers, self.reported_answers = IrregularAnswers(), IrregularAnswers()
        self.notices: list[str] = []
        self.rows: list[Row] = []
        self.answers_quiet_until = self.limits_quiet_until = self.outliers_quiet_until = -math.inf
        self.is_current_limited = False  # by the last status
        self.outliers = Outliers(NOISE_BOUNDS)


class ElmoSerial(EngagingDrive):
    """One Elmo drive, asked for its readings every cycle; its own program stops it if the host falls silent.

    After `open`, the first `engage` switches the drive on without a sign of life until its program has switched it off
    again, with zero demand: a drive whose program does not do so is never let into operation.
    """

    Settings = ElmoSerialSettings
    transport = "serial"
    baudrate = 115200
    summary = "Elmo Gold and SimplIQ servo drives over RS-232 (two-letter commands)"
    example: ClassVar[Mapping[str, Any]] = {"counts_per_turn": 40000}
    modes = REFERENCES_AND_UNIT_MODES
    connection = "over this line"
    enable_time_s = ENABLE_TIME_S
    probe = ElmoSerialProbe()

    def __init__(self, name: str, role: str, settings: ElmoSerialSettings, port: SerialPort, clock: Clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        self._port, self._clock = port, clock
        self._interpreter = Interpreter(port, settings.tag_variable)
        self._opened = self._echoed = False
        self._identity = Identity()
        self._angle_per_count = settings.sign * 2.0 * math.pi / settings.counts_per_turn
        self._q_per_ampere = settings.sign * settings.current_convention.to_q_axis
        self._limits = DriveLimits(NAN, NAN, -math.inf, math.inf)
        self._position = CountedPosition(*COUNTS_OF_32_BITS)
        self._exchange_s, self._exchange_timeout_s = math.inf, settings.answer_timeout_s
        self._record = _Record()
        self._status = StatusRegister(0)
        self._is_fault_ignored = False  # whether a fault that was latched at `open` is ignored until the motor is on
        self._safe = False  # whether it has confirmed to be off, and has got no demand since
        self._supervised = False  # whether `feed` was called since the last exchange: the next one is a sign of life
        self._is_dead_man_proved = False  # whether its program has switched it off while the host's counter stood still
        self._heard = self._voltage_due = -math.inf  # times [s] of the last answer, and of the next voltage query
        self._garbled_in_sequence = 0
        self._is_late = False  # whether the pending exchange was sent in an earlier cycle
        self._follow(Mode.OFF)
        self._references_in_force = [NAN, NAN, NAN]  # current, velocity and angle, until the next queries
        self.values = [NAN] * len(self.loop_channels)

    def safe_state(self, deadline_s: float) -> Confirmation:
        """Switch the motor off and confirm it, from any state, over a new connection if needed; never raises."""
        self._follow(Mode.OFF)
        self._safe = False
        deadline = self._clock.now() + deadline_s
        reason = ""
        while (seconds_left := deadline - self._clock.now()) > 0.0:
            try:
                if not self._port.connected:
                    self._port.reopen()
                self._port.discard()
                replies = self._switch_off_and_query(min(seconds_left, LONGEST_SAFE_TRY_S))
            except DeviceError as error:
                # an attempt shortly before the deadline has too little time
                if not (reason and isinstance(error, NoAnswer)):
                    reason = str(error)
                self._reconnect(deadline)
                continue
            status = StatusRegister(replies.integer("SR"))
            if not status.motor_on and replies.integer("MO") == 0:
                self._status, self._safe = status, True
                break
            reason = f"still on: {status}"
        if not self._opened:
            self._port.close()
        return (
            Confirmation(True, str(self._status))
            if self._safe
            else Confirmation(False, f"not confirmed within {deadline_s:g} s: {reason or 'no time was left'}")
        )

    def _switch_off_and_query(self, within_s: float) -> Replies:
        """Switch off and query the state; the echo is switched off too, because it may drown the answers."""
        self._interpreter.begin(("MO=0", "EO=0", "MO", "SR"), prefix=MOTOR_OFF)
        replies = self._interpreter.collect(self._clock.now() + within_s)
        if replies is None:
            self._interpreter.give_up()
            raise NoAnswer(f"no answer to MO=0 in {within_s:.2g} s")
        replies.check()
        for command in ("MO", "SR"):
            replies.integer(command)
        return replies

    def _reconnect(self, deadline: float) -> None:
        """Open the line again, and wait a moment, but not past the deadline [s]."""
        with suppress(DeviceError):
            self._port.reopen()
        self._clock.sleep_until(min(deadline, self._clock.now() + RECONNECT_S))  # a line may be open and take no byte

    def stop_now(self) -> None:
        """Send the command that switches the motor off, without waiting; over a new connection if needed."""
        self._follow(Mode.OFF)
        send_at_once(self._send_off, self._port, lambda: self._opened)

    def _send_off(self) -> None:
        """Send the command that switches the motor off."""
        if not self._port.connected:
            self._port.reopen()
        self._port.write(MOTOR_OFF)

    def open(self) -> None:
        """Connect to the drive, switch it off, check its program, read its limits, set its timeout of the host.

        Raises
        ------
        DeviceError : the drive is absent, is still on, runs no program, or contradicts the bench file.
        DeviceFault : it is in fault.
        """
        self._port.open()
        self._opened = True
        self._port.discard()
        self._record, self._safe, self._is_dead_man_proved = _Record(), False, False
        self._follow(Mode.OFF)
        setup = SerialCommissioning(self.name, self.settings, self._interpreter, self._clock)
        try:
            self._echoed = setup.echo_off()
            self._identity = setup.identity()
            self._status = setup.check_status()
            self._limits = setup.limits()
            self._position = setup.position()
            setup.arm_dead_man()
            self._exchange_s = setup.exchange_s()
            self._exchange_timeout_s = min(
                self.settings.answer_timeout_s, max(3.0 * self._exchange_s, SHORTEST_TIMEOUT_S)
            )
        except DeviceError as error:
            text = str(error)
            if text.startswith(self.name):
                raise
            kind = DeviceError if isinstance(error, CommandRefused) else type(error)
            raise kind(f"{self.name}: {text}") from None
        self._is_fault_ignored, self._heard, self._interpreter.surplus = (
            self._status.is_fault_latched,
            self._clock.now(),
            0,
        )
        self._record.notices.append(
            f"a row's readings are taken one after another, within {1e3 * self._exchange_s:.2g} ms after its time:"
            " a serial line has no common instant"
        )

    def close(self) -> None:
        """Close the line; the echo of a safe drive is restored."""
        if self._opened:
            self._opened = False
            if self._safe and self._echoed:
                with suppress(DeviceError):  # the drive is safe; an echo that stays off does no harm
                    self._port.write(b"EO=1;")
                    self._clock.sleep_until(self._clock.now() + LONGEST_SAFE_TRY_S)  # closing drops unsent bytes
            self._port.close()

    @classmethod
    def far_end(cls, settings: ElmoSerialSettings, role: str, physics: Physics) -> SerialEmulator:
        """Return an emulated drive that turns the bench's motor."""
        from leactl_plugins.elmo_serial.emulator import ElmoSerialEmulator

        return ElmoSerialEmulator(
            physics.machine(role),
            counts_per_turn=settings.counts_per_turn,
            q_axis_per_ampere=settings.current_convention.to_q_axis,
            peak_current=settings.emulated_peak_current_A,
            continuous_current=settings.emulated_continuous_current_A,
            voltage_command=settings.bus_voltage_command,
            variables=(settings.life_variable, settings.silence_variable),
        )

    def identity(self) -> Identity:
        """Return model, firmware (VR) and serial number (SN[4]) as read at `open`."""
        return self._identity

    def recorded(self) -> OwnRecording:
        """Upload the recording of the drive's own recorder; only while the drive is open and off.

        Raises
        ------
        DeviceError : there is no recording, or the upload is incomplete.
        """
        from leactl_plugins.elmo_serial import recorder

        self._port.longest_line = LONGEST_UPLOAD
        try:
            return recorder.upload_recording(self._interpreter, self.settings.answer_timeout_s)
        except DeviceError as error:
            raise type(error)(f"{self.name}: {error}") from None
        finally:
            self._port.longest_line = LONGEST_LINE

    # -- one cycle ---------------------------------------------------------------------------------------------------

    @property
    def loop_channels(self) -> tuple[ChannelSpec, ...]:
        """Channels of `values`: the readings, and the references that were in force until they were queried."""
        return drive_channels(self.role, self.name)

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """Stream of the bus voltage, which is queried at its own rate."""
        if self.settings.bus_voltage_command is None:
            return ()
        channel = ChannelSpec("vbus", "bus_voltage", self.role, self.name, "DC link voltage")
        return (StreamSpec(f"{self.name}_supply", (channel,)),)

    def pace(self, period: float) -> None:
        """Check that an exchange fits into a cycle of this length [s].

        Raises
        ------
        DeviceError : it does not fit.
        """
        if self._exchange_s > MOST_EXCHANGE_SHARE * period:
            highest_rate_hz = math.floor(MOST_EXCHANGE_SHARE / self._exchange_s)
            raise DeviceError(
                f"{self.name}: an exchange takes {1e3 * self._exchange_s:.3g} ms on its line, a cycle at"
                f" {1.0 / period:g} Hz leaves {1e3 * MOST_EXCHANGE_SHARE * period:.3g} ms: {highest_rate_hz} Hz at"
                " the most, a higher baud rate on both sides, or the drive's CAN (elmo_can)"
            )

    @property
    def engaged(self) -> bool:
        """Whether the drive reports to be on, in the demanded unit mode, with its program running."""
        status = self._status
        is_reported_on = status.motor_on and status.has_program and status.unit_mode == self._unit_mode
        return self._is_dead_man_proved and self._is_on_commanded and is_reported_on

    def command(self, value: float) -> None:
        """Set the demand of the engaged mode (A, rad/s or rad) for the next cycle.

        Raises
        ------
        InputError : not finite, outside the drive's number range, or above its limits.
        """
        if self._reference == CURRENT:
            highest_current = self._limits.peak_current * abs(self._q_per_ampere)
            if not abs(value) <= highest_current:
                raise InputError(
                    f"{self.name}: a demand of {value:g} A is above the {highest_current:g} A of the drive (PL[1])"
                )
        elif self._reference == VELOCITY:
            low, high = self._limits.lowest_velocity, self._limits.highest_velocity
            if not (math.isfinite(value) and low <= value / self._angle_per_count <= high):
                raise InputError(
                    f"{self.name}: a demand of {value:g} rad/s is outside the drive's {low:g} to {high:g} counts/s"
                    " (VL[2], VH[2])"
                )
        elif not abs(value / self._angle_per_count - self._position.counts) < self._position.half_span:
            largest_angle = self._position.half_span * abs(self._angle_per_count)
            raise InputError(
                f"{self.name}: a demand of {value:g} is outside what the drive can hold ({largest_angle:g})"
            )
        self._demanded_value = value

    def begin_cycle(self) -> None:
        """Send this cycle's exchange (queries of the readings, then the demand), unless the last one is still pending.

        Only an exchange after a supervised cycle changes the variable that the drive's program monitors.

        Raises
        ------
        DeviceError : the line is gone.
        """
        now, interpreter = self._clock.now(), self._interpreter
        sent_at = interpreter.pending_since
        self._is_late = sent_at is not None and now - sent_at < self._exchange_timeout_s and not interpreter.garbled
        if self._is_late:
            return
        prefix = b""
        if sent_at is None:
            interpreter.drop_unasked()
        else:
            self._lose_exchange()
            interpreter.give_up()
            prefix = SPOIL_COMMAND
        commands = [*READINGS, *self._cycle_commands(now)]
        if self._voltage_due < now and self._supervised and self.settings.bus_voltage_command is not None:
            self._voltage_due = now + self.settings.bus_voltage_period_s
            commands.append(self.settings.bus_voltage_command)
        is_heartbeat = self._supervised and (self._is_dead_man_proved or not self._is_on_commanded)
        interpreter.begin(commands, self.settings.life_variable if is_heartbeat else "", prefix)
        self._supervised = False

    def end_cycle(self, deadline: float) -> None:
        """Collect the readings; NaN if they did not arrive within the cycle.

        Raises
        ------
        DeviceFault : the drive has a fault, left operation by itself, or reads back another demand than was sent.
        NoAnswer : it no longer answers, or did not enter operation in time.
        DeviceError : it refuses a command.
        """
        values = self.values
        values[0], values[1], values[2] = self._references_in_force
        values[3] = values[4] = values[5] = values[6] = NAN
        replies = self._interpreter.collect(deadline)
        now = self._clock.now()
        if replies is not None:
            try:
                self._evaluate(replies, now)
            except Unreadable as error:
                self._count_garbled(error)
        self._count_surplus()
        self._check_operation(now)

    def feed(self) -> None:
        """Let the next exchange count as the host's heartbeat."""
        self._supervised = True

    def take(self) -> list[Row]:
        """Return the bus voltages since the last call."""
        rows, self._record.rows = self._record.rows, []
        return rows

    def notices(self) -> list[str]:
        """Return notices of readings' times, irregular answers, outliers, and each start of a limited current."""
        record, now = self._record, self._clock.now()
        if record.irregular_answers != record.reported_answers and (
            now >= record.answers_quiet_until or self._mode is Mode.OFF
        ):
            record.answers_quiet_until, record.reported_answers = (
                now + NOTICE_PERIOD_S,
                replace(record.irregular_answers),
            )
            record.notices.append(str(record.irregular_answers))
        notices, record.notices = record.notices, []
        return notices

    # -- commands ---------------------------------------------------------------------------------------------------

    def _follow(self, mode: Mode) -> None:
        """Change to a mode with zero demand; earlier reports of the drive belong to the previous mode."""
        self._mode, self._demanded_value = mode, 0.0
        reference, self._unit_mode = REFERENCES_AND_UNIT_MODES.get(mode, (ANGLE, 0))
        self._reference: int = reference
        self._enable_by = math.inf
        self._is_on_commanded = self._was_on = self._asks_fault = False
        self._on_since = NAN  # time at which the motor was switched on for the test of its dead-man
        self._begun_demand: int | None = None  # demand of the last motion that was begun [counts or counts/s]
        # command and demand of the pending exchange, to be compared with what the drive reads back
        self._sent_demand: tuple[str, float] | None = None

    def _cycle_commands(self, now: float) -> list[str]:
        """Return the commands of this cycle apart from the queries of the readings."""
        self._sent_demand = None
        fault_query = ["MF"] if self._asks_fault else []
        if self._mode is Mode.OFF:
            return [*fault_query, "MO=0"] if self._status.motor_on else fault_query
        if self.engaged:
            return [*fault_query, *self._demand_commands()]
        if self._is_on_commanded or self._enable_by == -math.inf:
            return fault_query
        if self._status.motor_on:
            return ["MO=0"]
        if self._status.unit_mode != self._unit_mode:
            return [f"UM={self._unit_mode}"]
        if not self._supervised:
            return []
        self._is_on_commanded, self._was_on, self._on_since = True, False, now
        return ["MO=1", *(["TC=0"] if self._reference == CURRENT else [])]

    def _demand_commands(self) -> list[str]:
        """Return the commands that set the demand and read it back; a motion begins only if its demand has changed."""
        demand_command = DEMANDS[self._reference]
        if self._reference == CURRENT:
            amperes = round(self._demanded_value / self._q_per_ampere, 3)
            self._sent_demand = demand_command, amperes
            return [f"{demand_command}={amperes:.3f}", demand_command]
        counts = round(self._demanded_value / self._angle_per_count)
        if self._mode is Mode.ANGLE:
            counts = self._position.wrapped(counts)
        self._sent_demand = demand_command, counts
        if counts == self._begun_demand:
            return [demand_command]
        return [f"{demand_command}={counts}", demand_command, "BG"]

    # -- answers ----------------------------------------------------------------------------------------------------

    def _evaluate(self, replies: Replies, now: float) -> None:
        """Evaluate a complete exchange; its readings go into the row if it belongs to this cycle."""
        status = StatusRegister(replies.integer("SR"))
        self._heard = now
        try:
            replies.check()
        except CommandRefused as error:
            if error.number != MOTOR_MUST_BE_ON or not self._is_on_commanded:
                raise DeviceFault(f"{self.name}: {error}") from None
            # MF has the reason; a drive that is still being switched on refuses a torque demand
            self._asks_fault = self._was_on
            self._sent_demand = None
        current, speed, counts = replies.number("IQ"), replies.number("VX"), replies.integer("PX")
        voltage = self.settings.bus_voltage_command
        if voltage is not None and voltage in replies:
            self._record.rows.append(
                Row(f"{self.name}_supply", self._interpreter.answered_at, (replies.number(voltage),))
            )
        self._check_demand(replies)
        position = self._position
        position.counts = position.nearest(counts)
        self._garbled_in_sequence = 0
        self._take_status(status, now)
        if "MF" in replies and self._asks_fault:
            raise DeviceFault(f"{self.name}: {left_operation(status, replies.integer('MF'))}")
        if self._is_late:
            self._record.irregular_answers.late += 1
            return
        values = self.values
        values[3], values[4] = current * self._q_per_ampere, speed * self._angle_per_count
        values[5], values[6] = position.counts * self._angle_per_count, 1.0 if self.engaged else 0.0
        self._references_in_force = [NAN, NAN, NAN]
        if self._mode is not Mode.OFF:
            self._references_in_force[self._reference] = self._demanded_value
        self._note_outlier(now)

    def _note_outlier(self, now: float) -> None:
        """Add a notice for a reading that differs from both its neighbours."""
        record = self._record
        outlier = record.outliers.add(self.values[3:6])
        if outlier is not None and now >= record.outliers_quiet_until:
            record.outliers_quiet_until = now + NOTICE_PERIOD_S
            record.notices.append(f"{outlier}; {record.outliers.count} readings so far")

    def _check_demand(self, replies: Replies) -> None:
        """Compare the demand that the drive reads back with the one sent, since RS-232 has no checksum."""
        if self._sent_demand is None:
            return
        demand_command, sent = self._sent_demand
        read_back = replies.number(demand_command)
        if abs(read_back - sent) > 1e-3 + 1e-5 * abs(sent):
            raise DeviceFault(
                f"{self.name}: holds {demand_command}={read_back:g} where {sent:g} was sent; the line garbles commands"
            )
        if demand_command != DEMANDS[CURRENT]:
            self._begun_demand = int(sent)

    def _take_status(self, status: StatusRegister, now: float) -> None:
        """Store the status of the drive, and conclude whether it enters, has entered or has left operation."""
        record, was_engaged = self._record, self.engaged
        self._status = status
        if status.is_current_limited and not record.is_current_limited and now >= record.limits_quiet_until:
            record.limits_quiet_until = now + NOTICE_PERIOD_S
            record.notices.append(
                f"the drive holds its current down to CL[1], {self._limits.continuous_current:g} A (bit 13 of SR"
                f" 0x{status.register:X})"
            )
        record.is_current_limited = status.is_current_limited
        self._is_fault_ignored = self._is_fault_ignored and not status.motor_on
        if not self._is_on_commanded:
            self._asks_fault = self._asks_fault or (status.is_fault_latched and not self._is_fault_ignored)
        elif status.is_fault_latched and not self._is_fault_ignored:
            self._asks_fault = True
        elif not self._is_dead_man_proved:
            self._test_dead_man(status)
        elif self.engaged:
            self._was_on = True
            if not was_engaged and self._reference == ANGLE:
                # hold the present angle of the shaft
                self._demanded_value = self._position.counts * self._angle_per_count
            self._enable_by = -math.inf  # from now on, only the drive itself can leave operation
        elif self._was_on:
            self._asks_fault = True

    def _test_dead_man(self, status: StatusRegister) -> None:
        """Test the drive's program before any demand: it has to switch the drive off while the host is silent.

        Raises
        ------
        DeviceError : the drive is still on after the timeout.
        """
        if status.motor_on:
            self._was_on = True
            # at least: it was still on when the exchange was sent
            on_time = self._interpreter.asked_at - self._on_since
            if on_time > self.settings.host_silence_s:
                raise DeviceError(
                    f"{self.name}: its dead-man does not work: on for {on_time:.3f} s without a sign of life in"
                    f" {self.settings.life_variable}, {self.settings.host_silence_s:g} s were set; its program is"
                    " another one, or watches other variables"
                )
        elif self._was_on:
            self._is_dead_man_proved, self._is_on_commanded, self._was_on = True, False, False

    def _count_garbled(self, error: Unreadable) -> None:
        """Count a garbled exchange, which leaves its row empty.

        Raises
        ------
        DeviceError : `MOST_GARBLED_EXCHANGES` in sequence were garbled.
        """
        self._garbled_in_sequence += 1
        self._lose_exchange()
        if self._garbled_in_sequence >= MOST_GARBLED_EXCHANGES:
            raise DeviceError(f"{self.name}: {error}; {self._garbled_in_sequence} exchanges in a row were garbled")

    def _lose_exchange(self) -> None:
        """Continue after an exchange that the drive may or may not have executed."""
        self._record.irregular_answers.lost += 1
        self._begun_demand = None
        if self._is_on_commanded and not self._was_on:
            self._is_on_commanded = False  # so that it is commanded again

    def _count_surplus(self) -> None:
        """Add the answers that belonged to no exchange to the irregular ones."""
        self._record.irregular_answers.surplus += self._interpreter.surplus
        self._interpreter.surplus = 0

    def _check_operation(self, now: float) -> None:
        """Raise the reason why the drive is not in operation although it should be."""
        silence = now - self._heard
        if silence > self.settings.host_silence_s + self.settings.answer_timeout_s:
            raise NoAnswer(f"{self.name}: no answer for {silence:.3f} s")
        if self._mode is not Mode.OFF and self._enable_by < now and self._enable_by > -math.inf:
            raise NoAnswer(f"{self.name}: not in operation after {ENABLE_TIME_S:g} s: {self._status}")
