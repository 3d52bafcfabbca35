"""What is refused before anything moves: loops too slow for their drives, disks too small, trips behind a limit."""

import math

import pytest

from leactl import yamlfile
from leactl.errors import InputError
from leactl.quantities import ChannelSpec
from leactl.safety.disk import BYTES_A_VALUE, COPIES, planned_bytes
from leactl.safety.interlocks import Interlocks
from leactl.safety.plan_checks import FEWEST_CYCLES_PER_TIMEOUT, LEAST_RATE_WITH_SUPPLY_HZ, check_rate
from leactl.safety.thermal.box import Box, Range
from leactl.safety.thermal.turning import highest_speed
from tests.safety.guards import LEA
from tests.safety.rig import LIMITS


@pytest.mark.parametrize("silence", [0.05, 0.2, 2.0])
def test_three_cycles_fall_into_the_time_that_a_device_goes_on_alone(silence):
    enough = FEWEST_CYCLES_PER_TIMEOUT / silence
    check_rate(enough, {"drive": silence, "sensor": None})
    with pytest.raises(InputError, match=f"too slow for drive, which stops after {silence:g} s") as refused:
        check_rate(0.99 * enough, {"drive": silence, "sensor": None})
    assert f"at least {enough:.4g} Hz was expected" in str(refused.value)
    assert len(refused.value.faults) == 1


def test_a_supply_needs_a_loop_that_hears_of_a_stop():
    check_rate(LEAST_RATE_WITH_SUPPLY_HZ, {"supply": None}, ["supply"])
    check_rate(0.02, {"supply": None})
    with pytest.raises(InputError, match=r"0\.02 Hz is too slow for supply, a supply: a stop waits for the next cycle"):
        check_rate(0.02, {"supply": None}, ["supply"])


def test_the_loop_is_planned_at_the_rate_it_is_recorded_and_others_at_their_own():
    def channels(count):
        return [ChannelSpec(f"c{k}", "torque", "test", "device") for k in range(count)]

    streams = {"loop": channels(3), "sensor": channels(1), "fast": channels(2)}
    planned = planned_bytes(streams, record_hz=50.0, rate_hz=1000.0, duration_s=10.0, fast_hz={"fast": 20_000.0})
    # times beside each stream's values
    assert planned == COPIES * BYTES_A_VALUE * 10.0 * (4 * 50.0 + 2 * 1000.0 + 3 * 20_000.0)


def interlocks(text):
    return yamlfile.parse(text).validate(Interlocks)


def test_a_trip_at_the_limit_is_kept_and_one_beyond_it_is_told():
    low, high = LIMITS.bus_voltage_low_V, LIMITS.bus_voltage_high_V
    assert interlocks(f"bus_voltage: {{trip_low_V: {low}, trip_high_V: {high}}}").beyond(LIMITS) == []
    [(place, told)] = interlocks(f"bus_voltage: {{trip_low_V: {low - 0.1}}}").beyond(LIMITS)
    assert place == ("bus_voltage",)
    assert f"a trip at {low - 0.1:g} V is beyond the limits of {low:g} to {high:g} V" in told
    [(_place, told)] = interlocks(f"bus_voltage: {{trip_high_V: {high + 0.1}}}").beyond(LIMITS)
    assert f"a trip at {high + 0.1:g} V" in told


def test_a_lone_temperature_is_the_hot_side():
    [entry] = [entry for _, entry, _ in interlocks("housing_temperature: {trip_degC: 85}").entries()]
    assert entry.window("trip") == (-math.inf, 85.0)


def test_where_a_speed_is_not_known_it_is_the_highest_that_the_bench_lets_pass():
    assert highest_speed([], 40.0) == 0.0
    assert highest_speed([3.0, -5.0], 40.0) == 5.0
    assert highest_speed([3.0, math.nan, -5.0], 40.0) == 40.0
    assert highest_speed([3.0, -math.inf], 40.0) == 40.0


def test_the_coolest_corner_has_every_tolerance_on_its_cool_side():
    whole, cool = Box.of(LEA), Box.favourable(LEA)
    assert cool.ambient_rise == -whole.ambient_rise < 0.0
    assert cool.temperature_rise == -whole.temperature_rise
    assert cool.current_gain == pytest.approx(2.0 - whole.current_gain)
    assert cool.winding_capacitance == Range(whole.winding_capacitance.high, whole.winding_capacitance.high)
    assert cool.phase_resistance == Range(whole.phase_resistance.low, whole.phase_resistance.low)
