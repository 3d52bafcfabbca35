"""A moteus controller at the wire: golden bytes, the time of a command, faults that latch, answers that are none."""

import math
import struct

import pytest
from leactl_plugins.moteus_can.emulator import MoteusEmulator
from leactl_plugins.moteus_can.multiplex import parse
from leactl_plugins.moteus_can.registers import TORQUE_FACTOR, Register

from leactl.driver.contract import Identity, Mode
from leactl.driver.far_end import FdFrame
from leactl.driver.safe_state import make_safe
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer

from .failing import Shaft
from .moteus_bench import CONSTANT, FROM_DRIVE, NODE, PERIOD_S, TO_DRIVE, MoteusBench

AMPLITUDE = math.sqrt(2 / 3)
HOME_POSITION = bytes.fromhex("01000a0c0620")  # the mode as int8, then six floats from register 0x020 on
TIMES = bytes.fromhex("0f27")  # three floats from register 0x027 on
QUESTION = bytes.fromhex("1d10 1100 1c0401 110f 1d27")


@pytest.fixture
def make_moteus():
    """Make a controller's bench with these settings; it is let go at the end."""
    made = []

    def make(**settings):
        made.append(MoteusBench(**settings))
        return made[-1]

    yield make
    for bench in made:
        bench.drive.close()


@pytest.fixture
def moteus_bench(make_moteus):
    """A controller that is open."""
    bench = make_moteus()
    bench.drive.open()
    bench.cycle()
    return bench


def floats(data, at, count):
    return struct.unpack_from(f"<{count}f", data, at)


def test_a_torque_is_position_mode_with_its_loops_switched_off(make_moteus):
    bench = make_moteus(supply_period_s=60)  # seldom: one question in a while has it in place of the time-out
    bench.drive.open()
    bench.engage(Mode.CURRENT)
    bench.cycle()
    bench.drive.command(4.9)
    bench.cycle()
    sent = bench.commands()[-1]
    assert sent[:6] == HOME_POSITION
    position, velocity, torque, kp, kd, most = floats(sent, 6, 6)
    assert math.isnan(position)
    assert math.isnan(most)
    assert (velocity, kp, kd) == (0.0, 0.0, 0.0)
    assert torque == pytest.approx(4.9 * AMPLITUDE * CONSTANT, rel=1e-6)
    assert sent[30:32] == TIMES
    assert floats(sent, 32, 3) == (pytest.approx(0.1), -1.0, -1.0)  # s, no limit of velocity, none of acceleration
    assert sent[44:47] == bytes.fromhex("012b00")  # no integral either
    assert sent[47:49] == bytes.fromhex("0d10")  # the number of the question
    assert sent[53:] == QUESTION
    assert len(sent) == 64
    assert bench.shaft.following == ("current", pytest.approx(4.9, rel=1e-6))
    assert bench.cycle()[3] == pytest.approx(4.9, rel=1e-6)


def test_a_velocity_goes_on_from_where_the_shaft_is_in_revolutions_a_second(moteus_bench):
    moteus_bench.engage(Mode.VELOCITY)
    moteus_bench.drive.command(-2.5 * 2 * math.pi)
    moteus_bench.cycle()
    sent = moteus_bench.commands()[-1]
    position, velocity, torque, kp, kd, _most = floats(sent, 6, 6)
    assert math.isnan(position)
    assert (velocity, torque, kp, kd) == (-2.5, 0.0, 1.0, 1.0)
    assert sent[44:47] == bytes.fromhex("012b7f")
    assert moteus_bench.shaft.following == ("velocity", pytest.approx(-5 * math.pi))


def test_an_angle_holds_where_the_shaft_is(moteus_bench):
    moteus_bench.shaft.angle = 0.7
    moteus_bench.engage(Mode.ANGLE)
    assert moteus_bench.shaft.following == ("angle", pytest.approx(0.7, abs=1e-6))
    moteus_bench.drive.command(-0.3)
    moteus_bench.cycle()
    assert floats(moteus_bench.commands()[-1], 6, 2) == (pytest.approx(-0.3 / (2 * math.pi), rel=1e-6), 0.0)


def test_a_turned_and_geared_drive_turns_and_gears_what_belongs_to_the_output(make_moteus):
    bench = make_moteus(sign=-1)
    bench.far.parameters["motor_position.rotor_to_output_ratio"] = 0.125
    bench.drive.open()
    bench.shaft.velocity, bench.shaft.angle = 3.0, 0.5
    bench.engage(Mode.CURRENT)
    bench.drive.command(2.0)
    bench.cycle()
    row = bench.cycle()
    assert floats(bench.commands()[-1], 14, 1)[0] == pytest.approx(-2.0 * AMPLITUDE * CONSTANT / 0.125, rel=1e-6)
    assert bench.shaft.following == ("current", pytest.approx(-2.0))
    assert row[3:6] == [pytest.approx(2.0), pytest.approx(-3.0), pytest.approx(-0.5)]


def test_a_reference_stands_in_the_row_whose_reading_it_led_to(moteus_bench):
    moteus_bench.engage(Mode.VELOCITY)
    moteus_bench.drive.command(1.0)
    assert moteus_bench.cycle()[1] == 0.0
    moteus_bench.drive.command(2.0)
    assert moteus_bench.cycle()[1] == 1.0
    assert moteus_bench.cycle()[1] == 2.0


def test_a_mode_is_left_by_way_of_stopped(moteus_bench):
    moteus_bench.engage(Mode.VELOCITY)
    moteus_bench.drive.command(4.0)
    moteus_bench.cycles(0.05)
    moteus_bench.tape.clear()
    moteus_bench.drive.engage(Mode.CURRENT)  # without a word of release
    moteus_bench.cycle()
    assert moteus_bench.tape[0].data[:3] == bytes.fromhex("010000")
    assert moteus_bench.shaft.following[0] == "off"
    moteus_bench.cycles(0.2)
    assert moteus_bench.drive.engaged
    assert moteus_bench.shaft.following == ("current", 0.0)


def test_a_mode_that_a_moteus_has_not_is_refused(moteus_bench):
    with pytest.raises(
        InputError, match="mode 'torque_profile' is none that a moteus follows: current, velocity, angle"
    ):
        moteus_bench.drive.engage(Mode.TORQUE_PROFILE)


# -- dead-man -------------------------------------------------------------------------------------------------------


def test_a_command_that_is_not_renewed_stops_the_controller_in_the_time_asked_for(make_moteus):
    bench = make_moteus(watchdog_ms=150)
    bench.drive.open()
    assert bench.far.parameters["servo.timeout_mode"] == 0
    bench.cycle()
    bench.engage(Mode.CURRENT)
    bench.drive.command(5.0)
    bench.cycles(0.1)
    began = bench.clock.now()
    while bench.shaft.following[0] != "off":
        bench.clock.sleep_until(bench.clock.now() + 0.001)
        assert bench.clock.now() - began < 1.0
    assert 0.1 < bench.clock.now() - began <= 0.151
    with pytest.raises(DeviceFault, match=r"no command came for 150 ms and it has stopped by itself: mode 11"):
        bench.cycles(0.1)


def test_a_controller_that_has_restarted_since_it_was_opened_is_not_engaged(moteus_bench):
    moteus_bench.far.restart()
    moteus_bench.drive.engage(Mode.CURRENT)
    with pytest.raises(DeviceFault, match=r"drive: servo\.timeout_mode is 12 although 0 was set when it was opened"):
        moteus_bench.cycles(3.0)
    assert moteus_bench.commands() == []


def test_the_time_out_mode_is_read_back_again_where_text_is_lost_or_left(moteus_bench):
    far, polled = moteus_bench.far, []

    def passes(frame, source):
        if source and frame.data[:2] == b"\x41\x01":
            polled.append(frame)
            return None if len(polled) == 3 else 0.0  # the first has what was left, the second nothing
        return 0.0

    moteus_bench.wire.disturb(passes)
    far._text = b"12.0\r\n"  # of a question that somebody else has asked
    moteus_bench.engage(Mode.CURRENT)
    assert len(polled) == 5


@pytest.mark.parametrize(("period", "watchdog_ms"), [(1 / 15, 200), (1 / 30, 100), (1 / 3, 1000)])
def test_a_loop_that_is_slower_than_the_query_enters_operation_too(monkeypatch, period, watchdog_ms):
    monkeypatch.setattr("tests.driver.moteus_bench.PERIOD_S", period)
    bench = MoteusBench(watchdog_ms=watchdog_ms)
    bench.drive.open()
    bench.drive.engage(Mode.CURRENT)
    for _ in range(6):
        bench.cycle()
    assert bench.drive.engaged
    bench.drive.close()


def test_a_time_out_mode_that_does_not_read_back_is_no_operation(moteus_bench):
    moteus_bench.wire.disturb(lambda frame, source: None if source and frame.data[:2] == b"\x41\x01" else 0.0)
    moteus_bench.drive.engage(Mode.CURRENT)
    with pytest.raises(NoAnswer, match=r"not in operation after 2 s: mode 0.*; servo\.timeout_mode was not answered"):
        moteus_bench.cycles(3.0)
    assert moteus_bench.commands() == []


def test_cycles_that_nobody_supervised_renew_nothing(moteus_bench):
    moteus_bench.engage(Mode.CURRENT)
    moteus_bench.drive.command(5.0)
    moteus_bench.cycles(0.1)
    with pytest.raises(DeviceFault, match="no command came for 100 ms"):
        moteus_bench.cycles(0.5, feed=False)
    assert moteus_bench.shaft.following[0] == "off"


def test_a_time_that_reads_back_otherwise_is_no_operation(moteus_bench):
    read = moteus_bench.far._read
    moteus_bench.far._read = lambda register, resolution: 5.0 if register == 0x27 else read(register, resolution)
    with pytest.raises(NoAnswer, match=r"not in operation after 2 s: mode 10, commands valid for 5 s"):
        moteus_bench.drive.engage(Mode.CURRENT)
        moteus_bench.cycles(3.0)


def test_a_safe_controller_gets_its_own_time_out_mode_back(moteus_bench):
    moteus_bench.engage(Mode.CURRENT)
    assert moteus_bench.drive.safe_state(1.0).safe
    moteus_bench.drive.close()
    assert moteus_bench.far.parameters["servo.timeout_mode"] == 12


def test_a_time_out_mode_that_cannot_be_set_refuses_the_start(make_moteus):
    bench = make_moteus()
    answer_to, bench.far._answer_to = (
        bench.far._answer_to,
        lambda words: "OK" if words[1] == "set" else answer_to(words),
    )
    with pytest.raises(DeviceError, match=r"drive: servo.timeout_mode is 12 although 0 was written \('OK'\)"):
        bench.drive.open()


def test_a_time_out_that_a_dead_host_has_left_is_cleared(make_moteus):
    bench = make_moteus()
    bench.far.mode = 11
    bench.drive.open()
    assert bench.far.mode == 0


# -- faults ---------------------------------------------------------------------------------------------------------


def test_a_fault_is_told_in_the_makers_words_and_stays_when_it_is_made_safe(moteus_bench):
    moteus_bench.engage(Mode.CURRENT)
    moteus_bench.far.fault(0x3210)
    with pytest.raises(DeviceFault, match=r"drive: over voltage \(code 34\)"):
        moteus_bench.cycles(0.1)
    assert moteus_bench.shaft.following[0] == "off"
    for _ in range(2):  # it has no power, and to stop it would clear what it has to say
        assert make_safe([moteus_bench.drive]) == {"drive": (True, "in fault, without power: over voltage (code 34)")}
        assert moteus_bench.far.mode == 1
    moteus_bench.far.mode = 10  # another host has cleared it and gone on
    moteus_bench.shaft.following = ("velocity", 1.0)
    assert moteus_bench.drive.safe_state(1.0) == (True, "stopped")
    assert moteus_bench.shaft.following[0] == "off"


def test_a_fault_that_nobody_has_heard_of_yet_is_told_where_a_stop_clears_it(moteus_bench):
    moteus_bench.engage(Mode.CURRENT)
    moteus_bench.far.fault(0x3210)
    assert moteus_bench.drive.safe_state(1.0) == (True, "stopped; it was in fault: over voltage (code 34)")
    assert moteus_bench.far.mode == 0


def test_a_fault_while_the_drive_is_off_is_told_and_not_cleared(moteus_bench):
    moteus_bench.far.fault(0x2340)
    with pytest.raises(DeviceFault, match=r"motor driver fault \(code 33\)"):
        moteus_bench.cycle()
    moteus_bench.drive.begin_cycle()
    assert (moteus_bench.far.mode, moteus_bench.far.fault_code) == (1, 33)


def test_a_fault_that_is_met_is_refused_and_stays_unless_it_is_to_be_cleared(make_moteus):
    bench = make_moteus()
    bench.far.fault(0x2340)
    for _ in range(2):
        with pytest.raises(DeviceFault, match=r"motor driver fault \(code 33\); reset_fault_at_start: true clears it"):
            bench.drive.open()
        assert make_safe([bench.drive])["drive"].safe  # as a bench does that cannot be opened
        assert bench.far.mode == 1
    willing = make_moteus(reset_fault_at_start=True)
    willing.far.fault(0x2340)
    willing.drive.open()
    assert willing.far.mode == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"temperature": 76.0}, "over temperature (code 38)"),
        ({"bus_voltage": 57.0}, "over voltage (code 34)"),
        ({"bus_voltage": 3.0}, "under voltage (code 40)"),
    ],
)
def test_the_emulated_controller_fails_where_the_real_one_does(moteus_bench, change, words):
    moteus_bench.engage(Mode.CURRENT)
    for name, value in change.items():
        setattr(moteus_bench.far if name == "temperature" else moteus_bench.shaft, name, value)
    with pytest.raises(DeviceFault) as raised:
        moteus_bench.cycles(0.1)
    assert words in str(raised.value)


def test_what_limits_the_output_is_told_once(moteus_bench):
    moteus_bench.engage(Mode.CURRENT)
    moteus_bench.far.temperature = 70.0  # 20 of the 25 K margin before the fault
    moteus_bench.drive.command(20.0)
    moteus_bench.cycles(0.2)
    assert moteus_bench.drive.notices() == ["the output is limited by servo.fault_temperature (code 100)"]
    assert moteus_bench.drive.notices() == []
    assert moteus_bench.shaft.following[1] < 20.0
    moteus_bench.far.temperature = 30.0
    moteus_bench.cycles(1.2)
    assert moteus_bench.drive.notices() == ["nothing limits the output any more"]


def test_outside_its_bounds_operation_is_a_fault(make_moteus):
    bench = make_moteus()
    bench.far.parameters |= {"servopos.position_min": -0.01, "servopos.position_max": 0.01}
    bench.drive.open()
    bench.shaft.angle = 0.25
    with pytest.raises(DeviceFault, match=r"outside limit \(code 39\)"):
        bench.engage(Mode.CURRENT)


@pytest.mark.parametrize(
    ("mode", "value", "text"),
    [
        (Mode.CURRENT, 123.0, r"a demand of 123 A is outside -122\.474 to 122\.474 A \(servo\.max_current_A\)"),
        (Mode.VELOCITY, 3142.0, r"3142 rad/s is outside -3141\.59 to 3141\.59 rad/s \(servo\.max_velocity\)"),
        (Mode.ANGLE, 7000.0, r"7000 rad is outside -6433\.98 to 6433\.98 rad"),
        (Mode.ANGLE, math.nan, "nan"),
    ],
)
def test_what_the_controller_would_cut_is_refused(moteus_bench, mode, value, text):
    moteus_bench.engage(mode)
    with pytest.raises(InputError, match=text):
        moteus_bench.drive.command(value)


def test_angles_outside_the_controllers_bounds_are_refused(make_moteus):
    bench = make_moteus(sign=-1)
    bench.far.parameters |= {"servopos.position_min": -0.5, "servopos.position_max": 2.0}
    bench.drive.open()
    bench.engage(Mode.ANGLE)
    bench.drive.command(-4 * math.pi)
    with pytest.raises(InputError, match=r"is outside -12\.5664 to 3\.14159 rad \(servopos\.position_min"):
        bench.drive.command(3.2)


# -- who is there ---------------------------------------------------------------------------------------------------


def test_a_controller_tells_model_serial_number_and_firmware(moteus_bench):
    told = moteus_bench.drive.identity()
    assert told == Identity("moteus, model 0x0120", moteus_bench.far.serial_number, "1.1.14")
    assert len(told.serial) == 16


def test_another_register_map_is_refused(make_moteus):
    bench = make_moteus()
    bench.far.map_version = 4
    with pytest.raises(DeviceError, match=r"firmware 1\.1\.14 has register map 4; 5 was expected"):
        bench.drive.open()


def test_two_controllers_of_one_number_are_told_at_the_start(make_moteus):
    bench = make_moteus()
    second = MoteusEmulator(NODE, Shaft(), torque_constant=CONSTANT)
    second.words[2] += 1
    bench.wire.attach(second)
    with pytest.raises(DeviceError, match="two controllers answer as node 1; connect one of them alone"):
        bench.drive.open()


def test_a_second_controller_that_comes_later_is_told_by_its_other_readings(moteus_bench):
    moteus_bench.cycles(0.1)
    moteus_bench.wire.attach(MoteusEmulator(NODE, Shaft(), torque_constant=CONSTANT))
    moteus_bench.shaft.angle = 1.0
    with pytest.raises(DeviceError, match="two controllers answer as node 1"):
        moteus_bench.cycles(0.1)


def test_a_frame_that_comes_twice_is_no_second_controller(moteus_bench):
    receive = moteus_bench.far.receive
    moteus_bench.far.receive = lambda frame, now: 2 * receive(frame, now)
    moteus_bench.cycles(5 * PERIOD_S)
    moteus_bench.far.receive = receive
    moteus_bench.cycle()
    [told] = moteus_bench.drive.notices()
    assert told.startswith("0 answers came after their cycle, 0 were lost, 5 came unasked")


@pytest.mark.parametrize(
    ("parameter", "value", "text"),
    [
        ("motor.Kv", 0.0, r"motor\.Kv is 0; more than 0 was expected: calibrate it first"),
        ("servo.voltage_mode_control", 1, r"servo\.voltage_mode_control is 1; 0 was expected"),
        ("servo.fixed_voltage_mode", 1, r"servo\.fixed_voltage_mode is 1; 0 was expected"),
        ("servo.bemf_feedforward", 1.0, r"servo\.bemf_feedforward is 1; 0 was expected"),
        ("servo.max_current_A", 60.0, r"holds 60 for max_current_A; the bench file says 100"),
        ("motor.Kv", TORQUE_FACTOR / 0.5, r"holds 0\.5 for torque_constant_Nm_per_A; the bench file says 0\.6"),
    ],
)
def test_settings_that_cannot_be_driven_or_that_differ_from_the_bench_file_are_refused(
    make_moteus, parameter, value, text
):
    bench = make_moteus(torque_constant_Nm_per_A=CONSTANT, max_current_A=100.0)
    bench.far.parameters[parameter] = value
    with pytest.raises(DeviceError, match=text):
        bench.drive.open()


def test_a_parameter_that_the_firmware_lacks_is_told(make_moteus):
    bench = make_moteus()
    del bench.far.parameters["motor.Kv"]
    with pytest.raises(DeviceError, match=r"motor\.Kv was answered 'ERR error reading'; a number was expected"):
        bench.drive.open()


def test_text_that_another_program_has_left_is_no_answer(make_moteus):
    bench = make_moteus()
    bench.far._text = b"7.5\r\nOK\r\n" + b"x" * 90
    bench.drive.open()
    bench.engage(Mode.CURRENT)
    bench.drive.command(1.0)
    bench.cycle()
    assert bench.shaft.following == ("current", pytest.approx(1.0))


def test_one_lost_answer_to_a_question_is_asked_for_again(make_moteus):
    bench, seen = make_moteus(), []

    def passes(frame, source):
        seen.append(frame)
        return None if source and len(seen) in (2, 13, 30) else 0.0

    bench.wire.disturb(passes)
    bench.drive.open()
    assert len(seen) > 30


def test_a_controller_whose_torque_is_of_another_constant_is_told(moteus_bench):
    moteus_bench.engage(Mode.CURRENT)
    moteus_bench.drive.command(3.0)
    moteus_bench.cycles(1.0)
    moteus_bench.far.parameters["motor.Kv"] /= 0.9  # as saturation set up by hand, or another formula, would make it
    with pytest.raises(DeviceError, match=r"shows 0\.54 N\*m per A of amplitude at its output, 0\.6 was expected"):
        moteus_bench.cycles(1.0)


def test_a_controller_found_in_operation_is_stopped_at_once(make_moteus):
    bench = make_moteus()
    bench.far.mode = 10
    bench.shaft.following = ("velocity", 5.0)
    bench.drive.open()
    assert bench.shaft.following[0] == "off"


def test_a_controller_that_is_told_to_stop_and_does_not_hear_it_is_refused(make_moteus):
    bench = make_moteus()
    bench.far.mode = 10
    bench.wire.disturb(lambda frame, source: None if source is None and frame.data[:3] == b"\x01\x00\x00" else 0.0)
    with pytest.raises(DeviceError, match="the controller does not stop: not confirmed within 1 s: no answer"):
        bench.drive.open()


def test_an_answer_that_was_on_its_way_confirms_nothing(make_moteus):
    bench, told = make_moteus(watchdog_ms=1000), []
    bench.drive.open()
    bench.wire.disturb(lambda frame, source: told.append(frame) or 0.0 if source else 0.0)
    bench.cycle()
    stopped = told[0]
    bench.engage(Mode.CURRENT)
    bench.wire.disturb(lambda frame, source: None if source is None and frame.data[:3] == b"\x01\x00\x00" else 0.0)
    send = bench.port.send_fd

    def send_into_an_old_answer(identifier, data):
        send(identifier, data)
        bench.port.bus.arrived.append(stopped)

    bench.port.send_fd = send_into_an_old_answer
    confirmation = bench.drive.safe_state(0.5)  # before the command runs out
    assert parse(stopped.data).values[Register.MODE] == 0
    assert confirmation == (False, "not confirmed within 0.5 s: no answer")


def test_an_orderly_stop_counts_no_answer_as_irregular(moteus_bench):
    moteus_bench.engage(Mode.CURRENT)
    moteus_bench.drive.stop_now()
    assert moteus_bench.drive.safe_state(1.0).safe
    moteus_bench.cycles(0.05)
    assert moteus_bench.drive.notices() == []


def test_a_controller_that_hears_and_goes_on_is_not_confirmed_safe(moteus_bench):
    moteus_bench.engage(Mode.CURRENT)
    moteus_bench.far._take_command = lambda now: None
    moteus_bench.far._expires = math.inf
    assert moteus_bench.drive.safe_state(0.2) == (False, "not confirmed within 0.2 s: mode 10")


# -- answers that are late, lost or none ----------------------------------------------------------------------------


def test_a_late_answer_is_no_later_cycles_reading(moteus_bench):
    moteus_bench.cycles(0.5)
    stalled_until = moteus_bench.clock.now() + 3.2 * PERIOD_S  # frames keep their order on a bus
    moteus_bench.wire.disturb(
        lambda frame, source: max(0.0, stalled_until - moteus_bench.clock.now()) if source else 0.0
    )
    read = []
    for number in range(20):
        moteus_bench.shaft.velocity = float(number)
        read.append(moteus_bench.cycle()[4])
    assert all(math.isnan(value) for value in read[:3])
    assert read[4:] == pytest.approx([float(number) for number in range(4, 20)])
    [told] = moteus_bench.drive.notices()
    assert told.startswith("3 answers came after their cycle, 0 were lost")


def test_a_lost_answer_empties_its_own_row_alone_and_is_counted(moteus_bench):
    lost = []

    def passes(frame, source):
        if source and frame.identifier == FROM_DRIVE and len(lost) < 2 and len(frame.data) == 48:
            lost.append(frame)
            return None
        return 0.0

    moteus_bench.wire.disturb(passes)
    rows = [moteus_bench.cycle()[4] for _ in range(6)]
    assert [math.isnan(value) for value in rows] == [True, True, False, False, False, False]
    [told] = moteus_bench.drive.notices()
    assert told.startswith("0 answers came after their cycle, 2 were lost")


def test_a_controller_that_answers_no_more_is_told_within_the_watchdogs_time(moteus_bench):
    moteus_bench.far.freeze(True)
    began = moteus_bench.clock.now()
    with pytest.raises(NoAnswer, match=r"no answer of node 1 in its own cycle for 0\.100 s; 0 came later"):
        moteus_bench.cycles(1.0)
    assert moteus_bench.clock.now() - began < 0.12


def test_a_controller_that_leaves_operation_by_itself_is_told(moteus_bench):
    moteus_bench.engage(Mode.CURRENT)
    moteus_bench.far.mode = 15
    with pytest.raises(DeviceFault, match="left operation by itself: mode 15"):
        moteus_bench.cycles(0.1)


def test_a_position_that_is_not_valid_is_missing(moteus_bench):
    moteus_bench.shaft.angle = math.nan
    row = moteus_bench.cycle()
    assert math.isnan(row[5])
    assert row[4] == 0.0
    moteus_bench.drive.engage(Mode.ANGLE)
    with pytest.raises(NoAnswer, match=r"not in operation after 2 s: mode 0, .*; the shaft is at nan turns"):
        moteus_bench.cycles(3.0)


@pytest.mark.parametrize(("angle", "velocity"), [(2 * math.pi * 40_000, 0.0), (0.0, math.inf)])
def test_a_value_that_no_controller_can_have_is_missing_and_told(moteus_bench, angle, velocity):
    moteus_bench.shaft.angle, moteus_bench.shaft.velocity = angle, velocity
    assert all(math.isnan(value) for value in moteus_bench.cycle()[3:])
    notices = moteus_bench.drive.notices()
    assert "1 answers could not be used; the last one holds a value that no controller can have" in notices


def test_bus_voltage_and_temperature_come_at_their_own_pace(moteus_bench):
    moteus_bench.drive.take()
    moteus_bench.cycles(1.0)
    rows = moteus_bench.drive.take()
    assert 4 <= len(rows) <= 6
    assert rows[0].values == (pytest.approx(29.6), pytest.approx(32.0))


def test_a_supply_that_is_asked_for_in_every_cycle_leaves_every_second_one_to_the_time_out(make_moteus):
    bench = make_moteus(supply_period_s=0.05)
    bench.drive.open()
    bench.engage(Mode.CURRENT)
    bench.drive.take()
    for _ in range(20):
        bench.drive._asks_supply_next = True
        bench.cycle()
    assert len(bench.drive.take()) == 10
    assert bench.drive.engaged


def test_a_firmware_that_refuses_a_register_is_told(moteus_bench):
    read = moteus_bench.far._read
    moteus_bench.far._read = lambda register, resolution: None if register == 4 else read(register, resolution)
    assert math.isnan(moteus_bench.cycle()[4])
    notices = moteus_bench.drive.notices()
    assert any("the last one refuses the registers 0x004 (error 1)" in text for text in notices)


# -- the emulator's own manners -------------------------------------------------------------------------------------


def answered(far, frame, now=0.0):
    [reply] = far.receive(FdFrame(TO_DRIVE, bytes.fromhex(frame)), now)
    return reply


def test_the_emulator_answers_as_the_makers_example_says():
    shaft = Shaft()
    shaft.angle, shaft.velocity = 0.008 * 2 * math.pi, 0.064 * 2 * math.pi
    far = MoteusEmulator(NODE, shaft, torque_constant=CONSTANT)
    reply = answered(far, "01000a07206000200150ff140400130d")
    assert isinstance(reply, FdFrame)
    assert reply.identifier == FROM_DRIVE
    # stopped yet: the command is taken up after its frame; 0.008 rev, 0.064 rev/s, no torque; 29.5 V, 32 degC, no fault
    assert reply.data.hex() == "240400000050000001000023" + "0d3b2000"


def test_a_command_of_current_mode_never_runs_out_and_one_of_position_mode_does():
    """Why the driver has no use for the controller's own current mode."""
    shaft = Shaft()
    far = MoteusEmulator(NODE, shaft, torque_constant=CONSTANT)
    told = "0100090d1c" + struct.pack("<f", 2.0).hex() + "1100"
    for now in (0.0, 0.01, 0.02):
        far.tick(now)
        answered(far, told, now)
    far.tick(60.0)
    assert (far.mode, shaft.following) == (9, ("current", pytest.approx(2.0 / AMPLITUDE)))
    answered(far, "01000a0d27" + struct.pack("<f", 0.05).hex() + "1100", 60.0)
    far.tick(60.049)
    assert far.mode == 10
    far.tick(60.051)
    assert far.mode == 11


def test_a_command_that_runs_out_on_the_way_into_operation_is_never_followed():
    shaft = Shaft()
    far = MoteusEmulator(NODE, shaft, torque_constant=CONSTANT)
    far.parameters["servo.timeout_mode"] = 0
    answered(far, "01000a0d27" + struct.pack("<f", 0.001).hex() + "1100")
    far.tick(1.0)
    assert (far.mode, shaft.following[0]) == (11, "off")


@pytest.mark.parametrize("broken", ["01", "0100", "0c062000", "1cff", "1c", "40010a41", "8080808080", "99", ""])
def test_a_frame_that_breaks_off_harms_nothing(broken):
    far = MoteusEmulator(NODE, Shaft(), torque_constant=CONSTANT)
    assert parse(answered(far, broken).data).errors == {}
    assert far.mode == 0


def test_an_unknown_register_ends_the_reading_of_a_frame():
    far = MoteusEmulator(NODE, Shaft(), torque_constant=CONSTANT)
    reply = parse(answered(far, "11001d8104110f").data)
    assert reply.values == {Register.MODE: 0.0}
    assert reply.errors == {0x201: 1}
    assert parse(answered(far, "0101101100").data).errors == {1: 2}  # a position cannot be written
    assert parse(answered(far, "0100631100").data).errors == {0: 3}  # no mode has the number 99
    assert parse(answered(far, "0d000000c07f1100").data).errors == {0: 3}


def test_classic_frames_and_other_numbers_are_none_of_its_own():
    far = MoteusEmulator(NODE, Shaft(), torque_constant=CONSTANT)
    assert far.receive(FdFrame(0x8002, b"\x11\x00"), 0.0) == []
    assert far.receive(FdFrame(0x0001, b"\x11\x00"), 0.0) == []  # no answer is asked for
