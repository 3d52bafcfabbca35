"""Bandwidth from noise against loops whose response is known, and records that cannot give it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.signal import csd, welch

from leactl.analysis.analyze import analyze_runs
from leactl.analysis.responses.bandwidth import sampled_half_power
from leactl.analysis.responses.blackman_tukey import BlackmanTukey
from leactl.errors import InputError, MissingChannel, NotIdentifiable
from tests.analysis.control_runs import NOISE_S, RATE, noise_run


def found(result):
    return {item.name: item for item in result.results}


def true_bandwidth(pole_Hz):  # noqa: N803
    """Of the sampled first-order loop that the runs are made of."""
    decay = math.exp(-2 * math.pi * pole_Hz / RATE)

    def excess(frequency):
        return abs((1 - decay) / (1 - decay * np.exp(-2j * math.pi * frequency / RATE))) - math.sqrt(0.5)

    return brentq(excess, 0.01, 0.49 * RATE)


@pytest.mark.parametrize("pole", [5.0, 8.0, 20.0])
def test_a_bandwidth_comes_back(tmp_path, pole):
    result = analyze_runs([noise_run(tmp_path, pole_Hz=pole, noise=0.002)])
    assert found(result)["bandwidth"].value == pytest.approx(true_bandwidth(pole), rel=0.02)
    assert found(result)["coherent_band_high"].value == pytest.approx(40, abs=0.5)


@pytest.mark.long
def test_intervals_hold_the_truth_about_as_often_as_they_say(tmp_path):
    truth, held = true_bandwidth(8.0), 0
    for seed in range(20):
        (folder := tmp_path / str(seed)).mkdir()
        bandwidth = found(analyze_runs([noise_run(folder, noise=0.02, seed=seed)]))["bandwidth"]
        held += bandwidth.low <= truth <= bandwidth.high
    assert held >= 16  # of 20; fewer have a probability of 0.003 at 95 %


def test_a_bandwidth_above_the_noise_is_a_lower_bound(tmp_path):
    result = analyze_runs([noise_run(tmp_path, pole_Hz=100.0, noise=0.002)])
    bandwidth = found(result)["bandwidth"]
    assert math.isnan(bandwidth.value)
    assert bandwidth.low == pytest.approx(40, abs=0.5)
    assert bandwidth.high == math.inf
    assert any("the gain stays above -3 dB up to 40 Hz (95 %)" in note for note in result.notes)
    assert bandwidth.as_json()["value"] is None


@pytest.mark.parametrize(("pole", "lag"), [(50.0, 0.5), (36.0, 0.0)], ids=["taken from", "added to"])
def test_what_sampling_does_to_the_gain_makes_no_bandwidth_and_no_false_bound(tmp_path, pole, lag):
    """Sampled at 200 Hz these pass -3 dB at 36 and at 41 Hz."""
    bandwidth = found(analyze_runs([noise_run(tmp_path, pole_Hz=pole, lag=lag, rate=200, noise=0.002)]))["bandwidth"]
    assert math.isnan(bandwidth.value)
    assert 0.8 * 36 < bandwidth.low <= pole < bandwidth.high


@given(st.floats(1e-4, 0.45), st.floats(0.0, 1.0))
def test_a_sampled_loop_at_half_power_lies_within_the_limits(turns, lag):
    decay, back = math.exp(-2 * math.pi * turns), np.exp(-2j * math.pi * turns)
    late = decay ** (1 - lag)
    gain = abs(((1 - late) + (late - decay) * back) / (1 - decay * back))
    highest, lowest = (float(level) for level in sampled_half_power(np.array(turns)))
    assert lowest - 1e-9 <= gain <= highest + 1e-9


def disturb(low, high):
    """Drown a band of the response in something else."""

    def edit(columns):
        rng = np.random.default_rng(7)
        time, total = columns["time"], np.zeros(len(columns["time"]))
        for frequency in np.arange(low, high, 0.11):
            total += np.cos(2 * np.pi * frequency * time + rng.uniform(0, 2 * np.pi))
        columns["angle"] += 0.03 * total

    return edit


def test_a_band_of_too_low_coherence_is_not_known_and_neither_is_a_bandwidth_in_it(tmp_path):
    result = analyze_runs([noise_run(tmp_path, edit=disturb(6, 12))])
    bandwidth = found(result)["bandwidth"]
    assert math.isnan(bandwidth.value)
    assert bandwidth.low < true_bandwidth(8.0) < bandwidth.high < 15
    assert any("coherence at 1 is below 0.6 from" in note and "is not known" in note for note in result.notes)
    gain = result.plots[0].points[0]
    assert all(math.isnan(y) for x, y in zip(gain.x, gain.y, strict=True) if 7 < x < 11)


def test_a_crossing_that_a_gap_hides_between_what_sampling_leaves_is_not_lost(tmp_path):
    """Early and late limits lie in known stretches, the crossing itself in a line that drowns it."""

    def hum(columns):
        columns["angle"] += 0.02 * np.sin(2 * np.pi * 15.6 * columns["time"])

    path = noise_run(tmp_path, pole_Hz=16.0, cutoff_Hz=90.0, rate=200, lag=0.5, noise=0.0005, seed=10, edit=hum)
    result = analyze_runs([path])
    bandwidth = found(result)["bandwidth"]
    assert math.isnan(bandwidth.value)
    assert 13 < bandwidth.low < 16 < bandwidth.high < 18
    assert any("the gain passes -3 dB between 13." in note for note in result.notes)


def test_coherence_that_is_low_elsewhere_does_not_take_the_bandwidth(tmp_path):
    result = analyze_runs([noise_run(tmp_path, edit=disturb(20, 26))])
    assert found(result)["bandwidth"].value == pytest.approx(true_bandwidth(8.0), rel=0.03)
    assert any("is below 0.6 from" in note for note in result.notes)


def gap(columns):
    columns["angle"][2000:2003] = np.nan


def test_a_gap_leaves_the_longest_part(tmp_path):
    result = analyze_runs([noise_run(tmp_path, noise=0.002, edit=gap)])
    assert found(result)["bandwidth"].value == pytest.approx(true_bandwidth(8.0), rel=0.03)


def two_parts(columns):
    """Leave 2,000 samples of each stretch, 508 of which settle, and 1,900 that are settled."""
    row = np.arange(len(columns["time"])) % round(NOISE_S * RATE)
    columns["angle"][((row >= 2000) & (row < 2003)) | (row >= 3903)] = np.nan


def test_the_part_with_most_settled_samples_is_taken(tmp_path):
    result = analyze_runs([noise_run(tmp_path, noise=0.002, edit=two_parts)])
    assert found(result)["bandwidth"].value == pytest.approx(true_bandwidth(8.0), rel=0.05)


def missing(columns):
    columns["angle"][columns["time"] > 4 * NOISE_S] = np.nan


def test_missing_repeats_are_told(tmp_path):
    notes = analyze_runs([noise_run(tmp_path, trials=3, levels=(1.0, 2.0), edit=lambda c: missing(c))]).notes
    assert any("left out 2: too few samples in a row" in note for note in notes)


def test_the_same_noise_twice_is_no_second_trial(tmp_path):
    first = noise_run(tmp_path, trials=1)
    assert math.isnan(found(analyze_runs([first, noise_run(tmp_path, trials=1)]))["bandwidth"].std)


def clip(columns):
    np.clip(columns["angle"], 0.95, 1.05, out=columns["angle"])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"noise": 3.0}, "no frequency at which the coherence of every level is 0.6 or more"),
        ({"edit": clip, "levels": (1.0,)}, "angle is clipped at 1.05 rad"),
        ({"edit": lambda columns: columns["angle"].fill(np.nan)}, "too few samples in a row"),
        ({"edit": lambda columns: columns["angle_reference"].fill(1.0)}, "the reference does not move"),
    ],
    ids=["no coherence", "clipped", "missing", "still"],
)
def test_records_that_say_nothing_are_refused(tmp_path, change, words):
    path = noise_run(tmp_path, **change)
    with pytest.raises(NotIdentifiable) as caught:
        analyze_runs([path])
    assert str(caught.value).startswith(str(path))
    assert words in str(caught.value)


def test_a_swapped_sign_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"angle of test .* has the opposite sign of its demand.*a sign is swapped"):
        analyze_runs([noise_run(tmp_path, sign=-1.0)])


def test_a_run_without_a_channel_is_refused(tmp_path):
    with pytest.raises(MissingChannel, match="no angle_reference of test"):
        analyze_runs([noise_run(tmp_path, trials=1, edit=lambda columns: columns.pop("angle_reference"))])


def test_the_estimator_agrees_with_averaged_periodograms():
    """Welch's method, another estimator, on the same records and at about the same resolution."""
    rng = np.random.default_rng(3)
    noise = rng.standard_normal(200_000)
    answer = np.convolve(noise, [0.0, 0.4, 0.3, 0.2], "full")[: len(noise)] + 0.5 * rng.standard_normal(len(noise))
    method = BlackmanTukey(1 / RATE, 400, 200.0)
    response = method.response(method.spectra(noise, answer))
    frequency, cross = csd(noise, answer, RATE, nperseg=800)
    power, out = (welch(column, RATE, nperseg=800)[1] for column in (noise, answer))
    at = np.arange(10, 150, 10)
    places = np.searchsorted(response.frequency, frequency[at])
    np.testing.assert_allclose(response.value[places], (cross / power)[at], atol=0.02)
    np.testing.assert_allclose(response.coherence[places], (np.abs(cross) ** 2 / power / out)[at], atol=0.03)
