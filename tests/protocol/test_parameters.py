"""Parameters: defaults, conditions and --set, in that order of precedence, put in whole and never computed."""

import pytest

from leactl.errors import InputError
from leactl.protocol.protocolfile import read_overrides
from tests.protocol.writing import levels, plan, read, segments, text

SWEEP = "sweep: {role: test, levels_A: $levels_A, hold_s: $hold_s}"
DEFAULTS = "{levels_A: [1, 2], hold_s: 3, unused: text}"
CONDITIONS = "{loaded: {levels_A: [4]}}"


def found(condition="", **overrides):
    return plan(SWEEP, parameters=DEFAULTS, conditions=CONDITIONS, condition=condition, overrides=overrides)


def faults(*steps, **more):
    with pytest.raises(InputError) as caught:
        plan(*steps, **more)
    return caught.value.faults


def test_defaults():
    assert levels(found()) == [1, 2]


def test_a_condition_goes_over_a_default():
    loaded = found("loaded")
    assert levels(loaded) == [4]
    assert loaded.condition == "loaded"
    assert loaded.parameters == {"levels_A": [4], "hold_s": 3, "unused": "text"}


def test_a_name_that_the_command_line_has_for_itself_is_refused():
    [told] = faults("hold: {duration_s: 1}", parameters="{seed: 1}")
    assert "parameters.seed: another name was expected: `--set seed=N` is that of an emulated bench" in told


def test_any_other_label_is_fine():
    assert levels(found("design")) == [1, 2]


def test_the_command_line_goes_over_a_condition():
    assert levels(found("loaded", levels_A="[5, 6.5]")) == [5, 6.5]


def test_values_inside_lists_and_texts_may_be_parameters():
    steps = ("sweep: {role: test, levels_A: [$low, 2], hold_s: 1, visit: $visit}", "prompt: $text")
    done = plan(*steps, parameters="{low: 1, visit: down, text: Go on}")
    assert levels(done) == [2, 1]
    assert done.actions[-1].text == "Go on"


def test_text_that_only_contains_a_name_stays_as_it_is():
    assert plan("prompt: costs $low or so", parameters="{low: 1}").actions[-1].text == "costs $low or so"


def test_command_line_texts():
    assert read_overrides(["a=1", "b = x=y", "seed=4"]) == {"a": "1", "b": "x=y"}
    with pytest.raises(InputError) as caught:
        read_overrides(["a", "b=1", "c"])
    assert len(caught.value.faults) == 2
    with pytest.raises(InputError, match="--set a: given twice"):
        read_overrides(["a=1", "b=1", "a=1"])


@pytest.mark.parametrize(
    ("name", "value", "line"),
    [
        ("hold", "1", "--set hold=1: no such parameter; known: levels_A, hold_s, unused"),
        ("hold_s", "soon", "--set hold_s=soon: 'soon': a finite number was expected, as in the default 3"),
        ("hold_s", ".inf", "--set hold_s=.inf: inf: a finite number was expected, as in the default 3"),
        ("hold_s", ".nan", "--set hold_s=.nan: nan: a finite number was expected, as in the default 3"),
        ("hold_s", "1e999", "--set hold_s=1e999: inf: a finite number was expected, as in the default 3"),
        ("hold_s", "", "--set hold_s=: None: a finite number was expected, as in the default 3"),
        ("hold_s", "true", "--set hold_s=true: true: a finite number was expected, as in the default 3"),
        ("levels_A", "5", "--set levels_A=5: 5: a list of finite numbers was expected, as in the default [1, 2]"),
        (
            "levels_A",
            "[a]",
            "--set levels_A=[a]: ['a']: a list of finite numbers was expected, as in the default [1, 2]",
        ),
        ("levels_A", "[]", "--set levels_A=[]: []: a list of finite numbers was expected, as in the default [1, 2]"),
        ("unused", "$hold_s", "--set unused=$hold_s: '$hold_s': a text was expected, as in the default 'text'"),
        ("levels_A", "[1, 2", "--set levels_A:1:6  did not find expected ',' or ']'"),
        (
            "levels_A",
            "[&a 1, *a]",
            "--set levels_A:1:2  [0]: anchors and aliases are not accepted; write the value out",
        ),
        ("hold_s", "-1", "trial.yaml:9:54  steps[1].sweep.hold_s: -1: more than 0 was expected"),
        (
            "hold_s",
            "0.001",
            "trial.yaml:9:54  steps[1].sweep.hold_s: 0.001 s: at least one cycle (0.01 s) was expected",
        ),
    ],
)
def test_a_value_that_does_not_fit_is_named(name, value, line):
    told = faults(SWEEP, parameters=DEFAULTS, overrides={name: value})
    given = f" (${name} from --set {name}={value})" if line.startswith("trial") else ""
    assert told == [line + given]


def test_a_fault_names_the_parameter_and_where_it_came_from():
    steps = "hold: {duration_s: $hold_s, settle_s: $settle_s}"
    head = {"parameters": "{hold_s: 3, settle_s: 1}", "conditions": "{short: {hold_s: 0.5}}"}
    assert faults(steps, condition="short", **head) == [
        "trial.yaml:9:24  steps[1].hold.duration_s: a settle window of 1 s leaves nothing of 0.5 s; less was expected"
        " ($hold_s from condition short, line 5)"
    ]
    assert faults(steps, overrides={"settle_s": "4"}, **head) == [
        "trial.yaml:9:43  steps[1].hold.settle_s: a settle window of 4 s leaves nothing of 3 s; less was expected"
        " ($settle_s from --set settle_s=4)"
    ]
    assert faults("hold: {duration_s: $hold_s}", parameters="{hold_s: -3}") == [
        "trial.yaml:9:24  steps[1].hold.duration_s: -3: more than 0 was expected ($hold_s from line 4)"
    ]


def test_a_fault_inside_a_list_names_the_parameter():
    assert faults(SWEEP, parameters=DEFAULTS, overrides={"levels_A": "[1, 1e7]"}) == [
        "trial.yaml:9:35  steps[1].sweep.levels_A[1]: 10000000.0: at most 1000000 was expected"
        " ($levels_A from --set levels_A=[1, 1e7])"
    ]


def test_a_fault_of_a_whole_step_names_the_parameters_that_were_changed():
    steps = "sweep: {role: test, levels_A: [1], hold_s: 100, repeats: $trials, pause_s: $pause_s}"
    assert faults(steps, parameters="{trials: 2, pause_s: 1}", overrides={"trials": "99999"}) == [
        "trial.yaml:9:12  steps[1].sweep: the protocol reaches more than 604800 s of duration here"
        " ($trials from --set trials=99999)"
    ]


@pytest.mark.parametrize(
    ("parameters", "conditions", "lines"),
    [
        ("[1]", "{}", ["trial.yaml:4:13  parameters: a mapping of names to defaults was expected"]),
        (
            "{Low: 1}",
            "{}",
            ["trial.yaml:4:19  parameters.Low: a name of a letter a-z, then letters, digits, _ was expected"],
        ),
        ("{a: true}", "{}", ["trial.yaml:4:17  parameters.a: true: a finite number, a text that is no $name, or"]),
        ("{a: {b: 1}}", "{}", ["trial.yaml:4:17  parameters.a: {'b': 1}: a finite number, a text that is no $name"]),
        ("{a: [1, x]}", "{}", ["trial.yaml:4:17  parameters.a: [1, 'x']: a finite number, a text that is no $name"]),
        ("{a: $a}", "{}", ["trial.yaml:4:17  parameters.a: '$a': a finite number, a text that is no $name"]),
        ("{a: 1}", "[x]", ["trial.yaml:5:13  conditions: a mapping of labels to parameters was expected"]),
        ("{a: 1}", "{hot: 3}", ["trial.yaml:5:19  conditions.hot: a mapping of parameters to values was expected"]),
        ("{a: 1}", "{hot: {b: 3}}", ["trial.yaml:5:23  conditions.hot.b: no such parameter; known: a"]),
        ("{a: 1}", "{hot: {a: x}}", ["trial.yaml:5:23  conditions.hot.a: 'x': a finite number was expected, as in"]),
    ],
)
def test_parameters_and_conditions_that_are_none(parameters, conditions, lines):
    told = faults("hold: {duration_s: 1}", parameters=parameters, conditions=conditions)
    assert len(told) == len(lines)
    assert all(line.startswith(start) for line, start in zip(told, lines, strict=True))


def test_a_name_that_is_no_parameter_is_one_fault_at_its_place():
    assert faults("hold: {duration_s: $hold}", parameters="{hold_s: 1}") == [
        "trial.yaml:9:24  steps[1].hold.duration_s: $hold: no such parameter; known: $hold_s"
    ]


def test_a_rate_may_be_a_parameter():
    source = text("hold: {duration_s: 1}", rate_Hz="$rate", parameters="{rate: 200}")
    assert read(source).rate_Hz == 200
    assert segments(read(source, rate="50"))[0].duration_s == 1
