"""The protocols that ship with leactl: their names, their files, and what a list shows of each.

How long a protocol lasts is known only after expanding it, which takes longer than to show the list. `durations.json`
beside the files has it, by the digest of the file that was expanded: a file that was changed since is expanded again.
`python -m leactl.protocol.shipped` prints it anew.
"""

import hashlib
import json
from importlib import resources
from pathlib import Path
from typing import NamedTuple

from leactl import yamlfile

DURATIONS = "durations.json"


class Listed(NamedTuple):
    """What a list shows of a protocol."""

    name: str
    title: str
    setup: str
    duration_s: float


def folder() -> Path:
    """Where the protocols are."""
    return Path(str(resources.files("leactl_protocols")))


def names() -> list[str]:
    """Names of the protocols that ship with leactl."""
    return sorted(path.stem for path in folder().glob("*.yaml"))


def listed() -> list[Listed]:
    """Every protocol, in the order of names.

    Raises
    ------
    InputError : a file has faults.
    """
    known = _known_durations()
    return [_listed(folder() / f"{name}.yaml", known.get(name, {})) for name in names()]


def durations() -> dict[str, dict[str, str | float]]:
    """Digest and duration of every protocol, expanded afresh: the content of `durations.json`."""
    paths = [folder() / f"{name}.yaml" for name in names()]
    return {path.stem: {"sha256": _digest(path), "duration_s": _expanded(path).duration_s} for path in paths}


def _listed(path: Path, known: dict[str, str | float]) -> Listed:
    if known.get("sha256") != _digest(path):
        return _expanded(path)
    head = yamlfile.load(path).data
    return Listed(head["name"], head["title"], head["setup"], float(known["duration_s"]))


def _expanded(path: Path) -> Listed:
    from leactl.protocol.protocolfile import load

    plan = load(str(path))
    return Listed(plan.name, plan.title, plan.setup, plan.duration_s)


def _known_durations() -> dict[str, dict[str, str | float]]:
    path = folder() / DURATIONS
    return json.loads(path.read_text("utf-8")) if path.is_file() else {}


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


if __name__ == "__main__":
    print(json.dumps(durations(), indent=2))
