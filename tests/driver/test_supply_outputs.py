"""One output of a supply with several: bytes that name it, the others untouched, and what is refused."""

import math
import re
from pathlib import Path

import pytest
from leactl_plugins.scpi_supply import models
from leactl_plugins.scpi_supply.models import OUTPUTS, dialect_of
from leactl_plugins.scpi_supply.settings import ScpiSupplySettings
from pydantic import ValidationError

from leactl.errors import DeviceError, DeviceFault

from .failing import FailingSupplyEnd
from .supply_bench import HEATED, SupplyBench
from .transports import SERIAL

README = Path(models.__file__).with_name("README.md")
LIMITS = {"voltage_limit_V": 5.5, "current_limit_A": 1.0}
E36300 = {"dialect": "e36300", "model": "E36312A", "output": 2, **LIMITS}
DP832 = {"dialect": "dp800", "model": "DP832", "output": 2, **LIMITS}
SPD3303 = {"dialect": "spd3303", "model": "SPD3303X", "output": 2, **LIMITS}
SEVERAL = {"e36300": E36300, "dp800": DP832, "spd3303": SPD3303}
SERVED = [(model, number) for model, outputs in OUTPUTS.items() for number in outputs]

OPENINGS = {
    "e36300": [
        (b"", b""),
        (b"SYST:REM", b""),
        (b"INST:NSEL 2", b""),
        (b"OUTP OFF,(@2)", b""),
        (b"*IDN?", b"Keysight Technologies,E36312A,0,2.1.0-1.0.4-1.12"),
        (b"OUTP? (@2)", b"0"),
        (b"MEAS:CURR? (@2)", b"+0.00000000E+00"),
        (b"SYST:ERR?", b'+0,"No error"'),
        (b"CURR:PROT:STAT? (@2)", b"0"),
        (b"OUTP:COUP:CHAN?", b"NONE"),
        (b"OUTP:TRAC?", b"0"),
        (b"OUTP:PAIR?", b"OFF"),
        (b"INST:NSEL?", b"2"),
        (b"VOLT 0.0000,(@2)", b""),
        (b"VOLT? (@2)", b"+0.00000000E+00"),
        (b"CURR 0.0020,(@2)", b""),
        (b"CURR? (@2)", b"+2.00000000E-03"),
        (b"VOLT:PROT? (@2)", b"+2.75000000E+01"),
        (b"VOLT:PROT 5.5000,(@2)", b""),
        (b"VOLT:PROT? (@2)", b"+5.50000000E+00"),
        (b"VOLT:PROT:TRIP? (@2)", b"0"),
        (b"SYST:ERR?", b'+0,"No error"'),
    ],
    "dp800": [
        (b"", b""),
        (b"SYST:REM", b""),
        (b"OUTP CH2,OFF", b""),
        (b"*IDN?", b"RIGOL TECHNOLOGIES,DP832,0,00.01.16"),
        (b"OUTP? CH2", b"OFF"),
        (b"MEAS:CURR? CH2", b"0.0000"),
        (b"SYST:ERR?", b'0,"No error"'),
        (b"OUTP:TRAC? CH1", b"OFF"),
        (b"OUTP:TRAC? CH2", b"OFF"),
        (b"SYST:ONOFFSYNC?", b"OFF"),
        (b"SOUR2:VOLT 0.0000", b""),
        (b"SOUR2:VOLT?", b"0.0000"),
        (b"SOUR2:CURR 0.0000", b""),
        (b"SOUR2:CURR?", b"0.0000"),
        (b"OUTP:OVP:VAL? CH2", b"33.0000"),
        (b"OUTP:OVP? CH2", b"ON"),
        (b"OUTP:OCP:VAL? CH2", b"3.3000"),
        (b"OUTP:OCP? CH2", b"ON"),
        (b"OUTP:OVP:VAL CH2,5.5000", b""),
        (b"OUTP:OVP:VAL? CH2", b"5.5000"),
        (b"OUTP:OVP CH2,ON", b""),
        (b"OUTP:OVP? CH2", b"ON"),
        (b"OUTP:OVP:QUES? CH2", b"NO"),
        (b"OUTP:OCP:VAL CH2,1.0000", b""),
        (b"OUTP:OCP:VAL? CH2", b"1.0000"),
        (b"OUTP:OCP CH2,ON", b""),
        (b"OUTP:OCP? CH2", b"ON"),
        (b"OUTP:OCP:QUES? CH2", b"NO"),
        (b"SYST:ERR?", b'0,"No error"'),
    ],
    "spd3303": [
        (b"", b""),
        (b"OUTPut CH2,OFF", b""),
        (b"*IDN?", b"Siglent Technologies,SPD3303X,0,1.01.01.02.07R2,V3.0"),
        (b"SYSTem:STATus?", b"0x4"),
        (b"MEASure:CURRent? CH2", b"0.000"),
        (b"SYSTem:ERRor?", b"0  No Error"),
        (b"SYSTem:STATus?", b"0x4"),
        (b"CH2:VOLTage 0.000", b""),
        (b"CH2:VOLTage?", b"0.000"),
        (b"CH2:CURRent 0.000", b""),
        (b"CH2:CURRent?", b"0.000"),
        (b"SYSTem:ERRor?", b"0  No Error"),
    ],
}
ROUNDS = {
    "e36300": [
        *(b"MEAS:VOLT? (@2)", b"MEAS:CURR? (@2)", b"OUTP? (@2)", b"STAT:QUES:INST:ISUM2:COND?", b"SYST:ERR?"),
        b"VOLT:PROT:TRIP? (@2)",
    ],
    "dp800": [
        *(b"MEAS:VOLT? CH2", b"MEAS:CURR? CH2", b"OUTP? CH2", b"STAT:QUES:INST:ISUM2:COND?", b"SYST:ERR?"),
        *(b"OUTP:OVP:QUES? CH2", b"OUTP:OCP:QUES? CH2"),
    ],
    "spd3303": [
        *(b"MEASure:VOLTage? CH2", b"MEASure:CURRent? CH2", b"SYSTem:STATus?", b"SYSTem:STATus?", b"SYSTem:ERRor?"),
    ],
}
COMMANDS = {  # levels, on
    "e36300": [b"CURR 0.9000,(@2)", b"CURR? (@2)", b"VOLT 5.0000,(@2)", b"VOLT? (@2)", b"OUTP ON,(@2)", b"OUTP? (@2)"],
    "dp800": [b"SOUR2:CURR 0.9000", b"SOUR2:CURR?", b"SOUR2:VOLT 5.0000", b"SOUR2:VOLT?", b"OUTP CH2,ON", b"OUTP? CH2"],
    "spd3303": [
        *(b"CH2:CURRent 0.900", b"CH2:CURRent?", b"CH2:VOLTage 5.000", b"CH2:VOLTage?"),
        *(b"OUTPut CH2,ON", b"SYSTem:STATus?"),
    ],
}
LEAVINGS = {
    "e36300": [b"*IDN?", b"VOLT:PROT 27.5000,(@2)", b"VOLT:PROT? (@2)", b"SYST:LOC"],
    "dp800": [
        *(b"*IDN?", b"OUTP:OVP:VAL CH2,33.0000", b"OUTP:OVP:VAL? CH2", b"OUTP:OVP CH2,ON", b"OUTP:OVP? CH2"),
        *(b"OUTP:OCP:VAL CH2,3.3000", b"OUTP:OCP:VAL? CH2", b"OUTP:OCP CH2,ON", b"OUTP:OCP? CH2", b"SYST:LOC"),
    ],
    "spd3303": [],
}
of_each_family = pytest.mark.parametrize("family", SEVERAL)
on_a_socket_too = pytest.mark.parametrize("make_supply", [*SERIAL, "tcp"], indirect=True)


def made(model, number, **settings):
    """A bench with this output of this model."""
    return SupplyBench(**{"dialect": dialect_of(model), "model": model, "output": number, **LIMITS, **settings})


# -- what is sent ----------------------------------------------------------------------------------------------------


@on_a_socket_too
@of_each_family
def test_opening_names_the_output_in_every_command_and_question(make_supply, family):
    bench = make_supply(**SEVERAL[family])
    bench.supply.open()
    assert bench.lines() == [sent for sent, _ in OPENINGS[family]]
    assert bytes(bench.heard).split(b"\n") == [*(answer for _, answer in OPENINGS[family] if answer), b""]


@on_a_socket_too
@of_each_family
def test_levels_then_on_then_rounds_name_it(make_supply, family):
    bench = make_supply(**SEVERAL[family])
    bench.supply.open()
    bench.lines()
    bench.supply.supply(5.0, 0.9)
    bench.supply.switch_on()
    rows = bench.rows()
    assert bench.lines() == [b"*IDN?", *COMMANDS[family], *ROUNDS[family]]
    assert bench.far.output() == [True, pytest.approx(0.54), 0.9]
    assert rows[0].values == (pytest.approx(0.54, abs=1e-3), pytest.approx(0.9, abs=1e-3))
    assert bench.rows()[0].fault == ""
    assert any(text.startswith("constant current: 0.54") for text in bench.supply.notices())


@of_each_family
def test_off_names_it_and_is_confirmed_by_its_own_state(family):
    bench = SupplyBench(**SEVERAL[family])
    bench.far.use_others()
    bench.energise(5.0, 0.9)
    others = bench.far.others()
    assert bench.made_safe() == (True, "output off, 0.000 A")
    assert (
        bench.lines() == [sent for sent, _ in OPENINGS[family]][: 5 if family == "spd3303" else 7 - (family == "dp800")]
    )
    assert bench.far.output() == [False, 0.0, 0.0]
    assert bench.far.others() == others
    assert all(on for _number, on, *_ in others)


@of_each_family
def test_closing_puts_the_protections_of_that_output_back_and_leaves_the_panel_to_people(make_supply, family):
    bench = make_supply(**SEVERAL[family])
    bench.supply.open()
    assert bench.far.in_remote_control() is (family != "spd3303")  # which has no such command
    bench.lines()
    bench.supply.close()
    assert bench.lines() == LEAVINGS[family]
    assert bench.far.in_remote_control() is False


# -- the others ------------------------------------------------------------------------------------------------------


def test_a_command_that_names_no_output_lands_on_the_selected_one():
    """The far end makes the mistake that the driver must not make."""
    for model, number in ("E36312A", 1), ("DP832", 3):
        far = FailingSupplyEnd(dialect_of(model), model, "0", 2)
        far.receive(f"INST:NSEL {number}\nVOLT 3\nOUTP ON\n".encode(), 0.0)
        assert [output.on for output in far.outputs] == [output.number == number for output in far.outputs]
        assert [output.set_volts == 3.0 for output in far.outputs] == [
            output.number == number for output in far.outputs
        ]
    far = FailingSupplyEnd("spd3303", "SPD3303X", "0", 2)
    far.receive(b"INSTrument CH1\nVOLTage 3\n", 0.0)
    assert [output.set_volts for output in far.outputs] == [3.0, 0.0, 0.0]


def a_protection_trips(bench):
    if bench.settings.dialect == "spd3303":  # has none
        bench.far.go_off()
    else:
        bench.far.trip()
    assert bench.until(lambda rows: rows and rows[-1].fault)


def it_goes_out_of_regulation(bench):
    bench.far.lose_regulation(0.5)
    assert bench.rows(2)


def it_does_not_switch_off(bench):
    bench.far.stuck_on()
    assert not bench.made_safe().safe
    bench.far.mend()


def an_answer_is_garbled(bench):
    bench.far.spoil(b"\xff\n".hex(), None)
    bench.rows(2)


def bytes_are_lost(bench):
    bench.far.miss(9)
    bench.rows(2)


def the_connection_is_replaced(bench):
    bench.dead_connections = bench.connections
    bench.supply.stop_now()


def it_is_switched_off_in_the_middle_of_a_question(bench):
    bench.until(lambda _: bench.said)
    bench.supply.switch_off()
    bench.until(lambda _: not bench.supply.supplying)


MISHAPS = [
    a_protection_trips,
    it_goes_out_of_regulation,
    it_does_not_switch_off,
    an_answer_is_garbled,
    bytes_are_lost,
    the_connection_is_replaced,
    it_is_switched_off_in_the_middle_of_a_question,
]


@pytest.mark.parametrize("mishap", MISHAPS, ids=lambda mishap: mishap.__name__)
@pytest.mark.parametrize(("model", "number"), SERVED)
def test_other_outputs_are_untouched_from_opening_to_closing_whatever_happens(model, number, mishap):
    bench = made(model, number)
    bench.far.use_others()
    bench.far.select(1 if number > 1 else 2)  # as somebody has left it
    others = bench.far.others()
    bench.supply.open()
    bench.supply.protect(4.5)
    bench.supply.supply(5.0, 0.8)
    bench.supply.switch_on()
    bench.rows(2)
    assert bench.far.output()[0] is True
    bench.supply.protect(3.0)
    bench.supply.supply(2.5, 0.5)
    bench.rows(2)
    assert bench.far.others() == others
    mishap(bench)
    assert bench.far.others() == others
    assert bench.made_safe().safe
    bench.supply.close()
    assert bench.far.output() == [False, 0.0, 0.0]
    assert bench.far.others() == others


@pytest.mark.parametrize(("model", "number"), SERVED)
def test_a_command_cut_anywhere_and_ended_by_off_lands_on_no_other_output(model, number):
    bench = made(model, number)
    bench.supply.open()
    bench.supply.protect(4.5)
    bench.supply.supply(5.0, 0.8)
    bench.supply.switch_on()
    bench.rows()
    bench.supply.stop_now()
    bench.supply.close()
    commands = [line for line in bench.lines() if b"?" not in line and line]
    assert len(commands) >= 7
    off = bench.supply._dialogue.off
    for at, command in enumerate(commands):
        for cut in range(len(command) + 1):
            far = FailingSupplyEnd(dialect_of(model), model, "0", number)
            far.use_others()
            far.select(1 if number > 1 else 2)
            others = far.others()
            far.receive(b"".join(line + b"\n" for line in commands[:at]) + command[:cut] + off, 0.0)
            assert far.others() == others, command[:cut]
            assert far.output()[0] is False


def test_what_happens_at_another_output_is_none_of_this_one_s_faults():
    bench = SupplyBench(**DP832)
    bench.far.use_others()
    bench.energise(5.0, 0.9)
    other = bench.far.outputs[0]
    other.over_voltage.tripped, other.on = True, False
    assert [row.fault for row in bench.rows(3)] == ["", "", ""]


# -- what is read back and refused -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "deaf", "complaint"),
    [
        (E36300, "VOLT:PROT 5", "VOLT:PROT holds 27.5 after 5.5 was written"),
        (E36300, "VOLT 0", "VOLT holds 3 after 0 was written"),
        (E36300, "INST:NSEL 2", "output 1 is selected after INST:NSEL 2"),
        (DP832, "OUTP:OVP:VAL CH2", "OUTP:OVP:VAL holds 33 after 5.5 was written"),
        (DP832, "OUTP:OCP:VAL CH2", "OUTP:OCP:VAL holds 3.3 after 1 was written"),
        (DP832, "SOUR2:VOLT 0", "SOUR2:VOLT holds 3 after 0 was written"),
        (SPD3303, "CH2:CURRent 0", "CH2:CURRent holds 1 after 0 was written"),
    ],
)
def test_a_setting_that_does_not_stick_is_refused(settings, deaf, complaint):
    bench = SupplyBench(**settings)
    bench.far.leave_on(3.0, 1.0)
    bench.far.ignore(deaf)
    with pytest.raises(DeviceError) as refused:
        bench.supply.open()
    assert str(refused.value) == f"supply: {complaint}"


@pytest.mark.parametrize(("settings", "header"), [(DP832, "OUTP:OVP CH2,ON"), (DP832, "OUTP:OCP CH2,ON")])
def test_a_protection_that_stays_off_is_refused(settings, header):
    bench = SupplyBench(**settings)
    bench.far.protect_itself(33.0, False, 3.3, False)
    bench.far.ignore(header)
    with pytest.raises(DeviceError, match="protection does not stay on"):
        bench.supply.open()


@of_each_family
def test_on_is_read_back_from_that_output(family):
    bench = SupplyBench(**SEVERAL[family])
    bench.far.use_others()  # on, which is no answer for this one
    bench.supply.open()
    bench.far.ignore(COMMANDS[family][-2].decode())
    bench.supply.switch_on()
    with pytest.raises(DeviceFault, match="supply: the output does not switch on"):
        bench.until(lambda _: False)


@of_each_family
@pytest.mark.parametrize(
    ("admits", "detail"),
    [(True, "the output is still on"), (False, "the instrument reports its output off, but 0.900 A flow")],
)
def test_an_output_that_stays_on_is_not_called_safe(family, admits, detail):
    bench = SupplyBench(**SEVERAL[family])
    bench.energise(5.0, 0.9)
    bench.far.stuck_on(admits)
    confirmed = bench.made_safe()
    assert not confirmed.safe
    assert detail in confirmed.detail


def ocp_on(far):
    far.fed.over_current.armed = True


def coupled(far):
    far.coupled = True


def tracking(far):
    far.tracking = True


INDEPENDENT = "set them independent at the instrument"


@pytest.mark.parametrize(
    ("settings", "state", "complaint"),
    [
        (
            E36300,
            ocp_on,
            "over-current protection is on, and would trip as soon as the output regulates its current: switch it off"
            " at the instrument",
        ),
        (E36300, coupled, f"its outputs are switched or set together: {INDEPENDENT}"),
        (E36300, tracking, f"its outputs are switched or set together: {INDEPENDENT}"),
        (DP832, coupled, f"its outputs are switched together: {INDEPENDENT}"),
        (DP832, tracking, f"the voltages of outputs 1 and 2 follow each other: {INDEPENDENT}"),
        (SPD3303, coupled, f"its outputs are in series or in parallel: {INDEPENDENT}"),
    ],
)
def test_outputs_that_act_on_each_other_are_refused_before_a_level_is_set(settings, state, complaint):
    bench = SupplyBench(**settings)
    state(bench.far)
    with pytest.raises(DeviceError) as refused:
        bench.supply.open()
    assert str(refused.value) == f"supply: {complaint}"
    assert not any(re.match(rb"(SOUR2:|CH2:|)(VOLT|CURR)\w* ", line) for line in bench.lines())


def test_an_output_that_tracks_nothing_is_asked_for_its_switch_alone():
    bench = made("DP832", 3)
    bench.far.tracking = True
    bench.supply.open()
    assert not any(line.startswith(b"OUTP:TRAC") for line in bench.lines())


def test_an_e36311a_is_not_asked_for_pairs_that_it_lacks():
    bench = made("E36311A", 2)
    bench.supply.open()
    assert b"OUTP:PAIR?" not in bench.lines()
    assert bench.supply.notices() == [
        "has no over-current protection that can be set; current_limit_A only limits what is commanded"
    ]


def test_a_current_below_the_least_of_an_e36300_is_set_to_that():
    bench = SupplyBench(**E36300)
    bench.energise(5.0, 0.0)
    assert bench.far.levels()[:2] == [5.0, 0.002]


def test_the_protection_of_an_e36300_trips_by_itself_and_is_told():
    bench = SupplyBench(**E36300)
    bench.energise(5.0, 0.9)  # 0.54 V at 0.6 ohm
    bench.far.fed.over_voltage.level = 0.4
    row = bench.until(lambda rows: rows and rows[-1].fault)[-1]
    assert row.fault == "supply: over-voltage protection has tripped"


def test_a_supply_without_protections_says_so_and_no_run_counts_on_one():
    bench = SupplyBench(**SPD3303)
    bench.supply.open()
    assert bench.supply.notices() == [
        "has no over-voltage protection that can be set; voltage_limit_V only limits what is commanded",
        "has no over-current protection that can be set; current_limit_A only limits what is commanded",
    ]
    for settings, counted in (SPD3303, False), (E36300, False), (DP832, True):
        level = SupplyBench(**settings).supply.trip_accuracy.level_below(5.0)
        assert math.isfinite(level) is counted


@pytest.mark.parametrize("answer", [b"0x2\n", b"0x24", b"24\n", b"0x\n", b"\n"])
def test_a_status_that_lost_a_digit_is_no_state(answer):
    bench = SupplyBench(**SPD3303)
    bench.energise(5.0, 0.9)
    bench.until(lambda _: b"SYSTem:STATus?" in bench.said)
    bench.far.spoil(answer.hex())
    assert [row.fault for row in bench.rows(2)] == ["", ""]
    assert [text for text in bench.supply.notices() if text.startswith("a round was lost")]


@pytest.mark.parametrize(("register", "mode"), [(b"+257\n", "current"), (b"+258\n", "voltage")])
def test_higher_bits_of_an_output_s_register_do_not_hide_how_it_regulates(register, mode):
    bench = SupplyBench(**E36300)
    bench.supply.open()
    bench.supply.supply(5.0, 0.9)
    bench.supply.switch_on()
    bench.until(lambda _: b"ISUM2:COND?" in bench.said)
    bench.far.spoil(register.hex())
    assert bench.rows()[0].fault == ""
    assert any(text.startswith(f"constant {mode}") for text in bench.supply.notices())


def test_errors_of_an_spd3303_are_read_in_its_own_form():
    bench = SupplyBench(**SPD3303)
    bench.far.receive(b"MEAS:POW? CH2\n", 0.0)
    bench.supply.open()
    assert "had an error from before: -113, Undefined header" in bench.supply.notices()


# -- settings --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"dialect": "dp800", "model": "DP832"}, "output is missing: DP832 has several, 1 to 3 was expected"),
        ({"dialect": "e36300", "model": "E36313A"}, "output is missing: E36313A has several, 1 to 3 was expected"),
        (DP832 | {"output": 4}, "output 4 of DP832 cannot be served; 1 to 3 was expected"),
        (DP832 | {"model": "DP831A", "output": 3}, "output 3 of DP831A cannot be served; 1 to 2 was expected"),
        (E36300 | {"model": "E36311A", "output": 3}, "output 3 of E36311A cannot be served; 1 to 2 was expected"),
        (SPD3303 | {"output": 3}, "output 3 of SPD3303X cannot be served; 1 to 2 was expected"),
        ({"output": 2}, "output 2 of E3633A cannot be served; 1 was expected"),
        ({"dialect": "dp800", "model": "DP811", "output": 2}, "output 2 of DP811 cannot be served; 1 was expected"),
        (
            {"dialect": "dp800", "model": "E36312A", "output": 2},
            "E36312A speaks e36300; dp800 was given as its dialect",
        ),
        (
            {"dialect": "spd3303", "model": "SPD3303C", "output": 1},
            "SPD3303C is no known model of spd3303; SPD3303X, SPD3303X-E are",
        ),
    ],
)
def test_an_output_that_is_missing_or_not_there_is_refused_in_one_line(settings, complaint):
    with pytest.raises(ValidationError) as refused:
        ScpiSupplySettings(**(HEATED | settings))
    [error] = refused.value.errors()
    assert error["msg"] == f"Value error, {complaint}"


def test_the_page_lists_the_models_with_their_outputs():
    rows = re.findall(r"^\| \S+ (.*) \| `(\w+)` \| (.*?) \|", README.read_text(), re.MULTILINE)
    listed = {
        model: (dialect, [int(number) for number in numbers.split(", ")])
        for several, dialect, numbers in rows
        for model in several.split(", ")
        if numbers[0].isdecimal()
    }
    assert listed == {model: (dialect_of(model), list(outputs)) for model, outputs in OUTPUTS.items()}


def test_the_only_output_may_be_named():
    bench = SupplyBench(output=1)
    bench.supply.open()
    assert b"OUTP OFF" in bench.lines()


def test_an_output_that_gives_less_than_it_is_said_to_regulate_is_a_fault(make_supply):
    bench = make_supply(**SEVERAL["spd3303"])
    bench.energise(3.0, 0.9)
    bench.far.lose_regulation(0.5)
    began = bench.clock.now()
    row = bench.until(lambda rows: rows and rows[-1].fault)[-1]
    assert row.fault == (
        "supply: out of regulation, 0.270 V and 0.450 A at constant voltage; 3.000 V and 0.900 A are set"
    )
    assert 1.0 <= bench.clock.now() - began < 2.0
