"""Transfers that went through when they were repeated: counted, and told at the 1st, the 10th, the 100th and so on."""


class Retries:
    """A count of transfers that had to be repeated."""

    def __init__(self) -> None:
        self.count = 0
        self._next_told = 1

    def take_note(self) -> str:
        """The count so far where it has reached the next power of ten since it was told last; else nothing."""
        if self.count < self._next_told:
            return ""
        while self._next_told <= self.count:
            self._next_told *= 10
        return f"{self.count} so far"
