"""Checks of output files before a long computation."""

import os
import tempfile
from pathlib import Path

import pytest

from leactl.errors import InputError
from leactl.report.outputs import check_files


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can act as another user")
def test_a_file_in_a_folder_that_may_not_be_searched_is_refused():
    with tempfile.TemporaryDirectory() as place:  # open to its owner alone
        path = Path(place) / "sub" / "a.html"
        os.seteuid(65534)
        try:
            with pytest.raises(InputError) as refused:
                check_files([path], [])
        finally:
            os.seteuid(0)
    assert refused.value.faults == [f"{path}: cannot be written: Permission denied"]
