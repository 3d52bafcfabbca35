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

    A text is sent with the port's line end, bytes are sent as they are. A reply is one line, or all lines up to and
    including `last`; `means` parses them, joined by line feeds. With a `framing` the reply is a frame; with `silence_s`
    it is all that arrives until nothing has come for that time. Bytes that arrived before a query with a `framing` or
    `silence_s` was sent are dropped.
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
    """Return a script that sends a query and returns the parsed value of its reply."""
    reply = yield query
    assert reply is not None
    return reply.value


class Talk(Generic[Result]):
    """Executes a script over a serial port."""

    def __init__(self, port: SerialPort, script: Script[Result], answer_s: float) -> None:
        self._port, self._script, self._answer_s = port, script, answer_s
        self._unsent: Query | str | bytes | None = None  # to be sent once the device has rested
        self._pending_query: Query | None = None
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
            if self._pending_query is None:
                if isinstance(self._resume(self._script.send, None), Pause):
                    return
                continue
            now = self._port.clock.now()
            line = self._take(self._pending_query)
            if line is not None:
                self._lines.append(line)
                if self._pending_query.last in (None, line):
                    reply, self._lines = b"\n".join(self._lines), []
                    self._parse_reply(
                        self._pending_query,
                        reply,
                        now if self._pending_query.silence_s is None else self._port.heard_at,
                    )
            elif now >= self._asked + self._answer_s:  # as `finish` waits, to the last bit
                unanswered, self._pending_query = self._pending_query, None
                self._resume(self._script.throw, NoAnswer(f"no answer to {unanswered} within {self._answer_s:g} s"))
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
                awaited = self._pending_query or "the last command"
                raise NoAnswer(f"no answer to {awaited} in time")
            if self._unsent is not None:
                clock.sleep_until(min(deadline, self._port.rested_at))
            elif self._pending_query is not None and self._pending_query.silence_s is None:
                self._port.wait(min(deadline, self._asked + self._answer_s), self._pending_query.framing)
            else:
                clock.sleep_until(min(deadline, now + POLL_S))

    def _take(self, query: Query) -> bytes | None:
        """Return the next line, frame or silence-ended bytes of a reply; None if it has not arrived yet."""
        if query.silence_s is not None:
            return self._port.take_until_silent(query.silence_s)
        return self._port.take_line() if query.framing is None else self._port.take_frame(query.framing)

    def _parse_reply(self, query: Query, reply: bytes, now: float) -> None:
        """Pass the parsed reply, or the error that it cannot be read, to the script; a patient query waits on."""
        try:
            value = query.means(reply)
        except Unreadable as error:
            if not query.patient:
                self._pending_query = None
                self._resume(self._script.throw, Unreadable(f"{query} was answered by {error}"))
            return
        self._pending_query = None
        self._resume(self._script.send, Reply(value, self._asked, now))

    def _resume(self, proceed: Callable[[Any], Yielded], argument: Reply | DeviceError | None) -> Yielded | None:
        """Resume the script by its method `proceed`; return what it yields to send next, or None at its end."""
        try:
            yielded = proceed(argument)
        except StopIteration as end:
            self.ended, self.result = True, end.value
            return None
        if not isinstance(yielded, Pause):
            self._unsent = yielded
        return yielded

    def _send(self, to_send: Query | str | bytes) -> None:
        """Send a text or a query, and wait for its reply if it is a query.

        Raises
        ------
        DeviceError : the line is closed or gone.
        """
        self._unsent = None
        content = to_send.text if isinstance(to_send, Query) else to_send
        if isinstance(to_send, Query) and (to_send.framing is not None or to_send.silence_s is not None):
            self._port.discard()
        self._port.write(content if isinstance(content, bytes) else content.encode("ascii") + self._port.line_end)
        if isinstance(to_send, Query):
            self._pending_query, self._asked, self._lines = to_send, self._port.clock.now(), []
