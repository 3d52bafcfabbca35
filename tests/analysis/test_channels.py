"""The analysis of any protocol: holds, excitations and histograms of runs whose numbers are known."""

import numpy as np
import pytest

from leactl.analysis.analyze import analyze_runs
from leactl.errors import InputError, MissingChannel
from tests.cli.terminal import leactl

from .excited import first_order

RATE = 200.0


def holds(bench, drift=0.0, deviation=0.01, count=3, seed=1, name="bespoke", level=1.0, **how):
    rng = np.random.default_rng(seed)
    time = np.arange(round(count * 5 * RATE)) / RATE
    columns = {"torque": level + drift * time + rng.normal(0.0, deviation, len(time)), "velocity": 0.0 * time + 3.0}
    steps = [("hold", 5.0 * k, 5.0 * k + 5.0, 1.0, {"current_A": k}) for k in range(count)]
    return bench.write(name, time, columns, steps, protocol=f"name: {name}\n", **how)


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


def test_a_sensor_without_its_noise_is_told(bench):
    (note,) = [note for note in analyze_runs([holds(bench)]).notes if "throughout" in note]
    assert "velocity reads exactly 3 rad/s throughout" in note
    notes = analyze_runs([holds(bench, deviation=0.0, level=0.0, name="dead")]).notes
    assert any("torque reads exactly 0 N*m throughout" in note for note in notes)


@pytest.mark.long
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


def test_a_run_that_ended_early_does_not_keep_the_others_from_being_analysed(bench):
    early = holds(bench, count=1, level=5.0, status="tripped")
    none = bench.write("bespoke", np.arange(2) / RATE, {"torque": np.zeros(2), "velocity": np.zeros(2)}, [],
                       status="tripped", protocol="name: bespoke\n")  # fmt: skip
    result = analyze_runs([none, early, holds(bench, seed=2), holds(bench, seed=3)])
    assert result.find("hold_1_torque").value == pytest.approx(1.0, abs=0.01)
    for path in (none, early):
        assert any(note.startswith(f"{path}: left out: it ended early") for note in result.notes)
    alone = analyze_runs([none, early])
    assert alone.find("hold_1_torque").value == pytest.approx(5.0, abs=0.01)


def test_a_stopped_run_with_all_steps_counts_as_a_repeat(bench):
    result = analyze_runs([holds(bench), holds(bench, level=2.0, status="stopped")])
    assert result.find("hold_1_torque").value == pytest.approx(1.5, abs=0.01)


def test_several_protocols_and_parameters_are_analysed_apart_and_named(bench):
    first = [holds(bench, level=level, parameters={"hold_s": level, "top": 7}) for level in (1.0, 2.0)]
    result = analyze_runs([*first, holds(bench, name="other", level=3.0)])
    means = {item.name: item.value for item in result.results if item.name.endswith("hold_1_torque")}
    assert means == pytest.approx(
        {
            "bespoke hold_s=1.0: hold_1_torque": 1.0,
            "bespoke hold_s=2.0: hold_1_torque": 2.0,
            "other: hold_1_torque": 3.0,
        },
        abs=0.01,
    )
    assert {item.name.split(":")[0] for item in analyze_runs(first).results} == {"hold_s=1.0", "hold_s=2.0"}


def test_the_very_same_readings_twice_are_no_better_known_than_once(bench):
    once, again = (analyze_runs(paths) for paths in ([holds(bench)], [holds(bench), holds(bench)]))
    for name in ("hold_1_torque", "hold_1_torque_drift"):
        assert again.find(name).value == pytest.approx(once.find(name).value)
        assert again.find(name).std >= 0.7 * once.find(name).std > 0.0
        assert again.find(name).low < again.find(name).value < again.find(name).high


def test_holds_of_another_name_are_analysed_too_and_moves_are_not(bench):
    time = np.arange(round(40 * RATE)) / RATE
    columns = {"torque": 1.0 + np.random.default_rng(4).normal(0.0, 0.01, len(time))}
    told = {"role": "test", "repeat": 1}
    named = ("steady", {"velocity_rad_s": 5.0}), ("ramp", {}), ("turn", {}), ("sine", {"kind": "sine"})
    steps = [(name, 5.0 * k, 5.0 * k + 5.0, 1.0, told | own) for k, (name, own) in enumerate(named)]
    steps += [("coast", 20.0, 25.0, 0.0, {"repeat": 1}), ("set", 25.0, 25.0, 0.0, told | {"current_A": 1.0})]
    steps += [("steady", 30.0, 35.0, 0.0, told | {"current_A": 0.0, "until": "met"})]
    result = analyze_runs([bench.write("bespoke", time, columns, steps, protocol="name: bespoke\n")])
    assert {item.name.split("_torque")[0] for item in result.results} == {"steady_1", "coast_1", "steady_2"}


def test_a_channel_that_stands_still_drifts_by_nothing(bench):
    time = np.arange(round(5 * RATE)) / RATE
    columns = {"torque": np.full(len(time), 29.6), "velocity": np.full(len(time), 1.0)}
    steps = [("hold", 0.0, 5.0, 1.0, {"current_A": 1.0})]
    result = analyze_runs([bench.write("bespoke", time, columns, steps, protocol="name: bespoke\n")])
    for channel in ("torque", "velocity"):
        drift = result.find(f"hold_1_{channel}_drift")
        assert (drift.value, drift.std, drift.low, drift.high) == (0.0, 0.0, 0.0, 0.0)


def test_channels_with_too_few_samples_are_told_once_for_all_holds(bench):
    time = np.arange(round(20 * RATE)) / RATE
    gone = np.full(len(time), np.nan)
    steps = [("hold", 4.0 * k, 4.0 * k + 4.0, 1.0, {"current_A": k}) for k in range(5)]
    path = bench.write("bespoke", time, {"torque": np.ones(len(time)), "velocity": gone}, steps, protocol="name: x\n")
    notes = [note for note in analyze_runs([path]).notes if "fewer than" in note]
    assert len(notes) == 1
    assert "hold_1, hold_2, hold_3, hold_4 and 1 more" in notes[0]
    assert "(velocity)" in notes[0]


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


@pytest.mark.parametrize("kind", ["noise", "chirp", "multisine"])
def test_the_phase_of_a_delay_is_unwrapped_alike_in_results_grid_and_plot(bench, kind):
    time, given, answer = first_order(kind, corner_hz=8.0, rate=RATE)
    late = 16
    noise = np.random.default_rng(5).normal(0.0, 0.3 * np.std(answer), len(time))  # hides some frequencies
    columns = {"velocity_reference": given, "torque": np.roll(answer, late) + noise}
    steps = [(kind, 1.0, float(time[-1]) + 1 / RATE, 0.0, {"role": "test"})]
    result = analyze_runs([bench.write("bespoke", time, columns, steps, protocol="name: bespoke\n")])
    [grid] = [grid for grid in result.grids if "response" in grid.name]
    frequency, phase = np.array(grid.axes["frequency [Hz]"]), np.array(grid.values["phase [rad]"][0])
    truth = -2.0 * np.pi * frequency * late / RATE - np.arctan(frequency / 8.0)
    assert truth.min() < -2.0 * np.pi
    assert np.abs(phase - truth).max() < np.pi
    [plot] = [plot for plot in result.plots if "phase" in plot.y_label]
    assert set(plot.points[0].y) <= set(phase.tolist())
    estimates = [item.value for item in result.results if "_phase_at_" in item.name]
    assert len(estimates) == 5
    assert set(estimates) <= set(phase.tolist())


@pytest.mark.parametrize("scale", [1.0, 40.0])
def test_a_multisine_says_nothing_between_and_beyond_its_lines(bench, scale):
    time = np.arange(4000) / (RATE * scale)
    lines = scale * np.linspace(5.0, 40.0, 15)
    phases = np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, (15, 1))
    given = np.sin(2.0 * np.pi * lines[:, None] * time + phases).sum(axis=0)
    steps = [("multisine", 0.0, float(time[-1] + time[1]), 0.0, {"role": "test"})]
    columns = {"velocity_reference": given, "velocity": 0.5 * given + np.random.default_rng(4).normal(0, 0.01, 4000)}
    result = analyze_runs([bench.write("bespoke", time, columns, steps, protocol="name: bespoke\n")])
    grid = next(grid for grid in result.grids if "response" in grid.name)
    known = np.array(grid.axes["frequency [Hz]"])
    away = np.abs(known[:, None] - lines).min(axis=1)
    assert set(np.abs(known[:, None] - lines).argmin(axis=1)) == set(range(15))
    assert away.max() < 0.8 * scale  # the width of a line in a fortieth of the record


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
