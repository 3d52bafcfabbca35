"""Talk to an instrument one query at a time: a script (generator) yields what to send and receives the parsed replies.

The same script can run to its end, while a bench is opened or made safe, or step by step in the control loop, where
nothing may wait.
"""

from collections.abc import Callable, Generator
from typing import Any, Generic, NamedTuple, TypeVar

from leactl.driver.serial_port import Framing, SerialPort
from leactl.errors import DeviceError, NoAnswer

Result = TypeVar("Result")


class Unreadable(DeviceError):
    """A reply that cannot be parsed: garbled, cut short, or meant for another query."""


class Query(NamedTuple):
    """A query and the parser of its reply; with `patient`, unreadable replies are skipped until a readable one comes.

    A text is sent with the port's line end, bytes as they are. A reply is one line, or all lines up to and including
    `last`; `means` parses them, joined by line feeds. With a `framing` the reply is a frame, and what arrived before
    the query was sent is dropped.
    """

    text: str | bytes
    means: Callable[[bytes], Any]
    patient: bool = False
    last: bytes | None = None
    framing: Framing | None = None

    def __str__(self) -> str:
        return self.text if isinstance(self.text, str) else self.text.hex(" ").upper()


class Reply(NamedTuple):
    """The parsed value of a reply, and when the query was sent and the reply received [s on the port's clock]."""

    value: Any
    asked: float
    seen: float


class Pause:
    """Yielded by a script to continue at the next step."""


Said = str | bytes | Query | Pause
Script = Generator[Said, Reply | None, Result]


class Talk(Generic[Result]):
    """Executes a script over a serial port."""

    def __init__(self, port: SerialPort, script: Script[Result], answer_s: float) -> None:
        self._port, self._script, self._answer_s = port, script, answer_s
        self._question: Query | None = None
        self._asked = 0.0
        self._lines: list[bytes] = []  # of an answer that is not whole yet
        self.ended = False
        self.result: Result | None = None

    def step(self) -> None:
        """Continue the script as far as possible without waiting.

        Raises
        ------
        DeviceError : an error that the script does not handle.
        """
        while not self.ended:
            if self._question is None:
                if isinstance(self._say(self._script.send, None), Pause):
                    return
                continue
            now = self._port.clock.now()
            framing = self._question.framing
            line = self._port.take_line() if framing is None else self._port.take_frame(framing)
            if line is not None:
                self._lines.append(line)
                if self._question.last in (None, line):
                    whole, self._lines = b"\n".join(self._lines), []
                    self._hear(self._question, whole, now)
            elif now >= self._asked + self._answer_s:  # as `finish` waits, to the last bit
                missed, self._question = self._question, None
                self._say(self._script.throw, NoAnswer(f"no answer to {missed} within {self._answer_s:g} s"))
            else:
                return

    def finish(self, deadline: float) -> Result:
        """Run the script to its end, waiting for replies.

        Raises
        ------
        DeviceError : an error that the script does not handle; `NoAnswer` if the deadline passes first.
        """
        clock = self._port.clock
        while True:
            self.step()
            if self.ended:
                assert self.result is not None
                return self.result
            now = clock.now()
            if now >= deadline:
                asked = self._question or "the last command"
                raise NoAnswer(f"no answer to {asked} in time")
            if self._question is not None:
                self._port.wait(min(deadline, self._asked + self._answer_s), self._question.framing)
            else:
                clock.sleep_until(min(deadline, now + 0.01))

    def _hear(self, question: Query, answer: bytes, now: float) -> None:
        try:
            value = question.means(answer)
        except Unreadable as error:
            if not question.patient:
                self._question = None
                self._say(self._script.throw, Unreadable(f"{question} was answered by {error}"))
            return
        self._question = None
        self._say(self._script.send, Reply(value, self._asked, now))

    def _say(self, proceed: Callable[[Any], Said], argument: Reply | DeviceError | None) -> Said | None:
        """Resume the script and send what it yields; returns that, or None at the end of the script."""
        try:
            said = proceed(argument)
        except StopIteration as end:
            self.ended, self.result = True, end.value
            return None
        if isinstance(said, Query):
            if said.framing is not None:
                self._port.discard()
            self._send(said.text)
            self._question, self._asked, self._lines = said, self._port.clock.now(), []
        elif not isinstance(said, Pause):
            self._send(said)
        return said

    def _send(self, text: str | bytes) -> None:
        self._port.write(text if isinstance(text, bytes) else text.encode("ascii") + self._port.line_end)
