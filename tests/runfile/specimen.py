"""Channels and description of a small run."""

import shutil
from pathlib import Path

from leactl.quantities import ChannelSpec
from leactl.runfile.write.writer import RunInfo, RunWriter

LOOP = [
    ChannelSpec("iq", "q_axis_current", "test", "drive_a"),
    ChannelSpec("theta", "angle", "test", "drive_a", dtype="f8"),
    ChannelSpec("a_torque", "torque", "test", "sensor", sampling="mean"),
]
CAMERA = [
    ChannelSpec("housing_1", "housing_temperature", "test", "camera", location="active_1"),
    ChannelSpec("housing_2", "housing_temperature", "test", "camera", location="inactive_2"),
]
STREAMS = {"loop": LOOP, "camera": CAMERA}
PROTOCOL = "name: torque constant\r\n# Überprüft\r\n"


def info(run_id: str = "20261120T101530Z-torque-constant-7f3a") -> RunInfo:
    return RunInfo(
        run_id=run_id,
        protocol="torque-constant",
        bench="emulated",
        actuator="unit 7",
        condition="design",
        operator="Ada",
        simulated=True,
        mechanical="coupled",
        software="leactl 0.1.0",
        created="2026-11-20T10:15:30Z",
        sources={"protocol": PROTOCOL, "bench": "name: emulated\n"},
        setup={"drive_gain": 0.98},
    )


def as_left_by_a_kill(writer: RunWriter) -> Path:
    """A copy of a recording that no process writes."""
    return Path(shutil.copy(writer.path, writer.path.with_name("killed.h5")))


def unseal(file) -> None:
    """Make an open run one of other makers, whose names and attributes nothing covers."""
    del file["seal"], file.attrs["seal"]
