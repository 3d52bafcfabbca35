"""What confirms a prompt at a terminal, what stops the run instead, and the key that stops it at any time."""

import os
import pty
import select
import sys
import termios
import time
from contextlib import nullcontext

import pytest

from leactl.errors import Stopped
from leactl.runfile.read.reader import Run
from leactl.runner import operators
from leactl.runner.operators import at_the_terminal
from tests.runner.conftest import SPIN

PERIOD = 0.01  # of `spin` [s]
PROMPTING = SPIN.replace("  - mode: {test: current}\n", "  - prompt: Lock the shaft\n  - mode: {test: current}\n")


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
    ("text", "told"),
    [
        (b"\x04", "the end of input"),
        (b"no, stop!\n", "'no, stop!'"),
        (b"yes, but\n", "'yes, but'"),
        (b" \n", "' '"),
    ],
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


# -- the stop key ------------------------------------------------------------------------------------------------------


def typing(keyboard, text):
    """An action on the bench: type, and see it arrive at the terminal."""

    def type_now(_bench):
        os.write(keyboard, text)
        assert select.select([sys.stdin], [], [], 10)[0]

    return type_now


@pytest.mark.parametrize(("text", "name"), [(b" ", "space"), (b"q", "q"), (b"xyz q\n", "space")])
def test_no_cycle_begins_after_a_stop_key(spin, keyboard, text, name):
    pressed, begun, benches = [], [], []

    def watch(_progress):
        begun.append(benches[0].clock.now())
        return nullcontext()

    def press(bench):
        typing(keyboard, text)(bench)
        pressed.append(bench.clock.now())

    with operators.keyboard(shown=True) as keys:
        outcome, bench = spin(at=[(0.0, benches.append), (0.305, press)], watch=watch, stops=[keys.pressed])
    assert (outcome.status, outcome.reason) == ("stopped", f"stopped by the operator: key {name}")
    with Run.open(outcome.path) as run:
        last = begun[0] + run.time("loop")[-1]  # start of the last cycle
    assert last <= pressed[0] <= last + PERIOD + 1e-9
    assert [bench.far_ends[name].state for name in ("drive_test", "drive_load")] == ["disabled", "disabled"]


def test_other_keys_and_what_was_typed_before_the_run_stop_nothing(spin, keyboard):
    typing(keyboard, b"q \n")(None)
    with operators.keyboard(shown=True) as keys:
        assert keys.hint == "space or q stops the run, p pauses it"
        outcome, _bench = spin(at=[(0.3, typing(keyboard, b"abc\n\x1b"))], stops=[keys.pressed])
    assert outcome.status == "complete"


@pytest.mark.parametrize("answer", [[b"\n"], [b"y\n"], [b"y", b"\n"]])
def test_a_stop_key_takes_no_answer_from_a_prompt_and_works_after_it(spin, keyboard, answer):
    def give_up(_bench):
        raise AssertionError("nobody took the answer")

    at = [(0.2 + 0.1 * number, typing(keyboard, part)) for number, part in enumerate(answer)]
    with operators.keyboard(shown=True) as keys:
        outcome, _bench = spin(
            PROMPTING, at=[*at, (0.7, typing(keyboard, b" ")), (5.0, give_up)], operator=keys.ask, stops=[keys.pressed]
        )
    with Run.open(outcome.path) as run:
        assert [event.message for event in run.events if event.source == "operator"][-1] == "confirmed"
    assert outcome.reason == "stopped by the operator: key space"


@pytest.mark.parametrize(("text", "told"), [(b" ", "' '"), (b"q", "'q'"), (b"n", "'n'")])
def test_a_single_key_stops_at_a_prompt_too(spin, keyboard, text, told):
    with operators.keyboard(shown=True) as keys:
        outcome, _bench = spin(PROMPTING, at=[(0.3, typing(keyboard, text))], operator=keys.ask, stops=[keys.pressed])
    assert outcome.reason == f"stopped by the operator: {told} in answer to: Lock the shaft"


def test_a_stop_key_just_before_a_prompt_is_not_thrown_away(keyboard):
    with operators.keyboard(shown=True) as keys:
        typing(keyboard, b" ")(None)
        with pytest.raises(Stopped, match="key space"):
            keys.ask("Lock the shaft")


def test_a_terminal_that_hangs_up_stops_nothing_by_itself(spin, monkeypatch):
    hands, terminal = pty.openpty()
    with os.fdopen(terminal, "r") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with operators.keyboard(shown=True) as keys:
            outcome, _bench = spin(at=[(0.3, lambda _bench: os.close(hands))], stops=[keys.pressed])
    assert outcome.status == "complete"


def test_the_terminal_is_given_back_whatever_ends_the_block(keyboard):
    before = termios.tcgetattr(sys.stdin)
    with pytest.raises(RuntimeError), operators.keyboard(shown=True):
        assert not termios.tcgetattr(sys.stdin)[3] & (termios.ICANON | termios.ECHO)
        assert termios.tcgetattr(sys.stdin)[3] & termios.ISIG
        raise RuntimeError
    assert termios.tcgetattr(sys.stdin) == before


def test_without_a_terminal_or_a_display_no_key_is_taken(keyboard, monkeypatch, tmp_path):
    before = termios.tcgetattr(sys.stdin)
    with operators.keyboard(shown=False) as keys:
        assert (keys.hint, termios.tcgetattr(sys.stdin)) == ("", before)
        typing(keyboard, b"q\n")(None)
        assert keys.pressed() == ""
    (tmp_path / "keys").write_text("q\n")
    with (tmp_path / "keys").open() as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with operators.keyboard(shown=True) as keys:
            assert (keys.hint, keys.pressed()) == ("", "")
        assert stdin.read() == "q\n"
    monkeypatch.setattr(sys, "stdin", None)
    with operators.keyboard(shown=True) as keys:
        assert keys.hint == ""


def test_what_answers_a_prompt_is_left_to_it_whoever_looks_first(keyboard):
    with operators.keyboard(shown=True) as keys:
        confirmed = keys.ask("Lock the shaft")
        typing(keyboard, b"y\n")(None)
        assert keys.pressed() == ""
        assert confirmed()
        typing(keyboard, b"q")(None)
        assert keys.pressed() == "stopped by the operator: key q"
