"""Faults of a set-up are named before any effect, with what undoes them; sound channels are left alone."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leactl.gap.diagnose import diagnose, mend_faults
from leactl.gap.setup import (
    clock_faults,
    conventions,
    factor_hypotheses,
    faulty_samples,
    find_and_mend_faults,
    relations,
    swapped_channels,
)
from leactl.gap.setup.conventions import convention
from leactl.gap.setup.expected_channels import direct_pairs, modelled_pairs
from leactl.gap.setup.faulty_samples import period_of, samples_at_ends
from leactl.gap.setup.signs_and_scales import fault_of
from leactl.gap.signals.record import Clocked, build_record
from leactl.joints.make import draw_machines, draw_runs
from leactl.model.nominal import Model
from leactl.quantities import UNITS
from leactl.vocabulary.variable import VARIABLES
from tests.gap.drawn_machines import case_of, write_cases
from tests.gap.joints import Effect, Log, case, channels, drawn_joint

ANGLE, VELOCITY = ("angle", "test"), ("velocity", "test")
STRONG_SPRING = 14002, 117  # seeds of a set of machines and of a case, whose spring looks like a factor of 2 pi
DOCS = Path(__file__).resolve().parents[2] / "docs"
SPOILT = {  # channels, what is done to them, the fault, and what its evidence tells
    "turned velocity": (["velocity"], lambda v, _: -v, ("channel_sign", "velocity")),
    "turned torque direction": (
        ["q_axis_current", "q_axis_current_reference"],
        lambda v, _: -v,
        ("channel_sign", "angle"),
    ),
    "turned encoder": (["angle"], lambda v, _: -v, ("channel_sign", "angle")),
    "turned current": (["q_axis_current"], lambda v, _: -v, ("channel_sign", "q_axis_current")),
    "rpm": (["velocity"], lambda v, _: v * 30.0 / np.pi, ("channel_scale", "velocity")),
    "milliamperes": (["q_axis_current"], lambda v, _: v * 1000.0, ("channel_scale", "q_axis_current")),
    "amplitude for power": (["q_axis_current"], lambda v, _: v * 2.0 / 3.0, ("channel_scale", "q_axis_current")),
    "dead velocity": (["velocity"], lambda v, _: 0.0 * v, ("frozen_channel", "velocity")),
    "dead encoder": (["angle"], lambda v, _: 0.0 * v, ("frozen_channel", "angle")),
    "current frozen halfway": (["q_axis_current"], lambda v, _: half(v), ("frozen_channel", "q_axis_current")),
    "wrapped": (["angle"], lambda v, _: (v + np.pi) % (2 * np.pi) - np.pi, ("wrapped_channel", "angle")),
    "clipped": (
        ["q_axis_current"],
        lambda v, top: np.clip(v, -0.7 * top, 0.7 * top),
        ("clipped_channel", "q_axis_current"),
    ),
    "half rate": (["velocity"], lambda v, _: np.repeat(v[::2], 2)[: len(v)], ("repeated_samples", "velocity")),
}


def half(values):
    middle = len(values) // 2
    return np.concatenate([values[:middle], np.full(len(values) - middle, values[middle])])


def spoilt(given, joint, quantities, spoil):
    """A case whose channels were spoilt in the record."""

    def one(record):
        values = dict(record.fast.values)
        for quantity in quantities:
            values[quantity, "test"] = spoil(values[quantity, "test"], joint.top)
        return replace(record, fast=replace(record.fast, values=values))

    return replace(given, fitted=[one(r) for r in given.fitted], held_out=[one(r) for r in given.held_out])


def joint_case(seed):
    random = np.random.default_rng(seed)
    joint = drawn_joint(random)
    return joint, case(joint, Log(), random)


@pytest.fixture(scope="module")
def cases():
    return [joint_case(seed) for seed in (11, 12, 13)]


@pytest.mark.parametrize("name", SPOILT)
def test_a_fault_is_named_by_itself_and_mended(cases, name):
    quantities, spoil, expected = SPOILT[name]
    for joint, given in cases:
        faults, records = find_and_mend_faults(
            [*(bad := spoilt(given, joint, quantities, spoil)).fitted, *bad.held_out], given.model
        )
        assert [(fault.name, fault.key[0]) for fault in faults] == [expected]
        assert faults[0].probability > 0.9
        assert not faults[0].shrinks or faults[0].share > 0.9  # else samples are left out, and no gap has to go
        assert find_and_mend_faults(records, given.model)[0] == []


def test_a_sound_joint_has_no_fault(cases):
    for _, given in cases:
        assert find_and_mend_faults([*given.fitted, *given.held_out], given.model)[0] == []


def test_a_fault_is_the_first_cause_with_its_change_and_what_is_left_is_sound(cases):
    joint, given = cases[0]
    diagnosis = diagnose(spoilt(given, joint, ["velocity"], lambda v, _: v * 30.0 / np.pi))
    assert diagnosis.verdict == "effect"
    assert [(c.effect, c.family) for c in diagnosis.causes if c.probability >= 0.5] == [("channel_scale", "setup")]
    assert "0.1047" in diagnosis.causes[0].change
    assert "60/(2 pi)" in diagnosis.notes[0]
    assert diagnosis.causes[0].parameters[0].value == pytest.approx(30.0 / np.pi, rel=0.01)


def test_a_fault_that_leaves_nothing_to_check_is_the_answer_itself(cases):
    joint, given = cases[0]
    dead = spoilt(given, joint, ["angle"], lambda v, _: 0.0 * v)
    for record in [*dead.fitted, *dead.held_out]:
        for quantity in ("q_axis_current", "q_axis_current_reference"):
            del record.fast.values[quantity, "test"]
    diagnosis = diagnose(dead)
    assert {c.effect for c in diagnosis.causes} == {"frozen_channel"}
    assert any("a diagnosis needs the angle" in note for note in diagnosis.notes)


@pytest.mark.parametrize(
    ("factor", "name"), [(2 / 3, "2/3"), (-1.0e3, "-1000"), (1.73, "sqrt(3)"), (1.1, ""), (7.0, "")]
)
def test_a_factor_is_told_as_the_convention_it_equals(factor, name):
    assert convention(factor) == name


def test_a_rest_before_a_motion_to_one_side_is_no_end_of_a_range():
    time = np.linspace(0.0, 5.0, 1000)
    speed = -np.clip(time - 0.5, 0.0, None) * (1.0 + 0.01 * np.random.default_rng(1).standard_normal(1000))
    assert not samples_at_ends(clocked(time, speed), VELOCITY).any()
    clipped = np.maximum(speed, -3.0)
    assert samples_at_ends(clocked(time, clipped), VELOCITY).sum() > 200


def clocked(time, speed):
    return Clocked(time, float(time[1]), {VELOCITY: speed}, {VELOCITY: np.ones(len(time), bool)})


def test_a_period_is_told_from_leaps_and_never_from_a_motion():
    time = np.linspace(0.0, 20.0, 4000)
    assert period_of(np.mod(3.0 * time, 2 * np.pi)) == 2 * np.pi
    assert period_of(np.mod(100.0 * np.sin(time), 360.0)) == pytest.approx(360.0, rel=0.01)
    assert period_of(np.sign(np.sin(time))) == 0.0 or period_of(100.0 * np.sin(time)) == 0.0


def test_an_angle_that_flickers_at_rest_is_not_wrapped():
    assert period_of(1e-4 * (np.arange(4000) % 7 == 0)) == 0.0


def test_a_reference_that_holds_a_level_is_not_frozen(cases):
    joint, given = cases[0]
    random = np.random.default_rng(1)

    def held(values, top):
        flowing = np.where(np.arange(len(values)) < len(values) // 2, values, 0.8 * top)
        return flowing if len(np.unique(values)) < 20 else flowing + 2e-3 * top * random.standard_normal(len(values))

    levels = replace(given, fitted=[given.fitted[1]], held_out=[given.held_out[1]])
    both = spoilt(levels, joint, ["q_axis_current", "q_axis_current_reference"], held)
    assert faulty_samples.find_frozen_channel([*both.fitted, *both.held_out], given.model) is None


@pytest.mark.parametrize(
    ("factor", "multiplier"), [(2.0009, "0.5"), (0.4996, "2"), (57.31, "0.0174533"), (2.06, "0.485437")]
)
def test_what_is_a_whole_number_or_a_unit_is_mended_by_that(factor, multiplier):
    signature = factor_hypotheses.Signature((ANGLE,), {})
    hypothesis = factor_hypotheses.FaultHypothesis(signature, math.log(factor), 0.004, 1.0, 0.0, 100.0)
    fault = fault_of([hypothesis], {"a"}, 1, Model(name="joint", winding="wye"))
    assert fault.change.startswith(
        f"multiply the `scale` of angle in the mapping, or in the bench file, by {multiplier}"
    )


def test_the_page_has_the_numbers_of_the_code():
    page = re.sub(r"\s+", " ", (DOCS / "explanation" / "gap.md").read_text(encoding="utf-8"))
    assert f"stands still over {100 * faulty_samples.LEAST_FROZEN_SHARE:.0f} % of a run" in page
    assert f"| {100 * faulty_samples.MOST_REPEATED_SHARE:.0f} % of a measured channel" in page
    assert f"| {100 * faulty_samples.LEAST_CLIPPED_SHARE:.0f} % of a measured channel stands at its end" in page
    assert f"explains {factor_hypotheses.LEAST_EXPLAINED_SQUARES:.0f} squares of standard deviations" in page
    assert f"and {100 * factor_hypotheses.LEAST_EXPLAINED_SHARE:.0f} % of what a channel is off by" in page
    assert f"leaves no factor beyond {factor_hypotheses.MOST_RESIDUAL_STDS:.0f} of them" in page
    assert f"within {factor_hypotheses.MOST_RIVAL_COST:.0f} of the best" in page
    assert f"whole number up to {conventions.MOST_POLE_PAIRS}" in page
    usual = relations.FACTOR_STDS
    told = (relations.TIGHT_STD, relations.CONSTANT_STD, usual["inertia"], usual["friction"], usual["damping"])
    words = (
        "Usual are {:.0%} between two channels that say the same, {:.0%} of the torque constant, {:.0%} of inertia and"
    )
    words += " resistance, {:.0%} of friction, {:.0%} of damping"
    assert words.format(*told).replace("%", " %") in page
    assert usual["inertia"] == usual["resistance"]
    assert f"later, or earlier, by {2 * clock_faults.STAMP_ERROR:.0f} samples or more" in page
    assert (swapped_channels.LEAST_SWAPPED_SHARE, swapped_channels.MOST_CLEAN_RATIO, clock_faults.MOST_LEAPS) == (
        0.5,
        0.1,
        4,
    )


@pytest.mark.long
def test_a_fault_is_not_named_where_an_effect_explains_the_runs_as_they_were_logged(tmp_path):
    seed, index = STRONG_SPRING
    machines = draw_machines(np.random.default_rng([seed, 0]), 10)
    machine = machines[index % len(machines)]
    runs = draw_runs(np.random.default_rng([seed, 1, index]), machine, ["position_spring"], "strong")
    write_cases(tmp_path, {"spring": (machine, runs)})
    sprung = case_of(tmp_path / "spring")
    faults, _ = mend_faults(sprung)
    assert [fault.as_cause().effect for fault in faults] == ["channel_scale"]
    diagnosis = diagnose(sprung)
    assert [cause.effect for cause in diagnosis.causes if cause.probability >= 0.5] == ["position_spring"]


@pytest.mark.parametrize("seed", [1, 2])
def test_a_dead_band_of_the_drive_is_no_scale_of_its_current(seed):
    """It has a mean factor, of 0.92, in which a channel in another unit would be exact once it is mended."""
    random = np.random.default_rng(seed)
    joint = drawn_joint(random)
    diagnosis = diagnose(case(joint, Log(), random, Effect(dead=0.06 * joint.top)))
    assert (diagnosis.verdict, [cause.effect for cause in diagnosis.causes if cause.probability > 0.5]) == (
        "unknown",
        [],
    )
    assert diagnosis.unexplained.quantity == "q_axis_current"
    assert any(note.startswith("not named: channel_scale; what is left") for note in diagnosis.notes)


@pytest.mark.parametrize("mechanical", ["free", "locked"])
def test_an_error_is_drawn_over_values_of_the_variable_that_the_picture_names(mechanical):
    random = np.random.default_rng(4)
    joint = drawn_joint(random)
    model = joint.model(random).model_copy(update={"phase_resistance": 0.4})
    made = channels(joint, Log(), "multisine", random)
    current = next(channel for channel in made if channel.quantity == "q_axis_current")
    voltage = replace(current, quantity="q_axis_voltage", units="V")
    record = build_record(Path("a.h5"), "multisine", mechanical, [*made, voltage], {})
    pairs = [*direct_pairs(record, model), *modelled_pairs(record, model)]
    assert {pair.key[0] for pair in pairs} >= {"q_axis_voltage", "q_axis_current"}
    for pair in pairs:
        assert pair.drawn_over is not None or UNITS[pair.key[0]] == VARIABLES[pair.variable].units
