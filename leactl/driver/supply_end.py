"""The far end of a supply with one output on a serial line: the output, its faults, and answers at their times."""

import math
from collections import deque

from leactl.driver.far_end import SupplyLoad

REGULATE_S = 0.05  # time between two regulations; the load's resistance changes within seconds


class SupplyEnd:
    """One output that feeds a load; an emulator adds what its instrument understands and answers."""

    def __init__(self, load: SupplyLoad, answer_s: float, set_volts: float = 0.0) -> None:
        """`answer_s`: time for each answer [s]; `set_volts`: voltage that is set at first."""
        self._load, self._answer_s = load, answer_s
        self.set_volts, self.set_amperes = set_volts, 0.0
        self.on = False
        self.volts = self.amperes = 0.0  # at the terminals
        self._stuck, self._admits, self._share = False, True, 1.0
        self._input = b""
        self._output: deque[tuple[float, bytes]] = deque()
        self._busy = 0.0
        self._regulates = 0.0
        self._regulate()

    # -- faults that a bench may inject ------------------------------------------------------------------------------

    def stuck_on(self, admits: bool = True) -> None:
        """Make the output stay on, as with a welded relay; `admits` says whether it is reported as on."""
        self._stuck, self._admits = True, admits

    def lose_regulation(self, share: float) -> None:
        """Put out only this share of the set voltage and current."""
        self._share = share
        self._regulate()

    def mend(self) -> None:
        """Return to normal operation."""
        self._stuck, self._share = False, 1.0
        self._regulate()

    # -- the wire ----------------------------------------------------------------------------------------------------

    @property
    def due(self) -> float:
        """Time of the next answer or the next regulation [s]."""
        return min(self._output[0][0] if self._output else math.inf, self._regulates)

    def tick(self, now: float) -> bytes:
        """Regulate the output if that is due; returns an answer that is ready."""
        if now >= self._regulates:
            self._regulates = now + REGULATE_S
            self._regulate()
        if self._output and now >= self._output[0][0]:
            return self._output.popleft()[1]
        return b""

    def _answer(self, answer: bytes, now: float) -> None:
        """Send this `answer_s` after now, or after the answer before it."""
        self._busy = max(self._busy, now) + self._answer_s
        self._output.append((self._busy, answer))

    # -- the output --------------------------------------------------------------------------------------------------

    @property
    def _limited(self) -> bool:
        """Whether the current is regulated, and not the voltage."""
        return self.on and self.volts < self.set_volts * self._share - 1e-6

    def _switch(self, on: bool) -> None:
        self.on = on or (self._stuck and self.on)

    def _regulate(self) -> None:
        asked = (self.set_volts * self._share, self.set_amperes * self._share) if self.on else (0.0, 0.0)
        self.volts, self.amperes = self._load.feed(*asked)
