"""A power meter that speaks Modbus RTU: an example of a driver of a binary protocol, and the meter's far end.

Functions 3 and 4 and exceptions by the Modbus Application Protocol V1.1b3; address, CRC and silence by Modbus over
Serial Line V1.02. Registers are those of Eastron's SDM meters (SDM320Y user manual): floats in two registers each.
"""

import math
import struct
from typing import Annotated, ClassVar

from pydantic import Field

from leactl.driver.contract import Confirmation, Driver, DriverSettings, Row, StreamSpec
from leactl.driver.conversation import Pause, Query, Talk
from leactl.driver.serial_port import FrameCut
from leactl.errors import DeviceError, NoAnswer
from leactl.quantities import ChannelSpec

HOLDING, INPUT = 3, 4  # functions that read registers
EXCEPTION = 0x80  # added to the function
EXCEPTIONS = {1: "illegal function", 2: "illegal data address", 3: "illegal data value", 4: "device failure", 6: "busy"}
PULSE_WIDTH, VOLTAGE, CURRENT = 0x0C, 0, 6  # first registers; the first is a holding register, in ms
OPEN_S = 2.0
MOST_LOST_ROUNDS = 3  # rounds in sequence
QUANTITIES = ("bus_voltage", "bus_current")


def crc16(data):
    """CRC of Modbus; 0 over a frame with its own CRC."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


def with_crc(data):
    return data + struct.pack("<H", crc16(data))


def answers_to(request):
    """Framing of the answers to a request; an answer of another length belongs to another request."""
    address, function, count = request[0], request[1], request[5]

    def framing(received):
        if received[0] != address:
            return FrameCut(1, 0)
        if len(received) < 3:
            return FrameCut(0, 0)
        length = 5 if received[1] == function | EXCEPTION else 5 + 2 * count
        if length > 5 and (received[1], received[2]) != (function, 2 * count):
            return FrameCut(1, 0)
        if len(received) >= length and crc16(received[:length]):
            return FrameCut(1, 0)
        return FrameCut(0, length)

    return framing


class ModbusMeterSettings(DriverSettings):
    """Address of the meter, and its times."""

    address: Annotated[int, Field(ge=1, le=247)] = 1
    period_s: Annotated[float, Field(ge=0.01, le=60)] = 0.1
    answer_s: Annotated[float, Field(gt=0, le=10)] = 0.3
    silence_s: Annotated[float, Field(ge=0.00175, le=1)] = 0.005  # 3.5 characters of 11 bits last 4.01 ms at 9600 baud


class ModbusMeter(Driver):
    """One meter, asked for voltage and current in turn; the two answers differ in length."""

    Settings = ModbusMeterSettings
    transport, further_transports = "serial", ("visa",)
    summary = "power meter over Modbus RTU"
    example: ClassVar = {"period_s": 0.05}

    def __init__(self, name, role, settings, port, clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        self._port, self._clock = port, clock
        self._opened = False
        self._talk = None
        self._rows = []

    def safe_state(self, deadline_s) -> Confirmation:
        return Confirmation(True, "measures only")

    def open(self):
        self._port.open()
        self._opened, self._talk = True, None
        met = Talk(self._port, self._registers(HOLDING, PULSE_WIDTH, 2), self.settings.answer_s)
        met.finish(self._clock.now() + OPEN_S)

    def close(self):
        if self._opened:
            self._opened = False
            self._port.close()

    @property
    def streams(self):
        channels = (ChannelSpec(quantity, quantity, self.role, self.name) for quantity in QUANTITIES)
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
                voltage = yield from self._registers(INPUT, VOLTAGE, 2)
                current = yield from self._registers(INPUT, CURRENT, 4)
            except NoAnswer as error:
                lost += 1
                if lost == MOST_LOST_ROUNDS:
                    raise NoAnswer(f"{self.name}: {error}") from None
                continue
            lost = 0
            values = [struct.unpack_from(">f", reply.value, 3)[0] for reply in (voltage, current)]
            self._rows.append(Row(self.name, voltage.asked, values))

    def _registers(self, function, first, count):
        """Read registers once the line has been silent.

        Raises
        ------
        DeviceError : the meter answers with an exception; NoAnswer : it does not answer.
        """
        while not self._port.silent_for(self.settings.silence_s):
            yield Pause()
        request = with_crc(struct.pack(">BBHH", self.settings.address, function, first, count))
        reply = yield Query(request, bytes, framing=answers_to(request))
        if reply.value[1] & EXCEPTION:
            number = reply.value[2]
            raise DeviceError(
                f"{self.name}: registers {first} to {first + count - 1} are refused: exception {number}"
                f" ({EXCEPTIONS.get(number, 'unknown')})"
            )
        return reply

    @classmethod
    def far_end(cls, settings, role, physics):
        return ModbusMeterEnd(*(physics.reading(quantity, role) for quantity in QUANTITIES), settings.address)


class ModbusMeterEnd:
    """The meter: a request ends with the line's silence, and is answered if address and CRC are right."""

    silence_s = 3.5 * 11 / 9600

    def __init__(self, voltage, current, address=1, delay_s=0.01) -> None:
        self._address, self.delay_s = address, delay_s
        self._readings = {(INPUT, VOLTAGE): voltage, (INPUT, CURRENT): current, (HOLDING, PULSE_WIDTH): lambda: 100.0}
        self._received, self._heard = b"", math.inf
        self._sends = []  # of times and frames

    @property
    def due(self):
        return min([self._heard + self.silence_s, *(time for time, _ in self._sends)])

    def receive(self, data, now):
        self._received, self._heard = self._received + data, now

    def tick(self, now):
        if now >= self._heard + self.silence_s:
            request, self._received, self._heard = self._received, b"", math.inf
            if len(request) == 8 and request[0] == self._address and crc16(request) == 0:
                self._sends.append((now + self.delay_s, with_crc(self._answer(*struct.unpack(">BBHH", request[:6])))))
        sent = b"".join(frame for time, frame in self._sends if time <= now)
        self._sends = [(time, frame) for time, frame in self._sends if time > now]
        return sent

    def _answer(self, address, function, first, count):
        if function not in (HOLDING, INPUT):
            return bytes((address, function | EXCEPTION, 1))
        if (function, first) not in self._readings:
            return bytes((address, function | EXCEPTION, 2))
        if not 1 <= count <= 125:
            return bytes((address, function | EXCEPTION, 3))
        value = struct.pack(">f", self._readings[function, first]()).ljust(2 * count, b"\0")[: 2 * count]
        return bytes((address, function, 2 * count)) + value
