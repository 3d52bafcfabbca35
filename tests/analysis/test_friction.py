"""Damping and Coulomb friction from runs in which they are known."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from leactl.analysis.experiments.friction import analyze
from leactl.errors import InputError, MissingChannel, NotIdentifiable

from .synthetic import HOLD_S, Bench, analyzed, covered

SLOW = settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])


@SLOW
@given(b=st.floats(0.002, 0.2), f=st.floats(0.0, 0.28), zero=st.floats(-0.02, 0.02))
def test_without_noise_the_parameters_come_back(tmp_path_factory, b, f, zero):
    path = Bench(tmp_path_factory.mktemp("run")).friction(b=b, f=f, zero_A=zero)
    result = analyzed(analyze, path)
    for suffix, extra in {"": 0.0, "_forward": 0.49 * zero, "_backward": -0.49 * zero}.items():
        assert result.find(f"viscous_damping{suffix}").value == pytest.approx(b, rel=1e-8)
        assert result.find(f"coulomb_friction{suffix}").value == pytest.approx(f + extra, abs=1e-8)
    assert result.find("offset").value == pytest.approx(0.49 * zero, abs=1e-8)


@pytest.mark.long
@pytest.mark.parametrize("scatter", [0.002, 0.0066])  # the second makes the paper's r squared of 0.93
def test_intervals_hold_the_truth_in_95_of_100_runs(bench, scatter):
    held = dict.fromkeys(("viscous_damping", "coulomb_friction", "viscous_damping_forward"), 0)
    ratios, r_squared = [], []
    for _ in range(100):
        result = analyzed(analyze, bench.friction(scatter=scatter, trials=5, rate_Hz=8))
        for name in held:
            held[name] += covered(result.find(name), 0.208 if name.startswith("coulomb") else 0.0238)
        ratios.append(result.find("viscous_damping").value / 0.0238)
        r_squared.append(result.find("r_squared_forward").value)
    assert min(held.values()) >= 88  # three standard deviations below 95 of 100
    assert np.median(ratios) == pytest.approx(1.0, abs=0.015)
    assert np.median(r_squared) == pytest.approx(0.93 if scatter > 0.005 else 0.99, abs=0.02)


def test_repeats_are_combined(bench):
    paths = [bench.friction(scatter=0.003, zero_A=zero) for zero in (0.0, 0.01, -0.01)]
    one, three = analyzed(analyze, paths[0]), analyzed(analyze, *paths)
    assert covered(three.find("viscous_damping"), 0.0238)
    assert covered(three.find("coulomb_friction"), 0.208)
    assert three.find("viscous_damping").std < 0.85 * one.find("viscous_damping").std


@pytest.mark.parametrize(("sign", "name", "size"), [(1, "forward", 0.2129), (-1, "backward", 0.2031)])
def test_one_direction_alone_has_the_zero_of_current_in_its_friction_and_says_so(bench, sign, name, size):
    result = analyzed(analyze, bench.friction(signs=(sign,), zero_A=0.01))
    assert result.find("viscous_damping").value == pytest.approx(0.0238)
    assert result.find("coulomb_friction").value == pytest.approx(size)
    assert "offset" not in [item.name for item in result.results]
    assert any(f"the rotor turned {name} only" in note for note in result.notes)


def test_levels_too_low_to_turn_the_rotor_do_not_count(bench):
    result = analyzed(analyze, bench.friction(levels=(0.2, 0.4, 0.6, 0.67, 0.74)))
    assert result.find("coulomb_friction").value == pytest.approx(0.208)
    assert any("left out 12: the rotor did not turn" in note for note in result.notes)


def test_a_rotor_that_stops_late_in_a_hold_is_not_steady(bench):
    def stop(time, columns):
        columns["velocity"][(time > HOLD_S - 0.3) & (time < HOLD_S)] = 0.0

    result = analyzed(analyze, bench.friction(edit=stop))
    assert result.find("viscous_damping").value == pytest.approx(0.0238)
    assert any("left out 1: the velocity was not steady (0.6 A at 0.5 s)" in note for note in result.notes)


def test_a_rotor_that_something_else_turned_does_not_count(bench):
    def turn_back(time, columns):
        columns["velocity"][time < HOLD_S] = -5.0

    result = analyzed(analyze, bench.friction(edit=turn_back))
    assert result.find("coulomb_friction").value == pytest.approx(0.208)
    assert any("the rotor turned against its current" in note for note in result.notes)


def test_a_linear_axis_answers_in_its_own_units(bench):
    result = analyzed(analyze, bench.friction(units={"velocity": "m/s"}))
    assert result.find("viscous_damping").units == "N*s/m"
    assert result.find("coulomb_friction").units == "N"


def test_a_torque_constant_given_scales_both(bench):
    path = bench.friction()
    result = analyzed(analyze, path, torque_constant=0.98)
    assert result.find("viscous_damping").value == pytest.approx(2 * 0.0238)
    assert result.find("coulomb_friction").value == pytest.approx(2 * 0.208)
    assert any("torque constant 0.98 N*m/A, as given" in note for note in result.notes)


def test_the_uncertainty_of_the_torque_constant_adds_in_squares(bench):
    path = bench.friction(scatter=0.002)
    alone = analyzed(analyze, path).find("coulomb_friction")
    doubted = analyzed(analyze, path, torque_constant_std=0.049).find("coulomb_friction")
    assert doubted.std == pytest.approx(np.hypot(alone.std, 0.1 * alone.value))
    # scatter has hardly a share in it, so the quantile is that of the normal distribution
    assert (doubted.high - doubted.value) / doubted.std == pytest.approx(1.96, abs=0.01)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"f": 5.0}, r"found 0 levels of current at which the rotor turned steadily \(30 holds: the rotor did not"),
        ({"levels": (0.6,)}, "found 1 levels of current|found one level"),
        ({"levels": (0.0, 0.6), "signs": (1,)}, "found 1 levels of current at which the rotor turned steadily"),
        ({"torque_constant": None}, "found no model; a torque constant is needed, give --torque-constant"),
        ({"torque_constant": 1e308}, r"found a model whose torque_constant is 1e\+308; a torque constant is needed"),
        ({"torque_constant": "strong"}, "a model whose torque_constant is 'strong'"),
        ({"torque_constant": -0.49}, "a model whose torque_constant is -0.49"),
        ({"levels": (0.6, 0.74), "trials": 1, "signs": (1,)}, "2 points for 2 unknowns leave no degree of freedom"),
        ({"role": "load"}, "no step named 'hold' with current_A"),
    ],
)
def test_a_run_that_cannot_answer_says_why_in_one_line(bench, how, words):
    path = bench.friction(**how)
    with pytest.raises(NotIdentifiable, match=words) as caught:
        analyzed(analyze, path)
    assert caught.value.exit_status == 2
    assert str(caught.value).startswith(str(path))
    assert len(caught.value.faults) == 1


def test_a_run_without_velocity_names_what_it_has(bench):
    path = bench.torque()
    with pytest.raises(MissingChannel, match="no velocity of test; the run has q_axis_current of test, torque of test"):
        analyzed(analyze, path)


@pytest.mark.parametrize(
    "options",
    [{"torque_constant": 0.0}, {"torque_constant": float("nan")}, {"torque_constant_std": -0.1}],
    ids=str,
)
def test_a_torque_constant_that_is_no_positive_number_is_refused(bench, options):
    path = bench.friction()
    with pytest.raises(InputError, match=r"was expected"):
        analyzed(analyze, path, **options)
