"""Emulator of the supply: commands end when the line is silent, and a command that arrives too soon is lost.

A command is too soon before the answer to a query, or within `REST_S` after a setting or `STATUS?`, for which the
instrument needs longer (libsigrok, pull request 210). Settings, unknown commands and values out of range are not
answered.
"""

import math
import re

from leactl.driver.far_end import SupplyLoad
from leactl.driver.supply_end import SupplyEnd
from leactl_plugins.korad_ka.settings import RATINGS

COMMAND_END_S = 0.005  # silence that ends a command; five characters at 9600 baud
REST_S = 0.04  # time after a setting or STATUS? in which commands are lost, from the end of the command
MOST_INPUT_BYTES = 64  # of an unfinished command, of which only the last are kept
HIGHEST_LEVEL_OVER_RATING = 1.03  # highest level that can be set: libsigrok has 31 V and 5.1 A for 30 V and 5 A


class KoradEmulator(SupplyEnd):
    """One emulated supply that feeds a load."""

    def __init__(
        self,
        model: str,
        load: SupplyLoad,
        identity: bytes = b"",
        stray: bytes = b"",
        rest_s: float = REST_S,
        answer_s: float = 0.01,
    ) -> None:
        """`identity`: answer to `*IDN?` in place of the usual one; `stray`: the sixth byte after `ISET1?`."""
        self.rating = RATINGS[model]
        self._identity, self._stray, self._rest_s = identity or f"KORAD{model}V2.0".encode("ascii"), stray, rest_s
        self._command_ends_at = -math.inf  # time at which silence ends the present command
        self._ready_at = -math.inf  # time from which the next command is obeyed
        self._is_command_lost = False  # whether the present command is lost
        self.protections = {"OVP": False, "OCP": False}
        super().__init__(load, answer_s)

    @property
    def due(self) -> float:
        """Time of the next answer, the next regulation or the end of a command [s]."""
        return min(super().due, self._command_ends_at if self._input else math.inf)

    def receive(self, data: bytes, now: float) -> None:
        """Receive bytes of one command; silence ends it."""
        if now >= self._command_ends_at:
            self._finish(now)
            self._is_command_lost = now < self._ready_at
        self._command_ends_at = now + COMMAND_END_S
        if not self._is_command_lost:
            self._input = (self._input + data)[-MOST_INPUT_BYTES:]

    def tick(self, now: float) -> bytes:
        """Obey a command that has ended; return an answer that is ready."""
        if now >= self._command_ends_at:
            self._finish(now)
        return super().tick(now)

    def _finish(self, now: float) -> None:
        """Obey the command that has ended, and note from when on the next one is obeyed."""
        command, self._input = self._input.decode("ascii", "replace"), b""
        answer = self._obey(command) if command else None
        self._regulate()
        if answer is not None:
            self._answer(answer, now)
        if command:
            needs_rest = answer is None or command == "STATUS?"
            self._ready_at = self._command_ends_at + self._rest_s if needs_rest else self._busy

    def _obey(self, command: str) -> bytes | None:
        """Carry out a command; return its answer, or None if it has none."""
        queries = {
            "VSET1?": lambda: f"{self.set_volts:05.2f}".encode("ascii"),
            "ISET1?": lambda: f"{self.set_amperes:.3f}".encode("ascii") + self._stray,
            "VOUT1?": lambda: f"{self.volts:05.2f}".encode("ascii"),
            "IOUT1?": lambda: f"{self.amperes:.3f}".encode("ascii"),
            "STATUS?": lambda: bytes([self._status()]),
            "*IDN?": lambda: self._identity,
        }
        if command in queries:
            return queries[command]()
        self._change_setting(command)
        return None

    def _change_setting(self, command: str) -> None:
        """Carry out a setting; an unknown one, or a value out of range, changes nothing."""
        if command in ("OUT0", "OUT1"):
            self._switch(command == "OUT1")
        elif match := re.fullmatch(r"(OVP|OCP)([01])", command):
            self.protections[match[1]] = match[2] == "1"
        elif match := re.fullmatch(r"VSET1:([0-9]{1,2}(?:\.[0-9]{1,2})?)", command):
            self.set_volts = self._programmed(match[1], self.rating.voltage, self.set_volts)
        elif match := re.fullmatch(r"ISET1:([0-9](?:\.[0-9]{1,3})?)", command):
            self.set_amperes = self._programmed(match[1], self.rating.current, self.set_amperes)

    @staticmethod
    def _programmed(text: str, rating: float, present_level: float) -> float:
        """Return the level in a command, or the present one if it is out of range."""
        return float(text) if float(text) <= HIGHEST_LEVEL_OVER_RATING * rating else present_level

    def _status(self) -> int:
        """Return the byte that answers `STATUS?`."""
        reported_on = self.on and (self._admits or not self._stuck)
        armed = any(self.protections.values())
        return 0x40 * reported_on | 0x20 * armed | 0x10 | (not self._limited)
