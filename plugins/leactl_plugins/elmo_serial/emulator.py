"""Emulator of an Elmo drive on a serial line: its interpreter, its motor, and the program that monitors the host.

Bytes in, bytes out; it shares only the bits of SR and MF with the driver. The echo is sent at once, byte by byte,
before answers that are not sent yet (SimplIQ Software Manual, 3.2).
"""

import math
import re
import struct
from collections import deque

from leactl.driver.far_end import Machine
from leactl_plugins.elmo.fault_names import bits_of
from leactl_plugins.elmo_serial.status import (
    CURRENT_LIMITED,
    FAULT_LATCHED,
    MOTION_SHIFT,
    MOTOR_ON,
    PROGRAM_RUNNING,
    UNIT_MODE_SHIFT,
)

BAD_COMMAND, BAD_INDEX, NEEDS_INDEX, EMPTY, SYNTAX, RANGE, READ_ONLY = 2, 3, 16, 18, 19, 21, 23
NOT_IN_THIS_MODE, MOTOR_MUST_BE_OFF, MOTOR_MUST_BE_ON, BAD_UNIT_MODE, NOTHING_YET = 12, 57, 58, 60, 164
BAD_NUMBER = 162
BAD_START, NO_DATA = 7, 70
RC_BITS = 16
LONG_SIGNALS = (1, 2)  # numbers of the signals that are uploaded in 8 digits
CURRENT_PER_BIT = 0.0078125  # A, of an uploaded number
MOST_COMMAND_BYTES = 512  # of a command, of which only the last are kept
EXECUTE_S = 2e-4  # time from the end of a command to the first byte of its answer
TICK_S = 0.01  # time between two checks of the host's counter by the program
LARGEST_INTEGER = 0x7FFFFFFF
UNIT_MODES = {1, 2, 3, 4, 5}
FOLLOWED_QUANTITIES = {1: "current", 2: "velocity", 4: "angle", 5: "angle"}  # by unit mode
DEMAND_UNIT_MODES = {"TC": (1,), "JV": (2, 5), "PA": (4, 5)}  # unit modes in which a demand may be set
VERSION = "Whistle 1.01.12.00 08Mar2018"
_command_form = re.compile(r"([A-Z]{2})(?:\[([0-9]{1,4})\])?(=(.*))?", re.ASCII | re.DOTALL)
_number_form = re.compile(r"[-+]?[0-9]+(\.[0-9]*)?([eE][-+]?[0-9]+)?", re.ASCII)


class InterpreterError(Exception):
    """Refusal of a command, with its error number."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class ElmoSerialEmulator:
    """One drive at the end of a line, which turns a motor."""

    def __init__(
        self,
        machine: Machine,
        *,
        counts_per_turn: int,
        q_axis_per_ampere: float = math.sqrt(1.5),
        peak_current: float = 40.0,
        continuous_current: float = 40.0,
        voltage_command: str | None = "AN[6]",
        variables: tuple[str, str] = ("UI[1]", "UI[2]"),
    ) -> None:
        self._machine, self._q_axis_per_ampere = machine, q_axis_per_ampere
        self._counts_per_rad = counts_per_turn / (2.0 * math.pi)
        self._voltage_command, self._watched_variables = voltage_command, variables
        self.values: dict[str, float] = {  # of the variables that can be set, by name with index
            "EO": 1,
            "HX": 0,
            "UM": 5,
            "TC": 0.0,
            "JV": 0,
            "PA": 0,
            "PL[1]": peak_current,
            "CL[1]": continuous_current,
            "VL[2]": -2_000_000_000,
            "VH[2]": 2_000_000_000,
            "XM[1]": -1_000_000_000,
            "XM[2]": 1_000_000_000,
            "CA[18]": counts_per_turn,
            "RC": 0,
            "RG": 1,
            "RL": 1024,
            "WS[29]": 100,
            **{f"RV[{number}]": number for number in range(1, 17)},
            **{f"UI[{number}]": 0 for number in range(1, 25)},
        }
        self._recording: dict[int, list[int]] = {}  # samples of the recorder, by bit of RC
        self._next_sample, self._samples_left = math.inf, 0
        self.serial_number = "1"
        self.on = False
        self.program_running = True  # the program starts by itself when the drive gets power
        self.fault_bits = 0  # MF
        self.frozen = False  # whether it has stopped answering
        self._last_error = NOTHING_YET
        self._begun_motion: tuple[str, float] | None = None
        self._input = b""
        self._output: deque[tuple[float, bytes]] = deque()
        self._busy = 0.0
        self._last_counter, self._quiet_ticks, self._next_tick = 0.0, 0, 0.0

    # -- the wire ----------------------------------------------------------------------------------------------------

    @property
    def due(self) -> float:
        """Time [s] of the next echo, answer, sample, or check of the host's counter."""
        if self.frozen:
            return math.inf
        tick = self._next_tick if self.on and self.program_running else math.inf
        return min(self._output[0][0] if self._output else math.inf, tick, self._next_sample)

    def receive(self, data: bytes, now: float) -> None:
        """Receive bytes; each is echoed at once, and a semicolon or a carriage return ends a command."""
        if self.frozen:
            return
        for byte in data:
            if self.values["EO"]:
                self._output.appendleft((now, bytes((byte,))))
            if byte not in b";\r\n":
                self._input += bytes((byte,))
            elif self._input:
                command, self._input = self._input[-MOST_COMMAND_BYTES:].decode("latin-1"), b""
                answer = self._obey(command, now)
                self._busy = max(self._busy, now) + EXECUTE_S
                self._output.append((self._busy, answer))

    def tick(self, now: float) -> bytes:
        """Run the program and the recorder if they are due; return bytes that are ready."""
        if self.on and self.program_running and now >= self._next_tick:
            self._next_tick += TICK_S
            self._check_counter()
        if now >= self._next_sample:
            self._sample()
        if self._output and now >= self._output[0][0]:
            return self._output.popleft()[1]
        return b""

    # -- inside the drive --------------------------------------------------------------------------------------------

    def _check_counter(self) -> None:
        """Switch off if the host's counter has not changed for the allowed time, as the drive's program does."""
        counter, allowed_ms = (self.values[variable] for variable in self._watched_variables)
        if counter != self._last_counter:
            self._last_counter, self._quiet_ticks = counter, 0
        else:
            self._quiet_ticks += 1
        if 1e3 * TICK_S * self._quiet_ticks >= allowed_ms:
            self._switch(False)

    def freeze(self, frozen: bool) -> None:
        """Stop answering and keep the last demand, program included (`frozen` True), or return to normal."""
        self.frozen = frozen

    def fault(self, code: int) -> None:
        """Switch the motor off, and latch the bit of MF for the code of an emergency message."""
        self._switch(False)
        self.fault_bits = bits_of(code)

    def _switch(self, on: bool, now: float = 0.0) -> None:
        """Switch the motor; switching it on clears the fault and the demands."""
        self.on, self._begun_motion = on, None
        if on:
            self.fault_bits, self.values["TC"], self.values["JV"] = 0, 0.0, 0
            self._quiet_ticks, self._next_tick = 0, now + TICK_S
            self._last_counter = self.values[self._watched_variables[0]]
            self.values["PA"] = self._wrapped_position()
            self._begun_motion = ("angle", self._machine.read()[2]) if self.values["UM"] in (4, 5) else None
            self._move()
        else:
            self._machine.command("off", 0.0)

    def _move(self) -> None:
        """Let the motor follow the demand of the unit mode, limited to the continuous current."""
        mode = FOLLOWED_QUANTITIES.get(int(self.values["UM"]), "off")
        if mode == "current":
            self._machine.command("current", self._limited_current() * self._q_axis_per_ampere)
        elif self._begun_motion is not None:
            self._machine.command(*self._begun_motion)
        else:
            self._machine.command(mode if mode == "velocity" else "off", 0.0)

    def _limited_current(self) -> float:
        """Return the demanded current within the limits [A]; the peak current of a few seconds is not emulated."""
        highest_current = min(self.values["PL[1]"], self.values["CL[1]"])
        return max(-highest_current, min(highest_current, self.values["TC"]))

    def _wrapped_position(self) -> int:
        """Return the angle of the shaft in counts, wrapped to the range of the drive."""
        counts = round(self._machine.read()[2] * self._counts_per_rad)
        low, high = int(self.values["XM[1]"]), int(self.values["XM[2]"])
        return (counts - low) % (high - low) + low if high > low else counts

    @property
    def status(self) -> int:
        """Status register SR."""
        moving = self._begun_motion is not None
        limited = self.on and self.values["UM"] == 1 and self._limited_current() != self.values["TC"]
        return (
            (MOTOR_ON if self.on else 0)
            | (FAULT_LATCHED if self.fault_bits else 0)
            | int(self.values["UM"]) << UNIT_MODE_SHIFT
            | (PROGRAM_RUNNING if self.program_running else 0)
            | (CURRENT_LIMITED if limited else 0)
            | (2 if moving else 1 if not self.on else 0) << MOTION_SHIFT
        )

    # -- the recorder ------------------------------------------------------------------------------------------------

    def _set_recording(self, state: float, now: float) -> None:
        """Start recording at once (RR=2) or stop (RR=0); a trigger is not emulated."""
        if state not in (0, 2):
            raise InterpreterError(RANGE)
        self._recording = {bit: [] for bit in range(RC_BITS) if int(self.values["RC"]) >> bit & 1} if state else {}
        if state and not self._recording:
            raise InterpreterError(BAD_START)
        self._samples_left = int(self.values["RL"]) if state else 0
        self._next_sample = now if state else math.inf

    def _sample(self) -> None:
        """Record a sample of each chosen signal."""
        current, velocity, angle = self._machine.read()
        counted_signals = {1: velocity * self._counts_per_rad, 2: angle * self._counts_per_rad}
        scaled_signals = {10: current / self._q_axis_per_ampere / CURRENT_PER_BIT, 7: self._machine.bus_voltage}
        for bit, items in self._recording.items():
            signal = int(self.values[f"RV[{bit + 1}]"])
            items.append(round((counted_signals | scaled_signals).get(signal, 0.0)))
        self._samples_left -= 1
        self._next_sample += 1e-6 * self.values["RG"] * self.values["WS[29]"]
        if not self._samples_left:
            self._next_sample = math.inf

    def _upload(self, signal_mask: float) -> str:
        """Return the answer to BH: the recording of the lowest bit of RC in the mask, in items of 4 or 8 digits."""
        requested = int(signal_mask) & int(self.values["RC"])
        bit = (requested & -requested).bit_length() - 1
        if self._samples_left or bit not in self._recording:
            raise InterpreterError(NO_DATA)
        is_long = int(self.values[f"RV[{bit + 1}]"]) in LONG_SIGNALS
        factor = CURRENT_PER_BIT if self.values[f"RV[{bit + 1}]"] == 10 else 1.0
        items, layout = self._recording[bit], ">i" if is_long else ">h"
        head = (
            f"00{8 if is_long else 4:02x}{len(items):04x}{int(self.values['RG']):04x}{struct.pack('>f', factor).hex()}"
        )
        return head + b"".join(struct.pack(layout, item) for item in items).hex()

    # -- the interpreter ---------------------------------------------------------------------------------------------

    def _obey(self, command: str, now: float) -> bytes:
        """Execute one command; return its answer with its end."""
        try:
            answer = self._answer_of(command, now)
        except InterpreterError as error:
            self._last_error = error.number
            return bytes((error.number,)) + b"?;"
        return answer.encode("ascii") + b";"

    def _answer_of(self, command: str, now: float) -> str:
        """Execute one command and return its answer; raise InterpreterError if it is refused."""
        match = _command_form.fullmatch(command)
        if match is None:
            raise InterpreterError(BAD_COMMAND if not re.match(r"[A-Z]{2}", command) else SYNTAX)
        name = match[1] if match[2] is None else f"{match[1]}[{int(match[2])}]"
        if match[3] is None:
            return self._execute(name) if name in ("BG", "ST") else self._query(name)
        if not match[4]:
            raise InterpreterError(EMPTY)
        if not _number_form.fullmatch(match[4]):
            raise InterpreterError(BAD_NUMBER)
        if name == "BH":
            return self._upload(float(match[4]))
        self._set(name, float(match[4]), now)
        return ""

    def _query(self, name: str) -> str:
        """Return the answer to a query; raise InterpreterError if there is no such variable."""
        current, velocity, _ = self._machine.read()
        if name == "IQ":
            return f"{current / self._q_axis_per_ampere:.4f}" if self.on else "0"
        if name == self._voltage_command:
            return f"{self._machine.bus_voltage:.2f}"
        integers = {
            "ID": 0,
            "VX": round(velocity * self._counts_per_rad),
            "PX": self._wrapped_position(),
            "SR": self.status,
            "MO": int(self.on),
            "MF": self.fault_bits,
            "MS": self.status >> MOTION_SHIFT & 3,
            "EC": self._last_error,
            "RR": 2 if self._samples_left else 0 if self._recording else -1,
        }
        if name in integers:
            return str(integers[name])
        if name in ("VR", "SN[4]"):
            return VERSION if name == "VR" else self.serial_number
        if name in self.values:
            return f"{self.values[name]:.10g}"
        raise InterpreterError(self._unknown_variable_error(name))

    def _unknown_variable_error(self, name: str) -> int:
        """Return the error number for an unknown variable."""
        letters = name[:2]
        vectors = {variable[:2] for variable in self.values if "[" in variable} | {"AN", "SN"}
        if letters in vectors:
            return BAD_INDEX if "[" in name else NEEDS_INDEX
        return BAD_COMMAND

    def _set(self, name: str, value: float, now: float) -> None:
        """Set a variable; raise InterpreterError if the drive refuses it."""
        if name in ("MO", "RR"):
            (self._set_motor if name == "MO" else self._set_recording)(value, now)
            return
        if name not in self.values:
            read_only = ("IQ", "ID", "VX", "PX", "SR", "MF", "MS", "EC", "VR", "SN[4]", self._voltage_command)
            raise InterpreterError(READ_ONLY if name in read_only else self._unknown_variable_error(name))
        if name == "UM":
            if self.on:
                raise InterpreterError(MOTOR_MUST_BE_OFF)
            if value not in UNIT_MODES:
                raise InterpreterError(BAD_UNIT_MODE)
        if name in DEMAND_UNIT_MODES:
            if self.values["UM"] not in DEMAND_UNIT_MODES[name]:
                raise InterpreterError(NOT_IN_THIS_MODE)
            if name == "TC" and not self.on:
                raise InterpreterError(MOTOR_MUST_BE_ON)
        low, high = self._range_of(name)
        if not low <= value <= high:
            raise InterpreterError(RANGE)
        self.values[name] = value if name in ("TC", "PL[1]", "CL[1]") else round(value)
        if name == "TC":
            self._move()

    def _range_of(self, name: str) -> tuple[float, float]:
        """Return the lowest and the highest value that a variable can take."""
        if name == "TC":
            return -self.values["PL[1]"], self.values["PL[1]"]
        if name == "JV":
            return self.values.get("VL[2]", -LARGEST_INTEGER), self.values.get("VH[2]", LARGEST_INTEGER)
        return (0, 1) if name in ("EO", "HX") else (-LARGEST_INTEGER - 1, LARGEST_INTEGER)

    def _set_motor(self, value: float, now: float) -> None:
        if value not in (0, 1):
            raise InterpreterError(RANGE)
        if bool(value) != self.on:
            self._switch(bool(value), now)

    def _execute(self, name: str) -> str:
        """Start (BG) or stop (ST) a motion."""
        if not self.on:
            raise InterpreterError(MOTOR_MUST_BE_ON)
        mode = self.values["UM"]
        if mode == 2:
            self._begun_motion = ("velocity", self.values["JV"] / self._counts_per_rad if name == "BG" else 0.0)
        elif mode in (4, 5):
            angle = self._machine.read()[2]
            if name == "BG":
                span = int(self.values["XM[2]"] - self.values["XM[1]"])
                ahead = (int(self.values["PA"]) - self._wrapped_position() + span // 2) % span - span // 2
                angle += ahead / self._counts_per_rad
            self._begun_motion = ("angle", angle)
        else:
            raise InterpreterError(NOT_IN_THIS_MODE)
        self._move()
        return ""
