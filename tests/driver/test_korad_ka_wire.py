"""The Korad's driver against its far end: no end of a command or of an answer, and commands that are lost."""

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from leactl_plugins.korad_ka import replies
from leactl_plugins.korad_ka.settings import RATINGS, SOLD_AS, KoradKaSettings, model_of
from pydantic import ValidationError

from leactl.driver.contract import Identity, PowerSupply
from leactl.driver.conversation import Unreadable
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer

from .failing import FailingKoradEnd
from .supply_bench import KORAD, KoradKaBench

SWITCHING_OFF = [
    (b"OUT0", b""),
    (b"VSET1:01.01", b""),
    (b"VSET1?", b"01.01"),
    (b"STATUS?", b"\x11"),
    (b"VOUT1?", b"00.00"),
    (b"IOUT1?", b"0.000"),
]
OPENING = [
    *SWITCHING_OFF,
    (b"*IDN?", b"KORADKA3010PV2.0"),
    (b"ISET1:0.000", b""),
    (b"VSET1:00.00", b""),
    (b"VSET1?", b"00.00"),
    (b"ISET1?", b"0.000"),
]


@pytest.fixture
def bench(make_korad_ka):
    return make_korad_ka()


@pytest.fixture
def here():
    """A bench in this process: its time is emulated, and its line fails on request."""
    return KoradKaBench()


def opened_as(identity, stray="", **expected):
    """A bench whose supply has this identity and this sixth byte, in text."""
    bench = KoradKaBench(**expected)
    hexa = [text.encode("latin1").hex() for text in (identity, stray)]
    bench.far = bench.wire.device("korad_ka", bench.settings.model, *hexa)
    bench.supply.open()
    return bench


UNPROTECTED = (
    "no protection with a level of its own (OVP, OCP): voltage_limit_V and current_limit_A bound nothing but what is"
    " commanded"
)


# -- opening ---------------------------------------------------------------------------------------------------------


def test_opening_makes_off_asks_for_the_name_and_sets_nothing(bench):
    bench.supply.open()
    assert bench.commands() == [sent for sent, _ in OPENING]
    assert bytes(bench.heard) == b"".join(answer for _, answer in OPENING)
    assert bench.supply.notices() == [UNPROTECTED]
    assert bench.supply.identity() == Identity("KORADKA3010P", "", "2.0")


def test_an_output_that_was_left_on_is_off_after_opening(here):
    here.far.leave_on(6.0, 5.0)
    here.supply.open()
    assert here.far.output() == [False, 0.0, 0.0]
    assert here.far.levels() == [0.0, 0.0]


def test_protections_are_left_as_they_are(here):
    here.far.protections.update(OVP=True, OCP=True)
    here.energise()
    here.made_safe()
    here.supply.close()
    assert here.far.protections == {"OVP": True, "OCP": True}
    assert not any(command.startswith((b"OVP", b"OCP", b"BEEP")) for command in here.commands())


@pytest.mark.parametrize(
    ("identity", "model", "told"),
    [
        ("KORADKA3005PV2.0", "KA3005P", ("KORADKA3005P", "", "2.0")),
        ("KORADKA3005PV2.0\x01", "KA3005P", ("KORADKA3005P", "", "2.0")),
        ("KORADKA3005PV2.0\xbc", "KA3005P", ("KORADKA3005P", "", "2.0")),
        ("KORAD KA3005P V5.5 SN:16072670", "KA3005P", ("KORAD KA3005P", "16072670", "5.5")),
        ("VELLEMANPS3005DV2.0", "KA3005P", ("VELLEMANPS3005D", "", "2.0")),
        ("TENMA 72-2535 V2.1", "KA3003P", ("TENMA 72-2535", "", "2.1")),
        ("TENMA72-2550V2.0", "KA6003P", ("TENMA72-2550", "", "2.0")),
        ("RND 320-KA3005P V2.0", "KA3005P", ("RND 320-KA3005P", "", "2.0")),
    ],
)
def test_a_model_is_known_under_the_names_of_its_sellers(identity, model, told):
    bench = opened_as(identity, model=model, current_limit_A=3.0)
    assert bench.supply.identity() == Identity(*told)


@pytest.mark.parametrize(
    ("identity", "complaint"),
    [
        ("KORADKA3005PV2.0", "KORADKA3005P answers; a KA3010P, which answers KORADKA3010P, was expected"),
        ("KORAD KD3010P V2.0", "KORAD KD3010P answers; a KA3010P, which answers KORADKA3010P, was expected"),
        ("KA3010PV2.0", "KA3010P answers; a KA3010P, which answers KORADKA3010P, was expected"),
        (
            "VELLEMANPS3005DV1.3",
            "VELLEMANPS3005D with firmware 1.3 answers, which needs too long for a command",
        ),
        (
            "\x80\xff",
            r"*IDN? was answered by '\x80\xff' where a name and a version such as KORADKA3005PV2.0 were expected",
        ),
    ],
)
def test_another_model_is_refused_with_its_answer(identity, complaint):
    with pytest.raises(DeviceError) as refused:
        opened_as(identity)
    assert str(refused.value) == f"supply: {complaint}"


def test_a_refusal_names_all_sellers_names():
    with pytest.raises(DeviceError, match=r"answers KORADKA6003P or TENMA72-2550, was expected"):
        opened_as("KORADKA3005PV2.0", model="KA6003P", current_limit_A=3.0)


def test_a_supply_that_does_not_tell_its_name_is_taken_as_it_is_told_and_says_so(here):
    here.far.ignore("*IDN?")
    here.supply.open()
    assert here.supply.notices() == [UNPROTECTED, "does not tell its model (*IDN?); it is taken for a KA3010P"]
    assert here.supply.identity() == Identity()


@pytest.mark.parametrize(
    ("fault", "kind", "complaint"),
    [
        (("freeze",), NoAnswer, "supply: no answer to VSET1? within 0.2 s"),
        (("ignore", "ISET1:"), DeviceError, "supply: 0.00 V and 5.000 A are set after 0.00 V and 0.000 A were"),
        (("stuck_on",), DeviceFault, "supply: the output is still on, 1."),
        (("stuck_on", False), DeviceFault, "supply: the output is still on, 1."),
    ],
)
def test_a_supply_that_is_not_as_it_was_told_to_be_is_refused(here, fault, kind, complaint):
    here.far.leave_on(6.0, 5.0)
    getattr(here.far, fault[0])(*fault[1:])
    with pytest.raises(kind) as refused:
        here.supply.open()
    assert complaint in str(refused.value)


def test_a_setting_that_is_lost_is_sent_again(here):
    here.supply.open()
    here.rows()
    here.supply.supply(8.0, 9.0)
    here.until(lambda _: b"ISET1:9.000" in here.said)
    here.far.busy_until(here.clock.now() + 0.03)
    here.until(lambda _: here.far.levels() == [8.0, 9.0])
    assert here.commands().count(b"ISET1:9.000") == 2


# -- commands --------------------------------------------------------------------------------------------------------


def test_levels_then_on_each_read_back(bench):
    bench.supply.open()
    bench.commands()
    bench.supply.supply(7.5, 9.125)
    bench.supply.switch_on()
    assert not bench.supply.supplying
    bench.until(lambda _: bench.supply.supplying)
    expected = [b"ISET1:9.125", b"VSET1:07.50", b"VSET1?", b"ISET1?", b"OUT1", b"STATUS?", b"VOUT1?", b"IOUT1?"]
    assert bench.commands()[:8] == expected
    assert bench.far.output() == [True, pytest.approx(5.475), 9.125]
    assert isinstance(bench.supply, PowerSupply)


@pytest.mark.parametrize(
    ("levels", "complaint"),
    [
        ((8.01, 1.0), "8.01 V asked of a supply that is good for 0 to 8 V"),
        ((8.0, 9.501), "9.501 A asked of a supply that is good for 0 to 9.5 A"),
        ((-0.01, 1.0), "-0.01 V asked of a supply that is good for 0 to 8 V"),
        ((8.0, 9.0005), "9.0005 A asked of a supply with steps of 0.001 A"),
        ((7.965, 9.0), "7.965 V asked of a supply with steps of 0.01 V"),
        ((math.nan, 1.0), "nan V asked"),
        ((8.0, math.inf), "inf A asked"),
    ],
)
def test_levels_that_it_cannot_have_go_nowhere(here, levels, complaint):
    here.supply.open()
    here.rows()
    here.commands()
    with pytest.raises(InputError, match=complaint):
        here.supply.supply(*levels)
    here.rows()
    assert not any(command.startswith((b"VSET1:", b"ISET1:")) for command in here.commands())


@given(st.integers(0, 800), st.integers(0, 9500))
@settings(max_examples=30, deadline=None)
def test_every_step_is_set_as_it_is_asked(hundredths, thousandths):
    bench = KoradKaBench()
    bench.supply.open()
    bench.supply.supply(hundredths / 100, thousandths / 1000)
    bench.rows()
    assert bench.far.levels() == [pytest.approx(hundredths / 100), pytest.approx(thousandths / 1000)]


def test_off_is_sent_at_once_in_the_middle_of_a_query_and_repeated_until_seen(bench):
    bench.energise()
    bench.until(lambda _: bench.said)
    bench.commands()
    bench.supply.switch_off()
    assert bytes(bench.said) == b"OUT0"
    bench.until(lambda _: not bench.supply.supplying)
    assert bench.commands()[:5] == [b"OUT0", b"OUT0", b"STATUS?", b"VOUT1?", b"IOUT1?"]
    assert bench.far.output() == [False, 0.0, 0.0]
    assert bench.rows()[0].fault == ""


def test_an_off_that_is_lost_is_repeated_by_the_next_call(here):
    here.energise()
    here.until(lambda _: bytes(here.said).endswith(b"STATUS?"))
    here.clock.sleep_until(here.clock.now() + 0.02)  # the instrument rests
    here.supply.stop_now()
    here.clock.sleep_until(here.clock.now() + 0.02)
    assert here.far.output()[0] is True
    assert here.made_safe().safe


def test_an_off_while_the_instrument_idles_is_obeyed_at_once(here):
    here.energise()
    here.clock.sleep_until(here.clock.now() + 0.06)
    here.supply.stop_now()
    here.clock.sleep_until(here.clock.now() + 0.01)
    assert here.far.output() == [False, 0.0, 0.0]


def test_an_output_that_does_not_switch_on_is_a_fault_and_is_not_asked_again(here):
    here.supply.open()
    here.far.ignore("OUT1")
    here.commands()
    here.supply.supply(8.0, 9.0)
    here.supply.switch_on()
    with pytest.raises(DeviceFault, match=r"supply: the output does not switch on, 0.00 V and 0.000 A, its state off"):
        here.until(lambda _: False)
    assert here.commands().count(b"OUT1") == 1  # a protection may have tripped


@pytest.mark.parametrize("admits", [True, False])
def test_an_output_that_does_not_switch_off_is_a_fault(here, admits):
    here.energise()
    here.far.stuck_on(admits)
    here.supply.switch_off()
    with pytest.raises(DeviceFault, match=r"supply: the output does not switch off, 5.40 V and 9.000 A"):
        here.until(lambda _: False)


# -- pace ------------------------------------------------------------------------------------------------------------


class Stopwatch:
    """The times at which a bench's connection is written to."""

    def __init__(self, bench):
        self.times, write = [], bench.port.write

        def timed(data):
            self.times.append(bench.clock.now())
            write(data)

        bench.port.write = timed


def test_no_command_comes_sooner_than_the_pace_after_another(here):
    watch = Stopwatch(here)
    here.energise()
    here.rows(5)
    here.made_safe()
    gaps = [later - earlier for earlier, later in pairwise(watch.times)]
    assert min(gaps) >= here.settings.pace_s - 1e-9
    assert len(gaps) > 30


@pytest.mark.parametrize("pace_s", [0.06, 0.07])
def test_off_is_confirmed_in_time_at_any_pace(pace_s):
    bench = KoradKaBench(pace_s=pace_s)
    bench.energise()
    bench.supply.stop_now()
    assert bench.made_safe().safe


# -- readings --------------------------------------------------------------------------------------------------------


def test_a_round_is_state_and_output_and_once_a_second_what_is_set(here):
    here.energise()
    here.commands()
    here.rows(20)
    sent = here.commands()
    assert set(sent) == {b"STATUS?", b"VOUT1?", b"IOUT1?", b"VSET1?", b"ISET1?"}
    assert 7 <= sent.count(b"VSET1?") <= 11


def test_the_stamp_is_the_middle_of_voltage_and_current(here):
    here.energise()
    here.until(lambda _: b"VOUT1?" in here.said)
    asked = here.clock.now()
    (row,) = here.rows()
    assert row.values == (5.4, 9.0)
    assert row.time == pytest.approx((asked + here.clock.now() - 0.03) / 2, abs=0.002)  # silence ends the answer


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
        (("lose_regulation", 0.5), "out of regulation, 2.70 V and 4.500 A; 8.00 V and 9.000 A are set"),
        (("leave_on", 8.0, 9.4), "set to 8.00 V and 9.400 A by itself; 8.00 V and 9.000 A were commanded"),
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
    here.far.leave_on(0.0, 0.0)
    assert here.until(lambda rows: rows and rows[-1].fault)[-1].fault == "supply: the output is on by itself"


@pytest.mark.parametrize("stray", ["K", "\x00", "\xff", "5"])
def test_a_sixth_byte_behind_the_current_that_is_set_means_nothing(stray):
    bench = opened_as("KORADKA3010PV2.0", stray)
    bench.energise()
    assert [row.values for row in bench.rows(8)] == [(5.4, 9.0)] * 8
    assert bench.supply.notices() == []


# -- answers that go wrong -------------------------------------------------------------------------------------------

GARBAGE = {
    "garbled": b"05\xff40",
    "cut short": b"05.4",
    "a byte too many": b"05.400",
    "two answers": b"05.4005.40",
    "another query's": b"9.000",
    "more than it can give": b"85.40",
    "with an end": b"05.40\n",
}


@pytest.mark.parametrize("answer", [*(data.hex() for data in GARBAGE.values()), None], ids=[*GARBAGE, "lost"])
def test_one_bad_answer_costs_a_round_and_none_is_guessed(here, answer):
    here.energise()
    here.until(lambda _: bytes(here.said).endswith(b"VOUT1?"))
    here.far.spoil(answer)
    rows = here.rows(2)
    assert all(row.values == (5.4, 9.0) for row in rows)
    assert len([text for text in here.supply.notices() if text.startswith("a round was lost")]) == 1


def test_a_state_of_more_than_a_byte_is_told(here):
    here.energise()
    here.until(lambda _: bytes(here.said).endswith(b"STATUS?"))
    here.far.spoil(b"05.40".hex())
    here.rows()
    assert "a round was lost: STATUS? was answered by '05.40' where one byte was expected" in here.supply.notices()


def test_more_than_it_can_give_is_told(here):
    here.energise()
    here.until(lambda _: bytes(here.said).endswith(b"VOUT1?"))
    here.far.spoil(b"85.40".hex())
    here.rows()
    complaint = "85.40 V and 9.000 A, its state on, where no more than 30 V and 9.999 A can be"
    assert f"a round was lost: {complaint}" in here.supply.notices()


def test_a_line_that_is_never_silent_is_told(here):
    here.energise()
    tick, next_byte = here.far.tick, here.clock.now()

    def chatter(now):
        nonlocal next_byte
        sent = tick(now)
        while next_byte <= now:
            sent, next_byte = sent + b"\xff", next_byte + 0.09
        return sent

    here.far.tick = chatter
    began = here.clock.now()
    with pytest.raises(NoAnswer, match=r"supply: the line was never silent for 0\.1 s within 0\.5 s"):
        here.until(lambda _: False, 10.0)
    assert here.clock.now() - began < 3.0


def test_a_late_answer_is_not_taken_for_the_next_query_s(here):
    here.energise()
    here.until(lambda _: bytes(here.said).endswith(b"VOUT1?"))
    here.far.slow_down(0.25)
    here.clock.sleep_until(here.clock.now() + 0.02)  # the query has arrived
    here.far.slow_down(0.01)
    here.supply.supply(8.0, 4.0)
    rows = here.rows(3)
    assert [row.values for row in rows] == [(2.4, 4.0)] * 3
    assert "a round was lost: no answer to VOUT1? within 0.2 s" in here.supply.notices()


@given(st.lists(st.booleans(), min_size=4, max_size=4))
def test_every_chunking_of_an_answer_is_read(cuts):
    """Pieces 10 ms apart, as an adapter passes them on."""
    bench = KoradKaBench()
    bench.energise()
    bench.until(lambda _: bytes(bench.said).endswith(b"VOUT1?"))
    bench.far.spoil(None)
    pieces, moment = [b"0"], bench.clock.now() + 0.02
    for byte, cut in zip(b"5.40", cuts, strict=True):
        pieces[-1:] = [pieces[-1], bytes([byte])] if cut else [pieces[-1] + bytes([byte])]
    bench.clock.sleep_until(moment)
    for k, piece in enumerate(pieces):
        bench.far._output.append((moment + 0.02 + 0.01 * k, piece))
    assert bench.rows()[0].values == (5.4, 9.0)
    assert bench.supply.notices() == []


# -- the safe state --------------------------------------------------------------------------------------------------


def in_the_middle_of_a_query(bench):
    bench.energise()
    bench.until(lambda _: b"VOUT1?" in bench.said)


@pytest.mark.parametrize("lost", range(6))
def test_off_in_spite_of_any_one_answer_or_command_lost(lost):
    bench = KoradKaBench()
    bench.energise()
    header = [b"OUT0", b"VSET1:", b"VSET1?", b"STATUS?", b"VOUT1?", b"IOUT1?"][lost].decode()
    obey, seen = bench.far._obey, []

    def forgetful(command):
        if command.startswith(header) and not seen:
            return seen.append(command)
        return obey(command)

    bench.far._obey = forgetful
    assert bench.made_safe().safe
    assert seen
    assert bench.far.output()[0] is False


def test_off_is_seen_after_a_mark_that_only_a_fresh_answer_can_carry(bench):
    bench.energise()
    bench.made_safe()
    expected = [b"OUT0", b"VSET1:01.02", b"VSET1?", b"STATUS?", b"VOUT1?", b"IOUT1?"]
    assert bench.commands()[-6:] == expected
    bench.made_safe()
    assert bench.commands() == [b"VSET1:01.03" if command == b"VSET1:01.02" else command for command in expected]


@pytest.mark.parametrize("admits", [True, False])
def test_a_supply_that_does_not_switch_off_is_not_called_safe_and_is_turned_down(here, admits):
    here.energise()
    here.far.stuck_on(admits)
    confirmed = here.made_safe()
    assert not confirmed.safe
    assert "the output is still on, 1." in confirmed.detail
    assert 1.0 <= here.far.output()[1] < 2.0
    here.far.mend()
    assert here.made_safe().safe


# what earlier queries may have brought: settings, measurements of nothing, states that are off, parts of these
STALE = ["00.00", "0.000", "08.00", "01.01", "\x11", "\x01", "0", ".", "K", "\xff", "00.000.000", "00.0"]


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(STALE), st.floats(0.0, 0.9)), max_size=8), st.booleans(), st.booleans())
def test_stale_and_spoilt_answers_never_make_a_stuck_supply_safe(stale, asking, admits):
    bench = KoradKaBench()
    bench.energise()
    if asking:
        in_the_middle_of_a_query(bench)
    bench.far.stuck_on(admits)
    now = bench.clock.now()
    for text, later in sorted(stale, key=lambda each: each[1]):
        bench.far._output.append((now + later, text.encode("latin1")))
    assert not bench.supply.safe_state(1.0).safe


def test_answers_of_an_output_that_was_off_once_are_not_believed(here):
    """As if all answers were one whole opening late, each in its form and in its turn."""
    here.energise()
    here.far.stuck_on()
    late = [b"01.01", b"\x11", b"00.00", b"0.000"]
    here.far.spoil(*[answer.hex() for answer in late] * 20)
    assert not here.made_safe().safe
    here.far.mend()
    assert not here.made_safe().safe  # more of them come


PIECES = [b"OUT", b"OUT0", b"VSET1:05.00", b"0", b"1", b"STATUS?", b"OCP1"]


@given(st.lists(st.one_of(st.binary(max_size=20), st.sampled_from(PIECES))), st.sampled_from([0.001, 0.02, 0.1]))
def test_nothing_but_out1_switches_the_far_end_on(chunks, apart):
    far = FailingKoradEnd()
    for step, chunk in enumerate(chunks):
        far.receive(chunk, apart * step)
        far.tick(apart * step)
    assert not far.on or b"OUT1" in b"".join(chunks)


@pytest.mark.parametrize("command", [b"VSET1:31.00", b"ISET1:10.0", b"VSET1", b"OUT2", b"out1", b"VSET2?", b"OUT1\n"])
def test_what_it_does_not_understand_it_does_not_answer(command):
    far = FailingKoradEnd()
    far.receive(command, 0.0)
    far.tick(0.01)
    assert far.tick(1.0) == b""
    assert far.levels() == [0.0, 0.0]
    assert not far.on


@pytest.mark.parametrize(
    ("first", "after_s", "obeyed"),
    [
        (b"VSET1:05.00", 0.004, False),  # no silence between: one command that is none
        (b"VSET1:05.00", 0.03, False),
        (b"VSET1:05.00", 0.05, True),
        (b"STATUS?", 0.03, False),
        (b"STATUS?", 0.05, True),
        (b"VOUT1?", 0.01, False),  # before the answer
        (b"VOUT1?", 0.02, True),
    ],
)
def test_the_far_end_loses_what_comes_too_soon(first, after_s, obeyed):
    far = FailingKoradEnd()
    for now, command in ((0.0, first), (after_s, b"OUT1")):
        if now > 0.005:
            far.tick(0.005)
        far.receive(command, now)
    far.tick(after_s + 0.005)
    assert far.on is obeyed


# -- the parsers -----------------------------------------------------------------------------------------------------


@given(st.one_of(st.binary(max_size=8), st.from_regex(rb"[0-9]{0,2}\.[0-9]{0,4}.?", fullmatch=True)))
def test_an_answer_is_read_or_refused_never_anything_else(answer):
    for read, form in (
        (replies.parse_hundredths, "{:05.2f}"),
        (replies.parse_thousandths, "{:.3f}"),
        (replies.parse_set_thousandths, "{:.3f}"),
    ):
        try:
            value = read(answer)
        except Unreadable as error:
            assert "\n" not in str(error)
        else:
            assert form.format(value / (100 if read is replies.parse_hundredths else 1000)).encode() == answer[:5]
            assert len(answer) == 5 or (read is replies.parse_set_thousandths and len(answer) == 6)


@given(st.binary(max_size=40))
def test_an_identity_is_read_or_refused(answer):
    try:
        read = replies.parse_identity(answer)
    except Unreadable as error:
        assert "\n" not in str(error)
    else:
        assert all(text.isprintable() for text in read)
        assert read.name.encode() == answer[: len(read.name)]


@given(st.integers(0, 9999), st.integers(0, 9999), st.binary(max_size=1))
def test_every_value_is_read(hundredths, thousandths, stray):
    assert replies.parse_hundredths(f"{hundredths / 100:05.2f}".encode()) == hundredths
    assert replies.parse_thousandths(f"{thousandths / 1000:.3f}".encode()) == thousandths
    assert replies.parse_set_thousandths(f"{thousandths / 1000:.3f}".encode() + stray) == thousandths


@pytest.mark.parametrize("byte", range(256))
def test_only_the_bits_on_which_all_agree_are_read(byte):
    assert replies.parse_status(bytes([byte])) == (bool(byte & 0x40), not byte & 1)


@given(
    st.sampled_from([*(f"KORAD{model}" for model in RATINGS), *SOLD_AS]),
    st.sampled_from(["", " "]),
    st.sampled_from(["2.0", "5.5"]),
    st.sampled_from(["", "16072670"]),
    st.sampled_from([b"", b"\x01", b"\xbc"]),
)
def test_every_known_identity_is_read(name, blank, firmware, number, stray):
    answer = f"{name}{blank}V{firmware}{' SN:' if number else ''}{number}".encode() + stray
    read = replies.parse_identity(answer)
    assert read == (name, firmware, number)
    assert model_of(read.name) in RATINGS


# -- settings --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "wrong",
    [
        {"model": "KA3006P"},
        {"voltage_limit_V": 30.1},
        {"current_limit_A": 10.0},
        {"model": "KA3005P", "current_limit_A": 5.1},
        {"model": "KA6002P", "current_limit_A": 2.0, "voltage_limit_V": 60.1},
        {"voltage_limit_V": 0.5},
        {"current_limit_A": math.nan},
        {"off_voltage_V": 1.0},  # the lowest mark
        {"feeds": "drives"},
        {"pace_s": 0.1},
        {"volts": 3},
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValidationError):
        KoradKaSettings(**(KORAD | wrong))


def test_a_limit_above_the_model_s_rating_names_both():
    with pytest.raises(ValidationError, match=r"current_limit_A 5\.1 A: a KA3005P is served up to 5 A"):
        KoradKaSettings(**(KORAD | {"model": "KA3005P", "current_limit_A": 5.1}))
