"""Every effect of the library keeps its definition's words and fills known places with finite columns."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from leactl.effects import library
from leactl.effects.contract import PLACES, Signals
from leactl.effects.gear_backlash import LEAST_PLAY_COUNTS
from leactl.effects.joint_elasticity import MOST_LOAD_SHARE
from leactl.effects.plant import Plant
from leactl.gap.search.effect_sets import STRENGTH_RANGE
from leactl.gap.search.parameters import propagated_variances
from leactl.gap.signals.effect_variables import VARIABLE_FUNCTIONS
from leactl.model.nominal import DriveModel, Model
from leactl.vocabulary.effect import EffectDefinition, effect_definition, effect_names, effects_on
from leactl.vocabulary.variable import VARIABLES

MODEL = Model.model_validate(
    {
        "name": "m",
        "phase_resistance": 0.264,
        "resistance_coefficient": 0.004,
        "torque_constant": 0.49,
        "back_emf_constant": 0.49,
        "rotor_inertia": 0.0024,
        "viscous_damping": 0.0238,
        "coulomb_friction": 0.208,
        "bench": {"shaft_stiffness": 6000.0, "bus_voltage": 29.6},
        "thermal": {
            "winding_ambient_resistance": 5.6,
            "winding_housing_resistance": 0.3,
            "housing_ambient_resistance": 1.7,
            "winding_capacitance": 22.9,
            "housing_capacitance": 469.1,
        },
    }
)


def signals(mechanical, slow=False):
    time = np.linspace(0, 20, 2000)
    wave = np.sin(2.0 * time)
    s = Signals(mechanical, time, MODEL, 0.01, "run")
    if slow:
        s.extra = {"heat": 20 + 5 * wave, "heat_per_ampere": wave}
    else:
        s.current, s.voltage, s.following, s.command = 12 * wave, 6 * wave, 12 * wave, 12 * wave
        s.looped = lambda ends, shares, begin: ends
        s.bus_voltage = np.full_like(time, 29.6)
        s.angle, s.acceleration = 8 * time, np.cos(time)
        if mechanical != "free":
            s.torque = s.calm_torque = 5 * wave
    s.velocity = s.calm_velocity = 6 * np.cos(2.0 * time) + 0.1
    s.sliding = np.sign(s.velocity)
    s.winding, s.housing, s.ambient = 60 + wave, 45 + wave, np.full_like(time, 22.0)
    s.winding_rise, s.housing_rise = s.winding - 25, s.housing - 25
    if slow and mechanical == "heated":
        s.line_current = np.full_like(time, 8.0)
    return s


CASES = [signals("coupled"), signals("locked"), signals("free"), signals("heated", True), signals("free", True)]


def test_a_friction_by_direction_is_a_constant_torque_through_swift_reversals():
    """As the one of an offset of the current: rows of a reversal would tell the two apart that are one law."""
    s = signals("free")
    s.sliding = np.tanh(s.velocity)  # smoothed
    [column] = library()["asymmetric_friction"].terms(s, ())["drag"].values()
    np.testing.assert_array_equal(column, MODEL.coulomb_friction)


def test_the_library_has_every_word_of_the_vocabulary():
    assert tuple(library()) == effect_names()
    assert set(effects_on("bench")) | set(effects_on("joint")) | set(effects_on("servo")) == set(library())


SERVOS = tuple(name for name in effect_names() if effect_definition(name).shown_on == ("servo",))
OTHERS = tuple(name for name in effect_names() if name not in SERVOS)


@pytest.mark.parametrize("name", SERVOS)
def test_an_effect_of_servos_alone_touches_no_equation_and_asks_for_a_servo(name):
    effect, definition = library()[name], effect_definition(name).parameters
    assert not any(effect.terms(case, ()) for case in CASES)
    assert not effect.applies(MODEL)
    servo = MODEL.model_copy(update={"drive": DriveModel(type="position_servo", gain=3.0, voltage_limit=7.4)})
    assert effect.applies(servo)
    result = effect.parameters((), dict.fromkeys(definition, 0.5), servo)
    assert {key for key, item in definition.items() if item.default is None} <= set(result) <= set(definition)


@pytest.mark.parametrize("name", OTHERS)
def test_an_effect_fills_known_places_with_finite_columns_and_speaks_its_definition(name):
    effect = library()[name]
    forms = effect.forms or ((7.0,),)
    touched = 0
    for form in forms:
        for case in CASES:
            for place, columns in effect.terms(case, form).items():
                assert place in PLACES
                for column in columns.values():
                    assert column.shape == case.time.shape
                    assert np.all(np.isfinite(column))
                touched += 1
    assert touched
    coefficients = next(columns for form in forms for case in CASES for columns in effect.terms(case, form).values())
    result = dict.fromkeys(coefficients, 0.5)
    parameters = effect.parameters(forms[0], result, MODEL)
    definition = effect_definition(name).parameters
    assert set(parameters) <= set(definition)
    assert {key for key, item in definition.items() if item.default is None} <= set(parameters)
    assert effect.size(forms[0], result, MODEL) > 0


@pytest.mark.parametrize("name", OTHERS)
def test_a_run_that_shows_an_effect_shows_a_variable_that_it_acts_in(name):
    variables = effect_definition(name).acts_over
    effect = library()[name]
    shown = [s for s in CASES if effect.terms(s, (effect.forms or ((6.0,),))[0])]
    assert shown
    assert any(VARIABLE_FUNCTIONS[variable](s) is not None for s in shown for variable in variables)


def test_every_variable_comes_from_signals():
    assert set(VARIABLE_FUNCTIONS) == set(VARIABLES)


def test_a_definition_says_which_size_is_worth_knowing_on_a_machine_of_any_size():
    known = effect_definition("cogging").model_dump()
    with pytest.raises(ValueError, match=r"faint is missing.*amplitude begins at 0.003 N\*m"):
        EffectDefinition.model_validate(known | {"faint": None})
    with pytest.raises(ValueError, match="greater than 0"):
        EffectDefinition.model_validate(known | {"faint": {"size": 0.0, "units": "N*m"}})


def test_a_play_that_an_encoder_hardly_resolves_is_not_told():
    effect, shown = library()["gear_backlash"], signals("free")
    form = next(form for form in effect.forms if form[0] > 0.02)
    assert effect.terms(shown, form)
    shown.count = 0.3 * form[0]
    assert effect.terms(shown, form) == {}


def test_the_page_says_which_plays_are_tried():
    words = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
    plays, ratios = (sorted({form[place] for form in library()["gear_backlash"].forms}) for place in (0, 1))
    page = (Path(__file__).parents[2] / "docs" / "explanation" / "gap.md").read_text(encoding="utf-8")
    told = f"at {words[len(plays)]} plays from {plays[0]:g} to {plays[-1]:g} rad and {words[len(ratios)]} ratios"
    assert told in page
    assert f"a play below {words[int(LEAST_PLAY_COUNTS)]} counts of the encoder" in page


@pytest.mark.parametrize("name", ["joint_elasticity", "gear_backlash"])
def test_a_load_that_is_nearly_all_of_the_inertia_is_told_as_it_is_and_simulated_with_a_rotor(name):
    effect = library()[name]
    numbers = effect.parameters(effect.forms[0], {"share": 0.95}, MODEL)
    assert numbers["share"] == 0.95, "at a limit it would have no standard error"
    plant = Plant(MODEL, None, 0.0)
    effect.act(numbers, plant)
    assert (plant.elastic_load or plant.geared_load).share == MOST_LOAD_SHARE


SHAPED = [name for name, effect in library().items() if effect.shaped]


@pytest.mark.parametrize("name", SHAPED)
def test_no_shape_lies_between_what_two_forms_may_stand_for(name):
    """What a reversal or a step leaves in a slow log grows with up to the cube of a displacement or a delay."""
    assert len(SHAPED) >= 8
    for numbers in zip(*library()[name].forms, strict=True):
        assert all(
            (above / below) ** 3 < STRENGTH_RANGE[1] / STRENGTH_RANGE[0]
            for below, above in pairwise(sorted(set(numbers)))
        )


def test_a_limit_that_does_not_fall_with_speed_has_no_no_load_speed():
    effect = library()["voltage_limit"]
    speeds = [
        effect.parameters((2.0, left, 10.0), {"strength": 1.0}, MODEL)["no_load_speed"] for left in (1.0, 2.0, 3.0)
    ]
    assert speeds == [20.0, math.inf, math.inf]


def test_a_parameter_that_a_usual_change_makes_infinite_has_an_infinite_variance():
    def after(change):
        return {"speed": 20.0 if change[0] < 1.0 else math.inf, "current": 2.0 + change[1]}

    variances = propagated_variances({"speed": 20.0, "current": 2.0}, after, np.array([[4.0, 0.0], [0.0, 0.25]]))
    assert variances == {"speed": math.inf, "current": pytest.approx(0.25)}
