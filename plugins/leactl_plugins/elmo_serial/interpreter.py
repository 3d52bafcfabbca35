"""Exchanges with an Elmo's interpreter: several commands at a time, and the assignment of answers to exchanges.

Each command ends with a semicolon. The answers come in order: a value and a semicolon for a query, a semicolon alone
for an assignment, or a binary error number, `?` and a semicolon (SimplIQ Software Manual, 3.1). An answer does not name
its command. An exchange therefore begins by setting a variable to a tag that no recent exchange has used, and ends
by querying it: only answers in the expected form before that tag belong to the exchange.
"""

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from leactl.driver.conversation import Unreadable
from leactl.driver.serial_port import SerialPort
from leactl.errors import DeviceError, NoAnswer
from leactl_plugins.elmo.fault_names import refusal

END, REFUSED = b";", b"?"
SPOIL_COMMAND = b"!;"  # makes an incomplete earlier command invalid, which might otherwise be MO=1
ACTIONS = frozenset(("BG", "ST"))  # commands without a value, whose answers are empty
UPLOAD_COMMAND = "BH="  # has the form of an assignment, but its answer has a value
TAG_COUNT = 900  # tags of three digits
FIRST_TAG = 100
LONGEST_VALUE_BYTES = 64  # of an answer other than an upload
MOST_SEGMENTS = 200  # received for one exchange; after more, it is given up
# error numbers by which the drive refuses a command that was garbled on the line
GARBLED_COMMAND_ERRORS = frozenset((2, 3, 5, 16, 18, 19, 32, 97, 110, 136, 162))
_number_form = re.compile(rb"[-+]?[0-9]+(\.[0-9]*)?([eE][-+]?[0-9]+)?", re.ASCII)
_integer_form = re.compile(rb"-?[0-9]{1,10}", re.ASCII)


class CommandRefused(DeviceError):
    """Refusal of a command that the drive has understood."""

    def __init__(self, command: str, number: int) -> None:
        super().__init__(f"{command} is refused: {refusal(number)}")
        self.command, self.number = command, number


class Replies:
    """Answers of one exchange, and the error numbers of its refused commands, by command."""

    def __init__(self, values: dict[str, bytes], refused: dict[str, int]) -> None:
        self._values, self.refused = values, refused

    def __contains__(self, command: str) -> bool:
        """Return whether a command is in the exchange and was not refused."""
        return command in self._values

    def check(self) -> None:
        """Check that no command was refused.

        Raises
        ------
        CommandRefused : the drive refused a command; the error is that of the first one.
        Unreadable : by its error number, that command was garbled on the line.
        """
        for command, number in self.refused.items():
            if number in GARBLED_COMMAND_ERRORS:
                raise Unreadable(f"{command} was not understood: {refusal(number)}")
            raise CommandRefused(command, number)

    def text(self, command: str) -> str:
        """Return an answer as printable text.

        Raises
        ------
        CommandRefused : the command was refused.
        """
        if command in self.refused:
            raise CommandRefused(command, self.refused[command])
        return self._values[command].decode("ascii", "backslashreplace").strip()

    def number(self, command: str) -> float:
        """Return an answer as a number.

        Raises
        ------
        Unreadable : the answer has another form.
        CommandRefused : the command was refused.
        """
        value = float(self._read(command, _number_form, "a number"))
        if not math.isfinite(value):
            raise Unreadable(f"{command} was answered by '{self.text(command)}' where a number was expected")
        return value

    def integer(self, command: str) -> int:
        """Return an answer as an integer of 32 bits.

        Raises
        ------
        Unreadable : the answer has another form.
        CommandRefused : the command was refused.
        """
        value = int(self._read(command, _integer_form, "a whole number"))
        if not -0x80000000 <= value <= 0xFFFFFFFF:
            raise Unreadable(f"{command} was answered by {value} where 32 bits were expected")
        return value

    def _read(self, command: str, form: re.Pattern[bytes], expected: str) -> bytes:
        """Return an answer of this form; raise CommandRefused or Unreadable if there is none."""
        if command in self.refused:
            raise CommandRefused(command, self.refused[command])
        value = self._values[command]
        if not form.fullmatch(value):
            raise Unreadable(f"{command} was answered by '{self.text(command)}' where {expected} was expected")
        return value


class _PendingExchange(NamedTuple):
    """An exchange that is not completely answered yet."""

    commands: Sequence[str]
    tag: bytes
    sent: float  # s


class Interpreter:
    """Exchanges over one line; at most one is pending, so that the drive's receive buffer does not overflow."""

    def __init__(self, port: SerialPort, tag_variable: str) -> None:
        port.line_end = END
        self._port, self._clock, self._tag_variable = port, port.clock, tag_variable
        self._pending: _PendingExchange | None = None
        self._segments: list[bytes] = []
        self._exchange_number = 0
        self.garbled = False  # whether answers to the pending exchange ended with its tag, in an unexpected form
        self.surplus = 0  # answers that belonged to no exchange
        self.asked_at = self.answered_at = 0.0  # times [s] at which the last answered exchange was sent and answered

    @property
    def pending_since(self) -> float | None:
        """Time [s] at which the pending exchange was sent; None if there is none."""
        return self._pending.sent if self._pending else None

    def begin(self, commands: Sequence[str], tag_variable: str = "", prefix: bytes = b"") -> None:
        """Send an exchange; a pending one is abandoned.

        `tag_variable` receives the exchange's tag; by default, it is one that the drive's program does not monitor.
        The bytes of `prefix` are sent before the exchange.

        Raises
        ------
        DeviceError : the line is gone, or takes no more.
        """
        variable = tag_variable or self._tag_variable
        self._exchange_number = (self._exchange_number + 1) % TAG_COUNT
        tag = str(FIRST_TAG + self._exchange_number)
        self.give_up()
        text = ";".join((f"{variable}={tag}", *commands, variable, ""))
        self._port.write(prefix + text.encode("ascii"))
        self._pending = _PendingExchange(commands, tag.encode("ascii"), self._clock.now())

    def give_up(self) -> None:
        """Abandon the pending exchange, and count the answers to it as surplus."""
        self._pending, self.garbled = None, False
        self.surplus += len(self._segments)
        self._segments.clear()

    def collect(self, until: float) -> Replies | None:
        """Return the answers to the pending exchange once they are complete; None if `until` [s] passes before.

        Raises
        ------
        DeviceError : the line is gone.
        """
        pending = self._pending
        while pending is not None:
            segment = self._port.take_line()
            if segment is None:
                if self._clock.now() >= until:
                    return None
                self._port.wait(until)
                continue
            self._add(segment)
            if len(self._segments) > MOST_SEGMENTS:
                self.give_up()
                return None
            if self._segments[-1] == pending.tag:
                replies = _decode(self._segments[-len(pending.commands) - 2 :], pending.commands)
                if replies is not None:
                    self.surplus += len(self._segments) - len(pending.commands) - 2
                    self._segments.clear()
                    self.asked_at, self.answered_at = pending.sent, self._clock.now()
                    self._pending, self.garbled = None, False
                    return replies
                self.garbled = True  # unless a reading equals the tag
        return None

    def drop_unasked(self) -> None:
        """Drop and count the answers that arrived while no exchange was pending.

        Raises
        ------
        DeviceError : the line is gone.
        """
        while self._port.take_line() is not None:
            self.surplus += 1

    def ask(self, *commands: str, within_s: float, attempts: int = 3) -> Replies:
        """Make an exchange and wait for its answers; it is repeated if it is lost or garbled.

        Raises
        ------
        CommandRefused : an assignment was refused; a refused query raises this when its answer is read.
        NoAnswer : none of the attempts was answered.
        DeviceError : the line is gone.
        """
        no_answer = NoAnswer(f"no answer to {', '.join(commands) or 'the interpreter'} in {within_s:g} s")
        for attempt in range(attempts):
            self.begin(commands, prefix=SPOIL_COMMAND if attempt else b"")
            replies = self.collect(self._clock.now() + within_s)
            if replies is None:
                continue
            refused_assignments = {
                command: error_number for command, error_number in replies.refused.items() if _has_empty_answer(command)
            }
            if attempt < attempts - 1 and any(
                error_number in GARBLED_COMMAND_ERRORS for error_number in refused_assignments.values()
            ):
                continue
            for command, error_number in refused_assignments.items():
                raise CommandRefused(command, error_number)
            return replies
        self.give_up()
        raise no_answer

    def _add(self, segment: bytes) -> None:
        """Add a segment of the input to the answers.

        An error number may itself be the code of a semicolon. In the manual, `?` comes after the semicolon; drives send
        it before.
        """
        if segment.startswith(REFUSED) and self._segments:
            last_segment = self._segments[-1]
            self._segments[-1] = (last_segment or END) + REFUSED
            if segment == REFUSED and not last_segment:
                return
            segment = segment[1:]
        self._segments.append(segment)


def _has_empty_answer(command: str) -> bool:
    """Return whether the answer to a command has no value: an assignment or an action, but not the upload."""
    return ("=" in command and not command.startswith(UPLOAD_COMMAND)) or command in ACTIONS


def _longest_answer_bytes(command: str) -> float:
    """Return the longest answer to a command [bytes]; infinity for an upload."""
    return math.inf if command.startswith(UPLOAD_COMMAND) else LONGEST_VALUE_BYTES


def _decode(segments: Sequence[bytes], commands: Sequence[str]) -> Replies | None:
    """Return the answers of an exchange; None if the segments do not have its form."""
    if len(segments) != len(commands) + 2 or segments[0]:
        return None
    values: dict[str, bytes] = {}
    refused: dict[str, int] = {}
    for command, segment in zip(commands, segments[1:-1], strict=True):
        if segment.endswith(REFUSED):
            if len(segment) != 2:
                return None
            refused[command] = segment[0]
        elif bool(segment) is _has_empty_answer(command) or len(segment) > _longest_answer_bytes(command):
            return None
        else:
            values[command] = segment
    return Replies(values, refused)
