"""Begin and end the faults of a bench exactly at their times, at which emulated time stops."""

import heapq
import math
from collections.abc import Callable, Sequence

import numpy as np

from leactl.emulation.faults.contract import Fault, FaultTarget


class Schedule:
    """The faults of one bench, each with its own random numbers, so that adding a fault does not change the others."""

    def __init__(self, bench: FaultTarget, faults: Sequence[Fault], seed: int) -> None:
        self._pending: list[tuple[float, int, Callable[[], None]]] = []
        self._action_count = 0
        for index, fault in enumerate(faults):
            self._add(fault.at_s, self._beginning(bench, fault, np.random.default_rng([seed, index])))
        self._pass_time(bench.time.now())
        bench.time.follow(self._pass_time)
        bench.time.stop_at(lambda: self._pending[0][0] if self._pending else math.inf)

    def _beginning(self, bench: FaultTarget, fault: Fault, draw: np.random.Generator) -> Callable[[], None]:
        """Return a function that begins the fault, and schedules its end if it has one."""

        def begin() -> None:
            end = fault.begin(bench, draw)
            if fault.ends_s < math.inf:
                self._add(fault.ends_s, end)

        return begin

    def _add(self, time: float, action: Callable[[], None]) -> None:
        """Schedule an action at a time [s]; actions of one time keep their order."""
        self._action_count += 1
        heapq.heappush(self._pending, (time, self._action_count, action))

    def _pass_time(self, now: float) -> None:
        """Run the actions that are due at a time [s]."""
        while self._pending and self._pending[0][0] <= now:
            heapq.heappop(self._pending)[2]()
