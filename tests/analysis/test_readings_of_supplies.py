"""How well a supply's readings tell heat: records of several levels are judged one by one."""

import numpy as np
import pytest

from leactl.analysis.estimate import plot_slice
from leactl.analysis.heating.parameters import noise_of_heat, resolution_of
from leactl.analysis.heating.record import HeatingRecord, SupplyRecord


def record(current, voltage):
    time = np.arange(len(current), dtype=float)
    supply = SupplyRecord(time, np.array(current), np.array(voltage), means=False)
    return HeatingRecord("a run", time, time, time, time, supply, None)


def flickering(level):
    """Readings of a step of 10 mA, whose noise is below it."""
    return record(np.tile([level, level, level + 0.01, level], 50), np.full(200, 10.0))


def test_a_level_is_no_step_of_the_readings():
    constant = [record(np.full(100, level), np.full(100, 10.0)) for level in (1.0, 2.0)]
    assert resolution_of(constant, "current") == 0.0
    alone = [resolution_of([flickering(level)], "current") for level in (1.0, 2.0)]
    assert alone[0] == pytest.approx(0.01 / np.sqrt(12.0) / 1.0025, rel=1e-6)
    assert resolution_of([flickering(1.0), flickering(2.0)], "current") == pytest.approx(max(alone), rel=1e-6)


def test_a_record_that_only_cools_says_nothing_of_the_readings():
    cooling = record(np.tile([0.0, 0.001, 0.002], 30), np.tile([0.0, 0.001], 45))
    off = record(np.zeros(90), np.zeros(90))
    for name in ("current", "voltage"):
        assert resolution_of([flickering(5.0), cooling, off], name) == resolution_of([flickering(5.0)], name)
    assert noise_of_heat([flickering(5.0), cooling, off]) == noise_of_heat([flickering(5.0)])


def test_readings_that_never_change_have_the_step_that_another_record_shows():
    constant = record(np.full(100, 0.5), np.full(100, 10.0))
    assert resolution_of([constant], "current") == 0.0
    expected = 0.01 / np.sqrt(12.0) / 0.5
    assert resolution_of([constant, flickering(2.0)], "current") == pytest.approx(expected, rel=1e-6)


def test_a_jump_from_record_to_record_is_no_noise_of_the_heat():
    random = np.random.default_rng(1)
    records = [record(level + 1e-4 * random.standard_normal(1000), np.full(1000, 10.0)) for level in (1.0, 9.0)]
    assert noise_of_heat(records) == pytest.approx(1e-4 / np.sqrt(2000.0) / 5.0, rel=0.1)
    assert noise_of_heat(records[::-1]) == pytest.approx(noise_of_heat(records), rel=1e-9)


@pytest.mark.parametrize("count", [0, 1, 79, 80, 81, 159, 160, 1000])
def test_a_plot_has_no_more_points_than_it_may(count):
    shown = range(count)[plot_slice(count, 80)]
    assert len(shown) <= 80
    assert len(shown) > 80 // 2 or len(shown) == count
    assert list(shown[:1]) == list(range(count)[:1])
