"""A run told line by line: whole, in order, and of no consequence for the run whoever reads it."""

import json
import math
import os
import subprocess
import sys
import time

import pytest
import yaml

from leactl.errors import InputError
from leactl.quantities import ChannelSpec
from leactl.runner.event_lines import MOST_QUEUED, EventLines
from leactl.runner.progress import Progress
from tests.cli.terminal import leactl

SHORT = ("run", "current-step", "--bench", "emulated", "--set", "trials=1")


def read(path):
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_every_step_event_and_the_end_is_a_line_and_the_end_is_the_last(tmp_path):
    done = leactl(*SHORT, "--out", tmp_path, "--events", tmp_path / "lines", "--json", LEACTL_STATE=str(tmp_path))
    assert done.returncode == 0, done.stderr
    answer, lines = json.loads(done.stdout), read(tmp_path / "lines")
    assert lines[0] == {"event": "begin", "run": answer["run"], "protocol": "current-step", "bench": "emulated"}
    assert lines[-1] == {"event": "end", **answer}
    steps = [line for line in lines if line["event"] == "step"]
    assert [line["stop_s"] for line in steps] == sorted(line["stop_s"] for line in steps)
    assert len(steps) >= 3
    assert any("safe state" in line["message"] for line in lines if line["event"] == "event")


def test_a_warning_is_a_line_when_it_comes(tmp_path, monkeypatch):
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path))
    bench = leactl("bench", "show", "emulated").stdout.replace("name: emulated", "name: mine", 1)
    assert "warn_Nm: 15" in bench
    (tmp_path / "mine.yaml").write_text(bench.replace("warn_Nm: 15", "warn_Nm: 1"))
    words = (*SHORT[:2], "--bench", tmp_path / "mine.yaml", *SHORT[4:], "--out", tmp_path)
    done = leactl(*words, "--events", tmp_path / "lines")
    assert done.returncode == 0, done.stderr
    lines = read(tmp_path / "lines")
    [warning] = [line for line in lines if line.get("level") == "warning" and "torque" in line["message"]]
    assert warning.keys() == {"event", "time_s", "level", "source", "message"}
    assert warning["event"] == "event"
    step = next(line for line in lines if line["event"] == "step" and line["stop_s"] > warning["time_s"])
    assert lines.index(warning) < lines.index(step)  # and not at the end


def test_the_means_of_all_channels_are_a_line_each_second(tmp_path):
    loop = [ChannelSpec("iq", "q_axis_current", "test", "drive"), ChannelSpec("omega", "velocity", "test", "drive")]
    supply = [ChannelSpec("vbus", "bus_voltage", "test", "drive")]
    progress = Progress("spin", 9.0, {"loop": loop, "supply": supply}, [1.25, math.nan])
    progress.device_values = {"supply": (29.6,)}
    with EventLines(tmp_path / "lines") as lines:
        lines.begin(progress, run="run.h5")
        deadline = time.monotonic() + 30.0
        while len(read(tmp_path / "lines")) < 2:
            assert time.monotonic() < deadline
            time.sleep(0.05)  # a look at the file costs as much as a line
        lines.end(status="complete")
    begin, *means, end = read(tmp_path / "lines")
    assert begin == {"event": "begin", "run": "run.h5"}
    for line in means:
        assert (line["event"], line["means"]) == ("values", {"iq": 1.25, "supply/vbus": 29.6})
    assert 0.9 <= means[0]["wall_s"] < 30.0
    assert end == {"event": "end", "status": "complete"}


def test_a_mean_is_of_a_second_s_values_and_none_comes_after_the_end(tmp_path):
    lines = EventLines(tmp_path / "lines")
    progress = Progress("spin", 9.0, {"loop": [ChannelSpec("iq", "q_axis_current", "test", "drive")]}, [1.0])
    lines.begin(progress)
    samples = {}
    for value in (1.0, 2.0, math.nan, 6.0):
        progress.values = [value]
        lines._sample(samples)
    lines._queue_means(samples)
    lines.end(status="complete")
    lines._queue_means(samples)
    with lines:
        pass
    told = read(tmp_path / "lines")
    assert [line["event"] for line in told] == ["begin", "values", "end"]
    assert told[1]["means"] == {"iq": 3.0}


class StallingClock:
    """A clock whose first wait takes ten seconds; the run ends after 12.5 s."""

    def __init__(self):
        self.now = 0.0

    def monotonic(self):
        return self.now

    def wait(self, seconds):
        self.now += seconds if self.now else 10.0
        return self.now > 12.5

    def set(self):
        pass


def test_after_a_stall_the_means_are_again_a_line_each_second(tmp_path, monkeypatch):
    clock = StallingClock()
    monkeypatch.setattr("leactl.runner.event_lines.time", clock)
    lines = EventLines(tmp_path / "lines")
    lines._ending = clock
    lines.begin(Progress("spin", 9.0, {"loop": [ChannelSpec("iq", "q_axis_current", "test", "drive")]}, [1.0]))
    with lines:
        pass
    assert lines.fault == ""
    means = [line["wall_s"] for line in read(tmp_path / "lines") if line["event"] == "values"]
    assert means == pytest.approx([10.0, 11.0, 12.0], abs=0.11)  # a pass of the loop takes 0.05 s


def test_a_trip_is_a_line_with_its_cause(tmp_path):
    bench = leactl("bench", "show", "emulated").stdout
    bench += "  faults: [{fault: scaled_sensor, at_s: 2, device: drive_test, quantity: q_axis_current, gain: 1000}]\n"
    bench = bench.replace("name: emulated", "name: mine", 1)
    (tmp_path / "mine.yaml").write_text(bench)
    words = (
        "run",
        "current-step",
        "--bench",
        tmp_path / "mine.yaml",
        "--out",
        tmp_path,
        "--events",
        tmp_path / "lines",
    )
    done = leactl(*words, LEACTL_STATE=str(tmp_path))
    assert done.returncode == 3, done.stderr
    end = read(tmp_path / "lines")[-1]
    assert (end["event"], end["status"]) == ("end", "tripped")
    assert "q_axis_current" in end["reason"]


def test_lines_on_stdout_are_alone_there(tmp_path):
    done = leactl(*SHORT, "--out", tmp_path, "--events", "-", LEACTL_STATE=str(tmp_path))
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert (lines[0]["event"], lines[-1]["event"]) == ("begin", "end")
    refused = leactl(*SHORT, "--out", tmp_path, "--events", "-", "--json", LEACTL_STATE=str(tmp_path))
    assert refused.returncode == 2
    assert "stdout is for --json alone" in refused.stderr


def test_a_reader_that_hangs_or_leaves_costs_the_run_nothing(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with subprocess.Popen(
        [sys.executable, "-c", f"open({str(pipe)!r}).readline(); input()"], stdin=subprocess.PIPE
    ) as r:
        try:
            deadline = time.monotonic() + 20.0
            while True:  # until the reader has opened it
                try:
                    held = os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
                    break
                except OSError:
                    assert time.monotonic() < deadline
            done = leactl(*SHORT, "--out", tmp_path, "--events", pipe, LEACTL_STATE=str(tmp_path))
            assert done.returncode == 0, done.stderr
            assert "complete" in done.stdout
            os.close(held)
            r.communicate(b"\n", timeout=20)
        finally:
            r.kill()  # or a failure would wait for it for ever


def test_what_has_no_room_is_counted_and_told(tmp_path):
    lines = EventLines(tmp_path / "lines")
    for number in range(MOST_QUEUED + 7):
        lines.put("event", number=number)
    with lines:
        lines.end(status="complete")
    told = read(tmp_path / "lines")
    assert [line["number"] for line in told[:-2]] == list(range(MOST_QUEUED))
    assert told[-2:] == [{"event": "left_out", "lines": 7}, {"event": "end", "status": "complete"}]


def test_a_reader_that_takes_nothing_holds_up_an_end_for_no_longer_than_it_may(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    began = time.process_time()
    with EventLines(tmp_path / "pipe") as lines:
        for _ in range(100):
            lines.put("event", message="x" * 4096)  # more than a pipe holds
        lines.end(status="complete")
    assert "the reader takes nothing; the last lines are missing" in lines.fault
    assert time.process_time() - began < 0.5  # it waits, and does not spin
    os.close(reader)


def test_what_cannot_be_written_to_is_refused_before_anything_moves(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for place, fault in (
        (tmp_path / "pipe", "nobody reads this pipe"),
        (tmp_path / "no" / "x", "No such file"),
        (tmp_path, "Is a directory"),
    ):
        with pytest.raises(InputError, match=fault), EventLines(place):
            pass


def test_a_command_at_the_end_may_be_interrupted(tmp_path):
    told = "import signal, sys; sys.exit(signal.getsignal(signal.SIGINT) is signal.SIG_IGN)"
    (tmp_path / "after.py").write_text(told)
    command = f"{sys.executable} {tmp_path / 'after.py'}"
    done = leactl(*SHORT, "--out", tmp_path, "--at-end", command, LEACTL_STATE=str(tmp_path))
    assert (done.returncode, "warning" in done.stderr) == (0, False), done.stderr


def test_a_run_whose_devices_cannot_be_opened_has_an_end(tmp_path):
    bench = yaml.safe_load(leactl("bench", "show", "emulated").stdout) | {"name": "mine"}
    bench["emulated"]["faults"] = [{"fault": "bus_off", "at_s": 0.0, "bus": "can0"}]
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(bench))
    script = tmp_path / "after"
    script.write_text('#!/bin/sh\nprintf "%s," "$@" > "$(dirname "$0")/told"\n')
    script.chmod(0o755)
    words = (*SHORT[:2], "--bench", tmp_path / "mine.yaml", *SHORT[4:], "--out", tmp_path, "--json")
    done = leactl(*words, "--events", tmp_path / "lines", "--at-end", script, LEACTL_STATE=str(tmp_path))
    assert (done.returncode, done.stdout) == (5, "")
    [line] = read(tmp_path / "lines")
    assert (line["event"], line["run"], line["status"]) == ("end", None, "failed")
    assert line["reason"] in done.stderr
    assert (tmp_path / "told").read_text() == "failed,,"


def test_a_command_at_the_end_gets_status_and_file(tmp_path):
    script = tmp_path / "after"
    script.write_text('#!/bin/sh\necho "$@" > "$(dirname "$0")/told"\n')
    script.chmod(0o755)
    done = leactl(*SHORT, "--out", tmp_path, "--at-end", f"{script} said", "--json", LEACTL_STATE=str(tmp_path))
    assert (tmp_path / "told").read_text().split() == ["said", "complete", json.loads(done.stdout)["run"]]
    failed = leactl(*SHORT, "--out", tmp_path, "--at-end", "false", LEACTL_STATE=str(tmp_path))
    assert failed.returncode == 0
    assert "warning: --at-end false: ended with status 1" in failed.stderr
    for command, fault in (("nothing-of-the-kind", "there is no program"), ("'", "No closing quotation")):
        refused = leactl(*SHORT, "--out", tmp_path, "--at-end", command, LEACTL_STATE=str(tmp_path))
        assert refused.returncode == 2
        assert fault in refused.stderr
