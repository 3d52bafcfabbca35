"""Interlocks in whole runs: one cycle from a sample to zero torque on the wire, warnings in the file, the disk."""

import json
import os
import shutil
import struct
from collections import namedtuple

import pytest

from leactl.bench import benchfile
from leactl.errors import DeviceFault, InputError, SafetyTrip
from leactl.runfile.read.reader import Run
from tests.cli.terminal import leactl
from tests.runner.conftest import SPIN

PERIOD = 0.01
COUNTS_PER_RAD = 40000 / 6.283185307179586
Sent = namedtuple("Sent", "time identifier data")


def bench_file(tmp_path, interlocks):
    head, _, rest = (benchfile.SHIPPED / "emulated.yaml").read_text().partition("interlocks:")
    path = tmp_path / "bench.yaml"
    path.write_text(f"{head}interlocks:\n{interlocks}\nresponse:{rest.partition('response:')[2]}")
    return str(path)


class Tapped:
    """Every frame of a wire, either way, with the time at which it was there."""

    def __init__(self):
        self.host, self.drives = [], []

    def __call__(self, bench):
        wire = bench.wires["can0"]
        from_host, to_hosts = wire.from_host, wire._send_to_hosts

        def out(frame, sender):
            self.host.append(Sent(bench.clock.now(), *frame))
            from_host(frame, sender)

        def back(frames):
            self.drives += [Sent(bench.clock.now(), *frame) for frame in frames]
            to_hosts(frames)

        wire.from_host, wire._send_to_hosts = out, back

    def zero_torque(self, node, since):
        """When the host took the torque away for good: from then on, no demand and no enabling."""
        demands = [frame for frame in self.host if frame.identifier == 0x200 + node and frame.time >= since]
        last = max((frame.time for frame in demands if any(frame.data[:4])), default=-1.0)
        return min(frame.time for frame in demands if not any(frame.data[:4]) and frame.time >= last)


def velocity_past(tap, limit):
    def speed(frame):
        return abs(struct.unpack("<ii", frame.data)[1]) / COUNTS_PER_RAD

    return min(frame.time for frame in tap.drives if frame.identifier == 0x281 and speed(frame) > limit)


def test_from_a_sample_past_an_interlock_to_zero_torque_is_at_most_one_cycle(spin, tmp_path):
    tap = Tapped()
    bench = bench_file(tmp_path, "  velocity: {trip_rad_s: 4}")
    outcome, _bench = spin(bench=bench, at=[(0.0, tap)], sets=("current_A=1.2",))
    assert "test velocity of 4." in outcome.reason
    sample = velocity_past(tap, 4.0)
    for node in (1, 2):
        assert 0.0 <= tap.zero_torque(node, sample) - sample <= PERIOD
    assert outcome.status == "tripped"


@pytest.mark.parametrize(
    ("happens", "interlocks", "error", "words"),
    [
        (lambda b: b.far_ends["drive_test"].fault(0x3310), "", DeviceFault, "0x3310 (over-voltage)"),
        (
            lambda b: setattr(b.far_ends["torque_sensor"], "_pins", lambda number: 1.2 if number == 0 else 0.0),
            "  torque: {trip_Nm: 3}",
            SafetyTrip,
            "test torque of 3.6 N*m passed the interlock of 3 N*m",
        ),
    ],
)
def test_a_fault_and_a_sensor_reach_zero_torque_within_one_cycle_too(spin, tmp_path, happens, interlocks, error, words):
    tap, began = Tapped(), []

    def happen(bench):
        began.append(bench.clock.now())
        happens(bench)

    bench = bench_file(tmp_path, interlocks or "  clock: {jump_s: 0.2}")
    outcome, _bench = spin(bench=bench, at=[(0.0, tap), (0.4, happen)])
    assert isinstance(outcome.error, error)
    assert words in outcome.reason
    conversion = 0.0 if error is DeviceFault else 1 / 860 * 1.5  # the one under way began before
    for node in (1, 2):
        assert tap.zero_torque(node, began[0]) - began[0] <= PERIOD + conversion + PERIOD * (error is SafetyTrip)


def test_a_fault_of_a_drive_latches_the_supervisor_though_the_status_is_the_device_s(spin, monkeypatch):
    from leactl.runner import preparation

    kept = []

    def keep(*arguments, **keywords):
        kept.append(made(*arguments, **keywords))
        return kept[-1]

    made = preparation.Supervisor
    monkeypatch.setattr(preparation, "Supervisor", keep)
    outcome, _bench = spin(at=[(0.4, lambda bench: bench.far_ends["drive_test"].fault(0x2310))])
    assert (outcome.error.exit_status, outcome.status) == (5, "failed")
    with pytest.raises(SafetyTrip, match="0x2310"):
        kept[0].command("load", 0.0)


# -- warnings ----------------------------------------------------------------------------------------------------------


def test_a_warning_is_one_event_of_the_file_and_one_line_of_the_view(spin, tmp_path):
    seen = []

    def watch(progress):
        from contextlib import nullcontext

        seen.append(progress)
        return nullcontext()

    outcome, _bench = spin(bench=bench_file(tmp_path, "  velocity: {role: test, warn_rad_s: 2}"), watch=watch)
    assert outcome.status == "complete"
    with Run.open(outcome.path) as run:
        results = [event for event in run.events if event.source == "safety"]
        velocity = run.channel("velocity", "test")
    assert [event.level for event in results] == ["warning"]
    assert results[0].message.startswith("test velocity of 2.")
    crossed = velocity.time[velocity.values > 2.0][0]
    assert 0 <= results[0].time - crossed <= PERIOD
    assert seen[0].warnings == [results[0].message]


def test_a_warning_is_on_stderr_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spin.yaml").write_text(SPIN)
    bench_file(tmp_path, "  velocity: {role: test, warn_rad_s: 2}")
    state = os.environ | {"LEACTL_STATE": str(tmp_path)}
    done = leactl("run", "spin.yaml", "--bench", "bench.yaml", "--json", **state)
    assert done.returncode == 0
    (line,) = done.stderr.splitlines()
    assert line.startswith("leactl: warning: test velocity of 2.")
    assert json.loads(done.stdout)["status"] == "complete"


# -- the disk ----------------------------------------------------------------------------------------------------------


def test_a_run_that_the_disk_may_not_take_is_refused_before_anything_moves(spin, tmp_path):
    bench = bench_file(tmp_path, "  disk_space: {trip_MB: 1e9}")
    with pytest.raises(InputError, match=r"disk: \d+ MB are free; 1000000\d+ MB were expected"):
        spin(bench=bench)
    assert not (tmp_path / "runs").exists()


def test_the_planned_run_counts(spin, tmp_path, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: usage(10**12, 0, 150_000_000))
    bench = bench_file(tmp_path, "  disk_space: {trip_MB: 100, warn_MB: 100}")
    long = SPIN.replace("rate_Hz: 100", "rate_Hz: 1000")
    assert spin(bench=bench)[0].status == "complete"
    # 1 ms for 3000 s: a stamp and 14 values of two drives, and three streams of one value; twice 8 bytes each
    with pytest.raises(
        InputError, match="disk: 150 MB are free; 1108 MB were expected, 1008 MB for the run and 100 MB"
    ):
        spin(long, bench=bench, sets=("hold_s=2999.8",))


def test_a_disk_that_fills_up_while_running_trips(spin, tmp_path, monkeypatch):
    usage, free = namedtuple("usage", "total used free"), [10**9]
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: usage(10**12, 0, free[0]))
    monkeypatch.setattr("leactl.runner.flushing.FLUSH_INTERVAL_S", 0.0)
    bench = bench_file(tmp_path, "  disk_space: {trip_MB: 100, warn_MB: 500}")
    outcome, _bench = spin(
        bench=bench,
        at=[(0.3, lambda _b: free.__setitem__(0, 4 * 10**8)), (0.6, lambda _b: free.__setitem__(0, 9 * 10**7))],
    )
    assert (outcome.status, outcome.reason) == ("tripped", "disk: 90 MB are free; 100 MB at least are required")
    assert outcome.duration_s < 0.6 + 17 * PERIOD
    with Run.open(outcome.path) as run:
        told = [event.message for event in run.events if event.source == "safety" and event.level == "warning"]
    assert told == ["disk: 400 MB are free; below 100 MB the run trips"]
