"""Conversations over a line that says nothing, or says it in pieces."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.driver.conversation import Query, Talk, Unreadable
from leactl.driver.serial_port import SerialPort
from leactl.emulation.clock import EmulatedClock
from leactl.errors import NoAnswer


class Silent:
    """A line on which these pieces come, one a look, and nothing after."""

    def __init__(self, clock, *pieces):
        self.clock, self.pieces, self.looks, self.said = clock, list(pieces), 0, b""

    def read(self, timeout):
        self.looks += 1
        assert self.looks < 1000, "it looks again and again while no time passes"
        self.clock.sleep_until(self.clock.now() + timeout)
        return self.pieces.pop(0) if self.pieces else b""

    def write(self, data):
        self.said += data
        return len(data)


def asked(question):
    answer = yield question
    return answer.value


def port(line, clock, end=b"\n"):
    made = SerialPort(lambda: line, clock)
    made.line_end = end
    made.open()
    return made


@given(st.floats(0, 1e5), st.sampled_from([0.3, 0.1, 0.05]))
def test_no_answer_is_told_at_its_time_whatever_the_clock_says(now, answer_s):
    clock = EmulatedClock()
    clock.sleep_until(now)
    talk = Talk(port(Silent(clock), clock), asked(Query("GETD", bytes)), answer_s)
    with pytest.raises(NoAnswer, match="no answer to GETD"):
        talk.finish(now + 10.0)
    assert clock.now() == pytest.approx(now + answer_s)


def test_an_answer_of_several_lines_ends_with_its_last():
    clock = EmulatedClock()
    line = Silent(clock, b"01", b"0120\rO", b"K\rrest")
    question = Query("GETS", bytes, last=b"OK")
    assert Talk(port(line, clock, b"\r"), asked(question), 0.3).finish(1.0) == b"010120\nOK"
    assert line.said == b"GETS\r"


def refusing(answer):
    if answer != b"mine":
        raise Unreadable(f"{answer!r}")
    return answer


@pytest.mark.parametrize(("patient", "outcome"), [(True, b"mine"), (False, None)])
def test_only_a_patient_question_lets_other_answers_go_by(patient, outcome):
    clock = EmulatedClock()
    talk = Talk(port(Silent(clock, b"other\nmine\n"), clock), asked(Query("?", refusing, patient)), 0.3)
    if patient:
        assert talk.finish(1.0) == outcome
        return
    with pytest.raises(Unreadable, match=r"\? was answered by b'other'"):
        talk.finish(1.0)


class Paced:
    """A device that notes when it is written to, and answers each query by pieces at times [s] after it."""

    def __init__(self, clock, *pieces):
        self.clock, self.pieces, self.said, self.coming = clock, pieces, [], []

    def read(self, timeout):
        until = self.clock.now() + timeout
        moment = min(self.coming[0][0], until) if self.coming else until
        self.clock.sleep_until(moment)
        return self.coming.pop(0)[1] if self.coming and self.coming[0][0] <= moment else b""

    def write(self, data):
        self.said.append((data, self.clock.now()))
        if data.endswith(b"?"):
            self.coming += [(self.clock.now() + later, piece) for later, piece in self.pieces]
        return len(data)


def three_commands():
    yield "A"
    yield b"B"
    answer = yield Query("C?", bytes, silence_s=0.03)
    return answer


@pytest.mark.parametrize("in_steps", [True, False], ids=["step by step", "to its end"])
def test_a_script_keeps_the_rest_that_the_device_needs(in_steps):
    clock = EmulatedClock()
    line = Paced(clock, (0.02, b"yes"))
    at = port(line, clock, b"")
    at.rest_s = 0.05
    at.write(b"earlier")  # does not wait itself
    at.write(b"at once")
    talk = Talk(at, three_commands(), 0.3)
    while in_steps and not talk.ended:
        before = clock.now()
        talk.step()
        assert clock.now() == before
        clock.sleep_until(before + 0.01)
    reply = talk.finish(1.0)
    assert [data for data, _ in line.said] == [b"earlier", b"at once", b"A", b"B", b"C?"]
    assert [moment for _, moment in line.said] == pytest.approx([0.0, 0.0, 0.05, 0.1, 0.15], abs=0.011)
    assert all(later - earlier >= 0.05 - 1e-9 for (_, earlier), (_, later) in pairwise(line.said[1:]))
    assert (reply.value, reply.asked) == (b"yes", line.said[-1][1])


@pytest.mark.parametrize(
    ("pieces", "heard"),
    [
        ([(0.02, b"12.34")], b"12.34"),
        ([(0.02, b"1"), (0.04, b"2"), (0.06, b".34")], b"12.34"),
        ([(0.02, b"12."), (0.1, b"34")], b"12."),
        ([(0.02, b"12.34"), (0.03, b"00.00")], b"12.3400.00"),
        ([(0.02, b"\x00")], b"\x00"),
    ],
)
def test_an_answer_may_end_by_silence(pieces, heard):
    clock = EmulatedClock()
    line = Paced(clock, *pieces)
    at = port(line, clock, b"")
    line.coming.append((0.0, b"left of an earlier answer"))

    def script():
        return (yield Query("V?", bytes, silence_s=0.03))

    reply = Talk(at, script(), 0.3).finish(1.0)
    assert reply.value == heard
    assert reply.seen <= clock.now() - 0.03 + 1e-9  # its last byte, and not the end of the silence


def test_a_query_whose_answer_never_ends_has_none():
    clock = EmulatedClock()
    line = Paced(clock, *[(0.02 * k, b"1") for k in range(1, 50)])
    with pytest.raises(NoAnswer, match=r"no answer to V\? within 0.3 s"):
        Talk(port(line, clock, b""), asked(Query("V?", bytes, silence_s=0.03)), 0.3).finish(2.0)
