"""Match a drive's answers to requests, so that a row holds the samples of its own cycle, or none.

A request is anything that makes a drive answer once a cycle: CANopen's SYNC, or a question for each reading.
"""

import math
from dataclasses import dataclass

# Missing answers count as lost after this time with one answer to each request. A lost answer empties the rows of this
# time and one cycle; the supervisor allows 50 ms of silence at any rate, so that a lost answer ends no run. After a
# longer stall, answers come in a burst and not one to a request.
IN_STEP_S = 0.012
WATCH_S = 1.0  # time after an irregular answer in which answers are counted before every request


@dataclass
class IrregularAnswers:
    """Counts of answers that were not one to each request before the cycle's deadline."""

    late: int = 0  # arrived after their cycle
    lost: int = 0  # never arrived, while later requests were answered one by one
    surplus: int = 0  # arrived although every request had its answer

    def __str__(self) -> str:
        return (
            f"{self.late} answers came after their cycle, {self.lost} were lost, {self.surplus} came unasked;"
            " a row holds none that is known to be of another cycle"
        )


class Answers:
    """The answers of one drive: one of each kind to every request, in the order of the requests.

    While every request has its answer, nothing is counted: the next answer belongs to the next request. Once an answer
    is missing, the drive is watched: an answer then belongs to the earliest request without one, and a row takes only
    answers to its own request. A lost answer would shift all later ones for ever; therefore, once each request has
    brought one answer for `IN_STEP_S`, answers that are still missing are taken for lost.

    The kinds of answers to one request come in a fixed order. By it, a frame that comes twice is noticed even if the
    drive is not watched: the last kind then comes before the other kinds of its request.
    """

    def __init__(self, count: int) -> None:
        self.came = [True] * 3  # by kind, whether an answer came in this cycle; True for a kind that is not sent
        self.watched = True
        self.irregular = IrregularAnswers()
        self._owed = [0] * count  # by kind, requests without an answer
        self._counted = [0] * count  # by kind, answers since the last request
        self._too_many = False  # whether answers came unasked, and not yet one by one for `IN_STEP_S` since
        self._unplaced = 0  # answers that are late, or in time if an earlier answer was lost
        self._in_cycle = self._begun = False
        self._watched_until = self._in_step_since = -math.inf

    def begin(self, now: float) -> None:
        """Expect one answer of each kind to the next request; call it after earlier answers were taken."""
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
        """Take missing answers for lost, or trust the count again, after `IN_STEP_S` with one answer per request."""
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
        """Count an answer of a watched drive; True if it is known to answer this cycle's request."""
        if not self._begun:  # the answer is to a request of another program
            return False
        self._counted[which] += 1
        if not self._owed[which]:
            self.irregular.surplus += 1
            self._too_many = True
            self._in_step_since, self._watched_until = now, now + WATCH_S
            return False
        self._owed[which] -= 1
        if not self._in_cycle:
            self.irregular.late += 1
            return False
        self.came[which] = True
        if self._owed[which]:
            self._unplaced += 1
        return not self._owed[which] and not self._too_many

    def leave_out(self) -> None:
        """Count an answer that came before the kinds that precede it: it repeats an answer to an earlier request."""
        self.irregular.surplus += 1

    def end(self, now: float) -> list[bool]:
        """End a cycle of a watched drive or with a missing answer; returns, by kind, whether the row may hold it."""
        counts_from_now = not self.watched
        for which in range(len(self._owed)):
            if not self.came[which]:
                self.watched, self._watched_until = True, now + WATCH_S
                self._in_step_since = now
            if counts_from_now:
                self._owed[which] = 0 if self.came[which] else 1
                self._counted[which] = 0
        self._in_cycle = False
        owed = [*self._owed, 0, 0]
        return [came and not owed[which] and not self._too_many for which, came in enumerate(self.came)]
