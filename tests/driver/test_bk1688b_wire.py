"""The 168xB's driver against its far end: bytes, an output switch that is the wrong way round, and no word of it."""

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from leactl_plugins.bk1688b import replies
from leactl_plugins.bk1688b.settings import Bk1688bSettings
from pydantic import ValidationError

from leactl.driver.contract import PowerSupply
from leactl.driver.conversation import Unreadable
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer

from .failing import FailingBk1688bEnd
from .supply_bench import BK, Bk1688bBench

OPENING = [
    (b"", b""),
    (b"SOUT1", b"OK\r"),  # 1 is off
    (b"VOLT011", b"OK\r"),
    (b"GETS", b"011000\rOK\r"),
    (b"GETD", b"000000000\rOK\r"),
    (b"GMAX", b"180200\rOK\r"),
    (b"CURR000", b"OK\r"),
    (b"VOLT010", b"OK\r"),
    (b"GETS", b"010000\rOK\r"),
]


@pytest.fixture
def bench(make_bk1688b):
    return make_bk1688b()


@pytest.fixture
def here():
    """A bench in this process: its time is emulated, and its line fails on request."""
    return Bk1688bBench()


# -- opening ---------------------------------------------------------------------------------------------------------


def test_opening_makes_off_asks_for_the_limits_and_sets_the_least(bench):
    bench.supply.open()
    assert bench.lines() == [sent for sent, _ in OPENING]
    assert bytes(bench.heard) == b"".join(answer for _, answer in OPENING)
    assert bench.supply.notices() == []


def test_an_output_that_was_left_on_is_off_after_opening(here):
    here.far.leave_on(6.0, 5.0)
    here.supply.open()
    assert here.far.output() == [False, 0.0, 0.0]
    assert here.far.levels() == [1.0, 0.0]


def test_a_supply_that_does_not_tell_its_limits_is_taken_as_it_is_told_and_says_so(here):
    here.far.ignore("GMAX")
    here.supply.open()
    assert here.supply.notices() == ["does not tell its limits (GMAX); it is taken for a 1688B"]


@pytest.mark.parametrize(
    ("model", "complaint"),
    [
        ("1685B", "limits of 60.0 V and 50.0 A answer; a 1688B with 18 V and 20 A was expected"),
        ("1687B", "limits of 36.0 V and 10.0 A answer; a 1688B with 18 V and 20 A was expected"),
    ],
)
def test_another_model_is_refused_by_its_limits(here, model, complaint):
    here.wire.device("bk1688b", model)
    with pytest.raises(DeviceError) as refused:
        here.supply.open()
    assert str(refused.value) == f"supply: {complaint}"


@pytest.mark.parametrize(
    ("fault", "kind", "complaint"),
    [
        (("freeze",), NoAnswer, "supply: no answer to SOUT1"),
        (("ignore", "CURR"), NoAnswer, "supply: no answer to CURR000 within 0.3 s"),
        (("stuck_on",), DeviceFault, "supply: the output is still on, 1."),
    ],
)
def test_a_supply_that_is_not_as_it_was_told_to_be_is_refused(here, fault, kind, complaint):
    here.far.leave_on(6.0, 5.0)
    getattr(here.far, fault[0])(*fault[1:])
    with pytest.raises(kind) as refused:
        here.supply.open()
    assert complaint in str(refused.value)


def test_garbage_at_the_other_end_is_refused(here):
    here.far.spoil(*[b"\xff\x00\r\x80OK\r".hex()] * 50)
    with pytest.raises(NoAnswer, match=r"supply: no answer to SOUT1 within 0.3 s"):
        here.supply.open()


# -- commands --------------------------------------------------------------------------------------------------------


def test_levels_then_on_which_is_sout0_each_read_back(bench):
    bench.supply.open()
    bench.lines()
    bench.supply.supply(7.5, 9.0)
    bench.supply.switch_on()
    assert not bench.supply.supplying
    bench.until(lambda _: bench.supply.supplying)
    assert bench.lines()[:6] == [b"GETS", b"CURR090", b"VOLT075", b"GETS", b"SOUT0", b"GETD"]
    assert bench.far.output() == [True, pytest.approx(5.4), 9.0]
    assert isinstance(bench.supply, PowerSupply)


def test_a_1685b_takes_its_current_in_hundredths(make_bk1688b):
    bench = make_bk1688b(model="1685B", current_limit_A=5.0)
    bench.energise(8.0, 2.25)
    assert bench.far.levels() == [8.0, 2.25]
    (row,) = bench.rows()
    assert row.values == (1.35, 2.25)


@pytest.mark.parametrize(
    ("levels", "complaint"),
    [
        ((8.1, 1.0), "8.1 V asked of a supply that is good for 1 to 8 V"),
        ((8.0, 10.1), "10.1 A asked of a supply that is good for 0.1 to 10 A"),
        ((0.9, 1.0), "0.9 V asked of a supply that is good for 1 to 8 V"),
        ((8.0, 0.0), "0 A asked of a supply that is good for 0.1 to 10 A"),
        ((8.0, 9.05), "9.05 A asked of a supply with steps of 0.1 A"),
        ((7.96, 9.0), "7.96 V asked of a supply with steps of 0.1 V"),
        ((math.nan, 1.0), "nan V asked"),
        ((8.0, math.inf), "inf A asked"),
    ],
)
def test_levels_that_it_cannot_have_go_nowhere(here, levels, complaint):
    here.supply.open()
    here.rows()
    here.lines()
    with pytest.raises(InputError, match=complaint):
        here.supply.supply(*levels)
    here.rows()
    assert not any(line.startswith((b"VOLT", b"CURR")) for line in here.lines())


def test_off_is_sent_at_once_in_the_middle_of_a_question_and_then_seen(bench):
    bench.energise()
    bench.until(lambda _: bench.said)
    bench.lines()
    bench.supply.switch_off()
    assert bench.lines() == [b"", b"SOUT1"]
    bench.until(lambda _: not bench.supply.supplying)
    assert bench.lines()[:3] == [b"GETS", b"SOUT1", b"GETD"]
    assert bench.far.output() == [False, 0.0, 0.0]
    assert bench.rows()[0].fault == ""


def test_an_output_that_does_not_switch_on_is_a_fault(here):
    here.supply.open()
    here.far._regulate = lambda: None  # nothing ever comes to the terminals
    here.supply.supply(8.0, 9.0)
    here.supply.switch_on()
    with pytest.raises(DeviceFault, match=r"supply: the output does not switch on, 0.00 V and 0.00 A"):
        here.until(lambda _: False)


def test_an_output_that_does_not_switch_off_is_a_fault(here):
    here.energise()
    here.far.stuck_on()
    here.supply.switch_off()
    with pytest.raises(DeviceFault, match=r"supply: the output does not switch off, 5.40 V and 9.00 A"):
        here.until(lambda _: False)


# -- readings --------------------------------------------------------------------------------------------------------


def test_a_round_is_the_display_and_once_a_second_what_is_set(here):
    here.energise()
    here.lines()
    here.rows(20)
    sent = here.lines()
    assert set(sent) == {b"GETD", b"GETS"}
    assert 3 <= sent.count(b"GETS") <= 5


def test_thirty_readings_a_second_go_over_9600_baud():
    bench = Bk1688bBench(period_s=0.02)
    bench.energise()
    began = bench.clock.now()
    rows = []
    while bench.clock.now() < began + 2.0:
        rows += bench.supply.take()
        bench.clock.sleep_until(bench.clock.now() + 1 / 30)
    assert len(rows) >= 57  # what is set is asked for in between
    assert all(later.time > earlier.time for earlier, later in pairwise(rows))


def test_the_stamp_is_the_middle_of_question_and_answer(here):
    here.energise()
    here.until(lambda _: b"GETD" in here.said)
    asked = here.clock.now()
    (row,) = here.rows()
    assert row.time == pytest.approx((asked + here.clock.now()) / 2, abs=0.0015)


def test_what_limits_is_noticed(here):
    here.energise()
    here.supply.supply(3.0, 9.0)
    here.until(lambda rows: rows and rows[-1].values[0] < 3.1)
    assert "constant voltage: 3.000 V, 5.000 A" in here.supply.notices()
    here.supply.supply(8.0, 4.0)
    here.until(lambda rows: rows and rows[-1].values[1] < 4.1)
    assert "constant current: 2.400 V, 4.000 A" in here.supply.notices()


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (("go_off",), "supply: the output is off by itself"),
        (("lose_regulation", 0.5), "out of regulation, 2.70 V and 4.50 A; 8.0 V and 9.00 A are set"),
    ],
)
def test_what_the_supply_does_by_itself_is_a_fault_not_a_value(here, fault, said):
    here.energise()
    getattr(here.far, fault[0])(*fault[1:])
    row = here.until(lambda rows: rows and rows[-1].fault)[-1]
    assert said in row.fault
    assert all(math.isnan(value) for value in row.values)


def test_an_output_that_goes_on_by_itself_is_a_fault(here):
    here.supply.open()
    here.rows()
    here.far.leave_on(5.0, 5.0)
    assert here.until(lambda rows: rows and rows[-1].fault)[-1].fault == "supply: the output is on by itself"


def test_what_a_person_sets_at_the_panel_is_a_fault(here):
    here.energise()
    here.far.leave_on(8.0, 9.5)
    row = here.until(lambda rows: rows and rows[-1].fault)[-1]
    assert row.fault == "supply: set to 8.0 V and 9.50 A at its panel; 8.0 V and 9.00 A were commanded"


def test_a_current_ten_times_what_was_meant_is_seen_within_two_seconds():
    """A 1688B in the place of a 1685B, which counts in hundredths, and does not tell its limits."""
    bench = Bk1688bBench(model="1685B", current_limit_A=5.0)
    bench.far = bench.wire.device("bk1688b", "1688B")
    bench.far.ignore("GMAX")
    bench.supply.open()
    bench.supply.supply(8.0, 1.0)
    bench.supply.switch_on()
    bench.until(lambda _: bench.supply.supplying)
    began = bench.clock.now()
    row = bench.until(lambda rows: rows and rows[-1].fault)[-1]
    assert row.fault == "supply: out of regulation, 6.00 V and 10.00 A; 8.0 V and 1.00 A are set"
    assert bench.clock.now() - began < 2.0


# -- answers that go wrong -------------------------------------------------------------------------------------------

GARBAGE = {
    "garbled": b"0540\xff9001\rOK\r".hex(),
    "no end": b"054009001\r".hex(),
    "cut short": b"05400900\rOK\r".hex(),
    "another question's": b"080090\rOK\r".hex(),
    "a plain OK": b"OK\r".hex(),
    "more volts than it can give": b"854009001\rOK\r".hex(),
    "more amperes than it can give": b"054099001\rOK\r".hex(),
    "with a line feed": b"054009001\r\nOK\r\n".hex(),
    "empty": b"\r".hex(),
    "lost": None,
}


@pytest.mark.parametrize("answer", GARBAGE.values(), ids=GARBAGE)
def test_one_bad_answer_costs_a_round_and_none_is_guessed(here, answer):
    here.energise()
    here.until(lambda _: b"GETD" in here.said)
    here.far.spoil(answer)
    rows = here.rows(2)
    assert all(row.values == (5.4, 9.0) for row in rows)
    lost = [text for text in here.supply.notices() if text.startswith("a round was lost")]
    assert 1 <= len(lost) <= 2  # half a line may spoil the next answer as well


def test_more_than_it_can_give_is_told(here):
    here.energise()
    here.until(lambda _: b"GETD" in here.said)
    here.far.spoil(b"854009001\rOK\r".hex())
    here.rows(1)
    complaint = "a round was lost: GETD was answered by 85.40 V and 9.00 A where no more than 18 V and 20 A can be"
    assert complaint in here.supply.notices()


def test_a_late_answer_is_not_taken_for_the_next_question_s(here):
    here.energise()
    here.until(lambda _: b"GETD" in here.said)
    here.far.slow_down(0.35)
    here.clock.sleep_until(here.clock.now() + 0.05)  # the question has arrived
    here.far.slow_down(0.005)
    here.supply.supply(8.0, 4.0)
    rows = here.rows(3)
    assert [row.values for row in rows] == [(2.4, 4.0)] * 3
    assert "a round was lost: no answer to GETD within 0.3 s" in here.supply.notices()


# -- the safe state --------------------------------------------------------------------------------------------------


def in_the_middle_of_a_question(bench):
    bench.energise()
    bench.until(lambda _: b"GETD" in bench.said)


def test_off_is_measured_after_a_mark_that_only_a_fresh_answer_can_carry(bench):
    bench.energise()
    bench.made_safe()
    assert bench.lines() == [b"", b"SOUT1", b"VOLT012", b"GETS", b"GETD"]
    bench.made_safe()
    assert bench.lines() == [b"", b"SOUT1", b"VOLT013", b"GETS", b"GETD"]


@pytest.mark.parametrize("left", [b"054009001\rOK\r"[cut:] for cut in range(13)])
def test_the_rest_of_an_answer_to_whoever_asked_before_holds_nobody_up(here, left):
    """A program that ended in the middle of a question: the rest comes when the next one has begun to listen."""

    def under_way():
        here.far._output.append((here.clock.now() + 0.001, left))

    under_way()
    here.energise()
    under_way()
    began = here.clock.now()
    assert here.made_safe().safe
    assert here.clock.now() - began < 0.2  # at the first try


def test_a_supply_that_does_not_switch_off_is_not_called_safe_and_is_turned_down(here):
    here.energise()
    here.far.stuck_on()
    confirmed = here.made_safe()
    assert not confirmed.safe
    assert "the output is still on, 1." in confirmed.detail
    assert 1.0 <= here.far.output()[1] <= 1.9
    here.far.mend()
    assert here.made_safe().safe


# what earlier questions may have brought, whole or in part: settings that were there before, a display of nothing
STALE = ["000000000\rOK\r", "OK\r", "010000\rOK\r", "011000\rOK\r", "080090\rOK\r", "\r", "\xff", "000000000\r"]


@settings(max_examples=60)
@given(st.lists(st.sampled_from(STALE), max_size=6), st.booleans())
def test_stale_and_spoilt_answers_never_make_a_stuck_supply_safe(stale, asking):
    bench = Bk1688bBench()
    bench.energise()
    if asking:
        in_the_middle_of_a_question(bench)
    bench.far.stuck_on()
    for text in stale:  # answers to earlier questions that are still on their way
        bench.far._output.append((bench.clock.now(), text.encode("latin1")))
    assert not bench.supply.safe_state(1.0).safe


@given(st.lists(st.one_of(st.binary(max_size=20), st.sampled_from([b"\r", b"SOUT", b"SOUT1", b"VOLT050", b"0", b"1"]))))
def test_nothing_but_sout0_switches_the_far_end_on(chunks):
    far = FailingBk1688bEnd()
    for step, chunk in enumerate(chunks):
        far.receive(chunk, 0.1 * step)
        far.tick(0.1 * step)
    assert not far.on or b"SOUT0" in b"".join(chunks)


@pytest.mark.parametrize("command", [b"VOLT009", b"VOLT181", b"CURR201", b"VOLT50", b"SOUT2", b"GETX", b"sout0", b""])
def test_what_it_does_not_understand_it_does_not_answer(command):
    far = FailingBk1688bEnd()
    far.receive(command + b"\r", 0.0)
    assert far.tick(1.0) == b""
    assert far.levels() == [1.0, 0.0]
    assert not far.on


def test_presets_are_kept_and_run():
    far = FailingBk1688bEnd()
    heard = b""
    for step, command in enumerate([b"PROM050010120090030005", b"RUNM1", b"GETS", b"GETM"]):
        far.receive(command + b"\r", float(step))
        heard += far.tick(step + 0.5)
    assert heard == b"OK\rOK\r120090\rOK\r050010\r120090\r030005\rOK\r"


# -- the parser ------------------------------------------------------------------------------------------------------


@given(st.one_of(st.binary(max_size=20), st.from_regex(rb"[0-9]{5,10}\nOK", fullmatch=True)))
def test_an_answer_is_read_or_refused_never_anything_else(answer):
    for read, digits in ((replies.parse_confirmation, 0), (replies.parse_levels, 6), (replies.parse_display, 9)):
        try:
            read(answer)
        except Unreadable as error:
            assert "\n" not in str(error)
        else:
            assert answer == (b"OK" if not digits else answer[:digits] + b"\nOK")
            assert answer[:digits].isdigit() or not digits


@given(st.integers(0, 9999), st.integers(0, 9999), st.booleans())
def test_every_display_is_read(centivolts, centiamperes, limited):
    read = replies.parse_display(f"{centivolts:04d}{centiamperes:04d}{limited:d}\nOK".encode())
    assert read == (centivolts / 100, centiamperes / 100, limited)


def test_the_manual_s_own_examples():
    assert replies.parse_display(b"030201450\nOK") == (3.02, 1.45, False)
    assert replies.parse_levels(b"025051\nOK") == (25, 51)  # 2.5 V, 5.1 A


# -- settings --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "wrong",
    [
        {"model": "1696"},
        {"voltage_limit_V": 18.1},
        {"current_limit_A": 20.1},
        {"model": "1685B", "current_limit_A": 5.1},
        {"model": "1687B", "voltage_limit_V": 36.1},
        {"voltage_limit_V": 0.9},
        {"current_limit_A": math.nan},
        {"feeds": "drives"},
        {"period_s": 0.001},
        {"volts": 3},
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValidationError):
        Bk1688bSettings(**(BK | wrong))


def test_a_limit_above_the_model_s_rating_names_both():
    with pytest.raises(ValidationError, match="voltage_limit_V: 20 V is above the 18 V of a 1688B; lower it"):
        Bk1688bSettings(**(BK | {"voltage_limit_V": 20.0}))
