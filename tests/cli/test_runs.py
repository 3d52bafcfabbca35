"""`leactl runs` at the command line, on a run that was written to the end and on one that was not."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from leactl.quantities import ChannelSpec
from leactl.runfile.write.run_info import RunInfo
from leactl.runfile.write.writer import RunWriter

from .terminal import leactl

CHANNELS = [
    ChannelSpec("iq", "q_axis_current", "test", "drive"),
    ChannelSpec("torque", "torque", "test", "sensor"),
]


@pytest.fixture
def run(tmp_path):
    info = RunInfo(
        run_id="20261121T100000Z-torque-constant-0001",
        protocol="torque-constant",
        bench="emulated",
        actuator="lea-1",
        condition="design",
        operator="",
        simulated=True,
        mechanical="coupled",
        software="leactl 0.1.0",
        created="2026-11-21T10:00:00Z",
    )
    writer = RunWriter(tmp_path, info, {"loop": CHANNELS})
    writer.append("loop", np.arange(4) * 0.02, np.arange(8.0).reshape(4, 2))
    writer.step("level", 0.0, 0.06, 0.02, {"current_A": 4.9})
    writer.close("complete")
    return tmp_path / f"{info.run_id}.h5"


def test_list_and_show_answer_in_text_and_json(run):
    listed = leactl("runs", "list", run.parent)
    assert "torque-constant-0001" in listed.stdout
    assert json.loads(leactl("runs", "list", run.parent, "--json").stdout)["runs"][0]["status"] == "complete"
    shown = json.loads(leactl("runs", "show", run, "--json").stdout)
    assert shown["streams"]["loop"]["rows"] == 4
    assert "q_axis_current" in leactl("runs", "show", run).stdout


def test_verify_is_silent_about_nothing(run):
    assert leactl("runs", "verify", run).returncode == 0
    whole = run.read_bytes()
    run.write_bytes(whole[: len(whole) // 2])
    cut = leactl("runs", "verify", run)
    assert cut.returncode == 2
    assert cut.stderr.startswith("leactl: ")
    assert "Traceback" not in cut.stderr


def test_a_note_is_added_and_the_data_still_verify(run):
    assert leactl("runs", "annotate", run, "bearing squeaked", "--author", "jg").returncode == 0
    assert "bearing squeaked" in leactl("runs", "show", run).stdout
    assert leactl("runs", "verify", run).returncode == 0


def test_export_never_overwrites(run, tmp_path):
    out = tmp_path / "csv"
    first = leactl("runs", "export", run, "--out", out, "--json")
    (path,) = json.loads(first.stdout)["files"]
    assert Path(path).read_text().splitlines(keepends=True)[0] == "time [s],iq [A],torque [N*m]\n"
    assert leactl("runs", "export", run, "--out", out).returncode == 2


@pytest.mark.parametrize("command", ["show", "verify", "recover"])
def test_a_missing_file_is_one_line_and_status_2(tmp_path, command):
    answer = leactl("runs", command, tmp_path / "nothing.h5")
    assert answer.returncode == 2
    assert len(answer.stderr.splitlines()) == 1


def test_plot_draws_named_channels_in_the_terminal(run):
    done = leactl("runs", "plot", run, "torque", "iq", **{**os.environ, "COLUMNS": "80", "LINES": "24"})
    assert (done.returncode, done.stderr) == (0, "")
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert "loop/torque: torque of test [N*m]" in done.stdout
    assert "level" in done.stdout


def test_plot_writes_a_page_and_json(run, tmp_path):
    done = leactl("runs", "plot", run, "--html", tmp_path / "run.html", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert [channel["values"] for channel in answer["channels"]] == [[0.0, 2.0, 4.0, 6.0], [1.0, 3.0, 5.0, 7.0]]
    assert (tmp_path / "run.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["torqe"], "no channel 'torqe'; did you mean 'torque'"),
        (["--step", "lift"], "no step 'lift'; the run has level"),
        (["--from", "3", "--to", "1"], "--to has to be after --from"),
        (["--html", "nowhere/run.html"], "no folder nowhere"),
    ],
)
def test_plot_refuses_in_one_line(run, words, message):
    done = leactl("runs", "plot", run, *words)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert message in done.stderr
