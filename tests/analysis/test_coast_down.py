"""Inertia and drag from run-outs that an ODE solver made."""

import math

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from leactl.analysis.experiments.coast_down import analyze
from leactl.errors import MissingChannel, NotIdentifiable

from .run_outs import COAST_S, HELD_S, KT, RATE, SPEED, B, F, J, coasting
from .synthetic import Bench, analyzed, covered


@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(j=st.floats(0.003, 0.05), f=st.floats(0.05, 0.4), b=st.floats(0.001, 0.05), zero=st.floats(-0.02, 0.02))
def test_without_noise_inertia_and_drag_come_back_whatever_the_zero_of_the_current(tmp_path_factory, j, f, b, zero):
    assume(j / b * math.log((f + b * SPEED) / (f + 0.1 * b * SPEED)) * RATE > 30)  # readings; fewer are refused
    result = analyzed(analyze, coasting(Bench(tmp_path_factory.mktemp("run")), j=j, f=f, b=b, trials=2, zero_A=zero))
    assert result.find("rotor_inertia").value == pytest.approx(j, rel=2e-4)
    assert result.find("coulomb_over_inertia").value == pytest.approx(f / j, rel=5e-3)
    assert result.find("coulomb_friction").value == pytest.approx(f, rel=5e-3)
    assert result.find("viscous_damping").value == pytest.approx(b, rel=1e-2, abs=1e-4)


def test_the_lag_of_the_speed_filter_moves_nothing(bench):
    result = analyzed(analyze, coasting(bench, lag_s=1 / (2 * math.pi * 250)))
    assert result.find("rotor_inertia").value == pytest.approx(J, rel=1e-3)
    assert result.find("damping_over_inertia").value == pytest.approx(B / J, rel=3e-3)
    assert result.find("coulomb_over_inertia").value == pytest.approx(F / J, rel=3e-3)


@pytest.mark.long
def test_intervals_hold_the_truth_in_95_of_100_times(bench):
    true = {"rotor_inertia": J, "coulomb_friction": F, "viscous_damping": B, "coulomb_over_inertia": F / J}
    held = dict.fromkeys(true, 0)
    for _ in range(40):
        result = analyzed(analyze, coasting(bench, scatter=0.005, noise=0.01))
        for name, value in true.items():
            held[name] += covered(result.find(name), value)
    assert min(held.values()) >= 33, held  # three and a half standard deviations below 38 of 40


def test_without_a_torque_constant_only_what_is_over_the_inertia_is_known(bench):
    result = analyzed(analyze, coasting(bench, torque_constant=None))
    assert math.isnan(result.find("rotor_inertia").value)
    assert result.find("damping_over_inertia").value == pytest.approx(B / J, rel=1e-3)
    assert any("a run-out alone gives no inertia" in note for note in result.notes)
    given = analyzed(analyze, coasting(bench, torque_constant=None), torque_constant=KT, torque_constant_std=0.01 * KT)
    assert given.find("rotor_inertia").std == pytest.approx(0.01 * J, rel=0.01)


def test_a_run_out_that_a_drive_took_part_in_does_not_count(bench):
    with pytest.raises(NotIdentifiable, match=r"found 0 run-outs in 0 directions .*left out 6: the drive was on"):
        analyzed(analyze, coasting(bench, enabled=1.0))


def test_missed_samples_and_one_spoilt_run_out_are_named_and_do_no_harm(bench):
    def spoil(columns):
        columns["velocity"][530:534] = math.nan
        columns["velocity"][round((HELD_S + COAST_S) * RATE) + 510 :][: round(COAST_S * RATE)] = -40.0

    result = analyzed(analyze, coasting(bench, edit=spoil))
    assert result.find("rotor_inertia").value == pytest.approx(J, rel=2e-3)
    assert any(
        "left out 1: the rotor was faster than in the hold before it (at 2.4 s)" in note for note in result.notes
    )


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"trials": 1}, "found 2 run-outs in 2 directions; two or more in one direction are needed"),
        ({"j": 0.0002}, "fewer than 20 readings before the rotor stood: record faster"),
    ],
)
def test_a_run_that_cannot_answer_says_why_in_one_line(bench, how, words):
    with pytest.raises(NotIdentifiable, match=words) as caught:
        analyzed(analyze, coasting(bench, **how))
    assert len(caught.value.faults) == 1


def test_a_run_without_run_outs_or_without_speed_is_told_so(bench):
    with pytest.raises(NotIdentifiable, match="no step named 'coast'"):
        analyzed(analyze, bench.friction())

    def forget(columns):
        del columns["q_axis_current"]

    with pytest.raises(MissingChannel, match="no q_axis_current of test"):
        analyzed(analyze, coasting(bench, edit=forget))


def test_one_direction_says_what_is_in_its_inertia(bench):
    result = analyzed(analyze, coasting(bench, signs=(-1,), zero_A=0.05))
    assert any("a zero error of the current is part of the inertia" in note for note in result.notes)
    assert result.find("rotor_inertia").value < 0.99 * J


def test_a_coarse_current_that_stays_on_its_step_does_not_hang(bench):
    coarse = {"q_axis_current": 0.0137}  # A; at rest the current is near the middle of two steps, and flickers
    path = coasting(bench, noise=0.002, current_noise=0.0005, zero_A=0.0065, trials=5, resolution=coarse)
    result = analyzed(analyze, path)
    assert not any("came again" in note for note in result.notes)
    assert covered(result.find("rotor_inertia"), J)
