"""The four control-loop experiments on the emulated bench, by the path of `leactl run`, against its true loops."""

import math
from contextlib import nullcontext

import pytest

from leactl.analysis.analyze import analyze_runs
from leactl.bench import benchfile
from leactl.emulation.bench import emulated_bench
from leactl.runner.operators import confirm_at_once
from leactl.runner.request import prepare
from leactl.runner.session import execute
from tests.coverage_of_intervals.plant import WatchedRig, current_loop_bandwidth
from tests.loops import current_figures

SAMPLE_S = 1e-3
LOOPS = benchfile.load("emulated")[0].emulated.bench


@pytest.fixture
def estimates(tmp_path, monkeypatch):
    """Run a shipped protocol and analyse it: the estimates by name, and the plant that was run."""
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))

    def run(name, *sets):
        rigs = []

        class Kept(WatchedRig):
            def __init__(self, *arguments, **settings):
                super().__init__(*arguments, **settings)
                rigs.append(self)

        if name.endswith("step"):
            monkeypatch.setattr(emulated_bench, "Rig", Kept)
        request = prepare(name, "emulated", ["seed=1", *sets], "a1", "design", "", tmp_path, realtime=False)
        outcome = execute(request, confirm_at_once, lambda _progress: nullcontext())
        assert outcome.error is None
        return {item.name: item for item in analyze_runs([outcome.path]).results}, rigs

    return run


@pytest.mark.long
def test_current_steps_give_the_figures_of_the_loop(estimates):
    found, _ = estimates("current-step", "trials=2")
    truth = current_figures(
        *(LOOPS[name] for name in ("current_loop_bandwidth", "setpoint_lead", "setpoint_lead_time"))
    )
    assert found["rise_time"].value == pytest.approx(truth.rise_time, abs=SAMPLE_S)
    assert found["overshoot"].value == pytest.approx(truth.overshoot, rel=0.05)
    assert found["settling_time"].value == pytest.approx(truth.settling_time, rel=0.05)
    assert abs(found["steady_state_error"].value) < 0.1


@pytest.mark.long
def test_position_steps_give_the_figures_of_the_plant_that_was_run(estimates):
    found, (rig,) = estimates("position-step", "trials=1")
    truth = rig.figures()
    assert found["rise_time"].value == pytest.approx(truth.rise_time, abs=SAMPLE_S)
    assert found["overshoot"].value == pytest.approx(truth.overshoot, rel=0.05)
    assert found["settling_time"].value == pytest.approx(truth.settling_time, rel=0.05)
    assert abs(found["steady_state_error"].value) < 0.1


def test_the_loops_are_those_of_the_paper(estimates):
    """Position: the plant's own figures in the first trial; noise: the page control-loops has the true 7.5 Hz."""
    current = current_figures(
        *(LOOPS[name] for name in ("current_loop_bandwidth", "setpoint_lead", "setpoint_lead_time"))
    )
    assert vars(current) == pytest.approx({"rise_time": 1.0e-3, "overshoot": 8.3, "settling_time": 0.090}, rel=1e-3)
    found, _ = estimates("position-noise", "trials=1", "trial_s=5.1")
    assert found["bandwidth"].value == pytest.approx(7.5, rel=0.05)


@pytest.mark.long
def test_a_current_loop_beyond_its_noise_has_a_lower_bound(estimates):
    bandwidth = estimates("current-noise", "trials=1", "subtrials=1", "trial_s=4.1")[0]["bandwidth"]
    assert math.isnan(bandwidth.value)
    assert 200 < bandwidth.low <= 218 + 1
    assert bandwidth.low < current_loop_bandwidth(LOOPS)
