"""The person beside the bench: a key that stops the run, and who confirms a prompt, nobody where it is emulated.

The loop itself looks at the keyboard, once a cycle: a thread that reads it would run beside the supervised path, and
two readers of one terminal would take each other's answers.
"""

import os
import select
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from leactl.errors import Stopped

HOW_TO_ANSWER = "[Enter goes on, anything else stops the run]"
STOP_KEYS = {ord(" "): "space", ord("q"): "q"}
PAUSE_KEY = ord("p")
STOP_HINT = "space or q stops the run, p pauses it"


class Keyboard:
    """The terminal that the operator types at, each key at once; without one nobody types."""

    def __init__(self, terminal: int | None = None) -> None:
        self._terminal = terminal
        self._asking = self._pause_pressed = False
        if terminal is not None:
            self._poll = select.poll()
            self._poll.register(terminal, select.POLLIN)

    @property
    def hint(self) -> str:
        """Text on the keys for the operator; empty without a terminal."""
        return "" if self._terminal is None else STOP_HINT

    def pressed(self) -> str:
        """Return the cause of a stop if a stop key was pressed, else an empty string, as while a question is open."""
        terminal = self._terminal
        if terminal is None or self._asking or not self._poll.poll(0) or not _in_front(terminal):
            return ""
        typed = _read(terminal)
        if not typed:  # it has hung up, and would be ready for ever
            self._poll.unregister(terminal)
            self._terminal = None
        self._pause_pressed ^= typed.count(PAUSE_KEY) % 2 == 1
        return next((f"stopped by the operator: key {STOP_KEYS[key]}" for key in typed if key in STOP_KEYS), "")

    def pause_pressed(self) -> bool:
        """Return whether the key for a pause, which begins and ends one, was pressed since the last call."""
        pressed, self._pause_pressed = self._pause_pressed, False
        return pressed

    def ask(self, text: str) -> Callable[[], bool]:
        """Ask as `at_the_terminal` does; a stop key that was pressed just before the question still stops.

        Raises
        ------
        Stopped : a stop key was pressed.
        """
        cause = self.pressed()
        if cause:
            raise Stopped(cause)
        self._asking = True
        confirmed = at_the_terminal(text)

        def answered() -> bool:
            self._asking = not confirmed()
            return not self._asking

        return answered


@contextmanager
def keyboard(shown: bool) -> Iterator[Keyboard]:
    """Take single keys, unechoed, until the block is left, and give the terminal back as it was found.

    Only where stdin is a terminal that is ours to use, and the operator is `shown` which key it is; Ctrl-C, Ctrl-Z and
    Ctrl-S keep their meaning.
    """
    try:
        import termios
        import tty
    except ImportError:  # Windows has no such terminals
        yield Keyboard()
        return
    try:
        terminal = sys.stdin.fileno()
        before: list[Any] = termios.tcgetattr(terminal)
    except (OSError, ValueError, AttributeError, termios.error):  # no stdin, a closed one, or no terminal
        shown = False
    if not shown or not _in_front(terminal):
        yield Keyboard()
        return
    try:
        # at once: TCSAFLUSH, the default, would wait for a terminal that Ctrl-S has stopped to take its output
        tty.setcbreak(terminal, termios.TCSANOW)
        termios.tcflush(terminal, termios.TCIFLUSH)  # what was typed before the run is not about it
        yield Keyboard(terminal)
    finally:
        if _in_front(terminal):  # else the shell has it back already, and setting it would stop this process
            with suppress(termios.error):
                termios.tcflush(terminal, termios.TCIFLUSH)  # a stop key that was pressed twice is none of the shell's
                termios.tcsetattr(terminal, termios.TCSANOW, before)


def at_the_terminal(text: str) -> Callable[[], bool]:
    """Ask on stderr; an empty line or `y` on stdin confirms, anything else stops; the loop goes on meanwhile.

    What was typed before the question answers nothing. A terminal that gives each key at once gives a line in parts.
    """
    import termios  # a bench with people beside it is on Linux

    # from a thread: a stopped terminal takes no text, and must not hold the loop
    question = f"{text}  {HOW_TO_ANSWER}\n".encode()
    threading.Thread(target=_tell, args=(sys.stderr.fileno(), question), daemon=True).start()
    terminal = sys.stdin.fileno()
    if _in_front(terminal):
        with suppress(termios.error):  # no terminal: nothing was typed ahead
            termios.tcflush(terminal, termios.TCIFLUSH)
    line = b""

    def confirmed() -> bool:
        nonlocal line
        ready, _, _ = select.select([terminal], [], [], 0.0)
        if not ready or not _in_front(terminal):
            return False
        typed = _read(terminal)
        line += typed
        if typed and line.rstrip(b"\r\n").lower() in (b"", b"y"):
            return line.endswith((b"\n", b"\r"))
        answer = ascii(line.decode(errors="replace").rstrip("\r\n")) if typed else "the end of input"
        raise Stopped(f"stopped by the operator: {answer} in answer to: {text}")

    return confirmed


def confirm_at_once(_text: str) -> Callable[[], bool]:
    """Confirm at once: nobody has to touch an emulated bench."""
    return lambda: True


def _tell(descriptor: int, question: bytes) -> None:
    with suppress(OSError):  # a terminal that has hung up; the live view and the file hold the question too
        os.write(descriptor, question)


def _read(terminal: int) -> bytes:
    """Return the typed bytes; none at the end of input and if the terminal has hung up."""
    try:
        return os.read(terminal, 4096)
    except OSError:
        return b""


def _in_front(terminal: int) -> bool:
    """Return whether the process may use the terminal: in the background, a read or a flush would stop it."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:  # not the controlling terminal, which stops nobody
        return True
