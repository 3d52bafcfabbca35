"""What held-out runs do not bear out is neither named nor applied; what lies beyond every range is no candidate."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from leactl.effects.contract import Signals
from leactl.gap.diagnose import diagnose
from leactl.gap.diagnosis import CalibratedParameter, Cause, EffectParameter, Shrinkage
from leactl.gap.search.effect_sets import outweighs_equation
from leactl.gap.search.parameters import is_at_bound
from leactl.gap.search.regression import Normal, Rows, gain_of, stack
from leactl.gap.verdict.shrinkage import Growth, Shrunk
from leactl.gap.verdict.withdrawal import FittedEffects, apply, refusal_of_limit
from leactl.model.nominal import Model, read_model
from leactl.vocabulary.effect import effect_definition, effect_names
from tests.cli.terminal import leactl
from tests.gap.joints import Effect, Log, case, drawn_joint

SOUND = CalibratedParameter("viscous_damping", 0.0238, 0.024, 1e-4, "N*m*s/rad")
BOUNDED = CalibratedParameter("rotor_inertia", 0.0024, 0.00012, 1e-6, "kg*m^2")
SATURATION = Cause(
    "saturation", 0.99, 1.0, (EffectParameter("loss", 0.1, 0.01, "1"), EffectParameter("exponent", 2.0, 0.0, "1"))
)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "nominal.yaml"
    path.write_text(leactl("bench", "model", "emulated").stdout)
    return read_model(path)[0]


RIPPLE = replace(SATURATION, effect="cogging", parameters=(EffectParameter("amplitude", 0.02, 0.001, "N*m"),))


def growth(by_calibration=0.0, by_effects=0.0, closed=False, alike=None):
    return Growth((by_calibration,) * 2, (by_effects,) * 2, closed, closed if alike is None else alike)


def simulated(by_calibration, by_effects):
    """Held-out runs on which calibration and effects change the gap so; effects that let it shrink close a channel."""

    def simulate(calibrated, augmented):
        by = by_effects if augmented.effects else 0.0
        return Shrunk((), (), (), (), growth(by_calibration, by, by < 0.0))

    return simulate


def beside(*calibration):
    """A fit whose parameters are these, whatever effects it has."""
    return lambda causes: FittedEffects(tuple(causes), calibration)


def test_what_held_out_runs_bear_out_is_applied(model):
    applied = apply(model, [SOUND], [[SATURATION]], beside(SOUND), simulated(-1.0, -1.0))
    assert [entry.effect for entry in applied.augmented.effects] == ["saturation"]
    assert applied.calibrated.viscous_damping == 0.024
    assert (applied.fitted.causes, applied.notes) == ((SATURATION,), ())


@pytest.mark.parametrize(
    ("by_effects", "reason"),
    [(0.5, "with it the gap of held-out runs grows"), (0.0, "with it no gap of held-out runs shrinks beyond chance")],
)
def test_an_effect_that_closes_nothing_is_taken_back_and_said(model, by_effects, reason):
    applied = apply(model, [SOUND], [[SATURATION]], beside(SOUND), simulated(-1.0, by_effects))
    assert applied.fitted == FittedEffects((), (SOUND,))
    assert not applied.augmented.effects
    assert applied.augmented.viscous_damping == 0.024
    assert applied.notes == (f"not named though it fits: saturation; {reason}",)


def test_an_effect_that_closes_one_channel_and_opens_another_farther_is_taken_back(model):
    """The blocks of one channel shrink beyond chance, and the squares of all channels grow by half a percent."""

    def simulate(calibrated, further):
        torque, velocity = (5.5, 10.12) if further.effects else (6.0, 9.8)
        lines = (
            Shrinkage("torque", "test", "free", "N*m", 6.0, 6.0, torque, 1.0),
            Shrinkage("velocity", "test", "free", "rad/s", 9.8, 9.8, velocity, 1.0),
        )
        return Shrunk(lines, (), (), (), growth(-1.0, -0.05, bool(further.effects)))

    applied = apply(model, [SOUND], [[SATURATION]], beside(SOUND), simulate)
    assert not applied.augmented.effects
    assert applied.notes == ("not named though it fits: saturation; with it the gap of held-out runs grows",)


@pytest.mark.parametrize(("before", "after", "named"), [(0.9, 1.05, True), (1.2, 1.35, False)])
def test_a_channel_that_stays_within_its_noise_has_no_gap_that_grows(model, before, after, named):
    def simulate(calibrated, further):
        temperature = after if further.effects else before
        lines = (
            Shrinkage("torque", "test", "free", "N*m", 1.3, 1.3, 1.25 if further.effects else 1.3, 1.0),
            Shrinkage("temperature", "test", "free", "degC", before, before, temperature, 1.0),
        )
        return Shrunk(lines, (), (), (), growth(-1.0, -0.05, bool(further.effects)))

    applied = apply(model, [SOUND], [[SATURATION]], beside(SOUND), simulate)
    assert bool(applied.augmented.effects) is named


def test_an_effect_is_judged_again_beside_the_calibration_that_is_applied(model):
    """Better than a calibration that took up the effect, and worse than the one that is fitted beside it."""
    alone = replace(SOUND, fitted=0.05)
    distances = {alone.fitted: 8.0, SOUND.fitted: 5.0, model.viscous_damping: 7.0}

    def simulate(calibrated, further):
        plain = distances[calibrated.viscous_damping]
        line = Shrinkage("velocity", "test", "free", "rad/s", 7.0, plain, 6.0 if further.effects else plain, 1.0)
        by = -1.0 if further.effects else 0.0
        return Shrunk((line,), (), (), (), growth(plain - 7.0, by, bool(further.effects)))

    applied = apply(model, [alone], [[SATURATION]], beside(SOUND), simulate)
    assert not applied.fitted.causes
    assert not applied.augmented.effects
    assert [(near.effect, near.refused_because) for near in applied.refused] == [
        ("saturation", "with it the gap of held-out runs grows")
    ]
    assert "not named though it fits: saturation; with it the gap of held-out runs grows" in applied.notes
    assert applied.calibrated.viscous_damping == SOUND.fitted  # what beat the effect is what is applied
    assert applied.shrunk.shrinkage[0].calibrated_rms == 5.0


def test_of_several_effects_the_one_goes_without_which_the_gap_is_smallest(model):
    """Both shrink the gap beside a calibration that is not applied in the end, and fail beside the one that is."""
    alone = replace(SOUND, fitted=0.05)
    without = {alone.fitted: 8.0, SOUND.fitted: 5.0, model.viscous_damping: 7.0}
    distance = {frozenset({"saturation"}): 7.0, frozenset({"cogging"}): 3.0, frozenset({"saturation", "cogging"}): 6.0}

    def far(model):
        return distance.get(frozenset(entry.effect for entry in model.effects), without[model.viscous_damping])

    def simulate(calibrated, further):
        line = Shrinkage("velocity", "test", "free", "rad/s", 7.0, far(calibrated), far(further), 1.0)
        by_effects = -1.0 if further.effects else 0.0
        return Shrunk((line,), (), (), (), growth(far(calibrated) - 7.0, by_effects, bool(further.effects)))

    applied = apply(model, [alone], [[SATURATION], [RIPPLE]], beside(SOUND), simulate)
    assert [cause.effect for cause in applied.fitted.causes] == ["cogging"]
    assert [near.effect for near in applied.refused] == ["saturation"]
    assert any(note.startswith("calibration alone is not applied") for note in applied.notes)


def test_an_effect_may_keep_the_calibration_without_it_where_the_one_beside_it_lets_a_gap_grow(model):
    alone, shifted = SOUND, replace(SOUND, fitted=0.025)

    def simulate(calibrated, further):
        velocity = {shifted.fitted: 9.9}.get(further.viscous_damping, 9.8)
        lines = (
            Shrinkage("torque", "test", "free", "N*m", 6.0, 6.0, 5.9 if further.effects else 6.0, 1.0),
            Shrinkage("velocity", "test", "free", "rad/s", 9.8, 9.8, velocity, 1.0),
        )
        return Shrunk(lines, (), (), (), growth(-1.0, -0.05, bool(further.effects)))

    applied = apply(model, [alone], [[SATURATION]], beside(shifted), simulate)
    assert applied.fitted == FittedEffects((SATURATION,), (alone,))
    assert applied.augmented.viscous_damping == alone.fitted
    assert applied.notes == ()


@pytest.mark.parametrize("needed", [True, False])
def test_effects_that_close_a_gap_together_alone_are_applied_if_each_is_needed(model, needed):
    """Alone each lets the gap grow; both close it, or cogging does so with whatever is beside it."""
    distance = {frozenset(): 5.0, frozenset({"cogging"}): 6.0, frozenset({"saturation"}): 6.0}

    def far(model):
        names = frozenset(entry.effect for entry in model.effects)
        return distance.get(names, 1.0 if needed else 6.0)

    def simulate(calibrated, further):
        line = Shrinkage("velocity", "test", "free", "rad/s", 7.0, far(calibrated), far(further), 1.0)
        closer = far(further) < far(calibrated)
        return Shrunk((line,), (), (), (), growth(-1.0, -1.0 if closer else 0.5, closer))

    applied = apply(model, [SOUND], [[SATURATION], [RIPPLE]], beside(SOUND), simulate)
    assert bool(applied.fitted.causes) is needed
    assert len(applied.refused) == (0 if needed else 2)


def test_of_effects_that_close_a_gap_together_one_that_is_not_needed_takes_the_others_with_it(model):
    shown = []

    def simulate(calibrated, further):
        has, had = ({entry.effect for entry in item.effects} for item in (further, calibrated))
        shown.append((has, had))
        closer = has == {"cogging", "saturation"} and "cogging" not in had  # whatever saturation adds to it
        line = Shrinkage("velocity", "test", "free", "rad/s", 7.0, 5.0, 4.0 if closer else 5.1, 1.0)
        return Shrunk((line,), (), (), (), growth(-1.0, -1.0 if closer else 0.5, closer))

    applied = apply(model, [SOUND], [[SATURATION], [RIPPLE]], beside(SOUND), simulate)
    assert ({"cogging", "saturation"}, {"cogging"}) in shown
    assert applied.fitted.causes == ()


@pytest.mark.parametrize("order", [(SATURATION, RIPPLE), (RIPPLE, SATURATION)])
def test_each_effect_has_to_close_a_gap_beside_the_others(model, order):
    def simulate(calibrated, augmented):
        added = {entry.effect for entry in augmented.effects} - {entry.effect for entry in calibrated.effects}
        return Shrunk((), (), (), (), growth(-1.0, 0.0, "cogging" in added))

    applied = apply(model, [SOUND], [[item] for item in order], beside(SOUND), simulate)
    assert applied.fitted.causes == (RIPPLE,)
    assert [entry.effect for entry in applied.augmented.effects] == ["cogging"]
    assert applied.notes == (
        "not named though it fits: saturation; with it no gap of held-out runs shrinks beyond chance",
    )


def test_an_effect_that_shows_beside_another_alone_is_tried_again(model):
    def simulate(calibrated, augmented):
        has, had = ({entry.effect for entry in item.effects} for item in (augmented, calibrated))
        return Shrunk((), (), (), (), growth(-1.0, 0.0, "saturation" in has and has != had))

    applied = apply(model, [SOUND], [[RIPPLE], [SATURATION]], beside(SOUND), simulate)
    assert {entry.effect for entry in applied.augmented.effects} == {"cogging", "saturation"}
    assert applied.notes == ()


@pytest.mark.parametrize(("by_effects", "named"), [(-0.1, True), (0.0, False), (0.1, False)])
def test_runs_too_short_to_tell_chance_have_to_show_a_gap_that_shrinks(model, by_effects, named):
    def simulate(calibrated, augmented):
        return Shrunk((), (), (), (), growth(-1.0, by_effects if augmented.effects else 0.0, None))

    applied = apply(model, [SOUND], [[SATURATION]], beside(SOUND), simulate)
    assert bool(applied.fitted.causes) is named


@pytest.mark.parametrize(("by_effects", "named"), [(-0.01, True), (0.0, True), (0.01, False)])
def test_what_equations_show_beyond_chance_needs_a_replay_s_gap_that_does_not_grow(model, by_effects, named):
    def simulate(calibrated, augmented):
        by = (by_effects, -1.0) if augmented.effects else (0.0, 0.0)
        return Shrunk((), (), (), (), Growth((-1.0, -1.0), by, False, False))

    applied = apply(model, [SOUND], [[SATURATION]], beside(SOUND), simulate, borne_out_by_equations={"saturation"})
    assert bool(applied.fitted.causes) is named
    assert not apply(model, [SOUND], [[SATURATION]], beside(SOUND), simulate).fitted.causes


def test_calibration_with_which_the_gap_grows_leaves_the_model_as_it_was(model):
    applied = apply(model, [SOUND], [], beside(SOUND), simulated(0.2, 0.0))
    assert applied.calibrated == applied.augmented == model
    assert applied.first_calibration_withdrawn
    assert "calibration is not applied: with it the gap of held-out runs grows" in applied.notes[0]


def test_calibration_alone_that_takes_up_an_effect_is_not_applied_beside_it(model):
    applied = apply(model, [SOUND], [[SATURATION]], beside(SOUND), simulated(0.2, -1.0))
    assert applied.calibrated == model
    assert [entry.effect for entry in applied.augmented.effects] == ["saturation"]
    assert applied.notes[0].startswith("calibration alone is not applied")
    assert applied.notes[0].endswith("the model stays as it was given")


def test_calibration_beside_an_effect_stands_for_the_one_alone_that_takes_the_effect_up(model):
    alone = replace(SOUND, fitted=0.05)

    def simulate(calibrated, augmented):
        by = 0.2 if calibrated.viscous_damping == alone.fitted else -0.2
        return Shrunk((), (), (), (), growth(by, -1.0 if augmented.effects else 0.0, bool(augmented.effects)))

    applied = apply(model, [alone], [[SATURATION]], beside(SOUND), simulate)
    assert applied.calibrated.viscous_damping == applied.augmented.viscous_damping == SOUND.fitted
    assert not applied.calibrated.effects
    assert applied.notes[0].endswith("the one beside the effects stands for it")


def test_a_parameter_at_its_bound_is_told_and_not_applied(model):
    applied = apply(model, [SOUND, BOUNDED], [[SATURATION]], beside(SOUND, BOUNDED), simulated(-1.0, -1.0))
    assert applied.augmented == model
    assert applied.fitted == FittedEffects((), ())
    assert "calibration is not applied: rotor_inertia ended at a bound" in applied.notes[-1]


def test_an_effect_beside_another_has_to_show_in_more_than_the_largest_gaps(model):
    def simulate(calibrated, augmented):
        return Shrunk((), (), (), (), growth(0.0, -1.0, True, alike=False))

    applied = apply(model, [SOUND], [[SATURATION], [RIPPLE]], beside(SOUND), simulate)
    assert [entry.effect for entry in applied.augmented.effects] == ["saturation"]
    assert applied.notes[0].startswith("not named though it fits: cogging; beside the others")


@pytest.mark.parametrize(
    ("factor", "bound"), [(0.05, True), (0.0501, False), (1.0, False), (19.9, False), (20.0, True)]
)
def test_a_bound_is_a_twentieth_and_twenty_times(factor, bound):
    assert is_at_bound(replace(SOUND, fitted=SOUND.nominal * factor)) == bound


def test_a_range_holds_for_any_machine_only_where_it_has_no_dimension():
    assert effect_definition("saturation").largest == 0.25
    assert effect_definition("transport_delay").largest == float("inf")
    assert all(effect_definition(name).largest > 0.0 for name in effect_names())


@pytest.mark.parametrize(("turned", "there"), [(2.0 * np.pi, True), (0.02, False)])
def test_a_wave_is_no_candidate_where_the_shaft_hardly_turns(turned, there):
    """What grows with the angle on a shaft that stands looks like a piece of a wave of any height."""
    angle = np.linspace(0.0, turned, 400)
    columns = {
        ("calibration", "torque_constant"): np.full(400, 5.0),
        ("effect", "cogging", "(3.0,)", "cos"): np.cos(angle),
        ("effect", "cogging", "(3.0,)", "sin"): np.sin(angle),
    }
    left = np.sin(angle) if there else 100.0 * angle
    index = np.arange(400)
    signals = Signals("free", index * 0.01, Model(name="m"), 0.01)
    made = Rows("r", "k", "free", "eq", "torque", "test", "N*m", left, columns, {}, index, index, signals, 0.01)
    stacked = stack([made], {})
    added = np.asarray([stacked.position_of[name] for name in list(columns)[1:]])
    [base] = [stacked.position_of["calibration", "torque_constant"]]
    _, values, _ = gain_of(Normal(stacked, [1e4]), np.asarray([base]), added)
    assert outweighs_equation(stacked, added, values) is not there


@pytest.mark.long
def test_the_recipe_of_the_readme_names_nothing_that_is_not_there(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for seed in ("11", "12"):
        arguments = ("--bench", "emulated", "--condition", "design", "--set", f"seed={seed}", "--out", seed)
        assert leactl("run", "friction", *arguments).returncode == 0
    Path("nominal.yaml").write_text(leactl("bench", "model", "emulated").stdout)
    [fitted], [held_out] = Path("11").glob("*.h5"), Path("12").glob("*.h5")
    done = leactl("gap", "diagnose", fitted, "--held-out", held_out, "--model", "nominal.yaml", "--json")
    assert "Warning" not in done.stderr
    answer = json.loads(done.stdout)
    assert answer["causes"] == []
    assert answer["verdict"] != "effect"


@pytest.mark.parametrize(
    ("closed_by_set_up", "refused"), [((0.0,), True), ((0.3,), False), ((0.0, 0.3), False), ((None,), False)]
)
def test_a_limit_that_closes_nothing_of_a_currents_gap_is_none_however_small_the_gap(closed_by_set_up, refused):
    """A current that overshoots is 3 floors off its reference with a voltage limit as without it."""
    lines = tuple(
        Shrinkage("q_axis_current", "test", set_up, "A", 3.0, 3.0, 3.0, 1.0, closed)
        for set_up, closed in zip(("free", "coupled"), closed_by_set_up, strict=False)
    )
    assert bool(refusal_of_limit(Shrunk(lines, (), (), (), growth(-1.0, -0.05, True)))) is refused


def limited(seed, stall_share, speed_share, limits):
    """Diagnosis of a drawn joint whose current has limits over its speed; its true stall current and no-load speed."""
    random = np.random.default_rng(seed)
    joint = drawn_joint(random)
    stall = stall_share * joint.top
    no_load = speed_share * joint.constant * joint.top / joint.damping
    return diagnose(case(joint, Log(), random, Effect(limits=partial(limits, stall, no_load)))), stall, no_load


def of_a_voltage(stall, no_load, speed):
    back_emf = stall * speed / no_load
    return -stall - back_emf, stall - back_emf


def of_an_ellipse(stall, no_load, speed):
    highest = stall * np.sqrt(max(1.0 - (speed / no_load) ** 2, 0.0))
    return -highest, highest


@pytest.mark.parametrize(
    ("seed", "stall_share", "speed_share"),
    [
        pytest.param(57, 8.0, 0.8, marks=pytest.mark.long),  # its ridge lies between the points of any grid
        *(pytest.param(seed, 1.5, 1.1, marks=pytest.mark.long) for seed in (40, 41, 42, 43, 44, 45, 46, 47)),
        *(pytest.param(seed, 8.0, 0.8, marks=pytest.mark.long) for seed in (50, 51, 52, 53, 56, 58)),
        *(pytest.param(seed, 0.8, 2.0, marks=pytest.mark.long) for seed in (54, 55)),
    ],
)
def test_a_voltage_that_ends_is_named_with_its_numbers(seed, stall_share, speed_share):
    """A hyperbola and a cap resemble the line to which a voltage limits a current over speed, and are not it."""
    found, stall, no_load = limited(seed, stall_share, speed_share, of_a_voltage)
    assert found.verdict == "effect"
    assert [cause.effect for cause in found.causes if cause.probability > 0.5] == ["voltage_limit"]
    told = {item.name: item.value for item in found.causes[0].parameters}
    assert told["no_load_speed"] == pytest.approx(no_load, rel=0.03)
    assert told["stall_current"] == pytest.approx(stall, rel=0.15)  # which runs near the no-load speed hardly tell


@pytest.mark.parametrize("seed", [pytest.param(seed, marks=pytest.mark.long) for seed in (41, 46, 51)])
def test_a_limit_of_another_law_is_no_limit_of_the_library(seed):
    found, _, _ = limited(seed, 0.8, 0.8, of_an_ellipse)
    assert found.verdict == "unknown"
    assert all(cause.probability < 0.5 for cause in found.causes)
    assert any("a limit of the drive" in note for note in found.notes)
