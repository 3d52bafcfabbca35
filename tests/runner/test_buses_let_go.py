"""Whatever ends a run, also what nobody foresaw: devices are safe and every bus is closed."""

from contextlib import nullcontext

import pytest
from leactl_plugins.ads1115.driver import Ads1115

from leactl.emulation.bench import emulated_bench
from leactl.runner import run_head, session
from leactl.runner.operators import confirm_at_once
from leactl.runner.request import prepare
from tests.runner.conftest import SPIN


@pytest.mark.parametrize(
    ("place", "name"),
    [(Ads1115, "open"), (run_head, "RunWriter"), (session, "introduce"), (run_head.RunWriter, "close")],
)
def test_an_error_that_nobody_foresaw_leaves_no_bus_open(tmp_path, monkeypatch, place, name):
    benches = []

    class Kept(emulated_bench.EmulatedBench):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            benches.append(self)

    def fail(*_args, **_kwargs):
        raise RuntimeError("unforeseen")

    monkeypatch.setattr(emulated_bench, "EmulatedBench", Kept)
    monkeypatch.setattr(place, name, fail)
    (tmp_path / "spin.yaml").write_text(SPIN)
    request = prepare(str(tmp_path / "spin.yaml"), "emulated", [], "", "", "", tmp_path / "runs", False)
    try:
        outcome = session.execute(request, confirm_at_once, lambda _progress: nullcontext())
    except RuntimeError as error:
        assert str(error) == "unforeseen"
    else:
        assert str(outcome.error) == "unforeseen"
    (bench,) = benches
    assert bench.wires["can0"].hosts == []
    assert [bench.far_ends[drive].state for drive in ("drive_test", "drive_load")] == ["disabled", "disabled"]
