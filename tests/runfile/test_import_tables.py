"""NPZ and Parquet: the columns that were written, and one line for what swells, needs pickle or is cut."""

import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import parquet
from scipy.io import savemat

from leactl.errors import InputError
from leactl.quantities import ChannelSpec
from leactl.runfile.export import export
from leactl.runfile.importing.importer import import_runs
from leactl.runfile.importing.proposal.proposal import propose
from leactl.runfile.importing.proposal.survey import survey
from leactl.runfile.importing.sources.formats import npz
from leactl.runfile.importing.sources.registry import open_source
from leactl.runfile.importing.sources.source import SourceRequest, WantedColumn
from leactl.runfile.read.reader import Run
from leactl.runfile.write.run_info import RunInfo
from leactl.runfile.write.writer import RunWriter

from .logs import HIP, HIP_SPEED, KNEE, N, T
from .test_import import mapping

PLAIN = """
mechanical: free
streams:
  loop:
    time: {column: t}
    channels:
      q: {column: "q[1]", quantity: angle, units: deg}
      w: {column: w, quantity: velocity}
"""
DEGREES = np.degrees(np.stack([HIP, KNEE], axis=1))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run_of(folder, source, text=PLAIN, joints=()):
    (file,) = import_runs([source], mapping(folder, text), folder / "out", joints)
    return Run.open(file)


def fault(folder, source, text=PLAIN):
    with pytest.raises(InputError) as caught:
        import_runs([source], mapping(folder, text), folder / "out")
    assert not (folder / "out").exists()
    assert all(line.isprintable() for line in caught.value.faults)
    return caught.value.faults[0]


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_of_an_archive(folder, save):
    save("log.npz", t=T, q=np.asfortranarray(DEGREES), w=HIP_SPEED.astype(np.float32), note=np.array(["a"] * N))
    run = run_of(folder, "log.npz")
    np.testing.assert_allclose(run.channel("angle", "test").values, KNEE, atol=1e-12)
    np.testing.assert_allclose(run.channel("velocity", "test").values, HIP_SPEED, atol=1e-6)


@pytest.mark.parametrize(
    ("ending", "inside"), [("npz", ""), ("mat", ""), ("mat", "arm."), ("json", ""), ("json", "arm.")]
)
def test_a_matrix_beside_its_stamps_is_taken_by_column_from_every_tree(folder, ending, inside):
    columns = {"t": T, "q": DEGREES, "w": HIP_SPEED}
    if ending == "npz":
        np.savez("log.npz", **columns)
    else:
        tree = {"arm": columns} if inside else columns
        if ending == "mat":
            savemat("log.mat", tree)
        else:
            Path("log.json").write_text(json.dumps(tree, default=lambda array: array.tolist()))
    text = PLAIN
    for name in ("t", '"q[1]"', "w"):
        text = text.replace(f"column: {name}", f'column: "{inside}{name.strip(chr(34))}"', 1)
    run = run_of(folder, f"log.{ending}", text)
    np.testing.assert_allclose(run.channel("angle", "test").values, KNEE, rtol=1e-12)
    (table,) = open_source(folder / f"log.{ending}", None, SourceRequest(None)).tables()
    assert sorted(column.name for column in table.columns) == ["q[0]", "q[1]", "t", "w"]
    with pytest.raises(InputError, match=r"no .*2"):
        import_runs([f"log.{ending}"], mapping(folder, text.replace("q[1]", "q[2]")), folder / "another")


@pytest.mark.parametrize("ending", ["mat", "json"])
@pytest.mark.parametrize(
    ("beside", "listed", "values"),
    [
        ({"lengths": 3}, [], [0, 1, 2, 3, 4, 5, 6]),
        ({"lengths": 3, "t": 7}, ["q[0]", "q[1]", "q[2]", "t"], [0, 1, 2, 3, 4, 5, 6]),
        ({"t": 3}, ["q[0]", "q[1]", "q[2]", "q[3]", "q[4]", "q[5]", "q[6]", "t"], [0, 7, 14]),
    ],
)
def test_a_matrix_wider_than_long_has_its_samples_in_rows_only_beside_stamps(folder, ending, beside, listed, values):
    tree = {"q": np.arange(21.0).reshape(3, 7)} | {name: np.arange(float(size)) for name, size in beside.items()}
    if ending == "mat":
        savemat("log.mat", tree)
    else:
        Path("log.json").write_text(json.dumps(tree, default=lambda array: array.tolist()))
    source = open_source(folder / f"log.{ending}", None, SourceRequest(None))
    assert source.column("q[0]", None).tolist() == values
    assert sorted(c.name for table in source.tables() for c in table.columns if c.name in ("t", *Q)) == listed


Q = [f"q[{index}]" for index in range(7)]


@pytest.mark.parametrize(("stamps", "values"), [(7, [0, 1, 2, 3, 4, 5, 6]), (3, [0, 7, 14])])
def test_an_array_wider_than_long_goes_by_row_where_its_columns_have_stamps(folder, stamps, values):
    np.savez("log.npz", q=np.arange(21.0).reshape(3, 7), t=np.arange(float(stamps)))
    assert open_source(folder / "log.npz", None, SourceRequest(None)).column("q[0]", None).tolist() == values


def test_an_array_of_objects_is_never_unpickled(folder):
    np.savez("log.npz", t=np.array([open, 1], dtype=object), q=DEGREES, w=HIP_SPEED)
    assert fault(folder, "log.npz") == "log.npz: t.npy: an array of objects; numbers or text were expected"


def header(shape, dtype="<f8"):
    text = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


def test_a_header_that_says_more_than_is_stored(folder):
    with zipfile.ZipFile("log.npz", "w") as archive:
        archive.writestr("t.npy", header("(100000000000,)") + bytes(80))
    assert fault(folder, "log.npz") == "log.npz: t.npy: its header says 800000000000 bytes; 80 are stored"


def test_an_archive_that_swells_is_refused_unread(folder, monkeypatch):
    monkeypatch.setattr(npz, "MOST_UNPACKED", (32, 1 << 10))
    np.savez_compressed("log.npz", t=np.zeros(1 << 20), q=DEGREES, w=HIP_SPEED)
    assert "unpacks to 8" in fault(folder, "log.npz")


@settings(max_examples=60, deadline=None)
@given(cut=st.integers(0, 4000), flips=st.lists(st.tuples(st.integers(0, 4000), st.integers(1, 255)), max_size=3))
def test_a_spoiled_archive_is_one_line_or_reads(tmp_path_factory, cut, flips):
    buffer = io.BytesIO()
    np.savez_compressed(buffer, t=T, q=DEGREES)
    spoiled = bytearray(buffer.getvalue())
    for at, change in flips:
        spoiled[at % len(spoiled)] ^= change
    path = tmp_path_factory.mktemp("npz") / "log.npz"
    path.write_bytes(spoiled[: len(spoiled) - cut])
    try:
        open_source(path, None, SourceRequest([WantedColumn("t")]))
    except InputError as error:
        assert all("\n" not in line for line in error.faults)
    else:
        assert not cut


def write_parquet(path, **columns):
    parquet.write_table(pa.table(columns), path)


def test_columns_lists_and_instants_of_a_table(folder):
    stamps = 1_700_000_000_000_000_000 + np.round(T * 1e9).astype(np.int64)
    speed = [None if row == 7 else value for row, value in enumerate(HIP_SPEED)]
    lists = pa.FixedSizeListArray.from_arrays(pa.array(DEGREES.reshape(-1)), 2)
    for q in (lists, pa.array(DEGREES.tolist())):
        write_parquet("log.parquet", t=pa.array(stamps).cast(pa.timestamp("ns")), q=q, w=speed, text=["a"] * N)
        run = run_of(folder, "log.parquet")
        np.testing.assert_allclose(run.channel("angle", "test").values, KNEE, atol=1e-12)
        np.testing.assert_allclose(run.channel("angle", "test").time, T, atol=1e-9)
        assert np.flatnonzero(np.isnan(run.channel("velocity", "test").values)).tolist() == [7]
        assert run.attributes["created"] == "2023-11-14T22:13:20Z"
        (folder / "out" / "log.h5").unlink()


def test_columns_that_are_no_numbers_are_no_hindrance(folder):
    ragged = [[1.0] * (row % 3) for row in range(N)]
    odd = {
        "day": pa.array([19000] * N).cast(pa.int32()).cast(pa.date32()),
        "span": pa.array([5] * N, pa.duration("us")),
    }
    odd |= {"nothing": pa.nulls(N), "bytes": [b"x"] * N, "ragged": ragged, "words": [["a", "b"]] * N}
    motor = pa.StructArray.from_arrays([pa.array(HIP), pa.array([True] * N)], ["speed", "on"])
    write_parquet("log.parquet", t=T, q=DEGREES.tolist(), motor=motor, **odd)
    run = run_of(folder, "log.parquet", PLAIN.replace("column: w", "column: motor.speed"))
    np.testing.assert_array_equal(run.channel("velocity", "test").values, HIP)
    (table,) = open_source(folder / "log.parquet", None, SourceRequest(None)).tables()
    assert [column.name for column in table.columns] == ["t", "q[0]", "q[1]", "motor.speed", "motor.on"]


def test_what_leactl_exports_comes_back(folder):
    np.savez("log.npz", t=T, q=DEGREES, w=HIP_SPEED)
    run_of(folder, "log.npz").close()
    export(folder / "out" / "log.h5", "parquet", folder)
    (table,) = open_source(folder / "log.loop.parquet", None, SourceRequest(None)).tables()
    assert [(column.name, column.units, column.quantity) for column in table.columns] == [
        ("time", "s", ""),
        ("q", "rad", "angle"),
        ("w", "rad/s", "velocity"),
    ]


def test_what_leactl_exports_says_whose_channels_they_are(folder):
    """Two drives with the same quantities; nothing but the file's metadata tells the load's."""
    head = RunInfo(
        run_id="20261121T100000Z-friction-0001", protocol="friction", bench="b: 1", actuator="lea-1",
        condition="design", operator="", simulated=True, mechanical="coupled", software="x",
        created="2026-11-21T10:00:00Z",
    )  # fmt: skip
    specs = [
        ChannelSpec("a", "q_axis_current", "test", "drive_1", sampling="mean"),
        ChannelSpec("b", "q_axis_current", "load", "drive_2"),
        ChannelSpec("c", "winding_temperature", "test", "camera", location="end turn", sampling=""),
        ChannelSpec("d", "winding_temperature", "test", "camera", location="slot"),
    ]
    with RunWriter(folder, head, {"loop": specs}) as writer:
        writer.append("loop", T, np.stack([HIP, HIP_SPEED, 20 + HIP, 21 + HIP], axis=1))
    (exported,) = export(writer.path, "parquet", folder)
    proposed = propose(survey(exported), {("mechanical",): "coupled"})
    assert proposed.questions == []
    run = run_of(folder, exported.name, proposed.text)
    taken = {spec.name: spec for spec in run.streams["loop"]}
    assert [(taken[spec.name].role, taken[spec.name].location, taken[spec.name].device) for spec in specs] == [
        (spec.role, spec.location, spec.device) for spec in specs
    ]
    assert [taken[spec.name].sampling for spec in specs] == ["mean", "instant", "", "instant"]
    np.testing.assert_allclose(run.channel("q_axis_current", "load").values, HIP_SPEED, rtol=1e-6)
    assert [str(run.attributes[name]) for name in ("protocol", "bench", "actuator", "condition")] == [
        "friction", "b: 1", "lea-1", "design",
    ]  # fmt: skip
    assert run.attributes["simulated"] == 1


def test_an_episode_of_lerobot_goes_by_the_names_of_its_motors(folder):
    episode = folder / "set" / "data" / "chunk-000" / "episode_000000.parquet"
    episode.parent.mkdir(parents=True)
    (folder / "set" / "meta").mkdir()
    names = ["shoulder_pan.pos", "elbow_flex.pos"]
    features = {"observation.state": {"names": names}, "action": {"names": {"motors": names}}}
    (folder / "set" / "meta" / "info.json").write_text(json.dumps({"fps": 100, "features": features}))
    state = pa.FixedSizeListArray.from_arrays(pa.array(DEGREES.reshape(-1).astype(np.float32)), 2)
    write_parquet(episode, **{"observation.state": state, "action": state, "timestamp": T})
    text = """
    mechanical: free
    streams:
      loop:
        time: {column: timestamp}
        channels:
          q: {column: "observation.state[{joint}]", quantity: angle, units: deg}
          goal: {column: "action[{joint}]", quantity: angle_reference, units: deg}
    """
    files = import_runs([str(episode)], mapping(folder, text), folder / "out", ["all"])
    assert [file.name for file in files] == ["episode_000000-shoulder_pan.pos.h5", "episode_000000-elbow_flex.pos.h5"]
    for file, angle in zip(files, (HIP, KNEE), strict=True):
        np.testing.assert_allclose(Run.open(file).channel("angle", "test").values, angle, atol=1e-6)


def test_a_table_that_swells_is_refused_unread(folder, monkeypatch):
    monkeypatch.setattr("leactl.runfile.importing.sources.formats.parquet.MOST_UNPACKED", (32, 1 << 10))
    write_parquet("log.parquet", t=np.zeros(1 << 20), w=np.zeros(1 << 20), q=np.zeros(1 << 20))
    assert "3145728 values in a file of" in fault(folder, "log.parquet")


def test_a_table_that_is_cut_or_none(folder):
    write_parquet("log.parquet", t=T, w=HIP_SPEED)
    whole = (folder / "log.parquet").read_bytes()
    for content in (b"", whole[:-1], whole[:200], b"t,q\n0,1\n" * 9):
        (folder / "bad.parquet").write_bytes(content)
        assert "bad.parquet: not a Parquet file that can be read" in fault(folder, "bad.parquet")
    assert "log.parquet has no 'q[1]'" in fault(folder, "log.parquet") or "'q'" in fault(folder, "log.parquet")
