"""What confirms a prompt at a terminal, and what stops the run instead."""

import os
import pty
import sys
import time

import pytest

from leactl.errors import Stopped
from leactl.runner.operators import at_the_terminal


@pytest.fixture
def keyboard(monkeypatch):
    """Where a person types."""
    hands, terminal = pty.openpty()
    with os.fdopen(terminal, "r") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield hands
    os.close(hands)


def answered(keyboard, text):
    confirmed = at_the_terminal("Lock the shaft")
    assert not confirmed()
    os.write(keyboard, text)
    end = time.monotonic() + 2
    while time.monotonic() < end:
        if confirmed():
            return True
    return False


@pytest.mark.parametrize("text", [b"\n", b"y\n", b"Y\n"])
def test_an_empty_line_or_y_confirms(keyboard, text):
    assert answered(keyboard, text)


@pytest.mark.parametrize(
    ("text", "told"), [(b"\x04", "the end of input"), (b"no, stop!\n", "'no, stop!'"), (b"yes, but\n", "'yes, but'")]
)
def test_anything_else_stops(keyboard, text, told):
    with pytest.raises(Stopped, match=f"stopped by the operator: {told} in answer to: Lock the shaft"):
        answered(keyboard, text)


def test_what_was_typed_before_the_question_answers_nothing(keyboard):
    os.write(keyboard, b"\n\nhello\n")
    time.sleep(0.1)
    confirmed = at_the_terminal("Lock the shaft")
    time.sleep(0.1)
    assert not confirmed()
    os.write(keyboard, b"\n")
    time.sleep(0.1)
    assert confirmed()
