"""`leactl analyze` as a terminal, a pipe, a log and a script see it."""

import json
import re

import pytest

from tests.analysis.synthetic import Bench
from tests.cli.terminal import leactl


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return Bench(tmp_path)


def rows(text):
    """First cell and the rest of each line of the table."""
    return {line.split()[0]: " ".join(line.split()[1:]) for line in text.splitlines() if re.match(r" *\w+  +\S", line)}


@pytest.mark.parametrize("environment", [{"COLUMNS": "80"}, {"PATH": "/usr/bin"}], ids=["80 columns", "pipe"])
def test_table_plot_and_notes_fit_80_columns(bench, environment):
    path = bench.torque(scatter=0.01).name
    done = leactl("analyze", path, **environment, PYTHONIOENCODING="utf-8")
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert max(map(len, lines)) <= 80
    assert "\x1b" not in done.stdout
    assert lines[0] == f"torque-constant, 1 run: {path}"
    assert "a1, design" in lines
    assert re.fullmatch(r"0\.4[89]\d+ ± 0\.0\d+ 0\.4\d+ \.\. 0\.4\d+ N\*m/A", rows(done.stdout)["torque_constant"])
    assert rows(done.stdout)["paper"] in ("0.49 ± 0.06 (3 std)", "> 0.99")
    assert any(line.startswith("torque [N*m] over q-axis current [A]:") for line in lines)
    assert any(line.startswith("note: an error in the calibration of torque or current") for line in lines)


@pytest.mark.parametrize("columns", [30, 100, 140])
def test_the_plot_takes_the_width_there_is_up_to_100(bench, columns):
    done = leactl("analyze", bench.friction().name, COLUMNS=str(columns), PYTHONIOENCODING="utf-8")
    plot = [line for line in done.stdout.splitlines() if line.lstrip().startswith("└")]
    assert [len(line) for line in plot] == [min(max(columns, 40), 100)]


@pytest.mark.parametrize("environment", [{"LC_ALL": "C"}, {"PYTHONIOENCODING": "ascii"}], ids=str)
def test_a_terminal_that_knows_ascii_alone_gets_ascii(bench, environment):
    done = leactl("analyze", bench.friction().name, **environment)
    assert done.returncode == 0
    assert done.stdout.isascii()
    assert "+-" in done.stdout
    assert "?" not in done.stdout
    assert "o" in done.stdout.split("over speed")[1]


def test_json_is_pure(bench):
    paths = [bench.friction().name, bench.friction(condition="loaded", signs=(1,)).name]
    done = leactl("analyze", *paths, "--json", COLUMNS="20")
    assert (done.returncode, done.stderr) == (0, "")
    answer = json.loads(done.stdout, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert list(answer) == ["format", "format_version", "experiment", "runs", "results", "notes"]
    assert answer["runs"] == paths
    results = {(row["name"], row["condition"]): row for row in answer["results"]}
    assert results["viscous_damping", "loaded"]["value"] == pytest.approx(0.0238)
    assert results["r_squared", "design"]["low"] is None


def test_repeats_and_conditions_have_tables_of_their_own(bench):
    paths = [bench.friction(condition=name).name for name in ("design", "loaded", "design")]
    done = leactl("analyze", *paths, COLUMNS="80", PYTHONIOENCODING="utf-8")
    lines = done.stdout.splitlines()
    assert [line for line in lines if line.startswith("a1, ")] == ["a1, design", "a1, loaded"]
    assert sum(line.startswith("viscous_damping") for line in lines) == 2
    assert "  paper           0.2080 ± 0.0384 (3 std)" in lines
    assert "  paper           0.3037 ± 0.0735 (3 std)" in lines


def test_a_torque_constant_of_ones_own(bench):
    path = bench.friction().name
    options = ["--torque-constant", "0.98", "--torque-constant-std", "0.01", "--json"]
    answer = json.loads(leactl("analyze", path, *options).stdout)
    friction = next(row for row in answer["results"] if row["name"] == "coulomb_friction")
    assert friction["value"] == pytest.approx(0.416)
    assert friction["std"] == pytest.approx(0.416 / 98)


@pytest.mark.parametrize("as_json", [[], ["--json"]], ids=["text", "json"])
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["absent.h5"], "absent.h5: cannot be read: No such file or directory"),
        (["absent.h5", "--as", "friction", "--torque-constant", "0.49"], "absent.h5: cannot be read: No such file"),
        (["text.h5"], "text.h5: not an HDF5 file"),
        (["torque.h5", "./torque.h5"], "torque.h5: the same run as torque.h5; give each run once"),
        (
            ["torque.h5", "--torque-constant", "1"],
            "torque-constant has no option torque_constant; it has torque_gain_std",
        ),
        (["friction.h5", "--torque-constant", "0"], "torque constant 0: a positive number in N*m/A was expected"),
        (
            ["friction.h5", "--torque-constant", "0.5", "--set", "torque_constant=0.6"],
            "--set torque_constant: given twice",
        ),
        (["still.h5"], "still.h5: friction: found 0 levels of current at which the rotor turned steadily"),
        (["one.h5"], "one.h5: torque constant: found one level (4.9 A in 6 holds)"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_unusable_input_is_status_2_in_one_line(bench, tmp_path, arguments, words, as_json):
    (tmp_path / "text.h5").write_text("speed,torque\n")
    bench.torque().rename(tmp_path / "torque.h5")
    bench.friction().rename(tmp_path / "friction.h5")
    bench.friction(f=9.0).rename(tmp_path / "still.h5")
    bench.torque(levels=(4.9,)).rename(tmp_path / "one.h5")
    done = leactl("analyze", *arguments, *as_json)
    assert done.returncode == 2
    assert len(json.loads(done.stdout)["faults"]) == 1 if as_json else done.stdout == ""
    assert done.stderr.startswith(f"leactl: {words}")
    assert len(done.stderr.splitlines()) == 1


def test_without_a_run_the_usage_is_shown():
    done = leactl("analyze", COLUMNS="80")
    assert (done.returncode, done.stdout) == (2, "")
    assert "RUN" in done.stderr


@pytest.mark.parametrize("as_folder", [True, False])
def test_several_experiments_are_analysed_each_by_itself(bench, tmp_path, as_folder):
    paths = [bench.torque(), bench.friction(), bench.torque()]
    given = [tmp_path] if as_folder else paths
    done = leactl("analyze", *given, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    answer = json.loads(done.stdout)
    counts = {analysis["experiment"]: len(analysis["runs"]) for analysis in answer["analyses"]}
    assert (counts, answer["faults"]) == ({"torque-constant": 2, "friction": 1}, [])
    assert {(item["format"], item["format_version"]) for item in (answer, *answer["analyses"])} == {
        ("leactl-analysis", 1)
    }
    alone = json.loads(leactl("analyze", paths[1], "--json").stdout)
    assert (
        next(analysis for analysis in answer["analyses"] if analysis["experiment"] == "friction")["results"]
        == alone["results"]
    )
    text = leactl("analyze", *given).stdout
    assert text.count("torque-constant, 2 runs:") == text.count("friction, 1 run:") == 1


def test_an_option_goes_to_the_experiments_that_take_it(bench, tmp_path):
    bench.torque()
    bench.friction()
    document = json.loads(leactl("analyze", tmp_path, "--torque-constant", "0.98", "--json").stdout)
    plain = json.loads(leactl("analyze", tmp_path, "--json").stdout)
    values = [
        {item["name"]: item["value"] for analysis in answer["analyses"] for item in analysis["results"]}
        for answer in (document, plain)
    ]
    assert values[0]["coulomb_friction"] == pytest.approx(2 * values[1]["coulomb_friction"], rel=0.01)
    assert values[0]["torque_constant"] == values[1]["torque_constant"]
    refused = leactl("analyze", tmp_path, "--set", "gaim=2")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "--set gaim: none of friction, torque-constant takes it" in refused.stderr


def test_what_cannot_be_analysed_is_told_after_what_can(bench, tmp_path):
    bench.torque()
    (tmp_path / "damaged.h5").write_text("no run")
    done = leactl("analyze", tmp_path)
    assert done.returncode == 2
    assert done.stdout.startswith("torque-constant, 1 run:")
    assert done.stderr == f"leactl: {tmp_path / 'damaged.h5'}: not an HDF5 file\n"
