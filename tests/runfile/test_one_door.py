"""No part of the program opens a stranger's HDF5 file but the one that looks at its links and sizes first."""

import ast
from pathlib import Path

import leactl_plugins

import leactl

# what each of these opens it has just written itself, under a name of its own
OWN = {
    ("runfile/verify/conversion.py", "w"),
    ("runfile/verify/integrity.py", "r+"),  # a copy of a run that has passed the door
    ("runfile/write/repack.py", "x"),
    ("runfile/write/writer.py", "r"),  # the live file of the run that it closes
    ("runfile/write/writer.py", "r+"),  # its copy where the file's folder vanished
    ("runfile/write/writer.py", "x"),
}
DOOR = {("runfile/hdf5/opening.py", "r")}
ROOTS = [Path(package.__file__).parent for package in (leactl, leactl_plugins)]
BUILDS = {
    "runfile/read/xarray_dataset.py",
    "runfile/read/reader.py",
}  # a dataset of what was read, and its type; neither opens one
OTHER_WAYS = ("h5open", "netCDF4", "xarray", "tables", "h5netcdf", "pandas")


def calls_of(tree):
    """Calls of `h5py.File`, `h5py.h5f.open` and the like, with the mode that is given."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("h5py.File", "File", "h5py.h5f.open", "h5f.open"):
            given = [*node.args[1:2], *(word.value for word in node.keywords if word.arg == "mode")]
            yield ast.literal_eval(given[0]) if given else "r"


def imported(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{name.name}" for name in node.names)


def test_every_file_is_opened_at_the_door():
    opened, elsewhere = set(), []
    for root in ROOTS:
        for path in root.rglob("*.py"):
            tree, name = ast.parse(path.read_text(encoding="utf-8")), path.relative_to(root).as_posix()
            opened |= {(name, mode) for mode in calls_of(tree)}
            ways = [word for word in imported(tree) if word.split(".")[0] in OTHER_WAYS]
            elsewhere += [(name, word) for word in ways if not (word == "xarray" and name in BUILDS)]
            used = [ast.unparse(node) for node in ast.walk(tree) if isinstance(node, ast.Attribute)]
            elsewhere += [(name, word) for word in used if word.startswith("xarray.") and word != "xarray.Dataset"]
            elsewhere += [(name, word) for word in imported(tree) if word in ("h5py.File", "h5py.h5f")]
    assert opened == OWN | DOOR
    assert elsewhere == []
