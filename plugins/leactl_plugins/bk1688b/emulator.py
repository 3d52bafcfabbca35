"""Emulator of the supply: commands end in a carriage return, and each valid one is answered by `OK`.

Unknown commands and values out of range get no answer.
"""

import re

from leactl.driver.far_end import SupplyLoad
from leactl.driver.supply_end import SupplyEnd
from leactl_plugins.bk1688b.settings import LOWEST_VOLTAGE_V, RATINGS, STEP_V

MOST_INPUT_BYTES = 64  # of an unfinished command, of which only the last are kept
PRESET_COUNT = 3  # pairs of levels in the memory of the supply


class Bk1688bEmulator(SupplyEnd):
    """One emulated supply that feeds a load."""

    def __init__(self, model: str, load: SupplyLoad, answer_s: float = 0.005) -> None:
        self.rating = RATINGS[model]
        self.presets = [(LOWEST_VOLTAGE_V, 0.0)] * PRESET_COUNT
        super().__init__(load, answer_s, LOWEST_VOLTAGE_V)

    def receive(self, data: bytes, now: float) -> None:
        """Receive bytes; a carriage return ends a command."""
        for byte in data:
            if byte == 0x0D:
                command, self._input = self._input.decode("ascii", "replace"), b""
                answer = self._obey(command)
                self._regulate()
                if answer is not None:
                    self._answer(answer.encode("ascii"), now)
            else:
                self._input = (self._input + bytes([byte]))[-MOST_INPUT_BYTES:]

    def _obey(self, command: str) -> str | None:
        """Carry out a command; return its answer with its line ends, or None if it has none."""
        match = re.fullmatch(r"(VOLT|CURR|GETS|GETD|GMAX|GETM|PROM|RUNM|SOUT|SESS|ENDS)([0-9]*)", command, re.ASCII)
        if match is None:
            return None
        keyword, digits = match[1], match[2]
        queries = {"GETS": self._settings, "GETD": self._display, "GMAX": self._limits, "GETM": self._memory}
        if keyword in queries and not digits:
            return f"{queries[keyword]()}\rOK\r"
        if keyword in ("SESS", "ENDS") and not digits:
            return "OK\r"
        return "OK\r" if self._change(keyword, digits) else None

    def _change(self, keyword: str, digits: str) -> bool:
        """Carry out a command with an argument; return whether it is valid."""
        if keyword == "SOUT" and digits in ("0", "1"):
            self._switch(digits == "0")
        elif (
            keyword == "VOLT"
            and len(digits) == 3
            and LOWEST_VOLTAGE_V <= (volts := int(digits) * STEP_V) <= self.rating.voltage
        ):
            self.set_volts = volts
        elif keyword == "CURR" and len(digits) == 3 and (amperes := self._amperes_of(digits)) <= self.rating.current:
            self.set_amperes = amperes
        elif keyword == "PROM" and len(digits) == 6 * PRESET_COUNT:
            presets_digits = [digits[6 * k : 6 * k + 6] for k in range(PRESET_COUNT)]
            self.presets = [
                (int(preset_digits[:3]) * STEP_V, self._amperes_of(preset_digits[3:]))
                for preset_digits in presets_digits
            ]
        elif keyword == "RUNM" and digits in ("0", "1", "2"):
            self.set_volts, self.set_amperes = self.presets[int(digits)]
        else:
            return False
        return True

    def _amperes_of(self, digits: str) -> float:
        """Return the current [A] that digits in steps of the model stand for."""
        return int(digits) * self.rating.current_step

    def _level_digits(self, volts: float, amperes: float) -> str:
        """Return two levels as three digits each, in steps of the model."""
        return f"{round(volts / STEP_V):03d}{round(amperes / self.rating.current_step):03d}"

    def _settings(self) -> str:
        return self._level_digits(self.set_volts, self.set_amperes)

    def _limits(self) -> str:
        return self._level_digits(self.rating.voltage, self.rating.current)

    def _memory(self) -> str:
        return "\r".join(self._level_digits(*preset) for preset in self.presets)

    def _display(self) -> str:
        return f"{round(100 * self.volts):04d}{round(100 * self.amperes):04d}{self._limited:d}"
