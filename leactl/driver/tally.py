"""Count occasional events of a bus, and report when the count has reached or passed a power of ten."""


class Tally:
    """A count of events, such as transfers that had to be repeated."""

    def __init__(self) -> None:
        self.count = 0
        self._next_reported = 1

    def take_note(self) -> str:
        """Return the count as text if it reached the next power of ten since the last report; else an empty text."""
        if self.count < self._next_reported:
            return ""
        while self._next_reported <= self.count:
            self._next_reported *= 10
        return f"{self.count} so far"
