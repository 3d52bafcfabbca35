"""Who confirms a prompt: a person at the terminal, or nobody where the bench is emulated."""

import os
import select
import sys
import termios
import threading
from collections.abc import Callable
from contextlib import suppress

from leactl.errors import Stopped

HOW = "[Enter goes on, anything else stops the run]"


def at_the_terminal(text: str) -> Callable[[], bool]:
    """Ask on stderr; an empty line or `y` on stdin confirms, anything else stops; the loop goes on meanwhile.

    What was typed before the question answers nothing.
    """
    # from a thread: a stopped terminal takes no text, and must not hold the loop
    question = f"{text}  {HOW}\n".encode()
    threading.Thread(target=_tell, args=(sys.stderr.fileno(), question), daemon=True).start()
    terminal = sys.stdin.fileno()
    if _in_front(terminal):
        with suppress(termios.error):  # no terminal: nothing was typed ahead
            termios.tcflush(terminal, termios.TCIFLUSH)

    def confirmed() -> bool:
        ready, _, _ = select.select([terminal], [], [], 0.0)
        if not ready or not _in_front(terminal):
            return False
        try:
            line = os.read(terminal, 4096)
        except OSError:  # the terminal has hung up
            line = b""
        if line.endswith(b"\n") and line.strip().lower() in (b"", b"y"):
            return True
        answer = ascii(line.decode(errors="replace").strip()) if line else "the end of input"
        raise Stopped(f"stopped by the operator: {answer} in answer to: {text}")

    return confirmed


def granted(_text: str) -> Callable[[], bool]:
    """Confirm at once: nobody has to touch an emulated bench."""
    return lambda: True


def _tell(place: int, question: bytes) -> None:
    with suppress(OSError):  # a terminal that has hung up; the live view and the file hold the question too
        os.write(place, question)


def _in_front(terminal: int) -> bool:
    """Whether the terminal is ours to use: in the background a read or a flush would stop the process, loop and all."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:  # not the controlling terminal, which stops nobody
        return True
