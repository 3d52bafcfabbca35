"""A plan under the bound before anything moves: what makes a forecast fail, or take too long."""

import numpy as np
import pytest

from leactl.safety.thermal.box import Box
from leactl.safety.thermal.foresight import Foresight
from leactl.safety.thermal.temperature_bound import ThermalBound
from tests.protocol.writing import plan
from tests.safety.guards import LEA, SETTINGS


def forecast(made):
    """Of two actuators from 28 degC."""
    start = {role: np.full(3, 28.0) for role in ("test", "load")}
    return Foresight({"test": LEA, "load": LEA}, SETTINGS, start).forecast(made)


@pytest.mark.parametrize("seconds", [0.3, 0.7, 1.1, 5.79, 24.99])
def test_an_angle_may_be_held_while_the_current_varies_for_any_time(seconds):
    sine = f"signal: {{role: test, kind: sine, amplitude_A: 5, frequency_Hz: 1, duration_s: {seconds}}}"
    result = forecast(plan(sine, mode="{test: current, load: angle}"))
    assert result.passing is None
    assert result.peaks["test"] < 40.0


def test_a_housing_at_rest_behind_a_winding_that_heats_costs_no_halved_steps(monkeypatch):
    tries = []
    one = ThermalBound._trial_step
    monkeypatch.setattr(ThermalBound, "_trial_step", lambda self, *told: tries.append(1) or one(self, *told))
    bound = ThermalBound([Box.of(LEA), Box.of(LEA)], 28.0)
    bound.step(1.0, np.array([900.0, 0.0]), np.ones(2), np.zeros(2), 25.0)
    assert len(tries) <= 4
