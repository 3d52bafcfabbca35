"""`leactl stats` on run files and answers, as a shell sees it."""

import json
import re
import subprocess

import h5py
import numpy as np
import pytest

from leactl.analysis.analyze import analyze_runs
from leactl.analysis.anova.comparison import compare, compare_all
from leactl.analysis.anova.values import Values
from leactl.errors import InputError, NotIdentifiable
from tests.analysis.envelopes import SPEEDS, driven
from tests.analysis.run_outs import coasting
from tests.analysis.synthetic import Bench
from tests.cli.terminal import COMMAND, leactl
from tests.runfile.specimen import unseal

FRICTION = {"unloaded": 0.24, "design": 0.21, "loaded": 0.26}


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return Bench(tmp_path)


def runs(bench, actuators=("a1",), trials=5, conditions=FRICTION, spread=0.005, **how):
    return [
        bench.friction(
            f=FRICTION[label] + bench.rng.normal(0.0, spread, trials),
            b=0.02 + 0.001 * np.linspace(-1.0, 1.0, trials),  # no effect of the condition at all
            trials=trials,
            condition=label,
            actuator=actuator,
            **how,
        )
        for label in conditions
        for actuator in actuators
    ]


def test_a_shell_gets_the_sentence_the_tables_and_json(bench):
    names = [path.name for path in runs(bench)]
    done = leactl("stats", *names, COLUMNS="80")
    assert (done.returncode, done.stderr) == (0, "")
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert "coulomb_friction differs between conditions (F(2, 12) = " in " ".join(done.stdout.split())
    assert "one actuator ('a1'): no random factor" in " ".join(done.stdout.split())
    body = json.loads(leactl("stats", *names, "--json").stdout, parse_constant=lambda name: pytest.fail(name))
    results = {result["name"]: result for result in body["results"]}
    assert [row["count"] for row in results["coulomb_friction"]["conditions"]] == [5, 5, 5]
    assert results["coulomb_friction"]["conditions"][0]["mean"] == pytest.approx(0.24, abs=0.01)
    assert not results["viscous_damping"]["shown"]
    assert results["viscous_damping"]["sentence"].startswith("No effect of the condition")


def test_two_actuators_are_a_random_factor(bench):
    result = {comparison.name: comparison for comparison in compare_all(runs(bench, ("a1", "a2")))[1]}[
        "coulomb_friction"
    ]
    assert (result.anova.test.between, result.anova.test.within) == (2, 26)
    assert any("holds for these 2 actuators" in note for note in result.notes)


def test_missing_repeats_and_cells_are_said_and_the_rest_is_compared(bench):
    paths = runs(bench, ("a1", "a2"))[:-1] + runs(bench, ("a1",), trials=2, conditions=("loaded",))
    result = {comparison.name: comparison for comparison in compare_all(paths)[1]}["coulomb_friction"]
    assert any(note.startswith("numbers are unequal: unloaded 10, design 10, loaded 7") for note in result.notes)
    assert "not measured: a2 loaded" in result.notes
    assert result.anova.test.shown


def test_a_trial_whose_samples_are_missing_is_left_out_and_said(bench):
    def lost(time, columns):
        columns["velocity"][time < 25.0] = np.nan  # the first of five trials, ten holds of 2.5 s

    paths = [*runs(bench, conditions=("unloaded", "design")), *runs(bench, conditions=("loaded",), edit=lost)]
    result = {comparison.name: comparison for comparison in compare_all(paths)[1]}["coulomb_friction"]
    assert [group.count for group in result.groups] == [5, 5, 4]
    assert any("1 of 5 trials gave nothing (1)" in note for note in result.notes)


def test_what_the_analysis_is_told_is_in_the_values(bench):
    names = [path.name for path in runs(bench)]
    means = []
    for told in ([], ["--torque-constant", "0.98"], ["--set", "torque_constant=0.98"]):
        body = json.loads(leactl("stats", *names, "--json", *told).stdout)
        [friction] = [result for result in body["results"] if result["name"] == "coulomb_friction"]
        means.append([row["mean"] for row in friction["conditions"]])
    assert means[1] == pytest.approx([2.0 * mean for mean in means[0]])
    assert means[2] == means[1]
    wrong = leactl("stats", *names, "--set", "phase_resistance=0.28")
    assert wrong.returncode == 2
    assert "friction has no option phase_resistance" in wrong.stderr


def test_by_run_takes_each_run_once(bench):
    paths = runs(bench) + runs(bench)
    result = {comparison.name: comparison for comparison in compare_all(paths, by_run=True)[1]}["coulomb_friction"]
    assert [group.count for group in result.groups] == [2, 2, 2]


class Numbered(Bench):
    """Writes run-outs with the number of their repeat, one each way in each."""

    def write(self, experiment, time, columns, steps, **how):
        numbered = [(*step, told | {"repeat": 1 + k // 4}) for k, (*step, told) in enumerate(steps)]
        return super().write(experiment, time, columns, numbered, **how)


def coasts(bench, actuators=("a1", "a2")):
    """Runs whose single repeats cannot be analysed: one run-out each way has no scatter."""
    numbered = Numbered(bench.directory, bench.rng)
    return [
        coasting(numbered, f=f + bench.rng.normal(0.0, 0.002), noise=0.01, condition=label, actuator=actuator)
        for label, f in FRICTION.items()
        for actuator in actuators
    ]


def test_one_value_a_run_is_taken_and_said_where_no_trial_can_be_analysed(bench):
    names = [path.name for path in coasts(bench)]
    body = json.loads(leactl("stats", *names, "--json").stdout)
    results = {result["name"]: result for result in body["results"]}
    assert [row["count"] for row in results["coulomb_friction"]["conditions"]] == [2, 2, 2]
    assert results["coulomb_friction"]["shown"]
    said = [note for note in results["coulomb_friction"]["notes"] if note.startswith("one value a run")]
    assert len(said) == 1
    assert "found 2 run-outs in 2 directions" in said[0]
    text = " ".join(leactl("stats", *names).stdout.split())
    assert "note: one value a run, its repeats together: no single trial could be analysed (" in text
    asked = json.loads(leactl("stats", *names, "--by-run", "--json").stdout)["results"]
    assert [item["anova"] for item in asked] == [result["anova"] for result in body["results"]]


def test_too_few_runs_to_take_each_once_say_what_is_needed(bench):
    with pytest.raises(NotIdentifiable, match="3 values of 3 conditions give no scatter") as caught:
        compare_all(coasts(bench, ("a1",)))
    assert all(
        "repeat one run or more under a condition, or measure a further actuator" in line
        for line in caught.value.faults
    )
    assert all("no single trial could be analysed" in line for line in caught.value.faults)


def test_a_result_that_single_trials_do_not_tell_is_compared_by_runs_and_the_others_by_trials(bench):
    repeats = np.repeat([1, 2], len(SPEEDS))
    paths = [
        driven(bench, scatter=0.01, noise=0.01, trials=2, repeats=repeats, condition=label)
        for label in ("design", "loaded")
        for _ in range(2)
    ]
    results = {comparison.name: comparison for comparison in compare_all(paths)[1]}
    assert [group.count for group in results["highest_torque"].groups] == [2, 2]
    assert any(note.startswith("one value a run") for note in results["highest_torque"].notes)
    assert [group.count for group in results["corner_speed"].groups] == [4, 4]
    assert not any(note.startswith("one value a run") for note in results["corner_speed"].notes)
    assert [comparison.name for comparison in compare_all(paths, ["highest_torque"])[1]] == ["highest_torque"]


def test_answers_of_analyze_are_repeats(bench, tmp_path):
    paths = []
    for number in range(3):
        path = tmp_path / f"answer{number}.json"
        path.write_text(json.dumps(analyze_runs(runs(bench)).as_json()))
        paths.append(path)
    result = {comparison.name: comparison for comparison in compare_all(paths)[1]}["coulomb_friction"]
    with pytest.raises(InputError, match=r"answer0\.json: .* takes no torque_constant; give runs"):
        compare_all(paths, torque_constant=0.5)
    assert [group.count for group in result.groups] == [3, 3, 3]
    assert result.anova.test.shown


def test_the_same_runs_in_two_answers_count_once(bench, tmp_path):
    paths = runs(bench)
    for name in ("one.json", "two.json"):
        (tmp_path / name).write_text(json.dumps(analyze_runs(paths).as_json()))
    with pytest.raises(InputError, match=r"two\.json: it is of .*, as .*one\.json is; give each run once"):
        compare_all([tmp_path / "one.json", tmp_path / "two.json"])
    with pytest.raises(InputError, match=r"as .*one\.json is; give each run once"):
        compare_all([tmp_path / "one.json"] * 2)
    with pytest.raises(InputError, match=r"\.h5: .*one\.json is an answer of it; give each run once"):
        compare_all([tmp_path / "one.json", *paths])


@pytest.mark.parametrize("value", ["true", '"1"', "1e308", "1" * 400, "[" * 100_000])
def test_an_answer_with_a_value_that_is_none_is_refused(bench, tmp_path, value):
    text = json.dumps(analyze_runs(runs(bench)).as_json())
    path = tmp_path / "answer.json"
    path.write_text(re.sub(r'("value": )[^,]+', lambda found: found[1] + value, text, count=1))
    with pytest.raises(InputError, match=r"answer\.json: an answer of `leactl analyze --json` was expected"):
        compare_all([path])


def test_what_cannot_be_compared_is_refused_in_a_line(bench, tmp_path):
    with pytest.raises(NotIdentifiable, match="found one condition, 'design'") as alone:
        compare_all(runs(bench, conditions=("design",)))
    assert len(alone.value.faults) == 1
    with pytest.raises(InputError, match=r"different experiments: .* is 'friction', .* is 'torque-constant'"):
        compare_all([*runs(bench), bench.torque()])
    with pytest.raises(NotIdentifiable, match="3 values of 3 conditions give no scatter"):
        compare_all(runs(bench, trials=1))
    with pytest.raises(InputError, match="friction has no result 'damping' to compare; it has viscous_damping"):
        compare_all(runs(bench), ["damping"])
    with pytest.raises(InputError, match="nothing to compare"):
        compare_all([])
    path = runs(bench)[0]
    with pytest.raises(InputError, match="the same run as"):
        compare_all([path, path])
    with h5py.File(path, "r+") as file:
        unseal(file)
        file.attrs["condition"] = ""
    with pytest.raises(InputError, match="the run has no condition"):
        compare_all([path])


def torques(bench):
    conditions = (("design", 0.48), ("loaded", 0.5))
    return [bench.torque(kt=kt, condition=label, scatter=0.01) for label, kt in conditions for _ in range(3)]


@pytest.mark.long
def test_runs_of_several_experiments_are_compared_each_by_itself(bench, tmp_path):
    frictions = runs(bench)
    torques(bench)
    alone = json.loads(leactl("stats", *frictions, "--json").stdout)
    done = leactl("stats", tmp_path, "--json", "--result", "coulomb_friction", "--result", "torque_constant")
    assert (done.returncode, done.stderr) == (0, "")
    friction, torque = json.loads(done.stdout)["comparisons"]
    of = next(result for result in alone["results"] if result["name"] == "coulomb_friction")
    assert (friction["experiment"], friction["results"]) == ("friction", [of])
    assert (torque["experiment"], [result["name"] for result in torque["results"]]) == (
        "torque-constant",
        ["torque_constant"],
    )
    text = leactl("stats", tmp_path, COLUMNS="80").stdout
    assert "friction: " in text
    assert "torque-constant: " in text
    completed = leactl("stats", tmp_path, "--set", "torque_constant=0.3")  # friction alone takes it
    assert completed.returncode == 0
    for words in (["--set", "gain=1"], ["--result", "gain"]):
        refused = leactl("stats", tmp_path, *words)
        assert (refused.returncode, refused.stdout) == (2, "")
        assert "none of friction, torque-constant" in refused.stderr


def test_an_experiment_without_two_conditions_is_named_and_the_others_compared(bench, tmp_path):
    runs(bench, conditions=("design",))
    torques(bench)
    done = leactl("stats", tmp_path, "--json")
    assert done.returncode == 0
    assert [comparison["experiment"] for comparison in json.loads(done.stdout)["comparisons"]] == ["torque-constant"]
    assert done.stderr.startswith("leactl: not compared: friction: found one condition, 'design'")
    (tmp_path / "none.h5").write_text("no run at all")
    spoilt = leactl("stats", tmp_path, "--json")
    assert spoilt.returncode == 2
    [fault] = json.loads(spoilt.stdout)["faults"]
    assert fault == {"file": str(tmp_path / "none.h5"), "line": None, "column": None, "message": "not an HDF5 file"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "an answer of `leactl analyze --json` was expected"),
        ('{"experiment": "friction", "results": [{"name": 1}]}', "an answer of `leactl analyze --json` was expected"),
        (
            '{"experiment": "x", "runs": ["a.h5"], "results": [{"name": "f", "value": 1, "std": 1, "low": 0, "high": 2,'
            ' "units": "N"}]}',
            "its rows name no condition",
        ),
    ],
)
def test_a_file_that_is_no_answer_is_refused(tmp_path, text, message):
    path = tmp_path / "answer.json"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        compare_all([path])


def test_unusable_input_is_status_2(tmp_path):
    done = leactl("stats", tmp_path / "absent.h5", "--set", "torque_constant=0.49")
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1
    assert "absent.h5: cannot be read" in done.stderr


def test_a_full_disk_behind_stdout_is_said_as_such(bench, tmp_path):
    paths = [str(path) for path in runs(bench)]
    with open("/dev/full", "w") as full:
        done = subprocess.run([*COMMAND, "stats", *paths], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "leactl: stdout: cannot be written: No space left on device\n"


def test_limits_of_a_difference_keep_their_digits():
    names = np.repeat(["unloaded", "loaded"], 5)
    for seed in range(30):
        drawn = np.random.default_rng(seed).normal(np.where(names == "loaded", 0.3, 0.2), 0.01)
        alone, number = np.full(10, "LEA-1"), np.arange(10)
        sentence = compare(Values("coulomb_friction", "N*m", drawn, alone, names, number, ())).sentence
        difference, low, high = re.search(r"by ([\d.]+) \[([\d.]+), ([\d.]+)\] N", sentence).groups()
        assert [len(item.lstrip("0.")) for item in (difference, low, high)] == [3, 2, 2]
