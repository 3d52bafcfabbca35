"""How far a gap shrinks, on runs whose truth is a model's own output, and on the practice cases where they are."""

import json
from pathlib import Path

import numpy as np
import pytest

from leactl.gap.replay import Job, plant_of, replay, replay_all
from leactl.gap.replay.bearing import TRIED_GIVES, fitted_give
from leactl.gap.replay.comparison import noise_of_residuals
from leactl.gap.signals.record import read_record
from leactl.gap.verdict.shrinkage import closed_interval, closes_gap, shrinkage
from leactl.model.nominal import Model, read_model
from tests.gap.synthetic import INTERVAL_S, model, record

TORQUE_NOISE, CURRENT_NOISE = 0.01, 0.02
PRACTICE = next(
    (
        place
        for parent in Path(__file__).resolve().parents
        if (place := parent.parent / "shared" / "gap-cases" / "practice").is_dir()
    ),
    None,
)
CASES = ["practice-1", "practice-3", "practice-5", "practice-8"]


def staircase(truth, seed=0, seconds=6.0):
    """A locked run whose channels are the truth's own output with noise."""
    time = INTERVAL_S * np.arange(round(seconds / INTERVAL_S))
    reference = 12.0 * np.sin(2 * np.pi * 0.5 * time) + 4.0 * np.sign(np.sin(2 * np.pi * 0.9 * time))
    run = record("locked", reference=reference, seconds=seconds)
    answer = replay(run, truth)
    random = np.random.default_rng(seed)
    for name, noise in (("torque", TORQUE_NOISE), ("q_axis_current", CURRENT_NOISE), ("q_axis_voltage", 0.03)):
        values = np.nan_to_num(answer.fast[name, "test"])
        run.fast.values[name, "test"] = values + noise * random.standard_normal(len(values))
    return run


def table(shrunk):
    return {(gap.quantity, gap.role, gap.mechanical): gap for gap in shrunk.shrinkage}


def test_a_share_of_a_gap_that_chance_closes_has_no_interval():
    random = np.random.default_rng(3)
    gaps = np.tile([2.0, 1.0, 0.2, 0.1], (2000, 1)) * random.normal(1.0, 0.02, (2000, 4))
    low, high = closed_interval(gaps)
    assert 0.85 < low < 0.8 / 0.9 < high < 0.92
    gaps[:200, 3] = gaps[:200, 1]  # no gap is left in a tenth
    assert closed_interval(gaps) == (None, None)
    gaps[20:200, 3] = 0.1
    assert closed_interval(gaps) == pytest.approx((low, high), abs=0.01)


def test_the_true_model_closes_the_gap_to_the_floor_and_others_stay_open():
    truth = model(("saturation", {"loss": 0.2}))
    shrunk = shrinkage([staircase(truth)], model(torque_constant=0.55), model(), truth)
    result = table(shrunk)
    torque = result["torque", "test", "locked"]
    assert torque.floor_rms == pytest.approx(TORQUE_NOISE, rel=0.1)
    assert torque.augmented_rms == pytest.approx(torque.floor_rms, rel=0.1)
    assert torque.nominal_rms > torque.calibrated_rms > 5 * torque.floor_rms
    assert torque.closed == pytest.approx(1.0, abs=0.03)
    assert torque.closed_low <= torque.closed <= torque.closed_high
    assert torque.closed_high - torque.closed_low < 0.1
    current = result["q_axis_current", "test", "locked"]
    assert current.closed is None
    assert current.calibrated_rms == pytest.approx(CURRENT_NOISE, rel=0.1)


def test_a_model_that_adds_nothing_closes_nothing():
    truth = model(("saturation", {"loss": 0.2}))
    shrunk = shrinkage([staircase(truth)], model(), model(), model())
    torque = table(shrunk)["torque", "test", "locked"]
    assert torque.closed == 0.0
    assert torque.nominal_rms == torque.calibrated_rms == torque.augmented_rms


@pytest.mark.parametrize(
    ("nominal", "calibrated", "augmented", "closes"),
    [
        (model(), model(), model(("saturation", {"loss": 0.2})), True),
        (model(), model(), model(), False),
        # the calibration broke what the effect mends
        (model(("saturation", {"loss": 0.2})), model(), model(("saturation", {"loss": 0.2})), False),
    ],
)
def test_an_effect_closes_a_gap_that_neither_model_without_it_closes(nominal, calibrated, augmented, closes):
    truth = model(("saturation", {"loss": 0.2}))
    assert shrinkage([staircase(truth, seconds=12.0)], nominal, calibrated, augmented).growth.closed is closes


@pytest.mark.parametrize(
    ("gaps", "expected"),
    [
        ([3.0] * 8 + [20.0] * 4, (True, True)),  # it shrinks everywhere
        ([6.0] * 8 + [20.0] * 4, (True, False)),  # the largest gaps shrink, the others grow by more than that, in ratio
        ([3.0] * 8 + [37.0, 42.0, 37.0, 42.0], (True, False)),  # most gaps shrink, of the largest as many as grow
        ([5.0] * 8 + [41.0] * 4, (False, False)),
    ],
)
def test_a_gap_closes_over_all_stretches_together_or_stretch_by_stretch(gaps, expected):
    before = [4.0] * 8 + [40.0] * 4
    floors = np.transpose([before, before, gaps, np.ones(12)])
    assert closes_gap([(np.full(12, 100.0), 100.0 * floors**2)], np.random.default_rng(2)) == expected


def test_a_few_seconds_are_too_little_to_tell_whether_a_gap_closes():
    truth = model(("saturation", {"loss": 0.2}))
    assert shrinkage([staircase(truth)], model(), model(), truth).growth.closed is None


def test_traces_are_thinned_and_named():
    truth = model(("torque_sensor_offset", {"offset": 0.3}))
    shrunk = shrinkage([staircase(truth)], model(), model(), truth)
    trace = next(trace for trace in shrunk.traces if trace.quantity == "torque")
    assert len(trace.time) == len(trace.measured) == len(trace.augmented) <= 1500
    assert trace.units == "N*m"
    assert np.mean(trace.measured - trace.calibrated) == pytest.approx(0.3, abs=0.01)
    channel = next(channel for channel in shrunk.channels if channel.quantity == "torque")
    assert channel.noise == pytest.approx(TORQUE_NOISE, rel=0.1)


def test_the_answer_is_the_same_for_the_same_seed():
    truth = model(("saturation", {"loss": 0.1}))
    first, second = (shrinkage([staircase(truth)], model(), model(), truth, seed=3) for _ in range(2))
    assert first.shrinkage == second.shrinkage


@pytest.mark.parametrize("give", TRIED_GIVES)
def test_a_locked_torque_tells_how_far_a_bearing_gives(give):
    truth = model()
    plant = plant_of(truth)
    plant.give = give
    run = staircase(truth)
    job = Job(run, plant)
    replay_all([job])
    random = np.random.default_rng(1)
    torque = np.nan_to_num(job.fast["torque", "test"])
    run.fast.values["torque", "test"] = 1.1 * torque + 0.2 + TORQUE_NOISE * random.standard_normal(len(torque))
    assert fitted_give([run], truth) == give


def test_what_a_model_cannot_replay_is_said():
    shrunk = shrinkage([staircase(model())], *(model(rotor_inertia=None) for _ in range(3)))
    assert not [gap for gap in shrunk.shrinkage if gap.quantity == "torque"]
    assert any("rotor_inertia" in note for note in shrunk.notes)


def truth_of(case):
    """The nominal model of a practice case with its true parameters, without and with its effects."""
    nominal, _ = read_model(PRACTICE / case / "nominal.yaml")
    label = json.loads((PRACTICE / "labels.json").read_text())[case]
    base, strength = label["true_base"], label["effect_parameters"]
    names = {"thermal": ("Rwa", "Rwh", "Rha", "Cw", "Ch"), "load": ("b_load", "f_load")}
    content = nominal.model_dump() | {
        "phase_resistance": base["R"],
        "phase_inductance": base["L"],
        "rotor_inertia": base["J"],
        "viscous_damping": base["b"],
        "coulomb_friction": base["f"],
        "torque_constant": base["kt"],
        "back_emf_constant": base["kb"],
        "resistance_coefficient": base["alpha"],
        "thermal": dict(zip(nominal.model_dump()["thermal"], (base[name] for name in names["thermal"]), strict=True)),
        "bench": nominal.model_dump()["bench"] | {"shaft_stiffness": base["k_shaft"]},
        "load": {"viscous_damping": base["b_load"], "coulomb_friction": base["f_load"]},
    }
    effects = {
        "practice-3": [("torque_sensor_lag", {"time_constant": strength.get("tau_lag")})],
        "practice-5": [
            ("third_thermal_node", {"capacitance": strength.get("Cf"), "resistance": strength.get("Rhf")}),
        ],
        "practice-8": [("transport_delay", {"delay": strength.get("delay")})],
    }.get(case, [])
    entries = [{"effect": name, "parameters": parameters} for name, parameters in effects]
    return nominal, Model(**content), Model(**content | {"effects": entries})


@pytest.mark.skipif(PRACTICE is None, reason="the practice cases (../shared/gap-cases) are not on this machine")
@pytest.mark.parametrize("case", CASES)
def test_the_true_parameters_of_a_practice_case_leave_the_floor(case):
    nominal, without, truth = truth_of(case)
    runs = sorted((PRACTICE / case).glob("*-b.h5"))
    result = table(shrinkage([read_record(path) for path in runs], nominal, without, truth))
    over = {key: one.augmented_rms / one.floor_rms for key, one in result.items()}
    judged = {key: ratio for key, ratio in over.items() if key[2] in ("locked", "heated")}
    if case == "practice-3":  # the bench's sensor lags by another curve than first order
        judged.pop(("torque", "test", "locked"))
    judged |= {key: ratio for key, ratio in over.items() if key[0] in ("q_axis_voltage", "bus_voltage")}
    judged |= {key: ratio for key, ratio in over.items() if key[2] == "free" and key[0] != "velocity"}
    assert {key: ratio for key, ratio in judged.items() if ratio > 1.5} == {}
    # a free rotor integrates what a millisecond's sampling leaves open of the servo's current steps
    assert over["velocity", "test", "free"] < 3.5
    if case != "practice-1":
        assert max(value.closed or 0.0 for value in result.values()) > (0.8 if case == "practice-3" else 0.9)


def test_what_a_filter_leaves_of_a_motion_that_is_over_is_no_noise():
    fading = 0.1 * np.exp(-0.05 * np.arange(6000))  # the velocity of a locked rotor, down to 1e-131 rad/s
    assert noise_of_residuals(fading, [fading]) == 0.0
    noisy = fading + np.random.default_rng(0).normal(0.0, 1e-4, 6000)
    assert noise_of_residuals(noisy, [noisy]) == pytest.approx(1e-4, rel=0.1)
