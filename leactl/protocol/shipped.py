"""Find the protocols that ship with leactl."""

from importlib import resources
from pathlib import Path


def folder() -> Path:
    """Return the folder of the shipped protocols."""
    return Path(str(resources.files("leactl_protocols")))


def names() -> list[str]:
    """Return the names of the shipped protocols, sorted."""
    return sorted(path.stem for path in folder().glob("*.yaml"))
