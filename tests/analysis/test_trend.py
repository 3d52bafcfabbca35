"""A result followed from run to run: limits, what speaks for a change, and runs that do not tell it."""

import json
import shutil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl import run_protocol
from leactl.analysis.statistics.control_chart import FEWEST_BASELINE_VALUES, ROW_LENGTH, control_chart
from tests.cli.terminal import leactl

WITHIN = np.array([0.1, -0.1] * 10)


def test_limits_are_three_sigma_of_the_mean_moving_range():
    chart = control_chart(5.0 + WITHIN)
    assert chart.centre == pytest.approx(5.0)
    assert chart.high - chart.centre == pytest.approx(2.66 * 0.2, rel=1e-3)  # the table's constant of such a chart
    assert not chart.changed


def test_a_leap_is_beyond_the_limits_of_the_runs_before_it():
    chart = control_chart(np.append(5.0 + WITHIN, 6.0), baseline=20)
    assert chart.beyond == (20,)


def test_a_small_shift_shows_by_nine_on_one_side():
    shifted = np.concatenate([5.0 + WITHIN, 5.05 + 0.01 * WITHIN[:ROW_LENGTH]])
    chart = control_chart(shifted, baseline=20)
    assert chart.beyond == ()
    assert chart.shifted == (20 + ROW_LENGTH - 1,)
    assert control_chart(shifted[:-1], baseline=20).shifted == ()


def test_too_few_runs_have_no_limits():
    assert control_chart(np.ones(FEWEST_BASELINE_VALUES - 1)) is None
    assert control_chart(np.arange(20.0), baseline=FEWEST_BASELINE_VALUES - 1) is None


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=FEWEST_BASELINE_VALUES, max_size=30),
    st.floats(0.1, 10.0),
    st.floats(-100.0, 100.0),
)
def test_units_and_zero_change_no_answer(values, scale, zero):
    values = np.round(np.array(values), 3)
    one, other = control_chart(values), control_chart(scale * values + zero)
    margins = np.abs(np.abs(values - one.centre) - (one.high - one.centre))
    if margins.min() > 1e-6 and np.abs(values - one.centre).min() > 1e-6:  # none lies on a limit or on the centre
        assert (one.beyond, one.shifted) == (other.beyond, other.shifted)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Eight runs of an actuator under one condition and one under another, and one of another actuator."""
    folder = tmp_path_factory.mktemp("runs")
    short = {"trials": 1, "hold_s": 2, "settle_s": 1}
    made = [("LEA-1", "design")] * 8 + [("LEA-1", "loaded"), ("LEA-2", "design")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LEACTL_STATE", str(folder / "state"))
        for seed, (actuator, condition) in enumerate(made, 1):
            settings = short | {"seed": seed}
            run_protocol("friction", settings=settings, actuator=actuator, condition=condition, out=folder / "runs")
    return folder / "runs"


def followed(runs, *words):
    return leactl("runs", "trend", "coulomb_friction", runs, "--set", "torque_constant=0.49", *words)


def test_an_actuator_and_a_condition_have_to_be_chosen(runs):
    done = followed(runs)
    assert done.returncode == 2
    groups = "'LEA-1' under 'design', 'LEA-1' under 'loaded', 'LEA-2' under 'design'; choose one by"
    assert groups in done.stderr
    done = followed(runs, "--actuator", "LEA-3")
    assert done.returncode == 2
    assert groups in done.stderr


def test_values_come_in_the_order_of_time_with_their_uncertainty(runs):
    done = followed(runs, "--actuator", "LEA-1", "--condition", "design", "--json")
    answer = json.loads(done.stdout)
    created = [point["created"] for point in answer["points"]]
    assert len(created) == 8
    assert created == sorted(created)
    assert all(point["value"] == pytest.approx(0.208, abs=0.01) and point["std"] > 0.0 for point in answer["points"])
    assert answer["chart"]["changed"] is False
    assert answer["left_out"] == []
    shown = followed(runs, "--actuator", "LEA-1", "--condition", "design").stdout
    assert shown.startswith("coulomb_friction [N*m] of LEA-1, design: no change in 8 runs; limits 0.20")
    assert max(map(len, shown.splitlines())) <= 80


def test_several_processes_give_the_same_answers_as_one(runs):
    chosen = "--actuator", "LEA-1", "--condition", "design", "--json"
    (runs / "spoilt.h5").write_bytes(next(runs.glob("*.h5")).read_bytes()[:5000])
    try:
        analyze = "analyze", runs, "--set", "torque_constant=0.49", "--json"
        for words in (("runs", "verify", runs), ("runs", "verify", runs, "--json"), analyze):
            alone, together = leactl(*words), leactl(*words, "--processes", 2)
            assert (together.returncode, together.stdout, together.stderr) == (2, alone.stdout, alone.stderr)
            assert len(together.stdout) > 1000
    finally:
        (runs / "spoilt.h5").unlink()
    alone, together = followed(runs, *chosen), followed(runs, *chosen, "--processes", 2)
    assert (together.returncode, together.stdout) == (0, alone.stdout)


def test_a_run_given_twice_is_refused(runs, tmp_path):
    file = sorted(runs.glob("*.h5"))[0]
    shutil.copy(file, tmp_path / "copy.h5")
    done = followed(file, str(tmp_path / "copy.h5"))
    assert done.returncode == 2
    assert f"copy.h5: the same run as {file}; give each run once" in done.stderr


def test_an_option_that_no_analysis_takes_is_refused(runs):
    done = followed(runs, "--actuator", "LEA-2", "--set", "torque_constnat=0.5")
    assert done.returncode == 2
    assert "--set torque_constnat: none of friction takes it" in done.stderr


def test_few_runs_are_shown_without_limits(runs):
    done = followed(runs, "--actuator", "LEA-2")
    assert "1 run; limits need 8" in done.stdout


def test_what_no_run_has_is_refused_with_what_they_have(runs):
    done = leactl("runs", "trend", "torque", runs)
    assert done.returncode == 2
    assert "no run has a result 'torque'; they have " in done.stderr
    assert "coulomb_friction" in done.stderr
