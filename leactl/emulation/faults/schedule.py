"""Begin and end the faults of a bench exactly at their times; emulated time stops at each of them."""

import heapq
import math
from collections.abc import Callable, Sequence

import numpy as np

from leactl.emulation.faults.contract import Fault, FaultTarget


class Schedule:
    """The faults of one bench, each with its own random numbers, so that adding a fault does not change the others."""

    def __init__(self, bench: FaultTarget, faults: Sequence[Fault], seed: int) -> None:
        self._pending: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0
        for index, fault in enumerate(faults):
            self._at(fault.at_s, self._beginning(bench, fault, np.random.default_rng([seed, index])))
        self._pass_time(bench.time.now())
        bench.time.follow(self._pass_time)
        bench.time.stop_at(lambda: self._pending[0][0] if self._pending else math.inf)

    def _beginning(self, bench: FaultTarget, fault: Fault, draw: np.random.Generator) -> Callable[[], None]:
        def begin() -> None:
            end = fault.begin(bench, draw)
            if fault.ends_s < math.inf:
                self._at(fault.ends_s, end)

        return begin

    def _at(self, moment: float, action: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._pending, (moment, self._count, action))

    def _pass_time(self, now: float) -> None:
        while self._pending and self._pending[0][0] <= now:
            heapq.heappop(self._pending)[2]()
