"""Exports hold the same values, never overwrite and never leave half a file."""

import csv
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from pyarrow import parquet
from scipy.io import loadmat

from leactl.errors import InputError
from leactl.runfile.export import export, matlab_fields
from leactl.runfile.read.reader import Run

from .specimen import unseal


def test_csv_reads_back_exactly(complete: Path, tmp_path: Path):
    written = export(complete, "csv", tmp_path / "out")
    assert sorted(path.name for path in written) == [f"{complete.stem}.camera.csv", f"{complete.stem}.loop.csv"]
    loop = next(path for path in written if "loop" in path.name)
    with loop.open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["time [s]", "iq [A]", "theta [rad]", "a_torque [N*m]"]
    with Run.open(complete) as run:
        current = run.channel("q_axis_current")
    np.testing.assert_array_equal([float(row[0]) for row in rows], current.time)
    np.testing.assert_array_equal(np.array([row[1] for row in rows], "f4").astype("f8"), current.values)
    assert rows[500][3] == "nan"


@pytest.mark.parametrize("name", ["=cmd|' C'!A0", "+1", "-1", "@SUM(A1)"])
def test_no_heading_is_a_formula(complete: Path, tmp_path: Path, name: str):
    with h5py.File(complete, "r+") as file:
        unseal(file)
        file.move("streams/loop/iq", f"streams/loop/{name}")
    loop = next(path for path in export(complete, "csv", tmp_path / "out") if "loop" in path.name)
    with loop.open(newline="") as file:
        header = next(csv.reader(file))
    assert f"'{name} [A]" in header
    assert not any(cell.startswith(tuple("=+-@")) for cell in header)


def test_a_heading_is_one_cell_of_one_row(complete: Path, tmp_path: Path):
    with h5py.File(complete, "r+") as file:
        unseal(file)
        file.move("streams/loop/iq", "streams/loop/a\r=1\n=2\t=3")
    loop = next(path for path in export(complete, "csv", tmp_path / "out") if "loop" in path.name)
    assert "a\ufffd=1\ufffd=2\ufffd=3 [A]" in loop.read_text(encoding="utf-8").splitlines()[0].split(",")


def test_mat_holds_structs(complete: Path, tmp_path: Path):
    (written,) = export(complete, "mat", tmp_path)
    content = loadmat(written, simplify_cells=True)
    assert content["run"]["run_id"] == complete.stem
    assert content["streams"]["loop"]["iq"]["units"] == "A"
    assert content["streams"]["loop"]["theta"]["values"][2] == 1.0
    assert content["steps"][0]["name"] == "hold"
    assert content["setup"]["mechanical"] == "coupled"


def test_names_that_matlab_cannot_tell_apart_are_numbered():
    assert list(matlab_fields(dict.fromkeys(("a b", "a.b", "a-b", "a/b"), 0))) == ["a_b", "a_b_2", "a_b_3", "a_b_4"]
    assert list(matlab_fields({"x" * 70: 0, "x" * 80: 0})) == ["x" * 63, "x" * 59 + "_2"]


def test_parquet_holds_units(complete: Path, tmp_path: Path):
    written = export(complete, "parquet", tmp_path)
    table = parquet.read_table(next(path for path in written if "loop" in path.name))
    assert table.num_rows == 1000
    assert table.schema.field("a_torque").metadata[b"units"] == b"N*m"
    assert table.schema.metadata[b"run_id"].decode() == complete.stem
    assert table["theta"][3].as_py() == 1.5


def test_parquet_without_pyarrow_says_what_to_install(complete: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"leactl\[parquet\]"):
        export(complete, "parquet", tmp_path)


def test_parquet_with_a_pyarrow_that_does_not_load_says_why(
    complete: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    package = tmp_path / "site"
    package.mkdir()
    (package / "pyarrow.py").write_text('raise ImportError("pyarrow requires NumPy 2.0 or newer, found 1.26.0")')
    monkeypatch.syspath_prepend(package)
    monkeypatch.delitem(sys.modules, "pyarrow")
    with pytest.raises(InputError, match="cannot be loaded: pyarrow requires NumPy"):
        export(complete, "parquet", tmp_path / "out")


@pytest.mark.parametrize("fmt", ["csv", "mat", "parquet"])
def test_an_existing_export_is_kept(complete: Path, tmp_path: Path, fmt: str):
    out = tmp_path / "out"
    kept = export(complete, fmt, out)[-1]
    for path in out.iterdir():
        if path != kept:
            path.unlink()
    kept.write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        export(complete, fmt, out)
    assert list(out.iterdir()) == [kept]
    assert kept.read_text() == "mine"


def test_an_unknown_format_is_refused(complete: Path, tmp_path: Path):
    with pytest.raises(InputError, match="csv, mat, parquet"):
        export(complete, "xlsx", tmp_path)
