"""List the protocols that ship with leactl, with title, set-up and duration.

The duration of a protocol is known only after its expansion, which would slow down the list. The file `durations.json`
in the folder of the protocols therefore has the duration and the digest of each protocol; a protocol with another
digest is expanded again. `python -m leactl.protocol.listing` prints a new content of `durations.json`.
"""

import hashlib
import json
from pathlib import Path
from typing import NamedTuple

from leactl import yamlfile
from leactl.protocol import shipped

DURATIONS = "durations.json"


class ListedProtocol(NamedTuple):
    """Entry of a protocol in the list."""

    name: str
    title: str
    setup: str
    duration_s: float


def listed_protocols() -> list[ListedProtocol]:
    """Return the entry of every shipped protocol, sorted by name.

    Raises
    ------
    InputError : a file has faults.
    """
    durations_by_name = _known_durations()
    return [_listed(shipped.folder() / f"{name}.yaml", durations_by_name.get(name, {})) for name in shipped.names()]


def durations() -> dict[str, dict[str, str | float]]:
    """Expand every shipped protocol and return its digest and duration, the content of `durations.json`."""
    paths = [shipped.folder() / f"{name}.yaml" for name in shipped.names()]
    return {path.stem: {"sha256": _digest(path), "duration_s": _expanded(path).duration_s} for path in paths}


def _listed(path: Path, stored: dict[str, str | float]) -> ListedProtocol:
    """Return the entry of a protocol, with the stored duration if the stored digest is that of the file."""
    if stored.get("sha256") != _digest(path):
        return _expanded(path)
    keys = yamlfile.load(path).data
    return ListedProtocol(keys["name"], keys["title"], keys["setup"], float(stored["duration_s"]))


def _expanded(path: Path) -> ListedProtocol:
    """Return the entry of a protocol with the duration of its expanded plan."""
    from leactl.protocol.protocolfile import load

    plan = load(str(path))
    return ListedProtocol(plan.name, plan.title, plan.setup, plan.duration_s)


def _known_durations() -> dict[str, dict[str, str | float]]:
    """Return the content of `durations.json`; empty if there is no such file."""
    path = shipped.folder() / DURATIONS
    return json.loads(path.read_text("utf-8")) if path.is_file() else {}


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


if __name__ == "__main__":
    print(json.dumps(durations(), indent=2))
