"""Talk to an instrument one query at a time: a script (generator) yields what to send and receives the parsed replies.

The same script can run to its end, while a bench is opened or made safe, or step by step in the control loop, where
nothing may wait.
"""

from collections.abc import Callable, Generator
from typing import Any, Generic, NamedTuple, TypeVar

from leactl.driver.serial_port import Framing, SerialPort
from leactl.errors import DeviceError, NoAnswer

Result = TypeVar("Result")

POLL_S = 0.01  # time between two steps of a script that waits for no byte


class Unreadable(DeviceError):
    """A reply that cannot be parsed: garbled, cut short, or meant for another query."""


class Query(NamedTuple):
    """A query and the parser of its reply; with `patient`, unreadable replies are skipped until a readable one comes.

    A text is sent with the port's line end, bytes as they are. A reply is one line, or all lines up to and including
    `last`; `means` parses them, joined by line feeds. With a `framing` the reply is a frame; with `silence_s` it is all
    that arrives until nothing has come for so long. What arrived before either of these was sent is dropped.
    """

    text: str | bytes
    means: Callable[[bytes], Any]
    patient: bool = False
    last: bytes | None = None
    framing: Framing | None = None
    silence_s: float | None = None

    def __str__(self) -> str:
        return self.text if isinstance(self.text, str) else self.text.hex(" ").upper()


class Reply(NamedTuple):
    """The parsed value of a reply, and when the query was sent and the reply received [s on the port's clock]."""

    value: Any
    asked: float
    seen: float


class Pause:
    """Yielded by a script to continue at the next step."""


Yielded = str | bytes | Query | Pause  # by a script: a command or a query to send, or the end of a step
Script = Generator[Yielded, Reply | None, Result]


def ask(query: Query) -> Script[Any]:
    """Script that sends a query and returns the parsed value of its reply."""
    reply = yield query
    assert reply is not None
    return reply.value


class Talk(Generic[Result]):
    """Executes a script over a serial port."""

    def __init__(self, port: SerialPort, script: Script[Result], answer_s: float) -> None:
        self._port, self._script, self._answer_s = port, script, answer_s
        self._unsent: Query | str | bytes | None = None  # to be sent once the device has rested
        self._question: Query | None = None
        self._asked = 0.0
        self._lines: list[bytes] = []  # lines of an answer that is not complete yet
        self.ended = False
        self.result: Result | None = None

    def step(self) -> None:
        """Continue the script as far as possible without waiting.

        Raises
        ------
        DeviceError : an error that the script does not handle.
        """
        while not self.ended:
            if self._unsent is not None:
                if self._port.clock.now() < self._port.rested_at:
                    return
                self._send(self._unsent)
                continue
            if self._question is None:
                if isinstance(self._say(self._script.send, None), Pause):
                    return
                continue
            now = self._port.clock.now()
            line = self._take(self._question)
            if line is not None:
                self._lines.append(line)
                if self._question.last in (None, line):
                    whole, self._lines = b"\n".join(self._lines), []
                    self._hear(self._question, whole, now if self._question.silence_s is None else self._port.heard_at)
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
            if self._unsent is not None:
                clock.sleep_until(min(deadline, self._port.rested_at))
            elif self._question is not None and self._question.silence_s is None:
                self._port.wait(min(deadline, self._asked + self._answer_s), self._question.framing)
            else:
                clock.sleep_until(min(deadline, now + POLL_S))

    def _take(self, question: Query) -> bytes | None:
        if question.silence_s is not None:
            return self._port.take_until_silent(question.silence_s)
        return self._port.take_line() if question.framing is None else self._port.take_frame(question.framing)

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

    def _say(self, proceed: Callable[[Any], Yielded], argument: Reply | DeviceError | None) -> Yielded | None:
        """Resume the script, which says what to send next; returns that, or None at the end of the script."""
        try:
            said = proceed(argument)
        except StopIteration as end:
            self.ended, self.result = True, end.value
            return None
        if not isinstance(said, Pause):
            self._unsent = said
        return said

    def _send(self, said: Query | str | bytes) -> None:
        self._unsent = None
        text = said.text if isinstance(said, Query) else said
        if isinstance(said, Query) and (said.framing is not None or said.silence_s is not None):
            self._port.discard()
        self._port.write(text if isinstance(text, bytes) else text.encode("ascii") + self._port.line_end)
        if isinstance(said, Query):
            self._question, self._asked, self._lines = said, self._port.clock.now(), []
