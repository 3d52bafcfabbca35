"""The thermal analysis against plants of three phases solved by themselves, and on records that lack something."""

import json
import math
import re

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

from leactl.analysis.analyze import analyze_runs
from leactl.analysis.heating.record import heating_records
from leactl.analysis.heating.resistance import means_while_on
from leactl.errors import InputError, MissingChannel, NotIdentifiable
from leactl.runfile.read.reader import Run
from tests.cli.terminal import leactl

from .heated import HeatedBench, Plant
from .synthetic import covered

EXACT = {"camera_offset_std": 0.0, "camera_gain_std": 0.0}
NETWORK = ("winding_ambient_resistance", "winding_housing_resistance", "housing_ambient_resistance")
BODIES = ("winding_capacitance", "housing_capacitance")
SHORT = {"heat_s": 900.0, "cool_s": 600.0, "rate_Hz": 2.0}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A record as the paper's, and its answer."""
    path = HeatedBench(tmp_path_factory.mktemp("heated")).run(rate_Hz=2.0)
    return path, analyze_runs([path], **EXACT)


@pytest.fixture
def heated(tmp_path):
    return HeatedBench(tmp_path)


def notes(result):
    return "\n".join(result.notes)


def test_the_paper_s_network_comes_back(whole):
    _, result = whole
    true = Plant().known
    for name in NETWORK + BODIES:
        outcome = result.find(name)
        assert outcome.value == pytest.approx(true[name], abs=4.0 * outcome.std)
        assert 0.0 < outcome.std < 0.01 * outcome.value
    assert result.find("parallel_thermal_resistance").value == pytest.approx(
        true["parallel_thermal_resistance"], rel=2e-3
    )
    assert result.find("line_resistance").value == pytest.approx(true["line_resistance"], rel=1e-3)
    assert result.find("rmse_over_noise").value == pytest.approx(1.0, abs=0.03)
    assert result.find("phase_resistance").value == pytest.approx(0.264, rel=1e-3)


def test_frames_before_the_supply_was_read_are_in_no_bin(whole):
    path, _ = whole
    with Run.open(path) as run:
        [record] = heating_records(run).value
    rates = np.zeros((2, len(record.time)))
    early = record.time[0] - record.supply.time[0] + 5.0
    time, temperature, *_ = means_while_on(record, early, rates)
    expected = np.interp(time, record.time - early, record.active)
    np.testing.assert_allclose(temperature, expected, atol=1.0)


def test_how_long_the_current_has_to_be_on_follows_from_the_intervals_of_the_readings(heated):
    with pytest.raises(NotIdentifiable, match=r"about 128 s are needed"):
        analyze_runs([heated.run(heat_s=100.0, cool_s=600.0, rate_Hz=1.0)], **EXACT)


def test_errata_the_coefficient_is_4e_3_per_kelvin_and_gives_the_printed_current(whole):
    result = whole[1].find("resistance_coefficient")
    assert result.units == "1/K"
    assert result.value == pytest.approx(4e-3, rel=0.01)
    assert not covered(result, 4e-4)
    assert whole[1].find("continuous_current").value == pytest.approx(13.79, abs=0.02)
    assert 0.49 * whole[1].find("peak_current_20s").value == pytest.approx(15.7, abs=0.1)


def test_errata_75_minutes_of_heating_are_no_steady_state_by_1_k_in_30_minutes(whole):
    assert 2.0 < whole[1].find("change_in_30_min").value < 3.0
    assert "no steady state: +2." in notes(whole[1])


def test_the_covariance_is_joint_and_the_combination_known_better_than_its_parts(whole):
    [covariance] = whole[1].covariances
    assert covariance.names[:5] == (*NETWORK, *BODIES)
    table = np.array(covariance.values)
    assert np.linalg.eigvalsh(table / np.sqrt(np.outer(np.diag(table), np.diag(table)))).min() > 0.0
    assert np.sqrt(np.diag(table))[0] == pytest.approx(whole[1].find(NETWORK[0]).std)
    parallel = whole[1].find("parallel_thermal_resistance")
    assert all(parallel.std / parallel.value < 0.2 * item.std / item.value for item in map(whole[1].find, NETWORK))
    body = json.loads(json.dumps(whole[1].as_json(), allow_nan=False))
    assert body["covariances"][0]["actuator"] == "a1"


def test_a_gain_of_the_camera_is_part_of_every_interval(whole):
    path, exact = whole
    doubted = analyze_runs([path], camera_offset_std=0.0, camera_gain_std=0.02)
    for name in (*NETWORK, *BODIES, "parallel_thermal_resistance", "resistance_coefficient"):
        assert doubted.find(name).std == pytest.approx(
            math.hypot(exact.find(name).std, 0.02 * exact.find(name).value), rel=0.02
        )
    # of R (1 + alpha 105 K) i^2 = 105 K / parallel a gain moves the right side, and alpha the other way
    share = 0.5 * (1.0 - 0.42 / 1.42)
    assert doubted.find("continuous_current").std == pytest.approx(0.02 * share * 13.79, rel=0.02)


def test_a_current_read_in_coarse_steps_is_known_to_a_step(heated):
    def coarse(time, camera, supply):
        on = supply["line_current"] > 4.0
        supply["line_current"] = np.where(on, np.where(heated.rng.random(len(time)) < 0.02, 9.1, 9.0), 0.0)

    result = analyze_runs([heated.run(edit=coarse, **SHORT)], **EXACT)
    assert "tell current_gain_std" not in notes(result)
    outcome = result.find("line_resistance")
    assert outcome.std / outcome.value == pytest.approx(0.1 / 9.0 / math.sqrt(12.0), rel=0.05)


def test_the_command_prints_the_table_beside_the_paper_in_80_columns(whole):
    done = leactl("analyze", str(whole[0]), "--set", "camera_gain_std=0.02", PYTHONIOENCODING="utf-8")
    assert (done.returncode, done.stderr) == (0, "")
    assert "paper" in done.stdout
    assert "2.00% of the" in done.stdout
    assert sum("over time [s]" in line for line in done.stdout.splitlines()) == 2
    refused = leactl("analyze", str(whole[0]), "--set", "camera_gain_std=lots")
    assert refused.returncode == 2
    assert refused.stderr == "leactl: --set camera_gain_std=lots: name=number was expected\n"
    refused = leactl("analyze", str(whole[0]), "--set", "camera=1")
    assert "thermal has no option camera; it has camera_offset_std" in refused.stderr


def test_a_plant_whose_winding_has_no_way_past_the_housing_is_not_given_one(tmp_path):
    bench = HeatedBench(tmp_path, plant=Plant(Rwa=3416.3, Rwh=1.1, Rha=3.5, Cw=25.8, Ch=130.6))
    result = analyze_runs([bench.run(current=5.0, rate_Hz=2.0, **{"heat_s": 2400.0, "cool_s": 1800.0})], **EXACT)
    assert math.isnan(result.find("winding_ambient_resistance").value)
    assert "winding_ambient_resistance is above" in notes(result)
    assert covered(result.find("parallel_thermal_resistance"), bench.plant.parallel)


def test_a_record_far_from_steady_state_gives_wide_intervals_or_none(heated):
    short = analyze_runs([heated.run(heat_s=240.0, cool_s=0.0, rate_Hz=2.0)])
    assert "no steady state" in notes(short)
    for name in ("housing_ambient_resistance", "parallel_thermal_resistance", "winding_ambient_resistance"):
        assert math.isnan(short.find(name).value)
        assert f"{name} is not identifiable" in notes(short)
    assert math.isnan(short.find("continuous_current").value)
    assert covered(short.find("housing_capacitance"), 469.1)


def test_less_of_a_record_gives_wider_intervals(whole, heated):
    short = analyze_runs([heated.run(heat_s=1200.0, cool_s=0.0, rate_Hz=2.0)], **EXACT)
    for name in (*NETWORK, "housing_capacitance", "parallel_thermal_resistance", "continuous_current"):
        assert short.find(name).std > 2.0 * whole[1].find(name).std
    assert covered(short.find("parallel_thermal_resistance"), heated.plant.parallel)


def test_under_white_noise_standard_errors_are_those_of_least_squares(heated):
    noise = 0.5
    path = heated.run(noise=noise, rate_Hz=1.0, volts=0.0, amperes=0.0)
    result = analyze_runs([path], camera_lag=0.0, **EXACT)
    assert "line_current reads 9 throughout" in notes(result)
    with Run.open(path) as run:
        current, voltage = run.channel("line_current"), run.channel("line_voltage")
    heat = np.column_stack([current.values * voltage.values, np.ones(len(current.time))])

    def seen(wa, wh, ha, cw, ch, winding, housing):
        rates = np.array([[-(1 / wa + 1 / wh) / cw, 1 / wh / cw], [1 / wh / ch, -(1 / wh + 1 / ha) / ch]])
        driven = np.array([[1 / cw, 25.0 / wa / cw], [0.0, 25.0 / ha / ch]])
        bodies = StateSpace(rates, driven, np.eye(2), np.zeros((2, 2)))
        return lsim(bodies, heat, current.time - current.time[0], [winding, housing])[1]

    true = np.array([5.6, 0.3, 1.7, 22.9, 469.1, 25.0, 25.0])
    slopes = [(seen(*(true + d)) - seen(*(true - d))) / 2e-4 for d in 1e-4 * np.diag(true)]
    weights = noise**2 * np.array([(4 / 9 + 1 / 9) / 3, 1 / 3])  # three places a region
    table = np.stack([slope.T.ravel() for slope in slopes], axis=1)
    informed, spread = table.T @ table, table.T @ (np.repeat(weights, len(heat))[:, None] * table)
    expected = np.sqrt(np.diag(np.linalg.solve(informed, np.linalg.solve(informed, spread).T)))
    for name, relative in zip((*NETWORK, *BODIES), expected, strict=False):
        assert result.find(name).std / result.find(name).value == pytest.approx(relative, rel=0.05)


def test_a_clock_that_is_late_is_found_or_told(heated):
    path = heated.run(lag=-712.4, **SHORT)
    result = analyze_runs([path], **EXACT)
    assert result.find("camera_lag").value == pytest.approx(-712.4, abs=0.1)
    assert "-712." in notes(result)
    assert covered(result.find("housing_capacitance"), 469.1)
    told = analyze_runs([path], camera_lag=-712.4, **EXACT)
    assert told.find("winding_capacitance").value == pytest.approx(22.9, rel=0.02)
    assert "camera_lag" not in {item.name for item in told.results}


@pytest.mark.long
def test_an_offset_of_the_camera_is_found_and_an_absurd_one_told(heated):
    result = analyze_runs([heated.run(offset=1.5, **SHORT)])
    assert result.find("camera_offset_winding").value == pytest.approx(1.5, abs=0.2)
    assert covered(result.find("line_resistance"), 0.528)
    absurd = notes(analyze_runs([heated.run(offset=52.0, **SHORT)]))
    assert re.search(r"winding reads \+\d+\.\d K off the sensor of the air, more than the camera's 1 K", absurd)


def test_frames_that_are_missing_are_left_out_and_counted(heated):
    def miss(time, camera, supply):
        camera["active_2"][200:400] = np.nan
        camera["housing_1"][heated.rng.random(len(time)) < 0.3] = np.nan
        camera["housing_3"][:] = np.nan

    result = analyze_runs([heated.run(edit=miss, **SHORT)], **EXACT)
    assert "active_1, active_2, active_3: 200 of" in notes(result)
    assert "left out housing_3: not seen in most frames" in notes(result)
    for name in BODIES:
        assert result.find(name).value == pytest.approx(heated.plant.known[name], abs=4.0 * result.find(name).std)


def test_one_place_a_region_is_enough_and_said(heated):
    result = analyze_runs([heated.run(places=1, **SHORT)], **EXACT)
    assert "housing_1 alone stands for its region" in notes(result)
    assert covered(result.find("housing_capacitance"), 469.1)


def test_without_ambient_the_air_is_fitted(heated):
    result = analyze_runs([heated.run(leave_out=("ambient",), rate_Hz=1.0)], **EXACT)
    assert "no ambient_temperature" in notes(result)
    assert result.find("parallel_thermal_resistance").value == pytest.approx(heated.plant.parallel, rel=0.01)


def test_an_ambient_that_drifts_is_followed(heated):
    result = analyze_runs([heated.run(ambient=lambda time: 22.0 + 4.0 * time / 9000.0, rate_Hz=1.0)], **EXACT)
    assert "the air changed by 3.9 K" in notes(result)
    assert result.find("parallel_thermal_resistance").value == pytest.approx(heated.plant.parallel, rel=0.002)


def test_heat_that_a_trip_ended_is_cooled_from(heated):
    path = heated.run(
        current=lambda time: np.where((time > 60.0) & (time < 1500.0), 9.0, 0.0), rate_Hz=1.0, status="tripped"
    )
    result = analyze_runs([path], **EXACT)
    assert "status is 'tripped'" in notes(result)
    assert "heated for less than 30 min" in notes(result)
    assert result.find("parallel_thermal_resistance").value == pytest.approx(heated.plant.parallel, rel=0.01)


def test_a_supply_that_was_not_recorded_for_a_while_parts_the_record(heated):
    def miss(time, camera, supply):
        supply["line_voltage"][2000:2300] = np.nan

    result = analyze_runs([heated.run(edit=miss, rate_Hz=1.0)], **EXACT)
    assert "frames at which the supply was not recorded" in notes(result)
    assert result.find("parallel_thermal_resistance").value == pytest.approx(heated.plant.parallel, rel=0.005)


def kelvin(time, camera, supply):
    for name in camera:
        camera[name] += 273.15


def swapped(time, camera, supply):
    supply["line_voltage"] *= -1.0


def unseen(time, camera, supply):
    for name in camera:
        if name.startswith("housing"):
            camera[name][:] = np.nan


BAD = {
    "kelvin": ({"edit": kelvin}, InputError, r"at active_1 is never below 29\d\.\d degC; degC was expected.*kelvin"),
    "negative": ({"edit": swapped}, InputError, r"is -0\.\d+ ohm; a resistance above zero was expected"),
    "no current": ({"current": 0.0, "amperes": 0.0}, NotIdentifiable, r"never exceeds 0 A: nothing was heated"),
    "no housing seen": ({"edit": unseen}, NotIdentifiable, "housing_temperature of test was never seen"),
    "no inactive": (
        {"leave_out": ("inactive_1", "inactive_2", "inactive_3")},
        MissingChannel,
        r"no winding_temperature of test at a location 'inactive_\.\.\.'; it has active_1",
    ),
    "no voltage": ({"leave_out": ("line_voltage",)}, MissingChannel, "no line_voltage of test"),
    "no housing": ({"leave_out": ("housing_1", "housing_2", "housing_3")}, MissingChannel, "no housing_temperature"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_used_is_refused_in_one_line(heated, case):
    how, error, message = BAD[case]
    with pytest.raises(error, match=message) as raised:
        analyze_runs([heated.run(heat_s=60.0, cool_s=30.0, rate_Hz=2.0, **how)])
    assert len(raised.value.faults) == 1


@pytest.mark.parametrize(
    "options", [{"camera_gain_std": -0.1}, {"camera_lag": math.nan}, {"winding_limit": 20.0}, {"ambient": math.inf}]
)
def test_options_out_of_range_are_refused(whole, options):
    with pytest.raises(InputError):
        analyze_runs([whole[0]], **options)
