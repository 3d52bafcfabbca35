"""Faults of a set-up planted in machines of several sizes: named, or as a class; never made up."""

import os
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from leactl.emulation.blind.make import make as make_benches
from leactl.errors import InputError
from leactl.gap.diagnose import diagnose, read_case
from leactl.gap.setup import find_and_mend_faults
from leactl.gap.signals.record import Record
from leactl.joints.make import make as make_joints
from tests.gap.joints import SOUND, Effect, Log, case, drawn_joint, drawn_log
from tests.gap.rigs import drawn_rig
from tests.gap.spoilt_setups import (
    ANGLE,
    CURRENT,
    REFERENCE,
    VELOCITY,
    drifted,
    dropped,
    on_values,
    plants,
    retimed,
    spoilt,
    swapped,
)

SEED = 3
PLANTED = {  # what is done to a record, what is named, and its peers
    "milliseconds": (retimed(1000.0), ("time_base", "time"), set()),
    "logged at half the rate": (retimed(0.5), ("time_base", "time"), set()),
    "seven pole pairs": (
        on_values(ANGLE, lambda v: 7.0 * v),
        ("pole_pairs", "angle"),
        {"encoder_counts", "channel_scale"},
    ),
    "four counts for one": (
        on_values(ANGLE, lambda v: 4.0 * v),
        ("encoder_counts", "angle"),
        {"pole_pairs", "channel_scale"},
    ),
    "degrees": (on_values(ANGLE, np.rad2deg), ("channel_scale", "angle"), set()),
    "angle for velocity": (swapped(ANGLE, VELOCITY), ("channel_swap", "velocity"), set()),
    "current for velocity": (swapped(CURRENT, VELOCITY), ("channel_swap", "q_axis_current"), set()),
    "asked for measured": (swapped(CURRENT, REFERENCE), ("channel_swap", "q_axis_current"), set()),
    "twelve samples a run": (drifted(VELOCITY, 0.0, 12.0 / 4800.0), ("clock_drift", "velocity"), set()),
    "five samples early": (drifted(VELOCITY, -5.0, 0.0), ("clock_drift", "velocity"), set()),
    "twice twenty samples lost": (dropped(VELOCITY, (0.3, 0.6), 20), ("dropped_samples", "velocity"), set()),
}


@pytest.fixture(scope="module")
def joint_case():
    random = np.random.default_rng(11)
    return case(drawn_joint(random), Log(), random)


def everywhere(given, spoil):
    return replace(given, fitted=[*map(spoil, given.fitted)], held_out=[*map(spoil, given.held_out)])


def faults_of(given):
    return find_and_mend_faults([*given.fitted, *given.held_out], given.model, len(given.held_out))[0]


@pytest.mark.parametrize("name", PLANTED)
def test_a_fault_is_named_with_its_class_and_what_mending_takes(joint_case, name):
    spoil, expected, peers = PLANTED[name]
    [fault] = faults_of(everywhere(joint_case, spoil))
    assert (fault.name, fault.key[0]) == expected
    assert set(fault.peers) == peers
    assert fault.share is None or fault.share > 0.3
    assert fault.change


def test_one_turned_run_of_six_is_told_and_mended_alone(joint_case):
    turn = on_values(VELOCITY, lambda v: -v)
    given = replace(joint_case, fitted=[turn(joint_case.fitted[0]), *joint_case.fitted[1:]])
    faults, records = find_and_mend_faults([*given.fitted, *given.held_out], given.model)
    assert [(fault.name, fault.key[0]) for fault in faults] == [("channel_sign", "velocity")]
    assert "in 1 of 6 runs" in faults[0].evidence
    sound = [*joint_case.fitted, *joint_case.held_out]
    assert all(
        np.allclose(a.fast.values[VELOCITY], b.fast.values[VELOCITY]) for a, b in zip(records, sound, strict=True)
    )


@pytest.mark.parametrize(
    "effect", [Effect(delay=6), Effect(loss=0.2), Effect(slew=20.0), Effect(drag=lambda w: 0.1 if w > 0.0 else 0.0)]
)
def test_an_effect_is_no_fault(effect):
    random = np.random.default_rng(SEED)
    assert faults_of(case(drawn_joint(random), drawn_log(random), random, effect)) == []


def with_values(record: Record, **changed) -> Record:
    values = record.fast.values | {(quantity, "test"): channel for quantity, channel in changed.items()}
    return replace(record, fast=replace(record.fast, values=values))


def test_a_reference_without_a_response_names_no_scale_and_no_swap(joint_case):
    random = np.random.default_rng(SEED)
    still = [
        with_values(
            item, q_axis_current=1e-3 * random.standard_normal(len(item.fast.time)), velocity=0.0 * item.fast.time
        )
        for item in [*joint_case.fitted, *joint_case.held_out]
    ]
    assert {fault.name for fault in find_and_mend_faults(still, joint_case.model)[0]} <= {"frozen_channel"}


def test_runs_of_two_machines_name_no_fault(joint_case):
    random = np.random.default_rng(29)
    other = case(drawn_joint(random), Log(), random)
    others = [replace(record, path=record.path.with_name(f"other-{record.path.name}")) for record in other.fitted]
    assert find_and_mend_faults([*joint_case.fitted, *others], joint_case.model)[0] == []


def test_a_model_without_parameters_still_tells_what_two_channels_disagree_in(joint_case):
    bare = joint_case.model.model_copy(
        update=dict.fromkeys(("torque_constant", "rotor_inertia", "viscous_damping", "coulomb_friction"))
    )
    given = replace(everywhere(joint_case, on_values(VELOCITY, lambda v: 3.0 * v)), model=bare)
    [fault] = faults_of(given)
    assert {"channel_scale", "encoder_counts", "time_base"} <= {fault.name, *fault.peers}
    assert faults_of(replace(joint_case, model=bare)) == []


def test_half_of_the_samples_missing_and_a_log_of_12_bits_name_nothing(joint_case):
    random = np.random.default_rng(SEED)

    def poor(record):
        valid = {key: mask & (random.random(len(mask)) < 0.5) for key, mask in record.fast.valid.items()}
        step = {key: float(np.ptp(values)) / 2**12 for key, values in record.fast.values.items()}
        values = {key: np.round(one / step[key]) * step[key] for key, one in record.fast.values.items() if key != ANGLE}
        return replace(record, fast=replace(record.fast, valid=valid, values=record.fast.values | values))

    assert faults_of(everywhere(joint_case, poor)) == []


@pytest.mark.parametrize("seed", range(8))
def test_no_rig_is_too_poor_to_be_looked_at(seed, tmp_path):
    try:
        given = drawn_rig(seed, tmp_path)
    except InputError:  # as its file would be refused
        return
    assert len(faults_of(given)) <= 8


def drawn_cases(folder):
    """Emulated benches, drawn machines of three kinds of simulator, and joints of the tests' own."""
    count = int(os.environ.get("SETUPS", "24"))
    make_benches(count, folder / "benches", folder / "benches-key", seed=SEED)
    make_joints(2 * count, folder / "joints", folder / "joints-key", 8, "stepped", seed=SEED)
    for model in sorted(folder.glob("*/*/nominal.yaml")):
        yield read_case(sorted(model.parent.glob("*.h5")), [], model)
    for seed in range(count):
        random = np.random.default_rng([SEED, seed])
        joint = drawn_joint(random)
        effects = [SOUND, Effect(delay=4), Effect(loss=0.2), Effect(slew=20.0 * joint.top)]
        yield case(joint, Log() if seed % 2 else drawn_log(random), random, effects[seed % 4])


@pytest.mark.long
def test_every_fault_of_drawn_machines(tmp_path):
    marks, made_up, cases = dict[str, Counter](), [], 0
    for index, given in enumerate(drawn_cases(tmp_path)):
        cases += 1
        made_up += [(index, fault.note()) for fault in faults_of(given)]
        for planted in plants(given, np.random.default_rng([SEED, index])):
            marks.setdefault(planted.kind, Counter())[marked(planted, faults_of(spoilt(given, planted)))] += 1
    print(cases, made_up, *marks.items(), sep="\n")
    total = sum(marks.values(), Counter())
    assert made_up == []
    assert total["wrong"] <= 0.03 * total.total()
    assert total["right"] + total["class"] >= 0.85 * total.total()


def marked(planted, faults) -> str:
    """How a planted fault was answered: right, right with more, as a member of the class, missed or wrong."""
    if not faults:
        return "missed"
    first = faults[0]
    if (first.name, first.key[0]) in planted.right:
        return "right" if len(faults) == 1 else "with more"
    return "class" if {name for name, _ in planted.right} & {first.name, *first.peers} else "wrong"


@pytest.mark.long
def test_a_current_of_two_thirds_is_no_effect(joint_case):
    answer = diagnose(everywhere(joint_case, on_values(CURRENT, lambda v: 2.0 / 3.0 * v)))
    assert [(cause.effect, cause.family) for cause in answer.causes if cause.probability >= 0.5] == [
        ("channel_scale", "setup")
    ]
    assert answer.causes[0].share > 0.9
    assert answer.causes[0].picture is not None
