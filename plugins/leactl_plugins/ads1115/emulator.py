"""Emulator of an ADS1115: registers as in the data sheet (TI SBAS444), voltages from a bench.

A conversion returns the voltage at its middle, which is to first order the mean over it.
"""

import math
from collections.abc import Callable

from leactl.driver.far_end import RegisterStore

CONVERSION, CONFIG, LOW, HIGH = range(4)
_OS, _SINGLE = 0x8000, 0x0100
HANDLED_BIT = 0x0004  # COMP_LAT, without effect while the comparator is off
_FULL_SCALES_V = (6.144, 4.096, 2.048, 1.024, 0.512, 0.256, 0.256, 0.256)
_RATES_SPS = (8, 16, 32, 64, 128, 250, 475, 860)
_DIFFERENTIAL_PINS = ((0, 1), (0, 3), (1, 3), (2, 3))


class Ads1115Emulator:
    """One ADS1115; `pins(number)` returns the voltage at a pin now, `noise()` the noise of one conversion [V]."""

    def __init__(
        self, pins: Callable[[int], float], noise: Callable[[], float] = lambda: 0.0, clock_error: float = 0.0
    ):
        self._pins, self._noise = pins, noise
        self._period_factor = 1.0 / (1.0 + clock_error)
        self._registers = [0x0000, 0x8583, 0x8000, 0x7FFF]
        self._ends: float | None = None
        self.due = math.inf  # middle of the present conversion [s]
        self._converted_config = self._sampled_code = 0
        self._stored_config: int | None = None  # configuration that was last read from the store or written to it
        self._is_conversion_pending = False  # whether the last word from the store was a start

    def read(self, register: int, now: float) -> int:
        """Read a register."""
        self._finish(now)
        if register == CONFIG:
            return self._registers[CONFIG] & ~_OS | (_OS if self._ends is None else 0)
        return self._registers[register & 3]

    def write(self, register: int, value: int, now: float) -> None:
        """Write a register; the conversion register cannot be written."""
        self._finish(now)
        if register == CONVERSION:
            return
        self._registers[register & 3] = value & 0xFFFF
        if register == CONFIG and (value & _OS or not value & _SINGLE) and self._ends is None:
            self._begin(now)

    def keep(self, store: RegisterStore, now: float) -> None:
        """Run single conversions on a register store: start one when the host writes a start, and store the result.

        The host starts each conversion with the same word. The stored configuration therefore differs from that word in
        one bit, during and after a conversion, and any other stored word is a start.
        """
        if self._stored_config is None:
            self._stored_config = self.read(CONFIG, now)
            for register, value in enumerate(self._registers):
                store.write(register, value)
            return
        written_config = store.read(CONFIG)
        if written_config != self._stored_config:
            self.write(CONFIG, written_config, now)
            self._stored_config, self._is_conversion_pending = written_config, bool(written_config & _OS)
        handled_config = self.read(CONFIG, now) ^ HANDLED_BIT
        if self._is_conversion_pending and handled_config != self._stored_config:
            store.write(CONVERSION, self._registers[CONVERSION])
            store.write(CONFIG, handled_config)
            self._stored_config = handled_config

    def tick(self, now: float) -> None:
        """Sample the input at the middle of a conversion."""
        if now >= self.due:
            self._sampled_code, self.due = self._convert(self._converted_config), math.inf

    def _begin(self, now: float) -> None:
        """Begin a conversion."""
        self._converted_config = config = self._registers[CONFIG]
        duration = self._period_factor / _RATES_SPS[config >> 5 & 7] + 25e-6
        self._ends, self.due = now + duration, now + duration / 2

    def _finish(self, now: float) -> None:
        """End the conversions whose time has passed; in continuous mode, the next one begins at once."""
        while self._ends is not None and now >= self._ends:
            self.tick(now)
            self._registers[CONVERSION] = self._sampled_code
            ended, self._ends = self._ends, None
            if not self._registers[CONFIG] & _SINGLE:
                self._begin(ended)

    def _convert(self, config: int) -> int:
        """Return the code of the voltage at the pins of a configuration."""
        mux = config >> 12 & 7
        if mux < 4:
            plus, minus = _DIFFERENTIAL_PINS[mux]
            volts = self._pins(plus) - self._pins(minus)
        else:
            volts = self._pins(mux - 4)
        count = round((volts + self._noise()) / _FULL_SCALES_V[config >> 9 & 7] * 32768)
        return max(-0x8000, min(0x7FFF, count)) & 0xFFFF
