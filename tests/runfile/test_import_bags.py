"""ROS 2 bags of SQLite and MCAP, with and without the definitions of their messages; what is damaged is one line."""

import sqlite3
import struct

import numpy as np
import pytest

from leactl.errors import InputError
from leactl.runfile.importing.importer import import_runs
from leactl.runfile.importing.proposal.channel_units import streams_of
from leactl.runfile.importing.proposal.survey import survey
from leactl.runfile.importing.sources.ros_types import RosTypes
from leactl.runfile.read.reader import Run

from . import logs
from .test_import import mapping
from .test_import_mcap import BY_JOINT, BY_PATH


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def imported(folder, source="bag", text=BY_JOINT, joints=("hip",)):
    return import_runs([source], mapping(folder, text), folder / "out", joints)


def fault(folder, source="bag", text=BY_JOINT, joints=("hip",)):
    with pytest.raises(InputError) as caught:
        imported(folder, source, text, joints)
    assert not (folder / "out").exists()
    assert all(line.isprintable() for line in caught.value.faults)
    return caught.value.faults[0]


@pytest.mark.parametrize(
    ("options", "source"),
    [
        ({"version": 9}, "bag"),
        ({"version": 9}, "bag/bag.db3"),
        ({"version": 8, "kinds": ("joints",)}, "bag"),
        ({"storage": "mcap"}, "bag"),
        ({"storage": "mcap"}, "bag/bag.mcap"),
        ({"compress": "MESSAGE"}, "bag"),
    ],
)
def test_joints_of_a_bag(folder, options, source):
    logs.write_bag(folder / "bag", **options)
    (file,) = imported(folder, source)
    assert file.name == "bag-hip.h5"
    run = Run.open(file)
    np.testing.assert_allclose(run.channel("angle").values, logs.HIP, atol=1e-12)
    np.testing.assert_allclose(run.channel("velocity").values, logs.HIP_SPEED, atol=1e-12)
    np.testing.assert_allclose(run.channel("angle").time, logs.T, atol=1e-9)
    assert run.attributes["created"] == "2023-11-14T22:13:20Z"


STORAGES = pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
OF_RECORDER = BY_JOINT.replace("header.stamp", "log_time")


@STORAGES
@pytest.mark.parametrize("text", [BY_JOINT, OF_RECORDER], ids=["header", "recorder"])
def test_a_gap_is_a_note(folder, storage, text):
    kept = [*range(100), *range(300, 500)]
    logs.write_bag(folder / "bag", kept, storage=storage)
    (file,) = imported(folder, text=text)
    run = Run.open(file)
    np.testing.assert_allclose(run.channel("angle").values, logs.HIP[kept], atol=1e-12)
    np.testing.assert_allclose(run.channel("angle").time, logs.T[kept], atol=1e-9)
    assert any("2.01 s without a sample from 0.99 s; samples come every 0.01 s" in str(event) for event in run.events)


@STORAGES
def test_a_clock_that_is_reset_is_told(folder, storage):
    logs.write_bag(folder / "bag", storage=storage, stamp=lambda row: logs.stamp_ns(row % 300))
    assert "'header.stamp' message 300: stamp -0.002 s goes back from 2.988 s" in fault(folder)


@STORAGES
@pytest.mark.parametrize("back", [300, 299.5])  # rows: onto earlier stamps, and between them
def test_a_recorder_s_clock_that_is_reset_mixes_no_messages(folder, storage, back):
    def log(row):
        return logs.stamp_ns(row) + 5_000_000 - (row >= 300) * round(back * 1e7)

    logs.write_bag(folder / "bag", storage=storage, log=log)
    assert "'log_time' message 300: stamp " in (told := fault(folder, text=OF_RECORDER))
    assert "goes back from " in told
    (file,) = imported(folder)  # by the stamps of the messages, which go on
    np.testing.assert_allclose(Run.open(file).channel("angle").values, logs.HIP, atol=1e-12)


def test_custom_messages_of_a_bag_that_carries_their_definitions(folder):
    logs.write_bag(folder / "bag")
    (file,) = imported(folder, text=BY_PATH, joints=())
    np.testing.assert_allclose(Run.open(file).channel("line_current").values, 1e-3 * np.arange(logs.N), atol=1e-7)


def test_a_kind_of_message_that_nobody_defines(folder):
    logs.write_bag(folder / "bag")
    with sqlite3.connect(folder / "bag" / "bag.db3") as bag:
        bag.execute("DELETE FROM message_definitions")
    bag.close()
    assert "/drive is of rig_msgs/msg/DriveState, of which neither the log" in fault(folder, text=BY_PATH, joints=())
    (file,) = imported(folder)  # of a kind that ROS 2 ships
    np.testing.assert_allclose(Run.open(file).channel("angle").values, logs.HIP, atol=1e-12)


def definition(*parts):
    """A message, and those that it uses by their names."""
    first, *others = parts
    return first + "".join(f"\n{'=' * 80}\nMSG: rig_msgs/{name}\n{text}" for name, text in others)


HEAVY = definition("rig_msgs/A[300] a", ("A", "rig_msgs/B[300] b"), ("B", "string s"))
CHAIN = [(f"M{at}", "\n".join(f"rig_msgs/M{at + 1} f{field}" for field in range(50))) for at in range(30)]
WIDE = definition("rig_msgs/M0 m", *CHAIN, ("M30", "float64 x"))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("string[99999999] s", "has a definition of more than 10000 parts; fewer were expected"),
        (HEAVY, "has a definition of more than 10000 parts; fewer were expected"),
        (WIDE, "has a definition of more than 10000 parts; fewer were expected"),
        (definition("rig_msgs/Motor m", ("Motor", "rig_msgs/Motor m")), "rig_msgs/msg/Motor holds itself"),
        ("rig_msgs/Other m", "rig_msgs/msg/Other is used and not defined"),
        ("float64 x;import os", "has a definition that cannot be read: Could not parse"),
        ("string C=''\n'+__import__('os')", "has a definition that cannot be read: Could not parse"),
        ("\udcff".encode("utf-8", "surrogateescape").decode("latin-1"), "has a definition that cannot be read"),
    ],
)
def test_a_definition_is_judged_before_code_is_made_of_it(folder, text, told):
    why = RosTypes().learn("rig_msgs/msg/DriveState", "ros2msg", text.encode())
    assert told in why
    assert why.isprintable()


IDL = """\
{0}
IDL: rig_msgs/msg/State
#include "rig_msgs/msg/Motor.idl"
module rig_msgs {{ module msg {{ struct State {{ rig_msgs::msg::Motor motor; }}; }}; }};
{0}
IDL: rig_msgs/msg/Motor
module rig_msgs {{ module msg {{ struct Motor {{ double speed; sequence<float> phase; }}; }}; }};
""".format("=" * 80)


def test_a_definition_in_idl():
    types = RosTypes()
    assert types.learn("rig_msgs/msg/State", "ros2idl", IDL.encode()) == ""
    state = types.decode("rig_msgs/msg/State", struct.pack("<4sdI2f", b"\0\1\0\0", 2.5, 2, 1.0, 3.0))
    assert (state.motor.speed, state.motor.phase.tolist()) == (2.5, [1.0, 3.0])
    assert "is defined in protobuf" in types.learn("rig_msgs/msg/Odd", "protobuf", b"")


def test_bags_by_a_pattern_and_their_proposal(folder):
    for name in ("one", "two"):
        logs.write_bag(folder / name, range(50))
    files = imported(folder, "[ot]*", joints=("all",))
    assert sorted(file.name for file in files) == ["one-hip.h5", "one-knee.h5", "two-hip.h5", "two-knee.h5"]
    streams = streams_of(survey(folder / "one"), {})
    assert {stream.name: list(stream.channels) for stream in streams} == {
        "joint_states": ["position", "velocity", "effort"],
        "drive": ["motor_bus_voltage", "motor_enabled"],
    }


def spoil(folder, at, by):
    path = folder / "bag" / at
    path.write_bytes(by(path.read_bytes()))


@pytest.mark.parametrize(
    ("at", "by", "told"),
    [
        ("bag.db3", lambda whole: whole[:5000], "bag.db3: damaged, or no bag: "),
        ("bag.db3", lambda whole: whole[:10], "bag.db3: neither SQLite nor MCAP, of which bags are"),
        ("bag.db3", lambda whole: whole[:100] + bytes(len(whole) - 100), "bag.db3: damaged, or no bag: "),
        ("metadata.yaml", lambda whole: b"a: b", "relative_file_paths: files were expected"),
        ("metadata.yaml", lambda whole: b"a: [", "metadata.yaml:"),
        ("metadata.yaml", lambda whole: whole.replace(b"bag.db3", b"other.db3"), "other.db3: no such file, which meta"),
        ("metadata.yaml", lambda whole: whole.replace(b"version: 9", b"version: 99"), "version 99; at most 9 is read"),
        ("metadata.yaml", lambda whole: whole.replace(b"compression_mode: ''", b"compression_mode: FILE"), "its files"),
    ],
)
def test_a_spoiled_bag_is_one_line(folder, at, by, told):
    logs.write_bag(folder / "bag", range(50))
    spoil(folder, at, by)
    assert told in fault(folder)


def test_a_bag_that_was_never_closed(folder):
    logs.write_bag(folder / "bag", range(50))
    (folder / "bag" / "bag.db3-wal").write_bytes(bytes(32))
    assert "bag.db3: was never closed, bag.db3-wal holds its last messages" in fault(folder)


def test_a_message_that_is_cut(folder):
    logs.write_bag(folder / "bag", range(50))
    with sqlite3.connect(folder / "bag" / "bag.db3") as bag:
        bag.execute("UPDATE messages SET data = substr(data, 1, 30) WHERE id = 7")
    bag.close()
    assert "bag: /joint_states message 6: cannot be decoded: " in fault(folder)


def test_a_folder_that_is_no_bag(folder):
    (folder / "bag").mkdir()
    assert fault(folder) == "bag: a directory; name its files, such as 'bag/*.csv'"
