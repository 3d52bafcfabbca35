"""Two ways of doing the same, timed in turn, so that whatever else the machine does meets both alike."""

import gc
import statistics
import time
from collections.abc import Callable
from typing import NamedTuple


class Comparison(NamedTuple):
    """Medians over the rounds; the ratio is the median of the rounds' own ratios."""

    ratio: float
    subject_s: float
    peer_s: float

    def __format__(self, spec: str) -> str:
        scale, unit = (1e6, "us") if spec == "us" else (1e3, "ms")
        return f"{self.ratio:.2f} ({self.subject_s * scale:.3g} {unit} beside {self.peer_s * scale:.3g} {unit})"


def compare(
    subject: Callable[[], object],
    peer: Callable[[], object],
    *,
    rounds: int = 15,
    each: int = 1,
    timer: Callable[[], float] = time.process_time,
    before: Callable[[], object] = lambda: None,
    after: Callable[[], object] = lambda: None,
) -> Comparison:
    """Time subject and peer in turn, who is first changing with each round; `each` is how often either does its work.

    CPU time by default: it does not count what other processes take. `before` and `after` stand around each round,
    untimed.
    """
    result = []
    for number in range(rounds + 1):
        before()
        gc.collect()
        if number % 2:
            first = _timed(subject, timer)
            result.append((first, _timed(peer, timer)))
        else:
            first = _timed(peer, timer)
            result.append((_timed(subject, timer), first))
        after()
    result = result[1:]  # the first round loads what is loaded once
    ratios, own, others = zip(*((a / b, a / each, b / each) for a, b in result), strict=True)
    return Comparison(statistics.median(ratios), statistics.median(own), statistics.median(others))


def _timed(work: Callable[[], object], timer: Callable[[], float]) -> float:
    began = timer()
    work()
    return timer() - began
