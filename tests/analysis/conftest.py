"""A place for synthetic runs."""

import pytest

from .synthetic import Bench


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)
