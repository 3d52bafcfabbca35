"""The torque constant from runs whose torque constant is known."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from leactl.analysis.experiments.torque_constant import analyze
from leactl.errors import InputError, MissingChannel, NotIdentifiable

from .synthetic import HOLD_S, Bench, analyzed, covered

SLOW = settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])


@SLOW
@given(
    kt=st.floats(0.01, 5.0),
    sticking=st.floats(-0.5, 0.5),
    offset=st.floats(-2.0, 2.0),
    mirrored=st.booleans(),
)
def test_without_noise_the_parameters_come_back(tmp_path_factory, kt, sticking, offset, mirrored):
    levels = (-2.0, -4.0, -7.0) if mirrored else (2.0, 4.0, 7.0)
    path = Bench(tmp_path_factory.mktemp("run")).torque(kt=kt, sticking=sticking, offset=offset, levels=levels)
    result = analyzed(analyze, path)
    assert result.find("torque_constant").value == pytest.approx(kt, rel=1e-9)
    assert result.find("torque_constant_rising").value == pytest.approx(kt, rel=1e-9)
    assert result.find("torque_constant_falling").value == pytest.approx(kt, rel=1e-9)
    assert result.find("sticking_torque").value == pytest.approx(abs(sticking), abs=1e-9)
    assert result.find("offset").value == pytest.approx(offset, abs=1e-9)
    assert result.find("r_squared").value == pytest.approx(1.0, abs=1e-9)


def test_levels_from_one_side_leave_sticking_in_the_offset_and_say_so(bench):
    result = analyzed(analyze, bench.torque(sides=("rising",), sticking=-0.2, offset=0.05))
    assert result.find("torque_constant").value == pytest.approx(0.49)
    assert result.find("offset").value == pytest.approx(-0.15)
    assert "sticking_torque" not in [item.name for item in result.results]
    assert any("sticking friction is part of the offset" in note for note in result.notes)


def test_a_hold_without_direction_among_others_that_have_one_does_not_count(bench):
    result = analyzed(analyze, bench.torque(sides=("rising", "falling", ""), trials=2))
    assert result.find("sticking_torque").value == pytest.approx(0.2)
    assert any("left out 10: no direction" in note for note in result.notes)


@pytest.mark.long
@pytest.mark.parametrize(
    "faults",
    [
        {"scatter": 0.02},
        {"curve": 0.02},
        {"scatter": 0.02, "curve": 0.02},
        {"current_error": 0.6},
    ],
    ids=str,
)
def test_intervals_hold_the_truth_in_95_of_100_runs(bench, faults):
    held = {"torque_constant": 0, "sticking_torque": 0}
    for _ in range(100):
        result = analyzed(analyze, bench.torque(rate_Hz=8, **faults))
        held["torque_constant"] += covered(result.find("torque_constant"), 0.49)
        held["sticking_torque"] += covered(result.find("sticking_torque"), 0.2)
    assert min(held.values()) >= 88  # three standard deviations below 95 of 100


def test_more_samples_of_the_same_holds_are_no_more_evidence(tmp_path):
    widths = []
    for rate in (20, 320):
        bench = Bench(tmp_path / str(rate), np.random.default_rng(5))
        state = bench.rng.bit_generator.state
        path = bench.torque(scatter=0.02, rate_Hz=rate)
        bench.rng.bit_generator.state = state
        result = analyzed(analyze, path).find("torque_constant")
        widths.append(result.high - result.low)
    assert widths[1] == pytest.approx(widths[0], rel=1e-6)


def test_repeats_are_combined_each_with_the_zero_of_its_sensor(bench):
    paths = [bench.torque(scatter=0.02, offset=offset) for offset in (-1.0, 0.0, 2.5, 0.1)]
    one, four = analyzed(analyze, paths[0]), analyzed(analyze, *paths)
    slope = four.find("torque_constant")
    assert covered(slope, 0.49)
    assert slope.std < 0.75 * one.find("torque_constant").std
    assert covered(four.find("offset"), 0.4)
    assert four.find("sticking_torque").value == pytest.approx(0.2, abs=0.02)


def test_where_runs_differ_their_number_decides_and_not_that_of_the_holds(bench):
    constants = (0.47, 0.50, 0.48, 0.51)
    result = analyzed(analyze, *(bench.torque(kt=kt, scatter=0.01) for kt in constants))
    slope = result.find("torque_constant")
    # mean and its standard error of four values by hand, Student's t with 3 degrees of freedom 3.182
    assert slope.value == pytest.approx(0.49, abs=0.001)
    assert slope.std == pytest.approx(0.00913, rel=0.1)
    assert slope.high - slope.value == pytest.approx(3.182 * 0.00913, rel=0.1)
    assert any("torque_constant differs between the runs" in note for note in result.notes)
    assert result.find("sticking_torque").std < 0.01


def test_missed_samples_are_left_out(bench):
    def lose(time, columns):
        columns["torque"][::3] = np.nan
        columns["torque"][time < HOLD_S] = np.nan

    result = analyzed(analyze, bench.torque(edit=lose))
    assert result.find("torque_constant").value == pytest.approx(0.49)
    assert any("left out 1: too little torque in the settled part (4.9 A at 0.5 s)" in note for note in result.notes)
    assert any("33.3% of the samples of torque" in note for note in result.notes)


def clip_at(limit):
    def edit(_time, columns):
        columns["torque"] = np.minimum(columns["torque"], limit)

    return edit


def test_saturated_holds_do_not_count(bench):
    result = analyzed(analyze, bench.torque(noise=0.01, edit=clip_at(8.0)))
    assert covered(result.find("torque_constant"), 0.49)
    assert result.find("torque_constant").value == pytest.approx(0.49, abs=0.002)
    assert any("torque of test is saturated at 8 in 12 holds" in note for note in result.notes)


def test_a_sensor_that_is_saturated_at_all_levels_but_one_tells_nothing(bench):
    path = bench.torque(noise=0.01, edit=clip_at(4.0))
    with pytest.raises(NotIdentifiable, match=r"saturated at 4 in 24 holds .*; two levels or more within"):
        analyzed(analyze, path)


def test_torque_that_hangs_is_as_good_as_missed(bench):
    def hang(time, columns):
        columns["torque"][(time >= 1.9) & (time < 6.0)] = columns["torque"][time >= 1.9][0]

    result = analyzed(analyze, bench.torque(noise=0.01, edit=hang))
    assert result.find("torque_constant").value == pytest.approx(0.49, abs=0.001)
    assert any("readings of torque came again" in note for note in result.notes)
    assert any("left out 1: too little torque in the settled part (9.8 A" in note for note in result.notes)


def test_a_coarse_sensor_may_read_the_same_again(bench):
    def round_to_counts(_time, columns):
        columns["torque"] = np.round(columns["torque"] / 0.05) * 0.05

    result = analyzed(analyze, bench.torque(noise=0.01, edit=round_to_counts))
    assert result.find("torque_constant").value == pytest.approx(0.49, abs=0.002)
    assert not any("came again" in note or "saturated" in note for note in result.notes)


@pytest.mark.parametrize(
    ("how", "fault", "words"),
    [
        ({"levels": (4.9,)}, NotIdentifiable, r"found one level \(4.9 A in 6 holds\); two distinct levels"),
        (
            {"levels": (4.9, 9.8), "trials": 1, "sides": ("rising",)},
            NotIdentifiable,
            "2 points for 2 unknowns leave no degree of freedom; 3 points or more are needed",
        ),
        ({"role": "load"}, NotIdentifiable, "no step named 'hold' with current_A; two held levels or more are needed"),
        (
            {"edit": lambda _time, columns: columns["q_axis_current"].fill(0.0)},
            NotIdentifiable,
            "the current of 30 holds is spread by 0",
        ),
        (
            {"edit": lambda _time, columns: columns["torque"].fill(np.nan)},
            NotIdentifiable,
            "30 holds, none with data",
        ),
    ],
)
def test_a_run_that_cannot_answer_says_why_in_one_line(bench, how, fault, words):
    path = bench.torque(**how)
    with pytest.raises(fault, match=words) as caught:
        analyzed(analyze, path)
    assert caught.value.exit_status == 2
    assert str(caught.value).startswith(str(path))
    assert len(caught.value.faults) == 1


def test_a_current_of_noise_alone_is_refused(bench):
    def lose_current(_time, columns):
        columns["q_axis_current"] = bench.rng.normal(0.0, 0.05, len(columns["q_axis_current"]))

    path = bench.torque(edit=lose_current)
    with pytest.raises(NotIdentifiable, match=r"its means are known to 0\.0053; a spread above 0\.053 is needed"):
        analyzed(analyze, path)


def test_a_current_that_does_not_follow_its_setpoints_is_refused(bench):
    path = bench.torque(current_error=60.0)
    with pytest.raises(NotIdentifiable, match="do not follow their setpoints"):
        analyzed(analyze, path)


def test_a_run_without_torque_names_what_it_has(bench):
    path = bench.friction()
    with pytest.raises(MissingChannel, match="no torque of test; the run has q_axis_current of test, velocity of test"):
        analyzed(analyze, path)


def test_runs_in_different_units_are_refused(bench):
    paths = [bench.torque(), bench.torque(units={"torque": "N"})]
    with pytest.raises(InputError, match=r"torque in N, in N\*m in the runs before"):
        analyzed(analyze, *paths)


@pytest.mark.parametrize(
    ("ratio", "words"),
    [(1.2247, "phase amplitude taken for q-axis"), (0.8165, "q-axis current taken for"), (1.7321, "phase rms taken")],
)
def test_a_wrong_convention_of_current_is_named(bench, ratio, words):
    result = analyzed(analyze, bench.torque(kt=0.49 * ratio))
    assert any(words in note and "check current_convention" in note for note in result.notes)


def test_a_torque_constant_near_the_models_or_without_one_raises_no_doubt(bench):
    for path in (bench.torque(kt=0.51), bench.torque(kt=0.6, torque_constant=None)):
        assert not any("current_convention" in note for note in analyzed(analyze, path).notes)


def test_scatter_beyond_noise_and_a_curved_sensor_are_noted(bench):
    shaken = analyzed(analyze, bench.torque(scatter=0.05, noise=0.01))
    assert any("times as much as the noise within them explains" in note for note in shaken.notes)
    curved = analyzed(analyze, bench.torque(curve=0.05, scatter=0.001))
    assert any("level means depart from the fit" in note for note in curved.notes)
    quiet = analyzed(analyze, bench.torque(noise=0.01))
    assert not any("scatter" in note for note in quiet.notes)
    doubt = "an error in the calibration of torque or current is a factor on the torque constants"
    assert f"{doubt}, on top of their uncertainty" in quiet.notes


def test_a_shaft_that_was_free_is_noted(bench):
    result = analyzed(analyze, bench.torque(mechanical="free"))
    assert any("setup is 'free', coupled or locked was expected" in note for note in result.notes)
