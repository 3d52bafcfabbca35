"""The rise of a winding by its resistance, on records made from two exponentials with a display's steps."""

import numpy as np
import pytest

from leactl.analysis.experiments import analyze_runs
from leactl.errors import InputError, MissingChannel, NotIdentifiable
from leactl.quantities import ChannelSpec
from leactl.runfile.writer import RunInfo, RunWriter

LEADS, ALPHA = 0.528, 0.004  # ohm at 25 degC, 1/K
BEFORE = 10.0  # s of rest
MODEL = "resistance_coefficient: 0.004\nreference_temperature: 25.0\ntolerances: {resistance_coefficient: 0.0}\n"
FAST, SLOW = (12.0, 6.5), (60.0, 620.0)  # K and s


def rise(time, slow=SLOW):
    return FAST[0] * (1 - np.exp(-time / FAST[1])) + slow[0] * (1 - np.exp(-time / slow[1]))


@pytest.fixture
def record(tmp_path):
    """Write a record of heating for some time, and give its path."""
    count = iter(range(100))

    def write(lasts=4500.0, amperes=8.0, cold=25.0, slow=SLOW, step=0.01, air=(), sign=1.0, model=MODEL, lack="",
              air_role="test"):  # fmt: skip
        number = next(count)
        into = np.concatenate([np.arange(0.0, 5.0, 1 / 30), np.arange(5.0, lasts, 1.0)])
        into = into[into < lasts]
        kelvin = rise(into, slow)
        volts = amperes * LEADS * (1 + ALPHA * (cold - 25.0 + kelvin))
        volts = np.round(volts / step) * step if step else volts
        rest = np.arange(0.0, BEFORE, 1 / 30)
        info = RunInfo(
            run_id=f"20261120T101530Z-winding-rise-{number:04d}",
            protocol="winding-rise",
            bench="b",
            actuator="a1",
            condition="",
            operator="",
            simulated=True,
            mechanical="heated",
            software="",
            created="2026-11-20T10:15:30Z",
            sources={"protocol": "name: x\nanalysis: winding-rise\n", "model": model},
        )
        names = [name for name in ("line_voltage", "line_current") if name != lack]
        streams = {"supply": tuple(ChannelSpec(name, name, "test", "s", dtype="f8") for name in names)}
        if len(air):
            streams["air"] = (ChannelSpec("ambient", "ambient_temperature", air_role, "t", dtype="f8"),)
        writer = RunWriter(tmp_path, info, streams)
        off, on = {"line_voltage": 0.0, "line_current": 0.0}, {"line_current": amperes}
        for time in rest:
            writer.append_row("supply", time, [off[name] for name in names])
        for time, volt in zip(BEFORE + into, sign * volts, strict=True):
            writer.append_row("supply", time, [(on | {"line_voltage": volt})[name] for name in names])
        for time, degrees in enumerate(air):
            writer.append_row("air", float(time), [degrees])
        writer.close("complete", "")
        return writer.path

    return write


def test_resistances_and_rise_come_back_within_their_intervals(record):
    found = analyze_runs([record()])
    for name, truth in (
        ("cold_resistance", LEADS),
        ("hot_resistance", LEADS * (1 + ALPHA * rise(4485.0))),
        ("winding_rise", rise(4485.0)),
    ):
        one = found.find(name)
        assert one.low <= truth <= one.high
        assert one.std < 0.005 * one.value or name == "winding_rise"
    assert found.find("winding_rise").value == pytest.approx(72.0, rel=0.02)


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
    found = analyze_runs([record(lasts=lasts, slow=slow, step=0.0)])
    change = found.find("change_in_last_30_min")
    assert any(note.startswith(said) or said in note for note in found.notes)
    # a straight line through the last 30 min, by itself
    time = np.linspace(lasts - 1800.0, lasts, 5000)
    slope = np.polyfit(time, rise(time, slow), 1)[0] * 1800.0
    assert change.low <= slope <= change.high or abs(change.value - slope) < 0.05 * abs(slope)


def test_steps_as_large_as_the_criterion_leave_it_open(record):
    found = analyze_runs([record(step=0.04)])
    assert any("cannot be told from these readings" in note for note in found.notes)


def test_half_an_hour_is_needed_to_tell(record):
    found = analyze_runs([record(lasts=600.0)])
    assert np.isnan(found.find("change_in_last_30_min").value)
    assert any("heated for 10 min" in note for note in found.notes)


@pytest.mark.parametrize(
    ("given", "error", "said"),
    [
        ({"lack": "line_voltage"}, MissingChannel, "line_voltage"),
        ({"amperes": 0.0}, NotIdentifiable, "nothing was heated"),
        ({"sign": -1.0}, InputError, "one of the two has its leads swapped"),
        ({"model": "name: x\n"}, NotIdentifiable, "its model has no resistance_coefficient"),
        ({"lasts": 0.2}, NotIdentifiable, "nothing was heated"),
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
