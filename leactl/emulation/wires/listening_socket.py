"""The far side of an instrument's raw socket: a TCP server on this machine."""

import select
import socket
from contextlib import suppress

MOST_BYTES_PER_READ = 4096
MOST_WAITING_CLIENTS = 8  # connections that are not yet accepted


class ListeningSocket:
    """A TCP server on a free port of the loopback interface; it serves the client that has connected last."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=MOST_WAITING_CLIENTS)
        self._listener.setblocking(False)
        self._client: socket.socket | None = None
        self._events = select.epoll()  # one descriptor to wait for, whichever of the two sockets is ready
        self._events.register(self._listener, select.EPOLLIN)
        self.resource = "TCPIP::{}::{}::SOCKET".format(*self._listener.getsockname())

    def fileno(self) -> int:
        """Return the descriptor that `select` waits for."""
        return self._events.fileno()

    def accept(self) -> bool:
        """Accept waiting clients, the last of which replaces the present one; return whether there were any."""
        has_accepted = False
        with suppress(BlockingIOError):
            while True:
                client, _ = self._listener.accept()
                self._drop()
                client.setblocking(False)
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._events.register(client, select.EPOLLIN)
                self._client, has_accepted = client, True
        return has_accepted

    def read(self) -> bytes:
        """Return the bytes that the client has sent, without waiting."""
        if self._client is None:
            return b""
        try:
            data = self._client.recv(MOST_BYTES_PER_READ)
        except BlockingIOError:
            return b""
        except OSError:  # the client has dropped the connection
            data = b""
        if not data:
            self._drop()
        return data

    def write(self, data: bytes) -> None:
        """Send bytes; those that do not fit into the client's buffer are lost."""
        if self._client is not None:
            with suppress(OSError):
                self._client.send(data)

    def close(self) -> None:
        """Close the server and the connection of its client."""
        self._drop()
        self._listener.close()
        self._events.close()

    def _drop(self) -> None:
        """Close the connection of the present client, if there is one."""
        if self._client is not None:
            self._events.unregister(self._client)
            self._client.close()
            self._client = None
