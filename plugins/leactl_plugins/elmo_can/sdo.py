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

FRAME_BYTES = 8  # of every SDO frame (CiA 301, 7.2.4.3); `canopen` breaks over a shorter one
# bits of command, expedited and size in the first byte, and their value if no size is stated (CiA 301, 7.2.4.3.5)
UPLOAD_MASK, EXPEDITED_WITHOUT_SIZE = 0xE3, 0x42
SEGMENT_ANSWERS_BELOW = 0x20  # command byte of a segment: its first three bits are 0 (CiA 301, 7.2.4.3.6)
LONGEST_TEXT_BYTES = 256  # names have some 30
TEXT_TIMEOUT_S = 1.0  # longest time to read a text; a name of 64 bytes takes 11 exchanges, some 2 ms at 1 Mbit/s
FORMATS = {"u8": "<B", "i8": "<b", "u16": "<H", "i16": "<h", "u32": "<I", "i32": "<i"}


logging.getLogger("canopen").addHandler(logging.NullHandler())  # its messages for stderr are raised here as errors


class Refused(DeviceError):
    """A node's abort of a transfer."""

    code = 0  # CiA 301, table 22


class _PumpedQueue(queue.Queue[bytes]):
    """Queue of answers whose wait pumps the port."""

    def __init__(self, port: CanPort) -> None:
        super().__init__()
        self._port = port
        self.deadline = math.inf  # time of the port's clock [s] at which every wait ends
        self._came = [False]  # whether an answer waits; in a list, because the port watches it

    def _put(self, item: bytes) -> None:
        super()._put(item)
        self._came[0] = True

    def _get(self) -> bytes:
        item = super()._get()
        self._came[0] = self._qsize() > 0
        return item

    def get(self, block: bool = True, timeout: float | None = None) -> bytes:
        if block:
            deadline = min(self._port.clock.now() + (timeout or 0.0), self.deadline)
            self._port.pump_until(self._came, deadline)
        return super().get(block=False)

    def clear(self) -> None:
        """Drop waiting answers; `canopen` would instead replace the queue by a plain one, whose wait pumps nothing."""
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
        self._node, self._port = node, port
        self._client = SdoClient(0x600 + node, 0x580 + node, ObjectDictionary())
        self._client.network = _Sender(port)
        self._answers = self._client.responses = _PumpedQueue(port)
        self._client.RESPONSE_TIMEOUT = timeout_s
        self._awaited_object = b""  # index and subindex as in a frame
        self.surplus = 0  # answers received minus transfers begun; -1 while an answer is awaited
        self._answer_states_size = True  # whether the last answer states how many of its four bytes are valid
        self._is_reading_text = False  # whether a text is read; the frames of its segments carry no index

    def wait_no_longer_than(self, deadline: float) -> None:
        """End every wait for an answer at this time of the port's clock [s]; infinity removes the limit."""
        self._answers.deadline = deadline

    def on_frame(self, data: bytearray, timestamp: float) -> None:
        """Pass on answers to the present transfer; count those for other objects, ignore frames of other lengths."""
        if len(data) != FRAME_BYTES:
            return
        if data[0] >= SEGMENT_ANSWERS_BELOW:
            self.surplus += 1
        if data[1:4] == self._awaited_object:
            self._answer_states_size = data[0] & UPLOAD_MASK != EXPEDITED_WITHOUT_SIZE
        if data[1:4] == self._awaited_object or (self._is_reading_text and data[0] < SEGMENT_ANSWERS_BELOW):
            self._client.on_response(0x580 + self._node, bytes(data), timestamp)

    def read(self, index: int, sub: int, kind: str) -> int:
        """Read an integer object.

        Raises
        ------
        NoAnswer : nothing came in time.
        Refused : the node aborted the transfer.
        DeviceError : the answer has another length than the integer type.
        """
        raw = self._transfer(index, sub, self._client.upload)
        layout = struct.Struct(FORMATS[kind])
        if not self._answer_states_size:
            raw = raw[: layout.size]
        try:
            (value,) = layout.unpack(raw)
        except struct.error:
            raise DeviceError(
                f"node {self._node}: 0x{index:04X}:{sub} has {len(raw)} bytes, {kind} was expected"
            ) from None
        return int(value)

    def read_text(self, index: int, sub: int) -> str:
        """Read a text object, in segments where it is longer than four bytes, within `TEXT_TIMEOUT_S`.

        Raises
        ------
        NoAnswer : nothing came in time.
        DeviceError : the node aborted the transfer, or its text does not end.
        """
        self._is_reading_text, earlier_deadline = True, self._answers.deadline
        self._answers.deadline = min(earlier_deadline, self._port.clock.now() + TEXT_TIMEOUT_S)
        try:
            raw: bytes = self._transfer(index, sub, self._upload_text)
        finally:
            self._is_reading_text, self._answers.deadline = False, earlier_deadline
        return raw.decode("utf-8", "replace").strip("\0 ")

    def _upload_text(self, index: int, sub: int) -> bytes:
        """Upload a text object in segments."""
        raw = b""
        with self._client.open(index, sub, buffering=0) as stream:
            while segment := stream.read(7):
                raw += segment
                if len(raw) > LONGEST_TEXT_BYTES:
                    raise SdoCommunicationError(f"a text of more than {LONGEST_TEXT_BYTES} bytes")
        return raw

    def write(self, index: int, sub: int, kind: str, value: int) -> None:
        """Write an integer object.

        Raises
        ------
        NoAnswer : nothing came in time.
        Refused : the node aborted the transfer.
        """
        self._transfer(index, sub, self._client.download, struct.pack(FORMATS[kind], value))

    def write_verified(self, index: int, sub: int, kind: str, value: int) -> None:
        """Write an integer object and read it back.

        Raises
        ------
        DeviceError : as `write`, or the node holds another value afterwards.
        """
        self.write(index, sub, kind, value)
        read_back = self.read(index, sub, kind)
        if read_back != value:
            raise DeviceError(f"node {self._node}: 0x{index:04X}:{sub} holds {read_back} after {value} was written")

    def _transfer(self, index: int, sub: int, client_method: Any, *arguments: Any) -> Any:
        """Run a transfer by a method of `canopen`'s client, and convert its errors to those of this package."""
        self._answers.clear()
        self._client.responses = self._answers  # `canopen` may have put a plain queue there, to drop doubles
        self._awaited_object = struct.pack("<HB", index, sub)
        self.surplus -= 1
        try:
            return client_method(index, sub, *arguments)
        except SdoAbortedError as error:
            text = f"node {self._node}: 0x{index:04X}:{sub} refused, abort 0x{error.code:08X} ({error})"
            refusal = Refused(text)
            refusal.code = error.code
            raise refusal from None
        except (SdoCommunicationError, queue.Empty) as error:
            text = f"node {self._node}: no SDO answer for 0x{index:04X}:{sub} ({error}){self._port.why_silent()}"
            raise NoAnswer(text) from None
