"""Results of a bench of another size are the same, scaled: none rests on a constant with a unit."""

import math
import re

import numpy as np
import pytest

from leactl.analysis.analyze import analyze_runs

from .back_driven import driven
from .control_runs import noise_run, step_run
from .rescaled import SIZES, factor, rescaled
from .short_runs import SETTINGS, short_run


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


# defined in seconds or minutes, which do not stretch with another machine's runs
IN_SECONDS = re.compile(r"peak_current_|change_in_|cold_resistance|hot_resistance|winding_rise")
ROUNDING = 2e-4
OF_STD = 0.15  # stamps round to other samples at the edges of steps; what that moves is far within the scatter


def unlike(path, size, folder, name=None):
    """Results that are not those of the same bench in another size, scaled."""
    first = analyze_runs([path], name)
    other = analyze_runs([rescaled(path, SIZES[size], folder)], name)
    assert [item.name for item in other.results] == [item.name for item in first.results]
    wrong = []
    for item, answer in zip(first.results, other.results, strict=True):
        by = factor(item.units, SIZES[size])
        slack = 0.0 if math.isnan(item.std) else OF_STD * item.std * by
        for kind in ("value", "low", "high", "std"):
            expected, found = getattr(item, kind) * by, getattr(answer, kind)
            same = found == pytest.approx(expected, rel=ROUNDING, abs=slack, nan_ok=True)
            if not same and not IN_SECONDS.search(item.name):
                wrong.append((item.name, kind, expected, found))
    return wrong


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("experiment", RUNS)
def test_the_same_bench_in_another_size_gives_the_same_results_scaled(bench, tmp_path, experiment, size):
    assert unlike(RUNS[experiment](bench), size, tmp_path / "other") == []


@pytest.mark.parametrize("size", SIZES)
def test_what_holds_tell_of_a_channel_scales_with_it(bench, tmp_path, size):
    assert unlike(RUNS["torque-constant"](bench), size, tmp_path / "other", "channels") == []


@pytest.mark.long
@pytest.mark.parametrize("experiment", SETTINGS)
def test_every_shipped_experiment_gives_the_same_results_scaled(tmp_path, experiment):
    path = short_run(experiment, tmp_path / "run")
    assert {size: unlike(path, size, tmp_path / size) for size in SIZES} == {size: [] for size in SIZES}
