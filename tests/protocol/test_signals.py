"""Signals: what is sampled, at which rate, and which trajectories are refused."""

import numpy as np
import pytest

from leactl.errors import InputError
from tests.protocol.writing import plan, segments

RATE = 200


def sampled(keys, folder=None, rate_Hz=RATE, **head):  # noqa: N803
    result = plan(f"signal: {{role: test, {keys}}}", rate_Hz=rate_Hz, **({"folder": folder} if folder else {}), **head)
    return segments(result)[0]


def values(keys, **more):
    segment = sampled(keys, **more)
    profile = segment.setpoints["test"]
    assert segment.duration_s == pytest.approx(len(profile.values) * profile.period)
    return profile.values


def faults(keys, **more):
    with pytest.raises(InputError) as caught:
        sampled(keys, **more)
    return caught.value.faults


def test_samples_are_held_until_the_next():
    profile = sampled("kind: step, from_current_A: 0, to_current_A: 5, at_s: 0.5, duration_s: 1").setpoints["test"]
    assert [profile.at(time) for time in (-1, 0.499, 0.5, 0.9, 7)] == [0, 0, 5, 5, 5]
    assert (profile.low, profile.high) == (0, 5)


def test_every_cycle_of_the_loop_gets_its_own_sample():
    profile = sampled("kind: sine, amplitude_A: 1, frequency_Hz: 7, duration_s: 10").setpoints["test"]
    assert [profile.at(n / RATE) for n in range(len(profile.values))] == list(profile.values)


def test_sine():
    got = values("kind: sine, amplitude_A: 2, offset_A: 1, frequency_Hz: 10, duration_s: 1, phase_rad: 0.5")
    times = np.arange(200) / RATE
    np.testing.assert_allclose(got, 1 + 2 * np.sin(2 * np.pi * 10 * times + 0.5), atol=1e-12)


@pytest.mark.parametrize("spacing", ["linear", "log"])
def test_a_chirp_reaches_both_frequencies(spacing):
    got = values(
        f"kind: chirp, amplitude_A: 1, from_Hz: 1, to_Hz: 20, duration_s: 20, spacing: {spacing}", rate_Hz=2000
    )
    crossings = np.flatnonzero((got[:-1] < 0) & (got[1:] >= 0)) / 2000
    frequency = 1 / np.diff(crossings)
    middle = (crossings[1:] + crossings[:-1]) / 2
    expected = 1 + 19 * middle / 20 if spacing == "linear" else 20 ** (middle / 20)
    np.testing.assert_allclose(frequency, expected, rtol=0.03)
    assert frequency[-1] > 19


@pytest.mark.parametrize("phases", ["schroeder", "random, seed: 4"])
def test_a_multisine_has_its_lines_and_its_peak(phases):
    got = values(f"kind: multisine, amplitude_A: 3, from_Hz: 5, to_Hz: 50, count: 10, phases: {phases}, duration_s: 2")
    assert np.abs(got).max() == pytest.approx(3)
    spectrum = np.abs(np.fft.rfft(got))
    lines = np.flatnonzero(spectrum > spectrum.max() / 100) / 2
    np.testing.assert_allclose(lines, np.arange(5, 51, 5))


def test_schroeder_phases_keep_the_crest_low():
    keys = "kind: multisine, amplitude_A: 1, from_Hz: 1, to_Hz: 40, count: 40, duration_s: 1"
    crest = {p: 1 / values(f"{keys}, phases: {p}").std() for p in ("schroeder", "random")}
    assert crest["schroeder"] < 2 < crest["random"]


def test_noise_has_its_spread_band_and_seed():
    keys = "kind: noise, std_A: 2, offset_A: 5, cutoff_Hz: 20, order: 35, duration_s: 30"
    got = values(f"{keys}, seed: 1", rate_Hz=1000)
    assert (got - 5).std() == pytest.approx(2)
    assert abs(got[0] - 5) < 0.01  # the filter starts at rest
    power = np.abs(np.fft.rfft(got - 5)) ** 2
    frequency = np.fft.rfftfreq(len(got), 1 / 1000)
    assert power[frequency > 25].sum() < 1e-3 * power.sum()
    assert power[(frequency > 10) & (frequency < 19)].sum() > 0.3 * power.sum()
    np.testing.assert_array_equal(got, values(f"{keys}, seed: 1", rate_Hz=1000))
    assert not np.allclose(got, values(f"{keys}, seed: 2", rate_Hz=1000))


def test_a_signal_tells_what_it_is_and_where_it_leaves_the_role():
    result = plan(
        "repeat: {times: 2, steps: [{signal: {role: test, kind: step, from_current_A: 0, to_current_A: 5, at_s: 0.5,"
        " duration_s: 1, settle_s: 0.25}}, {ramp: {role: test, to_current_A: 0, rate_A_s: 5}}]}"
    )
    first, ramp, second, _ = segments(result)
    assert first.parameters == {
        "kind": "step", "from_current_A": 0, "to_current_A": 5, "at_s": 0.5, "role": "test", "repeat": 1
    }  # fmt: skip
    assert first.settle_s == 0.25
    assert ramp.duration_s == 1
    assert second.setpoints["test"] is first.setpoints["test"]
    assert result.peaks() == {("test", "q_axis_current_reference"): 5}


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("kind: sinus", "signal.kind: 'sinus': one of step, sine, chirp, multisine, noise, csv was expected"),
        ("amplitude_A: 1", "signal.kind: one of step, sine, chirp, multisine, noise, csv was expected"),
        (
            "kind: sine, amplitude_A: 1, frequency_Hz: 100, duration_s: 1",
            "frequency_Hz: 100 Hz: less than half of rate_Hz",
        ),
        (
            "kind: sine, amplitude_A: 1, frequency_hz: 1, duration_s: 1",
            "frequency_hz: 1: unknown key; frequency_Hz was",
        ),
        (
            "kind: sine, amplitude_A: 1, frequency_Hz: 1, duration_s: 1.0e-3",
            "duration_s: 0.001 s: at least 0.005 s was",
        ),
        ("kind: sine, amplitude_A: 1, frequency_Hz: 1, duration_s: 1, settle_s: 1", "settle_s: 1 s: less than 1 s was"),
        ("kind: sine, frequency_Hz: 1, duration_s: 1", "signal.amplitude_A: is required and missing"),
        (
            "kind: chirp, amplitude_A: 1, from_Hz: 1, to_Hz: 200, duration_s: 1",
            "to_Hz: 200 Hz: less than half of rate_Hz",
        ),
        (
            "kind: noise, std_A: 1, cutoff_Hz: 100, order: 4, seed: 1, duration_s: 1",
            "cutoff_Hz: 100 Hz: less than half",
        ),
        (
            "kind: noise, std_A: 1, cutoff_Hz: 0.01, order: 40, seed: 1, duration_s: 1",
            "nothing is left behind the filter",
        ),
        (
            "kind: noise, std_A: 1, cutoff_Hz: 0.001, order: 60, seed: 1, duration_s: 1",
            "nothing is left behind the filter",
        ),
        ("kind: noise, std_A: 1, cutoff_Hz: 5, order: 40, duration_s: 1", "signal.seed: is required and missing"),
        (
            "kind: step, from_current_A: 0, to_current_A: 1, at_s: 1, duration_s: 1",
            "at_s: 1 s: less than duration_s (1 s)",
        ),
        (
            "kind: multisine, amplitude_A: 1, duration_s: 1",
            "frequencies_Hz, or from_Hz, to_Hz and count, were expected",
        ),
        (
            "kind: multisine, amplitude_A: 1, from_Hz: 3, duration_s: 1",
            "from_Hz, to_Hz and count together, or frequencies",
        ),
        (
            "kind: multisine, amplitude_A: 1, frequencies_Hz: [1], from_Hz: 1, to_Hz: 2, count: 2, duration_s: 1",
            "from_Hz: from_Hz, to_Hz and count together, or frequencies_Hz alone, were expected",
        ),
        (
            "kind: multisine, amplitude_A: 1, frequencies_Hz: [1, 150], duration_s: 1",
            "frequencies_Hz: 150 Hz: less than",
        ),
    ],
)
def test_a_signal_that_cannot_be_used(keys, words):
    (line,) = faults(keys)
    assert words in line


@pytest.fixture
def trajectory(tmp_path):
    def write(content, name="knee.csv"):
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        return tmp_path

    return write


def test_a_trajectory_is_sampled_on_straight_lines(trajectory):
    folder = trajectory("note, current_A ,time_s\na,0,10\nb,2,10.01\n\nc,2,10.02\n")
    got = values("kind: csv, path: knee.csv", folder=folder)
    np.testing.assert_allclose(got, [0, 1, 2, 2, 2], atol=1e-9)


def test_a_trajectory_may_name_its_column(trajectory):
    folder = trajectory("time_s,current_A,hip_current_A\n0,1,5\n1,1,6\n")
    assert values("kind: csv, path: knee.csv, column: hip_current_A", folder=folder)[0] == 5


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "knee.csv: line 1: columns 'time_s' and 'current_A' were expected, each once; found nothing"),
        (
            "time_s,velocity_rad_s\n0,1\n1,1\n",
            "knee.csv: line 1: columns 'time_s' and 'current_A' were expected, each once; found time_s, velocity",
        ),
        (
            "time_s,current_A,current_A\n0,1,1\n",
            "columns 'time_s' and 'current_A' were expected, each once; found time_s, current_A, current_A",
        ),
        ("time_s,current_A\n0,1\n", "two rows or more were expected below the header"),
        ("time_s,current_A\n0,1\n0,1\n", "knee.csv: line 3, column 'time_s': 0 is not after 0"),
        ("time_s,current_A\n0,1\n2,1\n1,1\n", "knee.csv: line 4, column 'time_s': 1 is not after 2"),
        ("time_s,current_A\n0,1\n1,x\n", "knee.csv: line 3, column 'current_A': 'x' is not a number"),
        ("time_s,current_A\n0,1\n1,nan\n", "knee.csv: line 3, column 'current_A': nan: a number of at most 1e+06"),
        ("time_s,current_A\n0,1\n1,inf\n", "knee.csv: line 3, column 'current_A': inf: a number of at most 1e+06"),
        ("time_s,current_A\n0,1\n1\n", "knee.csv: line 3: 1 cells where 2 were expected"),
        ("time_s,current_A\n0,x\n1,2\n", "line 2, column 'current_A': 'x' is not a number"),
        ("time_s,current_A\n0,5,1\n1,0,2\n", "line 2: 3 cells where 2 were expected; is a decimal comma taken"),
        ("time_s,current_A\n0,1\n1,0,2\n", "line 3: 3 cells where 2 were expected; is a decimal comma taken"),
        ("time_s,current_A\n0,1\n900000,2\n", "900000 s long; at most 604800 s was expected"),
        ("time_s,current_A\n0,1\n60000,2\n", "more than 5000000 samples of signals"),
        (b"time_s,current_A\n0,\xff\n", "knee.csv: not utf-8-sig at byte 19"),
        ('time_s,current_A\n0,"1\n', "knee.csv: line 2: unexpected end of data"),
    ],
)
def test_a_trajectory_that_cannot_be_used(trajectory, content, words):
    (line,) = faults("kind: csv, path: knee.csv", folder=trajectory(content))
    assert line.startswith("trial.yaml:9:")
    assert words in line


def test_every_bad_row_is_told_up_to_twenty(trajectory):
    rows = "".join(f"{n},x\n" for n in range(1000))
    told = faults("kind: csv, path: knee.csv", folder=trajectory(f"time_s,current_A\n{rows}"))
    assert len(told) == 20
    assert "steps[1].signal.path" in told[0]


def test_a_trajectory_that_is_absent_a_folder_or_in_another_unit(trajectory):
    folder = trajectory("time_s,angle_rad\n0,1\n1,1\n")
    for path in ("nowhere.csv", "."):
        (line,) = faults(f"kind: csv, path: {path}", folder=folder)
        assert "9:43  steps[1].signal.path: " in line
        assert line.endswith("no such file")
    (line,) = faults("kind: csv, path: knee.csv, column: angle_rad", folder=folder)
    assert line == ("trial.yaml:9:61  steps[1].signal.column: column 'angle_rad': a name that ends in _A was expected")


def test_references_come_at_the_host_s_own_rate():
    keys = "kind: sine, amplitude_A: 1, frequency_Hz: 10, duration_s: 1, reference_Hz: 90"
    profile = sampled(keys, rate_Hz=1000).setpoints["test"]
    asked = np.array([profile.at(n / 1000) for n in range(1000)])
    changes = np.flatnonzero(np.diff(asked)) + 1
    assert set(np.diff(changes)) == {11, 12}  # 1000 / 90 cycles on average
    held = np.floor(np.arange(1000) * 0.09 + 1e-6) / 90
    np.testing.assert_allclose(asked, np.sin(2 * np.pi * 10 * held), atol=1e-12)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (
            "frequency_Hz: 50, reference_Hz: 90",
            "frequency_Hz: 50 Hz: less than half of reference_Hz (45 Hz) was expected",
        ),
        ("frequency_Hz: 1, reference_Hz: 201", "reference_Hz: 201 Hz: rate_Hz (200 Hz) or less was expected"),
    ],
)
def test_references_that_cannot_be(keys, words):
    (fault,) = faults(f"kind: sine, amplitude_A: 1, duration_s: 1, {keys}")
    assert words in fault


def passes(more):
    keys = f"kind: noise, std_A: 1, cutoff_Hz: 20, order: 4, seed: 7, duration_s: 1{more}"
    result = segments(plan(f"repeat: {{times: 3, steps: [{{signal: {{role: test, {keys}}}}}]}}", rate_Hz=RATE))
    return [segment.setpoints["test"].values for segment in result], [segment.parameters["seed"] for segment in result]


def test_noise_is_the_same_in_each_pass_unless_it_is_to_be_fresh():
    same, seeds = passes("")
    assert seeds == [7, 7, 7]
    np.testing.assert_array_equal(same[0], same[2])
    fresh, seeds = passes(", fresh: true")
    assert seeds == [7, 8, 9]
    np.testing.assert_array_equal(fresh[0], same[0])
    assert not np.allclose(fresh[0], fresh[1])
    np.testing.assert_array_equal(
        fresh[2], values("kind: noise, std_A: 1, cutoff_Hz: 20, order: 4, seed: 9, duration_s: 1")
    )
