"""Results of a bench of another size are the same, scaled: none rests on a constant with a unit."""

import math

import numpy as np
import pytest

from leactl.analysis.experiments import analyze_runs

from .back_driven import driven
from .control_runs import noise_run, step_run
from .rescaled import SIZES, factor, rescaled


def current_noise(bench):
    """A lag of 150 Hz, locked, at the rate and the noise of the shipped protocol."""
    rate, count = 1000.0, 9000
    spectrum = np.fft.rfft(np.random.default_rng(5).normal(0.0, 0.5, count))
    frequency = np.fft.rfftfreq(count, 1 / rate)
    spectrum[frequency > 218.0] = 0.0
    given, answer = (np.fft.irfft(column, count) for column in (spectrum, spectrum / (1 + 1j * frequency / 150.0)))
    time = np.arange(1, count + 1) / rate
    columns = {"q_axis_current_reference": 5.0 + given, "q_axis_current": 5.0 + answer}
    columns["q_axis_current"] += np.random.default_rng(6).normal(0.0, 0.002, count)
    steps = [("noise", 0.0, count / rate, 0.5, {"offset_A": 5.0, "cutoff_Hz": 218.0, "seed": 1, "role": "test"})]
    return bench.write("current-noise", time, columns, steps, mechanical="locked")


RUNS = {
    "back-drive": driven,
    "current-noise": current_noise,
    "position-noise": lambda bench: noise_run(bench.directory),
    "current-step": lambda bench: step_run(bench.directory, noise=0.01),
    "torque-constant": lambda bench: bench.torque(noise=0.01, scatter=0.01),
    "friction": lambda bench: bench.friction(noise=0.001),
}


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("experiment", RUNS)
@pytest.mark.parametrize("as_channels", [False, True])
def test_the_same_bench_in_another_size_gives_the_same_results_scaled(bench, tmp_path, experiment, size, as_channels):
    name = "channels" if as_channels else experiment
    if as_channels and experiment != "torque-constant":
        pytest.skip("one run tells enough of the channels")
    path = RUNS[experiment](bench)
    first = analyze_runs([path], name)
    other = analyze_runs([rescaled(path, SIZES[size], tmp_path / "other")], name)
    assert [item.name for item in other.results] == [item.name for item in first.results]
    for item, answer in zip(first.results, other.results, strict=True):
        by = factor(item.units, SIZES[size])
        for kind in ("value", "low", "high"):
            expected, found = getattr(item, kind) * by, getattr(answer, kind)
            assert found == pytest.approx(expected, rel=2e-3, abs=1e-9 * by, nan_ok=True), (item.name, kind)
        assert math.isnan(item.std) == math.isnan(answer.std)
