"""Efficiency and losses from runs whose powers are known in closed form."""

import json
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from leactl.analysis.analyze import analyze_runs
from leactl.analysis.experiments.efficiency import analyze
from leactl.errors import InputError, MissingChannel, NotIdentifiable

from .coupled import CURRENTS, SPEEDS, CoupledBench, Truth
from .synthetic import analyzed, covered

TURNS = {"speeds": (5.0, 25.0, 15.0), "currents": (14.0, 2.0, 20.0, 8.0)}  # so that time is neither
SLOW = settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def coupled(tmp_path):
    return CoupledBench(tmp_path)


def noted(result, text):
    return [note for note in result.notes if text in note]


@SLOW
@given(
    r=st.floats(0.05, 0.6), kt=st.floats(0.1, 1.0), b=st.floats(0.0, 0.05), f=st.floats(0.0, 0.5),
    driver=st.sampled_from(["test", "load"]), zero=st.floats(-1.0, 1.0),
)  # fmt: skip
def test_without_noise_every_power_comes_back(tmp_path_factory, r, kt, b, f, driver, zero):
    truth = Truth(r, kt, b, f)
    model = f"phase_resistance: {r!r}\nback_emf_constant: {kt!r}\n"
    path = CoupledBench(tmp_path_factory.mktemp("run")).run(truth, driver=driver, zero=zero, noise=0.0, model=model)
    result = analyzed(analyze, path)
    drives, driven = ("", "load_") if driver == "test" else ("load_", "")
    plus, minus = truth.efficiencies()
    w, i = np.meshgrid(SPEEDS, CURRENTS, indexing="ij")
    own, taken, given_ = truth.driving(w, i)
    expected = {
        f"{drives}driving_efficiency": plus.mean(),
        f"{drives}driving_efficiency_spread": plus.std(ddof=1),
        f"{drives}driving_efficiency_highest": plus.max(),
        f"{drives}driving_loss": (taken - given_).mean(),
        f"{drives}driving_loss_copper": (r * own**2).mean(),
        f"{drives}driving_loss_friction": (truth.drag(w) * w).mean(),
        f"{driven}driven_efficiency": minus.mean(),
        f"{driven}driven_loss_copper": (r * i**2).mean(),
        f"{driven}driven_negative_share": (minus < 0).mean(),
    }
    for name, value in expected.items():
        assert result.find(name).value == pytest.approx(value, rel=1e-7, abs=1e-7), name
    [grid] = [grid for grid in result.grids if grid.name == f"{driven}driven"]
    np.testing.assert_allclose(np.array(grid.values["efficiency_1"])[:, ::-1], minus, rtol=1e-7, atol=1e-9)
    assert grid.axes == {"velocity_rad_s": SPEEDS, "current_A": tuple(-item for item in reversed(CURRENTS))}


@pytest.mark.long
def test_intervals_hold_the_truth_with_noise_zero_and_calibrations(coupled):
    truth, names = (
        Truth(),
        ("driving_efficiency", "driving_loss", "load_driven_efficiency", "load_driven_loss_friction"),
    )
    plus, minus = truth.efficiencies()
    w, i = np.meshgrid(SPEEDS, CURRENTS, indexing="ij")
    _, taken, given_ = truth.driving(w, i)
    true = dict(
        zip(names, (plus.mean(), (taken - given_).mean(), minus.mean(), (truth.drag(w) * w).mean()), strict=True)
    )
    held = dict.fromkeys(names, 0)
    for _ in range(30):
        gains = 1.0 + coupled.rng.normal(0.0, 0.01, 3)

        def misread(_time, columns, gains=gains):
            columns["torque"] *= gains[0]
            columns["q_axis_current"] *= gains[1]
            columns["load_current"] *= gains[1]

        path = coupled.run(zero=coupled.rng.normal(0.0, 0.1), edit=misread, edit_steps=clear_of(gains[1]))
        told = {"torque_gain_std": 0.01, "current_gain_std": 0.01, "resistance_std": 0.01}
        resistance = truth.r * gains[2]
        result = analyzed(analyze, path, phase_resistance=resistance, **told)
        for name in names:
            held[name] += covered(result.find(name), true[name])
    assert min(held.values()) >= 25  # three standard deviations below 95 of 100
    assert max(result.find(name).std / abs(true[name]) for name in names) < 0.2


def clear_of(gain):
    """Setpoints as the drive that misreads its current reaches them."""

    def edit(steps):
        for _name, _start, _stop, _settle, told in steps:
            if "current_A" in told:
                told["current_A"] *= gain

    return edit


@pytest.mark.long
def test_noise_alone_is_covered_too(coupled):
    plus, _ = Truth().efficiencies()
    results = [analyzed(analyze, coupled.run(zero=0.3)).find("driving_efficiency") for _ in range(30)]
    assert sum(covered(result, plus.mean()) for result in results) >= 25
    printed = math.sqrt(np.mean([result.std**2 for result in results]))
    assert np.std([result.value for result in results], ddof=1) == pytest.approx(printed, rel=0.45)


def test_measured_voltages_give_the_power_that_warm_windings_take(coupled):
    warm = Truth(r=0.264 * (1.0 + 0.004 * 60.0))
    path = coupled.run(warm, voltages=True)
    plus, minus = warm.efficiencies()
    result = analyzed(analyze, path)
    assert result.find("driving_efficiency").value == pytest.approx(plus.mean(), abs=5e-4)
    assert result.find("load_driven_efficiency").value == pytest.approx(minus.mean(), abs=5e-3)
    assert noted(result, "at the temperature that the winding had")
    told = analyzed(analyze, path, winding_temperature=25.0).find("driving_efficiency").value
    assert told > plus.mean() + 0.03
    without = analyzed(analyze, coupled.run(warm), winding_temperature=85.0)
    assert without.find("driving_efficiency").value == pytest.approx(plus.mean(), abs=5e-4)
    assert noted(without, "0.3274 ohm at 85 degC")


def test_what_the_drives_lose_comes_from_the_dc_link(coupled):
    item = analyzed(analyze, coupled.run(voltages=True, link=7.5)).find("drives_loss")
    assert item.value == pytest.approx(7.5, abs=0.2)
    assert covered(item, 7.5)
    assert noted(analyzed(analyze, coupled.run(link=7.5)), "losses of the drives are not known")


def test_points_that_were_not_held_have_no_value_and_count_nowhere(coupled):
    def spoil(time, columns):
        hold = ((time - 4.0) // 2.5).astype(int)
        columns["velocity"][hold == 11] *= 0.9  # 25 rad/s 20 A: at the voltage's ceiling
        columns["torque"][hold == 2] += np.linspace(0.0, 1.0, 125)  # 5 rad/s 14 A: never settles
        columns["load_current"][hold == 5] = np.nan  # 15 rad/s 8 A

    result = analyzed(analyze, coupled.run(noise=0.1, edit=spoil))
    plus, _ = Truth().efficiencies()
    absent = np.zeros((3, 4), bool)
    absent[2, 3] = absent[0, 2] = absent[1, 1] = True
    assert result.find("driving_efficiency").value == pytest.approx(plus[~absent].mean(), abs=5e-5)
    values = np.array(result.grids[0].values["efficiency_1"])[:, ::-1]
    np.testing.assert_array_equal(np.isnan(values), absent)
    assert noted(result, "velocity was not reached (25 rad/s -20 A)")
    assert noted(result, "torque was not steady (5 rad/s -14 A)")
    assert noted(result, "too little q_axis_current in the settled part (15 rad/s -8 A)")
    assert noted(result, "test driving: 9 of 12 points were held")
    assert result.as_json()["grids"][0]["values"]["loss_W"][2][0] is None
    assert json.loads(json.dumps(result.as_json(), allow_nan=False))["grids"]


def test_a_clipped_torque_sensor_loses_the_points_beyond_its_range(coupled):
    def clip(_time, columns):
        columns["torque"] = np.minimum(columns["torque"], 8.0)

    result = analyzed(analyze, coupled.run(edit=clip))
    plus, _ = Truth().efficiencies()
    assert noted(result, "torque of test is saturated at 8 in 3 holds")
    assert result.find("driving_efficiency").value == pytest.approx(plus[:, :3].mean(), abs=2e-4)


def test_a_drifting_torque_sensor_is_told_and_widens_the_interval(coupled):
    def drift(time, columns):
        columns["torque"] += 0.2 * time / time[-1]

    still = analyzed(analyze, coupled.run(**TURNS))
    moved = analyzed(analyze, coupled.run(**TURNS, edit=drift))
    assert not noted(still, "drifts")
    assert noted(moved, "torque drifts by 0.16 N*m")  # from the first hold to the last
    item = moved.find("driving_efficiency")
    assert covered(item, Truth().efficiencies()[0].mean())
    assert item.std > 20 * still.find("driving_efficiency").std


def test_a_wrong_torque_calibration_shows_against_the_currents(coupled):
    def scale(_time, columns):
        columns["torque"] *= 1.05

    assert noted(analyzed(analyze, coupled.run(**TURNS, edit=scale)), "torque is +4.8% off")
    assert not noted(analyzed(analyze, coupled.run(**TURNS)), "off what the currents")


@pytest.mark.parametrize(
    ("column", "named"),
    [
        ("torque", "torque and velocity"),
        ("q_axis_current", "current and velocity of the test actuator"),
        ("q_axis_voltage", "voltage and current of the test actuator"),
    ],
)
def test_swapped_signs_are_refused_by_name(coupled, column, named):
    def swap(_time, columns):
        columns[column] *= -1.0

    with pytest.raises(InputError, match=f"{named}.* have the signs of the other role"):
        analyzed(analyze, coupled.run(voltages=True, edit=swap))


def test_a_driven_current_with_the_wrong_sign_is_named(coupled):
    def swap(_time, columns):
        columns["load_current"] *= -1.0

    with pytest.raises(
        NotIdentifiable, match=r"no point of the grid was held[\s\S]*q_axis_current of load has the opposite sign"
    ):
        analyzed(analyze, coupled.run(edit=swap))


def test_missing_repeats_leave_each_point_its_weight(coupled):
    skip = {(2, 5.0, 2.0), (3, 5.0, 2.0), (2, 25.0, 20.0)}
    result = analyzed(analyze, coupled.run(repeats=3, skip=skip))
    assert result.find("driving_efficiency").value == pytest.approx(Truth().efficiencies()[0].mean(), abs=2e-4)
    assert noted(result, "test driving: 2 points have fewer than 3 repeats")


def test_passes_that_differ_decide_the_interval(coupled):
    paths = [coupled.run(Truth(f=f)) for f in (0.18, 0.24, 0.20, 0.22)]
    item = analyzed(analyze, *paths).find("driving_loss_friction")
    each = [analyzed(analyze, path).find("driving_loss_friction").value for path in paths]
    assert item.std == pytest.approx(np.std(each, ddof=1) / 2.0, rel=1e-6)
    assert item.high - item.value == pytest.approx(3.182 * item.std, rel=1e-3)  # Student's t, 3 degrees of freedom


def test_one_actuator_alone_has_its_own_figures(coupled):
    result = analyzed(analyze, coupled.run(without=("load_current", "load_velocity")))
    assert {estimate.name.split("_")[0] for estimate in result.results} == {"driving"}
    assert noted(result, "no current of the load actuator")
    assert result.find("driving_efficiency").value == pytest.approx(Truth().efficiencies()[0].mean(), abs=2e-4)


def test_both_roles_swapped_give_both_maps_of_one_actuator(coupled):
    result = analyze_runs([coupled.run(driver="test"), coupled.run(driver="load")])
    plus, minus = Truth().efficiencies()
    for name, value in (("driving", plus), ("load_driving", plus), ("driven", minus), ("load_driven", minus)):
        assert result.find(f"{name}_efficiency").value == pytest.approx(value.mean(), abs=2e-3)
    assert {grid.actuator for grid in result.grids} == {"a1"}


def test_what_is_lacking_is_named(coupled):
    with pytest.raises(NotIdentifiable, match="give --set phase_resistance= and --set back_emf_constant="):
        analyzed(analyze, coupled.run(model=""))
    with pytest.raises(MissingChannel, match="no velocity of test or load"):
        analyzed(analyze, coupled.run(without=("velocity", "load_velocity")))
    with pytest.raises(NotIdentifiable, match="found no step 'hold' with velocity_rad_s and current_A"):
        analyzed(analyze, coupled.run(edit_steps=lambda steps: steps.__delitem__(slice(1, None))))
    for told in ({"resistance_std": -1.0}, {"phase_resistance": 0.0}, {"winding_temperature": 900.0}):
        with pytest.raises(InputError, match="expected"):
            analyzed(analyze, coupled.run(), **told)
    exact = analyzed(analyze, coupled.run(edit_steps=lambda steps: steps.pop(0)))
    assert noted(exact, "no step 'zero' with drives off")
