"""The far side of a serial line that another process opens by its path: a pseudo terminal in raw mode."""

import os
import pty
import tty

MOST_BYTES_PER_READ = 4096


class PseudoTerminal:
    """A pseudo terminal, whose `path` the other process may open and close any number of times."""

    def __init__(self) -> None:
        self._master, self._slave = pty.openpty()  # holding the slave keeps the line up between two clients
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)

    def fileno(self) -> int:
        """Return the descriptor that `select` waits for."""
        return self._master

    def read(self) -> bytes:
        """Return the bytes that have arrived, without waiting."""
        try:
            return os.read(self._master, MOST_BYTES_PER_READ)
        except (BlockingIOError, OSError):
            return b""

    def write(self, data: bytes) -> None:
        """Send bytes; those that do not fit into the line's buffer are lost."""
        try:
            os.write(self._master, data)
        except BlockingIOError:
            return  # nobody reads, and the buffer is full

    def close(self) -> None:
        """Close the terminal."""
        os.close(self._master)
        os.close(self._slave)
