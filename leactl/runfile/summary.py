"""Define the summary of a run for lists: plain values without HDF5, which can be stored, sent and compared."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

RECORDING: Final = "recording"
CLOSED_STATUSES: Final = ("complete", "stopped", "tripped", "failed")
STATUSES: Final = (RECORDING, *CLOSED_STATUSES, "recovered")


class Summary(NamedTuple):
    """Summary of one run file; if `fault` is not empty, only `folder`, `file` and `size` are known."""

    folder: Path
    file: str  # file name in the folder
    size: int  # bytes
    run_id: str = ""
    protocol: str = ""
    experiment: str = ""  # analysis that the protocol names, else the protocol's name
    actuator: str = ""
    condition: str = ""
    bench: str = ""
    operator: str = ""
    mechanical: str = ""
    simulated: int = 0  # 1 where the bench was emulated
    software: str = ""
    status: str = ""
    status_reason: str = ""
    created: str = ""
    seed: int | None = None  # of an emulated bench; None if the file has none
    duration: float = 0.0  # s, up to the last stamp of any stream
    rows: int = 0  # of the longest stream
    fault: str = ""
    parameters: Mapping[str, Any] = {}  # of the protocol, with the values that were used
    tags: tuple[str, ...] = ()

    @property
    def path(self) -> Path:
        """The run file."""
        return self.folder / self.file

    def as_json(self) -> dict[str, Any]:
        """Return all fields as a JSON object."""
        values = self._asdict()
        del values["folder"]
        plain_values = {"parameters": dict(self.parameters), "tags": list(self.tags)}
        return {"path": str(self.path)} | values | plain_values


def is_run_name(name: str) -> bool:
    """Return whether a file name is that of a run file."""
    return name.endswith((".h5", ".h5.partial")) and not name.startswith(".")
