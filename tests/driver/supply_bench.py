"""A supply's driver, its far end and the line between them, with every byte of either side kept."""

import re

from leactl_plugins.bk1688b.driver import Bk1688b
from leactl_plugins.korad_ka.driver import KoradKa
from leactl_plugins.scpi_supply.driver import ScpiSupply

from leactl.driver.serial_port import SerialPort

from .transports import SerialInProcess

HEATED = {"dialect": "e36xx", "model": "E3633A", "feeds": "leads", "voltage_limit_V": 8.0, "current_limit_A": 10.0}
BK = {"model": "1688B", "feeds": "leads", "voltage_limit_V": 8.0, "current_limit_A": 10.0}
KORAD = {"model": "KA3010P", "feeds": "leads", "voltage_limit_V": 8.0, "current_limit_A": 9.5}


class Tap:
    """A connection with a tape of both directions, and a failure that a write or a read ends with."""

    def __init__(self, bench) -> None:
        self._bench, self._line = bench, bench.wire.connect()
        bench.connections += 1

    def read(self, timeout):
        read = self._line.read(timeout)
        self._bench.heard += read
        return read

    def write(self, data):
        if self._bench.dead_connections >= self._bench.connections:
            raise OSError(5, "Input/output error")
        taken = self._line.write(data)
        self._bench.said += data[:taken]
        return taken

    def close(self):
        self._line.close()


class SupplyBench:
    """One supply at the host's line."""

    driver, settings_given, line_end = ScpiSupply, HEATED, b"\n"

    def __init__(self, wire=None, **settings) -> None:
        self.wire = wire or SerialInProcess()
        self.exact, self.clock = self.wire.exact, self.wire.clock
        self.settings = self.driver.Settings(**(self.settings_given | self.wire.settings | settings))
        self.far = self.wire.device(*self.far_end())
        self.said, self.heard = bytearray(), bytearray()
        self.connections = self.dead_connections = 0
        self.port = SerialPort(lambda: Tap(self), self.clock, "supply0")
        self.expect()

    def far_end(self):
        """Which instrument is there."""
        settings = self.settings
        return "scpi_supply", settings.dialect, settings.model, settings.serial_number or "0", settings.output

    def expect(self, **other):
        """Have the driver expect something else than the instrument is."""
        settings = self.settings.model_copy(update=other)
        self.supply = self.driver("supply", "test", settings, self.port, self.clock)

    def lines(self):
        """What was sent since the last call, a line each."""
        sent = bytes(self.said).split(self.line_end)
        self.said.clear()
        assert sent.pop() == b""
        return sent

    def until(self, arrived, limit_s=10.0, period=0.001):
        """Run the loop until then; all rows."""
        rows, end = [], self.clock.now() + limit_s
        while self.clock.now() < end:
            rows += self.supply.take()
            if arrived(rows):
                return rows
            self.clock.sleep_until(self.clock.now() + period)
        raise AssertionError(f"not within {limit_s} s")

    def rows(self, count=1):
        return self.until(lambda rows: len(rows) >= count)

    def energise(self, volts=8.0, amperes=9.0):
        """Open, and have the supply put out."""
        self.supply.open()
        self.supply.supply(volts, amperes)
        self.supply.switch_on()
        self.until(lambda _: self.supply.supplying)
        self.rows()
        self.said.clear()
        self.supply.notices()

    def made_safe(self):
        """What the supply confirms, and how long that took."""
        allowed, began = (1.0 if self.exact else 2.0), self.clock.now()
        confirmed = self.supply.safe_state(allowed)
        took = self.clock.now() - began
        assert took <= allowed + (0.0 if self.exact else 0.5) + 1e-9
        return confirmed


class Bk1688bBench(SupplyBench):
    """A BK Precision supply at the host's line."""

    driver, settings_given, line_end = Bk1688b, BK, b"\r"

    def far_end(self):
        return "bk1688b", self.settings.model


class KoradKaBench(SupplyBench):
    """A Korad supply at the host's line, which loses what comes too soon; elsewhere it is less particular."""

    driver, settings_given, line_end = KoradKa, KORAD, b""

    def far_end(self):
        return "korad_ka", self.settings.model, "", "", 0.04 if self.exact else 0.0

    def commands(self):
        """What was sent since the last call, a command each."""
        sent = bytes(self.said)
        self.said.clear()
        commands = re.findall(rb"\*IDN\?|STATUS\?|OUT[01]|[VI](?:SET|OUT)1\?|[VI]SET1:[0-9.]+", sent)
        assert b"".join(commands) == sent
        return commands
