"""Emulator of the supply: commands end in a carriage return, and each valid one is answered by `OK`.

Unknown commands and values out of range get no answer. Instruments of this family with SOVP and SOCP and such without
are both at hand; what they do beyond their level is assumed: the output goes off.
"""

import re

from leactl.driver.far_end import SupplyLoad
from leactl.driver.supply_end import SupplyEnd
from leactl_plugins.bk1688b.models import LEAST_V, RATINGS, STEP_V

MOST_INPUT = 64
PRESETS = 3


class Bk1688bEmulator(SupplyEnd):
    """One supply that feeds a load."""

    def __init__(self, model: str, load: SupplyLoad, answer_s: float = 0.005, has_protections: bool = True) -> None:
        """`has_protections`: whether it knows SOVP, GOVP, SOCP and GOCP."""
        self.rating = RATINGS[model]
        self.has_protections = has_protections
        self.over_volts, self.over_amperes = self.rating.voltage, self.rating.current
        self.presets = [(LEAST_V, 0.0)] * PRESETS
        super().__init__(load, answer_s, LEAST_V)

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
                self._input = (self._input + bytes([byte]))[-MOST_INPUT:]

    def _obey(self, command: str) -> str | None:
        """The answer to a command, with its line ends; None if there is none."""
        match = re.fullmatch(
            r"(VOLT|CURR|GETS|GETD|GMAX|GETM|PROM|RUNM|SOUT|SESS|ENDS|[GS]O[VC]P)([0-9]*)", command, re.ASCII
        )
        if match is None:
            return None
        word, digits = match[1], match[2]
        if word.endswith("P") and not self.has_protections:
            return None
        queries = {
            "GETS": self._settings,
            "GETD": self._display,
            "GMAX": self._limits,
            "GETM": self._memory,
            "GOVP": self._over_voltage,
            "GOCP": self._over_current,
        }
        if word in queries and not digits:
            return f"{queries[word]()}\rOK\r"
        if word in ("SESS", "ENDS") and not digits:
            return "OK\r"
        return "OK\r" if self._change(word, digits) else None

    def _change(self, word: str, digits: str) -> bool:
        """Carry out a command with an argument; False if it is invalid."""
        if word == "SOUT" and digits in ("0", "1"):
            self._switch(digits == "0")
        elif word == "VOLT" and len(digits) == 3 and LEAST_V <= (volts := int(digits) * STEP_V) <= self.rating.voltage:
            self.set_volts = volts
        elif word == "CURR" and len(digits) == 3 and (amperes := self._amperes(digits)) <= self.rating.current:
            self.set_amperes = amperes
        elif word == "SOVP" and len(digits) == 3 and (volts := int(digits) * STEP_V) <= self.rating.voltage:
            self.over_volts = volts
        elif word == "SOCP" and len(digits) == 3 and (amperes := self._amperes(digits)) <= self.rating.current:
            self.over_amperes = amperes
        elif word == "PROM" and len(digits) == 6 * PRESETS:
            presets_digits = [digits[6 * k : 6 * k + 6] for k in range(PRESETS)]
            self.presets = [
                (int(preset_digits[:3]) * STEP_V, self._amperes(preset_digits[3:])) for preset_digits in presets_digits
            ]
        elif word == "RUNM" and digits in ("0", "1", "2"):
            self.set_volts, self.set_amperes = self.presets[int(digits)]
        else:
            return False
        return True

    def _regulate(self) -> None:
        super()._regulate()
        if self.has_protections and self.on:
            room_v, room_a = STEP_V / 2, self.rating.step_A / 2
            if self.volts > self.over_volts + room_v or self.amperes > self.over_amperes + room_a:
                self._switch(False)
                super()._regulate()

    def _amperes(self, digits: str) -> float:
        return int(digits) * self.rating.step_A

    def _pair(self, volts: float, amperes: float) -> str:
        return f"{round(volts / STEP_V):03d}{round(amperes / self.rating.step_A):03d}"

    def _settings(self) -> str:
        return self._pair(self.set_volts, self.set_amperes)

    def _limits(self) -> str:
        return self._pair(self.rating.voltage, self.rating.current)

    def _over_voltage(self) -> str:
        return f"{round(self.over_volts / STEP_V):03d}"

    def _over_current(self) -> str:
        return f"{round(self.over_amperes / self.rating.step_A):03d}"

    def _memory(self) -> str:
        return "\r".join(self._pair(*preset) for preset in self.presets)

    def _display(self) -> str:
        return f"{round(100 * self.volts):04d}{round(100 * self.amperes):04d}{self._limited:d}"
