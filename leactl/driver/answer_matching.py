"""Match a drive's answers to requests, so that a row holds the samples of its own cycle, or none.

A request is anything that makes a drive answer once a cycle: CANopen's SYNC, or a question for each reading.
"""

import math
from dataclasses import dataclass

# Missing answers count as lost after this time with one answer to each request. A lost answer empties the rows of this
# time and one cycle; the supervisor allows at least 50 ms of silence, so that a lost answer ends no run. After a longer
# stall, answers come in a burst and not one to a request.
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
        self._unanswered = [0] * count  # by kind, requests without an answer
        self._answers_since_request = [0] * count  # by kind, answers since the last request
        self._has_surplus = False  # whether answers came unasked, and not yet one by one for `IN_STEP_S` since
        self._unplaced = 0  # answers that are late, or in time if an earlier answer was lost
        self._is_in_cycle = self._has_begun = False
        self._watched_until = self._in_step_since = -math.inf

    def begin(self, now: float) -> None:
        """Expect one answer of each kind to the next request; call it after earlier answers were taken."""
        self._has_begun = True
        self._judge(now)
        if now >= self._watched_until and not self._has_surplus and not any(self._unanswered):
            self.watched = False
            return
        for kind in range(len(self._unanswered)):
            self._unanswered[kind] += 1
            self._answers_since_request[kind] = 0
        self._is_in_cycle = True

    def _judge(self, now: float) -> None:
        """Take missing answers for lost, or trust the count again, after `IN_STEP_S` with one answer per request."""
        if not any(self._unanswered):
            self.irregular.late += self._unplaced
            self._unplaced = 0
            if not self._has_surplus:
                return
        if any(count != 1 for count in self._answers_since_request):
            self._in_step_since = now
        elif now - self._in_step_since >= IN_STEP_S:
            self.irregular.lost += sum(self._unanswered)
            self._unanswered = [0] * len(self._unanswered)
            self._unplaced, self._has_surplus = 0, False

    def take(self, kind: int, now: float) -> bool:
        """Count an answer of a watched drive; return whether it is known to answer this cycle's request."""
        if not self._has_begun:  # the answer is to a request of another program
            return False
        self._answers_since_request[kind] += 1
        if not self._unanswered[kind]:
            self.irregular.surplus += 1
            self._has_surplus = True
            self._in_step_since, self._watched_until = now, now + WATCH_S
            return False
        self._unanswered[kind] -= 1
        if not self._is_in_cycle:
            self.irregular.late += 1
            return False
        self.came[kind] = True
        if self._unanswered[kind]:
            self._unplaced += 1
        return not self._unanswered[kind] and not self._has_surplus

    def leave_out(self) -> None:
        """Count an answer that came before the kinds that precede it: it repeats an answer to an earlier request."""
        self.irregular.surplus += 1

    def end(self, now: float) -> list[bool]:
        """End a cycle of a watched drive or with a missing answer; return, by kind, whether the row may hold it."""
        was_not_watched = not self.watched
        for kind in range(len(self._unanswered)):
            if not self.came[kind]:
                self.watched, self._watched_until = True, now + WATCH_S
                self._in_step_since = now
            if was_not_watched:
                self._unanswered[kind] = 0 if self.came[kind] else 1
                self._answers_since_request[kind] = 0
        self._is_in_cycle = False
        unanswered = [*self._unanswered, 0, 0]
        return [came and not unanswered[kind] and not self._has_surplus for kind, came in enumerate(self.came)]
