"""Sound machines in the place of a case: what they leave over, and in which units what they leave is counted."""

import importlib
import math
import re
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl.effects.voltage_limit import MOST_LEFT_SHARE
from leactl.gap.diagnose import read_case
from leactl.gap.null import (
    LEAST_COMMON_STDS,
    SOUND_MACHINES,
    common_sizes,
    machines_with_spread,
    measure,
    set_floors,
    sound_runs,
)
from leactl.gap.replay.cutting import TRACKING_SAMPLES
from leactl.gap.search.effect_regression import BIAS_DOUBT_SHARE, NEGLIGIBLE_SHARE, PRIORS, Evidence
from leactl.gap.search.effect_sets import ENTRY_HEIGHT, FurtherEffect, fit_each_alone, standard_errors
from leactl.gap.search.parameters import calibrated_parameters, nominal_value
from leactl.gap.search.stamp_fit import MOST_STAMP_DELAY, STAMP_DELAY_STD
from leactl.gap.signals.derived import hidden_step_samples, resolved_samples
from leactl.gap.signals.noise import SEGMENT, quantum_of
from leactl.gap.signals.scales import worth_knowing
from leactl.gap.signals.voltage_ceiling import at_ceiling
from leactl.joints.machine import draw_machine
from leactl.joints.make import draw_runs
from leactl.model.nominal import read_model
from tests.gap.drawn_machines import case_of, write_cases
from tests.gap.synthetic import clocked, model, record

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("explanation/gap.md", "decisions/0008-the-null-is-measured-on-the-case.md")
LEFT = 5.0  # times what sound machines leave, within which a case without an effect stays
COUNT = 2e-4  # rad, of an encoder


@pytest.fixture(scope="module")
def case(sound_bench):
    return read_case(
        sorted(sound_bench.glob("*-a.h5")), sorted(sound_bench.glob("*-b.h5")), sound_bench / "nominal.yaml"
    )


@pytest.fixture(scope="module")
def null(case):
    return measure(case.fitted, case.model)


@pytest.mark.long
def test_a_case_without_an_effect_leaves_what_sound_machines_leave(case, null):
    evidence = Evidence(case.fitted, case.model, only=[])
    evidence.settle([])
    left = evidence.unrest()
    assert set(left) == set(null.unrest)
    for key, value in left.items():
        assert value < LEFT * max(null.unrest[key], 1.0), key


@pytest.mark.long
def test_held_out_runs_are_weighed_by_what_sound_machines_leave_in_the_fitted_ones(case, null):
    evidence = Evidence(case.fitted, case.model, only=[])
    assert {evidence.expected_unrest(rows) for rows in evidence.stack.rows} == {1.0}
    evidence.compare_with(null)
    other = evidence.on(case.held_out, [("cogging", (7.0,))])
    assert {rows.equation for rows in other.stack.rows} == {rows.equation for rows in evidence.stack.rows}
    for rows in other.stack.rows:
        key = rows.equation, rows.kind
        assert other.expected_unrest(rows) == max(
            1.0, null.unrest[key], null.residual_variances[key] / rows.white_noise**2
        ), key
    for candidate in other.candidates:
        assert other.floor(candidate) == evidence.floor(candidate) > 0.0


def shown(size, std=0.02):
    """A form of an effect with a signed size, as one sound machine shows it."""
    covariance = np.full((1, 1), std**2)
    return FurtherEffect(("gear_backlash", (0.005, 0.2)), 1.0, abs(size), std, (size,), ("share",), covariance, 0.0)


def wave(cosine, sine, std=0.02):
    """A wave over the angle in units of its coefficients, as one sound machine shows it."""
    size = math.hypot(cosine, sine)
    return FurtherEffect(("unbalance", ()), 1.0, size, std, (cosine, sine), ("cos", "sin"), std**2 * np.eye(2), 0.0)


def test_what_all_sound_machines_show_alike_is_a_floor_and_what_noise_shows_is_none():
    alike = [[shown(0.058), shown(0.058)], [shown(0.061), shown(-0.061)], [shown(0.055), None]]
    biased, unseen_in_one = common_sizes(alike)
    assert biased == pytest.approx(np.sqrt(0.058**2 - 0.02**2 / 3.0))
    assert unseen_in_one == 0.0
    assert common_sizes(alike[:1]) == []
    assert common_sizes([[shown(0.02)], [shown(-0.03)], [shown(0.025)]]) == [0.0]
    random = np.random.default_rng(7)
    by_chance = common_sizes(
        [[shown(size) for size in 0.02 * random.standard_normal(4000)] for _ in range(SOUND_MACHINES)]
    )
    assert np.mean(np.array(by_chance) > 0.0) == pytest.approx(math.erfc(LEAST_COMMON_STDS / math.sqrt(2.0)), abs=0.01)
    waves = [[wave(*pair) for pair in 0.02 * random.standard_normal((4000, 2))] for _ in range(SOUND_MACHINES)]
    assert np.mean(np.array(common_sizes(waves)) > 0.0) == pytest.approx(math.exp(-(LEAST_COMMON_STDS**2)), abs=0.01)
    (same,) = common_sizes([[wave(0.05, -0.03)] for _ in range(SOUND_MACHINES)])
    assert same == pytest.approx(math.sqrt(0.05**2 + 0.03**2 - 2.0 * 0.02**2 / SOUND_MACHINES))


def test_a_form_that_no_run_shows_has_the_floor_of_the_next_that_is_shown(case, null):
    """Else a form refined to just beyond what an encoder's counts hide would lie next to one that shows nothing."""
    evidence = Evidence(case.fitted, case.model)
    name, forms = "stribeck", evidence.forms["stribeck"]
    hidden = [form[0] < np.median([form[0] for form in forms]) for form in forms]
    floors = [0.0 if hides else 0.1 + 0.01 * place for place, hides in enumerate(hidden)]
    errors = [math.inf if hides else 0.01 for hides in hidden]
    set_floors(evidence, replace(null, floors={name: floors}, common_sizes={}, errors={name: errors}))
    assert all(evidence.floor((name, form)) >= 0.1 for form in forms)
    assert [evidence.floor((name, form)) for form, hides in zip(forms, hidden, strict=True) if not hides] == [
        floor for floor in floors if floor
    ]


@pytest.mark.parametrize(("effect", "is_rescaled"), [("torque_limit", True), ("transport_delay", False)])
def test_a_limit_that_few_sound_samples_would_meet_has_no_floor_of_what_these_have_in_common(
    case, null, effect, is_rescaled
):
    """The case shows each form a hundred times as sharply as sound machines do."""
    evidence = Evidence(case.fitted, case.model)
    forms = evidence.forms[effect]
    case_errors = standard_errors(effect, fit_each_alone(evidence)[effect])
    common = {effect: [1.4] * len(forms)}
    sound = replace(
        null,
        floors={effect: [0.0] * len(forms)},
        common_sizes=common,
        errors={effect: [100.0 * error for error in case_errors]},
    )
    set_floors(evidence, sound)
    shown = [form for form, error in zip(forms, case_errors, strict=True) if 0.0 < error < math.inf]
    assert shown
    for form in shown:
        least_floor = NEGLIGIBLE_SHARE * evidence.worth_knowing.get(effect, 0.0)
        assert evidence.floor((effect, form)) == pytest.approx(max(0.014 if is_rescaled else 1.4, least_floor))


def test_what_an_equation_leaves_does_not_shrink_with_its_noise(case, null):
    evidence = Evidence(case.fitted, case.model, only=[])
    evidence.compare_with(null)
    rows = evidence.stack.rows[0]
    expected = evidence.expected_unrest(rows)
    rows.white_noise /= 10.0
    assert (
        evidence.expected_unrest(rows)
        >= 50.0 * null.residual_variances[rows.equation, rows.kind] / (rows.white_noise * 10.0) ** 2
    )
    assert evidence.expected_unrest(rows) > expected


def test_what_no_sound_machine_tells_is_not_judged(case, null):
    evidence = Evidence(case.fitted, case.model, only=[])
    evidence.compare_with(replace(null, unrest={}, residual_variances={}))
    assert not any(evidence.is_judged(rows) for rows in evidence.stack.rows)


def test_sound_machines_move_no_parameter_that_these_runs_tell(null):
    assert null.unidentifiable == ()
    for name in ("torque_constant", "viscous_damping", "coulomb_friction", "rotor_inertia", "phase_resistance"):
        mean, scatter = null.parameter_changes[name]
        assert abs(mean) < 0.01, name
        assert scatter < 0.01, name


@pytest.mark.long
def test_a_torque_constant_that_every_fit_holds_biases_no_other_parameter(tmp_path):
    """So precise runs move even what a narrow prior holds; nothing but ratios to it can be told without a voltage."""
    machine = draw_machine(np.random.default_rng([3, 0]), "spindle")
    fine = {"rate": 1000.0, "seconds": 20.0, "count": machine.count / 8.0, "sampling": True}
    machine = replace(machine, channels=("current", "angle", "current_reference", "velocity"), **fine)
    write_cases(tmp_path, {"spindle": (machine, draw_runs(np.random.default_rng([3, 1]), machine, [], "plain"))})
    joint = case_of(tmp_path / "spindle")
    result = measure(joint.fitted, joint.model, only=())
    assert result.held_parameters == ()
    for name in ("viscous_damping", "coulomb_friction", "rotor_inertia"):
        assert abs(result.parameter_changes[name][0]) < 0.002, name


@pytest.mark.parametrize(
    ("parameter", "reciprocal"), [("rotor_inertia", False), ("thermal.winding_housing_resistance", True)]
)
def test_what_fits_to_sound_machines_are_off_by_alike_is_taken_away(case, null, parameter, reciprocal):
    """Where they find 0.8 of an inertia, a machine has 1.25 of what its fit finds, and a fifth of that in doubt."""
    results = {}
    for bias in (0.0, -0.2):
        evidence = Evidence(case.fitted, case.model, only=[])
        evidence.compare_with(replace(null, parameter_changes={parameter: (bias, 0.003)}))
        (results[bias],) = (p for p in calibrated_parameters(evidence, evidence.settle([])) if p.parameter == parameter)
    factor = 1.2 if reciprocal else 1.0 / 0.8
    assert results[-0.2].fitted == pytest.approx(factor * results[0.0].fitted)
    assert results[0.0].std / results[0.0].nominal < 0.02
    assert results[-0.2].std / results[-0.2].nominal == pytest.approx(BIAS_DOUBT_SHARE * 0.2 * factor, rel=0.15)


@pytest.mark.parametrize("bias", [-0.977, -0.5, 0.5])
def test_what_runs_hardly_show_is_not_corrected_and_stands_in_its_standard_error(case, null, bias):
    parameters = {}
    for moved in (0.0, bias):
        evidence = Evidence(case.fitted, case.model, only=[])
        evidence.compare_with(replace(null, parameter_changes={"rotor_inertia": (moved, 0.003)}))
        (parameters[moved],) = (
            p for p in calibrated_parameters(evidence, evidence.settle([])) if p.parameter == "rotor_inertia"
        )
    assert parameters[bias].fitted == parameters[0.0].fitted
    assert parameters[bias].std / parameters[bias].nominal == pytest.approx(abs(bias), rel=0.15)


def test_a_simulated_run_has_the_channels_the_noise_and_the_rounding_of_the_measured_one(case):
    [again] = sound_runs(case.fitted, [case.model], np.random.default_rng(1))
    assert [item.name for item in again] == [fit.name for fit in case.fitted]
    moving = [pair for pair in zip(again, case.fitted, strict=True) if pair[1].fast is not None]
    assert len(moving) == 4
    for one, measured in moving:
        assert one.fast.values.keys() == measured.fast.values.keys()
        for key, values in measured.fast.values.items():
            assert np.isfinite(one.fast.values[key]).all()
            if key == ("angle", "test"):
                counts = one.fast.values[key] / quantum_of(np.diff(values))
                assert np.ptp(counts - np.round(counts)) < 1e-3
            elif not key[0].endswith("_reference"):
                rough, before = (np.median(np.abs(np.diff(v, 3))) for v in (one.fast.values[key], values))
                assert 0.3 * before <= rough <= 3.0 * before + 1e-12, (one.name, key)


@pytest.mark.parametrize("count", [1, 2, 3, 8])
@pytest.mark.parametrize("name", ["torque_constant", "bench.shaft_stiffness"])
def test_machines_are_off_by_what_is_usual_and_together_not_at_all(name, count):
    nominal = model()
    machines = machines_with_spread(nominal, name, count)
    off = np.array([nominal_value(nominal, name) / nominal_value(machine, name) for machine in machines]) - 1.0
    assert np.sqrt(np.mean(off**2)) == pytest.approx(PRIORS[name])
    assert np.mean(off) == pytest.approx(0.0 if count > 1 else PRIORS[name], abs=1e-12)
    assert all(machine.rotor_inertia == nominal.rotor_inertia for machine in machines)


def test_a_torque_constant_that_a_loud_voltage_does_not_tell_is_held_without_a_bias(case):
    """Its usual error stands in the errors of the torques, and in none of their values."""
    free, random = deepcopy([fit for fit in case.fitted if fit.mechanical == "free"]), np.random.default_rng(1)
    for one in free:
        voltage = one.fast.values["q_axis_voltage", "test"]
        voltage += 10.0 * random.standard_normal(len(voltage))
    result = measure(free, case.model, only=())
    assert result.held_parameters == ("torque_constant",)
    assert "torque_constant" in result.unidentifiable
    for name in ("viscous_damping", "coulomb_friction", "rotor_inertia"):
        mean, scatter = result.parameter_changes[name]
        assert abs(mean) < 0.01, name
        assert scatter == pytest.approx(PRIORS["torque_constant"], rel=0.1), name


@settings(max_examples=20, deadline=None)
@given(*(st.floats(0.01, 100.0) for _ in range(3)))
def test_least_floors_of_similar_machines_are_similar(torque, current, time):
    """Torque x a, current x b, time x s: each size worth knowing has the unit of its effect and nothing else."""
    volt, power = torque / (current * time), torque / time
    one = model()
    thermal = {
        name: value * (power * time if name.endswith("capacitance") else 1.0 / power)
        for name, value in one.thermal.model_dump().items()
    }
    other = model(
        phase_resistance=one.phase_resistance * volt / current,
        torque_constant=one.torque_constant * torque / current,
        back_emf_constant=one.back_emf_constant * torque / current,
        rotor_inertia=one.rotor_inertia * torque * time**2,
        viscous_damping=one.viscous_damping * torque * time,
        coulomb_friction=one.coulomb_friction * torque,
        thermal=thermal,
    )
    run, slower = record("free", reference=1.0, start_speed=5.0), record("free", reference=1.0, start_speed=5.0)
    slower.fast.time, slower.fast.interval = slower.fast.time * time, slower.fast.interval * time
    first, second = worth_knowing([run], one), worth_knowing([slower], other)
    factors = {"cogging": torque, "transport_delay": time, "current_sensor_offset": current, "bus_sag": volt / current}
    factors |= {"dead_time": volt, "quadratic_drag": torque * time**2, "torque_sensor_drift": torque / time}
    factors |= {"third_thermal_node": power * time, "forced_convection": time, "torque_ripple": 1.0}
    for effect, factor in factors.items():
        assert second[effect] == pytest.approx(first[effect] * factor), effect


def moving(jump):
    time = 1e-3 * np.arange(4000)
    angle = np.sin(2.0 * np.pi * time) + np.where(time > 2.0, jump * (time - 2.0), 0.0)
    return np.round(angle / COUNT) * COUNT


def test_a_motion_with_a_knee_between_two_samples_is_not_resolved_there():
    smooth, knee = resolved_samples(moving(0.0), COUNT), resolved_samples(moving(10.0), COUNT)
    assert smooth.all()
    assert not knee[2000]
    assert knee[:1980].all()
    assert knee[2020:].all()


def test_an_encoder_without_counts_is_taken_at_its_word():
    assert resolved_samples(moving(10.0), 0.0).all()


def test_what_happens_around_a_switched_drive_is_unseen():
    enabled = (np.arange(100) >= 40).astype(float)
    clock = clocked(100, 1e-3, {("q_axis_current", "test"): 1.0, ("drive_enabled", "test"): enabled})
    assert np.flatnonzero(hidden_step_samples(clock, model().bench)).tolist() == [39, 40]


@pytest.mark.parametrize(("interval", "hidden"), [(1e-3, True), (1e-4, False)])
def test_a_servos_steps_are_unseen_where_its_current_settles_within_a_sample(interval, hidden):
    target = np.repeat([0.0, 1.0], 50)
    clock = clocked(100, interval, {("q_axis_current", "test"): 1.0, ("velocity_reference", "test"): target})
    assert hidden_step_samples(clock, model(bench={"current_loop_bandwidth": 600.0}).bench).any() == hidden


@pytest.mark.parametrize(("reference", "there"), [(1.0, False), (100.0, True)])
def test_a_voltage_that_is_not_logged_is_taken_from_what_the_reference_asks_for(reference, there):
    channels = {("q_axis_current_reference", "test"): reference, ("velocity", "test"): 0.0}
    assert at_ceiling(clocked(50, 1e-3, channels), model()).all() == there


def test_without_a_bus_voltage_there_is_no_ceiling(tmp_path):
    path = tmp_path / "m.yaml"
    path.write_text("name: m\ntorque_constant: 0.5\n")
    channels = {("q_axis_current_reference", "test"): 100.0, ("velocity", "test"): 0.0}
    assert not at_ceiling(clocked(50, 1e-3, channels), read_model(path)[0]).any()


def test_the_pages_have_the_numbers_of_the_code():
    gap, decision = (re.sub(r"\s+", " ", (DOCS / page).read_text(encoding="utf-8")) for page in PAGES)
    assert f"must stand {ENTRY_HEIGHT} times above" in gap
    assert f"Nothing up to {MOST_STAMP_DELAY:.0f} samples is called a delay" in gap
    assert f"in its error, {STAMP_DELAY_STD:.2f} samples" in gap
    assert {3: "Three"}[SOUND_MACHINES] + " sound machines are simulated" in gap
    assert f"a time constant of {TRACKING_SAMPLES:.0f} samples" in decision
    assert f"over stretches of {SEGMENT} samples" in decision
    assert {0.05: "a twentieth of the smallest size worth knowing"}[NEGLIGIBLE_SHARE] in gap
    assert {0.05: "A twentieth of the smallest size worth knowing"}[NEGLIGIBLE_SHARE] in decision
    assert {0.9: "falls by less than a tenth up to the highest speed"}[MOST_LEFT_SHARE] in gap


def test_the_table_of_thresholds_is_that_of_the_code():
    page = (DOCS / "explanation" / "gap.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| [^|]+ \| ([0-9.]+) \| `([\w.]+)\.(\w+)` \|$", page, re.MULTILINE)
    assert len(rows) > 15
    for number, module, name in rows:
        assert float(number) == getattr(importlib.import_module(f"leactl.gap.{module}"), name), name
