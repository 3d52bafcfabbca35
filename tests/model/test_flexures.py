"""Preload of bearings on flexures, and the two told points that contradict each other."""

import pytest

from leactl.errors import InputError
from leactl.model.flexures import bearings_of, disagreement, largest_gap, preload, readings
from leactl.model.motor import load_sheet

BEARINGS = bearings_of(load_sheet("lea")[0])


def by_name(rest_gap=0.5e-3):
    return {reading.name: reading for reading in readings(BEARINGS, rest_gap)}


def test_a_side_carries_twelve_times_one():
    result = preload(BEARINGS, by_name()["static load, beyond the gap at rest"], 0.75e-3)
    assert result.force == pytest.approx(150.0)
    assert result.side == pytest.approx(1800.0)
    assert result.share == pytest.approx(0.5)
    assert result.holds


def test_a_flexure_at_rest_carries_nothing():
    for gap in (0.0, 0.3e-3, 0.5e-3):
        assert preload(BEARINGS, by_name()["told preload, beyond the gap at rest"], gap).force == 0.0


def test_the_static_load_is_where_it_is_told_to_be():
    for reading in readings(BEARINGS, 0.5e-3):
        at_most = preload(BEARINGS, reading, largest_gap(BEARINGS, reading))
        assert at_most.force == pytest.approx(300.0)
        assert not preload(BEARINGS, reading, largest_gap(BEARINGS, reading) * 1.01).holds


def test_how_far_the_readings_are_off():
    result = disagreement(BEARINGS, readings(BEARINGS, 0.5e-3))
    assert result == pytest.approx(
        {
            "static load, gap is deflection": 450.0 / 138.0 - 1.0,
            "told preload, gap is deflection": 92.0 / 300.0 - 1.0,
            "static load, beyond the gap at rest": 150.0 / 138.0 - 1.0,
            "told preload, beyond the gap at rest": 276.0 / 300.0 - 1.0,
        }
    )


@pytest.mark.parametrize("rest_gap", [-1e-6, 0.75e-3, float("nan")])
def test_a_gap_at_rest_that_leaves_no_preload_is_refused(rest_gap):
    with pytest.raises(InputError, match="gap at rest"):
        readings(BEARINGS, rest_gap)


def test_a_gap_that_is_no_length_and_a_motor_without_bearings():
    with pytest.raises(InputError, match="gap -1 mm"):
        preload(BEARINGS, readings(BEARINGS, 0.0)[0], -1e-3)
    with pytest.raises(InputError, match="'u8-kv100' has no `bearings:`"):
        bearings_of(load_sheet("u8-kv100")[0])
