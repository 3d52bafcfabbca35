"""Waves over the angle as sampling and smoothing leave them of a torque, and what a fast rotor makes of them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl.effects.contract import Signals
from leactl.gap.diagnose import diagnose
from leactl.gap.signals.derived import fast_signals
from leactl.gap.signals.smoothing import smooth
from leactl.joints.machine import draw_machine
from leactl.joints.make import draw_runs
from leactl.model.nominal import Model
from tests.gap.drawn_machines import case_of, write_cases
from tests.gap.synthetic import clocked, record

COUNT, INTERVAL_S, FINE = 400, 2.5e-3, 64
ENDS = slice(40, -40)


def turning(speed):
    """A run that turns evenly, sampled without noise."""
    fast = clocked(COUNT, INTERVAL_S, {("angle", "test"): speed * INTERVAL_S * np.arange(COUNT)})
    return replace(record("free"), fast=fast, slow=None)


@settings(deadline=None)
@given(order=st.integers(1, 250), advance=st.floats(0.001, 3.0), backwards=st.booleans())
def test_a_wave_is_what_means_over_the_interval_leave_of_a_torque(order, advance, backwards):
    speed = (-1.0 if backwards else 1.0) * advance / (order * INTERVAL_S)
    signals = fast_signals(turning(speed), Model(name="m"), None)
    finely = speed * INTERVAL_S * ((np.arange(COUNT)[:, None] - 1.0) + (np.arange(FINE) + 0.5) / FINE)
    for wave, torque in zip(signals.waves(order), (np.cos, np.sin), strict=True):
        expected = smooth(torque(order * finely).mean(axis=1))
        assert wave[ENDS] == pytest.approx(expected[ENDS], abs=5e-3)


@pytest.mark.parametrize("turns_a_sample", [0.51, 0.99, 1.0, 1.01])
def test_a_wave_faster_than_the_samples_is_gone_and_not_a_slow_one(turns_a_sample):
    speed = 2.0 * math.pi * turns_a_sample / (30.0 * INTERVAL_S)
    signals = fast_signals(turning(speed), Model(name="m"), None)
    assert max(float(np.max(np.abs(wave[ENDS]))) for wave in signals.waves(30.0)) == 0.0


def test_a_run_without_an_angle_has_no_waves():
    with pytest.raises(ValueError, match="has none"):
        Signals("free", np.arange(9.0), Model(name="m"), 1.0).waves(1.0)


NEAR = 0.05  # of the truth
WAVES = ("cogging", "unbalance")


@pytest.fixture(scope="module")
def fast_rotors(tmp_path_factory):
    """Gives the case of a fast rotor with an effect, and a run that has what is true of it."""
    machine = draw_machine(np.random.default_rng(5), "drone_motor")
    machine = replace(
        machine, channels=("current", "angle", "current_reference"), sampling=True, rate=400.0, seconds=12.0
    )
    cases = {effect: (machine, draw_runs(np.random.default_rng(1), machine, [effect], "plain")) for effect in WAVES}
    folder = tmp_path_factory.mktemp("fast")
    write_cases(folder, cases)
    return lambda effect: (case_of(folder / effect), cases[effect][1][0])


@pytest.mark.parametrize(
    "effect", [pytest.param(effect, marks=[pytest.mark.long] if effect == "cogging" else []) for effect in WAVES]
)
def test_on_a_rotor_that_turns_fast_for_its_samples_a_wave_is_named_alone_and_with_its_size(fast_rotors, effect):
    case, run = fast_rotors(effect)
    diagnosis = diagnose(case)
    one_class = {effect, *diagnosis.causes[0].indistinguishable_from}
    assert {cause.effect for cause in diagnosis.causes if cause.probability >= 0.5} == one_class
    assert one_class <= {effect, "gravity_load"}
    own = next(cause for cause in diagnosis.causes if cause.effect == effect)
    fitted = {item.parameter: item.fitted for item in diagnosis.calibration}
    ratio = fitted["torque_constant"] / run.specimen.torque_constant
    told = {item.name: item.value for item in own.parameters}["amplitude"]
    assert told == pytest.approx(run.parameter(effect, "amplitude") * ratio, rel=NEAR)
