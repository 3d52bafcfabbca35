"""Currents against a second sensor: what a sound bench may show, what no sound bench can, and what is said of it.

The torque constant is 0.49 N*m/A; friction is 0.208 N*m and 0.0238 N*m*s/rad, each within 10 %.
"""

import itertools
import math

import pytest

from leactl import yamlfile
from leactl.errors import SafetyTrip
from leactl.quantities import ChannelSpec
from leactl.safety.interlocks import Interlocks
from leactl.safety.witnesses import CONVENTIONS, conventions, lone_sensors
from tests.safety.rig import Rig

TORQUE = "torque_disagreement: {tolerance_Nm: 0.2, share_percent: 5, for_s: 0.05}"
KT = 0.49
PERIOD = 0.001


@pytest.fixture
def driven():
    """A drive that follows a current [A] beside a torque sensor that shows a torque [N*m] of its own."""

    def driven(current, torque, interlocks=TORQUE, velocity=0.0, **settings):
        rig = Rig(interlocks, **settings)
        rig.engage()
        rig.shaft.velocity = velocity
        rig.supervisor.command("test", current)
        rig.converter.apply(torque / 5.0)
        return rig

    return driven


def trips_after(rig, seconds):
    """What ends it, and after how long."""
    began = rig.clock.now()
    with pytest.raises(SafetyTrip) as trip:
        rig.run(seconds)
    return str(trip.value), rig.clock.now() - began


# 0.95 x torque - (0.2288 + 0.2) N*m is 4.9 N*m, 10 A, at 5.609 N*m
@pytest.mark.parametrize(("torque", "sound"), [(5.58, True), (5.65, False), (-5.65, False)])
def test_a_rotor_at_rest_gives_what_its_current_and_friction_of_either_sign_explain(driven, torque, sound):
    rig = driven(math.copysign(10.0, torque), torque)
    if sound:
        rig.run(0.5)
    else:
        why, after = trips_after(rig, 0.5)
        assert why.startswith(
            "test q_axis_current of 10 A contradicts test torque, by which 11.53 A flow, no less than "
        )
        assert 0.05 <= after <= 0.08


# (1.05 x torque + 0.2288 + 0.2) N*m over 0.9 x 0.49 N*m/A, whose magnets are hot, is 10 A at 3.792 N*m
@pytest.mark.parametrize(("torque", "sound"), [(3.82, True), (3.75, False)])
def test_hot_magnets_and_friction_explain_that_little_of_a_current_reaches_the_shaft(driven, torque, sound):
    rig = driven(10.0, torque)
    if sound:
        rig.run(0.5)
    else:
        assert "by which 7.653 A flow, no more than 9.9" in trips_after(rig, 0.5)[0]


# at 10 rad/s friction is (0.208 + 0.238) N*m within 10 %, against the motion: 0.95 x (torque + 0.446) - 0.0446 - 0.2
# is 4.9 N*m at 4.969 N*m, 0.6 N*m less than at rest
@pytest.mark.parametrize(("torque", "sound"), [(4.94, True), (5.02, False)])
def test_a_rotor_that_turns_has_its_friction_against_the_motion(driven, torque, sound):
    rig = driven(10.0, torque, velocity=10.0)
    if sound:
        rig.run(0.5)
    else:
        assert "contradicts test torque" in trips_after(rig, 0.5)[0]


def test_a_rotor_that_turns_back_may_have_friction_of_either_sign(driven):
    rig = driven(10.0, 5.2)
    speeds = itertools.cycle([0.3] * 15 + [-0.3] * 15)
    rig.run(0.5, lambda: setattr(rig.shaft, "velocity", next(speeds)))


def test_inertia_explains_a_difference_of_torques(driven):
    rig = driven(0.0, 1.4)
    speeds = itertools.cycle((0.5, -0.5))  # 1000 rad/s^2 x 0.0024 kg*m^2 = 2.4 N*m
    rig.run(0.3, lambda: setattr(rig.shaft, "velocity", next(speeds)))
    rig.shaft.velocity = 0.0
    assert "contradicts test torque" in trips_after(rig, 0.3)[0]


def swung(rig, late, cycles=240):
    """A sine of 10 A in 40 cycles, and its torque so many cycles late."""
    asked = [10.0 * math.sin(2.0 * math.pi * k / 40) for k in range(cycles)]
    for k in range(late, cycles):
        rig.supervisor.command("test", asked[k])
        rig.converter.apply(KT * asked[k - late] / 5.0)
        rig.run(rig.period)


def test_a_torque_that_is_read_cycles_apart_from_its_current_agrees_with_it(driven):
    swung(driven(0.0, 0.0), late=2)


def test_a_swing_of_which_the_sensor_meets_one_side_alone_explains_that_it_shows_less(driven):
    """10 +- 3 A from cycle to cycle beside 3.6 N*m: by mean squares 106 A^2, and 91 A^2 at the most."""
    rig = driven(10.0, 3.6)
    for current in [13.0, 7.0, 10.0] * 100:
        rig.supervisor.command("test", current)
        rig.run(rig.period)


def test_a_torque_against_its_current_is_a_turned_sign(driven):
    with pytest.raises(SafetyTrip, match=r"and the other way, for 0\.05 s: is a sign turned"):
        swung(driven(0.0, 0.0), late=20)


@pytest.mark.parametrize("factor", [math.sqrt(1.5), math.sqrt(2.0), 1.5, math.sqrt(3.0), 1 / 1.5, 1 / math.sqrt(3.0)])
def test_a_current_that_is_misread_by_a_convention_is_found_with_its_name(driven, factor):
    why, after = trips_after(driven(10.0, factor * 10.0 * KT), 0.5)
    assert after <= 0.08
    assert f"{factor:.3g} times as much, near {CONVENTIONS[factor]}" in why


def test_a_swinging_current_that_is_misread_is_found(driven):
    rig = driven(0.0, 0.0)
    with pytest.raises(SafetyTrip, match=r"sqrt\(2\), as"):
        for k in range(400):
            asked = 10.0 * math.sin(2.0 * math.pi * k / 40)
            rig.supervisor.command("test", asked)
            rig.converter.apply(math.sqrt(2.0) * KT * asked / 5.0)
            rig.run(rig.period)


@pytest.mark.parametrize("hertz", [1.0, 4.0, 12.0, 25.0])
@pytest.mark.parametrize("factor", [1.0, math.sqrt(3.0)])
def test_a_sensor_that_follows_a_swing_slowly_shows_too_little_of_it_and_never_too_much(driven, factor, hertz):
    """10 A beside a torque that follows within 16 ms, as behind a filter of 10 Hz."""
    rig, keep = driven(0.0, 0.0), math.exp(-PERIOD / 0.016)

    def swing():
        seen = 0.0
        for k in range(800):
            asked = 10.0 * math.sin(2.0 * math.pi * hertz * k * PERIOD)
            seen = keep * seen + (1.0 - keep) * factor * KT * asked
            rig.supervisor.command("test", asked)
            rig.converter.apply(seen / 5.0)
            rig.run(rig.period)

    if factor == 1.0 or hertz > 10.0:  # beyond the filter what is too much is not to be seen either
        swing()
    else:
        with pytest.raises(SafetyTrip, match=r"contradicts test torque, by which .* A flow, no less than"):
            swing()


def test_one_blow_to_the_shaft_is_none_of_the_current(driven):
    rig = driven(5.0, 5.0 * KT)
    for _ in range(5):
        rig.run(0.061)
        rig.converter.apply(2.9)
        rig.run(0.015)
        rig.converter.apply(KT)
    rig.run(0.1)


def test_no_convention_is_named_that_the_contradiction_does_not_allow():
    assert conventions(1.3, 1.4, 1.55).startswith("sqrt(2), as")
    assert ", or 3/2, as" in conventions(1.3, 1.4, 1.55)
    assert conventions(2.5, 3.0, 3.5) == ""


TORQUES = ChannelSpec("torque", "torque", "test", "sensor")
VOLTS = ChannelSpec("vq", "q_axis_voltage", "test", "drive")
SPEEDS = [ChannelSpec("velocity", "velocity", role, "drive") for role in ("test", "load")]
BOTH = {"test": "q_axis_current", "load": "q_axis_current"}
BY_TORQUE = yamlfile.parse(TORQUE).validate(Interlocks)
BY_VOLTAGE = yamlfile.parse("voltage_disagreement: {tolerance_V: 0.5}").validate(Interlocks)


def test_a_torque_sensor_is_a_second_sensor_of_both_actuators_on_one_shaft():
    assert lone_sensors(BY_TORQUE, [TORQUES, *SPEEDS], "coupled", BOTH) == []
    (line,) = lone_sensors(BY_TORQUE, [TORQUES, *SPEEDS], "locked", BOTH)
    assert line.startswith("the bound of the load winding rests on one sensor, q_axis_current: in set-up 'locked'")


def test_where_nothing_is_held_against_a_current_its_bound_rests_on_one_sensor():
    alone = {"test": "q_axis_current"}
    (line,) = lone_sensors(BY_TORQUE, [TORQUES, *SPEEDS], "free", alone)
    assert line.endswith("nothing else shows a current that is misread")
    assert lone_sensors(BY_VOLTAGE, [VOLTS, *SPEEDS], "free", alone) == []
    (line,) = lone_sensors(Interlocks(), [TORQUES, VOLTS, *SPEEDS], "coupled", alone)
    assert line.endswith("; interlocks.torque_disagreement would hold a second one against it")


@pytest.mark.parametrize(("interlocks", "second"), [(BY_TORQUE, TORQUES), (BY_VOLTAGE, VOLTS)])
def test_without_a_velocity_nothing_is_held_against_a_current(interlocks, second):
    (line,) = lone_sensors(interlocks, [second], "coupled", {"test": "q_axis_current"})
    assert line.endswith("nothing else shows a current that is misread")


def test_the_voltage_of_a_supply_is_a_second_sensor_of_its_current():
    volts = ChannelSpec("v", "line_voltage", "test", "supply")
    assert lone_sensors(Interlocks(), [volts], "heated", {"test": "line_current"}) == []
    assert len(lone_sensors(Interlocks(), [], "heated", {"test": "line_current"})) == 1
