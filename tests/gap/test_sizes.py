"""Effects whose forms have a unit are named on a machine of any size: their forms are told in its own scales."""

import math

import numpy as np
import pytest

from leactl.effects import library
from leactl.effects.contract import SCALES
from leactl.gap.diagnose import diagnose
from leactl.gap.null import measure, set_floors
from leactl.gap.search.effect_regression import Evidence
from leactl.gap.signals.scales import form_scales
from leactl.model.nominal import Model
from tests.gap.joints import Effect, Log, case, drawn_joint


def lame(name, joint):
    """An effect at a size that its own machine gives it."""
    top = 0.4 * joint.constant * joint.top / joint.damping  # rad/s, about what the levels reach

    def rubs(speed):
        fading = math.exp(-abs(speed) / (0.03 * top))
        return 0.8 * joint.friction * fading * math.tanh(speed / (1e-3 * top))

    return {
        "command_slew_limit": Effect(slew=4.0 * joint.top * math.pi),
        "saturation": Effect(loss=0.1),
        "stribeck": Effect(drag=rubs),
    }[name]


@pytest.mark.parametrize("seed", [22, pytest.param(23, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    "name", ["stribeck", *(pytest.param(name, marks=pytest.mark.long) for name in ("command_slew_limit", "saturation"))]
)
def test_an_effect_is_named_on_a_joint_of_any_size(name, seed):
    random = np.random.default_rng(seed)
    joint = drawn_joint(random)
    diagnosis = diagnose(case(joint, Log(), random, lame(name, joint)))
    assert [cause.effect for cause in diagnosis.causes if cause.probability >= 0.5] == [name]


@pytest.mark.long
@pytest.mark.parametrize(("name", "least"), [("command_slew_limit", 38), ("saturation", 38), ("stribeck", 28)])
def test_of_many_joints_with_an_effect_most_are_told_so_and_none_another(name, least):
    told = []
    for seed in range(300, 340):
        random = np.random.default_rng(seed)
        joint = drawn_joint(random)
        diagnosis = diagnose(case(joint, Log(), random, lame(name, joint)))
        told.append([cause.effect for cause in diagnosis.causes if cause.probability >= 0.5])
    print(name, told.count([name]))
    assert told.count([name]) >= least  # friction that fades within a hundredth of the speed hides in a quarter of them
    assert [item for item in told if item not in ([], [name])] == []


def test_forms_are_told_in_scales_that_there_are():
    assert {scale for effect in library().values() for scale in effect.form_scales} <= set(SCALES)


def test_an_effect_has_no_form_where_the_runs_do_not_tell_its_scale():
    assert library()["stribeck"].forms_at({}) == []
    assert library()["stribeck"].forms_at({"highest speed": 10.0})[0] == pytest.approx((0.035, 1.0))
    assert len(library()["asymmetric_friction"].forms_at({})) == 1


def test_a_loop_without_a_bandwidth_counts_as_slow_as_a_sample():
    random = np.random.default_rng(3)
    joint = drawn_joint(random)
    records = case(joint, Log(), random).fitted
    here, unknown = form_scales(records, joint.model(random)), form_scales(records, Model(name="bare"))
    assert here["loop"] == pytest.approx(1.0 / (2.0 * math.pi * joint.loop))
    assert unknown["loop"] == pytest.approx(1.0 / joint.rate, rel=1e-6)
    assert unknown["highest rate"] == pytest.approx(unknown["highest current"] * joint.rate, rel=1e-6)
    assert "friction" not in unknown
    assert "housing" not in here


@pytest.mark.long
def test_a_form_that_runs_hardly_show_has_a_higher_floor_than_one_that_they_show_well():
    """Drags that fade within a hundredth of the speed, where next to no sample lies, and within a tenth."""
    random = np.random.default_rng(22)
    drawn = case(drawn_joint(random), Log(), random)
    evidence = Evidence(drawn.fitted, drawn.model)
    set_floors(evidence, measure(drawn.fitted, drawn.model))
    quick, slow = min(evidence.forms["stribeck"]), max(evidence.forms["stribeck"])
    assert evidence.floor(("stribeck", quick)) >= evidence.floor(("stribeck", slow))
    between = (1.01 * slow[0], slow[1])
    assert evidence.floor(("stribeck", between)) == evidence.floor(("stribeck", slow))
