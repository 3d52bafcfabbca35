"""Conversations over a line that says nothing, or says it in pieces."""

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
