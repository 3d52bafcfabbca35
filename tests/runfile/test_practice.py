"""Files made elsewhere to the same contract open here."""

from pathlib import Path

import numpy as np
import pytest

from leactl.runfile.catalog.run_index import list_runs
from leactl.runfile.read.reader import Run


def practice_runs() -> list[Path]:
    for parent in Path(__file__).resolve().parents:
        cases = parent.parent / "shared" / "gap-cases" / "practice"
        if cases.is_dir():
            return sorted(cases.glob("*/*.h5"))
    return []


@pytest.mark.long
@pytest.mark.skipif(not practice_runs(), reason="the practice files (../shared/gap-cases) are not on this machine")
def test_every_practice_file_opens():
    for path in practice_runs():
        with Run.open(path) as run:
            assert run.status == "complete"
            assert run.mechanical in ("free", "locked", "coupled", "heated")
            for specs in run.streams.values():
                for spec in specs:
                    for channel in run.channels(spec.quantity, spec.role):
                        assert np.isfinite(channel.time).all()
                        assert len(channel.time) == len(channel.values)
            assert run.source("model")
    assert not [entry.fault for entry in list_runs(practice_runs()[0].parent) if entry.fault]
