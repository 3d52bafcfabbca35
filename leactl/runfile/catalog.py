"""List the runs of a directory without reading their data; a file that cannot be read is listed with its reason."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from leactl.errors import InputError
from leactl.runfile import layout
from leactl.runfile.opening import open_run_file, reading
from leactl.runfile.packing import last_value


@dataclass(frozen=True)
class Summary:
    """One line of the list; where `fault` is not empty, only `path` and `size` are known."""

    path: Path
    size: int  # bytes
    run_id: str = ""
    protocol: str = ""
    actuator: str = ""
    condition: str = ""
    bench: str = ""
    operator: str = ""
    status: str = ""
    created: str = ""
    seed: int | None = None  # of an emulated bench, where the file has it
    parameters: Mapping[str, Any] = field(default_factory=dict)  # of the protocol, with the values that were used
    duration: float = 0.0  # s, up to the last stamp of any stream
    fault: str = ""

    @property
    def file(self) -> str:
        """Its name without the folder."""
        return self.path.name

    def as_json(self) -> dict[str, Any]:
        """Everything that is known of it."""
        return vars(self) | {"path": str(self.path), "file": self.file}


def list_runs(directory: Path) -> list[Summary]:
    """Every run file of a directory, oldest first as their names sort."""
    if not directory.is_dir():
        raise InputError(f"{directory}: not a directory")
    return [summary(path) for path in files_of(directory)]


def files_of(directory: Path) -> list[Path]:
    """The run files of a directory by their names, none of them opened."""
    names = [path for path in directory.iterdir() if path.name.endswith((".h5", ".h5.partial"))]
    return [path for path in sorted(names) if not path.name.startswith(".")]


def summary(path: Path) -> Summary:
    """Summary of one file."""
    size = path.stat().st_size if path.exists() else 0  # of a link that leads nowhere
    try:
        root: dict[str, Any] = {}
        file, _ = open_run_file(path, root, values=False)
        with file, reading(path):
            keys = ("run_id", "protocol", "actuator", "condition", "bench", "operator", "status", "created")
            known = {key: str(root.get(key, "")) for key in keys}
            seed = value if isinstance(value := root.get("seed"), int) else None
            return Summary(path, size, **known, seed=seed, parameters=layout.parameters(file), duration=duration(file))
    except InputError as fault:
        more = f" (and {len(fault.faults) - 1} more)" if len(fault.faults) > 1 else ""
        return Summary(path, size, fault=fault.faults[0] + more)


def duration(file: Any) -> float:
    """The last stamp of any stream."""
    groups = [group for group in file.get("streams", {}).values() if isinstance(group, h5py.Group)]
    times = [group["time"] for group in groups if "time" in group]
    last = [
        last_value(time)
        for time in times
        if isinstance(time, h5py.Dataset) and time.dtype.kind in "fiu" and time.ndim == 1
    ]
    stamps = np.concatenate([*last, np.zeros(1)])
    return float(stamps[np.isfinite(stamps)].max())


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
