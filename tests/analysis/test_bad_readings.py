"""Channels that lie: swapped signs, ends of range, readings that hang. Each is said or refused, none is fitted."""

import numpy as np
import pytest

from leactl.analysis.analyze import analyze_runs
from leactl.errors import InputError

from .control_runs import step_run
from .coupled import CoupledBench
from .heated import HeatedBench
from .synthetic import HOLD_S, SETTLE_S, covered
from .test_back_drive import driven as driven_back
from .test_coast_down import coasting
from .test_no_load_loss import turned
from .test_torque_pulses import pulsed
from .test_torque_speed_envelope import driven

NOISE = {"q_axis_current": 0.015, "velocity": 0.002, "torque": 0.004}


def negated(*names):
    def edit(*given):
        for name in names:
            given[-1][name] *= -1.0

    return edit


def cut_at(name, limit):
    """A channel whose range ends there, both ways."""

    def edit(*given):
        given[-1][name] = np.clip(given[-1][name], -limit, limit)

    return edit


def hung(name, first, last):
    """A channel that tells one reading again and again over a part of the record."""

    def edit(*given):
        column = given[-1][name]
        part = slice(round(first * len(column)), round(last * len(column)))
        column[part] = column[part.start]

    return edit


def refused(path):
    """The one line that a run is refused with."""
    with pytest.raises(InputError) as refusal:
        analyze_runs([path])
    [line] = str(refusal.value).splitlines()
    return line


@pytest.mark.parametrize("name", ["torque", "q_axis_current"])
def test_a_swapped_sign_is_no_torque_constant(bench, name):
    assert "a sign is swapped" in refused(bench.torque(noise=NOISE, edit=negated(name)))
    assert "a sign is swapped" in refused(pulsed(bench, edit=negated(name)))


@pytest.mark.parametrize("name", ["velocity", "q_axis_current"])
def test_a_swapped_sign_is_no_friction(bench, name):
    assert "a sign is swapped" in refused(bench.friction(noise=NOISE, edit=negated(name)))


def test_a_swapped_sign_is_no_drag_and_no_inertia(bench):
    assert "a sign is swapped" in refused(turned(bench, edit=negated("q_axis_current")))
    assert "has the opposite sign of its demand" in refused(turned(bench, edit=negated("velocity")))
    assert "a sign is swapped" in refused(coasting(bench, noise=0.002, edit=negated("q_axis_current")))
    assert "a sign is swapped" in refused(driven_back(bench, edit=negated("torque")))
    assert "a sign is swapped" in refused(driven_back(bench, edit=negated("angle")))


def test_a_zero_of_the_current_above_the_drag_is_no_swapped_sign(bench):
    """Both directions together cancel it; one of them alone has a current against its motion."""
    result = analyze_runs([coasting(bench, f=0.03, b=0.001, zero_A=0.2, noise=0.002)])
    assert result.find("rotor_inertia").value == pytest.approx(0.0024, rel=0.02)


@pytest.mark.parametrize("limit", [5.0, 6.0])
def test_velocities_at_the_end_of_their_range_do_not_count_in_friction(bench, limit):
    path = bench.friction(noise=NOISE, edit=cut_at("velocity", limit))
    result = analyze_runs([path])
    assert any("velocity of test is saturated at" in note for note in result.notes)
    assert covered(result.find("viscous_damping"), 0.0238)
    assert covered(result.find("coulomb_friction"), 0.208)


def test_a_current_at_the_end_of_its_range_is_no_torque_constant_of_another_convention(bench):
    result = analyze_runs([bench.torque(noise=NOISE, edit=cut_at("q_axis_current", 20.0))])
    assert any("q_axis_current of test is saturated at 20" in note for note in result.notes)
    assert covered(result.find("torque_constant"), 0.49)
    assert result.find("torque_constant").std < 0.001
    assert not any("amplitude" in note for note in result.notes)


@pytest.mark.parametrize("name", ["q_axis_current", "velocity"])
def test_readings_that_hang_are_missed_ones(bench, name):
    result = analyze_runs([bench.friction(noise=NOISE, edit=hung(name, 0.32, 0.57))])
    assert any(f"readings of {name} came again" in note for note in result.notes)
    assert covered(result.find("viscous_damping"), 0.0238)
    assert result.find("viscous_damping").std < 0.001


@pytest.mark.parametrize(("name", "share"), [("velocity", 0.9), ("velocity", 0.97), ("q_axis_current", 0.8)])
def test_a_held_speed_or_its_current_beyond_range_gives_no_inertia(bench, name, share):
    def edit(columns):
        columns["q_axis_current"] += bench.rng.normal(0.0, 0.015, len(columns["q_axis_current"]))
        cut_at(name, share * float(np.max(np.abs(columns[name]))))(columns)

    assert "coast-down" in refused(coasting(bench, noise=0.002, edit=edit))


@pytest.mark.parametrize("limit", [12.5, 9.0])
def test_a_torque_beyond_the_sensor_is_no_highest_torque(bench, limit):
    result = analyze_runs([driven(bench, noise=NOISE, edit=cut_at("torque", limit))])
    outcome = result.find("highest_torque")
    assert np.isnan(outcome.value)
    assert outcome.low == pytest.approx(limit)
    assert np.isnan(result.find("highest_power").value)
    assert any("the highest torque lies above" in note for note in result.notes)


def test_an_envelope_with_no_torque_within_range_is_refused(bench):
    def edit(time, columns):
        between = time % HOLD_S < SETTLE_S
        columns["torque"][between] = bench.rng.normal(1.0, 0.004, between.sum())
        cut_at("torque", 4.0)(columns)

    assert "torque of test is saturated at 4" in refused(driven(bench, noise=NOISE, edit=edit))


@pytest.mark.parametrize("name", ["torque", "velocity"])
def test_an_envelope_of_a_channel_that_hangs_throughout_is_refused(bench, name):
    def edit(_time, columns):
        columns[name][:] = 12.5

    assert f"{name} of test reads 12.5" in refused(driven(bench, noise={}, edit=edit))


def test_a_current_beyond_range_is_no_limit_of_the_voltage(bench):
    path = driven(bench, noise=NOISE, edit=cut_at("q_axis_current", 25.0))
    assert "q_axis_current of test is saturated at 25 A" in refused(path)
    assert "a sign is swapped" in refused(driven(bench, noise=NOISE, edit=negated("q_axis_current")))


def test_efficiency_takes_no_current_and_no_voltage_beyond_range(tmp_path):
    bench = CoupledBench(tmp_path)
    highest = analyze_runs([bench.run()]).find("driving_efficiency_highest").high
    for name, limit in (("q_axis_current", 18.0), ("q_axis_voltage", 15.0)):
        result = analyze_runs([bench.run(voltages=True, edit=cut_at(name, limit))])
        assert any(f"{name} of test is saturated at {limit:g}" in note for note in result.notes)
        assert result.find("driving_efficiency_highest").value < highest + 0.005


def test_efficiency_takes_no_current_that_hangs(tmp_path):
    bench = CoupledBench(tmp_path)
    whole, found = (
        analyze_runs([bench.run(repeats=2, edit=edit)]) for edit in (None, hung("q_axis_current", 0.3, 0.6))
    )
    assert any("q_axis_current" in note and "do not count" in note for note in found.notes)
    assert found.find("driving_efficiency").value == pytest.approx(whole.find("driving_efficiency").value, abs=0.002)


@pytest.mark.parametrize("name", ["load_voltage", "q_axis_voltage"])
def test_efficiency_refuses_a_swapped_voltage_of_either_role(tmp_path, name):
    assert "a sign is swapped" in refused(CoupledBench(tmp_path).run(voltages=True, edit=negated(name)))


def test_efficiency_says_where_a_drift_would_not_show(tmp_path):
    bench = CoupledBench(tmp_path)
    once, thrice = (analyze_runs([bench.run(repeats=repeats)]) for repeats in (1, 3))
    assert any("a drift of torque sensor or currents cannot be told" in note for note in once.notes)
    assert not any("drift" in note for note in thrice.notes)


@pytest.mark.parametrize(("drift", "said"), [(0.0, False), (0.3, True)])
def test_a_torque_that_drifts_is_named_and_its_interval_holds_the_truth(bench, drift, said):
    def edit(time, columns):
        columns["torque"] += drift * time / time[-1]

    result = analyze_runs([bench.torque(noise=NOISE, edit=edit)])
    assert any("levels drift by +0." in note for note in result.notes) == said
    assert covered(result.find("torque_constant"), 0.49)


def test_one_pass_in_order_tells_no_drift_and_says_so(bench):
    result = analyze_runs([bench.torque(trials=1, sides=("rising",), noise=NOISE)])
    assert any("a drift cannot be told from the slope" in note for note in result.notes)
    whole = analyze_runs([bench.torque(noise=NOISE)])
    assert not any("drift" in note for note in whole.notes)


def test_an_overshoot_that_is_cut_off_does_not_count(tmp_path):
    def edit(columns):
        columns["q_axis_current"] = np.minimum(columns["q_axis_current"], 7.6)

    result = analyze_runs([step_run(tmp_path, noise=0.015, edit=edit)])
    assert any("left out 5: q_axis_current is clipped at 7.6 A" in note for note in result.notes)
    assert result.find("overshoot").value == pytest.approx(8.3, abs=0.5)


def test_a_response_that_stays_short_and_one_that_drifts_are_named(tmp_path):
    def short(columns):
        columns["q_axis_current"] *= 0.85

    def drifts(columns):
        columns["q_axis_current"] += 0.5 * columns["time"] / columns["time"][-1]

    said = [
        " ".join(analyze_runs([step_run(tmp_path, noise=0.015, edit=edit)]).notes) for edit in (None, short, drifts)
    ]
    assert ["short of its reference" in notes for notes in said] == [False, True, True]
    assert ["before the jump moves" in notes for notes in said] == [False, False, True]


@pytest.mark.parametrize(("name", "limit"), [("line_voltage", 5.5), ("line_current", 8.8)])
def test_a_supply_beyond_range_is_no_heat(tmp_path, name, limit):
    def edit(_time, _camera, supply):
        supply[name] = np.minimum(supply[name], limit)

    assert f"{name} of test is clipped at {limit:g}" in refused(
        HeatedBench(tmp_path).run(rate_Hz=2.0, heat_s=600.0, cool_s=300.0, edit=edit)
    )


def test_frames_beyond_the_camera_s_range_do_not_count(tmp_path):
    def edit(_time, camera, _supply):
        for place in (1, 2, 3):
            camera[f"active_{place}"] = np.minimum(camera[f"active_{place}"], 60.0)

    path = HeatedBench(tmp_path).run(rate_Hz=1.0, heat_s=600.0, cool_s=900.0, edit=edit)
    result = analyze_runs([path])
    assert any("active_1 is clipped at 60 degC" in note for note in result.notes)
    assert covered(result.find("winding_capacitance"), 22.9)


@pytest.mark.parametrize("region", ["inactive", "housing"])
def test_places_of_the_camera_that_are_exchanged_are_refused(tmp_path, region):
    def edit(_time, camera, _supply):
        for place in (1, 2, 3):
            names = f"active_{place}", f"{region}_{place}"
            camera[names[0]], camera[names[1]] = camera[names[1]], camera[names[0]]

    path = HeatedBench(tmp_path).run(rate_Hz=1.0, heat_s=600.0, cool_s=300.0, edit=edit)
    assert "places of the camera are exchanged" in refused(path)


def test_a_camera_that_drifts_by_kelvins_has_intervals_that_hold_the_truth(tmp_path):
    def edit(time, camera, _supply):
        for name in camera:
            camera[name] += 5.0 * time / time[-1] if name != "ambient" else 0.0

    bench = HeatedBench(tmp_path)
    result = analyze_runs([bench.run(rate_Hz=0.25, edit=edit)])
    assert any("off the sensor of the air: its uncertainty is taken as that much" in note for note in result.notes)
    for name in ("parallel_thermal_resistance", "line_resistance", "resistance_coefficient"):
        assert covered(result.find(name), bench.plant.known[name]), name


@pytest.mark.parametrize("name", ["q_axis_current", "velocity"])
def test_a_channel_that_hangs_from_the_beginning_on_gives_no_friction(bench, name):
    assert "friction" in refused(bench.friction(noise=NOISE, edit=hung(name, 0.06, 1.0)))


def test_a_current_that_hangs_shows_in_steps_as_coarse_as_its_noise(bench):
    def edit(time, columns):
        columns["q_axis_current"] = 0.0137 * np.round(columns["q_axis_current"] / 0.0137)
        hung("q_axis_current", 0.32, 0.57)(columns)

    result = analyze_runs([bench.friction(noise=NOISE, edit=edit)])
    assert any("q_axis_current" in note and "missed" in note for note in result.notes)
    assert covered(result.find("viscous_damping"), 0.0238)
    assert result.find("viscous_damping").std < 0.001
