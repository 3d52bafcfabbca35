"""`leactl runs tail`: the last rows of a file, and those of a run that is being recorded by another process."""

import json
import math
import signal

import numpy as np
import pytest

from leactl.quantities import ChannelSpec
from leactl.report.run_tail import RowPrinter
from leactl.runfile.read.tail import RunTail
from leactl.runfile.write.description import RunInfo
from leactl.runfile.write.writer import RunWriter
from tests.cli.answers import fits_the_page

from .terminal import leactl, start

LOOP = [
    ChannelSpec("iq", "q_axis_current", "test", "drive"),
    ChannelSpec("torque", "torque", "test", "sensor"),
]
SLOW = [ChannelSpec("housing", "housing_temperature", "test", "camera")]


@pytest.fixture
def writer(tmp_path):
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
    made = RunWriter(tmp_path, info, {"camera": SLOW, "loop": LOOP})
    made.append("loop", np.arange(4) * 0.5, [[0.0, 1.0], [2.0, math.nan], [4.0, 5.0], [6.0, 7.0]])
    made.append("camera", np.array([0.25]), [[31.5]])
    made.flush()
    yield made
    made.close("complete")


@pytest.fixture
def path(writer, tmp_path):
    return next(tmp_path.glob("*.h5"))


def rows_of(text):
    return [json.loads(line) for line in text.splitlines()]


def test_the_last_rows_are_those_of_the_stream_with_most_and_what_is_missing_is_null(path):
    done = leactl("runs", "tail", path, "--rows", 3, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    rows = rows_of(done.stdout)
    assert [row["time_s"] for row in rows] == [0.5, 1.0, 1.5]
    assert rows[0] == {"stream": "loop", "time_s": 0.5, "values": {"iq": 2.0, "torque": None}}
    fits_the_page("Rows of a run", rows[0])
    text = leactl("runs", "tail", path, "--rows", 3).stdout.splitlines()
    assert text[0].split() == ["#", "loop:", "time", "s", "iq", "A", "torque", "N*m"]
    assert [line.split() for line in text[1:]] == [
        ["0.500000", "2", "nan"],
        ["1.000000", "4", "5"],
        ["1.500000", "6", "7"],
    ]


def test_chosen_channels_may_be_of_several_streams_and_rows_be_some_time_apart(path):
    done = leactl("runs", "tail", path, "housing_temperature", "torque", "--every", 0.9, "--json")
    assert [(row["stream"], row["time_s"], row["values"]) for row in rows_of(done.stdout)] == [
        ("camera", 0.25, {"housing": 31.5}),
        ("loop", 0.0, {"torque": 1.0}),
        ("loop", 1.0, {"torque": 5.0}),
    ]


def test_rows_are_followed_as_they_are_recorded_until_the_run_ends(writer, path):
    with start("runs", "tail", str(path), "--rows", "1", "--follow", "--json") as follower:
        first = json.loads(follower.stdout.readline())
        writer.append("loop", np.array([2.0, 2.5]), [[8.0, 9.0], [10.0, 11.0]])
        writer.flush()
        added = [json.loads(follower.stdout.readline()) for _ in range(2)]
        writer.append("loop", np.array([3.0]), [[12.0, 13.0]])
        writer.close("tripped", "too hot")
        rest, remarks = follower.communicate(timeout=20)
    assert first["time_s"] == 1.5
    assert [row["values"]["iq"] for row in added] == [8.0, 10.0]
    assert [row["time_s"] for row in rows_of(rest)] == [3.0]
    assert remarks == f"leactl: {path}: tripped\n"
    assert follower.returncode == 0


def test_ctrl_c_ends_it_and_the_run_goes_on(writer, path):
    with start("runs", "tail", str(path), "--follow") as follower:
        assert follower.stdout.readline().startswith("# loop: time s")
        follower.send_signal(signal.SIGINT)
        _, remarks = follower.communicate(timeout=20)
    assert (follower.returncode, remarks) == (4, "leactl: stopped\n")
    writer.append("loop", np.array([2.0]), [[8.0, 9.0]])


def test_a_narrow_terminal_shows_what_has_room_and_says_what_has_not(path):
    (rows,) = RunTail(path, [], 2).read()
    printer = RowPrinter(32)
    assert [len(line) <= 32 for line in printer.lines(rows)] == [True, True, True]
    assert printer.left_out == ("torque",)
    assert all(len(line) <= 40 for line in RowPrinter(20).lines(rows)), "the time and one channel at least"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["torqe"], "no channel 'torqe'; did you mean 'torque'"),
        (["--every", "nan"], "invalid value for '--every'"),
        (["--rows", "-1"], "invalid value for '--rows'"),
    ],
)
def test_what_cannot_be_shown_is_one_line_and_status_2(path, words, message):
    done = leactl("runs", "tail", path, *words)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert message in done.stderr


def test_no_run_is_one_line_and_status_2(tmp_path):
    (tmp_path / "none.h5").write_bytes(b"nothing of HDF5")
    for name in ("none.h5", "nowhere.h5"):
        done = leactl("runs", "tail", tmp_path / name, "--follow")
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
