"""A clock of fewer samples stands for the same motion and the same charge as the one it comes from."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.gap.signals.decimation import decimated
from leactl.gap.signals.record import Clocked
from leactl.gap.signals.stamps import TAPS, neighbour, stamp_columns

ANGLE, CURRENT, REFERENCE = ("angle", "test"), ("q_axis_current", "test"), ("q_axis_current_reference", "test")


def clock_of(rows, seed=1, lost=()):
    random = np.random.default_rng(seed)
    values = {ANGLE: np.cumsum(random.normal(size=rows)), CURRENT: random.normal(size=rows)}
    values[REFERENCE] = np.repeat(random.normal(size=rows), 3)[:rows]
    valid = {key: np.ones(rows, np.bool_) for key in values}
    valid[CURRENT][list(lost)] = False
    return Clocked(0.1 + 1e-3 * np.arange(rows), 1e-3, values, valid, means={CURRENT})


@given(st.integers(64, 300), st.sampled_from([2, 4, 8, 16]))
def test_charge_setpoints_and_instants_stay_and_the_rest_of_a_run_is_dropped(rows, factor):
    clock = clock_of(rows)
    slower = decimated(clock, factor)
    kept = rows // factor * factor
    assert slower.interval == pytest.approx(factor * clock.interval)
    assert slower.decimation == factor
    assert np.array_equal(slower.time, clock.time[factor - 1 : kept : factor])
    assert np.array_equal(slower.values[ANGLE], clock.values[ANGLE][factor - 1 : kept : factor])
    for key in (CURRENT, REFERENCE):
        assert slower.values[key].sum() * factor == pytest.approx(clock.values[key][:kept].sum())
    assert slower.means == {CURRENT, REFERENCE}


def test_a_current_of_instants_becomes_its_mean_over_the_interval():
    clock = clock_of(400)
    clock.means.clear()
    clock.values[CURRENT] = clock.time**2
    slower = decimated(clock, 4)
    exact = (slower.time**3 - (slower.time - slower.interval) ** 3) / (3.0 * slower.interval)
    assert slower.values[CURRENT][2:-2] == pytest.approx(exact[2:-2], rel=1e-9)


@given(st.lists(st.integers(0, 63), max_size=5))
def test_a_sample_that_is_lost_spoils_the_longer_one(lost):
    slower = decimated(clock_of(64, lost=lost), 8)
    assert set(np.flatnonzero(~slower.valid[CURRENT])) == {at // 8 for at in lost}
    assert slower.valid[ANGLE].all()


def test_taps_of_stamps_stay_samples_of_the_log():
    clock = clock_of(4000)
    clock.unstamped.add(CURRENT)
    clock.values[CURRENT] = np.sin(10.0 * clock.time)
    slower = decimated(clock, 4)
    fine = stamp_columns("free_torque", clock, [CURRENT], clock.values[CURRENT])
    coarse = stamp_columns("free_torque", slower, [CURRENT], slower.values[CURRENT])
    assert fine.keys() == coarse.keys()
    assert len(fine) == len(TAPS)
    for name, (column, _) in fine.items():
        means = column.reshape(-1, 4).mean(axis=1)
        assert coarse[name][0][5:-5] == pytest.approx(means[5:-5], abs=0.05 * np.abs(means).max())


def test_a_neighbour_between_two_samples_lies_on_their_line():
    values = np.array([0.0, 4.0, 2.0])
    assert neighbour(values, 1).tolist() == [4.0, 2.0, 2.0]
    assert neighbour(values, -0.25).tolist() == [0.0, 3.0, 2.5]
