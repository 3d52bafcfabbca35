"""SDO transfers over a port without threads: `canopen`'s client, whose wait for an answer pumps the port."""

import logging
import math
import queue
import struct
from typing import Any

from canopen import ObjectDictionary, SdoAbortedError, SdoCommunicationError
from canopen.sdo import SdoClient

from leactl.driver.can_port import CanPort
from leactl.errors import DeviceError, NoAnswer

FORMATS = {"u8": "<B", "i8": "<b", "u16": "<H", "i16": "<h", "u32": "<I", "i32": "<i"}


logging.getLogger("canopen").addHandler(logging.NullHandler())  # what it would say on stderr is raised here as an error


class _PumpedQueue(queue.Queue[bytes]):
    def __init__(self, port: CanPort) -> None:
        super().__init__()
        self._port = port
        self.until = math.inf
        self._came = [False]  # whether an answer waits

    def _put(self, item: bytes) -> None:
        super()._put(item)
        self._came[0] = True

    def _get(self) -> bytes:
        item = super()._get()
        self._came[0] = self._qsize() > 0
        return item

    def get(self, block: bool = True, timeout: float | None = None) -> bytes:
        if block:
            deadline = min(self._port.clock.now() + (timeout or 0.0), self.until)
            self._port.pump_until(self._came, deadline)
        return super().get(block=False)

    def clear(self) -> None:
        """Drop what nobody waits for: `canopen` would put a plain queue in its place, whose wait pumps nothing."""
        while not self.empty():
            super().get(block=False)


class _Sender:
    """The one call of `canopen.Network` that its SDO client makes."""

    def __init__(self, port: CanPort) -> None:
        self._port = port

    def send_message(self, identifier: int, data: bytes, remote: bool = False) -> None:
        self._port.send(identifier, bytes(data))


class Sdo:
    """Typed reads and writes of one node's objects, one transfer at a time."""

    def __init__(self, port: CanPort, node: int, timeout_s: float) -> None:
        self._node = node
        self._client = SdoClient(0x600 + node, 0x580 + node, ObjectDictionary())
        self._client.network = _Sender(port)
        self._answers = self._client.responses = _PumpedQueue(port)
        self._client.RESPONSE_TIMEOUT = timeout_s
        self._asked = b""

    def wait_no_longer_than(self, until: float) -> None:
        """End every wait for an answer at this moment of the port's clock at the latest; infinity lifts that."""
        self._answers.until = until

    def on_frame(self, data: bytearray, timestamp: float) -> None:
        """Take an answer of the node; one about an object that is not asked for now is late, or nobody's."""
        if data[1:4] == self._asked:
            self._client.on_response(0x580 + self._node, bytes(data), timestamp)

    def read(self, index: int, sub: int, kind: str) -> int:
        """Read an integer object.

        Raises
        ------
        NoAnswer : nothing came in time.
        DeviceError : the node aborted the transfer, or answered another length.
        """
        raw = self._guard(index, sub, self._client.upload)
        try:
            (value,) = struct.unpack(FORMATS[kind], raw)
        except struct.error:
            raise DeviceError(
                f"node {self._node}: 0x{index:04X}:{sub} has {len(raw)} bytes, {kind} was expected"
            ) from None
        return int(value)

    def write(self, index: int, sub: int, kind: str, value: int) -> None:
        """Write an integer object.

        Raises
        ------
        NoAnswer : nothing came in time.
        DeviceError : the node aborted the transfer.
        """
        self._guard(index, sub, self._client.download, struct.pack(FORMATS[kind], value))

    def write_verified(self, index: int, sub: int, kind: str, value: int) -> None:
        """Write an integer object and read it back.

        Raises
        ------
        DeviceError : as `write`, or the node holds another value afterwards.
        """
        self.write(index, sub, kind, value)
        held = self.read(index, sub, kind)
        if held != value:
            raise DeviceError(f"node {self._node}: 0x{index:04X}:{sub} holds {held} after {value} was written")

    def _guard(self, index: int, sub: int, call: Any, *arguments: Any) -> Any:
        self._answers.clear()
        self._asked = struct.pack("<HB", index, sub)
        try:
            return call(index, sub, *arguments)
        except SdoAbortedError as error:
            raise DeviceError(
                f"node {self._node}: 0x{index:04X}:{sub} refused, abort 0x{error.code:08X} ({error})"
            ) from None
        except (SdoCommunicationError, queue.Empty) as error:
            raise NoAnswer(f"node {self._node}: no SDO answer for 0x{index:04X}:{sub} ({error})") from None
