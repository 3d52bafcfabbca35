"""Summarise run files without reading their samples; the summary of an unreadable file holds the reason."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from leactl import yamlfile
from leactl.errors import InputError
from leactl.runfile import layout
from leactl.runfile.hdf5.chunks import last_value
from leactl.runfile.hdf5.opening import open_run_file, reading
from leactl.runfile.summary import Summary, is_run_name

TEXTS = (
    "run_id",
    "protocol",
    "actuator",
    "condition",
    "bench",
    "operator",
    "software",
    "status",
    "status_reason",
    "created",
)


def files_of(directory: Path) -> list[Path]:
    """Return the paths of the run files of a directory, sorted by name, without opening a file."""
    return [directory / name for name in sorted(path.name for path in directory.iterdir() if is_run_name(path.name))]


def summary(path: Path) -> Summary:
    """Summarise one run file; `fault` of the summary is not empty if the file cannot be read."""
    try:
        size = path.stat().st_size
    except OSError:  # a link without target, or a removed file, which `open_run_file` reports
        size = 0
    try:
        root: dict[str, Any] = {}
        file, _ = open_run_file(path, root, values=False)
        with file, reading(path):
            texts: dict[str, Any] = {name: str(root.get(name, "")) for name in TEXTS}
            streams = [group for group in file.get("streams", {}).values() if isinstance(group, h5py.Group)]
            times = [group["time"] for group in streams if "time" in group]
            return Summary(
                path.parent,
                path.name,
                size,
                **texts,
                experiment=analysis_in(protocol_text(file)) or texts["protocol"],
                mechanical=str(layout.attributes(file["setup"]).get("mechanical", "")) if "setup" in file else "",
                simulated=int(root.get("simulated") == 1),
                seed=value if isinstance(value := root.get("seed"), int) else None,
                duration=duration(times),
                rows=max((len(time) for time in times if is_column(time)), default=0),
                parameters=layout.parameters(file),
            )
    except InputError as fault:
        others_text = f" (and {len(fault.faults) - 1} more)" if len(fault.faults) > 1 else ""
        return Summary(path.parent, path.name, size, fault=fault.faults[0] + others_text)


def protocol_text(file: Any) -> str:
    """Return the YAML text of the protocol that the run used; empty if the file has no such scalar text."""
    source = file.get("protocol/source")
    if not isinstance(source, h5py.Dataset) or source.shape != () or not layout.is_text(source):
        return ""  # an array may be compressed, and `values=False` leaves its decompressed size unchecked
    return str(layout.to_python(source[()]))


@lru_cache(maxsize=64)  # thousands of runs in a folder share a few protocols
def analysis_in(protocol: str) -> str:
    """Return the key `analysis` of a protocol's YAML text; empty if it is absent or the text is no YAML.

    Faults are ignored because the run may have been written by another program.
    """
    try:
        data = yamlfile.parse(protocol).data
    except InputError:
        return ""
    analysis = data.get("analysis") if isinstance(data, dict) else None
    return analysis if isinstance(analysis, str) else ""


def duration(times: Sequence[Any]) -> float:
    """Return the largest finite last stamp of any stream [s]; 0 if there is none."""
    stamps = np.concatenate([*(last_value(time) for time in times if is_column(time)), np.zeros(1)])
    return float(stamps[np.isfinite(stamps)].max())


def is_column(item: Any) -> bool:
    """Return whether an HDF5 object is a one-dimensional dataset of numbers."""
    return isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu" and item.ndim == 1


def run_files(paths: Sequence[Path]) -> list[Path]:
    """Return run files in the order given; a folder stands for the run files in it.

    Raises
    ------
    InputError : one line for each path without a run file, or no path was given.
    """
    faults, files = [], []
    for path in paths:
        try:
            members = files_of(path) if path.is_dir() else [path]
        except OSError as fault:
            faults.append(f"{path}: cannot be read: {fault.strerror or fault}")
            continue
        files += members
        if not path.exists():
            faults.append(f"{path}: no such file or folder")
        elif not members:
            faults.append(f"{path}: no run files in this folder")
    if not paths:
        faults.append("no runs; give run files, or folders of them")
    if faults:
        raise InputError(faults)
    return files
