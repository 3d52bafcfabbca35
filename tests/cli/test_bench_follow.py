"""`leactl bench read --follow` as a shell sees it: a line for each look until Ctrl-C, and every device safe then."""

import json
import signal
import subprocess
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.cli.answers import fits_the_page
from tests.cli.terminal import COMMAND, leactl, start
from tests.cli.test_bench_by_hand import ALL_SAFE, bench, here, safe  # noqa: F401 (fixtures)

FOLLOW = ("bench", "read", "--follow", "--every", "0.2")


@pytest.fixture
def followed():
    """Start commands that are killed where a test leaves them running."""
    processes = []

    def begin(*arguments):
        processes.append(start(*FOLLOW, *arguments))
        return processes[-1]

    yield begin
    for process in processes:
        process.kill()
        process.communicate()


def test_each_look_is_a_line_of_json_at_once_and_ctrl_c_ends_it_with_every_device_safe(followed):
    process = followed("--channel", "torque", "--channel", "vbus", "--json")
    rows = [json.loads(process.stdout.readline()) for _ in range(3)]
    process.send_signal(signal.SIGINT)
    out, errors = process.communicate()
    *later, end = [json.loads(line) for line in out.splitlines()]
    rows += later
    assert (process.returncode, end["event"], end["status"], safe(end)) == (4, "end", "stopped", ALL_SAFE)
    assert "leactl: stopped by SIGINT\n" in errors
    for row in rows:
        fits_the_page("Readings of a bench", row)
        assert set(row["values"]) == {"torque", "drive_test_supply/vbus", "drive_load_supply/vbus"}
    times = [row["time_s"] for row in rows]
    assert times == sorted(set(times))
    assert {row["values"]["drive_test_supply/vbus"] for row in rows} <= {29.6, None}
    with h5py.File(end["run"]) as run:
        recorded = len(run["streams/daq/time"])
        # a row that comes late does not put off the next one: there is one in each 0.2 s, not 0.2 s between any two
        intervals = np.floor((run["streams/daq/time"][:] - run["streams/daq/time"][0]) / 0.2 + 1e-6)
        assert min(np.diff(intervals)) >= 1
        assert recorded <= end["duration_s"] / 0.2 + 1


def test_rows_of_a_pipe_have_every_channel_and_stderr_has_the_file(followed):
    process = followed("--for", "1")
    out, errors = process.communicate()
    bench_name, heading, *rows = out.splitlines()
    assert process.returncode == 0
    assert bench_name == "# emulated"
    assert all(name in heading for name in ("test_iq A", "torque N*m", "ca V"))
    assert "_ref" not in heading
    assert rows
    path = next(Path("runs/by-hand").glob("*.h5"))
    assert f"{path}  complete, " in errors


def test_a_reader_that_goes_away_ends_the_run(followed):
    process = followed()
    process.stdout.readline()
    process.stdout.close()
    assert process.wait() == 141
    with h5py.File(next(Path("runs/by-hand").glob("*.h5"))) as run:
        assert run.attrs["status"] == "stopped"


def test_a_full_disk_behind_stdout_ends_the_run():
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([*COMMAND, *FOLLOW], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == "leactl: stdout: cannot be written: No space left on device"
    with h5py.File(next(Path("runs/by-hand").glob("*.h5"))) as run:
        assert run.attrs["status"] == "stopped"


def test_a_limit_trips_it_as_any_run(bench, followed):  # noqa: F811
    process = followed(bench(limits={"bus_voltage_low_V": 30}), "--json")
    end = json.loads(process.communicate()[0].splitlines()[-1])
    assert (process.returncode, end["status"], safe(end)) == (3, "tripped", ALL_SAFE)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--every", "2"), "--every: goes with --follow alone"),
        (("--channel", "torque"), "--channel: goes with --follow alone"),
        (("--follow", "--every", "0"), "invalid value for '--every'"),
        (("--follow", "--for", "-1"), "--for -1: a time above 0 s was expected"),
        (("--follow", "--channel", "torqe"), "no channel 'torqe'; did you mean 'torque'; bench 'emulated' has "),
    ],
)
def test_it_refuses_in_one_line_before_anything_is_touched(here, arguments, words):  # noqa: F811
    done = leactl("bench", "read", *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert words in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (here / "runs").exists()
