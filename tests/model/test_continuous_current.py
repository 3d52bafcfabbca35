"""What a winding carries: NaN where its parameters give no number, for ever as for a while."""

import math
from dataclasses import replace

import numpy as np
import pytest

from leactl.model.continuous_current import STEADY_STATE, ThermalActuator, current_for_rise
from leactl.model.thermal_network import Conductances

ACTUATOR = ThermalActuator(Conductances(0.2, 1.0, 0.5, 100.0, 300.0), 0.1, 0.004, 25.0)


@pytest.mark.parametrize("duration", [60.0, STEADY_STATE])
@pytest.mark.parametrize("name", ["phase_resistance", "resistance_coefficient"])
def test_a_winding_without_a_number_carries_no_number(duration, name):
    assert math.isfinite(current_for_rise(ACTUATOR, 80.0, 25.0, duration))
    assert math.isnan(current_for_rise(replace(ACTUATOR, **{name: math.nan}), 80.0, 25.0, duration))


@pytest.mark.parametrize(("changes", "duration"), [({"phase_resistance": 0.0}, STEADY_STATE), ({}, 0.0)])
def test_a_winding_that_nothing_heats_has_no_current(changes, duration):
    assert math.isnan(current_for_rise(replace(ACTUATOR, **changes), 80.0, 25.0, duration))


def test_a_current_held_for_long_is_the_one_held_for_ever():
    assert current_for_rise(ACTUATOR, 80.0, 25.0, 1e5) == pytest.approx(
        current_for_rise(ACTUATOR, 80.0, 25.0, STEADY_STATE), rel=1e-6
    )
    assert current_for_rise(ACTUATOR, 80.0, 25.0, STEADY_STATE) < current_for_rise(ACTUATOR, 80.0, 25.0, 60.0) < np.inf
