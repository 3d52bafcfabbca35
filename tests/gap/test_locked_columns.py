"""Columns of locked and coupled runs against what rotors that stick and rub do on paper."""

import numpy as np
import pytest

from leactl.effects.load_dependent_friction import hidden_locked_torque
from leactl.gap.equations import equations
from leactl.gap.signals.derived import fast_signals
from tests.gap.synthetic import CONSTANT, DAMPING, FRICTION, model, record

SHARE = 0.15


def test_a_rising_torque_loses_a_share_of_itself_and_a_falling_one_keeps_as_much():
    current = np.concatenate([np.linspace(0, 20, 500), np.linspace(20, 10, 500), np.linspace(10, -20, 500)])
    hidden = SHARE * hidden_locked_torque(current, model(), SHARE)
    top, half = CONSTANT * 20.0, CONSTANT * 10.0
    assert hidden[499] == pytest.approx((top - FRICTION) * (1 - 1 / (1 + SHARE)))
    assert hidden[999] == pytest.approx((half + FRICTION) * (1 - 1 / (1 - SHARE)))
    assert hidden[-1] == pytest.approx(-hidden[499])


def locked(current, **changes):
    """Signals of a locked run whose drive follows at once."""
    channel = {("q_axis_current", "test"): current}
    return fast_signals(record("locked", current, len(current) * 1e-3, fast=channel), model(**changes), None)


def test_after_a_leap_it_is_open_where_a_rotor_sticks_until_its_torque_has_gone_on_by_twice_the_friction():
    reach = 2.0 * FRICTION / CONSTANT
    onwards = np.linspace(0.0, 2.0 * reach, 400)
    current = np.concatenate([np.zeros(300), np.full(400, 8.0), 8.0 + onwards, np.full(200, 8.0 + onwards[-1])])
    signals = locked(current)
    assert signals.settled[:290].all()
    assert not signals.settled[310:890].any()
    assert signals.settled[910:].all()


def test_a_slow_ramp_leaves_no_doubt_where_a_rotor_sticks():
    assert locked(np.linspace(0.0, 20.0, 2000)).settled.all()


@pytest.mark.parametrize("friction", [0.0, 1e-4])
def test_a_rotor_without_friction_to_speak_of_may_leap(friction):
    current = np.concatenate([np.zeros(300), np.full(300, 8.0)])
    assert locked(current, coulomb_friction=friction).settled.all()


def test_a_small_leap_leaves_open_where_a_rotor_sticks_but_not_how_it_slides():
    leap = 2.0 * FRICTION / CONSTANT
    signals = locked(np.concatenate([np.zeros(300), np.full(300, leap)]))
    assert not signals.settled[310:].any()
    assert signals.unleapt.all()


def test_what_a_current_does_between_two_instants_comes_from_its_reference():
    rate, fine = 2.0 * np.pi * 450.0, 200
    reference = np.repeat([0.0, 6.0, -3.0, 1.0], 40)
    at, trace = 0.0, []
    for wanted in np.repeat(reference, fine):
        at += (wanted - at) * -np.expm1(-rate * 1e-3 / fine)
        trace.append(at)
    ends = np.asarray(trace)[fine - 1 :: fine]
    means = np.asarray(trace).reshape(-1, fine).mean(axis=1)
    run = record("free", reference, len(reference) * 1e-3, fast={("q_axis_current", "test"): ends})
    run.fast.means.clear()
    signals = fast_signals(run, model(), None)
    run.fast.means.add(("q_axis_current", "test"))
    run.fast.values["q_axis_current", "test"] = means
    of_means = fast_signals(run, model(), None)
    np.testing.assert_allclose(signals.following, ends, atol=1e-6)
    np.testing.assert_allclose(signals.current[10:-10], of_means.current[10:-10], atol=0.02)


def test_two_coupled_rotors_rub_as_the_model_says_of_each():
    turning = 3.0 * np.sin(0.02 * np.arange(1000))
    channels = {("velocity", "load"): turning, ("angle", "test"): np.cumsum(turning) * 1e-3}
    run = record("coupled", reference=1.0, fast=channels)

    def load_columns(**load):
        [both] = [equation for equation in equations(run, model(load=load)) if equation.name == "both_torque"]
        return [both.calibration[f"load.{name}"] for name in ("viscous_damping", "coulomb_friction")]

    alike, other = load_columns(), load_columns(viscous_damping=2.0 * DAMPING, coulomb_friction=0.0)
    np.testing.assert_allclose(other[0], 2.0 * alike[0])
    assert np.any(alike[1]) and not np.any(other[1])
