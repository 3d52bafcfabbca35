"""Step metrics against closed forms: loops whose figures are known, and runs that cannot give them."""

import math

import numpy as np
import pytest

from leactl.analysis.analyze import analyze_runs
from leactl.errors import InputError, MissingChannel, NotIdentifiable
from tests.analysis.control_runs import BANDWIDTH, LEAD, LEAD_TIME, LEVELS, REST_S, TRIAL_S, ringing, step_run
from tests.loops import current_figures, figures

SAMPLE_S = 1e-3


def found(result):
    return {item.name: item for item in result.results}


def test_the_loop_of_the_paper_comes_back(tmp_path):
    truth = current_figures(BANDWIDTH, LEAD, LEAD_TIME)
    result = found(analyze_runs([step_run(tmp_path, noise=0.015, quantum=0.0137)]))
    assert result["rise_time"].value == pytest.approx(truth.rise_time, abs=SAMPLE_S)
    assert result["overshoot"].value == pytest.approx(truth.overshoot, rel=0.05)
    assert result["settling_time"].value == pytest.approx(truth.settling_time, rel=0.05)
    assert abs(result["steady_state_error"].value) < 0.1
    assert [result[name].units for name in result] == ["s", "%", "s", "%"]


@pytest.mark.parametrize(("natural", "damping"), [(60.0, 0.3), (250.0, 0.28), (40.0, 0.7), (25.0, 1.0 - 1e-9)])
def test_second_order_loops_come_back(tmp_path, natural, damping):
    answer = ringing(natural, damping)
    time = np.arange(0, 2, 1e-5)
    truth = figures(time, answer(time))
    result = found(analyze_runs([step_run(tmp_path, answer=answer, trials=2, noise=1e-4)]))
    assert result["rise_time"].value == pytest.approx(truth.rise_time, abs=2e-4)
    assert result["overshoot"].value == pytest.approx(truth.overshoot, rel=0.02, abs=0.01)
    assert result["settling_time"].value == pytest.approx(truth.settling_time, rel=0.01)


def test_a_response_that_stays_short_of_its_reference_says_by_how_much(tmp_path):
    result = found(analyze_runs([step_run(tmp_path, answer=lambda t: 0.97 * (1 - np.exp(-t / 0.01)), noise=0.01)]))
    assert result["steady_state_error"].value == pytest.approx(3.0, abs=0.05)
    assert result["overshoot"].value == 0.0
    assert result["rise_time"].value == pytest.approx(0.01 * math.log(9), rel=0.01)


@pytest.mark.long
def test_intervals_hold_the_truth_about_as_often_as_they_say(tmp_path):
    truth = current_figures(BANDWIDTH, LEAD, LEAD_TIME)
    held = dict.fromkeys(("overshoot", "settling_time", "steady_state_error"), 0)
    for seed in range(20):
        (folder := tmp_path / str(seed)).mkdir()
        result = found(analyze_runs([step_run(folder, noise=0.02, trials=4, seed=seed)]))
        for name in held:
            held[name] += result[name].low <= getattr(truth, name, 0.0) <= result[name].high
    assert min(held.values()) >= 16  # of 20; fewer have a probability of 0.003 at 95 %


def without_some(name, where):
    def edit(columns):
        columns[name][where(columns["time"])] = np.nan

    return edit


def test_missed_samples_are_no_samples(tmp_path):
    whole = found(analyze_runs([step_run(tmp_path, noise=0.01)]))
    gaps = without_some("q_axis_current", lambda time: (time * 1000).astype(int) % 37 == 0)
    some = found(analyze_runs([step_run(tmp_path, noise=0.01, edit=gaps)]))
    for name in ("rise_time", "overshoot", "settling_time"):
        assert some[name].value == pytest.approx(whole[name].value, rel=0.03)


def test_missing_repeats_are_told_and_a_lone_trial_has_no_interval(tmp_path):
    def cut(columns):
        columns["q_axis_current"][columns["time"] > 4 * TRIAL_S] = np.nan

    result = analyze_runs([step_run(tmp_path, trials=2, noise=0.01, edit=cut)])
    notes = "\n".join(result.notes)
    assert "left out 2: too many samples are missing (5 at 10.0 s, 7.5 at 12.5 s)" in notes
    assert "repeats are missing: trials are 2 at 2.5, 1 at 5, 1 at 7.5" in notes
    assert "one trial alone at 5, 7.5" in notes
    assert math.isnan(found(result)["overshoot"].low)
    assert found(result)["overshoot"].value == pytest.approx(8.3, rel=0.1)


def test_runs_are_repeats_of_each_other(tmp_path):
    result = analyze_runs([step_run(tmp_path, trials=1, noise=0.01, seed=seed) for seed in range(3)])
    assert math.isfinite(found(result)["overshoot"].std)


def clip(columns):
    np.clip(columns["q_axis_current"], -9, 6.2, out=columns["q_axis_current"])


def test_clipped_trials_are_left_out(tmp_path):
    result = analyze_runs([step_run(tmp_path, noise=0.01, edit=clip)])
    assert any("left out 5: q_axis_current is clipped at 6.2 A (7.5 at 5.0 s" in note for note in result.notes)
    assert found(result)["overshoot"].value == pytest.approx(8.3, rel=0.05)


def test_a_few_clipped_readings_of_a_top_leave_its_trial_out(tmp_path):
    def edit(columns):
        np.minimum(columns["q_axis_current"], 7.9, out=columns["q_axis_current"])

    path = step_run(tmp_path, answer=ringing(250.0, 0.6), noise=0.003, edit=edit)
    assert any("left out 5: q_axis_current is clipped at 7.9 A" in note for note in analyze_runs([path]).notes)


@pytest.mark.long
def test_readings_that_are_noisier_in_motion_make_no_higher_top(tmp_path):
    held, errors, true = 0, [], 100.0 * math.exp(-math.pi * 0.75)
    for seed in range(8):

        def edit(columns, seed=seed):
            since = columns["time"] % TRIAL_S - REST_S
            louder = np.random.default_rng(99 + seed).normal(0.0, 0.01 * math.sqrt(3.0), len(since))
            columns["q_axis_current"] += np.where((since > 0.0) & (since < 0.3), louder, 0.0)

        (folder := tmp_path / str(seed)).mkdir()
        result = analyze_runs([step_run(folder, answer=ringing(20.0, 0.6), noise=0.01, seed=seed, edit=edit)])
        outcome = result.find("overshoot")
        held += outcome.low <= true <= outcome.high
        errors.append(outcome.value - true)
    assert held >= 6
    assert abs(np.mean(errors)) < 0.1


def test_a_servo_that_friction_holds_at_its_highest_level_is_not_clipped(tmp_path):
    def creeping(time):
        return 1 - np.exp(-time / 0.02) - 0.002 * np.maximum(1.2 - time, 0.0)

    result = analyze_runs([step_run(tmp_path, answer=creeping, trials=2, quantum=0.0005)])
    assert not any("clipped" in note for note in result.notes)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"answer": lambda t: 1 - np.exp(-t / 1.2)}, "never settles within 2%"),
        ({"answer": lambda t: 1 + 0.5 * np.sin(3 * t)}, "never settles within 2%"),
        ({"answer": lambda t: 0.1 * t / (t + 0.01)}, "makes less than 50% of the step"),
        ({"edit": without_some("q_axis_current", lambda time: time > 0)}, "too many samples are missing"),
        ({"edit": without_some("q_axis_current_reference", lambda time: time > 0)}, "reference does not jump"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_responses_that_say_nothing_are_refused_with_the_reason(tmp_path, change, reason):
    path = step_run(tmp_path, trials=1, noise=1e-3, **change)
    with pytest.raises(NotIdentifiable) as caught:
        analyze_runs([path])
    assert str(caught.value).startswith(f"{path}: found 3 steps of q_axis_current, none of use (3: ")
    assert reason in str(caught.value)


def test_a_swapped_sign_is_refused(tmp_path):
    path = step_run(tmp_path, trials=1, noise=1e-3, answer=lambda t: -(1 - np.exp(-t / 0.01)))
    with pytest.raises(InputError, match=r"q_axis_current of test .* has the opposite sign of its demand"):
        analyze_runs([path])


@pytest.mark.parametrize("channel", ["q_axis_current", "q_axis_current_reference"])
def test_a_run_without_a_channel_is_refused(tmp_path, channel):
    with pytest.raises(MissingChannel, match=f"no {channel} of test"):
        analyze_runs([step_run(tmp_path, trials=1, lacks=(channel,))])


def test_noise_wider_than_the_band_leaves_the_settling_time_open(tmp_path):
    result = analyze_runs([step_run(tmp_path, levels=LEVELS[:1], trials=2, noise=0.35)])
    assert math.isnan(found(result)["settling_time"].value)
    assert any("settling_time is not known: noise" in note for note in result.notes)


def test_a_run_of_something_else_is_refused(tmp_path):
    def rename(columns):
        columns["time"] += 100.0

    with pytest.raises(InputError, match="none of use"):
        analyze_runs([step_run(tmp_path, trials=1, edit=rename)])
