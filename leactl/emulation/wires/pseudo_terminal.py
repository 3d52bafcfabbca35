"""The far side of a serial line that another process opens by its path: a pseudo terminal in raw mode."""

import os
import pty
import tty

MOST_BYTES = 4096  # of one read


class PseudoTerminal:
    """A pseudo terminal; the other process opens `path`, as often as it likes."""

    def __init__(self) -> None:
        self._master, self._slave = pty.openpty()  # holding the slave keeps the line up between two clients
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)

    def fileno(self) -> int:
        """Descriptor that `select` waits for."""
        return self._master

    def read(self) -> bytes:
        """Take the bytes that have arrived; never waits."""
        try:
            return os.read(self._master, MOST_BYTES)
        except (BlockingIOError, OSError):
            return b""

    def write(self, data: bytes) -> None:
        """Send; bytes that a full line does not take are lost."""
        try:
            os.write(self._master, data)
        except BlockingIOError:
            return  # nobody reads

    def close(self) -> None:
        """Close the terminal."""
        os.close(self._master)
        os.close(self._slave)
