"""`leactl runs tail`: the last rows of a file, and those of a run that is being recorded by another process."""

import json
import math
import os
import shutil
import signal

import h5py
import numpy as np
import pytest

from leactl.errors import InputError
from leactl.quantities import ChannelSpec
from leactl.report.run_tail import RowFormatter
from leactl.runfile.read.reader import Run
from leactl.runfile.read.tail import RunTail, StreamRows
from leactl.runfile.write.run_info import RunInfo
from leactl.runfile.write.writer import RunWriter
from tests.cli.answers import fits_the_page
from tests.runner.conftest import SPIN

from .terminal import leactl, live_run, start

HOURS_AGO = 1_000_000_000  # s since 1970
LOOP = [
    ChannelSpec("iq", "q_axis_current", "test", "drive"),
    ChannelSpec("torque", "torque", "test", "sensor"),
]
SLOW = [ChannelSpec("housing", "housing_temperature", "test", "camera")]

INFO = RunInfo(
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


@pytest.fixture
def writer(tmp_path):
    made = RunWriter(tmp_path, INFO, {"camera": SLOW, "loop": LOOP})
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


def test_the_last_rows_are_those_of_the_widest_stream_and_what_is_missing_is_null(path):
    done = leactl("runs", "tail", path, "--rows", 3, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    rows = rows_of(done.stdout)
    assert [row["time_s"] for row in rows] == [0.5, 1.0, 1.5]
    assert rows[0] == {"stream": "loop", "time_s": 0.5, "values": {"iq": 2.0, "torque": None}}
    fits_the_page("Rows of a run", rows[0])
    done = leactl("runs", "tail", path, "--rows", 3)
    assert [line.split() for line in done.stdout.splitlines()] == [
        ["#", "loop"],
        ["#", "time", "s", "iq", "A", "torque", "N*m"],
        ["0.500000", "2", "nan"],
        ["1.000000", "4", "5"],
        ["1.500000", "6", "7"],
    ]
    assert done.stderr == "leactl: other streams: camera; name channels to see theirs (runs show has them)\n"


def test_the_stream_is_the_same_before_and_after_the_first_rows(writer, path):
    writer.append("camera", np.arange(1.0, 40.0), np.full((39, 1), 31.5))
    writer.flush()
    (rows,) = RunTail(path, [], 1).read()
    assert rows.stream == "loop", "the camera has more rows by now"


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
        rest, remarks = follower.stdout.read(), follower.stderr.read()
    assert first["time_s"] == 1.5
    assert [row["values"]["iq"] for row in added] == [8.0, 10.0]
    assert [row["time_s"] for row in rows_of(rest)] == [3.0]
    assert remarks == f"leactl: {path}: tripped: too hot\n"
    assert follower.returncode == 0


def test_a_stream_without_a_row_to_show_has_no_heading(writer, path):
    with start("runs", "tail", str(path), "iq", "housing", "--follow", "--every", "10") as follower:
        lines = [follower.stdout.readline() for _ in range(6)]
        writer.append("loop", np.array([2.0]), [[8.0, 9.0]])
        writer.append("camera", np.array([2.0]), [[32.5]])
        writer.close("complete")
        rest = follower.stdout.read()
    assert [line.split()[-1] for line in lines] == ["camera", "degC", "31.5", "loop", "A", "0"]
    assert rest == "", "both rows are less than 10 s after those"


def closed_run(folder, stream, channels, rows):
    folder.mkdir(exist_ok=True)
    run = RunWriter(folder, INFO, {stream: channels})
    run.append(stream, np.arange(float(rows)), np.zeros((rows, len(channels))))
    run.close("complete")
    return run.path


@pytest.mark.parametrize(
    ("stream", "channels", "rows"), [("camera", SLOW, 3), ("loop", LOOP[1:], 3), ("loop", LOOP, 2)]
)
def test_a_file_that_another_run_has_replaced_is_refused(tmp_path, stream, channels, rows):
    path = closed_run(tmp_path, "loop", LOOP, 3)
    tail = RunTail(path, ["iq"], 2)
    tail.read()
    closed_run(tmp_path / "later", stream, channels, rows).replace(path)
    with pytest.raises(InputError, match="has become the file of another run; begin anew"):
        tail.read()


def test_a_run_of_another_process_is_followed_to_its_end_without_a_row_lost(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    (tmp_path / "spin.yaml").write_text(SPIN)
    with start("run", "spin.yaml", "--set", "hold_s=600", "--realtime") as run:
        path = live_run(tmp_path, run)
        with start("runs", "tail", str(path), "test_iq", "torque", "--rows", "1", "--follow", "--json") as follower:
            lines = [follower.stdout.readline() for _ in range(3)]
            stopped = leactl("bench", "stop")
            rest, remarks = follower.stdout.read(), follower.stderr.read()  # communicate drops what is buffered
        run.communicate(timeout=60)
    assert (stopped.returncode, follower.returncode, run.returncode) == (0, 0, 4)
    assert remarks == f"leactl: {path}: stopped: stopped by `leactl bench stop`\n"
    shown = [row for row in rows_of("".join(lines) + rest) if row["stream"] == "loop"]
    with Run.open(path) as recorded:
        rows = len(recorded.time("loop"))
        first = recorded.time("loop").tolist().index(shown[0]["time_s"])
        times = recorded.time("loop")[first:]
        values = recorded.values("loop", "test_iq", first, rows)
    assert [row["time_s"] for row in shown] == times.tolist()
    assert [row["values"]["test_iq"] for row in shown] == [None if math.isnan(x) else x for x in values.tolist()]


def test_the_recording_of_a_killed_run_is_shown_with_a_remark(path, tmp_path):
    killed = tmp_path / "killed.h5"
    shutil.copy(path, killed)
    os.utime(killed, (HOURS_AGO, HOURS_AGO))
    done = leactl("runs", "tail", killed, "torque", "--rows", 1)
    assert (done.returncode, done.stdout.splitlines()[-1].split()) == (0, ["1.500000", "7"])
    assert done.stderr.startswith(f"leactl: {killed}: not written for ")
    assert done.stderr.endswith(f"; if its run was killed, no row will come: leactl runs recover {killed}\n")


def test_a_reader_that_goes_away_ends_it_as_it_ends_other_commands(writer, path):
    with start("runs", "tail", str(path), "--rows", "1", "--follow", "--json") as follower:
        follower.stdout.readline()
        follower.stdout.close()
        writer.append("loop", np.array([2.0]), [[8.0, 9.0]])
        writer.flush()
        assert (follower.wait(timeout=20), follower.stderr.read()) == (141, "")


def test_ctrl_c_ends_it_and_the_run_goes_on(writer, path):
    with start("runs", "tail", str(path), "--follow") as follower:
        assert follower.stdout.readline() == "# loop\n"
        follower.send_signal(signal.SIGINT)
        _, remarks = follower.communicate(timeout=20)
    assert (follower.returncode, remarks.splitlines()[1:]) == (4, ["leactl: stopped"])
    writer.append("loop", np.array([2.0]), [[8.0, 9.0]])


def test_a_narrow_terminal_shows_what_has_room_and_says_what_has_not(path):
    (rows,) = RunTail(path, [], 2).read()
    formatter = RowFormatter(30)
    assert [len(line) <= 30 for line in formatter.lines(rows)] == [True] * 4
    assert formatter.omitted_channels == {"loop": ("torque",)}


@pytest.mark.parametrize("columns", [20, 40, 80])
def test_no_line_is_wider_than_the_terminal_and_no_two_columns_touch(columns):
    names = ("load_theta_ref", *(f"iq{index}" for index in range(9)))
    widest = -1.234567e-05
    rows = StreamRows("thermometers_of_the_housing", names, ("A",) * 10, np.array([3599.125]), np.full((1, 10), widest))
    formatter = RowFormatter(columns)
    _, heading, line = shown = list(formatter.lines(rows))
    assert all(len(text) <= columns for text in shown)
    cells = line.split()
    assert len(cells) == 1 + len(names) - len(formatter.omitted_channels[rows.stream])
    assert [float(cell) for cell in cells] == pytest.approx([3599.125, *[widest] * (len(cells) - 1)], rel=1e-3)
    assert heading.split()[3].startswith("load_theta")


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


def test_no_run_is_one_line_and_status_2(path, tmp_path):
    (tmp_path / "none.h5").write_bytes(b"nothing of HDF5")
    with h5py.File(tmp_path / "later.h5", "w") as later:
        later.attrs.update({"format": "leactl-run", "format_version": 2})
    for name, message in {
        "none.h5": "not an HDF5 file",
        "nowhere.h5": "cannot be read: No such file or directory",
        "later.h5": "format_version is 2; this program reads 1",
    }.items():
        done = leactl("runs", "tail", tmp_path / name, "--follow")
        assert (done.returncode, done.stdout, done.stderr) == (2, "", f"leactl: {tmp_path / name}: {message}\n")
