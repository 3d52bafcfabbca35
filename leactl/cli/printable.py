"""Output streams that escape control characters, so that text from run files or paths cannot steer a terminal."""

import errno
import io
import os
import re
import sys

# line ends and tabs pass; of the rest C0, DEL, C1, and the marks that turn the direction of what follows
OBEYED = re.compile("\r(?!\n)|[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    """Replace each control character of a text by its Python escape."""
    return OBEYED.sub(lambda match: repr(match[0])[1:-1], text)


class Printable(io.TextIOWrapper):
    """A standard stream that escapes control characters."""

    used = False  # whether anything was written

    def write(self, text: str) -> int:
        """Write text for people and scripts; bytes go to `buffer` as they are."""
        self.used = True
        return super().write(printable(text))


class Messages(Printable):
    """The stream of messages; once its terminal has hung up, they are lost and the exit status alone tells the end."""

    def write(self, text: str) -> int:
        """Write text, or lose it where the terminal has hung up."""
        try:
            return super().write(text)
        except OSError as fault:
            self._discard(fault)
        return len(text)

    def flush(self) -> None:
        """Write what is buffered, or lose it where the terminal has hung up."""
        try:
            super().flush()
        except OSError as fault:
            self._discard(fault)

    def _discard(self, fault: OSError) -> None:
        """Redirect the stream to the null device, so that what is still buffered raises no error at exit."""
        if fault.errno != errno.EIO:  # Linux's error for a terminal that has hung up
            raise fault
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())


_open: list[Printable] = []  # one that is let go of closes the stream beneath it


def show_control_characters() -> None:
    """Make stdout and stderr escape control characters; the live view writes to `sys.__stderr__` unescaped."""
    for name, kind in (("stdout", Printable), ("stderr", Messages)):
        stream = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper) and not isinstance(stream, Printable):
            lines = stream.line_buffering
            fresh = kind(stream.buffer, stream.encoding, stream.errors, "\n", lines, stream.write_through)
            _open.append(fresh)
            setattr(sys, name, fresh)
