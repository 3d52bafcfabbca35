"""No-load loss from runs in which every part of the drag is known."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from leactl.analysis.experiments.no_load_loss import analyze
from leactl.errors import InputError, NotIdentifiable

from .free_rotors import B, C, F, turned
from .synthetic import HOLD_S, Bench, analyzed, covered


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(f=st.floats(0.0, 0.4), b=st.floats(0.001, 0.2), c=st.floats(0.0, 0.01), zero=st.floats(-0.05, 0.05))
def test_without_noise_every_part_and_the_loss_come_back(tmp_path_factory, f, b, c, zero):
    path = turned(Bench(tmp_path_factory.mktemp("run")), f=f, b=b, c=c, zero_A=zero)
    result = analyzed(analyze, path)
    assert result.find("coulomb_friction").value == pytest.approx(f, abs=1e-7)
    assert result.find("viscous_damping").value == pytest.approx(b, rel=1e-6)
    assert result.find("quadratic_drag").value == pytest.approx(c, abs=1e-8)
    assert result.find("no_load_loss").value == pytest.approx(35 * f + 35**2 * b + 35**3 * c, rel=1e-6)
    assert result.find("full_speed").value == 35


@pytest.mark.long
def test_intervals_hold_the_truth_in_95_of_100_times(bench):
    true = {
        "coulomb_friction": F,
        "viscous_damping": B,
        "quadratic_drag": C,
        "no_load_loss": 35 * F + 35**2 * B + 35**3 * C,
    }
    held = dict.fromkeys(true, 0)
    for _ in range(40):
        result = analyzed(analyze, turned(bench, scatter=0.003, rate_Hz=4))
        for name, value in true.items():
            held[name] += covered(result.find(name), value)
    assert min(held.values()) >= 33, held  # three and a half standard deviations below 38 of 40


def test_iron_is_told_apart_from_friction_only_where_friction_alone_is_known(bench):
    path = turned(bench, scatter=0.001)
    silent = analyzed(analyze, path)
    for name, shared in (("hysteresis_torque", "coulomb_friction"), ("eddy_damping", "viscous_damping")):
        result = silent.find(name)
        assert math.isnan(result.value)
        assert (result.low, result.high) == (0.0, silent.find(shared).high)
    assert any("not identifiable from the speed alone" in note for note in silent.notes)

    known = {"mechanical_friction": 0.15, "mechanical_friction_std": 0.01, "mechanical_damping": 0.02}
    told = analyzed(analyze, path, **known)
    hysteresis = told.find("hysteresis_torque")
    assert hysteresis.value == pytest.approx(told.find("coulomb_friction").value - 0.15)
    assert hysteresis.high - hysteresis.value > 1.96 * 0.01
    assert covered(hysteresis, F - 0.15)
    assert covered(told.find("eddy_damping"), B - 0.02)
    assert not any("not identifiable" in note for note in told.notes)


def test_friction_alone_that_is_more_than_all_of_the_drag_is_said(bench):
    result = analyzed(analyze, turned(bench), mechanical_friction=0.5)
    assert any("hysteresis_torque is below zero" in note for note in result.notes)


def test_the_torque_constant_s_uncertainty_is_in_the_loss(bench):
    path = turned(bench)
    loss = analyzed(analyze, path, torque_constant=0.49, torque_constant_std=0.0049).find("no_load_loss")
    assert loss.std == pytest.approx(0.01 * loss.value, rel=1e-3)


def test_one_direction_has_the_zero_of_current_in_its_friction_and_says_so(bench):
    result = analyzed(analyze, turned(bench, signs=(-1,), zero_A=0.1))
    assert result.find("coulomb_friction").value == pytest.approx(F - 0.049)
    assert any("a zero error of the current is part of coulomb_friction" in note for note in result.notes)


def test_a_speed_that_the_voltage_does_not_reach_does_not_count(bench):
    def fall_short(_time, columns):
        velocity = columns["velocity"]
        velocity[np.abs(velocity) == 35.0] *= 0.9

    result = analyzed(analyze, turned(bench, edit=fall_short))
    assert result.find("viscous_damping").value == pytest.approx(B)
    assert any("left out 4: the velocity was not reached (35 rad/s at" in note for note in result.notes)


def test_a_speed_that_swings_does_not_count(bench):
    def swing(time, columns):
        columns["velocity"][time % HOLD_S > 2.0] *= 1.04

    with pytest.raises(NotIdentifiable, match=r"found 0 speeds at which .* the velocity was not steady"):
        analyzed(analyze, turned(bench, edit=swing))


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"speeds": (5.0, 10.0, 20.0)}, "found 3 speeds at which the shaft turned steadily; 4 or more are needed"),
        ({"key": "current_A"}, "no step named 'hold' with velocity_rad_s"),
        ({"torque_constant": None}, "a torque constant is needed, give --torque-constant"),
    ],
)
def test_a_run_that_cannot_answer_says_why_in_one_line(bench, how, words):
    with pytest.raises(NotIdentifiable, match=words) as caught:
        analyzed(analyze, turned(bench, **how))
    assert len(caught.value.faults) == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"mechanical_friction": -0.1}, "mechanical_friction -0.1: zero or more was expected"),
        ({"mechanical_damping_std": 0.1}, "mechanical_damping_std is given without mechanical_damping"),
        ({"mechanical_damping": 0.1, "mechanical_damping_std": math.nan}, "mechanical_damping_std nan: zero or more"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(bench, options, words):
    with pytest.raises(InputError, match=words):
        analyzed(analyze, turned(bench), **options)
