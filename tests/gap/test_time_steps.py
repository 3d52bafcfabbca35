"""Replays are stepped and cut alike on similar benches, and by the rate of a log where a model names no loop."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.gap.replay.long_runs import rows_per_sample
from leactl.gap.replay.time_steps import FEWEST_STEPS, samples, steps_in_sample
from leactl.model.nominal import BenchModel

BANDWIDTHS = ("current_loop_bandwidth", "velocity_filter_bandwidth", "torque_filter_bandwidth")


def bench(bandwidths, time=1.0):
    return BenchModel(**{name: value / time for name, value in bandwidths.items()})


@given(
    st.dictionaries(st.sampled_from(BANDWIDTHS), st.floats(1.0, 1e4), min_size=1),
    st.floats(1e-5, 0.1),
    st.floats(1e-3, 1e3),
    st.integers(1, 5000),
)
def test_a_bench_that_is_slower_all_over_is_cut_at_the_same_samples(bandwidths, interval, time, intervals):
    once, slower = bench(bandwidths), bench(bandwidths, time)
    assert steps_in_sample(once, interval) == pytest.approx(steps_in_sample(slower, interval * time), abs=1)
    assert samples(intervals, once, interval) == pytest.approx(samples(intervals, slower, interval * time), abs=1)
    assert rows_per_sample(interval, once) == pytest.approx(rows_per_sample(interval * time, slower), rel=0.1, abs=0.2)


@pytest.mark.parametrize("thinned", [1, 2, 4])
def test_a_thinned_log_is_replayed_at_the_same_steps(thinned):
    fast = bench({"current_loop_bandwidth": 450.0, "velocity_filter_bandwidth": 250.0})
    assert steps_in_sample(fast, thinned * 1e-3) == thinned * FEWEST_STEPS
    assert thinned * samples(1000, fast, thinned * 1e-3) == 1000


@given(st.floats(1e-5, 10.0))
def test_a_bench_without_loops_goes_by_the_interval_of_its_log(interval):
    assert (steps_in_sample(BenchModel(), interval), samples(250, BenchModel(), interval)) == (FEWEST_STEPS, 250)
