"""Emulate a supply with one output on a serial line: the output, its faults, and answers at their times."""

import math
from collections import deque

from leactl.driver.far_end import SupplyLoad

REGULATION_INTERVAL_S = 0.05  # time between two regulations; the load's resistance changes within seconds


class SupplyEnd:
    """One output that feeds a load; an emulator adds the commands and answers of its instrument."""

    def __init__(self, load: SupplyLoad, answer_s: float, set_volts: float = 0.0) -> None:
        """`answer_s` is the time that each answer takes; `set_volts` is the voltage that is set at first."""
        self._load, self._answer_s = load, answer_s
        self.set_volts, self.set_amperes = set_volts, 0.0
        self.on = False
        self.volts = self.amperes = 0.0  # at the terminals
        self._stuck, self._admits, self._regulated_share = False, True, 1.0
        self._input = b""
        self._output: deque[tuple[float, bytes]] = deque()
        self._busy = 0.0
        self._next_regulation = 0.0
        self._regulate()

    # -- faults that a bench may inject ------------------------------------------------------------------------------

    def stuck_on(self, admits: bool = True) -> None:
        """Make the output stay on, as with a welded relay; `admits` tells whether it is reported as on."""
        self._stuck, self._admits = True, admits

    def lose_regulation(self, share: float) -> None:
        """Put out this share of the set voltage and current from now on."""
        self._regulated_share = share
        self._regulate()

    def mend(self) -> None:
        """Return to normal operation."""
        self._stuck, self._regulated_share = False, 1.0
        self._regulate()

    # -- the wire ----------------------------------------------------------------------------------------------------

    @property
    def due(self) -> float:
        """Time of the next answer or the next regulation [s]."""
        return min(self._output[0][0] if self._output else math.inf, self._next_regulation)

    def tick(self, now: float) -> bytes:
        """Regulate the output if that is due; return an answer that is ready, or no bytes."""
        if now >= self._next_regulation:
            self._next_regulation = now + REGULATION_INTERVAL_S
            self._regulate()
        if self._output and now >= self._output[0][0]:
            return self._output.popleft()[1]
        return b""

    def _answer(self, answer: bytes, now: float) -> None:
        """Send an answer `answer_s` after now [s], or after the previous answer if that is later."""
        self._busy = max(self._busy, now) + self._answer_s
        self._output.append((self._busy, answer))

    # -- the output --------------------------------------------------------------------------------------------------

    @property
    def _limited(self) -> bool:
        """Whether the current is regulated, and not the voltage."""
        return self.on and self.volts < self.set_volts * self._regulated_share - 1e-6

    def _switch(self, on: bool) -> None:
        """Switch the output on or off; an output that is stuck stays on."""
        self.on = on or (self._stuck and self.on)

    def _regulate(self) -> None:
        """Update voltage and current at the terminals by the load and the set levels."""
        limits = (
            (self.set_volts * self._regulated_share, self.set_amperes * self._regulated_share)
            if self.on
            else (0.0, 0.0)
        )
        self.volts, self.amperes = self._load.feed(*limits)
