"""The person beside the bench: keys that stop or pause the run, and answers to prompts.

The loop itself reads the keyboard, once a cycle: a thread that read it would run beside the supervised path, and two
readers of one terminal would take each other's answers.
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
    """The terminal at which the operator types, with each key read at once; without a terminal no key is pressed."""

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
        """Return the cause of a stop if a stop key was pressed, else an empty string.

        No key is read while a question waits for its answer.
        """
        terminal = self._terminal
        if terminal is None or self._asking or not self._poll.poll(0) or not _is_in_foreground(terminal):
            return ""
        typed = _typed_bytes(terminal)
        if not typed:  # it has hung up, and would be ready for ever
            self._poll.unregister(terminal)
            self._terminal = None
        self._pause_pressed ^= typed.count(PAUSE_KEY) % 2 == 1
        return next((f"stopped by the operator: key {STOP_KEYS[key]}" for key in typed if key in STOP_KEYS), "")

    def pause_pressed(self) -> bool:
        """Return whether the key that begins or ends a pause was pressed an odd number of times since the last call."""
        pressed, self._pause_pressed = self._pause_pressed, False
        return pressed

    def ask(self, text: str) -> Callable[[], bool]:
        """Ask as `at_the_terminal` does; a stop key that was pressed just before the question still stops the run.

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
    """Read single keys without echo until the block is left, and then restore the terminal.

    Keys are read only if stdin is a terminal in whose foreground this process is. Ctrl-C, Ctrl-Z and Ctrl-S keep their
    meaning.

    shown : whether the operator sees which keys stop the run; if not, no keys are read.
    """
    try:
        import termios
        import tty
    except ImportError:  # Windows has no such terminals
        yield Keyboard()
        return
    try:
        terminal = sys.stdin.fileno()
        saved_settings: list[Any] = termios.tcgetattr(terminal)
    except (OSError, ValueError, AttributeError, termios.error):  # no stdin, a closed one, or no terminal
        shown = False
    if not shown or not _is_in_foreground(terminal):
        yield Keyboard()
        return
    try:
        # at once: TCSAFLUSH, the default, would wait for a terminal that Ctrl-S has stopped to take its output
        tty.setcbreak(terminal, termios.TCSANOW)
        termios.tcflush(terminal, termios.TCIFLUSH)  # what was typed before the run is not about it
        yield Keyboard(terminal)
    finally:
        if _is_in_foreground(terminal):  # else the shell has it back already, and setting it would stop this process
            with suppress(termios.error):
                termios.tcflush(terminal, termios.TCIFLUSH)  # a stop key that was pressed twice is none of the shell's
                termios.tcsetattr(terminal, termios.TCSANOW, saved_settings)


def at_the_terminal(text: str) -> Callable[[], bool]:
    """Ask on stderr; return a function that tells whether an empty line or `y` on stdin has confirmed.

    The function raises Stopped for any other answer. What was typed before the question is no answer. If the terminal
    passes each key on at once, a line arrives in parts.
    """
    import termios  # a bench with people beside it is on Linux

    # from a thread: a stopped terminal takes no text, and must not hold the loop
    question = f"{text}  {HOW_TO_ANSWER}\n".encode()
    threading.Thread(target=_write_question, args=(sys.stderr.fileno(), question), daemon=True).start()
    terminal = sys.stdin.fileno()
    if _is_in_foreground(terminal):
        with suppress(termios.error):  # no terminal: nothing was typed ahead
            termios.tcflush(terminal, termios.TCIFLUSH)
    line = b""

    def confirmed() -> bool:
        nonlocal line
        readable, _, _ = select.select([terminal], [], [], 0.0)
        if not readable or not _is_in_foreground(terminal):
            return False
        typed = _typed_bytes(terminal)
        line += typed
        if typed and line.rstrip(b"\r\n").lower() in (b"", b"y"):
            return line.endswith((b"\n", b"\r"))
        answer = ascii(line.decode(errors="replace").rstrip("\r\n")) if typed else "the end of input"
        raise Stopped(f"stopped by the operator: {answer} in answer to: {text}")

    return confirmed


def confirm_at_once(_text: str) -> Callable[[], bool]:
    """Return a function that confirms at once, for an emulated bench, which nobody has to touch."""
    return lambda: True


def _write_question(descriptor: int, question: bytes) -> None:
    """Write a question, which blocks while the terminal is stopped; ignore a failure."""
    with suppress(OSError):  # a terminal that has hung up; the live view and the file hold the question too
        os.write(descriptor, question)


def _typed_bytes(terminal: int) -> bytes:
    """Return the typed bytes; no bytes mean the end of input or a terminal that has hung up."""
    try:
        return os.read(terminal, 4096)
    except OSError:
        return b""


def _is_in_foreground(terminal: int) -> bool:
    """Return whether the process may use the terminal: in the background, a read or a flush would stop it."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:  # not the controlling terminal, which stops nobody
        return True
