"""Which request an answer belongs to: a row holds what the drive sampled in its own cycle, or nothing.

A request is whatever makes a drive answer once a cycle: CANopen's SYNC, or a question for each reading.
"""

import math
from dataclasses import dataclass

# With it, and a cycle, a lost answer empties rows for less than the 50 ms for which the supervisor lets a drive be
# silent, at any rate, so that it ends no run; what stalls for longer comes in a burst, no answer to each request.
IN_STEP_S = 0.012  # with one answer to each request, before the ones that are missing are taken for lost
WATCHED_S = 1.0  # after anything irregular, in which what has come is looked through before every request


@dataclass
class Irregular:
    """Answers that did not come as they should: one to each request, before the cycle's deadline."""

    late: int = 0  # came after their cycle
    lost: int = 0  # did not come, while later requests were answered one by one
    surplus: int = 0  # came although every request had its answer

    def __str__(self) -> str:
        return (
            f"{self.late} answers came after their cycle, {self.lost} were lost, {self.surplus} came unasked;"
            " a row holds the answer to its own cycle or none"
        )


class Answers:
    """The answers of one drive: one of each kind to every request, in the order of the requests.

    As long as each request has had its answer there is nothing to count: whatever comes next answers the next one. Once
    an answer has stayed away the drive is watched. An answer then belongs to the earliest request that has none, and a
    row takes those to its own request alone. An answer that was lost would put all later ones off for ever: where each
    request has brought one answer for `IN_STEP_S`, the ones that are missing still are lost.
    """

    def __init__(self, count: int) -> None:
        self.came = [True] * 3  # of each kind, an answer in this cycle; True for a kind that the drive does not send
        self.watched = True
        self.irregular = Irregular()
        self._owed = [0] * count  # requests without an answer, of each kind
        self._counted = [0] * count  # answers since the last request
        self._too_many = False  # answers came unasked, and not long enough one by one since
        self._unplaced = 0  # answers to an earlier request, or to their own with one before it lost
        self._in_cycle = self._begun = False
        self._watched_until = self._in_step_since = -math.inf

    def begin(self, now: float) -> None:
        """Expect an answer of each kind to the request that is about to be sent; what came before it has been taken."""
        self._begun = True
        self._judge(now)
        if now >= self._watched_until and not self._too_many and not any(self._owed):
            self.watched = False
            return
        for which in range(len(self._owed)):
            self._owed[which] += 1
            self._counted[which] = 0
        self._in_cycle = True

    def _judge(self, now: float) -> None:
        """Take answers for lost, or believe in the count again, where each request has had one for long enough."""
        if not any(self._owed):
            self.irregular.late += self._unplaced
            self._unplaced = 0
            if not self._too_many:
                return
        if any(count != 1 for count in self._counted):
            self._in_step_since = now
        elif now - self._in_step_since >= IN_STEP_S:
            self.irregular.lost += sum(self._owed)
            self._owed = [0] * len(self._owed)
            self._unplaced, self._too_many = 0, False

    def take(self, which: int, now: float) -> bool:
        """Take an answer of a watched drive; whether it is known to be the one to this cycle's request."""
        if not self._begun:  # it answers a request of somebody else
            return False
        self._counted[which] += 1
        if not self._owed[which]:
            self.irregular.surplus += 1
            self._too_many = True
            self._in_step_since, self._watched_until = now, now + WATCHED_S
            return False
        self._owed[which] -= 1
        if not self._in_cycle:
            self.irregular.late += 1
            return False
        self.came[which] = True
        if self._owed[which]:
            self._unplaced += 1
        return not self._owed[which] and not self._too_many

    def end(self, now: float) -> list[bool]:
        """End a cycle of a watched drive, or one in which an answer stayed away; tell which kinds the row may hold."""
        counts_from_now = not self.watched
        for which in range(len(self._owed)):
            if not self.came[which]:
                self.watched, self._watched_until = True, now + WATCHED_S
                self._in_step_since = now
            if counts_from_now:
                self._owed[which] = 0 if self.came[which] else 1
                self._counted[which] = 0
        self._in_cycle = False
        owed = [*self._owed, 0, 0]
        return [came and not owed[which] and not self._too_many for which, came in enumerate(self.came)]
