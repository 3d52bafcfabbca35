"""Read and write a controller's parameters by name: `conf get` and `conf set` of its diagnostic text.

Source: mjbots, `docs/protocol/diagnostic.md` and `docs/reference/configuration.md` of the moteus repository. Written
values are held in the controller's memory only, and lost when it is switched off: `conf write` is never sent.
"""

import math

from leactl.driver.can_port import CanPort
from leactl.errors import DeviceError, NoAnswer
from leactl_plugins.moteus_can.multiplex import REPLY_REQUESTED, identifier, pad, poll_for_text, text_to_device

TIMEOUT_MODE = "servo.timeout_mode"  # reaction to an expired command
TIMEOUT_STOPPED = 0  # the power stage is switched off
KV = "motor.Kv"  # rpm/V
RATIO = "motor_position.rotor_to_output_ratio"  # turns of the output per turn of the rotor
MAX_CURRENT = "servo.max_current_A"  # amplitude
MAX_VELOCITY = "servo.max_velocity"  # revolutions/s; above it, torque is reduced
POSITION_MIN, POSITION_MAX = "servopos.position_min", "servopos.position_max"  # revolutions; NaN: none
VOLTAGE_MODE = "servo.voltage_mode_control"  # commanded currents are taken as volts
FIXED_VOLTAGE = "servo.fixed_voltage_mode"  # no encoder, no current loop
BEMF_FEEDFORWARD = "servo.bemf_feedforward"  # refused by the firmware without a limit of acceleration

CHANNEL = 1
MOST_TEXT_BYTES = 48  # of one poll's answer
MOST_TRIES = 3  # of one line: a frame may get lost
MOST_POLLS = 3  # for one answer within the loop, each of which brings as much text as a frame holds
POLL_PAUSE_S = 0.002  # time between two polls for text that is not ready yet
READ_BACK_TOLERANCE = 1e-6  # share of a value, for the controller's single precision


class Configuration:
    """The parameters of one controller."""

    def __init__(self, name: str, port: CanPort, host: int, node: int, timeout_s: float) -> None:
        self._name, self._port, self._timeout_s = name, port, timeout_s
        self._plain_identifier = identifier(host, node)
        self._reply_identifier = identifier(host | REPLY_REQUESTED, node)
        self._came = [False]
        self._text = b""
        self._parameter = ""  # that `continue_reading` queries, after text that an earlier host has left
        self._is_line_sent, self._received_text = False, b""
        self._line_sent_at, self._polls = -math.inf, 0
        self._poll_again_at = -math.inf

    def on_text(self, text: bytes) -> None:
        """Receive the text of a poll, which may be empty."""
        self._text, self._came[0] = text, True

    def read(self, parameter: str) -> float:
        """Query a parameter's value; a switch is 0 or 1.

        Raises
        ------
        DeviceError : the controller lacks it.
        NoAnswer : the controller does not answer.
        """
        return self._parse_number(parameter, self._answer_to(f"conf get {parameter}"))

    def _parse_number(self, parameter: str, answer: str) -> float:
        """Return the number in an answer; raise DeviceError if it is another text."""
        try:
            return float(answer)
        except ValueError:
            raise DeviceError(
                f"{self._name}: {parameter} was answered '{answer[:40]}'; a number was expected: firmware too old?"
            ) from None

    def write(self, parameter: str, value: float) -> None:
        """Set a parameter and read it back.

        Raises
        ------
        DeviceError : another value reads back.
        NoAnswer : the controller does not answer.
        """
        answer = self._answer_to(f"conf set {parameter} {value:g}")
        read_back = self.read(parameter)
        if not abs(read_back - value) <= READ_BACK_TOLERANCE * abs(value):
            raise DeviceError(
                f"{self._name}: {parameter} is {read_back:g} although {value:g} was written ('{answer[:40]}')"
            )

    def begin_reading(self, parameter: str) -> None:
        """Begin to query a parameter within the control loop; `continue_reading` continues the query."""
        self._parameter, self._poll_again_at = parameter, -math.inf
        self._came[0] = self._is_line_sent = False

    def continue_reading(self) -> float | None:
        """Send the next frame of the query without waiting; return the value once it has arrived.

        The query begins again if a poll is not answered within `answer_timeout_s`. It also does if the answer is still
        incomplete after that time and `MOST_POLLS` polls, since a cycle may take longer than the time-out.

        Raises
        ------
        DeviceError : the bus is closed, full or gone, or the answer is not a number.
        """
        now = self._port.clock.now()
        if self._came[0] and self._is_line_sent:
            self._received_text += self._text
            if b"\n" in self._received_text:
                return self._parse_number(self._parameter, _first_line(self._received_text))
            self._polls += 1
            self._is_line_sent = self._polls < MOST_POLLS or now < self._line_sent_at + self._timeout_s
        elif self._came[0]:
            if not self._text:
                self._send_line(f"conf get {self._parameter}")
                self._is_line_sent, self._line_sent_at, self._polls, self._received_text = True, now, 0, b""
        elif now < self._poll_again_at:
            return None
        else:
            self._is_line_sent = False
        self._poll_again_at = now + self._timeout_s
        self._send_poll()
        return None

    def _answer_to(self, line: str) -> str:
        """Send a line and return the first line of the answer; text left by an earlier host is discarded first."""
        for _ in range(MOST_TRIES):
            deadline = self._port.clock.now() + self._timeout_s
            while self._poll(deadline):
                pass
            self._send_line(line)
            answer = b""
            while self._port.clock.now() < deadline:
                text = self._poll(deadline)
                if text is None:
                    break
                answer += text
                if b"\n" in answer:
                    return _first_line(answer)
                if not text:
                    self._port.clock.sleep_until(min(deadline, self._port.clock.now() + POLL_PAUSE_S))
        raise NoAnswer(f"{self._name}: '{line}' was not answered in {MOST_TRIES} times {self._timeout_s:g} s")

    def _poll(self, deadline: float) -> bytes | None:
        """Return text that waits in the controller; None if the poll is not answered."""
        self._send_poll()
        return self._text if self._port.pump_until(self._came, deadline) else None

    def _send_line(self, line: str) -> None:
        self._port.send_fd(self._plain_identifier, pad(text_to_device(CHANNEL, f"{line}\n".encode("ascii"))))

    def _send_poll(self) -> None:
        self._came[0] = False
        self._port.send_fd(self._reply_identifier, pad(poll_for_text(CHANNEL, MOST_TEXT_BYTES)))


def _first_line(text: bytes) -> str:
    """Return the first line of an answer, without blanks around it."""
    return text.partition(b"\n")[0].strip().decode("ascii", "replace")
