"""MCAP logs: joints by name, fields by path, stamps of messages or recorder; what is damaged is one line."""

import re
import struct

import numpy as np
import pytest

from leactl.errors import InputError
from leactl.runfile.importing.importer import import_runs
from leactl.runfile.read.reader import Run

from . import logs
from .test_import import mapping

BY_JOINT = """
mechanical: free
streams:
  loop:
    records: "/joint_states[{joint}]"
    time: {column: header.stamp}
    channels:
      q: {column: position, quantity: angle}
      w: {column: velocity, quantity: velocity}
"""
BY_PATH = """
mechanical: free
streams:
  state:
    time: {column: /drive.header.stamp}
    channels:
      q: {column: "/joint_states.position[hip]", quantity: angle}
      phase: {column: "/drive.motor.phase[3]", quantity: line_current, units: mA}
      bus: {column: /drive.motor.bus_voltage, quantity: bus_voltage, role: bench}
      "on": {column: /drive.motor.enabled, quantity: drive_enabled}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def runs(folder, text, joints=(), source="log.mcap"):
    files = import_runs([str(folder / source)], mapping(folder, text), folder / "out", joints)
    return {file.name: Run.open(file) for file in files}


def fault(folder, text=BY_JOINT, joints=("hip",), source="log.mcap"):
    with pytest.raises(InputError) as caught:
        runs(folder, text, joints, source)
    assert not (folder / "out").exists()
    assert all(line.isprintable() for line in caught.value.faults)
    return caught.value.faults[0]


def values(run, quantity):
    return run.channel(quantity, "test").values


def test_every_joint_of_a_log_becomes_a_run(folder):
    logs.write_mcap(folder / "log.mcap")
    result = runs(folder, BY_JOINT, ["all"])
    assert set(result) == {"log-hip.h5", "log-knee.h5"}
    for name, angle, speed in (("hip", logs.HIP, logs.HIP_SPEED), ("knee", logs.KNEE, logs.KNEE_SPEED)):
        run = result[f"log-{name}.h5"]
        np.testing.assert_allclose(values(run, "angle"), angle, atol=1e-12)
        np.testing.assert_allclose(values(run, "velocity"), speed, atol=1e-12)
        np.testing.assert_allclose(run.channel("angle", "test").time, logs.T, atol=1e-9)
        assert run.attributes["created"] == "2023-11-14T22:13:20Z"


def test_joints_are_named_by_the_mapping_or_on_the_command_line(folder):
    logs.write_mcap(folder / "log.mcap")
    assert "give joints: or --joint as all or some of knee, hip" in fault(folder, joints=())
    assert set(runs(folder, BY_JOINT.replace("mechanical", "joints: [knee]\nmechanical"))) == {"log-knee.h5"}


def test_fields_of_custom_messages_by_path(folder):
    logs.write_mcap(folder / "log.mcap")
    run = runs(folder, BY_PATH)["log.h5"]
    np.testing.assert_allclose(values(run, "angle"), logs.HIP, atol=1e-12)
    np.testing.assert_allclose(values(run, "line_current"), 1e-3 * np.arange(logs.N), atol=1e-7)
    np.testing.assert_array_equal(values(run, "drive_enabled"), np.arange(logs.N) > 10)


@pytest.mark.parametrize(("column", "shift"), [("log_time", 0.0), ("publish_time", 5e-4)])
def test_stamps_of_the_recorder_as_a_setting(folder, column, shift):
    rows = [0, 1, 2, 3, 5, 4, 6, 7]  # written out of order
    logs.write_mcap(folder / "log.mcap", rows, stamp=lambda row: logs.stamp_ns(0))
    run = runs(folder, BY_JOINT.replace("header.stamp", column), ["knee"])["log-knee.h5"]
    np.testing.assert_allclose(run.channel("angle", "test").time, logs.T[:8], atol=1e-9)


def test_json_and_every_packing(folder):
    from mcap.writer import CompressionType

    text = """
mechanical: free
streams:
  loop:
    records: motor
    time: {column: log_time}
    channels: {q: {column: angle.deg, quantity: angle, units: deg}}
"""
    for kind in CompressionType:
        logs.write_mcap(folder / f"{kind.name}.mcap", range(20), compression=kind)
        run = runs(folder, text, source=f"{kind.name}.mcap")[f"{kind.name}.h5"]
        np.testing.assert_allclose(values(run, "angle"), logs.HIP[:20], atol=1e-12)


def test_messages_that_name_other_joints_are_no_rows(folder):
    logs.write_mcap(folder / "log.mcap", names=lambda row: ("hip",) if row % 5 == 0 else ("knee",))
    run = runs(folder, BY_JOINT, ["hip"])["log-hip.h5"]
    np.testing.assert_allclose(values(run, "angle"), logs.HIP[::5], atol=1e-12)
    np.testing.assert_allclose(run.channel("angle", "test").time, logs.T[::5], atol=1e-9)


def test_a_gap_is_a_note(folder):
    logs.write_mcap(folder / "log.mcap", [*range(100), *range(300, 500)])
    events = runs(folder, BY_JOINT, ["hip"])["log-hip.h5"].events
    assert any("2.01 s without a sample from 0.99 s; samples come every 0.01 s" in str(event) for event in events)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (BY_JOINT.replace("/joint_states[", "/joints["), "no topic begins '/joints[hip]'; it has /drive, /jo"),
        (BY_JOINT.replace("column: position", "column: angle"), "message 0 has no 'angle' in it, which has header, na"),
        (BY_PATH.replace("motor.bus", "motor.bas"), "has no 'bas_voltage' in motor, which has phase, bus_voltage, ena"),
        (BY_PATH.replace("phase[3]", "phase"), "holds a list of 4 where a number was expected"),
        (BY_PATH.replace("phase[3]", "phase[9]"), "column '/drive.motor.phase[9]' holds no number at all"),
        (BY_PATH.replace("[hip]", "[elbow]"), "column '/joint_states.position[elbow]' holds no number at all"),
        (BY_PATH.replace("/drive.motor.phase[3]", "odd.x"), "odd is in protobuf; json or cdr with its definition"),
        (BY_PATH.replace("/drive.motor.phase[3]", "empty.x"), "topic empty has no message"),
        (BY_PATH.replace("mechanical", "joints: all\nmechanical"), "{joint} stands in no path of the mapping"),
        (BY_PATH.replace("mechanical", "format: bag\nmechanical"), "'bag' is no format; one of csv, json, mat, mcap"),
    ],
)  # fmt: skip
def test_what_a_log_does_not_have_is_one_line_in_the_mapping(folder, text, told):
    logs.write_mcap(folder / "log.mcap")
    line = fault(folder, text, ("hip",) if "{joint}" in text else ())
    assert told in line
    assert told.startswith(("column", "topic")) or re.match(r".*map\.yaml:\d+:\d+  ", line)


def test_no_message_names_the_joint(folder):
    logs.write_mcap(folder / "log.mcap")
    assert "no message of /joint_states names 'elbow'" in fault(folder, joints=("elbow",))


def test_a_clock_that_is_reset_is_told(folder):
    logs.write_mcap(folder / "log.mcap", stamp=lambda row: logs.stamp_ns(row % 300))
    assert "'header.stamp' message 300: stamp -0.002 s goes back from 2.988 s" in fault(folder)


def test_stamps_that_stand_twice(folder):
    logs.write_mcap(folder / "log.mcap", [row for row in range(100) for _ in range(2)])
    assert "stands twice (100 such rows); time.repeated: drop leaves the later rows out" in fault(folder)
    text = BY_JOINT.replace("header.stamp", "header.stamp, repeated: drop")
    assert len(values(runs(folder, text, ["hip"])["log-hip.h5"], "angle")) == 100


def test_a_log_cut_anywhere_is_one_line(folder):
    whole = logs.write_mcap(folder / "log.mcap", range(40), chunk_size=4096).read_bytes()
    for size in (0, 5, 9, 100, len(whole) // 2, len(whole) - 9, len(whole) - 1):
        (folder / "cut.mcap").write_bytes(whole[:size])
        assert "truncated: it ends before" in fault(folder, source="cut.mcap") or size < 9
    logs.write_mcap(folder / "cut.mcap", range(40), finish=False)
    assert "truncated: it ends before its footer" in fault(folder, source="cut.mcap")


def test_damage_anywhere_is_one_line_or_none(folder):
    whole = bytearray(logs.write_mcap(folder / "log.mcap", range(12), chunk_size=2048).read_bytes())
    rng = np.random.default_rng(3)
    refused = 0
    for at in rng.integers(8, len(whole), 60):
        damaged = whole.copy()
        damaged[at] ^= 0xFF
        (folder / "bad.mcap").write_bytes(damaged)
        try:
            import_runs([str(folder / "bad.mcap")], mapping(folder, BY_JOINT), folder / f"out{at}", ["hip"])
        except InputError as error:
            refused += 1
            assert all("\n" not in line for line in error.faults)
    assert refused > 10


def test_a_number_that_was_changed_is_damage(folder):
    from mcap.writer import CompressionType

    whole = logs.write_mcap(folder / "log.mcap", range(12), compression=CompressionType.NONE).read_bytes()
    changed = whole.replace(struct.pack("<d", logs.HIP[5]), struct.pack("<d", logs.HIP[5] + 0.1))
    assert changed != whole
    (folder / "log.mcap").write_bytes(changed)
    assert fault(folder).endswith("log.mcap: damaged: a chunk is not what its CRC says")


def test_a_chunk_that_unpacks_to_more_than_it_says(folder):
    import zstandard

    whole = bytearray(logs.write_mcap(folder / "log.mcap", range(12)).read_bytes())
    at = whole.index(b"\x04\x00\x00\x00zstd")  # of the chunk: compression, then the length of its records
    (length,) = struct.unpack_from("<Q", whole, at + 8)
    bomb = zstandard.compress(bytes(1 << 22))
    padding = length - len(bomb) - 8
    swollen = whole.copy()  # a skippable frame fills what the bomb leaves, so that all offsets stay
    swollen[at + 16 : at + 16 + length] = bomb + struct.pack("<II", 0x184D2A50, padding) + bytes(padding)
    (folder / "bomb.mcap").write_bytes(swollen)
    assert "a chunk unpacks to more than" in fault(folder, source="bomb.mcap")
    lying = whole.copy()
    lying[at - 12 : at - 4] = struct.pack("<Q", 1 << 40)
    (folder / "lying.mcap").write_bytes(lying)
    assert f"a chunk says that it unpacks to {1 << 40} bytes" in fault(folder, source="lying.mcap")


def test_other_files_are_no_mcap(folder):
    (folder / "log.mcap").write_text("time,q\n0,1\n" * 5)
    assert "log.mcap: not an MCAP file" in fault(folder)
