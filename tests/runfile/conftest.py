"""A small run, shared by the tests of the run file."""

from pathlib import Path

import numpy as np
import pytest

from leactl.runfile.write.writer import RunWriter

from .specimen import STREAMS, info


@pytest.fixture
def complete(tmp_path: Path) -> Path:
    """A closed run: 1000 loop rows, 10 camera rows, two steps, one event."""
    with RunWriter(tmp_path, info(), STREAMS) as writer:
        for row in range(1000):
            writer.append_row("loop", row * 1e-3, [row * 0.01, row * 0.5, float("nan") if row == 500 else 1.0])
        writer.append("camera", np.arange(10.0), np.full((10, 2), 25.0))
        writer.step("hold", 0.0, 0.5, 0.1, {"current_A": 2.0, "note": "größer"})
        writer.step("hold", 0.5, 1.0, 0.1, {})
        writer.event(0.25, "warning", "supervisor", "x" * 2000)
    return writer.path
