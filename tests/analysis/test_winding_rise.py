"""The rise of a winding by its resistance, on records made from two exponentials with a display's steps."""

import functools

import numpy as np
import pytest

from leactl.analysis.analyze import analyze_runs
from leactl.errors import InputError, MissingChannel, NotIdentifiable

from .warmed import ALPHA, LEADS, MODEL, SLOW, rise, warmed


@pytest.fixture
def record(bench):
    return functools.partial(warmed, bench)


def test_resistances_and_rise_come_back_within_their_intervals(record):
    result = analyze_runs([record()])
    for name, truth in (
        ("cold_resistance", LEADS),
        ("hot_resistance", LEADS * (1 + ALPHA * rise(4485.0))),
        ("winding_rise", rise(4485.0)),
    ):
        one = result.find(name)
        assert one.low <= truth <= one.high
        assert one.std < 0.005 * one.value or name == "winding_rise"
    assert result.find("winding_rise").value == pytest.approx(72.0, rel=0.02)


def test_the_interval_holds_the_rise_wherever_the_display_s_steps_fall(record):
    held = 0
    for amperes in np.arange(7.5, 8.5, 0.1):
        one = analyze_runs([record(lasts=100.0, amperes=amperes)]).find("winding_rise")
        held += one.low <= np.mean(rise(np.arange(70.0, 100.0))) <= one.high
    assert held >= 9


def test_a_warm_start_is_told_by_the_air_and_doubted_without(record):
    """From 35 degC a resistance doubles by 1 / alpha + 35 - 25 K, from 25 degC by 1 / alpha."""
    told = analyze_runs([record(cold=35.0, air=[35.0] * 10)])
    guessed = analyze_runs([record(cold=35.0)])
    assert told.find("winding_rise").value == pytest.approx(rise(4485.0), rel=0.01)
    assert guessed.find("winding_rise").value == pytest.approx(rise(4485.0) * 250 / 260, rel=0.01)
    assert any("no ambient temperature before heating" in note for note in guessed.notes)
    assert guessed.find("winding_rise").std > told.find("winding_rise").std


def test_the_coefficient_s_tolerance_widens_the_interval(record):
    wide = analyze_runs([record(model=MODEL.replace("resistance_coefficient: 0.0}", "resistance_coefficient: 0.1}"))])
    assert wide.find("winding_rise").std == pytest.approx(0.1 / 3**0.5 * 72.0, rel=0.1)


@pytest.mark.parametrize(
    ("lasts", "slow", "said"),
    [
        (4500.0, SLOW, "steady: no more than 1 K"),
        (1900.0, SLOW, "no steady state: +"),
        (4500.0, (20.0, 900.0), "steady"),
    ],
)
def test_steady_is_no_more_than_one_kelvin_in_thirty_minutes(record, lasts, slow, said):
    result = analyze_runs([record(lasts=lasts, slow=slow, step=0.0)])
    change = result.find("change_in_last_30_min")
    assert any(note.startswith(said) or said in note for note in result.notes)
    last, before = (np.mean(rise(np.arange(end - 59.0, end + 1.0), slow)) for end in (lasts - 1.0, lasts - 1801.0))
    assert change.value == pytest.approx(last - before, rel=0.001)


def test_steps_as_large_as_the_criterion_leave_it_open(record):
    result = analyze_runs([record(step=0.04)])
    assert any("cannot be told from these readings" in note for note in result.notes)


def test_half_an_hour_is_needed_to_tell(record):
    result = analyze_runs([record(lasts=600.0)])
    assert np.isnan(result.find("change_in_last_30_min").value)
    assert any("heated for 10 min" in note for note in result.notes)


@pytest.mark.parametrize(
    ("given", "error", "said"),
    [
        ({"lack": "line_voltage"}, MissingChannel, "line_voltage"),
        ({"amperes": 0.0}, NotIdentifiable, "nothing was heated"),
        ({"sign": -1.0}, InputError, "one of the two has its leads swapped"),
        ({"model": "name: x\n"}, NotIdentifiable, "its model has no resistance_coefficient"),
        ({"lasts": 0.2}, NotIdentifiable, "nothing was heated"),
        ({"model": MODEL.replace("0.0}", "1.5}")}, InputError, "tolerances.resistance_coefficient of its model is 1.5"),
        ({"model": MODEL.replace("25.0", "warm")}, InputError, "reference_temperature of its model is warm; a number"),
    ],
)
def test_what_cannot_answer_says_why(record, given, error, said):
    with pytest.raises(error, match=said):
        analyze_runs([record(**({"lasts": 60.0} | given))])


def test_two_runs_are_not_one(record):
    with pytest.raises(NotIdentifiable, match="one run at a time"):
        analyze_runs([record(lasts=60.0), record(lasts=60.0)])


@pytest.mark.parametrize("role", ["test", "bench"])
def test_the_air_before_heating_is_the_cold_winding_s_whosever_sensor_it_is(record, role):
    result = analyze_runs([record(lasts=600.0, cold=35.0, air=np.full(9, 35.0), air_role=role)])
    assert result.find("winding_rise").value == pytest.approx(rise(np.array(585.0)), abs=0.6)
    assert not any("no ambient temperature" in note for note in result.notes)


def test_air_in_kelvin_is_refused(record):
    with pytest.raises(InputError, match="these look like kelvin"):
        analyze_runs([record(lasts=600.0, air=np.full(9, 298.15))])
