"""Clocks tied to each other: closed forms for lines, simulated pairs of channels whose true offset is known."""

import re

import numpy as np
import pytest
from scipy.linalg import expm

from leactl.errors import InputError
from leactl.runfile.align.alignment import Tie, fit_alignment
from leactl.runfile.align.onsets import fit_onset, jumps, ties_by_onset
from leactl.runfile.align.similarity import align_by_similarity

DRIFT = 1e-4  # 95 %
UNSEEN = 0.0005  # s, half a recorder's interval, as it is stated for a record that is attached


def stepping(time, rng_of_signal=5):
    """A signal of random levels behind a lag of 20 ms, at any times."""
    rng = np.random.default_rng(rng_of_signal)
    at, level, before = np.cumsum(rng.uniform(0.2, 1.5, 60)), rng.uniform(-5, 5, 60), 0.0
    value = np.zeros_like(time)
    for moment, now in zip(at, level, strict=True):
        value += (now - before) * np.where(time >= moment, 1 - np.exp(-np.clip(time - moment, 0, None) / 0.02), 0.0)
        before = now
    return value


def pair(seed, noise, interval=0.005):
    """A channel of the run and the same one as a faster recorder with another clock has it."""
    rng = np.random.default_rng(seed)
    offset, rate = 5.0 + rng.uniform(-0.5, 0.5), 1.0 + rng.normal(0, DRIFT / 2)
    base, own = np.arange(0, 30, interval), np.arange(0, 16, 0.001)
    reference = stepping(base) + noise * rng.normal(size=len(base))
    values = 1.3 * stepping(offset + rate * own) + 0.4 + noise * rng.normal(size=len(own))
    return (own, values), (base, reference), offset, rate


def test_one_tie_gives_its_offset_and_a_drift_that_is_only_bounded():
    alignment = fit_alignment("x", [Tie(100.0, 112.0, 0.5 / 1.959964)], DRIFT, 0.0)
    assert alignment.on_run(np.array([100.0]))[0] == pytest.approx(112.0)
    assert alignment.uncertainty(100.0) == pytest.approx(0.5)
    assert alignment.uncertainty(100.0 + 9000.0) == pytest.approx(np.hypot(0.5, 9000.0 * DRIFT))
    assert alignment.drift_uncertainty_ppm == pytest.approx(100.0)


def test_two_far_ties_give_offset_and_drift():
    rate = 1 + 40e-6
    ties = [Tie(0.0, 3.0, 0.001), Tie(9000.0, 3.0 + rate * 9000.0, 0.001)]
    alignment = fit_alignment("x", ties, DRIFT, 0.0)
    assert alignment.drift_ppm == pytest.approx(40.0, abs=0.01)
    assert alignment.drift_uncertainty_ppm == pytest.approx(1.96 * 1e6 * 0.001 * np.sqrt(2) / 9000.0, rel=0.01)
    middle, end = alignment.uncertainty(4500.0), alignment.uncertainty(9000.0)
    assert middle == pytest.approx(1.96 * 0.001 / np.sqrt(2), rel=0.01)
    assert end == pytest.approx(1.96 * 0.001, rel=0.01)


def test_ties_that_scatter_more_than_they_claim_widen_the_interval():
    own = np.linspace(0, 100, 6)
    calm = fit_alignment("x", [Tie(t, t + 1.0, 0.01) for t in own], DRIFT, 0.0)
    torn = fit_alignment("x", [Tie(t, t + 1.0 + 0.1 * (-1) ** k, 0.01) for k, t in enumerate(own)], DRIFT, 0.0)
    assert torn.uncertainty(50.0) > 5 * calm.uncertainty(50.0)


def test_a_systematic_delay_stays_whatever_the_number_of_ties():
    alignment = fit_alignment("x", [Tie(t, t, 1e-6) for t in np.linspace(0, 100, 50)], DRIFT, 0.02)
    assert alignment.uncertainty(50.0) == pytest.approx(0.02, rel=1e-3)


@pytest.mark.parametrize("noise", [0.02, 0.3])
def test_likeness_finds_the_offset_and_says_how_well(noise):
    errors, claims = [], []
    for seed in range(6):
        own, reference, offset, rate = pair(seed, noise)
        result = align_by_similarity(own, reference, 2.0, "a and b", near_s=5.0, drift_within=DRIFT)
        errors.append(result.on_run(np.array([8.0]))[0] - (offset + rate * 8.0))
        claims.append(result.uncertainty(8.0))
    assert np.sum(np.abs(errors) < claims) >= 5
    assert np.median(claims) < 4 * np.sqrt(np.mean(np.square(errors)))
    assert np.median(claims) < 0.005


def test_unlike_channels_and_channels_at_rest_are_refused():
    own, reference, _, _ = pair(1, 0.02)
    noise = np.random.default_rng(0).normal(size=len(own[0]))
    with pytest.raises(InputError, match=r"a and b correlate by 0\.\d+ at best"):
        align_by_similarity((own[0], noise), reference, 2.0, "a and b", near_s=5.0)
    ramp = (np.arange(0, 20, 0.01), np.zeros(2000))
    with pytest.raises(InputError, match="correlate"):
        align_by_similarity(ramp, ramp, 2.0, "a and b")


def seen_twice(signal, offset, noise=0.01, seed=1, seconds=16.0, rate=1.0):
    """A signal as a recorder of another clock and as the run has it, 500 Hz for 60 s."""
    rng = np.random.default_rng(seed)
    base, own = np.arange(0, 60, 0.002), np.arange(0, seconds, 0.001)
    values, reference = signal(offset + rate * own), signal(base)
    return (own, values + noise * rng.normal(size=len(own))), (base, reference + noise * rng.normal(size=len(base)))


def sine(hertz):
    return lambda time: 5 * np.sin(2 * np.pi * hertz * time)


def fading(time):
    """A sine whose amplitude falls by 0.2 % per period."""
    return sine(1.0)(time) * np.exp(-0.002 * time)


def creeping(time):
    """A sine that slows down by 20 ppm per second, which a clock's drift could be."""
    return sine(1.0)(time * (1 - 1e-5 * time))


def climbing(time):
    """A sine on a ramp that outweighs it: likeness never falls by much between two periods."""
    return sine(1.0)(time) + 5 * time


def chirp(time):
    return 5 * np.sin(2 * np.pi * (0.2 * time + 0.05 * time**2))


def square(time):
    return 5 * np.sign(np.sin(2 * np.pi * time + 0.3))


def marked(time):
    """A square wave of 1 s that stands still once for 0.3 s."""
    return np.where((time > 28.1) & (time < 28.4), 0.0, square(time))


def rustle(time):
    """White noise of 250 Hz, at any times."""
    return np.interp(time, np.arange(0, 80, 0.004), np.random.default_rng(8).normal(size=20000))


@pytest.mark.parametrize(
    ("signal", "period", "noise"),
    [
        (sine(1.0), 1.0, 0.01),
        (sine(1.0), 1.0, 0.0),
        (sine(1.0), 1.0, 1.5),
        (sine(43.0), 1 / 43, 0.01),
        (square, 1.0, 0.05),
        (climbing, 1.0, 0.01),
        (fading, 1.0, 0.5),
    ],
)
def test_a_signal_that_repeats_itself_within_the_search_is_refused_with_two_shifts_told(signal, period, noise):
    own, reference = seen_twice(signal, 20.3, noise)
    with pytest.raises(InputError, match=r"a and b are as alike at .*near_s") as refused:
        align_by_similarity(own, reference, 5.0, "a and b", near_s=20.0, drift_within=DRIFT)
    one, other = (float(told) for told in re.findall(r"at ([-\d.]+) s", str(refused.value)))
    apart = (one - other) / period
    assert round(apart) != 0
    assert apart == pytest.approx(round(apart), abs=0.05)


@pytest.mark.parametrize("signal", [sine(1.0), fading, creeping, climbing, square])
def test_a_signal_that_repeats_itself_is_aligned_where_the_search_is_shorter_than_its_period(signal):
    for offset in (20.3, 19.95, 20.55):
        own, reference = seen_twice(signal, offset)
        result = align_by_similarity(own, reference, 0.4, "a and b", near_s=20.2, drift_within=DRIFT, systematic=UNSEEN)
        assert result.on_run(np.array([8.0]))[0] - 8.0 == pytest.approx(offset, abs=3 * result.uncertainty(8.0))


@pytest.mark.parametrize("signal", [chirp, stepping, marked, rustle])
def test_a_signal_that_never_repeats_itself_whole_is_aligned_over_a_wide_search(signal):
    for offset in (16.2, 20.3037):
        own, reference = seen_twice(signal, offset)
        result = align_by_similarity(own, reference, 5.0, "a and b", near_s=20.0, drift_within=DRIFT, systematic=UNSEEN)
        assert result.on_run(np.array([8.0]))[0] - 8.0 == pytest.approx(offset, abs=3 * result.uncertainty(8.0))


@pytest.mark.parametrize(("signal", "offset"), [(stepping, -12.0), (chirp, 53.0)])
def test_a_record_of_which_the_run_saw_a_part_is_aligned_in_spite_of_shorter_parts_that_fit(signal, offset):
    own, reference = seen_twice(signal, offset, noise=0.05)
    result = align_by_similarity(own, reference, 14.0, "a and b", near_s=offset + 3.0, drift_within=DRIFT)
    assert result.on_run(np.array([8.0]))[0] - 8.0 == pytest.approx(offset, abs=3 * result.uncertainty(8.0))


@pytest.mark.parametrize("signal", [sine(0.7), fading, creeping, climbing, square, marked, chirp, stepping])
def test_whatever_is_answered_is_true(signal):
    rng = np.random.default_rng(11)
    for seed in range(6):
        offset, rate, noise = rng.uniform(1, 40), 1 + rng.normal(0, DRIFT / 2), 10 ** rng.uniform(-3, -0.3)
        within = rng.uniform(0.2, 4.0)
        own, reference = seen_twice(signal, offset, noise, seed, rng.uniform(4, 16), rate)
        try:
            near = offset + within * rng.uniform(-0.9, 0.9)
            result = align_by_similarity(own, reference, within, "a and b", near, DRIFT, UNSEEN)
        except InputError:
            continue
        at = 0.5 * own[0][-1]
        error = result.on_run(np.array([at]))[0] - offset - rate * at
        assert abs(error) < 3 * result.uncertainty(at), (seed, offset, within, noise)


def heating(time, starts, ends):
    """Winding of two thermal nodes under constant heat from `starts` to `ends`; exact, by the matrix exponential."""
    matrix = np.array([[-(1 / 5.6 + 1 / 0.3) / 22.9, 1 / 0.3 / 22.9], [1 / 0.3 / 469.1, -(1 / 0.3 + 1 / 1.7) / 469.1]])
    heat = np.array([42.8 / 22.9, 0.0])
    steady = np.linalg.solve(matrix, heat)
    values, vectors = (part.real for part in np.linalg.eig(matrix))  # from NumPy 2.5 complex, whatever the matrix
    shares = vectors[0] * np.linalg.solve(vectors, steady)
    assert np.allclose(vectors @ np.diag(np.exp(values)) @ np.linalg.inv(vectors), expm(matrix))

    def response(since):
        return np.where(since > 0, (np.exp(np.clip(since, 0, None)[:, None] * values) - 1.0) @ shares, 0.0)

    return 25.0 + response(time - starts) - response(time - ends)


def test_onsets_of_heating_and_cooling_tie_a_camera_with_its_drift():
    errors, claims = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        starts, ends = 60 + rng.uniform(0, 1), 600 + rng.uniform(0, 1)
        offset, rate = 40 + rng.uniform(-20, 20), 1 + rng.normal(0, DRIFT / 2)
        base, own = np.arange(0, 700, 1 / 30), np.arange(0, 640, 1 / 30)
        current = np.where((base >= starts) & (base < ends), 9.0, 0.0) + 0.01 * rng.normal(size=len(base))
        seen = heating(offset + rate * own, starts, ends) + 0.1 * rng.normal(size=len(own))
        ties = ties_by_onset(own, np.round(seen, 2), base, current, 4.0, 40.0, 60.0, 5.0)
        assert len(ties) == 2
        result = fit_alignment("x", ties, DRIFT, 0.0)
        errors.append(result.on_run(np.array([300.0]))[0] - (offset + rate * 300.0))
        claims.append(result.uncertainty(300.0))
    assert np.sum(np.abs(errors) < claims) >= 5
    assert np.median(claims) < 0.06


def pulses(*edges):
    """Camera and current of pulses that begin and end at these moments, the camera's clock 7 s ahead of the run's."""
    base, own = np.arange(0, edges[-1] + 10, 1 / 30), np.arange(0, edges[-1] + 17, 1 / 30)
    rng = np.random.default_rng(5)
    pairs = list(zip(edges[::2], edges[1::2], strict=True))
    current = sum(np.where((base >= one) & (base < other), 9.0, 0.0) for one, other in pairs)
    seen = sum(heating(own - 7.0, one, other) - 25.0 for one, other in pairs)
    return own, 25.0 + seen + 0.1 * rng.normal(size=len(own)), base, current


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("leads", [1.0, -1.0])
def test_heat_that_lasts_shorter_than_the_search_reaches_is_not_mistaken_for_cooling(sign, leads):
    own, seen, base, current = pulses(8.1, 20.2)
    ties = ties_by_onset(own, 50.0 + sign * seen, base, leads * current, 4.0, 0.0, 60.0, 5.0)
    assert [tie.run_time - tie.device_time for tie in ties] == pytest.approx([-7.0, -7.0], abs=0.15)


def test_onsets_that_do_not_belong_together_are_refused():
    with pytest.raises(InputError, match=r"onsets do not lie as far apart as the jumps do: offsets of .* near_s"):
        ties_by_onset(*pulses(8.1, 20.2, 31.3, 35.4), 4.0, 0.0, 60.0, 5.0)


def test_a_camera_that_sees_nothing_has_no_onset():
    rng = np.random.default_rng(3)
    time = np.arange(0, 200, 1 / 30)
    assert fit_onset(time, 25 + 0.05 * rng.normal(size=len(time)), 100.0, 60.0, 5.0, 1.0) is None
    assert fit_onset(time[:10], np.full(10, 25.0), 0.0, 60.0, 5.0, 1.0) is None


def test_a_jump_over_two_samples_is_one_and_a_missing_sample_is_none():
    time = np.arange(8.0)
    values = np.array([0.0, 0.0, 5.0, 9.0, 9.0, np.nan, 9.0, 0.0])
    assert [(tie.run_time, round(tie.sd, 3)) for tie in jumps(time, values, 4.0)] == [(1.5, 0.289), (6.5, 0.289)]
