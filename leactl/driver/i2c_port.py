"""One I2C bus shared by several drivers: calls of smbus2, with its errors converted to named ones.

Registers are read and written by SMBus word transfers. On the wire these equal block transfers of two bytes; with the
kernel's i2c-stub, a block of two would also write the next register.
"""

import errno
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

from leactl.driver.tally import Tally
from leactl.errors import DeviceError, NoAnswer

MOST_ATTEMPTS = 3  # of a transfer, each of half a millisecond (three bytes and an address at 100 kHz)
_NOT_ACKNOWLEDGED = {errno.EREMOTEIO, errno.ENXIO, errno.ENODEV}
_MEANINGS = {
    errno.EBUSY: "a kernel driver holds this address; unbind it",
    errno.EACCES: "no permission; add the user to group i2c",
    errno.ENOENT: "no such bus; load i2c-dev and enable the adapter",
}


class SmBus(Protocol):
    """The part of smbus2.SMBus that is used."""

    def read_word_data(self, i2c_addr: int, register: int) -> int: ...  # noqa: D102
    def write_word_data(self, i2c_addr: int, register: int, value: int) -> None: ...  # noqa: D102
    def close(self) -> None: ...  # noqa: D102


def swap_bytes(word: int) -> int:
    """Return a word with its bytes swapped: SMBus sends the low byte first, these devices the high byte."""
    return (word & 0xFF) << 8 | word >> 8


class I2cPort:
    """Registers of devices on one bus, most significant byte first."""

    def __init__(self, connect: Callable[[], SmBus], name: str = "i2c") -> None:
        self._connect = connect
        self.name = name
        self._bus: SmBus | None = None
        self._users = 0
        self.repeated = Tally()  # repeats of transfers that were not acknowledged

    @property
    def connected(self) -> bool:
        """Whether there is a connection, dead or alive."""
        return self._bus is not None

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
                raise DeviceError(f"bus '{self.name}': {_MEANINGS.get(error.errno or 0, error)}") from None
        self._users += 1

    def close(self) -> None:
        """Disconnect when the last user has closed the port."""
        self._users = max(0, self._users - 1)
        bus = self._bus
        if self._users == 0 and bus is not None:
            self._bus = None
            with suppress(OSError):  # the line is closed already
                bus.close()

    def read(self, address: int, register: int) -> int:
        """Read a 16-bit register.

        Raises
        ------
        NoAnswer : nothing acknowledged, or the transfer timed out.
        DeviceError : the bus is closed or failed.
        """
        bus = self._bus
        if bus is None:
            raise DeviceError(f"bus '{self.name}': not open")
        return swap_bytes(self._transfer(address, lambda: bus.read_word_data(address, register)))

    def write(self, address: int, register: int, value: int) -> None:
        """Write a 16-bit register.

        Raises
        ------
        NoAnswer : nothing acknowledged, or the transfer timed out.
        DeviceError : the bus is closed or failed.
        """
        bus = self._bus
        if bus is None:
            raise DeviceError(f"bus '{self.name}': not open")
        self._transfer(address, lambda: bus.write_word_data(address, register, swap_bytes(value)))

    def notices(self) -> list[str]:
        """Return one line for each notable event of the bus since the last call."""
        count = self.repeated.take_note()
        return [f"bus '{self.name}': a transfer went through only when it was repeated, {count}"] if count else []

    def _transfer(self, address: int, transfer: Callable[[], Any]) -> Any:
        """Make a transfer, and repeat it if it is not acknowledged: near a motor drive, bits get lost."""
        for attempts_left in reversed(range(MOST_ATTEMPTS)):
            try:
                return transfer()
            except OSError as error:
                if error.errno not in _NOT_ACKNOWLEDGED or not attempts_left:
                    raise self._explain(error, address) from None
                self.repeated.count += 1
        raise AssertionError("the last attempt returns or raises")

    def _explain(self, error: OSError, address: int) -> DeviceError:
        """Return the named error for a transfer that failed."""
        place = f"bus '{self.name}', address 0x{address:02X}"
        if error.errno in _NOT_ACKNOWLEDGED:
            return NoAnswer(f"{place}: not acknowledged (errno {error.errno}); check wiring, power, address")
        if error.errno == errno.ETIMEDOUT:
            return NoAnswer(f"{place}: the transfer timed out (errno {error.errno})")
        return DeviceError(f"{place}: {_MEANINGS.get(error.errno or 0, error)}")
