"""A bench with wrong parameters and nothing else, made once for every file that asks for it."""

import fcntl
import os
from types import SimpleNamespace

import pytest

from leactl.emulation.blind.make import make


@pytest.fixture(scope="session")
def sound_cases(tmp_path_factory):
    """Folders of its cases and its key; workers that run side by side make it once."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "sound"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # until whoever came first has made it
        if not (folder / "whole").exists():
            make(1, folder / "cases", folder / "key", 11, ("none",), strengths=("plain",), prefix="none")
            (folder / "whole").touch()
    return SimpleNamespace(cases=folder / "cases", key=folder / "key")


@pytest.fixture(scope="session")
def sound_bench(sound_cases):
    """Folder of its runs and its nominal model."""
    [case] = (path for path in sound_cases.cases.iterdir() if path.is_dir())
    return case
