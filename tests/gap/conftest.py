"""A bench with wrong parameters and nothing else, made once for every file that asks for it."""

import pytest

from tests.gap.emulated_cases import emulated_cases


@pytest.fixture(scope="session")
def sound_cases(tmp_path_factory):
    """Folders of its cases and its key."""
    return emulated_cases(tmp_path_factory, "sound")


@pytest.fixture(scope="session")
def sound_bench(sound_cases):
    """Folder of its runs and its nominal model."""
    [case] = (path for path in sound_cases.cases.iterdir() if path.is_dir())
    return case
