"""The Elmo driver against the drive's far end: what goes over the wire, frame by frame, on every transport."""

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from leactl_plugins.elmo_can.cia402 import DriveState, state_of
from leactl_plugins.elmo_can.emulator import ElmoEmulator
from leactl_plugins.elmo_can.settings import ElmoSettings
from pydantic import ValidationError

from leactl.driver.contract import Identity, Mode
from leactl.driver.far_end import Frame
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer

from .elmo_bench import ElmoBench, q_axis
from .failing import COUNTS, RATED_MA, FailingDrive, Shaft
from .transports import CanInProcess


@pytest.fixture
def bench(make_bench):
    bench = make_bench()
    bench.drive.open()
    return bench


@pytest.fixture
def here():
    """A bench in this process, whose frames a test may add to."""
    bench = ElmoBench()
    yield bench
    bench.close()


def controlwords(bench):
    words = [struct.unpack_from("<H", data)[0] for data in bench.sent(0x201)]
    return [word for word, before in zip(words, [None, *words], strict=False) if word != before]


def test_the_drive_is_asked_who_it_is_and_a_long_name_comes_in_segments(bench):
    assert bench.drive.identity() == Identity("Gold DC Whistle, hardware 1.0", "1", "Whistle 01.01.16.00 08Mar2018G")
    asked = [data.hex() for data in bench.sent(0x601)]
    at = asked.index("4008100000000000")
    assert asked[at : at + 4] == ["4008100000000000", "6000000000000000", "7000000000000000", "6000000000000000"]
    before = [data.hex()[2:8] for data in bench.sent(0x601)[:at]]
    assert before[:2] == ["181001", "406000"]  # maker, then out of operation, then anything else


def test_a_drive_that_tells_no_names_is_met_all_the_same(monkeypatch):
    bench = ElmoBench()  # in process: its far end is at hand
    plain = bench.far._serve
    monkeypatch.setattr("leactl_plugins.elmo_can.emulator.TEXTS", {})
    assert plain(bytes.fromhex("4008100000000000"), 0.0).hex() == "8008100000000206"
    bench.drive.open()
    assert bench.drive.identity() == Identity("CiA 402 product 0x00030923, revision 0x000103F6", "1", "")
    bench.engage(Mode.CURRENT)
    bench.close()


def test_segments_that_come_twice_spoil_nothing_but_the_name(monkeypatch):
    bench = ElmoBench()
    take = bench.drive._sdo.on_frame

    def twice(data, timestamp):
        for _ in range(2 if data[0] < 0x20 else 1):
            take(data, timestamp)

    monkeypatch.setattr(bench.drive._sdo, "on_frame", twice)
    bench.drive.open()
    assert bench.drive.identity().serial == "1"
    bench.engage(Mode.CURRENT)
    bench.close()


def test_a_name_without_an_end_is_given_up(monkeypatch):
    bench = ElmoBench()
    monkeypatch.setattr(bench.far, "_text_segment", lambda toggle: bytes([toggle]) + b"endless")
    began = bench.clock.now()
    bench.drive.open()
    assert bench.drive.identity() == Identity("CiA 402 product 0x00030923, revision 0x000103F6", "1", "")
    assert bench.clock.now() - began < 5.0
    bench.close()


def test_enable_walks_one_transition_a_cycle(bench):
    bench.engage(Mode.CURRENT)
    assert controlwords(bench) == [0x0000, 0x0006, 0x0007, 0x000F]
    assert bench.drive.statusword == 0x0637


@pytest.mark.parametrize(
    ("word", "state"),
    [
        (0x0250, DriveState.DISABLED),
        (0x0231, DriveState.READY),
        (0x0233, DriveState.SWITCHED_ON),
        (0x0637, DriveState.ENABLED),
        (0x0218, DriveState.FAULT),
        (0x0298, DriveState.FAULT),
        (0x0617, DriveState.QUICK_STOP),
        (0x02C0, DriveState.DISABLED),
    ],
)
def test_statuswords_seen_on_real_drives(word, state):
    assert state_of(word) is state


def test_current_is_per_mille_of_the_drives_own_rating_in_amplitude(bench):
    bench.engage(Mode.CURRENT)
    bench.drive.command(4.9)
    bench.cycle()
    values = bench.cycle()
    assert bench.sent(0x201)[-1] == struct.pack("<Hhb", 0x000F, 358, 10)
    assert values[0] == pytest.approx(q_axis(358))
    assert values[3] == pytest.approx(q_axis(358))
    assert abs(values[3] - 4.9) < q_axis(1) / 2


def test_angle_mode_begins_where_the_shaft_is(bench):
    bench.engage(Mode.ANGLE)
    mode, angle = bench.far.follows()
    assert mode == "angle"
    assert angle == pytest.approx(0.25, abs=2 * math.pi / 40000)


@pytest.mark.parametrize(
    ("mode", "object_6060", "value", "followed"),
    [
        (Mode.CURRENT, 10, 4.9, ["current", q_axis(358)]),
        (Mode.TORQUE_PROFILE, 4, -4.9, ["current", q_axis(-358)]),
        (Mode.VELOCITY, 9, 3.0, ["velocity", 19099 * 2 * math.pi / 40000]),
        (Mode.ANGLE, 8, -0.1, ["angle", -637 * 2 * math.pi / 40000]),
    ],
)
def test_every_mode_is_entered_and_followed(bench, mode, object_6060, value, followed):
    bench.engage(mode)
    bench.drive.command(value)
    bench.cycle()
    assert bench.sent(0x201)[-1][4] == object_6060
    assert bench.far.follows() == [followed[0], pytest.approx(followed[1])]
    bench.drive.release()
    bench.cycle()
    assert bench.far.follows()[0] == "off"


def test_set_up_writes_and_reads_back_the_dead_man(bench):
    sdo = bench.sent(0x601)
    assert struct.pack("<BHBhxx", 0x2B, 0x6007, 0, 2) in sdo
    consumer = 126 << 16 | bench.drive.settings.consumer_heartbeat_ms
    assert struct.pack("<BHBI", 0x23, 0x1016, 1, consumer) in sdo
    assert struct.pack("<BHB4x", 0x40, 0x1016, 1) in sdo


def test_remapping_order_is_invalid_type_empty_entries_count_valid(bench):
    writes = [data for data in bench.sent(0x601) if data[1:3] in (b"\x00\x18", b"\x00\x1a") and data[0] != 0x40]
    assert writes == [
        bytes.fromhex("2300180181010080"),
        bytes.fromhex("2f00180201000000"),
        bytes.fromhex("2f001a0000000000"),
        bytes.fromhex("23001a0110004160"),
        bytes.fromhex("23001a0208006160"),
        bytes.fromhex("23001a0310007760"),
        bytes.fromhex("23001a0410007860"),
        bytes.fromhex("2f001a0004000000"),
        bytes.fromhex("2300180181010000"),
    ]


def test_host_heartbeat_is_sent_by_the_cycle_alone(make_bench):
    bench = make_bench(consumer_heartbeat_ms=300)
    third = 0.1
    bench.drive.open()
    bench.clock.sleep_until(bench.clock.now() + 1.5 * third)
    assert bench.sent(0x77E) == []
    began, cycles = bench.clock.now(), [0.0]
    while bench.clock.now() - began < 5.5 * third:
        before = bench.clock.now()
        bench.cycle()
        cycles.append(bench.clock.now() - before)
    took = bench.clock.now() - began
    beats = bench.sent(0x77E)
    assert set(beats) == {b"\x05"}
    assert (len(beats) - 1) * third <= took  # never sooner than a third of the consumer's time
    assert len(beats) * (third + 2 * max(cycles)) >= took  # nor later than the first cycle after it


def test_a_silent_host_stops_the_drive(make_bench):
    bench = make_bench(consumer_heartbeat_ms=1000)
    bench.drive.open()
    bench.engage(Mode.CURRENT)
    bench.drive.command(5.0)
    bench.cycle()
    bench.cycle()
    assert bench.far.follows()[0] == "current"
    waited = bench.wait_until(lambda: bench.far.follows()[0] == "off")
    if bench.exact:
        assert waited <= 1.000 + 0.002


def test_an_emergency_message_ends_the_cycle(bench):
    bench.cycle()
    bench.far.fault(0x3310, 235)
    with pytest.raises(DeviceFault, match=r"0x3310 \(over-voltage\).*drive code 235"):
        bench.cycle()


def test_an_emergency_message_of_another_length_is_one_of_unknown_code(here):
    here.drive.open()
    here.cycle()
    here.port.bus.arrived.append(Frame(0x081, bytes.fromhex("102303")))
    with pytest.raises(DeviceFault, match=r"emergency of unknown code: 3 bytes \(102303\), 8 were expected"):
        here.cycle()


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (Frame(0x181, bytes(8)), "drive: TPDO1 has 8 bytes, 7 were mapped"),
        (Frame(0x281, bytes(4)), "drive: TPDO2 has 4 bytes, 8 were mapped"),
    ],
)
def test_a_pdo_of_another_length_is_named_with_both(here, frame, said):
    here.port.open()
    here.port.bus.arrived.append(frame)  # of an earlier mapping: it means nothing before the node's start
    here.drive.open()
    here.cycle()
    here.port.bus.arrived.append(frame)
    with pytest.raises(DeviceFault, match=said):
        here.cycle()


@pytest.mark.parametrize("answer", ["8079600000000206", "4b79600010270000", "4f79600010000000"])
def test_a_bus_voltage_that_is_refused_is_noticed_once(here, answer):
    receive = here.far.receive

    def receive_and_refuse(frame, now):
        refused = frame.identifier == 0x601 and frame.data[1:3] == b"\x79\x60"
        return [Frame(0x581, bytes.fromhex(answer))] if refused else receive(frame, now)

    here.far.receive = receive_and_refuse
    here.drive.open()
    for _ in range(300):
        here.cycle()
    assert here.drive.take() == []
    assert [text for text in here.drive.notices() if "0x6079" in text] == [
        f"0x6079 (bus voltage) is answered by {answer}; 43796000 and four bytes were expected: there is no bus voltage"
    ]


def test_a_drive_that_leaves_operation_is_never_enabled_again(bench):
    bench.engage(Mode.CURRENT)
    bench.far.leave_operation()
    with pytest.raises(DeviceFault, match="left operation by itself"):
        for _ in range(5):
            bench.cycle()


def test_a_frozen_drive_gives_nan_then_no_answer(make_bench):
    bench = make_bench(consumer_heartbeat_ms=1000)
    bench.drive.open()
    bench.cycle()
    bench.far.freeze()
    values = bench.cycle(answer_s=0.02)
    assert all(math.isnan(value) for value in values[3:7])
    with pytest.raises(NoAnswer, match="no heartbeat of node 1"):
        for _ in range(5000):
            bench.cycle(answer_s=0.02)


def test_a_voltage_that_stays_away_is_nan_beside_what_came():
    wire = CanInProcess()
    wire.drive = lambda node: FailingDrive(wire.wire, node, voltage=(0x2F00, 0, "i16", 0.001))
    bench = ElmoBench(wire=wire, q_axis_voltage={"index": 0x2F00, "type": "i16", "scale_V": 0.001})
    bench.drive.open()
    assert bench.cycle()[7] == pytest.approx(3.25)
    bench.port.listen(0x381, None)
    values = bench.cycle()
    assert [math.isnan(value) for value in values[3:]] == [False] * 4 + [True]
    bench.close()


class Clocked(ElmoEmulator):
    """A drive whose clock goes its own way, and whose answers stand for a moment that is past."""

    def __init__(self):
        self.shaft, self.late, self.rate = Shaft(), 0.0, 1.0
        super().__init__(1, self.shaft, rated_current_ma=RATED_MA, counts_per_turn=COUNTS, clock_object=(0x2F10, 0))

    def _sync(self, now):
        return super()._sync(4294.0 + self.rate * now - self.late)  # its 32 bits go round within a second


@pytest.fixture
def clocked():
    wire = CanInProcess()
    far = Clocked()
    wire.wire.attach(far)
    wire.drive = lambda _node: far
    bench = ElmoBench(wire=wire, drive_clock={"index": 0x2F10})
    bench.drive.open()
    yield bench
    bench.close()


def test_answers_that_grow_old_are_told_by_the_clock_they_are_stamped_with(clocked):
    for late in (0.0, 0.025, 0.049):
        clocked.far.late = late
        for _ in range(1000):
            clocked.cycle()
    clocked.far.late = 0.09
    with pytest.raises(DeviceFault, match=r"its answers are 0\.0\d+ s late by its own clock; 0\.05 s are allowed"):
        for _ in range(21):
            clocked.cycle()


def test_a_clock_that_drifts_makes_no_answer_late(clocked):
    clocked.far.rate = 1.0 - 1.9e-4  # 57 ms behind after 300 s
    for _ in range(10_000):
        clocked.cycle(period=0.03)


def test_a_fault_at_start_is_named_and_reset_only_on_request(make_bench):
    bench = make_bench()
    bench.far.fault(0x7121)
    with pytest.raises(DeviceFault, match="motor stuck"):
        bench.drive.open()
    bench.drive.close()
    bench = make_bench(reset_fault_at_start=True)
    bench.far.fault(0x7121)
    bench.drive.open()
    words = [data[4:6] for data in bench.sent(0x601) if data[1:3] == b"\x40\x60"]
    assert words == [b"\x00\x00", b"\x00\x00", b"\x80\x00", b"\x00\x00"]


def test_holding_the_reset_bit_never_resets(make_bench):
    bench = make_bench()
    held, low, statusword = "2b40600080000000", "2b40600000000000", "4041600000000000"
    bench.transfer(held)
    bench.far.fault(0x7121)
    bench.transfer(held)
    assert bench.transfer(statusword) == "4b41600018020000"
    bench.transfer(low)
    bench.transfer(held)
    assert bench.transfer(statusword) == "4b41600040020000"


@pytest.mark.parametrize(
    ("index", "said"),
    [
        (0x1016, r"consumer heartbeat 0x1016:1 was written as 0x7E0\w+ and read back as 0x0;"),
        (0x6007, r"abort option 0x6007:0 was written as 0x2 and read back as 0x1;"),
    ],
)
def test_a_dead_man_that_does_not_stick_refuses_the_start(make_bench, index, said):
    bench = make_bench()
    bench.far.ignore_writes(index)
    with pytest.raises(DeviceError, match=f"drive: its dead-man cannot be armed: {said}"):
        bench.drive.open()
    assert bench.far.follows()[0] == "off"


def test_no_drive_is_enabled_before_its_dead_man_has_heard_a_heartbeat(make_bench):
    bench = make_bench(consumer_heartbeat_ms=1000)
    bench.drive.open()

    def cycles_without_heartbeat():
        bench.drive.engage(Mode.CURRENT)
        for _ in range(3):
            bench.drive.begin_cycle()
            bench.port.sync()
            bench.drive.end_cycle(bench.clock.now() + 0.5)

    with pytest.raises(DeviceError, match="no heartbeat was sent in 1 s, its dead-man is not armed"):
        cycles_without_heartbeat()
    assert controlwords(bench) == [0x0000]
    bench.drive.feed()
    cycles_without_heartbeat()
    assert 0x0006 in controlwords(bench)


def test_an_abort_names_object_and_code(make_bench):
    bench = make_bench()
    bench.far.lack(0x6007, 0)
    with pytest.raises(DeviceError, match="0x6007:0 refused, abort 0x06020000"):
        bench.drive.open()


def test_an_absent_drive_is_named(make_bench):
    bench = make_bench(sdo_timeout_s=0.3)
    bench.far.cut_cable()
    with pytest.raises(NoAnswer, match="node 1: no SDO answer"):
        bench.drive.open()


def test_the_emulated_drive_counts_no_object_that_was_not_mapped(make_bench):
    bench = make_bench()
    invalid, count = "23001801810100" + "80", "2f001a0002000000"  # TPDO 1, two objects of which the second is none
    assert bench.transfer(invalid) == "6000180100000000"
    assert bench.transfer(count) == "80001a0041000406"
    assert bench.transfer("2f001a0001000000") == "60001a0000000000"


def test_an_answer_that_nobody_asked_for_disturbs_no_later_transfer(bench):
    bench.far.say(0x581, "8079600000000206")  # as from a firmware without 0x6079, where the loop's request is refused
    bench.cycle()
    bench.cycle()
    bench.drive.reset_fault()
    bench.drive.reset_fault()


def test_demands_are_never_clipped(bench):
    bench.drive.engage(Mode.CURRENT)
    for value in (math.nan, math.inf, 1000.0):
        with pytest.raises(InputError):
            bench.drive.command(value)


def test_safe_state_is_confirmed_by_the_drive(bench):
    bench.engage(Mode.CURRENT)
    confirmation = bench.drive.safe_state(bench.drive.settings.sdo_timeout_s)
    assert confirmation.safe
    assert bench.far.follows() == ["off", 0.0]


def test_safe_state_reaches_a_drive_that_was_never_opened(make_bench):
    bench = make_bench()
    confirmation = bench.drive.safe_state(bench.drive.settings.sdo_timeout_s)
    assert confirmation == (True, "switch on disabled, statusword 0x0240")


def test_safe_state_says_what_it_could_not_confirm(make_bench):
    bench = make_bench(sdo_timeout_s=0.3)
    bench.far.cut_cable()
    before = bench.clock.now()
    confirmation = bench.drive.safe_state(0.5)
    assert not confirmation.safe
    assert "no SDO answer" in confirmation.detail
    if bench.exact:
        assert bench.clock.now() - before < 0.5 + 0.001


def test_safe_state_wakes_a_node_that_was_told_to_stop(make_bench):
    bench = make_bench(sdo_timeout_s=0.2)
    bench.drive.open()
    bench.engage(Mode.CURRENT)
    bench.far.stop_node()
    confirmation = bench.drive.safe_state(1.0)
    assert confirmation.safe
    assert bench.far.follows() == ["off", 0.0]


def test_no_wait_of_a_set_up_drive_may_outlast_its_safe_state():
    for change in ({"sdo_timeout_s": 1.01}, {"consumer_heartbeat_ms": 1001}):
        with pytest.raises(ValidationError):
            ElmoSettings(node=1, counts_per_turn=4, **change)


def test_a_drive_found_in_operation_is_out_of_it_before_anything_is_configured(make_bench):
    bench = make_bench()
    bench.far.run_away()
    bench.drive.open()
    sdo = bench.sent(0x601)
    writes = [data for data in sdo if data[0] != 0x40]
    assert writes[0] == bytes.fromhex("2b40600000000000")
    assert bench.far.follows() == ["off", 0.0]


def test_stop_now_reaches_a_drive_in_any_network_state_and_waits_for_nothing(make_bench):
    bench = make_bench()
    bench.far.run_away()
    before = bench.clock.now()
    bench.drive.stop_now()
    if bench.exact:
        assert bench.clock.now() == before
    bench.wait_until(lambda: bench.far.follows()[0] == "off")
    assert bench.drive.safe_state(bench.drive.settings.sdo_timeout_s).safe  # not misled by the first frame's answer


@pytest.mark.parametrize(("how", "said"), [("reboot", "boot-up"), ("stop_node", "stopped")])
def test_a_node_that_leaves_the_operational_state_is_noticed_by_its_next_heartbeat(bench, how, said):
    bench.engage(Mode.CURRENT)
    bench.wait_until(lambda: bench.cycle() and bench.drive._condition.operational)
    getattr(bench.far, how)()
    before = bench.clock.now()
    with pytest.raises(DeviceFault, match=rf"node 1 rebooted or left the operational state \({said}\)"):
        for _ in range(5000):
            bench.cycle(answer_s=0.002)
    if bench.exact:
        assert bench.clock.now() - before < 0.055


def test_only_operational_is_a_sign_of_life(make_bench):
    bench = make_bench(producer_heartbeat_ms=20)
    bench.drive.open()
    bench.far.stop_node()
    with pytest.raises((NoAnswer, DeviceFault), match=r"no heartbeat of node 1|left the operational state"):
        for _ in range(5000):
            bench.cycle(answer_s=0.002)


@pytest.fixture
def of_32_bits(make_bench):
    """A drive that has no range of positions (0x607B), and goes round where its 32 bits do."""
    bench = make_bench()
    bench.far.lack(0x607B, 1)
    bench.far.lack(0x607B, 2)
    bench.drive.open()
    return bench


def test_the_angle_goes_on_where_the_drives_counter_goes_round(of_32_bits):
    bench = of_32_bits
    count = 2 * math.pi / 40000
    angles = []
    for counts in (0x7FFFFFF0, 0x80000010, 0x80000030, 0x7FFFFFF8):
        bench.far.turn(counts * count)
        angles.append(bench.cycle()[5] / count)
    assert angles == pytest.approx([0x7FFFFFF0, 0x80000010, 0x80000030, 0x7FFFFFF8], abs=0.01)


def test_an_angle_is_demanded_in_the_drives_32_bits(of_32_bits):
    bench = of_32_bits
    count = 2 * math.pi / 40000
    for counts in (0x7FFFFFF0, 0x80000010):
        bench.far.turn(counts * count)
        bench.cycle()
    bench.engage(Mode.ANGLE)
    assert bench.sent(0x301)[-1] == struct.pack("<ii", 0x80000010 - 2**32, 0)
    bench.drive.command(0x80000100 * count)
    values = bench.cycle()
    assert bench.sent(0x301)[-1] == struct.pack("<ii", 0x80000100 - 2**32, 0)
    assert values[2] == pytest.approx(0x80000100 * count)
    with pytest.raises(InputError):
        bench.drive.command(-0x100 * count)


@pytest.mark.parametrize("most", [(500, 50000), (50000, 500)])
def test_a_current_above_what_the_drive_lets_flow_is_refused(make_bench, most):
    bench = make_bench()
    bench.far.allow(*most)
    bench.drive.open()
    bench.engage(Mode.CURRENT)
    bench.drive.command(-q_axis(500))
    with pytest.raises(InputError, match=r"above the 6.85 A that the drive lets flow \(0x6072, 0x6073: 500 per mille"):
        bench.drive.command(q_axis(501))


def test_a_drive_that_lets_nothing_flow_is_refused(make_bench):
    bench = make_bench()
    bench.far.allow(0, 1000)
    with pytest.raises(DeviceError, match="0x6072 is 0"):
        bench.drive.open()


def test_a_drive_that_limits_its_demand_is_noticed_once_an_onset(bench):
    bench.engage(Mode.CURRENT)
    bench.drive.command(q_axis(600))
    bench.cycle()
    bench.cycle()
    assert not bench.drive.notices()
    results = []
    for most in (500, 50000, 500):
        bench.far.allow(most, most)
        began = bench.clock.now()
        while bench.clock.now() - began < 1.1:
            bench.cycle(period=0.01)
            results += bench.drive.notices()
    assert results == ["the drive limits its demand by itself (bit 11 of statusword 0x0E37)"] * 2


def test_the_bus_voltage_comes_by_sdo_with_its_own_stamps(make_bench):
    bench = make_bench(bus_voltage_period_s=0.05)
    bench.drive.open()
    rows = []
    while len(rows) < 3:
        bench.cycle()
        rows += bench.drive.take()
    assert [row.values for row in rows] == [(29.6,)] * 3
    assert rows[0].time < rows[1].time < rows[2].time
    if bench.exact:
        assert rows[1].time - rows[0].time == pytest.approx(0.05, abs=0.002)


# -- in process only: hundreds of benches would take minutes at the pace of a real bus ---------------------------------

frames = st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8))


@settings(max_examples=300)
@given(st.lists(frames, max_size=30))
def test_no_babble_from_the_bus_enables_a_drive(noise):
    bench = ElmoBench()
    bench.drive.open()
    for frame in noise:
        bench.port.bus.arrived.append(frame)
        try:
            bench.cycle()
        except DeviceError:
            break
    bench.close()
    assert bench.shaft.following[0] == "off"
    assert all(struct.unpack_from("<H", data)[0] == 0 for data in bench.sent(0x201))


@settings(max_examples=300)
@given(
    st.lists(
        st.builds(Frame, st.sampled_from([0, 0x80, 0x201, 0x301, 0x601, 0x701]), st.binary(max_size=8)), max_size=30
    )
)
def test_the_far_end_survives_any_frames(noise):
    bench = ElmoBench()
    for frame in noise:
        for answer in bench.far.receive(frame, 0.0):
            assert len(answer.data) <= 8
