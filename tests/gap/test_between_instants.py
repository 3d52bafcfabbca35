"""A current that a host samples in step with the steps of an angle's reference: what it leaves out is no friction."""

from dataclasses import replace

import numpy as np
import pytest

from leactl.gap.diagnose import Case, diagnose
from leactl.gap.search.effect_regression import Evidence
from tests.gap.synthetic import CONSTANT, DAMPING, FRICTION, INERTIA, INTERVAL_S, model, record

SPEEDS = (0.5, -0.5, 1.0, -1.0, 1.6, -1.6, 20.0, -20.0, 12.0, -12.0)
FOLLOWED = 2.0  # rad/s, up to which the reference goes in ramps; further it leaps ahead
OFF_A = 0.012  # of a sample, at the root of the mean square of the reference's rate


def ramps(means=False, off=OFF_A, seed=1):
    """A free shaft on slow ramps and after leaps of its reference, a second each, as a servo's log has it."""
    random = np.random.default_rng(seed)
    asked = np.repeat(SPEEDS, round(1.0 / INTERVAL_S))
    speed = np.convolve(np.pad(asked, 25, mode="edge"), np.full(51, 1 / 51), mode="valid")
    angle = np.cumsum(speed) * INTERVAL_S
    torque = INERTIA * np.gradient(speed, INTERVAL_S) + DAMPING * speed + FRICTION * np.sign(speed)
    rate = np.where(np.abs(asked) < FOLLOWED, asked, 0.0)
    leaps = np.where(np.diff(asked, prepend=0.0) != 0.0, np.where(rate == 0.0, asked, 0.0), 0.0)
    usual = np.sqrt(np.mean(rate[rate != 0.0] ** 2))
    current = torque / CONSTANT - off * rate / usual + 0.02 * random.standard_normal(len(torque))
    fast = {
        ("angle_reference", "test"): np.cumsum(rate * INTERVAL_S + leaps),
        ("angle", "test"): np.round(angle * 40000 / (2 * np.pi)) * (2 * np.pi) / 40000,
        ("q_axis_current", "test"): current,
        ("velocity", "test"): speed + 0.01 * random.standard_normal(len(speed)),
    }
    run = record("free", None, len(speed) * INTERVAL_S, fast=fast)
    for key in [key for key in run.fast.values if key not in fast]:
        del run.fast.values[key], run.fast.valid[key]
    if not means:
        run.fast.means.clear()
    return replace(run, slow=None)


def test_it_is_taken_for_what_it_is_and_leaves_drag_and_friction_alone():
    evidence = Evidence([ramps()], model())
    fit = evidence.settle([])
    results = {evidence.stack.names[place]: value for place, value in zip(fit.columns, fit.values, strict=True)}
    [off] = [value for name, value in results.items() if name[-1] == "between_instants_A"]
    assert abs(off) == pytest.approx(OFF_A, rel=0.3)
    assert abs(results["calibration", "viscous_damping"]) < 0.01
    assert abs(results["calibration", "coulomb_friction"]) < 0.005


def test_means_leave_nothing_between_them():
    names = Evidence([ramps(means=True)], model()).stack.names
    assert not [name for name in names if name[-1] == "between_instants_A"]


def test_nothing_is_named_for_it():
    fitted, held_out = ramps(seed=2), ramps(seed=3)
    diagnosis = diagnose(Case(model(), [fitted], [held_out]))
    assert diagnosis.verdict in ("none", "calibration")
    assert all(cause.probability < 0.5 for cause in diagnosis.causes)
