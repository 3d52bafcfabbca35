"""Over which variable an effect is drawn."""

import math

import numpy as np
import pytest

from leactl.gap.diagnose import diagnose
from leactl.gap.verdict.picture import ActingResiduals, ResidualChannel, picture_of, shows_effect, view_of
from tests.gap.joints import Effect, Log, case, drawn_joint

CHANNEL = ResidualChannel("velocity", "test", "free", "free_torque", "N*m")


def part(effect, angle):
    groups = np.arange(len(angle)) // 100
    return ActingResiduals(CHANNEL, effect, 0.0 * effect, effect, groups, {"angle": angle}, len(angle) / 10.0, 1.0)


@pytest.mark.parametrize("order", [1.0, 14.0])
def test_a_wave_is_drawn_within_one_of_its_periods(order):
    angle = np.linspace(-20.0, 20.0, 20000)
    drawn = picture_of(view_of(part(np.sin(order * angle), angle), ["angle"], order))
    assert drawn.periods == order
    assert 0.0 <= drawn.bins[0].low < drawn.bins[-1].high <= 2.0 * np.pi / order


def test_what_turns_less_than_once_is_not_folded():
    angle = np.sin(np.linspace(0.0, 60.0, 20000))
    drawn = picture_of(view_of(part(-0.1 * angle, angle), ["angle"], 1.0))
    assert drawn.periods is None
    assert max(item.high - item.low for item in drawn.bins) < 0.5


def test_what_goes_on_over_several_turns_is_drawn_over_the_whole_angle():
    angle = np.linspace(-20.0, 20.0, 20000)
    drawn = picture_of(view_of(part(-0.1 * angle, angle), ["angle"], 1.0))
    assert drawn.periods is None
    assert drawn.bins[0].low == pytest.approx(-20.0, abs=0.1)
    assert [item.before for item in drawn.bins] == pytest.approx(
        [-0.05 * (item.low + item.high) for item in drawn.bins], abs=0.05
    )


def test_an_effect_that_a_calibration_stands_in_for_is_drawn_by_itself():
    """A bandwidth of the loop takes most of a delay: what is left without the delay follows no rate of the current."""
    random = np.random.default_rng(6)
    [cause] = diagnose(case(drawn_joint(random), Log(), random, Effect(delay=2))).causes
    drawn = cause.picture
    assert cause.effect == "transport_delay"
    assert drawn.variable == "current_rate"
    assert not drawn.refitted
    assert shows_effect(drawn)
    falling, rising = (
        [item.before for item in drawn.bins if sign * (item.low + item.high) > 0.0 and math.isfinite(item.before)]
        for sign in (-1, 1)
    )
    assert np.mean(falling) > 50.0 * drawn.after_rms, "the current of a falling reference is too high"
    assert np.mean(rising) < -50.0 * drawn.after_rms
