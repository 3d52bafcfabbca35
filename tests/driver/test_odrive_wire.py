"""An ODrive at the wire: golden bytes of the maker's protocol, its watchdog, its parameters, late answers."""

import json
import math
import struct

import pytest
from leactl_plugins.odrive_can import endpoints
from leactl_plugins.odrive_can.driver import OdriveCan
from leactl_plugins.odrive_can.emulator import OdriveEmulator
from leactl_plugins.odrive_can.settings import OdriveSettings

from leactl.driver.can_port import CanPort
from leactl.driver.contract import Mode
from leactl.driver.far_end import Frame
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer

from .elmo_bench import Tap
from .failing import Shaft
from .transports import CanInProcess

NODE, BASE = 1, 0x20
CONSTANT = 0.6
PERIOD_S = 0.005


class OdriveBench:
    """One axis at the host's wire."""

    def __init__(self, **settings):
        wire = CanInProcess()
        self.wire, self.clock, self.shaft = wire.wire, wire.clock, Shaft()
        self.tape: list[Frame] = []
        self.far = OdriveEmulator(
            NODE, self.shaft, endpoints.read_table("emulated"), torque_constant=CONSTANT, current_soft_max=40.0
        )
        self.wire.attach(self.far)
        checked = OdriveSettings(node=NODE, **({"endpoints": "emulated"} | settings))
        port = CanPort(lambda: Tap(wire.connect(), self.tape), self.clock)
        self.drive = OdriveCan("drive", "test", checked, port, self.clock)

    def cycle(self, feed=True):
        began = self.clock.now()
        self.drive.begin_cycle()
        self.drive.end_cycle(began + 0.6 * PERIOD_S)
        if feed:
            self.drive.feed()
        self.clock.sleep_until(began + PERIOD_S)
        return list(self.drive.values)

    def cycles(self, seconds):
        return [self.cycle() for _ in range(round(seconds / PERIOD_S))]

    def engage(self, mode):
        self.drive.engage(mode)
        for _ in range(400):
            self.cycle()
            if self.drive.engaged:
                return
        raise AssertionError("not engaged within two seconds")

    def sent(self, command):
        return [frame.data for frame in self.tape if frame.identifier == BASE | command]

    def told(self, path):
        """Values that were written to a parameter, as bytes."""
        number = endpoints.read_table("emulated").endpoints[path].number
        return [data[4:] for data in self.sent(0x04) if data[:3] == struct.pack("<BH", 1, number)]


@pytest.fixture
def make_bench():
    made = []

    def make(**settings):
        made.append(OdriveBench(**settings))
        return made[-1]

    yield make
    for bench in made:
        bench.drive.close()


@pytest.fixture
def bench(make_bench):
    bench = make_bench()
    bench.drive.open()
    bench.cycle()
    return bench


def test_a_state_is_asked_for_by_the_documented_bytes(bench):
    bench.engage(Mode.CURRENT)
    assert bench.sent(0x07)[-1] == bytes.fromhex("08000000")
    bench.drive.stop_now()
    assert bench.sent(0x07)[-1] == bytes.fromhex("01000000")


def test_a_velocity_is_turns_a_second_in_single_precision(bench):
    bench.engage(Mode.VELOCITY)
    bench.drive.command(-2.5 * 2 * math.pi)
    bench.cycle()
    assert bench.sent(0x0D)[-1] == bytes.fromhex("000020c000000000")  # -2.5 turns/s, no torque fed forward
    assert bench.shaft.following == ("velocity", pytest.approx(-5 * math.pi))


def test_a_current_is_sent_as_the_torque_that_the_drives_own_constant_makes_of_its_amplitude(bench):
    bench.engage(Mode.CURRENT)
    bench.drive.command(4.9)
    bench.cycle()
    (torque,) = struct.unpack("<f", bench.sent(0x0E)[-1])
    assert torque == pytest.approx(4.9 / math.sqrt(1.5) * CONSTANT, rel=1e-6)
    assert bench.cycle()[3] == pytest.approx(4.9, rel=1e-6)
    assert bench.sent(0x0B)[-1] == bytes.fromhex("0100000001000000")  # torque, passed through


def test_an_angle_holds_where_the_shaft_is(bench):
    bench.shaft.angle = 0.7
    bench.engage(Mode.ANGLE)
    assert bench.shaft.following == ("angle", pytest.approx(0.7, abs=1e-6))
    bench.drive.command(-0.3)
    bench.cycle()
    assert struct.unpack("<fhh", bench.sent(0x0C)[-1]) == (pytest.approx(-0.3 / (2 * math.pi), rel=1e-6), 0, 0)


def test_a_turned_drive_turns_current_velocity_and_angle(make_bench):
    bench = make_bench(sign=-1)
    bench.drive.open()
    bench.shaft.velocity, bench.shaft.angle = 3.0, 0.5
    bench.engage(Mode.CURRENT)
    bench.drive.command(2.0)
    bench.cycle()
    row = bench.cycle()
    assert bench.shaft.following == ("current", pytest.approx(-2.0))
    assert row[3:6] == [pytest.approx(2.0), pytest.approx(-3.0), pytest.approx(-0.5)]


def test_a_reference_stands_in_the_row_whose_reading_it_led_to(bench):
    bench.engage(Mode.VELOCITY)
    bench.drive.command(1.0)
    assert bench.cycle()[1] == 0.0
    bench.drive.command(2.0)
    assert bench.cycle()[1] == 1.0
    assert bench.cycle()[1] == 2.0


def test_no_closed_loop_before_the_drive_has_shown_mode_and_watchdog(bench):
    bench.wire.disturb(lambda frame, source: None if source and frame.identifier == BASE | 0x05 else 0.0)
    bench.drive.engage(Mode.CURRENT)
    with pytest.raises(NoAnswer, match=r"not in operation after 2 s.*has not shown the mode"):
        bench.cycles(3.0)
    assert bytes.fromhex("08000000") not in bench.sent(0x07)


def test_the_watchdog_is_armed_before_closed_loop_and_its_time_read_back(make_bench):
    bench = make_bench(watchdog_ms=150)
    bench.drive.open()
    assert bench.told(endpoints.WATCHDOG_TIMEOUT) == [struct.pack("<f", 0.15)]
    bench.cycle()
    bench.engage(Mode.CURRENT)
    assert bench.told(endpoints.ENABLE_WATCHDOG)[0] == b"\x01"
    bench.drive.command(5.0)
    bench.cycles(0.1)
    began = bench.clock.now()
    while bench.shaft.following[0] != "off":
        bench.clock.sleep_until(bench.clock.now() + 0.001)
        assert bench.clock.now() - began < 1.0
    assert bench.clock.now() - began <= 0.151


def test_a_drive_that_has_restarted_since_it_was_opened_is_not_engaged(bench):
    bench.far.stored[endpoints.WATCHDOG_TIMEOUT] = 10.0
    bench.far.restart()
    bench.drive.engage(Mode.CURRENT)
    with pytest.raises(DeviceFault, match=r"drive: axis0\.config\.watchdog_timeout is 10 s although 0\.1 s was set"):
        bench.cycles(3.0)
    assert bytes.fromhex("08000000") not in bench.sent(0x07)


def test_a_drive_that_restarts_on_the_way_into_operation_is_not_engaged(bench):
    bench.far.stored[endpoints.WATCHDOG_TIMEOUT] = 10.0
    mend = bench.wire.disturb(
        lambda frame, source: None if source is None and frame == (BASE | 0x07, b"\x08\0\0\0") else 0.0
    )
    bench.drive.engage(Mode.CURRENT)
    while bytes.fromhex("08000000") not in bench.sent(0x07):
        bench.cycle()
    bench.far.restart()
    mend()
    with pytest.raises(DeviceFault, match=r"drive: axis0\.config\.watchdog_timeout is 10 s although 0\.1 s was set"):
        bench.cycles(3.0)


def test_cycles_that_nobody_supervised_feed_no_watchdog(bench):
    bench.engage(Mode.CURRENT)
    bench.drive.command(5.0)
    bench.cycles(0.1)
    with pytest.raises(DeviceFault, match=r"WATCHDOG_TIMER_EXPIRED \(0x01000000\)"):
        for _ in range(100):
            bench.cycle(feed=False)
    assert bench.shaft.following[0] == "off"


def test_a_watchdog_that_cannot_be_set_refuses_the_start(make_bench):
    bench = make_bench()
    number = endpoints.read_table("emulated").endpoints[endpoints.WATCHDOG_TIMEOUT].number
    write = struct.pack("<BH", 1, number)
    bench.wire.disturb(lambda frame, source: None if source is None and frame.data[:3] == write else 0.0)
    with pytest.raises(DeviceError, match=r"drive: axis0\.config\.watchdog_timeout is 0 although 0\.1 was written"):
        bench.drive.open()


def test_one_lost_answer_to_a_question_is_asked_for_again(make_bench):
    bench = make_bench()
    lost = []

    def passes(frame, source):
        if source and frame.identifier == BASE | 0x05 and not lost:
            lost.append(frame)
            return None
        return 0.0

    bench.wire.disturb(passes)
    bench.drive.open()
    assert lost


def test_a_safe_drive_gets_its_own_parameters_back(bench):
    before = {path: value for path, value in bench.far.parameters.items() if path != endpoints.CONTROL_MODE}
    bench.engage(Mode.CURRENT)
    assert bench.far.parameters[endpoints.ENABLE_WATCHDOG]
    assert bench.drive.safe_state(1.0).safe
    bench.drive.close()
    after = bench.far.parameters
    assert after[endpoints.ENABLE_WATCHDOG] == 0
    assert (after[endpoints.ENCODER_PERIOD], after[endpoints.HEARTBEAT_PERIOD]) == (10, 100)
    assert after[endpoints.TORQUE_CONSTANT] == before[endpoints.TORQUE_CONSTANT]


def test_a_drive_of_another_firmware_is_refused_with_both(make_bench, tmp_path):
    table = json.loads(
        (endpoints.resources.files("leactl_plugins.odrive_can") / "emulated_endpoints.json").read_text("utf-8")
    )
    table["fw_version"] = "0.6.8-1"
    path = tmp_path / "flat_endpoints.json"
    path.write_text(json.dumps(table))
    bench = make_bench(endpoints=str(path))
    with pytest.raises(DeviceError, match=r"firmware 0\.6\.11 on hardware 5\.2\.0; .* is of 0\.6\.8 on 5\.2\.0"):
        bench.drive.open()


def test_two_drives_of_one_node_are_told_at_the_start(make_bench):
    bench, shaft = make_bench(), Shaft()
    table = endpoints.read_table("emulated")
    bench.wire.attach(OdriveEmulator(NODE, shaft, table, torque_constant=CONSTANT, current_soft_max=40.0))
    with pytest.raises(DeviceError, match="drive: two drives answer as node 1; connect one of them alone"):
        bench.drive.open()
    assert (bench.shaft.following[0], shaft.following[0]) == ("off", "off")


class Doubling(OdriveEmulator):
    """Sends its version twice, as often as it is said to; `second` changes what comes the second time."""

    times, second = 1, b""

    def _answer(self, command):
        frames = super()._answer(command)
        if self.times and command == 0x00:
            self.times -= 1
            return [frames[0], frames[0]._replace(data=self.second or frames[0].data)]
        return frames


@pytest.mark.parametrize(
    ("times", "second", "refused"),
    [
        (1, "", False),
        (3, "", True),
        (1, "02050200 00060C00", True),
    ],
    ids=["one frame too many", "two of the same to each question", "two firmwares"],
)
def test_a_version_that_comes_twice_by_chance_is_no_second_drive(make_bench, times, second, refused):
    bench, shaft = make_bench(), Shaft()
    bench.wire.devices.clear()
    far = Doubling(NODE, shaft, endpoints.read_table("emulated"), torque_constant=CONSTANT, current_soft_max=40.0)
    far.times, far.second = times, bytes.fromhex(second)
    bench.wire.attach(far)
    if refused:
        with pytest.raises(DeviceError, match="two drives answer as node 1"):
            bench.drive.open()
    else:
        bench.drive.open()


def test_a_late_version_is_no_second_drive(make_bench):
    bench = make_bench()
    late = [0.3]
    bench.wire.disturb(lambda frame, source: late.pop() if source and frame.identifier == BASE and late else 0.0)
    bench.drive.open()
    assert late == []


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (None, "cannot be read"),
        ("{", "is no flat_endpoints.json"),
        ("[]", "is no flat_endpoints.json"),
        ('{"fw_version": "0.6.8"}', "has no 'hw_version'"),
        ('{"fw_version": "1", "hw_version": "1", "endpoints": {}}', "has no 'axis0.config.enable_watchdog'"),
    ],
)
def test_a_table_that_is_none_is_refused_with_its_place(tmp_path, text, fault):
    path = tmp_path / "table.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ValueError, match=fault):
        OdriveSettings(node=NODE, endpoints=str(path))


def test_what_a_dead_host_has_left_is_cleared_and_another_error_is_not(make_bench):
    bench = make_bench()
    bench.far.errors = 0x01000000
    bench.drive.open()
    bench.drive.close()
    bench.far.errors = 0x01000020
    with pytest.raises(DeviceFault, match="DRV_FAULT and WATCHDOG_TIMER_EXPIRED"):
        bench.drive.open()
    willing = make_bench(reset_fault_at_start=True)
    willing.far.errors = 0x20
    willing.drive.open()


def test_an_axis_found_in_operation_is_made_idle_at_once(make_bench):
    bench = make_bench()
    bench.far.state = 8
    bench.shaft.following = ("velocity", 5.0)
    bench.drive.open()
    assert bench.shaft.following[0] == "off"


def test_a_heartbeat_that_was_on_its_way_confirms_nothing(make_bench):
    bench = make_bench(watchdog_ms=1000)
    bench.drive.open()
    bench.cycle()
    bench.engage(Mode.CURRENT)
    idle = Frame(BASE | 0x01, struct.pack("<IBBBB", 0, 1, 0, 0, 0))
    bench.wire.disturb(lambda frame, source: None if source is None and frame.identifier == BASE | 0x07 else 0.0)
    port = bench.drive._port
    ask = port.send

    def send(identifier, data):
        ask(identifier, data)
        if identifier == BASE | 0x07:  # told to be idle, which is lost, while a heartbeat of before arrives
            port.bus.arrived.appendleft(idle)

    port.send = send
    confirmation = bench.drive.safe_state(0.5)  # before the watchdog makes the axis idle
    assert not confirmation.safe
    assert confirmation.detail.startswith("not confirmed within 0.5 s: ")


def test_a_drive_that_is_met_without_heartbeats_gets_them_for_the_run_and_none_after_it(make_bench):
    bench = make_bench()
    bench.far.parameters[endpoints.HEARTBEAT_PERIOD] = 0
    bench.drive.open()
    bench.cycles(0.5)
    assert bench.drive.safe_state(1.0).safe
    bench.drive.close()
    assert bench.far.parameters[endpoints.HEARTBEAT_PERIOD] == 0


def test_an_axis_that_stays_in_operation_is_refused(make_bench):
    bench = make_bench()
    bench.far.state = 8
    bench.wire.disturb(lambda frame, source: None if source is None and frame.identifier == BASE | 7 else 0.0)
    with pytest.raises(DeviceError, match="drive: the axis does not become idle, state 8"):
        bench.drive.open()


def test_a_mode_is_left_by_way_of_idle(bench):
    bench.engage(Mode.VELOCITY)
    bench.drive.command(4.0)
    bench.cycles(0.05)
    bench.tape.clear()
    bench.drive.engage(Mode.CURRENT)  # without a word of release
    bench.cycles(0.5)
    states = [data[0] for data in bench.sent(0x07)]
    assert states[0] == 1
    assert states[-1] == 8
    assert bench.shaft.following == ("current", 0.0)


@pytest.mark.parametrize(
    ("mode", "value", "text"),
    [
        (Mode.CURRENT, 49.0, r"a demand of 49 A is above 48\.9898 A \(axis0\.config\.motor\.current_soft_max\)"),
        (Mode.VELOCITY, 130.0, r"130 rad/s is above 125\.664 rad/s \(axis0\.controller\.config\.vel_limit\)"),
        (Mode.ANGLE, 7000.0, r"7000 rad is above 6433\.98 rad"),
        (Mode.ANGLE, math.nan, "nan"),
    ],
)
def test_what_the_drive_would_cut_is_refused(bench, mode, value, text):
    bench.engage(mode)
    with pytest.raises(InputError, match=text):
        bench.drive.command(value)


def test_a_late_answer_is_no_later_cycles_reading(bench):
    bench.cycles(1.5)  # watched for a second after it was opened
    stalled_until = bench.clock.now() + 1.2 * PERIOD_S  # frames keep their order on a bus
    bench.wire.disturb(lambda frame, source: max(0.0, stalled_until - bench.clock.now()) if source else 0.0)
    read = []
    for number in range(60):
        bench.shaft.velocity = float(number)
        read.append(bench.cycle()[4])
    assert math.isnan(read[0])
    assert all(math.isnan(value) or value == pytest.approx(number) for number, value in enumerate(read))
    assert read[-1] == pytest.approx(59.0)
    assert any("came after their cycle" in text for text in bench.drive.notices())


@pytest.mark.parametrize(("command", "unasked"), [(0x09, 0), (0x14, 1)])
def test_an_answer_that_comes_twice_makes_no_row_stale(bench, command, unasked):
    bench.cycles(1.5)  # watched for a second after it was opened
    receive = bench.far.receive

    def twice(frame, now):
        answers = receive(frame, now)
        if frame.identifier == BASE | command:
            bench.far.receive = receive
            return answers * 2
        return answers

    while bench.drive._answers.watched:
        bench.cycle()
    bench.far.receive = twice
    for number in range(200):
        bench.shaft.velocity, bench.shaft.following = float(number), ("current", 0.1 * number)
        assert bench.cycle()[3:5] == [pytest.approx(0.1 * number, rel=1e-6), pytest.approx(number)]
    assert [f"{unasked} came unasked" in text for text in bench.drive.notices()] == [True] * unasked


def test_a_drive_that_shows_no_life_is_told(bench):
    bench.wire.disturb(lambda frame, source: None if source and bench.far.is_sign_of_life(frame) else 0.0)
    with pytest.raises(NoAnswer, match=r"no heartbeat of node 1 for 0\.160 s"):
        bench.cycles(0.5)


def test_a_drive_that_leaves_operation_by_itself_is_told(bench):
    bench.engage(Mode.CURRENT)
    bench.far.state = 1
    with pytest.raises(DeviceFault, match="left operation by itself, state 1"):
        bench.cycles(0.1)


def test_bus_voltage_and_current_come_at_their_own_pace(bench):
    bench.drive.take()
    bench.cycles(1.0)
    rows = bench.drive.take()
    assert 4 <= len(rows) <= 6
    assert rows[0].values == (pytest.approx(29.6), 0.0)
