"""A bench with wrong parameters and nothing else, made once for every file that asks for it."""

import pytest

from leactl.emulation.blind.make import make


@pytest.fixture(scope="session")
def sound_bench(tmp_path_factory):
    """Folder of its runs and its nominal model."""
    folder = tmp_path_factory.mktemp("sound")
    make(1, folder / "cases", folder / "key", 11, ("none",), strengths=("plain",), prefix="none")
    [case] = (path for path in (folder / "cases").iterdir() if path.is_dir())
    return case
