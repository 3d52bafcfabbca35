"""WPILib data logs: what WPILib's own writer logs, and what any spoiled bytes give."""

import contextlib
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl.errors import InputError
from leactl.runfile.importing.importer import import_runs
from leactl.runfile.importing.sources.formats.wpilog import WpiLog
from leactl.runfile.read.reader import Run

from .logs import HIP, HIP_SPEED, WPILOG_HEAD, T, wpilog_record, wpilog_start
from .test_import import mapping

SYSID = """
mechanical: free
streams:
  position:
    records: position-left-drive
    time: {column: log_time}
    channels: {q: {column: value, quantity: angle, units: rev}}
  velocity:
    time: {column: velocity-left-drive.log_time}
    channels: {w: {column: velocity-left-drive, quantity: velocity, units: rev/s}}
  modules:
    time: {column: modules.log_time}
    channels: {i: {column: "modules[2]", quantity: q_axis_current}}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def sysid(drop=(), after=b""):
    """A log of SysId's entries: rotations, and three currents at half the rate."""
    out = [WPILOG_HEAD, after]
    kinds = {"position-left-drive": "double", "velocity-left-drive": "float", "modules": "double[]"}
    kinds |= {"sysid-test-state-drive": "string", "pose": "struct:Pose2d"}
    for entry, (name, kind) in enumerate(kinds.items(), start=1):
        out.append(wpilog_start(entry, name, kind, 5))
    for row, (t, q, w) in enumerate(zip(T, HIP, HIP_SPEED, strict=True)):
        stamp = 1_000_000 + round(t * 1e6)
        out.append(wpilog_record(1, stamp, struct.pack("<d", q / (2 * np.pi))))
        out.append(wpilog_record(2, stamp + 3, struct.pack("<f", w / (2 * np.pi))))
        out.append(wpilog_record(4, stamp + 5, b"quasistatic-forward"))
        if row % 2 == 0:
            out.append(wpilog_record(3, stamp + 7, struct.pack("<3d", 0, 1, row)))
    return b"".join(out)


def fault(folder, content, text=SYSID):
    (folder / "log.wpilog").write_bytes(content)
    with pytest.raises(InputError) as caught:
        import_runs(["log.wpilog"], mapping(folder, text), folder / "out")
    assert all(line.isprintable() for line in caught.value.faults)
    return caught.value.faults[0]


def test_entries_are_streams_of_their_stamps(folder):
    (folder / "log.wpilog").write_bytes(sysid())
    (file,) = import_runs(["log.wpilog"], mapping(folder, SYSID), folder / "out")
    run = Run.open(file)
    np.testing.assert_allclose(run.channel("angle").values, HIP, atol=1e-12)
    np.testing.assert_allclose(run.channel("angle").time, T, atol=1e-9)
    np.testing.assert_allclose(run.channel("velocity").values, HIP_SPEED, atol=1e-6)
    np.testing.assert_allclose(run.channel("velocity").time, T + 3e-6, atol=1e-9)
    np.testing.assert_array_equal(run.channel("q_axis_current").values, np.arange(0, 500, 2))


BY_STATE = """
mechanical: free
streams:
  loop:
    records: position-left-drive
    time: {column: log_time}
    channels: {q: {column: value, quantity: angle, units: rev}}
steps_by_column:
  stream: loop
  column: state.value
  time: {column: state.log_time}
  names: {ramp: hold, back: hold}
"""


def test_labels_with_stamps_of_their_own_hold_until_the_next(folder):
    states = [(0.5, b"ramp"), (1.0, b"none"), (2.004, b"back"), (9.0, b"none")]
    data = sysid(after=wpilog_start(9, "state", "string"))
    data += b"".join(wpilog_record(9, 1_000_000 + round(t * 1e6), text) for t, text in states)
    (folder / "log.wpilog").write_bytes(data)
    (file,) = import_runs(["log.wpilog"], mapping(folder, BY_STATE), folder / "out")
    first, last = Run.open(file).steps
    assert (first.name, last.name) == ("hold", "hold")
    assert (first.start, first.stop) == pytest.approx((0.5, 1.0), abs=0.0051)
    assert (last.start, last.stop) == pytest.approx((2.01, 4.99), abs=0.0051)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("  time: {column: state.log_time}\n", "", "position-left-drive message 0 has no 'state' in it"),
        (
            "state.log_time}",
            "stat.log_time}",
            "map.yaml:11:18  steps_by_column.time.column: log.wpilog: no topic begins",
        ),
        ("{column: state.log_time}", "{rate_Hz: 5}", "map.yaml:11:9  steps_by_column.time: column was expected"),
        ("{ramp: hold, back: hold}", "{up: hold}", "none of up stands in column 'state.value', which has none"),
    ],
)
def test_a_fault_of_such_labels_has_its_line_and_column(folder, old, new, told):
    data = sysid(after=wpilog_start(9, "state", "string")) + wpilog_record(9, 1_000_000, b"none")
    assert old in BY_STATE
    assert told in fault(folder, data, BY_STATE.replace(old, new))


def test_what_the_library_of_wpilib_reads_reads_alike(tmp_path):
    log = pytest.importorskip("wpiutil.log", reason="robotpy-wpiutil has wheels for some machines only")
    data = sysid()
    kinds, theirs = {}, {}
    for record in log.DataLogReader(data, "log"):
        if record.isStart():
            about = record.getStartData()
            kinds[about.entry] = about.name
        elif kinds[record.getEntry()] == "velocity-left-drive":
            theirs.setdefault(record.getTimestamp() * 1000, record.getFloat())
    ours = WpiLog(tmp_path, data).messages(["velocity-left-drive"])
    assert {message.log_ns: message.decode()["value"] for message in ours} == theirs
    assert len(theirs) == len(T)


def test_an_entry_that_is_finished_and_started_again_goes_on(tmp_path):
    one = [wpilog_start(1, "x", "double"), wpilog_record(1, 10, struct.pack("<d", 1.0))]
    over = [wpilog_record(0, 20, b"\x01" + (1).to_bytes(4, "little")), wpilog_record(1, 25, b"never read")]
    again = [
        wpilog_start(1, "y", "int64"),
        wpilog_start(7, "x", "double"),
        wpilog_record(7, 30, struct.pack("<d", 2.0)),
    ]
    result = WpiLog(tmp_path, WPILOG_HEAD + b"".join([*one, *over, *again]))
    assert [(m.log_ns, m.decode()) for m in result.messages(["x"])] == [
        (10_000, {"value": 1.0}),
        (30_000, {"value": 2.0}),
    ]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "log.wpilog: not a WPILib data log"),
        (b"WPILOX" + bytes(40), "not a WPILib data log"),
        (b"WPILOG\x00\x02" + bytes(40), "data log of version 2.0; 1 is read"),
        (WPILOG_HEAD[:9], "truncated: it ends within its header"),
        (WPILOG_HEAD[:-1], "truncated: it ends within its header"),
        (sysid()[:-1], "truncated: the record at byte"),
        (sysid()[:200], "truncated: the record at byte"),
        (sysid(after=b"\xff" * 40), "truncated: the record at byte"),
        (sysid(after=b"\x80\1\0\0"), "damaged: no record begins at byte 26"),
        (sysid(after=wpilog_record(0, 0, b"\0\1")), "damaged: a control record at byte"),
        (WPILOG_HEAD, "log.wpilog: no topic begins 'position-left-drive'; it has none"),
        (sysid(after=wpilog_start(9, "modules", "double")), "modules is of type double first and of double[] later"),
        (WPILOG_HEAD + wpilog_start(1, "position-left-drive", "double"), "topic position-left-drive has no message"),
        (
            WPILOG_HEAD + wpilog_start(1, "position-left-drive", "double") + wpilog_record(1, 5, bytes(9)),
            "position-left-drive message 0: cannot be decoded: ",
        ),
    ],
)
def test_what_is_no_log_or_spoiled_is_one_line(folder, content, told):
    assert told in fault(folder, content)


def test_a_type_that_is_not_read_is_named(folder):
    assert "pose is of type struct:Pose2d; boolean, int64" in fault(
        folder, sysid(), SYSID.replace("modules[2]", "pose.x")
    )


def test_a_clock_that_begins_anew_is_told(folder):
    data = sysid() + wpilog_record(1, 5, struct.pack("<d", 0.0))
    assert "'log_time' message 500: stamp -0.999995 s goes back from 4.99 s" in fault(folder, data)


ENTRIES = st.lists(st.tuples(st.integers(0, 2**53), st.floats(allow_nan=False, width=32)), max_size=20)


@settings(max_examples=100, deadline=None)
@given(entry=st.integers(1, 2**32 - 1), rows=ENTRIES, name=st.text(st.characters(codec="utf-8"), max_size=20))
def test_every_value_comes_back(tmp_path_factory, entry, rows, name):
    data = WPILOG_HEAD + wpilog_start(entry, name, "float")
    data += b"".join(wpilog_record(entry, stamp, struct.pack("<f", value)) for stamp, value in rows)
    log = WpiLog(tmp_path_factory.getbasetemp(), data)
    assert [(m.log_ns // 1000, m.decode()["value"]) for m in log.messages([name])] == rows


@settings(max_examples=200, deadline=None)
@given(
    flips=st.lists(st.tuples(st.integers(0, 2000), st.integers(1, 255)), min_size=1, max_size=4),
    cut=st.integers(0, 900),
)
def test_spoiled_bytes_are_one_line_or_read(tmp_path_factory, flips, cut):
    data = bytearray(sysid()[:1000])
    for at, change in flips:
        data[at % len(data)] ^= change
    try:
        log = WpiLog(tmp_path_factory.getbasetemp(), bytes(data[: len(data) - cut]))
        for message in log.messages([name for name, topic in log.topics.items() if not topic.unreadable]):
            with contextlib.suppress(ValueError, struct.error):
                message.decode()
    except InputError as error:
        assert len(error.faults) == 1
