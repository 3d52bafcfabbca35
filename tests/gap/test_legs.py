"""A leg with a weight, on a spring or without, and what is said where the equations do not show the spring."""

import math
from dataclasses import replace

import numpy as np
import pytest

from leactl.gap.diagnose import diagnose
from leactl.gap.diagnosis import MOST_REPLAY_MISS, CalibratedParameter, Shrinkage
from leactl.gap.fitted_load import WEIGHT, weight_off
from leactl.gap.replay import replay
from leactl.gap.search.parameters import with_calibration, with_effects
from leactl.gap.verdict.replay_gap import floors_of_sound_machine, unexplained_in_replays
from tests.gap.legs import GRAVITY, case, drawn_leg, recorded

SWING = 9.0  # Hz


def parameters_of(cause):
    return {parameter.name: parameter.value for parameter in cause.parameters}


def named(diagnosis):
    return [cause.effect for cause in diagnosis.causes if cause.probability > 0.5]


def velocity_gap(diagnosis):
    [line] = [line for line in diagnosis.shrinkage if line.quantity == "velocity"]
    return line


def test_a_weight_on_a_spring_is_named_with_its_share_and_its_swing():
    leg = drawn_leg(np.random.default_rng(1), SWING)
    diagnosis = diagnose(case(leg, np.random.default_rng(2)))
    assert named(diagnosis) == ["joint_elasticity"]
    found = parameters_of(diagnosis.causes[0])
    assert found["share"] == pytest.approx(leg.share, rel=0.03)
    assert found["frequency"] == pytest.approx(SWING, rel=0.02)
    assert found["damping_ratio"] == pytest.approx(leg.swing_damping, rel=0.1)
    line = velocity_gap(diagnosis)
    assert line.calibrated_rms > 20.0 * line.floor_rms
    assert line.closed > 0.9


def test_a_weight_behind_teeth_with_play_is_named_with_its_play_and_its_share():
    leg = replace(drawn_leg(np.random.default_rng(1), 90.0), swing_damping=0.8, play=0.02)
    diagnosis = diagnose(case(leg, np.random.default_rng(2)))
    assert named(diagnosis) == ["gear_backlash"]
    found = parameters_of(diagnosis.causes[0])
    assert found["play"] == pytest.approx(leg.play, rel=0.05)
    assert found["share"] == pytest.approx(leg.share, rel=0.03)


def test_a_weight_on_the_motor_itself_is_sound():
    assert diagnose(case(drawn_leg(np.random.default_rng(3)), np.random.default_rng(4))).verdict == "calibration"


def calibrated(diagnosis):
    return {item.parameter: item for item in diagnosis.calibration}


@pytest.mark.parametrize(("heavier", "zero"), [(1.25, 0.0), (0.8, 0.0), (1.0, 0.08), (1.25, -0.05)])
def test_a_wrong_weight_or_angle_of_the_load_is_calibrated(heavier, zero):
    """The constant took a wrong weight up, and the inertia went seven eighths off; a wrong angle was in no replay."""
    leg = replace(drawn_leg(np.random.default_rng(1)), heavier=heavier, zero=zero)
    measured = case(leg, np.random.default_rng(2))
    diagnosis = diagnose(measured)
    assert (diagnosis.verdict, named(diagnosis)) == ("calibration", [])
    found = calibrated(diagnosis)
    constant = measured.model.torque_constant / leg.constant  # which no run of these tells from the weight
    assert ("load.gravity" in found) is (heavier != 1.0)
    if heavier != 1.0:
        assert found["load.gravity"].fitted == pytest.approx(heavier * constant * GRAVITY, rel=0.02)
    assert ("load.zero_angle" in found) is (zero != 0.0)
    if zero:
        assert found["load.zero_angle"].fitted == pytest.approx(-0.5 * np.pi - zero, abs=0.004)
    assert found["rotor_inertia"].fitted == pytest.approx(leg.rotor, rel=0.08)
    line = velocity_gap(diagnosis)
    assert line.augmented_rms < 2.0 * line.floor_rms < 0.2 * line.nominal_rms


def test_a_wrong_torque_constant_is_no_wrong_weight():
    leg = drawn_leg(np.random.default_rng(1))
    runs = case(leg, np.random.default_rng(2))
    diagnosis = diagnose(replace(runs, model=leg.model((0.09, 0.05, 0.1, -0.1))))
    assert (diagnosis.verdict, named(diagnosis)) == ("calibration", [])
    assert calibrated(diagnosis)["torque_constant"].fitted == pytest.approx(leg.constant, rel=0.003)
    assert not {"load.gravity", "load.zero_angle"} & calibrated(diagnosis).keys()


def test_a_weight_counts_as_changed_from_the_nominal_one_in_every_round():
    """Else a second round could go as far again for the price of its own step."""
    leg = replace(drawn_leg(np.random.default_rng(1)), heavier=1.25)
    records, model = case(leg, np.random.default_rng(2)).fitted, leg.model()
    lighter = with_calibration(model, [CalibratedParameter(WEIGHT, GRAVITY, GRAVITY / 3.0, 0.1, "m/s^2")])
    assert weight_off(records, model, nominal=model).fitted == pytest.approx(1.25 * GRAVITY, rel=0.02)
    assert weight_off(records, model, nominal=lighter) is None


def test_a_swing_that_no_equation_shows_is_unknown_for_what_it_leaves_in_replays():
    leg = replace(drawn_leg(np.random.default_rng(3), 25.0), swing_damping=0.02)
    diagnosis = diagnose(case(leg, np.random.default_rng(4)))
    assert (diagnosis.verdict, named(diagnosis)) == ("unknown", [])
    assert velocity_gap(diagnosis).augmented_rms > MOST_REPLAY_MISS * velocity_gap(diagnosis).floor_rms
    [note] = [note for note in diagnosis.notes if note.startswith("unexplained")]
    assert "simulated again, velocity of held-out runs, free" in note


def test_a_hard_stop_is_unknown_though_no_row_of_an_equation_has_it():
    leg = replace(drawn_leg(np.random.default_rng(3)), stop=0.85)
    diagnosis = diagnose(case(leg, np.random.default_rng(4)))
    assert (diagnosis.verdict, named(diagnosis)) == ("unknown", [])
    assert any(note.startswith("unexplained: simulated again, velocity") for note in diagnosis.notes)
    assert diagnosis.unexplained is None  # no equation has anything to describe
    assert diagnosis.where[0].region.variable == "time_since_reversal"


@pytest.mark.parametrize("weighs", [True, False])
def test_a_replay_of_a_load_on_a_spring_starts_where_the_motion_has_it(weighs):
    """A lightly damped load swings on for longer than a second: at rest at each restart, it would be far off."""
    leg = replace(drawn_leg(np.random.default_rng(1), SWING), swing_damping=0.02)
    leg = leg if weighs else replace(leg, mass=leg.mass * 1e-6, length=leg.length * 1e3)  # all inertia, no weight
    run = recorded(leg, "steps", "a", np.random.default_rng(2))
    spring = {"share": leg.share, "frequency": SWING, "damping_ratio": leg.swing_damping}
    measured = run.fast.values["velocity", "test"]
    missed = [
        float(np.sqrt(np.nanmean((replay(run, model).fast["velocity", "test"] - measured) ** 2)))
        for model in (with_effects(leg.model(), [("joint_elasticity", spring)]), leg.model())
    ]
    assert missed[0] < 0.03 * np.std(measured)
    assert missed[1] > 0.1 * np.std(measured)


def gap_of(floor, rms):
    return Shrinkage("velocity", "test", "free", "rad/s", rms, rms, rms, floor)


def test_a_gap_counts_by_what_a_sound_machine_leaves_in_the_same_replays():
    leg = drawn_leg(np.random.default_rng(3))
    runs, model = [recorded(leg, "multisine", "a", np.random.default_rng(4))], leg.model()
    sound_floor = floors_of_sound_machine(runs, model)["velocity", "test", "free"]
    for floors, probability in ((MOST_REPLAY_MISS, 0.5), (2.0 * MOST_REPLAY_MISS, 1.0)):
        seen = unexplained_in_replays([gap_of(1e-3 * sound_floor, floors * sound_floor)], runs, model)
        assert seen.probability == pytest.approx(probability, abs=0.04)
    near = gap_of(sound_floor, 0.99 * MOST_REPLAY_MISS * sound_floor)
    assert unexplained_in_replays([near], runs, model).probability == 0.0
    of_the_drive = replace(gap_of(1.0, math.inf), quantity="q_axis_current")
    assert unexplained_in_replays([of_the_drive], runs, model).probability == 0.0
