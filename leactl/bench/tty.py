"""A serial device of this machine: pyserial opens and configures it; bytes are read and written by system calls.

pyserial 3.5 never returns from a write that the kernel does not accept (pyserial issue 280), and Linux delays the close
of a line with unsent bytes by 30 s.

The lock that pyserial takes is one of the file in /dev, and a container has another file for the same device. The
kernel's own mark of exclusive use is one of the device; for it, a process with CAP_SYS_ADMIN has to ask.
"""

import errno
import fcntl
import os
import select
import struct
import termios
from contextlib import suppress

from leactl.bench.benchfile import SerialBus

MOST_BYTES = 4096
MEANING = {
    errno.ENOENT: "no such device; is it plugged in and switched on?",
    errno.EACCES: "no permission; add the user to group dialout",
    errno.EAGAIN: "another program holds it",
    errno.EBUSY: "another program holds it",
}
TIOCGEXCL = 0x80045440  # whether a device is marked (asm-generic/ioctls.h); termios has no name for it
# majors of pseudo terminals, on which the mark outlives a killed holder, as long as the other end is open
PSEUDO_TERMINALS = range(136, 144)


class Tty:
    """An open serial device whose methods never wait longer than their timeout."""

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
            self._mark()
        except (OSError, ValueError, termios.error) as error:
            number = getattr(error, "errno", None)
            raise OSError(f"{bus.port}: {MEANING.get(number or 0, error)}") from None
        self._descriptor = self._serial.fileno()

    def _mark(self) -> None:
        """Mark the device as in exclusive use; its last close, by a death too, ends that."""
        descriptor = self._serial.fileno()
        if os.major(os.fstat(descriptor).st_rdev) in PSEUDO_TERMINALS:
            return
        if struct.unpack("i", fcntl.ioctl(descriptor, TIOCGEXCL, bytes(4)))[0]:
            self._serial.close()
            raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))
        fcntl.ioctl(descriptor, termios.TIOCEXCL)

    def read(self, timeout: float) -> bytes:
        """Bytes that have arrived; waits at most `timeout` seconds for the first.

        Raises
        ------
        OSError : the device is gone.
        """
        ready, _, _ = select.select([self._descriptor], [], [], timeout)
        if not ready:
            return b""
        try:
            read = os.read(self._descriptor, MOST_BYTES)
        except BlockingIOError:
            return b""
        if not read:  # a device that was pulled out is always ready and has nothing
            raise OSError("nothing is at the other end")
        return read

    def write(self, data: bytes) -> int:
        """Write as many bytes as the kernel accepts at once; returns their number.

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
        with suppress(OSError):
            fcntl.ioctl(self._descriptor, termios.TIOCNXCL)  # a console or the like may have it open still
        self._serial.close()
