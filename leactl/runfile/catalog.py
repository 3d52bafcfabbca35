"""List the runs of a directory without reading their data; a file that cannot be read is listed with its reason."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from leactl.errors import InputError
from leactl.runfile import layout
from leactl.runfile.opening import open_run_file, reading


@dataclass(frozen=True)
class Summary:
    """One line of the list; where `fault` is not empty, only `path` and `size` are known."""

    path: Path
    size: int  # bytes
    run_id: str = ""
    protocol: str = ""
    actuator: str = ""
    condition: str = ""
    status: str = ""
    created: str = ""
    duration: float = 0.0  # s, up to the last stamp of any stream
    fault: str = ""


def list_runs(directory: Path) -> list[Summary]:
    """Every run file of a directory, oldest first as their names sort."""
    if not directory.is_dir():
        raise InputError(f"{directory}: not a directory")
    names = [path for path in directory.iterdir() if path.name.endswith((".h5", ".h5.partial"))]
    return [summary(path) for path in sorted(names) if not path.name.startswith(".")]


def summary(path: Path) -> Summary:
    """Summary of one file."""
    size = path.stat().st_size
    try:
        file, _ = open_run_file(path)
        with file, reading(path):
            root = layout.attributes(file)
            keys = ("run_id", "protocol", "actuator", "condition", "status", "created")
            known = {key: str(root.get(key, "")) for key in keys}
            return Summary(path, size, **known, duration=duration(file))
    except InputError as fault:
        return Summary(path, size, fault=str(fault))


def duration(file: Any) -> float:
    """The last stamp of any stream."""
    groups = [group for group in file.get("streams", {}).values() if isinstance(group, h5py.Group)]
    stamps = np.concatenate([*(group["time"][-1:] for group in groups if "time" in group), np.zeros(1)])
    return float(stamps[np.isfinite(stamps)].max())
