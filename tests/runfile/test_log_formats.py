"""A format is a file: found by its folder or entry point, and nothing else knows its name."""

import re
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from leactl.errors import InputError
from leactl.runfile.importing.importer import import_runs
from leactl.runfile.importing.sources import registry
from leactl.runfile.importing.sources.source import ListedColumn, ListedTable, MissingColumn
from leactl.runfile.importing.sources.trees import TreeSource
from leactl.runfile.read.reader import Run

from . import logs
from .test_import import ANGLE, SPEED, T, mapping, write_csv
from .test_import_faults import PLAIN
from .test_import_mcap import BY_JOINT

ROOM = {"csv", "json", "mat", "mcap", "npz", "parquet", "ros2", "sysid", "wpilog"}


class HexSource(TreeSource):
    def tables(self):
        return [ListedTable(None, (ListedColumn("q"),))]


def open_hex(path, request):
    values = np.frombuffer(bytes.fromhex(path.read_text()), "<f8")
    return HexSource(path, {"t": np.arange(len(values)) * 0.01, "q": values, "w": values})


def test_keys_with_dots_are_one_name_wherever_they_stand():
    nested = [{"motor.left": {"q": 1.0}}, {"motor.left": {"q": 2.0}}]
    source = TreeSource(
        Path("log.json"), {"rows": nested, "left.knee": {"a.b": {"q": [1.0, 2.0, 3.0]}}, "": [4.0, 5.0]}
    )
    for table in source.tables():
        for column in table.columns:
            assert len(source.column(column.name, table.records)) in (2, 3)
    assert source.column("motor.left.q", "rows").tolist() == [1.0, 2.0]
    assert source.column("q", "left.knee.a.b").tolist() == [1.0, 2.0, 3.0]
    assert source.column("", None).tolist() == [4.0, 5.0]


def test_keys_with_dots_are_one_name_in_records_and_groups():
    records = [{"motor.current": 1.0, "t": 0.0}, {"motor.current": 2.0, "t": 0.1}]
    source = TreeSource(Path("log.json"), {"rows": records, "left.knee": {"q": [1.0, 2.0, 3.0]}})
    columns = {table.records: [column.name for column in table.columns] for table in source.tables()}
    assert columns == {"rows": ["motor.current", "t"], "left.knee": ["q"]}
    for place, names in columns.items():
        for name in names:
            assert len(source.column(name, place)) == len(source.column(names[-1], place))
    np.testing.assert_array_equal(source.column("motor.current", "rows"), [1.0, 2.0])


def test_a_list_of_lists_of_different_lengths_is_taken_apart():
    source = TreeSource(Path("log.json"), {"x": [[1.0, 2.0], [3.0]]})
    assert [source.column(name, None).tolist() for name in ("x[0]", "x[1]")] == [[1.0, 2.0], [3.0]]


@pytest.mark.parametrize(
    ("name", "records", "text"),
    [("x[0]", None, "x has no item 0; it is an array of shape ()"), (-1, "m", "m has no column -1")],
)
def test_an_item_that_is_not_there_is_told_with_what_is(name, records, text):
    source = TreeSource(Path("log.npz"), {"x": np.array(1.0), "m": np.zeros((4, 2))})
    with pytest.raises(MissingColumn, match=re.escape(text)):
        source.column(name, records)


def point(name, load):
    return SimpleNamespace(name=name, load=load, dist=SimpleNamespace(name="other", version="2.0"))


@pytest.fixture
def foreign(monkeypatch):
    def given(*points):
        monkeypatch.setattr(registry, "entry_points", lambda group: points)

    return given


def test_the_shipped_formats_are_their_files():
    assert registry.shipped() == ROOM
    for name in ROOM:
        loaded = registry.load(name)
        assert callable(loaded.open_source)
        assert all(ending.startswith(".") and ending == ending.lower() for ending in loaded.ENDINGS)


def test_a_format_of_another_package_needs_no_edit(tmp_path, monkeypatch, foreign):
    monkeypatch.chdir(tmp_path)
    foreign(point("hexlog", lambda: SimpleNamespace(ENDINGS=(".hex",), open_source=open_hex)))
    (tmp_path / "a.hex").write_text(ANGLE.astype("<f8").tobytes().hex())
    for text in (PLAIN, "format: hexlog\n" + PLAIN):
        (file,) = import_runs(["a.hex"], mapping(tmp_path, text), tmp_path / f"out{len(text)}")
        np.testing.assert_array_equal(Run.open(file).channel("angle").values, ANGLE)


@pytest.mark.parametrize(
    ("load", "why"),
    [
        (lambda: 1 / 0, "ZeroDivisionError: division by zero"),
        (lambda: SimpleNamespace(ENDINGS=(".hex",)), "it has no tuple ENDINGS or no open_source"),
    ],
)
def test_a_format_that_does_not_load_harms_no_other(tmp_path, monkeypatch, foreign, load, why):
    monkeypatch.chdir(tmp_path)
    foreign(point("hexlog", load))
    write_csv(tmp_path / "a.csv", {"t": T, "q": ANGLE, "w": SPEED})
    import_runs(["a.csv"], mapping(tmp_path, PLAIN), tmp_path / "out")
    with pytest.raises(InputError) as caught:
        import_runs(["a.csv"], mapping(tmp_path, "format: hexlog\n" + PLAIN), tmp_path / "other")
    assert caught.value.faults == [f"format 'hexlog' of other 2.0 cannot be used: {why}"]


def test_a_missing_package_names_its_extra(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    logs.write_mcap(tmp_path / "log.mcap", range(5))
    for module in ("mcap.reader", "pyarrow"):
        monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / "log.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"log.mcap: needs mcap and rosbags: pip install 'leactl\[ros\]'"):
        import_runs(["log.mcap"], mapping(tmp_path, BY_JOINT), tmp_path / "out", ["hip"])
    with pytest.raises(InputError, match=r"Parquet needs pyarrow: pip install 'leactl\[parquet\]'"):
        import_runs(["log.parquet"], mapping(tmp_path, PLAIN), tmp_path / "out")


def test_sysid_is_recognised_by_its_tests_and_json_stays_json(tmp_path):
    (tmp_path / "a.json").write_text('{"fast-backward": [[0, 1, 2, 3], [1, 1, 2, 3]], "sysid": true}')
    (tmp_path / "b.json").write_text('{"q": [1, 2]}')
    assert registry.format_of(tmp_path / "a.json") == "sysid"
    assert registry.format_of(tmp_path / "b.json") == "json"
    with pytest.raises(InputError, match="the ending does not tell its format; give `format:` as one of csv, json"):
        registry.format_of(tmp_path / "c.xyz")


SYSID = """
mechanical: free
joints: all
streams:
  loop:
    records: "{joint}"
    time: {column: time_s}
    channels:
      u: {column: voltage_V, quantity: q_axis_voltage}
      q: {column: position, quantity: angle, units: turn}
"""


def test_each_test_of_sysid_is_a_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = np.stack([T + 3, SPEED, ANGLE / (2 * np.pi), SPEED], 1).tolist()
    (tmp_path / "a.json").write_text(f'{{"fast-backward": {rows[:50]}, "fast-forward": [], "slow-forward": {rows}}}')
    files = import_runs(["a.json"], mapping(tmp_path, SYSID), tmp_path / "out")
    assert [file.name for file in files] == ["a-slow-forward.h5", "a-fast-backward.h5"]
    np.testing.assert_allclose(Run.open(files[0]).channel("angle").values, ANGLE, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('{"slow-forward": []}', "a.json: none of slow-forward, slow-backward, fast-forward, fast-backward has a row"),
        ('{"slow-forward": [[1, 2], [3, 4]]}', "a.json: slow-forward: rows of 4 or 9 numbers were expected"),
        ('{"slow-forward": [[1, 2, 3, 4], 5]}', "a.json: slow-forward: rows of 4 or 9 numbers were expected"),
        ('{"slow-forward": "x"}', "a.json: slow-forward: rows of 4 or 9 numbers were expected"),
        ('{"slow-forward": [[0, 1, "x", 2], [1, 2, 3, 4]]}', "a.json: 'position' row 0: 'x' is not a number"),
    ],
)
def test_a_sysid_file_of_another_form_is_one_line(tmp_path, monkeypatch, text, told):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(InputError) as caught:
        import_runs(["a.json"], mapping(tmp_path, SYSID), tmp_path / "out")
    assert told in caught.value.faults[0]
