"""The program, whole, in memory before the first child: each would else import it again, for ten times the time."""

import importlib
import pkgutil

import pytest

import leactl


@pytest.fixture(scope="session", autouse=True)
def whole_program():
    for module in pkgutil.walk_packages(leactl.__path__, "leactl."):
        if module.name.endswith("__main__"):
            continue
        try:
            importlib.import_module(module.name)
        except ModuleNotFoundError as missing:  # an extra's package that is not installed here
            if (missing.name or "").startswith("leactl"):
                raise
