"""`--json` means one thing in every command: JSON alone on stdout, faults included."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.main import get_command

from leactl.cli.main import app
from leactl.errors import InputError
from tests.cli.terminal import leactl

WITHOUT = {"schema": "prints JSON in any case", "bench serve": "runs until it is stopped and has no answer"}
TO_A_FILE_TOO = "gap diagnose"  # alone it prints, before a name that is no run it writes that file
BAD = "name: bad\nsetup: free\nrate_Hz: 10\nsteps: [{holt: {duration_s: 1}}]\n"


def commands(group=None, path=()):
    group = group or get_command(app)
    for name in group.commands:
        command = group.get_command(None, name)
        if hasattr(command, "commands"):
            yield from commands(command, (*path, name))
        else:
            yield " ".join((*path, name)), command


def test_every_command_with_an_answer_takes_json_as_a_flag():
    lacking, kinds = set(), {}
    for name, command in commands():
        results = [option for option in command.params if "--json" in option.opts]
        lacking |= set() if results else {name}
        if results:
            kinds[name] = results[0].is_flag
        assert all(option.help for option in results), name
    assert lacking == WITHOUT.keys()
    assert [name for name, flag in kinds.items() if not flag] == [TO_A_FILE_TOO]


@pytest.mark.parametrize(
    "words",
    [
        ["bench", "show", "emulated"],
        ["bench", "model", "emulated"],
        ["campaign", "show", "paper"],
        ["protocol", "show", "friction"],
    ],
)
def test_what_shows_a_file_carries_its_text(words):
    done = leactl(*words, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["text"] == leactl(*words).stdout


@pytest.mark.parametrize(
    ("words", "faults"),
    [
        (["protocol", "check", "bad.yaml"], [("bad.yaml", 4, 16)]),
        (["run", "bad.yaml"], [("bad.yaml", 4, 16)]),
        (["runs", "show", "none.h5"], [("none.h5", None, None)]),
        (["runs", "annotate", "none.h5", "a"], [("none.h5", None, None)]),
        (["analyze", "none.h5", "gone.h5"], [("none.h5", None, None), ("gone.h5", None, None)]),
        (["stats", "none.h5"], [("none.h5", None, None)]),
        (["thermal", "fit", "none.h5"], [("none.h5", None, None)]),
        (["report", "none.h5"], [("none.h5", None, None)]),
        (["gap", "diagnose", "none.h5", "--model", "bad.yaml"], [("bad.yaml", 4, 1), ("none.h5", None, None)]),
        (["bench", "check", "nothing"], [(None, None, None)]),
        (["campaign", "status", "nothing"], [(None, None, None)]),
        (["motor", "show", "--nothing"], [(None, None, None)]),
    ],
)
def test_faults_are_json_where_json_was_asked_for(tmp_path, monkeypatch, words, faults):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.yaml").write_text(BAD)
    (tmp_path / "none.h5").write_text("no run at all")
    done = leactl(*words, "--json")
    assert done.returncode == 2
    told = json.loads(done.stdout)["faults"]
    assert all(item.keys() == {"file", "line", "column", "message"} and item["message"] for item in told)
    if words[0] == "gap":  # whatever else a protocol lacks as a model
        assert {item["file"] for item in told} == {"bad.yaml", "none.h5"}
    else:
        assert [(item["file"], item["line"], item["column"]) for item in told] == faults
    assert len([line for line in done.stderr.splitlines() if line.startswith("leactl: ")]) == len(told)


def test_without_json_faults_leave_stdout_empty():
    done = leactl("bench", "check", "nothing")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)


def test_an_answer_to_a_file_leaves_stdout_to_people(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = leactl("gap", "diagnose", "none.h5", "--model", "none.yaml", "--json", "answer.json")
    assert (done.returncode, done.stdout) == (2, "")


def test_a_table_s_line_is_a_fault_s_line(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t\n")
    [fault] = InputError(f"{path}: line 814, column 'q': not a number").as_json()
    assert (fault["file"], fault["line"]) == (str(path), 814)


@given(st.text())
def test_any_line_is_a_fault_and_none_of_its_words_is_lost(line):
    [fault] = InputError(line).as_json()
    assert json.loads(json.dumps(fault)) == fault
    assert fault["message"] in line
    assert fault["file"] is not None or fault["message"] == line
