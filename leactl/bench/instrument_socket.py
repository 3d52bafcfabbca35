"""Use the raw socket of an instrument on the network (SCPI-RAW, mostly port 5025 or 5555) like a serial line.

The socket module is used and not pyvisa-py, whose sockets break all four promises of a `SerialLine`: no wait without a
timeout, no lost byte, an error once the connection is gone, and no delivery after `close`
(docs/decisions/0020-raw-sockets-without-a-visa-library.md).
"""

import errno
import select
import socket
import struct

CONNECT_S = 0.3  # a third of the time for a safe state; on a local network a connection takes some ms
# Bytes that are not acknowledged within this time are dropped: a command to switch on must not reach the supply when
# the cable is plugged in again minutes later.
UNACKNOWLEDGED_MS = 1000  # the kernel checks it when it would next repeat the bytes: after 1.4 s
MOST_BYTES = 4096  # of one read
ADVICE = {  # by errno
    errno.ECONNREFUSED: "the connection is refused; is the port right, and does another program hold it?",
    errno.EHOSTUNREACH: "it cannot be reached; is it switched on, and on this network?",
    errno.ENETUNREACH: "there is no network to it from here",
}


class InstrumentSocket:
    """An open connection; `read` waits at most its timeout, `write` and `close` do not wait.

    Raises
    ------
    OSError : there is no connection within `CONNECT_S`; the message has the reason, and where it can, what to do.
    """

    def __init__(self, host: str, port: int) -> None:
        self._address = f"{host} port {port}"
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        options = (
            # send each command at once, without a wait for the acknowledgement of the command before
            (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),
            (socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNACKNOWLEDGED_MS),
            # drop bytes that are not sent yet when the connection ends, even by the death of this process
            (socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0)),
        )
        try:
            for option in options:
                self._socket.setsockopt(*option)
            self._socket.settimeout(CONNECT_S)
            self._socket.connect((host, port))
            self._socket.setblocking(False)
        except OSError as error:
            self._socket.close()
            no_answer = f"no answer within {CONNECT_S:g} s; is it switched on, and on this network?"
            advice = no_answer if isinstance(error, TimeoutError) else ADVICE.get(error.errno or 0, error)
            raise OSError(f"{self._address}: {advice}") from None

    def read(self, timeout: float) -> bytes:
        """Return the bytes that have arrived, after a wait of at most `timeout` [s] for the first of them.

        Raises
        ------
        OSError : the connection has ended, from either side.
        """
        ready, _, _ = select.select([self._socket], [], [], timeout)
        if not ready:
            return b""
        try:
            received = self._socket.recv(MOST_BYTES)
        except BlockingIOError:
            return b""
        if not received:
            raise OSError(f"{self._address} has closed the connection; end any other program that uses it")
        return received

    def write(self, data: bytes) -> int:
        """Write as many bytes as the kernel accepts at once; return their number.

        Raises
        ------
        OSError : the connection has ended, from either side.
        """
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """End the connection and drop bytes that are not sent yet."""
        self._socket.close()
