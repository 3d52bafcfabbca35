"""Columns of locked runs against what a rotor that sticks does on paper."""

import numpy as np
import pytest

from leactl.effects.load_dependent_friction import stuck
from tests.gap.synthetic import CONSTANT, FRICTION, model

SHARE = 0.15


def test_a_rising_torque_loses_a_share_of_itself_and_a_falling_one_keeps_as_much():
    current = np.concatenate([np.linspace(0, 20, 500), np.linspace(20, 10, 500), np.linspace(10, -20, 500)])
    hidden = SHARE * stuck(current, model(), SHARE)
    top, half = CONSTANT * 20.0, CONSTANT * 10.0
    assert hidden[499] == pytest.approx((top - FRICTION) * (1 - 1 / (1 + SHARE)))
    assert hidden[999] == pytest.approx((half + FRICTION) * (1 - 1 / (1 - SHARE)))
    assert hidden[-1] == pytest.approx(-hidden[499])
