"""An Elmo drive at the end of a serial line: its interpreter's bytes, its dead-man, garbled and late answers."""

import json
import math
import os
import re
import subprocess
import sys

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from leactl_plugins.elmo.fault_names import bits_of, motor_fault, refusal
from leactl_plugins.elmo_can.emergency import describe
from leactl_plugins.elmo_recorder_csv.driver import ElmoRecorderCsv
from leactl_plugins.elmo_recorder_csv.settings import ElmoRecorderCsvSettings
from leactl_plugins.elmo_serial.interpreter import CommandRefused, Interpreter
from leactl_plugins.elmo_serial.outliers import Outliers
from leactl_plugins.elmo_serial.recorder import parse_upload
from leactl_plugins.elmo_serial.settings import ElmoSerialSettings
from leactl_plugins.elmo_serial.status import StatusRegister
from pydantic import ValidationError

from leactl.bench import benchfile
from leactl.driver.contract import Mode
from leactl.driver.conversation import Unreadable
from leactl.driver.serial_port import SerialPort
from leactl.emulation.clock import EmulatedClock
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer
from leactl.runner import own_recording
from leactl.runner.own_recording import save_recording
from tests.cli.answers import fits_the_page
from tests.cli.terminal import leactl

from .elmo_serial_bench import ElmoSerialBench
from .failing import COUNTS
from .transports import ROOT

CURRENT, VELOCITY, ANGLE, ENABLED = 3, 4, 5, 6


@pytest.fixture
def make_bench():
    made = []

    def make(**given_settings):
        made.append(ElmoSerialBench(**given_settings))
        return made[-1]

    yield make
    for bench in made:
        bench.drive.close()


@pytest.fixture
def bench(make_bench):
    bench = make_bench()
    bench.drive.open()
    bench.drive.notices()
    bench.cycle()
    return bench


def untagged(text):
    """An exchange without the number that marks it."""
    return re.sub(r"=[1-9][0-9]{2};", "=n;", text, count=1)


# -- the interpreter, as the manuals print it --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sent", "heard"),
    [
        (b"MO\r", b"MO\r0;"),  # Software Manual 3.1 and 3.2: a query, and the echo of every character at once
        (b"UM=2;", b"UM=2;;"),  # an assignment is answered by its terminator
        (b"EO=0;MO=0;UM=5;UM;", b"EO=0;;;;5;"),  # as in 5.2
        (b"XF=2;", b"XF=2;\x02?;"),  # Command Reference, EC 2: there is no XF command
        (b"UI[25];", b"UI[25];\x03?;"),  # EC 3: out of the vector's boundaries
        (b"A*=3;", b"A*=3;\x02?;"),
        (b"TC=1;", b"TC=1;\x0c?;"),  # EC 12: not in this unit mode
        (b"EO=0;MO;", b"EO=0;;0;"),
        (b"mo;", b"mo;\x02?;"),  # mnemonics are case sensitive
    ],
)
def test_the_emulator_answers_as_the_manuals_say(make_bench, sent, heard):
    assert make_bench().talk(sent) == heard


def test_the_number_of_the_last_error_is_told_in_letters(make_bench):
    bench = make_bench()
    bench.far.hold("EO", 0)
    assert bench.talk(b"EC;XF=2;EC;") == b"164;\x02?;2;"


def test_the_status_register_has_the_manuals_bits(bench):
    bench.engage(Mode.CURRENT)
    shown = int(bench.talk(b"SR;").removesuffix(b";"))
    assert shown & 1 << 4  # motor on
    assert shown >> 7 & 7 == 1  # unit mode
    assert shown & 1 << 12  # program running
    assert str(StatusRegister(shown)) == f"motor on, torque, program running, SR 0x{shown:X}"


class Script:
    """A far end that answers each write by the next of some bytes."""

    def __init__(self, clock, *answers):
        self.clock, self._answers, self._ready = clock, list(answers), b""
        self.said = b""

    def read(self, timeout):
        ready, self._ready = self._ready, b""
        if not ready:
            self.clock.sleep_until(self.clock.now() + timeout)
        return ready

    def write(self, data):
        self.said += data
        self._ready += self._answers.pop(0) if self._answers else b""
        return len(data)

    def close(self):
        pass


def scripted(*answers):
    clock = EmulatedClock()
    line = Script(clock, *answers)
    port = SerialPort(lambda: line, clock)
    port.open()
    return Interpreter(port, "UI[3]"), line


def test_an_exchange_ends_with_the_number_that_it_began_with():
    interpreter, line = scripted(b";0.25;-7;;101;")
    replies = interpreter.ask("IQ", "PX", "UM=1", within_s=0.1)
    assert line.said == b"UI[3]=101;IQ;PX;UM=1;UI[3];"
    assert (replies.number("IQ"), replies.integer("PX")) == (0.25, -7)


@pytest.mark.parametrize(
    ("answer", "number"),
    [
        (b";\x3a?;5;101;", 58),  # as drives are seen to send it
        (b";\x3a;?5;101;", 58),  # as the manual prints it
        (b";;?;5;101;", 59),  # the number is a semicolon itself
        (b";\x0d?;5;101;", 13),  # or a carriage return
    ],
)
def test_an_error_is_one_binary_byte_wherever_the_question_mark_stands(answer, number):
    interpreter, _line = scripted(answer)
    with pytest.raises(CommandRefused, match=f"^TC=1.000 is refused: error {number} ") as refused:
        interpreter.ask("TC=1.000", "UM", within_s=0.1)
    assert refused.value.number == number


@pytest.mark.parametrize(
    "answer",
    [
        b";0.25;100;",  # another exchange's number
        b";0.25101;",  # a semicolon is lost
        b"0.25;101;",
        b";;101;",  # nothing where a value belongs
        b"UI[3]=101;IQ;UI[3];",  # the echo alone
        b"",
    ],
)
def test_what_has_not_the_shape_of_the_exchange_is_no_answer(answer):
    interpreter, line = scripted(answer, b"", b"")
    with pytest.raises(NoAnswer, match=r"^no answer to IQ in 0.1 s$"):
        interpreter.ask("IQ", within_s=0.1)
    assert line.said == b"UI[3]=101;IQ;UI[3];!;UI[3]=102;IQ;UI[3];!;UI[3]=103;IQ;UI[3];"


def test_what_stands_before_an_answer_is_passed_over_and_counted():
    interpreter, _line = scripted(b"7;;;0.25;101;")
    assert interpreter.ask("IQ", within_s=0.1).number("IQ") == 0.25
    assert interpreter.surplus == 2


@pytest.mark.parametrize("value", [b"nan", b"1,5", b"0x10", b"1e999", b"--1", b"1.2.3"])
def test_a_value_that_is_no_number_is_refused(value):
    interpreter, _line = scripted(b";" + value + b";101;")
    with pytest.raises(Unreadable, match="where a number was expected"):
        interpreter.ask("IQ", within_s=0.1).number("IQ")


def test_a_command_that_was_garbled_on_its_way_is_sent_again():
    interpreter, _line = scripted(b";\x02?;101;", b";;102;")
    interpreter.ask("UM=1", within_s=0.1)


@given(st.lists(st.binary(max_size=40), max_size=4))
@settings(max_examples=300, deadline=None)
def test_no_bytes_make_the_interpreter_crash_or_wait_longer_than_it_may(answers):
    interpreter, line = scripted(*answers)
    began = line.clock.now()
    try:
        replies = interpreter.ask("IQ", "UM=1", within_s=0.1)
        replies.number("IQ")
    except DeviceError:
        pass
    else:  # by chance: only what has the exchange's own number
        assert any(f"{number};".encode() in b"".join(answers) for number in (101, 102, 103))
    assert line.clock.now() - began <= 0.3 + 1e-9


# -- opening -----------------------------------------------------------------------------------------------------------


def test_what_is_asked_at_the_opening(make_bench):
    bench = make_bench()
    bench.far.hold("EO", 0)
    bench.drive.open()
    sent = bytes(bench.said).decode("ascii")
    assert sent.startswith("!;UI[3]=101;MO=0;EO=0;HX=0;UI[3];UI[3]=102;VR;SN[4];UI[3];UI[3]=103;SR;MF;UI[3];")
    assert "UI[2]=280;UI[2];" in sent  # the program's time: 300 ms less two of its ticks
    assert bench.drive.identity() == ("Elmo Whistle", "1", "1.01.12.00 08Mar2018")
    assert "MO=1" not in sent


def test_the_echo_is_switched_off_and_given_back(make_bench):
    bench = make_bench()
    bench.drive.open()
    assert bench.far.values["EO"] == 0
    assert bench.drive.safe_state(1.0).safe
    bench.drive.close()
    assert bench.far.values["EO"] == 1


def test_a_drive_that_runs_is_stopped_first(make_bench):
    bench = make_bench()
    bench.far.run_away()
    assert bench.shaft.following == ("velocity", pytest.approx(5, rel=1e-4))
    with pytest.raises(DeviceError, match=r"^drive: no program runs in it \(bit 12 of SR 0x\w+\), and RS-232 has no"):
        bench.drive.open()
    assert bench.shaft.following[0] == "off"


def test_a_line_without_a_drive_is_told(make_bench):
    bench = make_bench()
    bench.far.freeze(True)
    with pytest.raises(NoAnswer, match=r"^drive: nothing answers as an Elmo's interpreter does in 0.9 s; cable, baud"):
        bench.drive.open()


def test_counts_that_contradict_the_bench_file_are_refused_with_both(make_bench):
    bench = make_bench()
    bench.far.hold("CA[18]", 10000)
    with pytest.raises(DeviceError, match=r"counts 10000 in a turn \(CA\[18\]\), the bench file says .*: 40000$"):
        bench.drive.open()


def test_a_latched_fault_is_refused_by_name_unless_the_settings_say_to_go_on(make_bench):
    bench = make_bench()
    bench.far.fault(0x7121)
    with pytest.raises(DeviceFault, match=r"in fault at start, MF 0x200000 \(motor stuck\); mend it, or set reset_"):
        bench.drive.open()
    forgiving = make_bench(reset_fault_at_start=True)
    forgiving.far.fault(0x7121)
    forgiving.drive.open()
    forgiving.engage(Mode.CURRENT)
    assert forgiving.far.fault_bits == 0


def test_a_drive_that_lacks_what_it_may_lack_is_met_all_the_same(make_bench):
    bench = make_bench(bus_voltage_command=None)
    for name in ("VL[2]", "VH[2]", "CA[18]"):
        bench.far.lack(name)
    bench.drive.open()
    bench.engage(Mode.VELOCITY)


def test_a_dead_man_that_cannot_be_armed_is_refused(make_bench):
    bench = make_bench()
    bench.far.ignore("UI[2]")
    with pytest.raises(DeviceError, match=r"its dead-man cannot be armed: UI\[2\] was set to 280 and reads 0$"):
        bench.drive.open()


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("counts_per_turn", 0),
        ("dead_man_ms", 50),
        ("dead_man_ms", 1001),
        ("first_variable", 23),
        ("bus_voltage_command", "AN[6];MO=1"),
        ("answer_timeout_s", 2.0),
        ("node", 1),
    ],
)
def test_settings_are_checked(key, value):
    with pytest.raises(ValidationError, match=key):
        ElmoSerialSettings(**({"counts_per_turn": COUNTS} | {key: value}))


# -- cycles ------------------------------------------------------------------------------------------------------------


def test_a_cycle_asks_first_and_then_sets(bench):
    bench.engage(Mode.CURRENT)
    bench.drive.command(2.0)
    bench.cycle()
    assert untagged(bench.exchange()).replace("AN[6];", "") == "UI[1]=n;IQ;VX;PX;SR;TC=1.633;TC;UI[1];"


def test_readings_are_the_machines(bench):
    bench.engage(Mode.CURRENT)
    bench.shaft.velocity, bench.shaft.angle = -3.0, 1.25
    bench.drive.command(2.0)
    bench.cycle()
    row = bench.cycle()
    assert bench.shaft.following == ("current", pytest.approx(2.0, abs=1e-3))
    assert row == [2.0, *[pytest.approx(math.nan, nan_ok=True)] * 2, *row[3:]]
    assert row[3:] == [
        pytest.approx(2.0, abs=2e-3),
        pytest.approx(-3.0, abs=1e-4),
        pytest.approx(1.25, abs=1e-4),
        1.0,
    ]


def test_a_turned_drive_turns_current_velocity_and_angle(make_bench):
    bench = make_bench(sign=-1)
    bench.drive.open()
    bench.shaft.velocity, bench.shaft.angle = 3.0, 0.5
    bench.engage(Mode.CURRENT)
    bench.drive.command(2.0)
    bench.cycle()
    row = bench.cycle()
    assert bench.shaft.following == ("current", pytest.approx(-2.0, abs=1e-3))
    assert row[3:6] == [
        pytest.approx(2.0, abs=2e-3),
        pytest.approx(-3.0, abs=1e-4),
        pytest.approx(-0.5, abs=1e-4),
    ]


def test_a_velocity_is_begun_once_and_held_against_what_was_sent(bench):
    bench.engage(Mode.VELOCITY)
    bench.drive.command(2 * math.pi)
    assert untagged(bench.exchange()).replace("AN[6];", "") == "UI[1]=n;IQ;VX;PX;SR;JV=40000;JV;BG;UI[1];"
    assert untagged(bench.exchange()).replace("AN[6];", "") == "UI[1]=n;IQ;VX;PX;SR;JV;UI[1];"
    assert bench.shaft.following == ("velocity", pytest.approx(2 * math.pi))


def test_an_angle_holds_where_the_shaft_is_and_goes_on_where_counts_go_round(make_bench):
    bench = make_bench()
    bench.far.hold("XM[1]", -20000)
    bench.far.hold("XM[2]", 20000)
    bench.drive.open()
    bench.shaft.angle = 3.0
    bench.engage(Mode.ANGLE)
    assert bench.shaft.following == ("angle", pytest.approx(3.0, abs=1e-3))
    bench.shaft.angle = 3.3  # past half a turn, where XM has it go round
    row = bench.cycle()
    assert row[ANGLE] == pytest.approx(3.3, abs=1e-3)
    bench.drive.command(3.4)
    assert "PA=-18355;PA;BG;" in bench.exchange()  # 3.4 rad less a turn
    assert bench.shaft.following == ("angle", pytest.approx(3.4, abs=1e-3))


def test_a_reference_stands_in_the_row_whose_reading_it_led_to(bench):
    bench.engage(Mode.VELOCITY)
    bench.drive.command(1.0)
    assert bench.cycle()[1] == 0.0
    bench.drive.command(2.0)
    assert bench.cycle()[1] == 1.0
    assert bench.cycle()[1] == 2.0


def test_demands_above_what_the_drive_lets_through_are_refused(make_bench):
    bench = make_bench()
    bench.far.hold("PL[1]", 10)
    bench.far.hold("VH[2]", 80000)
    bench.drive.open()
    bench.cycle()
    bench.engage(Mode.CURRENT)
    with pytest.raises(InputError, match=r"a demand of 12.5 A is above the 12.2474 A of the drive \(PL\[1\]\)"):
        bench.drive.command(12.5)
    bench.drive.release()
    bench.cycles(0.1)
    bench.engage(Mode.VELOCITY)
    with pytest.raises(InputError, match=r"20 rad/s is outside the drive's -2e\+09 to 80000 counts/s"):
        bench.drive.command(20.0)


def test_torque_profiles_are_refused(bench):
    with pytest.raises(InputError, match="mode 'torque_profile' is not one a drive can follow over this line"):
        bench.drive.engage(Mode.TORQUE_PROFILE)


def test_the_bus_voltage_comes_at_its_own_pace(bench):
    rows = []
    for _ in range(100):
        bench.cycle()
        rows += bench.drive.take()
    assert 4 <= len(rows) <= 6
    assert rows[0].values == (29.6,)


def test_a_current_that_the_drive_holds_down_is_told_once(make_bench):
    bench = make_bench()
    bench.far.hold("CL[1]", 1.0)
    bench.drive.open()
    bench.cycle()
    bench.engage(Mode.CURRENT)
    bench.drive.notices()
    bench.drive.command(5.0)
    bench.cycles(0.5)
    notices = bench.drive.notices()
    assert len(notices) == 1
    assert re.match(r"the drive holds its current down to CL\[1\], 1 A \(bit 13 of SR 0x", notices[0])


def test_a_rate_that_the_line_does_not_carry_is_refused_with_the_one_that_it_does(make_bench):
    bench = make_bench()
    bench.drive.open()
    notices = bench.drive.notices()
    assert re.match(r"a row's readings are taken one after another, within \d(\.\d)? ms after its time", notices[0])
    bench.drive.pace(0.01)
    with pytest.raises(DeviceError, match=r"takes [45](\.\d+)? ms on its line, a cycle .* leaves .*: 1\d\d Hz at"):
        bench.drive.pace(0.001)


# -- the dead-man ------------------------------------------------------------------------------------------------------


def test_nothing_is_demanded_before_the_program_has_switched_the_drive_off_by_itself(bench):
    bench.said.clear()
    bench.engage(Mode.CURRENT)
    sent = bytes(bench.said).decode("ascii")
    first, second = (found.start() for found in re.finditer("MO=1", sent))
    between = sent[first:second]
    assert "UI[1]=" not in between[: between.index("UI[1]=")] and "TC=0;" in between
    assert re.search(r"TC=(?!0;|0\.000;|-0\.000;)", sent) is None
    assert len(re.findall(r"UI\[3\]=", between)) >= 25  # for 280 ms in cycles of 10 ms


def test_a_second_operation_needs_no_second_proof(bench):
    bench.engage(Mode.CURRENT)
    bench.drive.release()
    bench.cycles(0.1)
    bench.said.clear()
    bench.engage(Mode.CURRENT)
    assert bytes(bench.said).count(b"MO=1") == 1


def test_a_program_that_does_not_switch_off_is_found_out_and_nothing_demanded(bench):
    bench.far._check_counter = lambda: None
    bench.drive.engage(Mode.CURRENT)
    began = bench.clock.now()
    with pytest.raises(DeviceError, match=r"its dead-man does not work: on for 0.30\d s .* in UI\[1\], 0.3 s were set"):
        bench.cycles(3.0)
    assert bench.clock.now() - began < 0.4
    assert b"TC=0;" in bench.said and b"TC=0.0" not in bench.said
    assert bench.drive.safe_state(1.0).safe


def test_a_host_that_falls_silent_leaves_no_current(bench):
    bench.engage(Mode.CURRENT)
    bench.drive.command(3.0)
    bench.cycles(1.0)
    assert bench.shaft.following[0] == "current"
    bench.clock.sleep_until(bench.clock.now() + 0.3)
    assert bench.shaft.following[0] == "off"


def test_cycles_that_nobody_supervised_are_no_sign_of_life(bench):
    bench.engage(Mode.CURRENT)
    bench.drive.command(3.0)
    bench.cycle(feed=False)
    with pytest.raises(DeviceFault, match="switched off without a fault: by the program in it, an input or another ho"):
        bench.cycles(0.4, feed=False)
    assert bench.shaft.following[0] == "off"


def test_a_program_that_ends_in_operation_ends_the_run(bench):
    bench.engage(Mode.CURRENT)
    bench.far.program_running = False
    with pytest.raises(DeviceFault, match="motor on, torque, no program running, SR 0x"):
        bench.cycles(0.1)


# -- faults ------------------------------------------------------------------------------------------------------------


def test_a_fault_is_told_by_the_bits_of_mf(bench):
    bench.engage(Mode.CURRENT)
    bench.far.fault(0x2340)
    with pytest.raises(DeviceFault, match=r"^drive: MF 0xB000 \(short circuit\)$"):
        bench.cycles(0.1)


@pytest.mark.parametrize("code", [0x7300, 0x8311, 0x5441, 0x3120, 0x3310, 0x2340, 0x7121, 0x8680, 0x5400])
def test_bits_and_codes_name_the_same_faults(code):
    from leactl_plugins.elmo.fault_names import CODES

    assert CODES[code] in motor_fault(bits_of(code))


@pytest.mark.parametrize(
    ("code", "name"), [(0x7306, "commutation failed"), (0xFF30, "modulo overflow"), (0xFF34, "numeric overflow")]
)
def test_codes_of_the_gold_line_have_names(code, name):
    frame = code.to_bytes(2, "little") + bytes.fromhex("20 00 00 00 00 00")
    assert describe(frame) == f"emergency 0x{code:04X} ({name}), register 0x20, drive code 0"


def test_an_unknown_number_is_told_as_it_is():
    assert refusal(254) == "error 254 (unnamed)"
    assert motor_fault(0) == "MF 0x0 (no fault)"
    assert motor_fault(0x9008) == "MF 0x9008 (peak current exceeded, power stage)"


def test_a_refusal_ends_the_run_by_its_name(bench):
    bench.far.refuse("MO", 66)
    bench.drive.engage(Mode.CURRENT)
    with pytest.raises(DeviceFault, match=r"^drive: MO=1 is refused: error 66 \(amplifier not ready\)$"):
        bench.cycles(0.2)


def test_a_drive_that_does_not_come_on_is_told(bench):
    bench.far.ignore("MO")
    bench.drive.engage(Mode.CURRENT)
    with pytest.raises(NoAnswer, match=r"not in operation after 3 s: motor off, torque, program running, SR 0x"):
        bench.cycles(4.0)


# -- late, lost and garbled --------------------------------------------------------------------------------------------


def test_a_late_answer_stands_in_no_row(bench):
    bench.engage(Mode.VELOCITY)
    bench.drive.notices()
    seen = []
    for number in range(60):
        bench.shaft.velocity = 0.5 * number
        if number == 20:
            bench.far._busy = bench.clock.now() + 0.006
        seen.append(bench.cycle()[VELOCITY])
    right = [not math.isnan(read) and abs(read - 0.5 * number) < 1e-3 for number, read in enumerate(seen)]
    assert right == [number not in (20, 21) for number in range(60)]
    bench.drive.release()
    assert bench.drive.notices() == [
        "1 answers came after their cycle, 0 were lost, 0 came unasked;"
        " a row holds none that is known to be of another cycle"
    ]


def test_a_lost_byte_costs_rows_and_no_run(bench):
    bench.engage(Mode.CURRENT)
    bench.drive.command(1.0)
    bench.cycles(0.1)
    once = iter([True])
    bench.to_host = lambda data: data.replace(b";", b"", 1) if data and next(once, False) else data
    rows = bench.cycles(0.6)
    empty = [math.isnan(row[CURRENT]) for row in rows]
    assert sum(empty) == 1


def test_a_demand_that_arrives_as_another_ends_the_run(bench):
    bench.engage(Mode.CURRENT)
    bench.drive.command(1.0)
    bench.cycle()
    bench.to_drive = lambda data: data.replace(b"TC=0.816", b"TC=9.816")
    with pytest.raises(DeviceFault, match=r"holds TC=9.816 where 0.816 was sent; the line garbles commands"):
        bench.cycle()


def test_commands_that_arrive_garbled_cost_a_row_each_and_the_third_in_a_row_the_run(bench):
    bench.engage(Mode.CURRENT)
    bench.cycle()
    bench.to_drive = lambda data: data.replace(b"VX", b"V!")
    assert math.isnan(bench.cycle()[VELOCITY])
    bench.to_drive = bytes
    assert not math.isnan(bench.cycle()[VELOCITY])
    bench.to_drive = lambda data: data.replace(b"VX", b"V!")
    bench.cycle()
    bench.cycle()
    with pytest.raises(DeviceError, match=r"VX was not understood: error 2 \(bad command\); 3 exchanges in a row"):
        bench.cycle()


def test_a_line_that_was_pulled_out_is_told_and_the_drive_stops_by_itself(bench):
    bench.engage(Mode.CURRENT)
    bench.drive.command(1.0)
    bench.cycle()
    bench.unplugged = True
    with pytest.raises(DeviceError, match="the device is gone"):
        bench.cycles(0.1)
    assert not bench.drive.safe_state(0.5).safe
    assert bench.shaft.following[0] == "off"


# letters would make another query of one, as PA of PX
NOT_IN_A_NUMBER = st.sampled_from([byte for byte in range(256) if not chr(byte).isalnum() and chr(byte) not in "+-."])
PLACES = st.integers(0, 400)


@given(
    st.lists(st.tuples(PLACES, st.sampled_from(["replace", "insert"]), NOT_IN_A_NUMBER), min_size=1, max_size=6),
    st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_no_noise_beside_digits_gives_a_wrong_row_and_none_holds_the_loop_up(noise, towards_drive):
    bench = ElmoSerialBench()
    bench.drive.open()
    bench.engage(Mode.CURRENT)
    bench.drive.command(1.5)
    bench.cycle()
    hits = sorted(noise, reverse=True)
    place = [0]

    def spoil(data):
        spoilt = bytearray(data)
        while hits and hits[-1][0] < place[0] + len(data):
            at, what, byte = hits.pop()
            at = max(0, at - place[0])
            spoilt[at : at + (what == "replace")] = bytes((byte,))
        place[0] += len(data)
        return bytes(spoilt)

    if towards_drive:
        bench.to_drive = spoil
    else:
        bench.to_host = spoil
    try:
        for number in range(40):
            bench.shaft.velocity, bench.shaft.angle = 0.1 * number, 0.01 * number
            began = bench.clock.now()
            row = bench.cycle()
            assert bench.clock.now() - began == pytest.approx(0.01)
            assert math.isnan(row[VELOCITY]) or abs(row[VELOCITY] - 0.1 * number) < 1e-3
            assert math.isnan(row[ANGLE]) or abs(row[ANGLE] - 0.01 * number) < 1e-3
            assert math.isnan(row[CURRENT]) or min(abs(row[CURRENT] - 1.5), abs(row[CURRENT])) < 2e-3  # or it is off
    except DeviceError:
        pass  # which ends a run and is told
    bench.to_host = bench.to_drive = bytes
    assert bench.drive.safe_state(1.0).safe
    assert bench.shaft.following[0] == "off"


def test_a_digit_that_arrives_as_another_is_told_by_the_rows_beside_it(bench, monkeypatch):
    bench.engage(Mode.VELOCITY)
    bench.drive.notices()
    for number in range(30):
        bench.shaft.velocity, bench.shaft.angle = 2.0, 4.0 + 0.02 * number
        with monkeypatch.context() as garbled:
            if number == 20:
                garbled.setattr(bench.far, "_wrapped_position", lambda: 78011)  # in place of 28011
            row = bench.cycle()
        assert not math.isnan(row[ANGLE])
    assert bench.drive.notices() == [
        "angle [rad] of 12.2539 between 4.38001 and 4.42006: a digit may have been garbled on the line;"
        " 1 readings so far"
    ]


def test_a_step_and_a_ramp_are_no_outliers():
    outliers = Outliers([("current", 0.5)])
    assert [outliers.add([value]) for value in (0, 0, 9, 9, 8, 7, 0, math.nan, 0, 0)] == [None] * 10
    assert outliers.count == 0


# -- the safe state ----------------------------------------------------------------------------------------------------


def test_stop_now_ends_what_was_half_sent_and_waits_for_nothing(bench):
    bench.engage(Mode.CURRENT)
    bench.said.clear()
    began = bench.clock.now()
    bench.drive.stop_now()
    assert bytes(bench.said) == b"!;MO=0;"
    assert bench.clock.now() == began


@pytest.mark.parametrize("state", ["reboot", "run_away"])
def test_the_safe_state_is_confirmed_by_reading_back_whatever_the_drive_has_been_through(bench, state):
    bench.engage(Mode.CURRENT)
    getattr(bench.far, state)()
    began = bench.clock.now()
    confirmed = bench.drive.safe_state(1.0)
    assert confirmed.safe
    assert re.match(r"motor off, \w+, (no )?program running, SR 0x", confirmed.detail)
    assert bench.clock.now() - began < 0.5
    assert bench.shaft.following[0] == "off"


def test_a_command_that_was_cut_short_is_not_carried_out_by_what_comes_after_it(bench):
    bench.engage(Mode.CURRENT)
    bench.drive.release()
    bench.cycles(0.05)
    bench.wire.wire.from_host(b"MO=1")
    bench.clock.sleep_until(bench.clock.now() + 0.01)
    switched = []
    switch = bench.far._switch
    bench.far._switch = lambda on, now=0.0: (switched.append(on), switch(on, now))
    bench.drive.stop_now()
    bench.clock.sleep_until(bench.clock.now() + 0.01)
    assert switched == []


def test_a_speed_that_no_counter_holds_is_refused_where_the_drive_tells_no_limit(make_bench):
    bench = make_bench()
    bench.far.lack("VH[2]")
    bench.drive.open()
    bench.cycle()
    bench.engage(Mode.VELOCITY)
    with pytest.raises(InputError, match=r"outside the drive's -2e\+09 to 2.14748e\+09 counts/s"):
        bench.drive.command(1e12)


def test_a_drive_that_stays_on_is_not_confirmed(bench):
    bench.engage(Mode.CURRENT)
    bench.far.ignore("MO")
    confirmed = bench.drive.safe_state(0.15)
    assert not confirmed.safe
    assert re.match(r"not confirmed within 0.15 s: still on: motor on, torque", confirmed.detail)


def test_answers_to_earlier_questions_confirm_nothing(bench):
    bench.engage(Mode.CURRENT)
    stale = bench.talk(b"UI[3]=100;MO=0;EO=0;MO;SR;UI[3];")
    bench.far.freeze(True)
    bench.to_host = lambda data: data or stale
    assert not bench.drive.safe_state(0.5).safe


# -- the same over a pseudo terminal -----------------------------------------------------------------------------------


def test_a_drive_in_another_process_is_met_moved_and_stopped(make_serial_drive):
    bench = make_serial_drive(dead_man_ms=1000, answer_timeout_s=0.5)
    bench.drive.open()
    bench.engage(Mode.CURRENT)
    bench.drive.command(2.0)
    bench.cycle()
    bench.cycle()
    assert bench.far.follows() == ["current", pytest.approx(2.0, abs=1e-3)]
    assert bench.drive.safe_state(1.0).safe
    assert bench.far.follows()[0] == "off"
    assert json.dumps(bench.drive.identity()) == '["Elmo Whistle", "1", "1.01.12.00 08Mar2018"]'


# -- the drive's own recorder ------------------------------------------------------------------------------------------


def test_an_upload_is_read_as_the_manual_takes_it_apart():
    upload = parse_upload("0008000100013f80000000010000")  # Command Reference of the steppers' line, BH
    assert (upload.values.tolist(), upload.gap) == ([65536.0], 1)
    assert parse_upload("000400020003" + "3c000000" + "ab12" + "0001").values.tolist() == [-21742 / 128, 1 / 128]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a recording of 0 characters; at least 20 hexadecimal digits were expected"),
        ("0008000100013f8000000001000", "of 0.875 items where its head says 1"),
        ("0008000100013f80000000010000ff", "of 1.25 items where its head says 1"),
        ("0006000100013f80000000010000", "items of 6 digits; 4 or 8 were"),
        ("0008000100017f80000000010000", "with the factor inf and a gap of 1"),
        ("000800010001zz80000000010000", "a recording of 28 characters; at least 20 hexadecimal digits were expected"),
    ],
)
def test_an_upload_that_is_not_whole_is_refused(text, message):
    with pytest.raises(Unreadable, match=message):
        parse_upload(text)


@given(st.text(st.sampled_from("0123456789abcdef"), max_size=80))
def test_digits_of_any_kind_are_a_recording_or_refused(text):
    try:
        upload = parse_upload(text)
    except Unreadable:
        return
    assert len(text) == 20 + int(text[2:4], 16) * len(upload.values)


def test_the_recorder_is_uploaded_signal_by_signal(bench):
    bench.shaft.velocity, bench.shaft.angle = 2.0, 0.5
    bench.far.hold("RC", 0b1000000011)
    bench.far.hold("RG", 5)
    bench.far.hold("RL", 40)
    bench.engage(Mode.CURRENT)
    bench.drive.command(3.0)
    bench.cycle()
    with pytest.raises(
        DeviceError,
        match=r"^drive: its recorder holds nothing \(RR is -1\); a complete recording, RR of 0, was expected",
    ):
        bench.drive.recorded()
    bench.talk(b"RR=2;")
    assert bench.drive.safe_state(1.0).safe
    recording = bench.drive.recorded()
    assert recording.headings == ("VX (counts/s)", "PX (counts)", "IQ (A)")
    assert recording.interval == pytest.approx(5e-4)
    assert recording.values.shape == (40, 3)
    assert recording.values[0].tolist() == [12732.0, 3183.0, pytest.approx(3.0 / math.sqrt(1.5), abs=0.008)]


def test_an_upload_with_a_byte_missing_is_refused(bench):
    bench.far.hold("RC", 1)
    bench.talk(b"RR=2;")
    once = iter([True])
    bench.to_host = lambda data: data[1:] if len(data) > 8 and b";" not in data and next(once, False) else data
    with pytest.raises(DeviceError, match=r"^drive: a recording of 1023.88 items where its head says \d+$"):
        bench.drive.recorded()


HOST = """
import sys
from tests.driver.elmo_serial_bench import ElmoSerialBench
from tests.driver.transports import SerialToLine
from leactl.driver.contract import Mode
bench = ElmoSerialBench(wire=SerialToLine(sys.argv[1]), dead_man_ms=1000, answer_timeout_s=0.5)
bench.drive.open()
bench.engage(Mode.CURRENT)
bench.drive.command(2.0)
while True:
    bench.cycle()
    if bench.drive.values[0] == 2.0:
        print("moving", flush=True)
"""


def test_a_host_that_is_killed_leaves_a_drive_that_switches_itself_off(make_serial_drive):
    bench = make_serial_drive()
    with subprocess.Popen([sys.executable, "-c", HOST, bench.place], cwd=ROOT, stdout=subprocess.PIPE) as host:
        try:
            assert host.stdout.readline() == b"moving\n"
            assert bench.far.follows()[0] == "current"
        finally:
            host.kill()
    began = bench.clock.now()
    while bench.far.follows()[0] != "off":
        assert bench.clock.now() - began < 10.0


def recorded_bench(bench, tmp_path):
    """Record 50 samples of three signals, and write the bench file that leads to the drive; gives its path."""
    bench.far.hold("RC", 0b1000000011)
    bench.far.hold("RL", 50)
    bench.talk(b"RR=2;")
    bench.drive.close()
    data = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
    del data["emulated"]
    data["name"] = f"recorded-{os.getpid()}"
    data["buses"]["can0"]["interface"] = "socketcan"
    data["buses"]["line"] = {"kind": "serial", "port": bench.place, "baudrate": 115200}
    data["devices"]["drive_test"] |= {
        "driver": "elmo_serial",
        "bus": "line",
        "settings": {"counts_per_turn": COUNTS, "answer_timeout_s": 0.5},
    }
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def test_a_recording_is_saved_as_a_table_that_the_importer_reads(make_serial_drive, tmp_path):
    path, target, trace = recorded_bench(make_serial_drive(), tmp_path), tmp_path / "step.csv", tmp_path / "step.trace"
    words = "bench", "recording", "drive_test", str(path), "--out", str(target), "--trace", str(trace), "--json"
    done = leactl(*words)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer == {"file": str(target), "columns": answer["columns"], "rows": 50, "interval_s": pytest.approx(1e-4)}
    assert answer["columns"] == ["VX (counts/s)", "PX (counts)", "IQ (A)"]
    fits_the_page("A recording of a drive", answer)
    signals = {
        "speed": {"column": "VX", "quantity": "velocity"},
        "place": {"column": "PX", "quantity": "angle"},
        "current": {"column": "IQ", "quantity": "q_axis_current"},
    }
    settings_of_importer = ElmoRecorderCsvSettings(signals=signals, time_column="Time", counts_per_turn=COUNTS)
    importer = ElmoRecorderCsv("recorder", "test", settings_of_importer, None, None)
    record = importer.read_files([target])
    assert record.values.shape == (50, 3)
    assert record.values[0, 1] == pytest.approx(0.25, abs=1e-4)  # where the shaft stands
    assert record.time[-1] == pytest.approx(49e-4)
    with pytest.raises(InputError, match="exists already and is never overwritten"):
        save_recording(str(path), "drive_test", target)
    replayed = leactl("driver", "replay", str(trace), "--bench", str(path))
    assert (replayed.returncode, "drive_test = recorded []" in trace.read_text()) == (0, True), replayed.stderr


@pytest.mark.parametrize("count", [1, 3])
def test_a_drive_that_falls_silent_while_it_is_uploaded_is_told_and_a_complete_recording_kept(
    make_serial_drive, tmp_path, count
):
    bench = make_serial_drive()
    path, target = recorded_bench(bench, tmp_path), tmp_path / "step.csv"
    bench.far.fall_silent("BH", count)
    done = leactl("bench", "recording", "drive_test", str(path), "--out", str(target))
    assert done.returncode == 5, done.stderr
    assert "leactl: NOT CONFIRMED SAFE, switch off the supply: drive_test: " in done.stderr
    assert target.exists() == (count == 3)
    if count == 3:
        assert f"its recording is complete and was saved: {target}" in done.stderr
        assert len(target.read_text().splitlines()) == 51
    else:
        assert "leactl: drive_test: no answer to " in done.stderr


def test_what_is_not_confirmed_safe_is_told_too_where_the_recording_cannot_be_written(
    make_serial_drive, tmp_path, monkeypatch
):
    bench = make_serial_drive()
    path, target = recorded_bench(bench, tmp_path), tmp_path / "step.csv"
    bench.far.fall_silent("BH", 3)
    make_table = own_recording._table

    def table_while_another_takes_the_name(recording):
        target.write_bytes(b"")
        return make_table(recording)

    monkeypatch.setattr(own_recording, "_table", table_while_another_takes_the_name)
    with pytest.raises(InputError, match="exists already") as refused:
        save_recording(str(path), "drive_test", target)
    assert refused.value.__notes__[0].startswith("NOT CONFIRMED SAFE, switch off the supply: drive_test: ")


def test_a_folder_that_is_not_there_is_refused_before_the_drive_is_touched(make_serial_drive, tmp_path):
    bench = make_serial_drive()
    path = recorded_bench(bench, tmp_path)
    bench.far.fall_silent("BH", 1)
    done = leactl("bench", "recording", "drive_test", str(path), "--out", str(tmp_path / "none" / "step.csv"))
    assert (done.returncode, done.stderr) == (2, f"leactl: {tmp_path}/none/step.csv: no folder {tmp_path}/none\n")
