"""One I2C bus shared by several drivers: smbus2's own calls, with its errors told apart and named.

Registers go by SMBus word transfers. On the wire they are the two bytes of a block transfer; behind i2c-stub a block of
two would reach into the next register as well.
"""

import errno
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from leactl.errors import DeviceError, NoAnswer

_NAK = {errno.EREMOTEIO, errno.ENXIO, errno.ENODEV}
_MEANING = {
    errno.EBUSY: "a kernel driver holds this address; unbind it",
    errno.EACCES: "no permission; add the user to group i2c",
    errno.ENOENT: "no such bus; load i2c-dev and enable the adapter",
}


class SmBus(Protocol):
    """The part of smbus2.SMBus that is used."""

    def read_word_data(self, i2c_addr: int, register: int) -> int: ...  # noqa: D102
    def write_word_data(self, i2c_addr: int, register: int, value: int) -> None: ...  # noqa: D102
    def close(self) -> None: ...  # noqa: D102


def swapped(word: int) -> int:
    """A register's value from an SMBus word, or back: SMBus sends the low byte first, these devices the high one."""
    return (word & 0xFF) << 8 | word >> 8


class I2cPort:
    """Registers of devices on one bus, most significant byte first."""

    def __init__(self, connect: Callable[[], SmBus], name: str = "i2c") -> None:
        self._connect = connect
        self.name = name
        self._bus: SmBus | None = None
        self._users = 0

    def open(self) -> None:
        """Connect, once for all users of the port.

        Raises
        ------
        DeviceError : the bus is absent or refuses.
        """
        if self._bus is None:
            try:
                self._bus = self._connect()
            except OSError as error:
                raise DeviceError(f"bus '{self.name}': {_MEANING.get(error.errno or 0, error)}") from None
        self._users += 1

    def close(self) -> None:
        """Disconnect when the last user has let go."""
        self._users = max(0, self._users - 1)
        bus = self._bus
        if self._users == 0 and bus is not None:
            self._bus = None
            with suppress(OSError):  # it is gone already, which is what was asked for
                bus.close()

    def read(self, address: int, register: int) -> int:
        """Read a 16-bit register.

        Raises
        ------
        NoAnswer : nothing acknowledged, or the transfer timed out.
        DeviceError : the bus is closed or failed.
        """
        if self._bus is None:
            raise DeviceError(f"bus '{self.name}': not open")
        try:
            return swapped(self._bus.read_word_data(address, register))
        except OSError as error:
            raise self._explain(error, address) from None

    def write(self, address: int, register: int, value: int) -> None:
        """Write a 16-bit register.

        Raises
        ------
        NoAnswer : nothing acknowledged, or the transfer timed out.
        DeviceError : the bus is closed or failed.
        """
        if self._bus is None:
            raise DeviceError(f"bus '{self.name}': not open")
        try:
            self._bus.write_word_data(address, register, swapped(value))
        except OSError as error:
            raise self._explain(error, address) from None

    def _explain(self, error: OSError, address: int) -> DeviceError:
        place = f"bus '{self.name}', address 0x{address:02X}"
        if error.errno in _NAK:
            return NoAnswer(f"{place}: not acknowledged (errno {error.errno}); check wiring, power, address")
        if error.errno == errno.ETIMEDOUT:
            return NoAnswer(f"{place}: the transfer timed out (errno {error.errno})")
        return DeviceError(f"{place}: {_MEANING.get(error.errno or 0, error)}")
