"""The analysis of any protocol: holds, excitations and histograms of runs whose numbers are known."""

import numpy as np
import pytest

from leactl.analysis.experiments import analyze_runs
from leactl.errors import InputError, MissingChannel
from tests.cli.terminal import leactl

from .excited import first_order

RATE = 200.0


def holds(bench, drift=0.0, deviation=0.01, count=3, seed=1, **how):
    rng = np.random.default_rng(seed)
    time = np.arange(round(count * 5 * RATE)) / RATE
    columns = {"torque": 1.0 + drift * time + rng.normal(0.0, deviation, len(time)), "velocity": 0.0 * time + 3.0}
    steps = [("hold", 5.0 * k, 5.0 * k + 5.0, 1.0, {"current_A": k}) for k in range(count)]
    return bench.write("bespoke", time, columns, steps, protocol="name: bespoke\n", **how)


def test_a_protocol_that_names_no_analysis_is_analysed_by_its_channels(bench):
    result = analyze_runs([holds(bench, drift=0.02)])
    assert result.experiment == "channels"
    mean, scatter, drift = (result.find(f"hold_2_torque{part}") for part in ("", "_deviation", "_drift"))
    assert mean.low < 1.0 + 0.02 * 8.0 < mean.high
    assert drift.low < 0.02 < drift.high
    assert (mean.units, scatter.units, drift.units) == ("N*m", "N*m", "N*m/s")
    constant = result.find("hold_1_velocity")
    assert (constant.value, constant.std) == (3.0, 0.0)
    assert result.find("hold_1_velocity_drift").value == 0.0


def test_the_intervals_hold_the_truth_as_often_as_they_say(bench):
    missed = np.zeros(3)
    for seed in range(40):
        result = analyze_runs([holds(bench, drift=0.0, seed=seed)], channel=["torque"])
        for index, (part, truth) in enumerate((("", 1.0), ("_deviation", 0.01), ("_drift", 0.0))):
            for hold in (1, 2, 3):
                item = result.find(f"hold_{hold}_torque{part}")
                missed[index] += not item.low <= truth <= item.high
    assert np.all(missed <= 15)  # of 120 at 5 %; the 99.9 % point of the binomial distribution is 14


def test_channels_are_chosen_by_name_and_a_missing_one_is_refused(bench):
    path = holds(bench)
    result = analyze_runs([path], channel=["torque"])
    assert {item.name.split("_")[2] for item in result.results} == {"torque"}
    assert [plot.x_label for plot in result.plots] == ["time [s]", "torque [N*m]"]
    assert sum(result.grids[0].values["readings [1]"][0]) == 3000
    with pytest.raises(MissingChannel, match="no channel torqe; the run has torque, velocity"):
        analyze_runs([path], channel=["torqe"])


def test_runs_are_analysed_by_channels_on_request_and_repeats_are_averaged(bench):
    result = analyze_runs([bench.torque(), bench.torque()], "channels")
    assert result.find("hold_1_q_axis_current").value == pytest.approx(4.9, abs=1e-6)
    with pytest.raises(InputError, match="other steps or channels than"):
        analyze_runs([holds(bench), holds(bench, count=2)])


def test_a_run_without_steps_counts_as_one_hold(bench):
    time = np.arange(1000) / RATE
    path = bench.write("log", time, {"torque": 2.0 + 0.0 * time}, [])
    assert analyze_runs([path], "channels").find("whole_torque").value == 2.0


@pytest.mark.parametrize("kind", ["noise", "chirp", "multisine"])
def test_gain_and_phase_of_an_excitation(bench, kind):
    time, given, answer = first_order(kind, corner_hz=8.0, rate=RATE)
    columns = {"velocity_reference": given, "velocity": answer, "angle": np.zeros_like(time)}
    steps = [(kind, 0.0, float(time[-1]) + 1 / RATE, 0.0, {"role": "test"})]
    result = analyze_runs([bench.write("bespoke", time, columns, steps, protocol="name: bespoke\n")])
    gains = [item for item in result.results if f"{kind}_1_velocity_gain_at_" in item.name]
    assert len(gains) == 5
    for item in gains:
        at = float(item.name.split("_at_")[1].removesuffix("_Hz"))
        truth = 1.0 / (1.0 + 1j * at / 8.0)
        assert abs(item.value - abs(truth)) < max(0.03 * abs(truth), 2 * (item.high - item.value))
        phase = result.find(item.name.replace("_gain_", "_phase_"))
        assert abs(phase.value - np.angle(truth)) < max(0.03, 2 * (phase.high - phase.value))
    assert any("angle" in note and "does not move" in note for note in result.notes)
    assert {"frequency [Hz]"} <= set(next(grid for grid in result.grids if "response" in grid.name).axes)


def test_the_datasheet_has_the_channels_of_such_a_run(bench, tmp_path):
    path = holds(bench)
    done = leactl("report", str(path), "--html", str(tmp_path / "sheet.html"))
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "sheet.html").read_text(encoding="utf-8")
    assert "hold 2 torque" in page
    assert "Channels of a protocol of one's own" in page.replace("&#x27;", "'").replace("&#39;", "'")
    shown = leactl("analyze", str(path), "--channel", "torque", "--as", "generic")
    assert (shown.returncode, shown.stderr) == (0, "")
    assert "hold_2_torque" in shown.stdout
    assert "readings" in shown.stdout
