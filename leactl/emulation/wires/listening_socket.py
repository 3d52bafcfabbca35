"""The far side of an instrument's raw socket: a TCP server on this machine."""

import select
import socket
from contextlib import suppress

MOST_BYTES = 4096  # of one read
MOST_WAITING = 8  # connections that are not accepted yet


class ListeningSocket:
    """A TCP server on a free port of the loopback interface; it serves the client that has connected last."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=MOST_WAITING)
        self._listener.setblocking(False)
        self._client: socket.socket | None = None
        self._events = select.epoll()  # one descriptor to wait for, whichever of the two sockets is ready
        self._events.register(self._listener, select.EPOLLIN)
        self.resource = "TCPIP::{}::{}::SOCKET".format(*self._listener.getsockname())

    def fileno(self) -> int:
        """Descriptor that `select` waits for."""
        return self._events.fileno()

    def accept(self) -> bool:
        """Accept waiting clients, the last of which replaces the present one; returns whether there was one."""
        accepted = False
        with suppress(BlockingIOError):
            while True:
                client, _ = self._listener.accept()
                self._drop()
                client.setblocking(False)
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._events.register(client, select.EPOLLIN)
                self._client, accepted = client, True
        return accepted

    def read(self) -> bytes:
        """Take the bytes that the client has sent; never waits."""
        if self._client is None:
            return b""
        try:
            read = self._client.recv(MOST_BYTES)
        except BlockingIOError:
            return b""
        except OSError:  # the client has dropped the connection
            read = b""
        if not read:
            self._drop()
        return read

    def write(self, data: bytes) -> None:
        """Send; bytes that do not fit into the client's buffer are lost."""
        if self._client is not None:
            with suppress(OSError):
                self._client.send(data)

    def close(self) -> None:
        """Close the server and the connection of its client."""
        self._drop()
        self._listener.close()
        self._events.close()

    def _drop(self) -> None:
        if self._client is not None:
            self._events.unregister(self._client)
            self._client.close()
            self._client = None
