"""Use a serial device of this machine: pyserial opens and configures it, system calls read and write the bytes.

pyserial 3.5 never returns from a write that the kernel does not accept (pyserial issue 280), and Linux delays the close
of a line with unsent bytes by 30 s.
"""

import errno
import os
import select
import termios
from contextlib import suppress

from leactl.bench.benchfile import SerialBus

MOST_BYTES = 4096  # of one read
ADVICE = {  # by errno
    errno.ENOENT: "no such device; is it plugged in and switched on?",
    errno.EACCES: "no permission; add the user to group dialout",
    errno.EAGAIN: "another program holds it",
}


class Tty:
    """An open serial device; `read` waits at most its timeout, `write` and `close` do not wait.

    Raises
    ------
    OSError : the device cannot be opened; the message has the reason, and where it can, what to do.
    """

    def __init__(self, bus: SerialBus) -> None:
        import serial

        try:
            self._serial = serial.Serial(
                bus.port,
                baudrate=bus.baudrate,
                bytesize=bus.data_bits,
                parity=bus.parity[0].upper(),
                stopbits=bus.stop_bits,
                rtscts=bus.flow_control == "rtscts",
                xonxoff=bus.flow_control == "xonxoff",
                timeout=0,
                exclusive=True,
            )
        except (OSError, ValueError, termios.error) as error:
            error_number = getattr(error, "errno", None)
            raise OSError(f"{bus.port}: {ADVICE.get(error_number or 0, error)}") from None
        self._port = bus.port
        self._descriptor = self._serial.fileno()

    def read(self, timeout: float) -> bytes:
        """Return the bytes that have arrived, after a wait of at most `timeout` [s] for the first of them.

        Raises
        ------
        OSError : the device is gone.
        """
        ready, _, _ = select.select([self._descriptor], [], [], timeout)
        if not ready:
            return b""
        try:
            received = os.read(self._descriptor, MOST_BYTES)
        except BlockingIOError:
            return b""
        if not received:  # a device that was unplugged is always ready and has no bytes
            raise OSError(f"nothing is at the other end of {self._port}; check its cable and plug it in again")
        return received

    def write(self, data: bytes) -> int:
        """Write as many bytes as the kernel accepts at once; return their number.

        Raises
        ------
        OSError : the device is gone.
        """
        try:
            return os.write(self._descriptor, data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Close the device and drop bytes that are not sent yet."""
        with suppress(OSError, termios.error):
            self._serial.reset_output_buffer()
        self._serial.close()
