"""Supplies under supervision: what they may put out, what their leads heat by, and how they are cut."""

import math
from contextlib import suppress

import numpy as np
import pytest

from leactl.driver.contract import Row
from leactl.errors import DeviceError, InputError, SafetyTrip
from leactl.safety.interlocks import Interlocks
from leactl.safety.supervisor import Supervisor
from leactl.safety.supplies import Ending
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.temperature_bound import ThermalBound
from tests.safety.guards import LEA, guard_of
from tests.safety.rig import LIMITS
from tests.safety.supply_rig import PERIOD, ProtectedSupplyRig, SupplyRig

OFF = [b"", b"SOUT1"]


# -- what is passed on -----------------------------------------------------------------------------------------------


def test_levels_are_passed_on_and_the_output_is_on_once_it_is_measured():
    rig = SupplyRig()
    rig.supplies.put_out("test", 8.0, 9.0)
    assert not rig.supplies.supplying("test")
    rig.cycle(20)
    assert rig.supplies.supplying("test")
    assert rig.far.output() == [True, pytest.approx(5.4), 9.0]
    assert rig.supplies.most == {"test": (8.0, 10.0)}


@pytest.mark.parametrize(
    ("levels", "error", "said"),
    [
        ((8.0, 21.3), SafetyTrip, r"test line_current of 21.3 A is outside the limits \(-21.21, 21.21\)"),
        ((8.0, math.nan), SafetyTrip, "test line_current of nan A is outside"),
        ((8.0, -1.0), InputError, "-1 A asked of a supply"),
        ((8.0, 10.1), InputError, "10.1 A asked of a supply that is good for 0.1 to 10 A"),
        ((9.0, 9.0), InputError, "9 V asked of a supply that is good for 1 to 8 V"),
    ],
)
def test_what_is_refused_reaches_no_supply(levels, error, said):
    rig = SupplyRig()
    with pytest.raises(error, match=said):
        rig.supplies.put_out("test", *levels)
    with suppress(SafetyTrip):
        rig.cycle(20)
    assert not any(line.startswith((b"CURR", b"VOLT", b"SOUT0")) for line in rig.lines())
    assert rig.heating == 0.0


def test_a_role_without_a_supply_is_an_input_error():
    with pytest.raises(InputError, match="no supply feeds the leads of load"):
        SupplyRig().supplies.put_out("load", 8.0, 1.0)


def test_two_supplies_at_the_leads_of_one_role_are_refused():
    rig = SupplyRig()
    with pytest.raises(InputError, match="two supplies at the leads of test"):
        Supervisor(LIMITS, {}, [rig.supply, rig.supply], rig.clock, guard_of(), Interlocks())


def test_a_winding_that_is_hot_already_takes_no_more_than_it_may():
    rig = SupplyRig(start=128.7)
    rig.cycle(6)
    with pytest.raises(SafetyTrip, match=r"test winding: .* A may flow through two leads now, 9 A were asked for"):
        rig.supplies.put_out("test", 8.0, 9.0)
    assert b"SOUT0" not in rig.lines()


# -- what heats ------------------------------------------------------------------------------------------------------


def test_two_leads_carry_less_than_the_q_axis_may():
    rig = SupplyRig()
    rig.guard.allowed["test"] = 12.0
    with pytest.raises(SafetyTrip, match=r"8\.5 A may flow through two leads now, 9 A were asked for"):
        rig.supplies.put_out("test", 8.0, 9.0)


def test_the_protection_goes_back_for_levels_that_need_none():
    rig = ProtectedSupplyRig()
    rig.supplies.endings = {("test", 4.0, 2.0): Ending(trips_at=4.5)}
    levels = []
    for voltage in (4.0, 6.0):
        rig.heat(voltage, 2.0)
        rig.cycle(30)
        levels.append(rig.far.fed.over_voltage.level)
    assert levels == [4.5, 8.0]


def test_until_readings_tell_what_was_asked_for_heats():
    rig = SupplyRig()
    rig.supplies.put_out("test", 8.0, 9.0)
    assert rig.heating == 9.0
    row = Row("supply", rig.clock.now(), (0.0, 0.0))
    rig.supplies.look(row)  # was asked for before the command, and may be stamped after it
    assert rig.heating == 9.0
    rig.supplies.look(row)
    assert rig.heating == 0.0


def test_a_supply_at_its_voltage_heats_by_what_it_gives_and_not_by_what_was_asked():
    rig = SupplyRig()
    rig.heat(3.0, 10.0)
    assert rig.heating == pytest.approx(5.0)


def test_a_current_that_is_switched_off_heats_until_readings_tell_that_it_is():
    rig = SupplyRig()
    rig.heat()
    rig.far.stuck_on()
    rig.supplies.switch_off("test")
    rig.cycle(5)
    assert rig.heating == 9.0
    rig.far.mend()
    rig.supplies.switch_off("test")
    rig.cycle(10)
    assert rig.heating == 0.0
    assert not rig.supplies.supplying("test")


def test_a_reading_that_is_no_number_heats_by_the_most_that_the_supply_gives():
    rig = SupplyRig()
    rig.heat(8.0, 2.0)
    rig.supplies.look(Row("supply", rig.clock.now(), (math.nan, math.nan)))
    assert rig.heating == 10.0


def test_after_a_reading_that_is_no_number_the_next_one_may_be_of_the_moment_before_it_too():
    rig = SupplyRig()
    rig.heat(8.0, 2.0)
    heating = []
    for amperes in (math.nan, 2.0, 2.0):
        rig.supplies.look(Row("supply", rig.clock.now(), (1.2, amperes)))
        heating.append(rig.heating)
    assert heating == [10.0, 10.0, 2.0]


def test_a_supply_that_gives_more_than_is_outlived_trips_though_a_reading_is_lost_now_and_then():
    rig = SupplyRig()
    rig.supplies.endings = {("test", 8.0, 2.0): Ending(endured_current=2.5)}
    rig.heat(8.0, 2.0)

    def read(amperes, seconds):
        for second in range(seconds):
            rig.supplies.look(Row("supply", rig.clock.now() + second, (1.2, amperes(second))))

    read(lambda _: math.nan, 30)  # what is not known is no current that is too large
    read(lambda _: 2.6, 10)  # for 9 s
    read(lambda _: 2.5, 1)
    with pytest.raises(SafetyTrip, match=r"test supply gives 2\.6 A, and its winding outlives 2\.5 A at the most"):
        read(lambda second: math.nan if second % 4 == 2 else 2.6, 12)


def test_a_larger_current_by_another_sensor_counts():
    rig = SupplyRig()
    rig.heat(8.0, 2.0)
    rig.supervisor._measured._leads.tell("test", "shunt", 5.0)
    rig.cycle(3)
    assert rig.heating == 5.0


def test_two_leads_heat_two_phases_by_half_each_and_no_phase_by_two_thirds():
    """Against the bound itself, stepped without a guard, which allows for heat that comes late within a step."""
    rig = SupplyRig()
    rig.heat()
    before = rig.guard.node_bounds["test"][:, None]
    rig.cycle(30 * 20 + 15)  # a cold bound is told of heat once a second
    half, most = (stepped(before, aligned) for aligned in (0.5, 1.0))
    assert half < rig.guard.hottest["test"] < half + 3.0 < most - 3.0


def stepped(before, aligned):
    """Hottest phase [degC] after 20 s of 2 R I^2 with a share of (1 + aligned) / 3 in it."""
    alone = ThermalBound([Box.of(LEA)], 25.0)
    alone.set(before)
    alone.step(20.0, np.array([2 * 81.0]), np.array([aligned]), np.zeros(1), 25.0, delay=0.0)
    return alone.hottest()[0]


def test_the_guard_ends_what_would_pass_the_limit():
    rig = SupplyRig(start=122.0)
    rig.heat()
    with pytest.raises(SafetyTrip, match="test winding: its hottest phase may be at"):
        rig.cycle(30 * 120)
    assert rig.lines()[-2:] == OFF
    assert rig.guard.hottest["test"] < 130.0


# -- how it is cut ---------------------------------------------------------------------------------------------------


def test_a_trip_cuts_the_supply_at_once():
    rig = SupplyRig()
    rig.heat()
    rig.said.clear()
    with pytest.raises(SafetyTrip):
        rig.supervisor.trip("by hand")
    assert rig.lines() == OFF
    with pytest.raises(SafetyTrip, match="by hand"):
        rig.supplies.put_out("test", 8.0, 1.0)


def test_a_trip_cuts_a_supply_that_was_asked_for_and_is_not_on_yet():
    rig = SupplyRig()
    rig.supplies.put_out("test", 8.0, 9.0)
    assert not rig.supplies.supplying("test")
    with pytest.raises(SafetyTrip):
        rig.supervisor.trip("by hand")
    for _ in range(30):  # the driver goes on
        rig.supply.take()
        rig.clock.sleep_until(rig.clock.now() + PERIOD)
    assert b"SOUT0" not in rig.lines()
    assert not rig.far.output()[0]


def test_an_output_that_goes_on_by_itself_trips():
    rig = SupplyRig()
    rig.cycle(3)
    rig.far.leave_on(8.0, 9.0)
    with pytest.raises(SafetyTrip, match="supply: the output is on by itself"):
        rig.cycle(60)


def test_a_supply_that_falls_silent_ends_the_run():
    rig = SupplyRig()
    rig.heat()
    rig.far.freeze()
    with pytest.raises(DeviceError, match="supply: no answer to GETS"):
        rig.cycle(30 * 5)


def test_a_supply_that_is_stuck_on_is_told():
    rig = SupplyRig()
    rig.heat()
    rig.far.stuck_on()
    confirmed = rig.supervisor.make_safe()["supply"]
    assert not confirmed.safe
    assert "the output is still on" in confirmed.detail
