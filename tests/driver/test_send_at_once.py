"""The command that removes power is sent once more over a new connection, and what fails is left to `safe_state`."""

import pytest

from leactl.driver.safe_state import send_at_once
from leactl.errors import DeviceError


class Line:
    """A connection that breaks and may be made again; notes what is done to it."""

    def __init__(self, broken, mends=True):
        self.broken, self.mends, self.done = broken, mends, []

    def send(self):
        self.done.append("send")
        if self.broken:
            raise DeviceError("the line is gone")

    def reopen(self):
        self.done.append("reopen")
        if not self.mends:
            raise DeviceError("no such port")
        self.broken = False


@pytest.mark.parametrize(
    ("line", "opened", "done"),
    [
        (Line(broken=False), True, ["send"]),
        (Line(broken=True), True, ["send", "reopen", "send"]),
        (Line(broken=True, mends=False), True, ["send", "reopen"]),
        (Line(broken=True), False, ["send"]),
    ],
)
def test_it_connects_once_more_at_the_most_and_raises_nothing(line, opened, done):
    send_at_once(line.send, line, lambda: opened)
    assert line.done == done
