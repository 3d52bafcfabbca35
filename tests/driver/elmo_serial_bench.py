"""A drive on a serial line: its driver, its far end and the bytes of either side, which may be spoilt on their way."""

import math

from leactl_plugins.elmo_serial.driver import ElmoSerial
from leactl_plugins.elmo_serial.settings import ElmoSerialSettings

from leactl.driver.serial_port import SerialPort

from .failing import COUNTS
from .transports import SerialInProcess

BYTE_S = 10 / 115200
PERIOD_S = 0.01
COUNTS_PER_RAD = COUNTS / (2 * math.pi)


class SpoilingLine:
    """A connection whose bytes pass through the bench's own hands."""

    def __init__(self, bench) -> None:
        self._bench, self._line = bench, bench.wire.connect()

    def read(self, timeout):
        read = self._bench.to_host(self._line.read(timeout))
        self._bench.heard += read
        return read

    def write(self, data):
        if self._bench.unplugged:
            raise OSError(5, "Input/output error")
        self._bench.said += data
        self._line.write(self._bench.to_drive(data))
        return len(data)

    def close(self):
        self._line.close()


class ElmoSerialBench:
    """One drive at the host's line."""

    def __init__(self, wire=None, **settings) -> None:
        self.wire = wire or SerialInProcess(BYTE_S)
        self.exact, self.clock = self.wire.exact, self.wire.clock
        self.far = self.wire.device("elmo_serial")
        self.said, self.heard = bytearray(), bytearray()
        self.to_host = self.to_drive = bytes
        self.unplugged = False
        self.port = SerialPort(lambda: SpoilingLine(self), self.clock, "serial0")
        self.settings = ElmoSerialSettings(counts_per_turn=COUNTS, **settings)
        self.drive = ElmoSerial("drive", "test", self.settings, self.port, self.clock)

    @property
    def place(self):
        """The line's port; of a pseudo terminal only."""
        return self.wire.port

    @property
    def shaft(self):
        """What the drive turns; in process only."""
        return self.far.shaft

    def cycle(self, feed=True, period=PERIOD_S):
        """One cycle as the control loop makes it; its row."""
        began = self.clock.now()
        self.drive.begin_cycle()
        self.drive.end_cycle(began + (0.6 * period if self.exact else 0.5))
        if feed:
            self.drive.feed()
        self.clock.sleep_until(began + period)
        return list(self.drive.values)

    def cycles(self, seconds, feed=True):
        return [self.cycle(feed) for _ in range(round(seconds / PERIOD_S))]

    def engage(self, mode):
        self.drive.engage(mode)
        for _ in range(500):
            self.cycle()
            if self.drive.engaged:
                return
        raise AssertionError("not engaged within five seconds")

    def exchange(self):
        """The commands of one cycle, as they went over the line."""
        self.said.clear()
        self.cycle()
        return bytes(self.said).decode("ascii")

    def talk(self, text):
        """What the line brings back of these bytes, without the driver."""
        line = self.wire.connect()
        line.write(text)
        heard, end = b"", self.clock.now() + 0.2
        while self.clock.now() < end:
            heard += line.read(0.01)
        line.close()
        return heard
