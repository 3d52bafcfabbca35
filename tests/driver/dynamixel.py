"""A servo that speaks DYNAMIXEL Protocol 2.0: an example of a driver of a binary protocol, and the servo's far end.

ROBOTIS e-manual, Protocol 2.0: header, byte stuffing, length, CRC-16, and the error byte of a status packet. The
control table is that of the XM430-W210 (model 1030). The driver only reads; nothing turns.
"""

import math
import struct
from typing import Annotated, ClassVar

from pydantic import Field

from leactl.driver.contract import Confirmation, Driver, DriverSettings, Identity, Row, StreamSpec
from leactl.driver.conversation import Pause, Query, Talk, Unreadable
from leactl.driver.serial_port import FrameCut
from leactl.errors import DeviceError, DeviceFault, NoAnswer
from leactl.quantities import ChannelSpec

HEADER = b"\xff\xff\xfd\x00"
STUFFED = b"\xff\xff\xfd"  # in a packet it is followed by one more 0xFD
PING, READ, STATUS = 0x01, 0x02, 0x55
ALERT = 0x80  # in the error byte
ERRORS = {1: "result fail", 2: "instruction error", 3: "CRC error", 4: "data range error", 5: "data length error",
          6: "data limit error", 7: "access error"}  # fmt: skip
LEAST, MOST = 3, 250  # length field: instruction and CRC; no answer of this servo is longer
POSITION, VOLTAGE = (132, 4), (144, 2)  # address and bytes
PULSES_PER_TURN, VOLTS = 4096, 0.1
MODEL, FIRMWARE = 1030, 38
OPEN_S = 2.0
MOST_LOST_ROUNDS = 3  # rounds in sequence


def crc16(data):
    """CRC with the polynomial 0x8005, most significant bit first, from 0."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x8005 if crc & 0x8000 else 0)) & 0xFFFF
    return crc


def packet(ident, instruction, parameters=b""):
    body = (bytes((instruction,)) + parameters).replace(STUFFED, STUFFED + b"\xfd")
    head = HEADER + struct.pack("<BH", ident, len(body) + 2) + body
    return head + struct.pack("<H", crc16(head))


def body_of(whole):
    """Identifier, instruction and parameters of a packet."""
    body = whole[7:-2].replace(STUFFED + b"\xfd", STUFFED)
    return whole[4], body[0], body[1:]


def packets(received):
    """Framing of packets of either direction."""
    start = received.find(HEADER)
    if start < 0:  # what may be the beginning of a header is kept
        return FrameCut(next(n for n in range(len(received) + 1) if HEADER.startswith(received[n:])), 0)
    if start or len(received) < 7:
        return FrameCut(start, 0)
    length = int.from_bytes(received[5:7], "little")
    if not LEAST <= length <= MOST:
        return FrameCut(1, 0)
    whole = received[: 7 + length]
    if len(whole) == 7 + length and struct.pack("<H", crc16(whole[:-2])) != whole[-2:]:
        return FrameCut(1, 0)
    return FrameCut(0, 7 + length)


def status_of(ident, count):
    """Parser of the status packet of a servo with so many parameters, or with an error; gives error and parameters."""

    def parsed(whole):
        answering, instruction, parameters = body_of(whole)
        if (answering, instruction) != (ident, STATUS) or not parameters:
            raise Unreadable(whole.hex(" "))
        error, parameters = parameters[0], parameters[1:]
        if len(parameters) != count and not error & ~ALERT:
            raise Unreadable(whole.hex(" "))
        return error, parameters

    return parsed


class DynamixelSettings(DriverSettings):
    """Identifier of the servo, and its times."""

    servo: Annotated[int, Field(ge=0, le=252)] = 1
    period_s: Annotated[float, Field(ge=0.01, le=60)] = 0.1
    answer_s: Annotated[float, Field(gt=0, le=10)] = 0.1


class Dynamixel(Driver):
    """One servo, asked for position and voltage in turn; the two answers differ in length."""

    Settings = DynamixelSettings
    transport = "serial"
    baudrate = 57600
    summary = "servo over DYNAMIXEL Protocol 2.0, read only"
    example: ClassVar = {"period_s": 0.05}

    def __init__(self, name, role, settings, port, clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        self._port, self._clock = port, clock
        self._opened = False
        self._identity = Identity()
        self._talk = None
        self._rows = []

    def safe_state(self, deadline_s) -> Confirmation:
        return Confirmation(True, "only read")

    def open(self):
        self._port.open()
        self._opened, self._talk = True, None
        met = Talk(self._port, self._ask(PING, b"", 3), self.settings.answer_s)
        model, firmware = struct.unpack("<HB", met.finish(self._clock.now() + OPEN_S).value[1])
        self._identity = Identity(model=str(model), firmware=str(firmware))

    def close(self):
        if self._opened:
            self._opened = False
            self._port.close()

    def identity(self) -> Identity:
        return self._identity

    @property
    def streams(self):
        channels = (ChannelSpec(quantity, quantity, self.role, self.name) for quantity in ("angle", "bus_voltage"))
        return (StreamSpec(self.name, tuple(channels)),)

    def take(self):
        if self._talk is None:
            self._talk = Talk(self._port, self._rounds(), self.settings.answer_s)
        try:
            self._talk.step()
        except DeviceError:
            self._talk = None
            raise
        rows, self._rows = self._rows, []
        return rows

    def _rounds(self):
        due, lost = -math.inf, 0
        while True:
            if self._clock.now() < due:
                yield Pause()
                continue
            due = self._clock.now() + self.settings.period_s
            try:
                position = yield from self._ask(READ, struct.pack("<HH", *POSITION), POSITION[1])
                voltage = yield from self._ask(READ, struct.pack("<HH", *VOLTAGE), VOLTAGE[1])
            except NoAnswer as error:
                lost += 1
                if lost == MOST_LOST_ROUNDS:
                    raise NoAnswer(f"{self.name}: {error}") from None
                continue
            lost = 0
            [pulses], [tenths] = struct.unpack("<i", position.value[1]), struct.unpack("<H", voltage.value[1])
            angle = 2 * math.pi * pulses / PULSES_PER_TURN
            self._rows.append(Row(self.name, position.asked, (angle, VOLTS * tenths)))

    def _ask(self, instruction, parameters, count):
        """Send an instruction; packets of others, an echo among them, are no answer to it.

        Raises
        ------
        DeviceError : the status packet has an error; NoAnswer : there is none.
        """
        servo = self.settings.servo
        sent = packet(servo, instruction, parameters)
        reply = yield Query(sent, status_of(servo, count), patient=True, framing=packets)
        error = reply.value[0]
        if error & ~ALERT:
            raise DeviceError(f"{self.name}: error {error & ~ALERT} ({ERRORS.get(error & ~ALERT, 'unknown')})")
        if error & ALERT:
            raise DeviceFault(f"{self.name}: alert: its hardware error status is set")
        return reply

    @classmethod
    def far_end(cls, settings, role, physics):
        return DynamixelEnd(physics.reading("angle", role), physics.reading("bus_voltage", role), settings.servo)


class DynamixelEnd:
    """The servo: reads packets as they come, and answers those with its identifier and a right CRC."""

    def __init__(self, angle, voltage, servo=1, delay_s=0.0005) -> None:
        self._angle, self._voltage, self._servo, self.delay_s = angle, voltage, servo, delay_s
        self.alert = False
        self._received, self._sends = b"", []

    @property
    def due(self):
        return min((time for time, _ in self._sends), default=math.inf)

    def receive(self, data, now):
        self._received += data
        while (start := self._received.find(HEADER)) >= 0 and len(self._received) >= start + 7:
            end = start + 7 + int.from_bytes(self._received[start + 5 : start + 7], "little")
            if len(self._received) < end:
                return
            whole, self._received = self._received[start:end], self._received[end:]
            if crc16(whole[:-2]) == int.from_bytes(whole[-2:], "little"):
                self._act(*body_of(whole), now)

    def tick(self, now):
        sent = b"".join(whole for time, whole in self._sends if time <= now)
        self._sends = [(time, whole) for time, whole in self._sends if time > now]
        return sent

    def _act(self, ident, instruction, parameters, now):
        if ident != self._servo:
            return
        error, told = self._told(instruction, parameters)
        status = bytes((error | (ALERT if self.alert else 0),)) + told
        self._sends.append((now + self.delay_s, packet(ident, STATUS, status)))

    def _told(self, instruction, parameters):
        if instruction == PING:
            return 0, struct.pack("<HB", MODEL, FIRMWARE)
        if instruction != READ:
            return 2, b""
        asked = struct.unpack("<HH", parameters)
        if asked == POSITION:
            return 0, struct.pack("<i", round(self._angle() * PULSES_PER_TURN / (2 * math.pi)))
        if asked == VOLTAGE:
            return 0, struct.pack("<H", round(self._voltage() / VOLTS))
        return 7, b""
