"""Describe run files without reading their data; a file that cannot be read is described by the reason."""

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
    """The run files of a directory by their names, none of them opened."""
    return [directory / name for name in sorted(path.name for path in directory.iterdir() if is_run_name(path.name))]


def summary(path: Path) -> Summary:
    """Summary of one file."""
    try:
        size = path.stat().st_size
    except OSError:  # a link that leads nowhere, or removed meanwhile: the door says so
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
                experiment=asked_in(protocol_text(file)) or texts["protocol"],
                mechanical=str(layout.attributes(file["setup"]).get("mechanical", "")) if "setup" in file else "",
                simulated=int(root.get("simulated") == 1),
                seed=value if isinstance(value := root.get("seed"), int) else None,
                duration=duration(times),
                rows=max((len(time) for time in times if is_column(time)), default=0),
                parameters=layout.parameters(file),
            )
    except InputError as fault:
        more = f" (and {len(fault.faults) - 1} more)" if len(fault.faults) > 1 else ""
        return Summary(path.parent, path.name, size, fault=fault.faults[0] + more)


def protocol_text(file: Any) -> str:
    """The protocol's YAML as it was used; empty where the file has none as a single text."""
    source = file.get("protocol/source")
    if not isinstance(source, h5py.Dataset) or source.shape != () or not layout.is_text(source):
        return ""  # an array may be packed, and nobody has looked at what it unpacks to
    return str(layout.plain(source[()]))


@lru_cache(maxsize=64)  # a folder of thousands has runs of a few protocols
def asked_in(protocol: str) -> str:
    """`analysis` of a protocol's text; empty where it has none.

    A text that cannot be read counts as none, since the run may come from elsewhere.
    """
    try:
        data = yamlfile.parse(protocol).data
    except InputError:
        return ""
    named = data.get("analysis") if isinstance(data, dict) else None
    return named if isinstance(named, str) else ""


def duration(times: Sequence[Any]) -> float:
    """The last stamp of any stream."""
    stamps = np.concatenate([*(last_value(time) for time in times if is_column(time)), np.zeros(1)])
    return float(stamps[np.isfinite(stamps)].max())


def is_column(item: Any) -> bool:
    """Whether it is a dataset of numbers, one after the other."""
    return isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu" and item.ndim == 1


def run_files(given: Sequence[Path]) -> list[Path]:
    """Return run files, those of folders included, in the order in which they are given.

    Raises
    ------
    InputError : one line for each path that leads to none.
    """
    faults, paths = [], []
    for path in given:
        try:
            members = files_of(path) if path.is_dir() else [path]
        except OSError as fault:
            faults.append(f"{path}: cannot be read: {fault.strerror or fault}")
            continue
        paths += members
        if not path.exists():
            faults.append(f"{path}: no such file or folder")
        elif not members:
            faults.append(f"{path}: no run files in this folder")
    if not given:
        faults.append("no runs; give run files, or folders of them")
    if faults:
        raise InputError(faults)
    return paths
