"""Output streams that escape control characters, so that text from run files or paths cannot steer a terminal."""

import errno
import io
import os
import re
import sys

# characters that a terminal obeys: C0 without line ends and tabs, DEL, C1, and marks that change the text direction
CONTROL_CHARACTERS = re.compile("\r(?!\n)|[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    """Return a text with each control character replaced by its Python escape."""
    return CONTROL_CHARACTERS.sub(lambda match: repr(match[0])[1:-1], text)


class Printable(io.TextIOWrapper):
    """A standard stream that escapes control characters."""

    used = False  # whether anything was written

    def write(self, text: str) -> int:
        """Write a text with its control characters escaped; bytes that go to `buffer` are not changed."""
        self.used = True
        return super().write(printable(text))


class Messages(Printable):
    """The stream of messages; after its terminal has hung up, messages are dropped without an error."""

    def write(self, text: str) -> int:
        """Write a text, or drop it if the terminal has hung up."""
        try:
            return super().write(text)
        except OSError as fault:
            self._discard(fault)
        return len(text)

    def flush(self) -> None:
        """Flush the buffer, or drop its text if the terminal has hung up."""
        try:
            super().flush()
        except OSError as fault:
            self._discard(fault)

    def _discard(self, fault: OSError) -> None:
        """Redirect the stream to the null device, so that text in its buffer raises no error at exit.

        Raises
        ------
        OSError : `fault`, if it is of another kind.
        """
        if fault.errno != errno.EIO:  # Linux's error for a terminal that has hung up
            raise fault
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())


_replacements: list[Printable] = []  # references: a stream that is collected closes the buffer of the original


def show_control_characters() -> None:
    """Make stdout and stderr escape control characters; the live view writes to `sys.__stderr__` unescaped."""
    for name, stream_class in (("stdout", Printable), ("stderr", Messages)):
        stream = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper) and not isinstance(stream, Printable):
            buffering = stream.line_buffering, stream.write_through
            replacement = stream_class(stream.buffer, stream.encoding, stream.errors, "\n", *buffering)
            _replacements.append(replacement)
            setattr(sys, name, replacement)
