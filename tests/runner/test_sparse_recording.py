"""A recording of few rows: at most one of each stream in a time, and the room that it is given on the disk."""

from dataclasses import replace

import numpy as np
import pytest

from leactl.protocol.by_hand import reading_steps
from leactl.quantities import ChannelSpec
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runfile.write.writer import RunInfo
from leactl.runner.dry_run import preview, streams_of
from leactl.runner.flushing import SparseWriter
from leactl.runner.request import prepare_by_hand

STREAMS = {
    "loop": [ChannelSpec("iq", "q_axis_current", "test", "drive")],
    "daq": [ChannelSpec("ab", "phase_voltage_ab", "test", "daq")],
}


@pytest.fixture
def info():
    return RunInfo(
        run_id="20261121T100000Z-read-0001",
        protocol="read",
        bench="emulated",
        actuator="",
        condition="",
        operator="",
        simulated=True,
        mechanical="coupled",
        software="leactl 0.1.0",
        created="2026-11-21T10:00:00Z",
    )


def test_rows_and_blocks_are_thinned_stream_by_stream(tmp_path, info):
    writer = SparseWriter(tmp_path, info, STREAMS, lambda: None, 0.5)
    for cycle in range(8):  # from 0 to 1.75 s
        writer.append_row("loop", cycle / 4, [float(cycle)])
        writer.append("daq", np.array([cycle / 4, cycle / 4 + 0.125]), np.array([[2.0 * cycle], [2.0 * cycle + 1.0]]))
    writer.close("complete")
    with Run.open(writer.path) as run:
        current, voltage = run.channel("q_axis_current", "test"), run.channel("phase_voltage_ab", "test")
        assert (current.time.tolist(), current.values.tolist()) == ([0.0, 0.5, 1.0, 1.5], [0.0, 2.0, 4.0, 6.0])
        assert (voltage.time.tolist(), voltage.values.tolist()) == ([0.0, 0.5, 1.0, 1.5], [0.0, 4.0, 8.0, 12.0])
    assert verify(writer.path) == []


def test_a_recording_of_few_rows_is_given_little_room(tmp_path, monkeypatch):
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path))
    request = prepare_by_hand("read", reading_steps(60.0), "emulated", "", tmp_path, realtime=False, everything=True)
    columns = sum(1 + len(channels) for channels in streams_of(request).values())
    few, every = (preview(replace(request, record_every_s=s)).planned_bytes for s in (2.0, 0.0))
    assert few == 30 * columns * 16  # bytes of a value, in the live file and in the packed one
    assert every > 50 * few
