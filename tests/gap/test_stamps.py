"""A log that does not say what its stamps mean is no effect; one that does is taken at its word."""

import numpy as np
import pytest

from leactl.gap.diagnose import diagnose
from leactl.gap.search.effect_regression import Evidence
from leactl.gap.search.effect_sets import ENTRY_HEIGHT, fit_further_effect
from leactl.gap.signals.setpoints import mark_setpoints
from leactl.gap.signals.stamps import TAPS, lateness_of, neighbour, restamped
from tests.gap.joints import Effect, Log, case, drawn_joint, drawn_log

TOO_FAST = ("command_slew_limit", (1e6,))  # A/s, that no joint's command reaches


def named(found):
    return [cause.effect for cause in found.causes if cause.probability >= 0.5]


def sound(seed, told):
    random = np.random.default_rng(seed)
    joint = drawn_joint(random)
    return diagnose(case(joint, Log() if told else drawn_log(random), random))


@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize(
    "seed",
    [
        0,
        *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 122)),
    ],  # in 122 a channel that hardly moves tells no shift
)
def test_a_sound_joint_is_called_so_whatever_its_log_leaves_unsaid(seed, told):
    result = sound(seed, told)
    assert result.verdict in ("none", "calibration")
    assert named(result) == []
    assert any("do not say what their stamps mean" in note for note in result.notes) != told


@pytest.mark.long
@pytest.mark.parametrize("told", [True, False])
def test_of_many_sound_joints_next_to_all_are_called_so(told):
    results = [sound(seed, told) for seed in range(100, 140)]
    wrong = [result for result in results if result.verdict not in ("none", "calibration") or named(result)]
    print(f"sampling {'told' if told else 'not told'}: {len(results) - len(wrong)} of {len(results)} called sound")
    assert len(wrong) <= (0.02 if told else 0.05) * len(results), [(item.verdict, named(item)) for item in wrong]


@pytest.mark.parametrize(
    ("delay", "seed"), [pytest.param(*drawn, marks=pytest.mark.long) for drawn in ((8, 5), (5, 11), (6, 12))]
)
def test_a_delay_is_named_that_no_stamps_explain(delay, seed):
    random = np.random.default_rng(seed)
    joint, log = drawn_joint(random), drawn_log(random)
    diagnosis = diagnose(case(joint, log, random, Effect(delay=delay)))
    assert named(diagnosis) == ["transport_delay"]
    [told] = diagnosis.causes[0].parameters
    assert 0.5 < told.std * joint.rate < 1.5, "what the stamps may add is part of the error"
    stamps_add = log.current_late + 0.5 * (not log.held) + (not log.before) + 0.5 * log.filtered_by_samples
    assert told.value * joint.rate == pytest.approx(delay + stamps_add, abs=0.6), "no run tells the two apart"
    assert any(note.startswith("one side of current is later than stamps can be") for note in diagnosis.notes)


@pytest.mark.long
def test_a_delay_of_two_samples_is_named_only_where_stamps_are_told():
    for told in (True, False):
        random = np.random.default_rng(6)
        joint = drawn_joint(random)
        diagnosis = diagnose(case(joint, Log(sampling=told), random, Effect(delay=2)))
        assert named(diagnosis) == (["transport_delay"] if told else [])


@pytest.mark.parametrize(("told", "delay", "least"), [(True, 1, 0.0), (False, 1, 3.0), (False, 6, 0.0)])
def test_a_delay_within_what_stamps_may_be_enters_no_set(told, delay, least):
    """However surely it is there: three samples, where stamps are not told and not overdue."""
    random = np.random.default_rng(23)
    joint = drawn_joint(random)
    made = case(joint, Log(sampling=told), random, Effect(delay=delay))
    evidence = Evidence(mark_setpoints(made.fitted, made.model), made.model)
    normal, base = evidence.normal(), evidence.stack.columns_of([])
    delays = [candidate for candidate in evidence.candidates if candidate[0] == "transport_delay"]
    results = [
        one
        for candidate in delays
        if (one := fit_further_effect(evidence, normal, base, candidate, any_size=True)) is not None
    ]
    assert results
    assert [result.floor * ENTRY_HEIGHT * joint.rate for result in results] == pytest.approx(
        [least] * len(results), abs=0.1
    )


@pytest.mark.long
def test_an_effect_is_named_in_a_log_without_stamps():
    random = np.random.default_rng(7)
    joint = drawn_joint(random)
    top = joint.constant * joint.top / joint.damping
    strength = 0.15 * joint.constant * joint.top / top**2

    def drag(speed):
        return strength * speed * abs(speed)

    diagnosis = diagnose(case(joint, drawn_log(random), random, Effect(drag=drag)))
    assert named(diagnosis) == ["quadratic_drag"]


def test_a_shape_that_no_run_shows_has_no_size():
    random = np.random.default_rng(8)
    joint = drawn_joint(random)
    evidence = Evidence(case(joint, Log(), random).fitted, joint.model(random), only=[TOO_FAST])
    assert len(evidence.columns(TOO_FAST)) == 1
    assert (
        fit_further_effect(evidence, evidence.normal(), evidence.stack.columns_of([]), TOO_FAST, any_size=True) is None
    )


def test_neighbours_make_a_signal_late_by_what_they_are_said_to():
    time = np.linspace(0.0, 1.0, 400)
    slow = np.sin(2.0 * np.pi * time)
    weights = np.zeros(len(TAPS))
    weights[TAPS == -1], weights[TAPS == 2] = 0.5, -0.1
    late = lateness_of(weights)
    assert late == pytest.approx(0.7)
    shifted = np.interp(np.arange(400) - late, np.arange(400), slow)
    np.testing.assert_allclose(restamped(slow, late)[5:-5], shifted[5:-5], atol=3e-4)
    half_steps = np.sin(2.0 * np.pi * np.linspace(0.0, 1.0, 799))
    np.testing.assert_allclose(restamped(half_steps, late, parts=2)[10:-10:2], shifted[5:-5], atol=3e-4)
    np.testing.assert_array_equal(neighbour(slow, 3)[:-3], slow[3:])
