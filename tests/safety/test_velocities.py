"""A velocity beside the change of its angle, by what the guard's rotors have looked at: allowances and lasting."""

import itertools

import pytest

from leactl.errors import SafetyTrip
from leactl.safety.cross_checks import Velocities
from leactl.safety.interlocks import VelocityDisagreement
from leactl.safety.thermal.turning import SensedMotion

STEP_S = 0.125
STEPS = 4  # of `for_s`
SETTINGS = VelocityDisagreement(tolerance_rad_s=0.2, share_percent=5.0, for_s=STEPS * STEP_S)
APART = SensedMotion(difference=0.71, speed=10.0, unsteadiness=0.0)


class LookedAtRotor:
    """A rotor of which the guard has seen such a motion, or none."""

    motion = None


class Judged:
    """Velocities of one rotor, step by step of a guard."""

    def __init__(self):
        self.rotor, self.times = LookedAtRotor(), itertools.count(10.0, STEP_S)
        self.velocities = Velocities(SETTINGS, {"test": self.rotor}, self.trip)
        self.step(APART)  # after which time is not known

    @staticmethod
    def trip(text):
        raise SafetyTrip(text)

    def step(self, motion, roles=("test",), looks=1):
        self.rotor.motion, now = motion, next(self.times)
        for _ in range(looks):
            self.velocities.look(now, roles)


# 0.2 rad/s, 5 % of 10 rad/s, and as much as the angle's own steps differ
@pytest.mark.parametrize(
    ("apart", "unsteady", "sound"), [(0.69, 0.0, True), (0.71, 0.0, False), (0.76, 0.07, True), (0.78, 0.07, False)]
)
def test_a_velocity_may_be_as_far_from_its_angle_as_tolerance_share_and_an_unsteady_angle_allow(apart, unsteady, sound):
    judged, motion = Judged(), SensedMotion(apart, 10.0, unsteady)
    for _ in range(STEPS - 1):
        judged.step(motion)
    if sound:
        judged.step(motion)
    else:
        with pytest.raises(SafetyTrip, match=r"test velocity is 0\.7\d rad/s from the change of the angle"):
            judged.step(motion)


def test_a_step_of_the_guard_counts_once_however_often_it_is_looked_at():
    judged = Judged()
    for _ in range(STEPS - 1):
        judged.step(APART, looks=20)
    with pytest.raises(SafetyTrip):
        judged.step(APART)


@pytest.mark.parametrize("between", [(None, ("test",)), (APART, ()), (APART._replace(difference=0.0), ("test",))])
def test_a_step_that_is_not_known_not_judged_or_sound_begins_the_time_anew(between):
    judged = Judged()
    for _ in range(STEPS - 1):
        judged.step(APART)
    judged.step(*between)
    for _ in range(STEPS - 1):
        judged.step(APART)
    with pytest.raises(SafetyTrip):
        judged.step(APART)
