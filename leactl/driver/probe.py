"""Probes: how a driver recognises its devices on a wire that no bench file describes yet.

A driver has at most one probe, `Driver.probe`, whose class tells the kind of wire. A probe only reads: what it sends
changes no setting, no state and no output of any device, not even of one that speaks another protocol.
"""

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from leactl.driver.conversation import Query, Script, Talk
from leactl.driver.far_end import Frame
from leactl.driver.i2c_port import I2cPort
from leactl.driver.serial_port import SerialPort
from leactl.errors import NoAnswer

if TYPE_CHECKING:
    from leactl.driver.can_port import CanPort
    from leactl.driver.contract import Identity

ANSWER_S = 0.5  # longest time for an instrument on a line to answer


class Sighting(NamedTuple):
    """A device that answered."""

    address: int | None  # on its bus; None on a line with one device
    identity: "Identity"
    settings: Mapping[str, Any] | None  # those that follow from the answer; None: another driver's device
    detail: str = ""  # what else the device said of itself
    left_open: tuple[str, ...] = ()  # settings that this device needs beside those that every device needs


Seen = Iterator[Sighting | str]
"""Devices, and one line of text for each answer that is not as it should be: garbled, doubled, unasked."""


class CanProbe(ABC):
    """Recognises devices on a CAN bus, to which the scan has listened before anything is asked.

    The scan refuses to send a frame with an identifier in `taken`.
    """

    fd: ClassVar[bool] = False  # asks by CAN-FD frames, which are errors to a controller for classic frames
    searches: ClassVar[bool] = True  # asks addresses from which nothing was heard; such probes come first

    def heard(self, frames: Sequence[Frame]) -> Collection[int]:
        """Return the addresses of the devices that sent one of these frames by themselves."""
        return ()

    def host(self, frames: Sequence[Frame]) -> str:
        """Return as text what another host has sent among these frames; empty if it has sent nothing."""
        return ""

    @abstractmethod
    def identifiers(self, address: int) -> Collection[int]:
        """Return the identifiers of 11 bits that the device of this address sends or acts on."""

    @abstractmethod
    def ask(self, port: "CanPort", addresses: Collection[int], taken: Collection[int]) -> Seen:
        """Ask the devices who they are; `addresses` were heard, `taken` are identifiers of other protocols' devices.

        Raises
        ------
        DeviceError : the bus is gone, or takes no frames.
        """


class I2cProbe(ABC):
    """Recognises devices on an I2C bus, at no other addresses than such a device can have."""

    @abstractmethod
    def ask(self, port: I2cPort) -> Seen:
        """Read from the addresses; the scan refuses to write.

        Raises
        ------
        DeviceError : the bus is gone.
        """


class LineProbe(ABC):
    """Recognises the device at the end of a serial line, or behind the raw socket of an instrument.

    The scan opens a line anew for each rate, with 8 data bits, no parity and 1 stop bit.
    """

    baudrates: ClassVar[Sequence[int]]  # that such devices can have

    @abstractmethod
    def ask(self, port: SerialPort) -> Seen:
        """Ask the device who it is.

        Raises
        ------
        DeviceError : the line is gone.
        """

    @staticmethod
    def answer(port: SerialPort, question: Query) -> Any:
        """Return the value of the answer to a question, which may not be None itself; None if nothing readable came.

        The question is sent twice at the most: the first time it may end a command that another program has half sent,
        and the instrument then reads neither.

        Raises
        ------
        DeviceError : the line is gone.
        """
        for _ in range(2):
            try:
                return Talk(port, _script(question), ANSWER_S).finish(port.clock.now() + ANSWER_S)
            except NoAnswer:
                continue
        return None


def _script(question: Query) -> Script[Any]:
    """Return a script that asks a question until its reply is readable, and returns the value of the reply."""
    reply = yield question._replace(patient=True)
    assert reply is not None
    return reply.value


Probe = CanProbe | I2cProbe | LineProbe
