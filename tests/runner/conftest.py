"""Short runs on the emulated bench, with things going wrong at a chosen moment behind the wires."""

from contextlib import nullcontext

import pytest

from leactl.emulation.bench import emulated_bench
from leactl.runner.operators import confirm_at_once
from leactl.runner.request import prepare
from leactl.runner.session import execute

SPIN = """
name: spin
setup: free
rate_Hz: 100
parameters: {current_A: 0.7, hold_s: 0.6, trials: 1}
steps:
  - mode: {test: current}
  - hold: {role: test, current_A: 1.0, duration_s: 0.2}
  - hold: {role: test, current_A: $current_A, duration_s: $hold_s, settle_s: 0.1}
  - mode: {test: "off"}
"""


@pytest.fixture(autouse=True)
def own_state(tmp_path, monkeypatch):
    """Latches go to a directory of the test."""
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))


@pytest.fixture
def spin(tmp_path, monkeypatch):
    """Run `spin` or another text; `at` is a list of (second, action on the emulated bench)."""

    def run(
        text=SPIN,
        *,
        at=(),
        sets=("seed=3",),
        condition="design",
        bench="emulated",
        operator=confirm_at_once,
        watch=lambda _progress: nullcontext(),
        out=tmp_path / "runs",
        realtime=False,
        stops=(),
        pauses=(),
    ):
        path = tmp_path / "protocol.yaml"
        path.write_text(text)
        benches = []

        class Rehearsed(emulated_bench.EmulatedBench):
            def __init__(self, *args, **kwargs):
                super().__init__(*args, **kwargs)
                self.coming = sorted(at, key=lambda pair: pair[0])
                self.time.follow(self.happen)
                self.happen(0.0)
                benches.append(self)

            def happen(self, now):
                while self.coming and self.coming[0][0] <= now:
                    self.coming.pop(0)[1](self)

        monkeypatch.setattr(emulated_bench, "EmulatedBench", Rehearsed)
        request = prepare(str(path), bench, sets, "a1", condition, "", out, realtime)
        outcome = execute(request, operator, watch, stops, pauses)
        return outcome, benches[0]

    return run
