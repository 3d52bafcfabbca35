"""The program, whole, in memory before the first child: each would else import it again, for ten times the time."""

import pytest

from tests.cli.warm import import_all


@pytest.fixture(scope="session", autouse=True)
def whole_program():
    import_all()
