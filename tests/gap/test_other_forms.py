"""A joint follows laws of nobody's library: the nearest effect is named, and none for what its form misses."""

import numpy as np
import pytest

from leactl.gap.diagnose import diagnose
from tests.gap.joints import Effect, Log, case, drawn_joint

NEAR_REST = 0.002  # of the top speed, within which a drag has no sign yet


def hyperbolic(joint, top):
    """Friction that falls with one over the speed where the library has an exponential."""
    return lambda speed: 0.8 * joint.friction * np.tanh(speed / (NEAR_REST * top)) / (1.0 + abs(speed) / (0.08 * top))


def power_of_1_6(joint, top):
    """A drag between a damping and the square of the speed."""
    return lambda speed: 0.5 * joint.damping * top * np.sign(speed) * (abs(speed) / top) ** 1.6


def cubic(joint, top):
    """A drag that grows faster than the square."""
    return lambda speed: joint.damping * top * (speed / top) ** 3


@pytest.mark.parametrize(
    ("law", "nearest"),
    [
        (hyperbolic, "stribeck"),
        pytest.param(power_of_1_6, "quadratic_drag", marks=pytest.mark.long),
        pytest.param(cubic, "quadratic_drag", marks=pytest.mark.long),
    ],
)
def test_only_the_nearest_effect_is_named(law, nearest):
    random = np.random.default_rng([77, 0])
    joint = drawn_joint(random)
    top = 0.6 * joint.constant * joint.top / joint.damping
    diagnosis = diagnose(case(joint, Log(), random, Effect(drag=law(joint, top))))
    assert [cause.effect for cause in diagnosis.causes if cause.probability >= 0.5] == [nearest]


@pytest.mark.long
def test_two_effects_of_one_equation_are_both_named():
    random = np.random.default_rng([77, 1])
    joint = drawn_joint(random)
    top = 0.6 * joint.constant * joint.top / joint.damping
    diagnosis = diagnose(case(joint, Log(), random, Effect(loss=0.15, drag=hyperbolic(joint, top))))
    assert {cause.effect for cause in diagnosis.causes if cause.probability >= 0.5} == {"saturation", "stribeck"}


@pytest.mark.long
def test_overtones_of_a_wave_are_no_further_effect():
    random = np.random.default_rng([78, 0])
    joint = drawn_joint(random)
    waves = Effect(ripple=lambda angle: 0.08 * np.cos(6 * angle) + 0.03 * np.cos(12 * angle + 1.0))
    diagnosis = diagnose(case(joint, Log(), random, waves))
    assert [cause.effect for cause in diagnosis.causes if cause.probability >= 0.5] == ["torque_ripple"]
