"""Numbered queries to one controller: match answers to queries, and count lost, late and surplus answers.

Each query writes its number into a register that the controller uses in PWM mode only, and reads it back in the same
frame: an answer carries the number of its query, whatever was lost or late before it.
"""

import math
from dataclasses import replace
from typing import NamedTuple

from leactl.driver.answer_matching import IrregularAnswers
from leactl.driver.can_port import CanPort
from leactl_plugins.moteus_can.multiplex import ControllerReply, Resolution, pad, read, write
from leactl_plugins.moteus_can.registers import MODES, Register

NUMBER_REGISTER = Register.PWM_PHASE_A
LAST_NUMBER = 1 << 23  # whole numbers up to this are exact in single precision
MOST_UNANSWERED_QUERIES = 64  # that are remembered, because their answers may still arrive
LARGEST_TURNS = 32768.0  # of the position that a controller can report


class RegisterQuery(NamedTuple):
    """A query: its subframes, and the registers that an answer has to hold, each once."""

    subframes: bytes
    registers: frozenset[int]  # their numbers


def query(*register_ranges: tuple[Register, int, Resolution]) -> RegisterQuery:
    """Return a query of registers; each range is its first register, their number, and their resolution."""
    registers = {
        number
        for first_register, count, _ in register_ranges
        for number in range(first_register, first_register + count)
    }
    subframes = read(NUMBER_REGISTER) + b"".join(read(*register_range) for register_range in register_ranges)
    return RegisterQuery(subframes, frozenset((NUMBER_REGISTER, *registers)))


class ControllerExchange:
    """The queries to one controller, and its answers."""

    def __init__(self, port: CanPort, identifier: int) -> None:
        self._port, self._identifier = port, identifier
        self._number, self._awaited_registers = 0, frozenset[int]()
        self._unanswered: dict[float, bool] = {}  # by number: whether the answer was counted as lost
        self._answered_number, self._answer_frame = 0, b""
        self.came = [False]  # whether the answer to the last query has arrived
        self.begin()

    def begin(self) -> None:
        """Reset all counts."""
        self.irregular, self._irregular_reported = IrregularAnswers(), IrregularAnswers()
        self.unreadable, self._unreadable_reported, self._last_unreadable = 0, 0, ""
        self.second_controller = False

    def ask(self, command: bytes, register_query: RegisterQuery) -> None:
        """Send a command, which may be empty, and a query; does not wait.

        Raises
        ------
        DeviceError : the bus is closed, full or gone, or carries classic frames only.
        """
        self._number = self._number % LAST_NUMBER + 1
        self._awaited_registers, self.came[0] = register_query.registers, False
        self._unanswered[self._number] = False
        if len(self._unanswered) > MOST_UNANSWERED_QUERIES:
            del self._unanswered[next(iter(self._unanswered))]
        number = write(NUMBER_REGISTER, [float(self._number)])  # behind the command, whose mode resets this register
        self._port.send_fd(self._identifier, pad(command + number + register_query.subframes))

    def is_answered(self, command: bytes, register_query: RegisterQuery, deadline: float) -> bool:
        """Send a command and a query, and wait for the answer until a deadline [s]; return whether it came."""
        self.ask(command, register_query)
        return self._port.pump_until(self.came, deadline)

    def give_up(self) -> None:
        """Count the answer to the last query as lost, unless it arrives later."""
        self.irregular.lost += 1
        self._unanswered[self._number] = True

    def accept(self, reply: ControllerReply, data: bytes) -> bool:
        """Take a reply; return whether it answers the last query, and count it if it does not."""
        number = reply.values.get(NUMBER_REGISTER, math.nan)
        if self.came[0] or number != self._number:
            self._count_other(number, data)
            return False
        if fault := self._fault_of(reply):
            self.count_unreadable(fault)
            return False
        self._answered_number, self._answer_frame = self._number, data
        self._unanswered.pop(self._number, None)
        self.came[0] = True
        return True

    def count_unreadable(self, fault: str) -> None:
        """Count a frame that cannot be trusted."""
        self.unreadable += 1
        self._last_unreadable = fault

    def notices(self) -> list[str]:
        """Return lines for irregular and for unreadable answers since the last call."""
        lines = []
        if self.irregular != self._irregular_reported:
            self._irregular_reported = replace(self.irregular)
            lines.append(str(self.irregular))
        if self.unreadable != self._unreadable_reported:
            self._unreadable_reported = self.unreadable
            lines.append(f"{self.unreadable} answers could not be used; the last one {self._last_unreadable}")
        return lines

    def _count_other(self, number: float, data: bytes) -> None:
        """Count an answer to an earlier query, or to none.

        A controller's frame may arrive twice; a different frame with the same number is from another controller.
        """
        was_given_up = self._unanswered.pop(number, None)
        if was_given_up:
            self.irregular.late += 1
            self.irregular.lost -= 1
        elif was_given_up is None:
            self.irregular.surplus += 1
            if number == self._answered_number and data != self._answer_frame:
                self.second_controller = True

    def _fault_of(self, reply: ControllerReply) -> str:
        """Return why a reply with the right number is not a valid answer; empty if it is valid."""
        values = reply.values
        if reply.errors:
            refusals = ", ".join(f"0x{register:03X} (error {code})" for register, code in reply.errors.items())
            return f"refuses the registers {refusals}"
        if values.keys() != self._awaited_registers:
            return f"holds {len(values)} registers where {len(self._awaited_registers)} were asked for"
        mode, fault = values[Register.MODE], values[Register.FAULT]
        if mode not in MODES or fault < 0:
            return f"holds mode {mode:g} and fault {fault:g}"
        turns = abs(values.get(Register.POSITION, 0.0))
        if turns > LARGEST_TURNS or any(math.isinf(value) for value in values.values()):
            return "holds a value that no controller can have"
        return ""
