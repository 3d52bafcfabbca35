"""What a servo's drive does to reference and error is found in logs of position and goal, with or without duty."""

from dataclasses import replace

import numpy as np
import pytest

from leactl.effects.reference_rate_limit import trapezoidal
from leactl.errors import InputError
from leactl.gap.diagnose import diagnose
from leactl.gap.replay import replay
from leactl.gap.search.parameters import with_effects
from leactl.gap.servo.effect_sets import fit_effect_sets
from leactl.gap.servo.profile import delayed_rows, profile
from leactl.gap.setup import find_and_mend_faults
from leactl.model.nominal import Model, read_model
from tests.gap import servos

KINDS = ("sound", "limit", "LIMIT", "band", "BAND", "smoothed", "tires", "bursts", "limit", "LIMIT")
NAMES = {"limit": "reference_rate_limit", "band": "servo_dead_band"}
OUTSIDE = ("smoothed", "tires", "bursts")
ANGLE = ("angle", "test")
SIMILAR = {"torque": 20.0, "current": 2.0, "time": 1.6}


def drawn(seed, kind, seconds=20.0, free=None):
    """A servo of a kind; capitals are strong."""
    random = np.random.default_rng([2110, seed])
    servo, strong = replace(servos.drawn_servo(random, free), seconds=seconds), kind.isupper()
    if kind.lower() == "limit":
        return servos.limited(servo, random, strong), random
    if kind.lower() == "band":
        return servos.dead(servo, random, strong), random
    change = {
        "smoothed": {"smoothed": 2.0 * servo.response},
        "tires": {"tires": 0.5},
        "bursts": {"bursts": 1.5},
    }.get(kind, {})
    return replace(servo, **change), random


def standing(case):
    fitted_sets = fit_effect_sets(case.fitted, case.held_out, case.model, [])
    return {item.effect: dict(item.parameters) for item in fitted_sets.standing if item.probability >= 0.5}


def named(answer):
    return sorted(cause.effect for cause in answer.causes if cause.probability >= 0.5)


def test_a_limited_servo_is_diagnosed_whole_from_position_goal_and_duty():
    servo, random = drawn(3, "LIMIT", seconds=8.0, free=False)
    case = servos.case(servo, random, kinds=("steps", "sines"))
    answer = diagnose(case)
    assert named(answer) == ["reference_rate_limit"]
    speed = answer.causes[0].parameters[0]
    assert speed.name == "speed"
    assert speed.value == pytest.approx(servo.speed, rel=0.05)
    angle = next(line for line in answer.shrinkage if line.quantity == "angle")
    assert angle.augmented_rms < 0.5 * angle.calibrated_rms
    assert not any("reference_rate_limit" in note and "invisible" in note for note in answer.notes)


def test_a_limited_servo_may_begin_far_from_its_first_goal():
    servo, random = drawn(3, "LIMIT", seconds=8.0, free=False)
    servo = replace(servo, acceleration=np.inf)
    diagnosis = diagnose(servos.case(servo, random, kinds=("steps", "sines"), start=0.0))
    assert named(diagnosis) == ["reference_rate_limit"], "what begins elsewhere makes up a saturation"
    assert diagnosis.causes[0].parameters[0].value == pytest.approx(servo.speed, rel=0.02)
    (angle,) = [line for line in diagnosis.shrinkage if line.quantity == "angle"]
    assert angle.augmented_rms < 0.05 * angle.calibrated_rms


@pytest.mark.long
def test_a_limited_servo_is_told_from_a_weak_motor_by_position_and_goal_alone():
    servo, random = drawn(4, "limit", seconds=8.0, free=True)
    result = standing(servos.case(servo, random, volts=False, kinds=("steps", "sines")))
    assert list(result) == ["reference_rate_limit"]
    assert result["reference_rate_limit"]["speed"][0] == pytest.approx(servo.speed, rel=0.05)


@pytest.mark.long
def test_a_dead_band_is_found_with_its_width():
    servo, random = drawn(5, "BAND", seconds=8.0, free=False)
    result = standing(servos.case(servo, random, kinds=("steps", "sines")))
    assert list(result) == ["servo_dead_band"]
    assert result["servo_dead_band"]["band"][0] == pytest.approx(servo.band, rel=0.1)


@pytest.mark.parametrize("volts", [True, False])
def test_nothing_is_found_at_a_sound_servo(volts):
    servo, random = drawn(6, "sound", seconds=6.0)
    assert standing(servos.case(servo, random, volts=volts, kinds=("steps", "sines"))) == {}


def test_a_servo_s_voltage_that_rests_or_stands_at_its_limit_is_no_fault_of_the_set_up():
    servo, random = drawn(7, "sound", seconds=6.0)
    case = servos.case(servo, random, kinds=("steps",))
    faults, _ = find_and_mend_faults([*case.fitted, *case.held_out], case.model)
    assert list(faults) == []


def test_a_set_point_goes_no_faster_than_its_limits_and_arrives():
    reference = np.repeat([[0.0, 1.0, -0.5]], 400, axis=1)
    _, ends = profile(reference, 0.01, np.array([[0.5]]), np.array([[0.2]]), reference[:, 0])
    pace = np.diff(ends[0, 0]) / 0.01
    assert np.abs(pace).max() <= 2.0 + 1e-9
    assert np.abs(np.diff(pace)).max() / 0.01 <= 5.0 + 1e-6
    np.testing.assert_allclose(ends[0, 0, [390, 790, 1190]], [0.0, 1.0, -0.5], atol=1e-6)
    again = trapezoidal(reference[0], 2.0, 5.0, 0.01)
    np.testing.assert_allclose(again, ends[0, 0], atol=1e-9)


def test_a_set_point_without_a_limit_is_its_reference():
    reference = np.cumsum(np.random.default_rng(1).normal(size=(2, 50)), axis=1)
    begins, ends = profile(reference, 0.01, np.array([[0.0]]), np.array([[0.0]]), reference[:, 0])
    np.testing.assert_allclose(begins[0], reference)
    np.testing.assert_allclose(ends[0], reference)
    np.testing.assert_allclose(delayed_rows(reference, 1.0)[:, 1:], reference[:, :-1])
    np.testing.assert_allclose(delayed_rows(reference, -1.0)[:, :-1], reference[:, 1:])


@pytest.mark.parametrize(
    ("kind", "effect"),
    [
        ("LIMIT", lambda s: ("reference_rate_limit", {"speed": s.speed, "acceleration": s.speed / 0.2})),
        ("BAND", lambda s: ("servo_dead_band", {"band": s.band})),
    ],
)
def test_the_simulator_has_a_servo_s_effects_as_another_author_s_servo_does(kind, effect):
    servo, random = drawn(8, kind, seconds=6.0, free=False)
    servo = replace(
        servo, acceleration=servo.speed / 0.2 if kind == "LIMIT" else np.inf, rate_gain=0.1 * servo.constant
    )
    case = servos.case(servo, random, kinds=("sines",), again=1)
    (record,) = case.held_out
    true = {
        "torque_constant": servo.constant,
        "back_emf_constant": servo.constant,
        "phase_resistance": servo.resistance,
        "rotor_inertia": servo.inertia,
        "viscous_damping": servo.damping,
        "coulomb_friction": servo.friction,
    }
    plain = Model.model_validate(case.model.model_dump(exclude_none=True) | true)
    wrong = [
        np.nanstd(replay(record, model).fast[ANGLE] - record.fast.values[ANGLE])
        for model in (plain, with_effects(plain, [effect(servo)]))
    ]
    assert wrong[1] < 0.2 * wrong[0]


def test_a_servo_s_damping_is_checked_at_the_door(tmp_path):
    (tmp_path / "m.yaml").write_text(
        "name: m\ndrive: {type: position_servo, gain: 3.0, damping: -1.0, voltage_limit: 7.4}\n"
    )
    with pytest.raises(InputError, match=r"damping"):
        read_model(tmp_path / "m.yaml")


@pytest.mark.long
@pytest.mark.parametrize("change", ["half the rate", "similar"])
@pytest.mark.parametrize(("seed", "kind"), [(20, "limit"), (21, "BAND"), (22, "sound")])
def test_similar_servos_and_other_rates_get_the_same_answer(seed, kind, change):
    answers = []
    for changed in (False, True):
        servo, random = drawn(seed, kind)
        if changed and change == "similar":
            servo = servos.scaled(servo, **SIMILAR)
        answers.append(standing(servos.case(servo, random, thin=2 if changed and change == "half the rate" else 1)))
    assert answers[0].keys() == answers[1].keys()
    for effect, parameters in answers[0].items():
        leading = next(iter(parameters))
        scale = SIMILAR["time"] if change == "similar" and leading == "speed" else 1.0
        assert answers[1][effect][leading][0] * scale == pytest.approx(parameters[leading][0], rel=0.05)


@pytest.mark.parametrize("share", [1.0, *(pytest.param(share, marks=pytest.mark.long) for share in (0.1, 1e-3, 1e-6))])
def test_a_replayed_servo_stays_below_the_speed_that_its_voltage_holds_however_light_a_fit_makes_it(share):
    servo, random = drawn(0, "sound")
    case = servos.case(servo, random)
    light = case.model.model_copy(update={"rotor_inertia": share * case.model.rotor_inertia})
    job = replay(case.fitted[0], light)
    highest = light.drive.voltage_limit / (light.back_emf_constant or light.torque_constant)
    assert np.max(np.abs(job.velocity)) <= 1.05 * highest


@pytest.mark.long
def test_of_many_servos_limits_and_bands_are_named_and_nothing_else():
    right, expected_count, shrunk = 0, 0, []
    for seed in range(24):
        kind = KINDS[seed % len(KINDS)]
        servo, random = drawn(100 + seed, kind)
        answer = diagnose(servos.case(servo, random, volts=seed % 3 < 2, thin=1 + seed // 10 % 2))
        causes, expected = named(answer), [NAMES[kind.lower()]] if kind.lower() in NAMES else []
        angle = next(line for line in answer.shrinkage if line.quantity == "angle")
        print(seed, kind, answer.verdict, causes, f"{angle.calibrated_rms:.3g} -> {angle.augmented_rms:.3g} rad")
        assert [name for name in causes if name not in expected] == [], (seed, kind)
        if expected:
            expected_count, right = expected_count + 1, right + (causes == expected)
        if kind.lower() == "limit" and causes == expected:
            shrunk.append(angle.augmented_rms / angle.calibrated_rms)
    print(f"{right} of {expected_count} named; free runs' error times {np.mean(shrunk):.2f}, at most {max(shrunk):.2f}")
    assert right >= 0.9 * expected_count
    assert max(shrunk) < 0.75
