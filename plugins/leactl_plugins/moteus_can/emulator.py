"""Emulator of a moteus controller: registers, position mode, time-outs, faults, limits and the text tunnel.

Frames in, frames out; it shares with the driver the numbers and scales of registers, and parses frames by itself, as
the firmware does: if the end of a frame cannot be read, the part before it is still obeyed. Modes and limits follow the
maker's `fw/bldc_servo_control.h`; of the modes, stopped, current and position can be commanded here. An answer reports
the state before the command of its own frame.
"""

import base64
import math
import struct
from binascii import Error as NotBase64

from leactl.driver.far_end import FdFrame, Frame, Machine
from leactl_plugins.moteus_can.registers import MAP_VERSION, MODES, SCALES, TORQUE_FACTOR, OperatingMode, Register

TO_AMPLITUDE, TURN = math.sqrt(2.0 / 3.0), 2.0 * math.pi
LENGTHS = (8, 12, 16, 20, 24, 32, 48, 64)
LAYOUTS = (struct.Struct("<b"), struct.Struct("<h"), struct.Struct("<i"), struct.Struct("<f"))
LOWEST_CODES = (-128, -32768, -2147483648)
LEAST_FREE_BYTES = 23  # of an answer, without which the next subframe is not obeyed
ENABLE_S = 0.004  # time to start the gate driver and to measure the offsets of the current sensors
UNKNOWN_REGISTER, NOT_WRITEABLE, NO_ROOM, NO_MODE = 1, 2, 2, 3
OVER_VOLTAGE, OVER_TEMPERATURE, OUTSIDE_LIMIT, UNDER_VOLTAGE, MOTOR_DRIVER = 34, 38, 39, 40, 33
LIMIT_VELOCITY, LIMIT_CURRENT, LIMIT_TEMPERATURE, LIMIT_TORQUE = 96, 99, 100, 102
LOWEST_BUS_V = 4.0
FAULT_OF_CLASS = {0x31: OVER_VOLTAGE, 0x32: OVER_VOLTAGE, 0x41: OVER_TEMPERATURE, 0x42: OVER_TEMPERATURE}
"""Fault by the upper byte of a CiA 301 code; every other code is a fault of the motor driver."""

DEFAULT_COMMANDS = {  # value of each register after the mode was written
    Register.PWM_PHASE_A: 0.0,
    Register.COMMAND_Q_CURRENT: 0.0,
    Register.COMMAND_POSITION: 0.0,
    Register.COMMAND_VELOCITY: 0.0,
    Register.COMMAND_FEEDFORWARD_TORQUE: 0.0,
    Register.COMMAND_KP_SCALE: 1.0,
    Register.COMMAND_KD_SCALE: 1.0,
    Register.COMMAND_MAX_TORQUE: math.nan,
    Register.COMMAND_TIMEOUT: 0.0,
    Register.COMMAND_VELOCITY_LIMIT: math.nan,
    Register.COMMAND_ACCEL_LIMIT: math.nan,
    Register.COMMAND_ILIMIT_SCALE: 1.0,
}
ENABLING_MODES = (2, 3, 4)  # passed from stopped to the commanded mode
COMMAND_MODES = (OperatingMode.CURRENT, OperatingMode.POSITION)  # that a motor follows


class MoteusEmulator:
    """One controller of a number, which turns a motor."""

    def __init__(
        self, node: int, machine: Machine, *, torque_constant: float | None = None, max_current: float | None = None
    ) -> None:
        self.node, self._machine = node, machine
        self.words = [0x004E0032 + node, 0x30345111, 0x20363636]
        self.map_version, self.firmware, self.model = MAP_VERSION, 0x01010E, 0x0120
        self.temperature = 32.0  # degC, of the board
        self.frozen = False
        self.parameters: dict[str, float] = {
            "servo.timeout_mode": OperatingMode.ZERO_VELOCITY,
            "servo.default_timeout_s": 0.1,
            "servo.timeout_max_torque_Nm": 5.0,
            "servo.max_current_A": 100.0 if max_current is None else max_current,
            "servo.derate_current_A": -20.0,
            "servo.max_velocity": 500.0,
            "servo.max_voltage": 56.0,
            "servo.fault_temperature": 75.0,
            "servo.temperature_margin": 25.0,
            "servo.voltage_mode_control": 0,
            "servo.fixed_voltage_mode": 0,
            "servo.bemf_feedforward": 0.0,
            "servopos.position_min": math.nan,
            "servopos.position_max": math.nan,
            "motor.Kv": TORQUE_FACTOR / (0.6 if torque_constant is None else torque_constant),
            "motor_position.rotor_to_output_ratio": 1.0,
        }
        self.stored = dict(self.parameters)
        self.mode, self.fault_code = int(OperatingMode.STOPPED), 0
        self._commanded = dict(DEFAULT_COMMANDS)
        self._commanded_mode = int(OperatingMode.STOPPED)  # of the last command
        self._expires = self._enabled_at = math.inf
        # whether the present frame wrote the mode, and whether it requests an answer
        self._wrote_mode = self._answer_requested = False
        self._machine_state = (0.0, 0.0, 0.0)  # current, velocity and angle at the time of the present frame
        self._line, self._text = b"", b""

    # -- time --------------------------------------------------------------------------------------------------------

    @property
    def due(self) -> float:
        """Time at which the command expires, or operation begins [s]."""
        expires_at = self._expires if self.mode == OperatingMode.POSITION else math.inf
        return math.inf if self.frozen else min(expires_at, self._enabled_at)

    def tick(self, now: float) -> list[Frame]:
        """Let commands expire and operation begin; return no frames, since a controller sends nothing by itself."""
        if self.frozen:
            return []
        if now >= self._enabled_at:
            self._enabled_at = math.inf
            if self.mode in ENABLING_MODES:
                self._enter_operation()
        if self.mode == OperatingMode.POSITION and now >= self._expires:  # commands expire in no other mode
            self.mode = int(OperatingMode.TIMEOUT)
            self._expire_command()
        self._look_for_faults()
        return []

    def _expire_command(self) -> None:
        """React to an expired command by `servo.timeout_mode`; only a stop ends this state."""
        if self.parameters["servo.timeout_mode"] in (OperatingMode.ZERO_VELOCITY, OperatingMode.POSITION):
            self._machine.command("velocity", 0.0)
        else:
            self._machine.command("off", 0.0)

    def _look_for_faults(self) -> None:
        """Enter fault if voltage or temperature is out of range in operation."""
        if self.mode in (OperatingMode.STOPPED, OperatingMode.FAULT):
            return
        voltage = self._machine.bus_voltage
        if voltage > self.parameters["servo.max_voltage"]:
            self._fail(OVER_VOLTAGE)
        elif voltage < LOWEST_BUS_V:
            self._fail(UNDER_VOLTAGE)
        elif self.temperature > self.parameters["servo.fault_temperature"]:
            self._fail(OVER_TEMPERATURE)

    def _fail(self, code: int) -> None:
        """Enter fault with this code."""
        self.mode, self.fault_code = int(OperatingMode.FAULT), code
        self._enabled_at = self._expires = math.inf
        self._machine.command("off", 0.0)

    # -- frames ------------------------------------------------------------------------------------------------------

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Receive one frame from the bus; return the answer."""
        source, destination = frame.identifier >> 8 & 0xFF, frame.identifier & 0xFF
        if self.frozen or not isinstance(frame, FdFrame) or destination not in (self.node, 0x7F):
            return []
        self.tick(now)
        self._wrote_mode = False
        self._answer_requested = bool(source & 0x80)
        self._machine_state = self._machine.read()
        answer = self._obey(frame.data)
        if self._wrote_mode:
            self._take_command(now)
        if not self._answer_requested:
            return []
        length = next((length for length in LENGTHS if length >= len(answer)), LENGTHS[-1])
        return [FdFrame(self.node << 8 | source & 0x7F, answer.ljust(length, b"\x50"))]

    def _obey(self, data: bytes) -> bytes:
        """Obey the subframes in order; return the answer, as far as the frame can be read."""
        answer, offset = bytearray(), 0
        try:
            while offset < len(data) and len(answer) <= LENGTHS[-1] - LEAST_FREE_BYTES:
                kind, offset = data[offset], offset + 1
                if kind < 0x20:
                    offset = self._obey_registers(kind, data, offset, answer)
                elif kind in (0x40, 0x42):
                    offset = self._obey_tunnel(kind, data, offset, answer)
                elif kind != 0x50:
                    break
        except (IndexError, struct.error):
            return bytes(answer)
        return bytes(answer)

    def _obey_tunnel(self, kind: int, data: bytes, offset: int, answer: bytearray) -> int:
        """Receive text, or a poll for text; if no answer is requested, no text is taken from the buffer."""
        channel, offset = _varuint(data, offset)
        count, offset = _varuint(data, offset)
        most_bytes = LENGTHS[-1] - LEAST_FREE_BYTES
        if kind == 0x40:
            if offset + count > len(data):
                raise IndexError
            self._read_text(data[offset : offset + count])
            offset += count
        else:
            most_bytes = min(count, most_bytes)
        if self._answer_requested:
            text, self._text = self._text[:most_bytes], self._text[most_bytes:]
            answer += bytes((0x41, channel, len(text))) + text
        return offset

    def _obey_registers(self, kind: int, data: bytes, offset: int, answer: bytearray) -> int:
        """Write or read the registers of one subframe; an unknown register ends the reading of the frame."""
        resolution, count, head = kind >> 2 & 3, kind & 3, b""
        if not count:
            count, offset = _varuint(data, offset)
            head = _encoded_varuint(count)
        register, offset = _varuint(data, offset)
        layout = LAYOUTS[resolution]
        if kind < 0x10:
            for number in range(register, register + count):
                (raw,) = layout.unpack_from(data, offset)
                offset += layout.size
                if error := self._write(number, _decode(number, resolution, raw)):
                    answer += bytes((0x30,)) + _encoded_varuint(number) + bytes((error,))
            return offset
        if not self._answer_requested:
            return offset
        head = bytes((kind + 0x10,)) + head + _encoded_varuint(register)
        if len(answer) + len(head) + count * layout.size > LENGTHS[-1]:
            answer += bytes((0x31,)) + _encoded_varuint(register) + bytes((NO_ROOM,))
            return offset
        values = b""
        for number in range(register, register + count):
            value = self._read(number, resolution)
            if value is None:
                answer += bytes((0x31,)) + _encoded_varuint(number) + bytes((UNKNOWN_REGISTER,))
                raise IndexError
            values += layout.pack(_encode(number, resolution, value))
        answer += head + values
        return offset

    def _write(self, register: int, value: float) -> int:
        """Write a register; return an error code, 0 if there is none."""
        if register == Register.MODE:
            if not 0 <= value < len(MODES):
                return NO_MODE
            self._wrote_mode, self._commanded_mode = True, int(value)
            self._commanded = dict(DEFAULT_COMMANDS)
        elif register in DEFAULT_COMMANDS:
            self._commanded[Register(register)] = value
        else:
            return UNKNOWN_REGISTER if self._read(register, 2) is None else NOT_WRITEABLE
        return 0

    def _read(self, register: int, resolution: int) -> float | None:
        """Return the value of a register; None if there is no such register in this resolution."""
        if register in DEFAULT_COMMANDS:
            return self._commanded[Register(register)]
        if register in (Register.POSITION, Register.VELOCITY, Register.TORQUE, Register.Q_CURRENT):
            current, velocity, angle = self._machine_state
            amplitude = current * TO_AMPLITUDE
            current_flows = self.mode in (*COMMAND_MODES, OperatingMode.TIMEOUT)
            return {
                Register.POSITION: angle / TURN,
                Register.VELOCITY: velocity / TURN,
                Register.TORQUE: amplitude * self._torque_constant if current_flows else 0.0,
                Register.Q_CURRENT: amplitude,
            }[Register(register)]
        if register == Register.VOLTAGE:
            return self._machine.bus_voltage
        values: dict[int, float] = {
            Register.MODE: self.mode,
            Register.FAULT: self.fault_code,
            Register.TEMPERATURE: self.temperature,
        }
        integers: dict[int, int] = dict(
            zip(range(Register.SERIAL_NUMBER, Register.SERIAL_NUMBER + 3), self.words, strict=True)
        ) | {
            Register.MODEL_NUMBER: self.model,
            Register.FIRMWARE_VERSION: self.firmware,
            Register.REGISTER_MAP_VERSION: self.map_version,
        }
        if register in integers:
            return integers[register] if resolution == 2 else None
        return values.get(register)

    # -- commands ----------------------------------------------------------------------------------------------------

    def _take_command(self, now: float) -> None:
        """Change the mode as the firmware does: only a stop ends a fault or a time-out."""
        if self._commanded_mode == OperatingMode.STOPPED:
            self.mode, self.fault_code = int(OperatingMode.STOPPED), 0
            self._expires = self._enabled_at = math.inf
            self._machine.command("off", 0.0)
        elif self._commanded_mode in COMMAND_MODES and self.mode not in (OperatingMode.FAULT, OperatingMode.TIMEOUT):
            timeout = self._commanded[Register.COMMAND_TIMEOUT] or self.parameters["servo.default_timeout_s"]
            self._expires = math.inf if math.isnan(timeout) else now + timeout
            if self.mode == OperatingMode.STOPPED:
                self.mode, self._enabled_at = ENABLING_MODES[0], now + ENABLE_S
            elif self.mode in COMMAND_MODES:
                self._enter_operation()

    def _enter_operation(self) -> None:
        """Follow the command; a position mode that begins outside its bounds is a fault."""
        turns = self._machine.read()[2] / TURN
        low, high = self.parameters["servopos.position_min"], self.parameters["servopos.position_max"]
        is_entered = self.mode != OperatingMode.POSITION == self._commanded_mode
        if is_entered and (turns < low or turns > high):
            self._fail(OUTSIDE_LIMIT)
            return
        self.mode = self._commanded_mode
        self._follow_command()

    def _follow_command(self) -> None:
        """Let the motor follow the command within the limits; a limit that acts sets its fault code."""
        commanded, self.fault_code = self._commanded, 0
        position, velocity = commanded[Register.COMMAND_POSITION], commanded[Register.COMMAND_VELOCITY]
        if self.mode == OperatingMode.CURRENT:
            self._machine.command(
                "current", self._limited_current(commanded[Register.COMMAND_Q_CURRENT]) / TO_AMPLITUDE
            )
        elif commanded[Register.COMMAND_KP_SCALE] == 0.0 and commanded[Register.COMMAND_KD_SCALE] == 0.0:
            self._machine.command("current", self._demanded_current() / TO_AMPLITUDE)
        elif math.isnan(position):
            highest_velocity = self.parameters["servo.max_velocity"]
            if abs(velocity) > highest_velocity:
                self.fault_code = LIMIT_VELOCITY
            velocity = 0.0 if math.isnan(velocity) else max(-highest_velocity, min(highest_velocity, velocity))
            self._machine.command("velocity", velocity * TURN)
        else:
            low, high = self.parameters["servopos.position_min"], self.parameters["servopos.position_max"]
            position = low if position < low else high if position > high else position
            self._machine.command("angle", position * TURN)

    def _demanded_current(self) -> float:
        """Return the current amplitude [A] for the demanded torque."""
        torque = self._commanded[Register.COMMAND_FEEDFORWARD_TORQUE]
        highest_torque = self._commanded[Register.COMMAND_MAX_TORQUE]
        if abs(torque) > highest_torque:
            torque, self.fault_code = math.copysign(highest_torque, torque), LIMIT_TORQUE
        return self._limited_current(torque / self._torque_constant)

    def _limited_current(self, amplitude: float) -> float:
        """Return a current amplitude [A] within the limits of configuration and temperature."""
        highest_amplitude, code = self.parameters["servo.max_current_A"], LIMIT_CURRENT
        margin = self.parameters["servo.temperature_margin"]
        derating = (self.temperature - self.parameters["servo.fault_temperature"] + margin) / margin
        if derating > 0.0:
            code = LIMIT_TEMPERATURE
            highest_amplitude = max(
                0.0,
                min(
                    highest_amplitude,
                    highest_amplitude + derating * (self.parameters["servo.derate_current_A"] - highest_amplitude),
                ),
            )
        if abs(amplitude) <= highest_amplitude:
            return amplitude
        self.fault_code = code
        return math.copysign(highest_amplitude, amplitude)

    @property
    def _torque_constant(self) -> float:
        """Torque at the output per ampere of amplitude [N*m/A]."""
        return TORQUE_FACTOR / self.parameters["motor.Kv"] / self.parameters["motor_position.rotor_to_output_ratio"]

    # -- text --------------------------------------------------------------------------------------------------------

    def _read_text(self, text: bytes) -> None:
        """Obey the lines that are complete."""
        *lines, self._line = (self._line + text).replace(b"\r", b"\n").split(b"\n")
        for line in lines:
            if line.strip():
                self._text += self._answer_to(line.decode("ascii", "replace").split()).encode("ascii") + b"\r\n"

    def _answer_to(self, words: list[str]) -> str:
        """Obey a line of these words, and return its answer."""
        if len(words) < 3 or words[0] != "conf" or words[1] not in ("get", "set"):
            return "ERR unknown command"
        if words[2] not in self.parameters:
            return "ERR error reading" if words[1] == "get" else "ERR error setting"
        if words[1] == "get":
            value = self.parameters[words[2]]
            return f"{value}" if isinstance(value, int) else f"{value:.8f}"
        try:
            self.parameters[words[2]] = float(words[3])
        except (IndexError, ValueError):
            return "ERR error setting"
        return "OK"

    @property
    def serial_number(self) -> str:
        """Serial number as `moteus_tool --info` prints it."""
        return base64.b64encode(struct.pack(">3I", *self.words)).decode("ascii")

    @serial_number.setter
    def serial_number(self, text: str) -> None:
        try:
            self.words = list(struct.unpack(">3I", base64.b64decode(text, validate=True)))
        except (NotBase64, struct.error):
            return  # three words cannot hold another text

    # -- faults inside the drive -------------------------------------------------------------------------------------

    def freeze(self, frozen: bool) -> None:
        """Stop answering and keep the last demand (`frozen` True), or return to normal."""
        self.frozen = frozen

    def restart(self) -> None:
        """Come back from a loss of power: stopped, without faults, with the stored parameters."""
        self.frozen, self.mode, self.fault_code = False, int(OperatingMode.STOPPED), 0
        self.parameters, self._commanded = dict(self.stored), dict(DEFAULT_COMMANDS)
        self._expires = self._enabled_at = math.inf
        self._line, self._text = b"", b""
        self._machine.command("off", 0.0)

    def fault(self, code: int) -> None:
        """Enter fault with the maker's code that is closest to this CiA 301 code."""
        self._fail(FAULT_OF_CLASS.get(code >> 8, MOTOR_DRIVER))


def _varuint(data: bytes, offset: int) -> tuple[int, int]:
    """Decode an integer; return it and the offset after it."""
    number = 0
    for shift in range(0, 35, 7):
        number |= (data[offset] & 0x7F) << shift
        offset += 1
        if not data[offset - 1] & 0x80:
            return number, offset
    raise IndexError


def _encoded_varuint(number: int) -> bytes:
    """Encode an integer in groups of seven bits."""
    first_byte = bytes((number & 0x7F | (0x80 if number > 0x7F else 0),))
    return first_byte + _encoded_varuint(number >> 7) if number > 0x7F else first_byte


def _decode(register: int, resolution: int, raw: float) -> float:
    """Return the physical value or integer for the code of a register."""
    scales = SCALES.get(register)
    if resolution == 3 or scales is None:
        return raw
    return math.nan if raw == LOWEST_CODES[resolution] else raw * scales[resolution]


def _encode(register: int, resolution: int, value: float) -> float:
    """Return the code of a value as the firmware does: clipped, not rounded, the lowest code for NaN."""
    if resolution == 3:
        return value
    highest_code = -LOWEST_CODES[resolution] - 1
    if register not in SCALES:
        wrapped = int(value) & (2 * highest_code + 1)
        return wrapped - 2 * (highest_code + 1) if wrapped > highest_code else wrapped
    if math.isnan(value):
        return LOWEST_CODES[resolution]
    return int(max(-highest_code, min(highest_code, value / SCALES[register][resolution])))
