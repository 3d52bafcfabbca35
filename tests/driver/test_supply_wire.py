"""The supply's driver against its far end: bytes, refusals, answers that go wrong, and an output that goes off."""

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from leactl_plugins.scpi_supply import replies
from leactl_plugins.scpi_supply.dialects import DIALECTS
from leactl_plugins.scpi_supply.settings import ScpiSupplySettings
from pydantic import ValidationError

from leactl.driver.contract import PowerSupply, ProtectedSupply
from leactl.driver.conversation import Unreadable
from leactl.driver.serial_port import LONGEST_LINE, SerialPort
from leactl.emulation.clock import EmulatedClock
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer

from .failing import FailingSupplyEnd
from .supply_bench import HEATED, SupplyBench
from .transports import SERIAL

E36XX = [
    (b"\x03", b""),
    (b"SYST:REM", b""),
    (b"OUTP OFF", b""),
    (b"*IDN?", b"HEWLETT-PACKARD,E3633A,0,1.7-5.0-1.0\r"),
    (b"OUTP?", b"0\r"),
    (b"MEAS:CURR?", b"+0.00000000E+00\r"),
    (b"SYST:ERR?", b'+0,"No error"\r'),
    (b"VOLT 0.0000", b""),
    (b"VOLT?", b"+0.00000000E+00\r"),
    (b"CURR 0.0000", b""),
    (b"CURR?", b"+0.00000000E+00\r"),
    (b"VOLT:PROT?", b"+2.20000000E+01\r"),
    (b"VOLT:PROT:STAT?", b"1\r"),
    (b"CURR:PROT?", b"+2.20000000E+01\r"),
    (b"CURR:PROT:STAT?", b"1\r"),
    (b"VOLT:PROT 8.0000", b""),
    (b"VOLT:PROT?", b"+8.00000000E+00\r"),
    (b"VOLT:PROT:STAT ON", b""),
    (b"VOLT:PROT:STAT?", b"1\r"),
    (b"VOLT:PROT:TRIP?", b"0\r"),
    (b"CURR:PROT 10.0000", b""),
    (b"CURR:PROT?", b"+1.00000000E+01\r"),
    (b"CURR:PROT:STAT ON", b""),
    (b"CURR:PROT:STAT?", b"1\r"),
    (b"CURR:PROT:TRIP?", b"0\r"),
    (b"SYST:ERR?", b'+0,"No error"\r'),
]
DP800 = [
    (b"", b""),
    (b"SYST:REM", b""),
    (b"OUTP OFF", b""),
    (b"*IDN?", b"RIGOL TECHNOLOGIES,DP811,DP8C1,00.01.16"),
    (b"OUTP?", b"OFF"),
    (b"MEAS:CURR?", b"0.0000"),
    (b"SYST:ERR?", b'0,"No error"'),
    (b"VOLT 0.0000", b""),
    (b"VOLT?", b"0.0000"),
    (b"CURR 0.0000", b""),
    (b"CURR?", b"0.0000"),
    (b"OUTP:OVP:VAL?", b"66.0000"),
    (b"OUTP:OVP?", b"ON"),
    (b"OUTP:OCP:VAL?", b"66.0000"),
    (b"OUTP:OCP?", b"ON"),
    (b"OUTP:OVP:VAL 8.0000", b""),
    (b"OUTP:OVP:VAL?", b"8.0000"),
    (b"OUTP:OVP ON", b""),
    (b"OUTP:OVP?", b"ON"),
    (b"OUTP:OVP:QUES?", b"NO"),
    (b"OUTP:OCP:VAL 10.0000", b""),
    (b"OUTP:OCP:VAL?", b"10.0000"),
    (b"OUTP:OCP ON", b""),
    (b"OUTP:OCP?", b"ON"),
    (b"OUTP:OCP:QUES?", b"NO"),
    (b"SYST:ERR?", b'0,"No error"'),
]
RIGOL = {"dialect": "dp800", "model": "DP811", "serial_number": "DP8C1"}
on_a_socket_too = pytest.mark.parametrize("make_supply", [*SERIAL, "tcp"], indirect=True)


@pytest.fixture
def bench(make_supply):
    return make_supply()


IDENTITY = b"HEWLETT-PACKARD,E3633A,0,1.7-5.0-1.0\r\n"


@pytest.fixture
def here():
    """A bench in this process: its time is emulated, and its line fails on request."""
    return SupplyBench()


# -- opening ---------------------------------------------------------------------------------------------------------


@on_a_socket_too
@pytest.mark.parametrize(("own", "exchanges"), [({}, E36XX), (RIGOL, DP800)], ids=["e36xx", "dp800"])
def test_opening_makes_off_and_arms_the_protections_and_reads_each_back(make_supply, own, exchanges):
    bench = make_supply(**own)
    bench.supply.open()
    assert bench.lines() == [sent for sent, _ in exchanges]
    assert bytes(bench.heard).split(b"\n") == [*(answer for _, answer in exchanges if answer), b""]


def test_an_output_that_was_left_on_is_off_after_opening(bench):
    bench.far.leave_on(6.0, 5.0)
    bench.far.note_error(-113, "Undefined header")
    bench.supply.open()
    assert bench.far.output() == [False, 0.0, 0.0]
    assert bench.far.levels() == [0.0, 0.0, 8.0, 10.0]
    assert bench.supply.notices() == ["had an error from before: -113, Undefined header"]


@pytest.mark.parametrize(
    ("other", "complaint"),
    [
        ({"model": "E3634A"}, "supply: HEWLETT-PACKARD E3633A answers; E3634A was expected"),
        ({"serial_number": "MY5"}, "supply: serial number 0 answers; MY5 was expected"),
    ],
)
def test_another_instrument_is_refused(here, other, complaint):
    here.expect(**other)
    with pytest.raises(DeviceError) as refused:
        here.supply.open()
    assert str(refused.value) == complaint


@pytest.mark.parametrize(
    ("fault", "kind", "complaint"),
    [
        (("ignore", "VOLT:PROT 8"), DeviceError, "supply: VOLT:PROT holds 22 after 8 was written"),
        (("ignore", "VOLT 0"), DeviceError, "supply: VOLT holds 6 after 0 was written"),
        (("trip",), DeviceFault, "over-voltage protection has tripped; find out why, then clear it at the instrument"),
        (("stuck_on",), DeviceFault, "supply: the output is still on"),
        (("stuck_on", False), DeviceFault, "supply: the instrument reports its output off, but 5.000 A flow"),
        (("freeze",), NoAnswer, "supply: no answer to *IDN?"),
    ],
)
def test_a_supply_that_is_not_as_it_was_told_to_be_is_refused(here, fault, kind, complaint):
    here.far.leave_on(6.0, 5.0)
    getattr(here.far, fault[0])(*fault[1:])
    with pytest.raises(kind) as refused:
        here.supply.open()
    assert complaint in str(refused.value)


def test_a_level_beyond_the_instrument_s_range_is_refused_by_its_error(here):
    here.expect(output_range="high", voltage_limit_V=21.0)
    here.far.ignore("VOLT:RANG")
    here.far.ignore("VOLT:PROT 21")
    with pytest.raises(DeviceError, match="VOLT:PROT holds 22 after 21"):
        here.supply.open()


def test_output_range_is_chosen_where_there_are_two(here):
    here.expect(output_range="high", current_limit_A=15.0)
    here.supply.open()
    assert b"VOLT:RANG HIGH" in here.lines()
    here.supply.supply(5.0, 12.0)  # 20 V range: 10 A
    with pytest.raises(DeviceError, match="supply: CURR holds 0 after 12 was written"):
        here.until(lambda _: False)


# -- commands --------------------------------------------------------------------------------------------------------


@on_a_socket_too
def test_levels_then_on_each_read_back(bench):
    bench.supply.open()
    bench.lines()
    bench.supply.supply(7.5, 9.0)
    bench.supply.switch_on()
    assert not bench.supply.supplying
    bench.until(lambda _: bench.supply.supplying)
    expected = [b"*IDN?", b"CURR 9.0000", b"CURR?", b"VOLT 7.5000", b"VOLT?", b"OUTP ON", b"OUTP?"]
    assert bench.lines()[:7] == expected
    assert bench.far.output() == [True, pytest.approx(5.4), 9.0]
    assert isinstance(bench.supply, PowerSupply)


@pytest.mark.parametrize("levels", [(8.1, 1.0), (1.0, 10.1), (-0.1, 1.0), (1.0, math.nan), (math.inf, 1.0)])
def test_levels_beyond_the_protections_go_nowhere(bench, levels):
    bench.supply.open()
    bench.rows()
    bench.lines()
    with pytest.raises(InputError, match=r"supply: .* asked of a supply that is good for 0 to"):
        bench.supply.supply(*levels)
    bench.rows()
    assert not any(line.startswith((b"VOLT ", b"CURR ")) for line in bench.lines())


def test_off_is_sent_at_once_in_the_middle_of_a_question_and_then_confirmed(bench):
    bench.energise()
    bench.until(lambda _: bench.said)
    bench.lines()
    bench.supply.switch_off()
    assert bench.lines() == [b"\x03", b"SYST:REM", b"OUTP OFF"]
    bench.until(lambda _: not bench.supply.supplying)
    assert bench.lines()[:3] == [b"*IDN?", b"OUTP OFF", b"OUTP?"]
    assert bench.far.output() == [False, 0.0, 0.0]
    assert bench.rows()[0].fault == ""


def test_an_output_that_does_not_go_on_is_a_fault(bench):
    bench.supply.open()
    bench.far.ignore("OUTP ON")
    bench.supply.switch_on()
    with pytest.raises(DeviceFault, match="supply: the output does not switch on"):
        bench.until(lambda _: False)


# -- protections -----------------------------------------------------------------------------------------------------


def test_protections_are_put_back_as_they_were_found(bench):
    bench.far.protect_itself(12.0, False, 15.0, True)
    bench.supply.open()
    assert bench.far.levels()[2:] == [8.0, 10.0]
    assert bench.far.armed() == [True, True]
    bench.lines()
    bench.supply.close()
    assert bench.lines() == [
        b"*IDN?",
        b"VOLT:PROT 12.0000",
        b"VOLT:PROT?",
        b"VOLT:PROT:STAT OFF",
        b"VOLT:PROT:STAT?",
        b"CURR:PROT 15.0000",
        b"CURR:PROT?",
        b"CURR:PROT:STAT ON",
        b"CURR:PROT:STAT?",
        b"SYST:LOC",
    ]
    assert bench.far.levels()[2:] == [12.0, 15.0]
    assert bench.far.armed() == [False, True]


def test_protections_are_put_back_behind_an_output_that_was_on_and_is_off(bench):
    bench.energise()
    assert bench.made_safe().safe
    bench.supply.close()
    assert bench.far.levels()[2:] == [22.0, 22.0]


def test_protections_stay_where_the_output_may_be_on(here):
    here.energise()
    here.far.stuck_on()
    assert not here.made_safe().safe
    here.lines()
    here.supply.close()
    assert here.lines() == []
    assert here.far.levels()[2:] == [8.0, 10.0]


@pytest.mark.parametrize(
    "spoilt",
    [[None], [None, None], [IDENTITY.hex(), None], [(2 * IDENTITY).hex()]],
    ids=["lost", "lost twice", "lost halfway", "doubled"],
)
def test_protections_are_put_back_though_answers_are_lost_or_one_too_many(here, spoilt):
    here.energise()
    assert here.made_safe().safe
    here.far.spoil(*spoilt)
    here.supply.close()
    assert here.far.levels()[2:] == [22.0, 22.0]
    assert not here.port.connected


def test_protections_are_put_back_over_a_new_connection(here):
    here.supply.open()
    here.dead_connections = here.connections
    here.supply.close()
    assert here.connections == 2
    assert here.far.levels()[2:] == [22.0, 22.0]


def test_protections_of_another_instrument_that_answers_now_are_left(here):
    here.supply.open()
    here.said.clear()
    here.far.spoil(*[IDENTITY.replace(b"E3633A", b"E3634A").hex()] * 3)
    with pytest.raises(DeviceError, match="HEWLETT-PACKARD E3634A answers; E3633A was expected"):
        here.supply.close()
    assert set(here.lines()) == {b"*IDN?"}


def test_an_instrument_that_answers_nothing_holds_closing_up_for_three_answers(here):
    here.supply.open()
    here.far.freeze()
    began = here.clock.now()
    with pytest.raises(NoAnswer, match="not put back as they were found: no answer to"):
        here.supply.close()
    assert here.clock.now() - began == pytest.approx(3 * here.settings.answer_s)


def test_a_protection_that_is_not_put_back_is_told_and_the_line_let_go(here):
    here.supply.open()
    here.far.ignore("VOLT:PROT 22")
    with pytest.raises(DeviceError, match="not put back as they were found: VOLT:PROT holds 8 after 22 was written"):
        here.supply.close()
    assert not here.port.connected


@pytest.mark.parametrize(
    ("armed", "complaint"),
    [
        (
            (5.0, True, 22.0, True),
            "over-voltage protection is armed at 5, below voltage_limit_V of 8, and is not loosened",
        ),
        ((22.0, True, 9.5, True), "over-current protection is armed at 9.5, below current_limit_A of 10, and is not"),
    ],
)
def test_a_protection_that_somebody_armed_closer_is_not_loosened(here, armed, complaint):
    here.far.leave_on(6.0, 5.0)
    here.far.protect_itself(*armed)
    with pytest.raises(DeviceError) as refused:
        here.supply.open()
    assert complaint in str(refused.value)
    assert here.far.output() == [False, 0.0, 0.0]
    here.supply.close()
    assert here.far.levels()[2:] == [armed[0], armed[2]]


def test_a_protection_that_somebody_switched_off_is_taken_over_whatever_its_level(here):
    here.far.protect_itself(5.0, False, 3.0, False)
    here.supply.open()
    assert here.far.levels()[2:] == [8.0, 10.0]
    assert here.far.armed() == [True, True]


def test_a_protection_of_its_own_is_raised_before_a_larger_current_and_lowered_after_a_smaller_one(bench):
    bench.supply.open()
    assert isinstance(bench.supply, ProtectedSupply)
    bench.lines()
    armed = [b"VOLT:PROT?", b"VOLT:PROT:STAT ON", b"VOLT:PROT:STAT?", b"VOLT:PROT:TRIP?"]
    bench.supply.protect(6.5)
    bench.supply.supply(8.0, 9.0)
    bench.rows()
    assert bench.lines()[1:8] == [b"VOLT:PROT 6.5000", *armed, b"CURR 9.0000", b"CURR?"]
    bench.supply.protect(4.0)
    bench.supply.supply(8.0, 5.0)
    bench.rows(2)
    sent = bench.lines()
    begins = sent.index(b"CURR 5.0000")
    assert sent[begins : begins + 9] == [
        b"CURR 5.0000",
        b"CURR?",
        b"VOLT 8.0000",
        b"VOLT?",
        b"VOLT:PROT 4.0000",
        *armed,
    ]


def test_a_protection_is_raised_before_a_larger_voltage_with_the_same_current(bench):
    bench.supply.open()
    bench.supply.protect(4.0)
    bench.supply.supply(3.0, 9.0)
    bench.supply.switch_on()
    bench.until(lambda _: bench.supply.supplying)
    bench.lines()
    bench.supply.protect(8.0)
    bench.supply.supply(5.0, 9.0)
    assert bench.until(lambda rows: rows and rows[-1].values[0] > 4.5)[-1].fault == ""
    levels = [line for line in bench.lines() if line.startswith((b"VOLT", b"CURR")) and b"?" not in line]
    assert levels == [b"CURR 9.0000", b"VOLT:PROT 8.0000", b"VOLT:PROT:STAT ON", b"VOLT 5.0000"]


def test_a_voltage_falls_before_the_protection_does_though_the_current_rises(bench):
    bench.energise(5.0, 9.0)
    bench.supply.protect(4.0)
    bench.supply.supply(3.0, 9.5)
    assert bench.until(lambda rows: rows and rows[-1].values[0] < 3.5)[-1].fault == ""
    levels = [line for line in bench.lines() if line.startswith((b"VOLT", b"CURR")) and b"?" not in line]
    assert levels == [b"VOLT 3.0000", b"VOLT:PROT 4.0000", b"VOLT:PROT:STAT ON", b"CURR 9.5000"]


def test_a_protection_switches_the_output_off_by_itself(bench):
    bench.energise(8.0, 9.0)  # 5.4 V
    bench.supply.protect(5.0)
    bench.supply.supply(8.0, 9.0)
    with pytest.raises(DeviceFault, match="over-voltage protection has tripped"):
        bench.until(lambda rows: rows and rows[-1].fault)
    assert bench.far.output()[1:] == [0.0, 0.0]


def test_a_protection_that_does_not_stick_is_refused(here):
    here.supply.open()
    here.far.ignore("VOLT:PROT 6")
    here.supply.protect(6.0)
    here.supply.supply(8.0, 9.0)
    with pytest.raises(DeviceError, match="supply: VOLT:PROT holds 8 after 6 was written"):
        here.until(lambda _: False)


@pytest.mark.parametrize("level", [0.0, -1.0, 8.1, math.nan, math.inf])
def test_a_protection_beyond_the_limit_goes_nowhere(here, level):
    with pytest.raises(InputError, match="above 0 and at most 8 V was expected"):
        here.supply.protect(level)


# -- readings --------------------------------------------------------------------------------------------------------


def test_a_round_is_voltage_current_and_how_the_instrument_fares(bench):
    bench.energise()
    before = bench.clock.now()
    row = bench.rows(2)[-1]  # of two rounds that end, one has begun since
    lines = bench.lines()
    first = lines.index(b"MEAS:VOLT?")
    assert lines[first : first + 7] == [
        b"MEAS:VOLT?",
        b"MEAS:CURR?",
        b"OUTP?",
        b"STAT:QUES:COND?",
        b"SYST:ERR?",
        b"VOLT:PROT:TRIP?",
        b"CURR:PROT:TRIP?",
    ]
    assert row.stream == "supply"
    assert row.values == (pytest.approx(5.4), pytest.approx(9.0))
    assert before - 1.1 <= row.time <= bench.clock.now()


@pytest.mark.parametrize(
    ("feeds", "quantities"), [("leads", ["line_voltage", "line_current"]), ("bus", ["bus_voltage", "bus_current"])]
)
def test_what_it_feeds_names_its_channels(feeds, quantities):
    (stream,) = SupplyBench(feeds=feeds).supply.streams
    assert [(channel.quantity, channel.role) for channel in stream.channels] == [(name, "test") for name in quantities]


def test_the_stamp_is_the_middle_of_asking_for_voltage_and_current(here):
    here.energise()
    here.until(lambda _: b"MEAS:VOLT?" in here.said)
    asked = here.clock.now()
    here.until(lambda _: b"OUTP?" in here.said)
    answered = here.clock.now()
    (row,) = here.rows()
    assert row.time == pytest.approx((asked + answered) / 2, abs=0.0015)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (("go_off",), "supply: the output is off by itself"),
        (("trip",), "supply: over-voltage protection has tripped"),
        (("lose_regulation", 0.5), "supply: out of regulation, condition 0"),
    ],
)
def test_what_the_supply_does_by_itself_is_a_fault_not_a_value(bench, fault, said):
    bench.energise()
    getattr(bench.far, fault[0])(*fault[1:])
    row = bench.until(lambda rows: rows and rows[-1].fault)[-1]
    assert row.fault == said
    assert all(math.isnan(value) for value in row.values)


def test_levels_that_a_person_sets_at_the_panel_are_a_fault_within_a_second(bench):
    bench.energise(8.0, 9.0)
    looked = bench.clock.now() + 1.5
    assert not any(row.fault for row in bench.until(lambda _: bench.clock.now() >= looked))
    assert bench.lines().count(b"CURR?") == 1
    bench.far.leave_on(7.0, 9.0)
    began = bench.clock.now()
    row = bench.until(lambda rows: rows and rows[-1].fault)[-1]
    assert row.fault == "supply: its levels were changed to 7.000 V and 9.000 A; 8.000 V and 9.000 A were commanded"
    assert all(math.isnan(value) for value in row.values)
    assert bench.clock.now() - began < 2.0
    bench.far.leave_on(8.0, 9.0)
    bench.until(lambda rows: rows and not rows[-1].fault)


def test_an_output_that_goes_on_by_itself_is_a_fault(bench):
    bench.supply.open()
    bench.supply.supply(5.0, 5.0)
    bench.rows()
    bench.far.leave_on(5.0, 5.0)
    assert bench.until(lambda rows: rows and rows[-1].fault)[-1].fault == "supply: the output is on by itself"


def test_errors_and_changes_of_regulation_are_noticed(bench):
    bench.energise()
    bench.far.note_error(-222, "Data out of range")
    bench.supply.supply(3.0, 9.0)
    bench.until(lambda rows: rows and rows[-1].values[0] < 3.1)
    bench.rows()
    notices = bench.supply.notices()
    assert "error -222, Data out of range" in notices
    assert "constant voltage: 3.000 V, 5.000 A" in notices


# -- answers that go wrong -------------------------------------------------------------------------------------------

GARBAGE = {
    "garbled": b"+5.4\xff0000E+00\r\n".hex(),
    "another question's": b'+0,"No error"\r\n'.hex(),
    "cut short": b"+5.40000".hex(),
    "no number": b"+9.91000000E+37\r\n".hex(),
    "empty": b"\r\n".hex(),
    "lost": None,
}


@pytest.mark.parametrize("answer", GARBAGE.values(), ids=GARBAGE)
def test_one_bad_answer_costs_a_round_and_none_is_guessed(here, answer):
    here.energise()
    here.until(lambda _: b"MEAS:VOLT?" in here.said)
    here.far.spoil(answer)
    rows = here.rows(2)
    assert all(row.values == (pytest.approx(5.4), pytest.approx(9.0)) for row in rows)
    notices = [text for text in here.supply.notices() if text.startswith("a round was lost")]
    assert len(notices) == 1


@pytest.mark.parametrize("question", [b"MEAS:VOLT?", b"MEAS:CURR?"])
@pytest.mark.parametrize(
    ("own", "answer"),
    [
        *(({}, b"+6.00000000E+00\r\n"[lost:]) for lost in range(1, 15)),
        ({}, b"+6.0000000E+00\r\n"),  # a byte lost within
        *((RIGOL, b"6.0000\n"[lost:]) for lost in range(1, 6)),
        (RIGOL, b"6.00\n"),
    ],
)
def test_an_answer_that_lost_bytes_is_no_reading(own, answer, question):
    bench = SupplyBench(**own)
    bench.energise()
    bench.until(lambda _: question in bench.said)
    bench.far.spoil(answer.hex())
    rows = bench.rows(2)
    assert all(row.values == (pytest.approx(5.4), pytest.approx(9.0)) for row in rows)
    (lost,) = [text for text in bench.supply.notices() if text.startswith("a round was lost")]
    result = f"{question.decode()} was answered by {answer.decode().rstrip()!r}"
    assert lost == f"a round was lost: {result} where a reading was expected"


@pytest.mark.parametrize(
    ("own", "question", "answer", "complaint"),
    [
        ({}, "MEAS:VOLT?", b"+2.50000000E+01\r\n", "25 where no more than 20 can be"),
        ({}, "MEAS:CURR?", b"-9.00000000E+01\r\n", "-90 where no more than 20 can be"),
        (RIGOL, "MEAS:VOLT?", b"85.4000\n", "85.4 where no more than 40 can be"),
        (RIGOL, "MEAS:CURR?", b"12.5000\n", "12.5 where no more than 10 can be"),
    ],
)
def test_more_than_the_model_can_give_is_no_reading(own, question, answer, complaint):
    bench = SupplyBench(**own)
    bench.energise()
    bench.until(lambda _: question.encode() in bench.said)
    bench.far.spoil(answer.hex())
    rows = bench.rows(2)
    assert all(row.values == (pytest.approx(5.4), pytest.approx(9.0)) for row in rows)
    assert f"a round was lost: {question} was answered by {complaint}" in bench.supply.notices()


def test_a_lost_answer_is_lived_with_on_every_transport(make_supply):
    bench = make_supply()
    bench.energise()
    bench.far.spoil(None)
    assert bench.rows()[0].values == (pytest.approx(5.4), pytest.approx(9.0))


def test_a_late_answer_is_not_taken_for_the_next_question_s(here):
    here.energise()
    here.until(lambda _: b"MEAS:VOLT?" in here.said)
    here.far.slow_down(0.35)
    here.clock.sleep_until(here.clock.now() + 0.05)  # the question has arrived
    here.far.slow_down(0.02)
    rows = here.rows(3)
    assert {(round(row.values[0], 6), round(row.values[1], 6)) for row in rows} == {(5.4, 9.0)}
    assert here.supply.notices() == ["a round was lost: no answer to MEAS:VOLT? within 0.3 s"]


def test_an_error_queue_without_end_is_told(here):
    here.supply.open()
    here.far._next_error = lambda: '-350,"Queue overflow"'
    with pytest.raises(DeviceError, match="the error queue does not end; last error -350, Queue overflow"):
        here.until(lambda _: False)


# -- the safe state --------------------------------------------------------------------------------------------------


def in_the_middle_of_a_question(bench):
    bench.energise()
    bench.until(lambda _: b"MEAS" in bench.said)


def test_off_is_asked_for_after_it_was_sent_and_the_current_measured(bench):
    bench.energise()
    bench.made_safe()
    assert bench.lines() == [b"\x03", b"SYST:REM", b"OUTP OFF", b"*IDN?", b"OUTP?", b"MEAS:CURR?"]


@pytest.mark.parametrize(
    ("admits", "detail"),
    [(True, "the output is still on"), (False, "the instrument reports its output off, but 9.000 A flow")],
)
def test_a_supply_that_does_not_switch_off_is_not_called_safe(bench, admits, detail):
    bench.energise()
    bench.far.stuck_on(admits)
    confirmed = bench.made_safe()
    assert not confirmed.safe
    assert detail in confirmed.detail
    assert bench.far.output()[2] == 9.0


@pytest.mark.parametrize("lost", range(1, 15))
def test_a_current_that_lost_bytes_makes_no_stuck_supply_safe(here, lost):
    here.energise()
    here.far.stuck_on(False)
    left = b"+9.00000000E+00\r\n"[lost:]
    here.far.spoil(b"HEWLETT-PACKARD,E3633A,0,1.7-5.0-1.0\r\n".hex(), b"0\r\n".hex(), left.hex())
    assert not here.made_safe().safe


def test_a_name_that_was_given_to_whoever_asked_before_puts_nobody_out_of_step():
    """A program that ended in the middle of a question: the answer comes when the next one has begun to listen."""
    bench = SupplyBench(**RIGOL)  # an E36xx forgets what it has not sent yet when it is switched off
    name = b"RIGOL TECHNOLOGIES,DP811,DP8C1,00.01.16\n"

    def under_way():
        bench.far._output.append((bench.clock.now() + 0.005, name))

    under_way()
    bench.energise()
    under_way()
    began = bench.clock.now()
    assert bench.made_safe().safe
    assert bench.clock.now() - began < 0.4  # at the first try


def test_another_instrument_s_word_is_not_taken(here):
    here.energise()
    here.far.model = "34401A"
    confirmed = here.made_safe()
    assert not confirmed.safe
    assert "HEWLETT-PACKARD 34401A answers; E3633A was expected" in confirmed.detail


@settings(max_examples=40)
@given(st.lists(st.sampled_from(["0", "1", "+0.00000000E+00", "", None, "\xff"]), max_size=6), st.booleans())
def test_stale_and_spoilt_answers_never_make_a_stuck_supply_safe(spoilt, asking):
    bench = SupplyBench()
    bench.energise()
    if asking:
        in_the_middle_of_a_question(bench)
    bench.far.stuck_on()
    for text in spoilt:  # answers to earlier questions that are still on their way
        bench.far._output.append((bench.clock.now(), b"" if text is None else text.encode("latin1") + b"\r\n"))
    assert not bench.supply.safe_state(1.0).safe


@given(st.lists(st.one_of(st.binary(max_size=20), st.sampled_from([b"\n", b"OUTP", b"VOLT 3", b";", b"\x03", b"?"]))))
def test_nothing_but_output_on_switches_the_far_end_on(chunks):
    far = FailingSupplyEnd()
    for step, chunk in enumerate(chunks):
        far.receive(chunk, 0.1 * step)
        far.tick(0.1 * step)
    assert not far.fed.on or b"OUTP" in b"".join(chunks).upper()


# -- the parser and the port -----------------------------------------------------------------------------------------


@given(st.binary(max_size=40))
def test_an_answer_is_read_or_refused_never_anything_else(line):
    for read in (
        replies.parse_level,
        replies.parse_boolean,
        replies.parse_register,
        replies.parse_error_entry,
        replies.parse_identity,
    ):
        try:
            value = read(line)
        except Unreadable as error:
            assert "\n" not in str(error)
        else:
            assert not isinstance(value, float) or abs(value) <= 1e4


@given(st.floats(-1e4, 1e4), st.sampled_from(["{:+.8E}", "{:.4f}", "{:g}"]))
def test_every_number_that_a_supply_prints_is_read(value, form):
    text = form.format(value)
    assert replies.parse_level(text.encode()) == float(text)


@given(st.floats(-20, 20), st.sampled_from(["e36xx", "dp800"]))
def test_every_reading_that_a_supply_prints_is_read_and_no_rest_of_one_is_another(value, dialect):
    form = DIALECTS[dialect]("", 0).reading
    text = FailingSupplyEnd(dialect)._number_text(value)
    assert replies.parse_reading(text.encode(), form, 20.0) == float(text)
    if dialect == "e36xx":
        for lost in range(1, len(text)):
            with pytest.raises(Unreadable):
                replies.parse_reading(text[lost:].encode(), form, 20.0)


@pytest.mark.parametrize(
    "text", [b"1e", b"+", b".", b"1.2.3", b"nan", b"inf", b"1_0", b"0x10", b"9.9E37", b" ", b"1 2"]
)
def test_what_is_no_number_is_refused(text):
    with pytest.raises(Unreadable):
        replies.parse_level(text)


class Chunks:
    """A line on which these chunks come, one a read."""

    def __init__(self, chunks):
        self._chunks = list(chunks)

    def read(self, timeout):
        return self._chunks.pop(0) if self._chunks else b""


@given(st.binary(max_size=60), st.lists(st.integers(0, 60), max_size=6))
def test_lines_do_not_depend_on_how_their_bytes_come(data, cuts):
    places = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    port = SerialPort(lambda: Chunks(data[a:b] for a, b in pairwise(places)), EmulatedClock())
    port.open()
    taken = [port.take_line() for _ in range(len(data) + len(places))]
    assert [line for line in taken if line is not None] == [line.rstrip(b"\r") for line in data.split(b"\n")[:-1]]


def test_noise_without_an_end_does_not_pile_up():
    port = SerialPort(lambda: Chunks([b"x" * 5000] * 20 + [b"\n"]), EmulatedClock())
    port.open()
    lines = [port.take_line() for _ in range(21)]
    assert lines[:-1] == [None] * 20
    assert len(lines[-1]) <= LONGEST_LINE


# -- settings --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "wrong",
    [
        {"voltage_limit_V": 0},
        {"current_limit_A": math.inf},
        {"feeds": "drives"},
        {"dialect": "korad"},
        {"period_s": 0.01},
        {"dialect": "dp800", "output_range": "low"},
        {"model": ""},
        {"volts": 3},
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValidationError):
        ScpiSupplySettings(**(HEATED | wrong))


def test_without_limits_there_is_no_supply():
    for name in ("voltage_limit_V", "current_limit_A", "model"):
        with pytest.raises(ValidationError):
            ScpiSupplySettings(**{key: value for key, value in HEATED.items() if key != name})
