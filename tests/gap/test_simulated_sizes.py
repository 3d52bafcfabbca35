"""Effects of a simulator beside those of real runs: which are alike, and what becomes of the verdict."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.cli.gap import with_option_repeated
from leactl.gap.diagnosis import CalibratedParameter, Cause, DiagnosisResult, EffectParameter
from leactl.gap.equations.contract import Equation
from leactl.gap.signals.derived import fast_signals
from leactl.gap.simulated.comparing import (
    SideBySide,
    SizeInReal,
    other_machine_notes,
    side_by_side_in_free_runs,
    without_shared_causes,
)
from leactl.gap.simulated.simulator_effects import KnownEffect, Subtraction
from leactl.report.gap_words import change_text
from tests.gap.synthetic import model, record


def wave(cos, sin, std=0.001):
    return KnownEffect(("cogging", (7.0,)), ("cos", "sin"), np.array([cos, sin]), std**2 * np.eye(2))


def cause(effect, value, std=0.01, probability=0.99):
    return Cause(effect, probability, 1.0, (EffectParameter("size", value, std, "1"),))


def test_a_size_differs_beyond_both_errors_and_beyond_its_form():
    assert wave(0.02, 0.0).differs_from(wave(0.03, 0.0))
    assert not wave(0.02, 0.0).differs_from(wave(0.023, 0.0))  # 15 %, which no form is sure of
    assert not wave(0.02, 0.0, std=0.002).differs_from(wave(0.026, 0.0, std=0.002))  # 2.1 errors
    assert wave(0.02, 0.0).differs_from(wave(0.0, 0.02))  # a wave of the same amplitude, a quarter of a period on
    assert wave(0.02, 0.0).differs_from(wave(0.0, 0.0))
    assert not wave(0.0, 0.001).shows


@given(st.floats(0.001, 1.0), st.floats(0.001, 1.0))
def test_what_differs_does_so_in_any_unit(first, second):
    for unit in (1e-6, 1e6):
        scaled = wave(first * unit, 0.0, 0.001 * unit), wave(second * unit, 0.0, 0.001 * unit)
        assert scaled[0].differs_from(scaled[1]) == wave(first, 0.0).differs_from(wave(second, 0.0))


def test_a_known_effect_is_taken_from_what_an_equation_leaves_over():
    run = record("free", reference=2.0, fast={("angle", "test"): np.linspace(0.0, 30.0, 1000)})
    signals = fast_signals(run, model(), None)
    cosine, sine = signals.waves(7.0)
    left = 0.02 * cosine - 0.01 * sine
    mask = np.ones(len(left), bool)
    balance = Equation("free_torque", "torque", "test", "N*m", left, signals, mask, {"drag": np.asarray}, {})
    other = Equation("velocity", "velocity", "test", "rad/s", left, signals, mask, {}, {})
    # the columns are of drag, and the wave drives
    taken, kept = Subtraction((wave(-0.02, 0.01),))([balance, other])
    assert np.abs(taken.left_over).max() < 1e-12
    assert set(taken.shared) == {"cogging cos", "cogging sin"}
    assert taken.shared["cogging cos"][1] == pytest.approx(np.hypot(0.001, np.sqrt(0.03) * 0.02))
    assert np.array_equal(kept.left_over, left)
    assert not kept.shared


def test_effects_of_a_servo_are_compared_as_its_free_runs_have_them():
    nominal = SimpleNamespace(causes=(cause("stribeck", 0.9, 0.1), cause("saturation", 0.2), cause("backlash", 0.1)))
    alone = DiagnosisResult(
        "effect",
        0.0,
        causes=(cause("stribeck", 0.7, 0.05), cause("saturation", 0.4), cause("backlash", 0.1, 0.01, 0.3)),
    )
    both = side_by_side_in_free_runs(nominal, alone)
    assert both.differing == ["saturation", "backlash"]
    assert both.alike == {"stribeck"}
    assert [both.of_simulator[name].shows for name in both.differing] == [True, False]


@pytest.mark.parametrize(
    ("causes", "unexplained", "differs", "verdict"),
    [
        ((cause("cogging", 1.0),), 0.0, False, "none"),
        ((cause("cogging", 1.0),), 0.0, True, "calibration"),
        ((cause("cogging", 1.0),), 0.9, False, "unknown"),
        ((cause("cogging", 1.0), cause("stribeck", 1.0)), 0.9, False, "effect"),
    ],
)
def test_what_both_have_is_no_cause(causes, unexplained, differs, verdict):
    both = SideBySide({"cogging": SizeInReal((), False, True)}, ())
    answer = without_shared_causes(DiagnosisResult("effect", unexplained, causes=causes), both, differs)
    assert answer.verdict == verdict
    assert "cogging" not in [item.effect for item in answer.causes]


def test_what_the_simulator_has_and_the_machine_lacks_is_no_sound_machine():
    both = SideBySide({"cogging": SizeInReal((), True, False)}, ())
    assert without_shared_causes(DiagnosisResult("none", 0.0), both, False).verdict == "calibration"
    assert without_shared_causes(DiagnosisResult("calibration", 0.0), SideBySide({}, ()), False).verdict == "none"


def test_what_both_show_though_it_is_small_in_the_simulator_is_told():
    answer = without_shared_causes(
        DiagnosisResult("effect", 0.0, causes=(cause("cogging", 1.0),)), SideBySide({}, ("cogging",)), False
    )
    assert answer.notes == ("not named: cogging; the simulated runs show as much of it",)


def test_a_parameter_far_off_asks_whether_it_is_the_same_machine():
    far = CalibratedParameter("rotor_inertia", 0.01, 0.02, 1e-5, "kg*m^2")
    near = CalibratedParameter("rotor_inertia", 0.01, 0.013, 1e-5, "kg*m^2")
    assert other_machine_notes([far]) == ("is this the same machine? rotor_inertia is 2 times the simulator's",)
    assert other_machine_notes([near]) == ()


def test_an_ambient_that_is_warmer_than_the_simulator_s_is_no_sign_of_another_machine():
    offset = CalibratedParameter("ambient_offset", 0.02, -0.4, 0.1, "K")
    assert other_machine_notes([offset]) == ()
    assert change_text(offset) == ""


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("r.h5 --simulated a.h5 b.h5 --model m.yaml", "r.h5 --simulated a.h5 --simulated b.h5 --model m.yaml"),
        ("--simulated a.h5 --simulated b.h5 c.h5", "--simulated a.h5 --simulated b.h5 --simulated c.h5"),
        ("r.h5 s.h5 --model m.yaml --json", "r.h5 s.h5 --model m.yaml --json"),
        ("--simulated a.h5 --model m.yaml r.h5", "--simulated a.h5 --model m.yaml r.h5"),
    ],
)
def test_the_option_stands_for_all_runs_up_to_the_next(line, words):
    assert with_option_repeated(line.split()) == words.split()
