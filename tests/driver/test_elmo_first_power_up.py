"""What an Elmo drive may bring along at its first power-up: settings of others, its own range, another master."""

import math
import struct

import pytest
from leactl_plugins.elmo_can.driver import ENABLE_TIME_S

from leactl.driver.contract import Mode
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer

from .elmo_bench import q_axis
from .failing import COUNTS

COUNT = 2 * math.pi / COUNTS


@pytest.fixture
def bench(make_bench):
    bench = make_bench()
    bench.drive.open()
    return bench


def cycles(bench, number, **options):
    return [bench.cycle(**options) for _ in range(number)]


# -- another master ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("make_bench", ["in_process"], indirect=True)
def test_a_heartbeat_by_the_hosts_own_number_ends_the_run(bench):
    bench.engage(Mode.CURRENT)
    bench.far.say(0x77E, "05")
    with pytest.raises(DeviceFault, match=r"another device sends heartbeats as node 126 \(0x77E\).* host_node"):
        cycles(bench, 3)


@pytest.mark.parametrize("make_bench", ["in_process"], indirect=True)
def test_a_heartbeat_by_the_hosts_own_number_refuses_the_start(make_bench):
    bench = make_bench()
    bench.far.say(0x77E, "05")
    with pytest.raises(DeviceFault, match="another device sends heartbeats as node 126"):
        bench.drive.open()


@pytest.mark.parametrize("make_bench", ["in_process"], indirect=True)
def test_no_frame_of_another_master_makes_the_drive_deaf_to_a_foreign_heartbeat(bench):
    bench.engage(Mode.CURRENT)
    bench.far.say(0x601, "4041600000000000")
    cycles(bench, 3)
    bench.far.say(0x77E, "05")
    with pytest.raises(DeviceFault, match="another device sends heartbeats as node 126"):
        cycles(bench, 3)


DEMANDS_OF_OTHERS = [
    (0x201, "0f00c8000a", r"sends demands to node 1 \(0f00c8000a\)"),
    (0x301, "", r"sends demands to node 1 \(an empty PDO\)"),
    (0x501, "00", "sends demands to node 1"),
    (0x601, "2b40600000000000", r"writes to node 1 by SDO \(2b40600000000000\)"),
    (0x601, "c640600002000000", "writes to node 1 by SDO"),
]


@pytest.mark.parametrize("make_bench", ["in_process"], indirect=True)
@pytest.mark.parametrize(("identifier", "data", "said"), DEMANDS_OF_OTHERS)
def test_a_demand_of_another_master_ends_the_run(bench, identifier, data, said):
    bench.engage(Mode.CURRENT)
    bench.far.say(identifier, data)
    with pytest.raises(DeviceFault, match=f"another master on the bus {said}"):
        cycles(bench, 3)
    assert bench.drive.safe_state(1.0).safe


@pytest.mark.parametrize("make_bench", ["in_process"], indirect=True)
@pytest.mark.parametrize(("identifier", "data", "said"), DEMANDS_OF_OTHERS)
def test_a_demand_of_another_master_refuses_the_start(make_bench, identifier, data, said):
    bench = make_bench()
    bench.far.say(identifier, data)
    with pytest.raises(DeviceFault, match=f"another master on the bus {said}"):
        bench.drive.open()


@pytest.mark.parametrize("make_bench", ["in_process"], indirect=True)
def test_another_master_that_reads_is_told_once(bench):
    bench.engage(Mode.CURRENT)
    for _ in range(3):
        bench.far.say(0x601, "4041600000000000")
        cycles(bench, 3)
    [told] = [text for text in bench.drive.notices() if "another master" in text]
    assert told.startswith("another master on the bus reads from node 1 by SDO (4041600000000000)")


def test_what_another_master_has_mapped_is_made_invalid(make_bench):
    bench = make_bench()
    for index in (0x1402, 0x1802):
        bench.far.hold(index, 2, 1)
    bench.drive.open()
    valid = [k for k in (*range(0x1400, 0x1404), *range(0x1800, 0x1804)) if not bench.far.holds(k, 1) >> 31]
    assert valid == [0x1400, 0x1401, 0x1800, 0x1801, 0x1803]  # the last one tells changes of state


def test_two_drives_with_one_node_are_told(make_bench):
    bench = make_bench()
    bench.far.have_a_twin()
    with pytest.raises(DeviceError, match=r"two devices answer as node 1: connect one of them alone"):
        bench.drive.open()


def test_stops_that_await_no_answer_make_no_twin_of_a_drive_that_is_opened_again(make_bench):
    bench = make_bench()
    for _ in range(5):
        bench.drive.open()
        bench.drive.stop_now()
        assert bench.drive.safe_state(1.0).safe
        bench.drive.close()
    bench.drive.open()
    bench.engage(Mode.CURRENT)


def test_offsets_of_another_master_are_added_to_nothing(make_bench):
    bench = make_bench()
    bench.far.hold(0x60B0, 0, 4000)
    bench.far.hold(0x60B1, 0, -20000)
    bench.far.hold(0x60B2, 0, 300)
    bench.drive.open()
    assert [bench.far.holds(index, 0) for index in (0x60B0, 0x60B1, 0x60B2)] == [0, 0, 0]
    bench.engage(Mode.CURRENT)
    bench.drive.command(0.1)
    bench.cycle()
    assert bench.far.follows() == ["current", pytest.approx(q_axis(7))]


def test_an_offset_that_stays_refuses_the_start(make_bench):
    bench = make_bench()
    bench.far.hold(0x60B2, 0, 300)
    bench.far.ignore_writes(0x60B2)
    with pytest.raises(DeviceError, match="0x60B2:0 holds 300 after 0 was written"):
        bench.drive.open()
    assert bench.far.follows()[0] == "off"


def test_a_firmware_without_any_of_these_objects_is_met_all_the_same(make_bench):
    bench = make_bench()
    absent = [(0x607E, 0), (0x60B0, 0), (0x60B1, 0), (0x60B2, 0), (0x60C2, 1), (0x60C2, 2), (0x6502, 0)]
    absent += [(0x1006, 0)]
    absent += [(index, sub) for index in (0x607B, 0x608F, 0x6091, 0x6092) for sub in (1, 2)]
    for place in absent:
        bench.far.lack(*place)
    bench.drive.open()
    bench.drive.pace(0.02)
    bench.engage(Mode.CURRENT)


@pytest.mark.parametrize("index", [0x607E, 0x608F, 0x607B, 0x60B2])
@pytest.mark.parametrize("code", [0x08000022, 0x05040000, 0x06010001])
def test_a_refusal_is_not_taken_for_an_object_that_the_drive_lacks(make_bench, index, code):
    bench = make_bench()
    bench.far.refuse(index, code)
    with pytest.raises(DeviceError, match=rf"0x{index:04X}:\d+ refused, abort 0x{code:08X}"):
        bench.drive.open()
    assert bench.far.follows()[0] == "off"


@pytest.mark.parametrize("index", [0x3034, 0x6502, 0x1005, 0x1006])
def test_what_a_drive_need_not_tell_it_may_refuse_for_any_reason(make_bench, index):
    bench = make_bench()
    bench.far.refuse(index, 0x08000000)
    bench.drive.open()
    bench.drive.pace(0.02)
    bench.engage(Mode.CURRENT)


def test_a_drive_that_makes_the_sync_is_told_no_period(make_bench):
    bench = make_bench()
    bench.far.hold(0x1005, 0, 1 << 30 | 0x80)
    bench.drive.open()
    bench.drive.pace(0.02)
    assert bench.far.holds(0x1006, 0) == 0


def test_a_period_that_the_drive_confirms_and_forgets_leaves_it_what_it_had(make_bench):
    bench = make_bench()
    bench.far.ignore_writes(0x1006)
    bench.drive.open()
    with pytest.raises(DeviceError, match="0x1006:0 holds 0 after 20000 was written"):
        bench.drive.pace(0.02)
    assert bench.drive.safe_state(1.0).safe
    bench.drive.close()
    assert (bench.far.holds(0x60C2, 1), bench.far.holds(0x60C2, 2)) == (1, -3)


def test_a_drive_that_tells_no_sizes_is_met_all_the_same(make_bench):
    bench = make_bench()
    bench.far.tell_no_sizes()
    bench.drive.open()
    bench.engage(Mode.CURRENT)
    bench.drive.command(0.1)
    bench.cycle()
    assert bench.far.follows() == ["current", pytest.approx(q_axis(7))]


def test_a_drive_without_remote_frames_keeps_saying_so(make_bench):
    bench = make_bench()
    bench.far.have_no_remote_frames()
    bench.drive.open()
    assert bench.far.holds(0x1800, 1) == 1 << 30 | 0x181
    bench.engage(Mode.CURRENT)


@pytest.mark.parametrize("index", [0x607E, 0x608F, 0x3034, 0x607B, 0x6502, 0x60B2])
def test_an_answer_that_is_lost_is_not_taken_for_an_object_that_the_drive_lacks(make_bench, index):
    bench = make_bench()
    bench.far.say_nothing_of(index)
    with pytest.raises(NoAnswer, match=f"0x{index:04X}"):
        bench.drive.open()
    assert bench.far.follows()[0] == "off"


# -- positions ---------------------------------------------------------------------------------------------------------
def test_the_angle_goes_on_where_the_drives_range_of_positions_ends(bench):
    turned = (999_999_990, 1_000_000_020, 1_000_000_050, 999_999_980)
    angles = []
    for counts in turned:
        bench.far.turn(counts * COUNT)
        angles.append(bench.cycle()[5] / COUNT)
    assert angles == pytest.approx(list(turned), abs=0.01)


@pytest.mark.parametrize(("low", "high"), [(0, COUNTS), (-500, 1500), (-(2**31), 2**31 - 1)])
def test_any_range_of_positions_is_unwound_from_where_it_is_met(make_bench, low, high):
    bench = make_bench()
    bench.far.hold(0x607B, 1, low)
    bench.far.hold(0x607B, 2, high)
    bench.far.turn((high - 1) * COUNT)
    bench.drive.open()
    step = (high - low) // 5
    met = [bench.cycle()[5] / COUNT]
    for number in range(1, 12):
        bench.far.turn((high - 1 + number * step) * COUNT)
        met.append(bench.cycle()[5] / COUNT)
    assert met == pytest.approx([high - 1 + number * step for number in range(12)], rel=1e-9, abs=0.01)


def test_an_angle_is_demanded_inside_the_drives_range(bench):
    for counts in (999_999_990, 1_000_000_010):
        bench.far.turn(counts * COUNT)
        bench.cycle()
    bench.engage(Mode.ANGLE)
    assert bench.sent(0x301)[-1] == struct.pack("<ii", 1_000_000_010 - 2_000_000_000, 0)
    bench.drive.command((1_000_000_010 + 4000) * COUNT)
    bench.cycle()
    assert bench.sent(0x301)[-1] == struct.pack("<ii", 1_000_004_010 - 2_000_000_000, 0)
    with pytest.raises(InputError, match="outside what the drive can hold"):
        bench.drive.command(2_000_000_011 * COUNT)


@pytest.mark.parametrize("polarity", [0x80, 0x40, 0xC0])
def test_a_drive_that_turns_its_sense_is_refused(make_bench, polarity):
    bench = make_bench()
    bench.far.hold(0x607E, 0, polarity)
    with pytest.raises(DeviceError, match=rf"polarity 0x607E is 0x{polarity:02X}.* 0x00 was expected.* `sign`"):
        bench.drive.open()


@pytest.mark.parametrize(
    ("objects", "said"),
    [
        ({(0x6091, 1): 2}, "user units, 0.5 of them a count"),
        ({(0x6092, 1): 360}, "user units, 360 of them a count"),
        (
            {(0x608F, 1): 10_000, (0x6092, 1): 10_000},
            r"it counts 10000 in a turn \(0x608F\), the bench file says counts_per_turn: 40000",
        ),
    ],
)
def test_scales_that_contradict_the_bench_file_are_refused_with_both_values(make_bench, objects, said):
    bench = make_bench()
    for place, value in objects.items():
        bench.far.hold(*place, value)
    with pytest.raises(DeviceError, match=said):
        bench.drive.open()


@pytest.mark.parametrize("counts", [COUNTS // 4, 4 * COUNTS])
def test_counts_of_a_turn_that_the_drive_tells_are_held_against_the_bench_file(make_bench, counts):
    bench = make_bench()
    bench.far.have("u32", 0x3034, 18, counts)
    said = rf"counts {counts} in a turn \(CA\[18\], 0x3034:18\), the bench file says counts_per_turn: {COUNTS}"
    with pytest.raises(DeviceError, match=said):
        bench.drive.open()
    assert bench.far.follows()[0] == "off"


def test_a_drive_that_no_motor_was_tuned_to_is_refused(make_bench):
    bench = make_bench()
    bench.far.hold(0x6075, 0, 0)
    with pytest.raises(DeviceError, match="rated current 0x6075 is 0 mA; the drive has not been tuned to a motor"):
        bench.drive.open()


def test_units_that_come_to_counts_are_taken(make_bench):
    bench = make_bench()
    for place in ((0x608F, 1), (0x6092, 1)):
        bench.far.hold(*place, COUNTS)
    bench.drive.open()


# -- modes and operation -----------------------------------------------------------------------------------------------
def test_a_drive_is_enabled_in_the_mode_that_was_asked_for_alone(bench):
    bench.far.hold(0x60FF, 0, 60_000)
    bench.far.stay_in_mode(9)
    bench.drive.engage(Mode.CURRENT)
    refused_by = bench.clock.now() + 2 * ENABLE_TIME_S
    with pytest.raises(NoAnswer, match=r"switched on, 0x0633|mode 9 \(0x6061\) where 10 was asked for"):
        while bench.clock.now() < refused_by:
            bench.cycle()
            assert bench.far.follows()[0] == "off"
    assert struct.pack("<ii", 1592, 0) in bench.sent(0x301)  # what was left there is overwritten before


@pytest.mark.parametrize("lacks_status", [False, True])
def test_a_drive_that_its_safe_torque_off_holds_back_is_told(bench, lacks_status):
    bench.far.switch_torque_off(0x2)
    if lacks_status:
        bench.far.lack(0x2086, 0)
    bench.drive.engage(Mode.CURRENT)
    refused_by = bench.clock.now() + 2 * ENABLE_TIME_S
    with pytest.raises(NoAnswer) as told:
        while bench.clock.now() < refused_by:
            bench.cycle()
    status = "" if lacks_status else ", safe torque off 0x2086 is 0x00000002"
    assert str(told.value) == (
        f"drive: not in operation after 2 s: switch on disabled, 0x0240{status}; look at its safe torque"
        " off, its inhibit inputs and its brake"
    )


def test_a_mode_that_the_drive_lacks_is_refused(make_bench):
    bench = make_bench()
    bench.far.hold(0x6502, 0, 0x001)
    bench.drive.open()
    with pytest.raises(InputError, match=r"the drive has no mode 10, which 'current' needs \(0x6502: 0x00000001\)"):
        bench.drive.engage(Mode.CURRENT)


def test_a_drive_that_drops_out_between_two_syncs_is_noticed_although_the_held_word_enables_it_again(bench):
    bench.engage(Mode.CURRENT)
    cycles(bench, 3)
    bench.far.drop_out()
    with pytest.raises(DeviceFault, match="left operation by itself, switched on, statusword 0x0233"):
        cycles(bench, 3)


def test_setpoints_come_as_often_as_the_drive_is_told_and_its_own_time_is_given_back(make_bench):
    bench = make_bench()
    bench.far.hold(0x60C2, 1, 4)
    bench.far.hold(0x1006, 0, 4000)
    for period, held in (
        (0.02, (20, -3)),
        (0.001, (1, -3)),
        (1 / 30, (34, -3)),
        (1 / 300, (34, -4)),
        (0.0005, (50, -5)),
    ):
        bench.drive.open()
        bench.drive.pace(period)
        assert (bench.far.holds(0x60C2, 1), bench.far.holds(0x60C2, 2)) == held
        assert bench.far.holds(0x1006, 0) == round(1e6 * period)
        assert bench.drive.safe_state(1.0).safe
        bench.drive.close()
        assert (bench.far.holds(0x60C2, 1), bench.far.holds(0x60C2, 2), bench.far.holds(0x1006, 0)) == (4, -3, 4000)


# -- beginning and end -------------------------------------------------------------------------------------------------
def test_a_run_that_ended_in_order_leaves_no_fault_behind(make_bench):
    bench = make_bench(abort_option=1, consumer_heartbeat_ms=100)
    bench.drive.open()
    bench.engage(Mode.CURRENT)
    assert bench.drive.safe_state(1.0).safe
    bench.drive.close()
    assert bench.far.holds(0x1016, 1) == 0
    if bench.exact:
        bench.clock.sleep_until(bench.clock.now() + 1.0)
    bench.drive.open()  # refused were it in fault
    bench.engage(Mode.CURRENT)


def test_a_drive_that_is_not_confirmed_safe_keeps_its_dead_man(make_bench):
    bench = make_bench(sdo_timeout_s=0.2)
    bench.drive.open()
    bench.engage(Mode.CURRENT)
    bench.drive.close()
    assert bench.far.holds(0x1016, 1) != 0


@pytest.mark.parametrize("make_bench", ["in_process"], indirect=True)
@pytest.mark.parametrize("seconds", [0.001, 0.02, 0.4])
def test_a_fault_may_take_its_time_to_go(make_bench, seconds):
    bench = make_bench(reset_fault_at_start=True)
    bench.far.fault(0x7121)
    bench.far.reset_slowly(seconds)
    bench.drive.open()
    bench.engage(Mode.CURRENT)


@pytest.mark.parametrize("make_bench", ["in_process"], indirect=True)
def test_a_fault_that_stays_for_half_a_second_is_told(make_bench):
    bench = make_bench(reset_fault_at_start=True)
    bench.far.fault(0x7121)
    bench.far.reset_slowly(5.0)
    with pytest.raises(DeviceFault, match="still in fault after a reset"):
        bench.drive.open()


def test_a_node_that_somebody_has_stopped_is_woken_at_the_start(make_bench):
    bench = make_bench(sdo_timeout_s=0.3)
    bench.far.stop_node()
    bench.drive.open()
    bench.engage(Mode.CURRENT)


def test_an_emergency_of_the_run_before_ends_no_later_one(make_bench):
    bench = make_bench()
    bench.drive.open()
    bench.far.say(0x081, "1023010000000000")
    with pytest.raises(DeviceFault):
        cycles(bench, 3)
    assert bench.drive.safe_state(1.0).safe
    bench.drive.close()
    bench.drive.open()
    cycles(bench, 3)
