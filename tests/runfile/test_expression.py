"""Expressions that runs are chosen by: they mean what Python means by them, and nothing else passes."""

from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from leactl.errors import InputError
from leactl.runfile.catalog.expression import ALLOWED, MOST_CHARACTERS
from leactl.runfile.catalog.expression import read_expression as read_test
from leactl.runfile.summary import Summary

RUN = Summary(
    Path("runs"),
    "a-friction-1.h5",
    1200,
    protocol="friction",
    experiment="friction",
    condition="loaded",
    status="complete",
    created="2026-11-14T10:00:00.000+00:00",
    duration=72.5,
    rows=3600,
    parameters={"hold_s": 6, "label": "7", "levels_A": [1.0, 2.0], "rows": 5, "odd name": 1},
    tags=("greased", "paper"),
)
KNOWN = {*RUN.parameters, "absent"}


def holds(text, run=RUN):
    return read_test(text, KNOWN)(run)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("condition == 'loaded' and experiment == 'friction'", True),
        ("condition != 'loaded' or status in ('stopped', 'tripped')", False),
        ("not (condition == 'design')", True),
        ("60 < duration <= 72.5", True),
        ("60 < duration < 72.5", False),
        ("100 > duration", True),
        ("hold_s == 6.0 and hold_s in [5, 6] and -1 < hold_s", True),
        ("label == '7'", True),
        ("label == 7", False),  # a text is no number
        ("label != 7", True),
        ("label > 5 or label < 5", False),
        ("levels_A == [1, 2] and 2 in levels_A and 3 not in levels_A", True),
        ("levels_A == (1, 2)", True),
        ("levels_A > [0, 0]", False),
        ("'paper' in tags and 'pap' not in tags", True),
        ("tags == ['greased', 'paper']", True),
        ("'frict' in protocol", True),
        ("like(file, 'a-*-?.h5') and like(tags, 'gr*')", True),
        ("like(file, '*friction')", False),
        ("like(levels_A, '*')", False),
        ("rows == 3600 and parameters.rows == 5 and parameters['odd name'] == 1", True),
        ("hold_s < rows", True),
        ("condition == status", False),
        ("1 in absent or 1 not in absent", False),
        ("seed is None and hold_s is not None", True),
        ("seed is not None", False),
        ("absent == 1 or absent != 1 or absent < 1 or absent in (1, 2) or absent not in (1, 2)", False),  # it has none
        ("absent is None and not (absent == 1)", True),
        ("not " * 490 + "hold_s == 6", True),
    ],
)
def test_an_expression_means_what_it_says(text, expected):
    assert holds(text) is expected


@pytest.mark.parametrize(
    ("relation", "fitting"),
    [
        ("==", "same"),
        ("!=", "before after"),
        ("<", "before"),
        ("<=", "before same"),
        (">", "after"),
        (">=", "same after"),
    ],
)
def test_a_day_is_whole_and_a_moment_is_one(relation, fitting):
    made = {"before": "2026-11-13T23:59:59Z", "same": "2026-11-14T00:00:00Z", "after": "2026-11-15T00:00:00Z"}
    for name, created in made.items():
        run = RUN._replace(created=created)
        assert holds(f"created {relation} '2026-11-14'", run) is (name in fitting.split())
        assert holds(f"created {relation} '2026-11-14T01:00+01:00'", run) is (name in fitting.split())
    assert holds(f"created {relation} '2026-11-14'", RUN._replace(created="a Monday")) is False
    evening = RUN._replace(created="2026-11-14T23:00:00Z")
    assert holds(f"created {relation} '2026-11-14'", evening) is ("same" in fitting.split())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("conditon == 'loaded'", "no run has 'conditon'; did you mean 'condition'"),
        ("condition == loaded", "no run has 'loaded'; known: absent, actuator, bench"),
        ("parameters.holds == 1", "no run has a parameter 'holds'; did you mean 'hold_s'"),
        ("condition = 'loaded'", "is no expression: invalid syntax"),
        ("condition = 'loaded'", "two values are compared by =="),
        ("", "is no expression"),
        ("duration == 'long'", "duration is a number; 'long' is none"),
        ("condition > 5", "condition is a text; 5 is none"),
        ("tags == 'paper'", "'paper' in tags asks for a member"),
        ("created > 'yesterday'", "created is a date, such as '2026-01-31' or '2026-01-31T13:00'; 'yesterday' is none"),
        ("created > 5", "created is a date"),
        ("created == '9999-12-31T23:00-05:00'", "created is a date"),
        ("status in ('complete')", "'complete' stands after in, where a list such as ('a', 'b')"),
        ("5 in duration", "duration is a number and holds no others"),
        ("seed == None", "is None was expected"),
        ("seed is 5", "is 5: NAME is None was expected; other values are compared by =="),
        ("3 < 4", "3 and 4 are compared, and neither is a name"),
        ("hold_s", ALLOWED),
        ("like(duration, 'a')", "the name of a text or of a list was expected first"),
        ("like(file)", ALLOWED),
        ("hold_s + 1 == 7", "hold_s + 1 stands where a name"),
        ("hold_s == -label", "-label stands where a name"),
        ("__import__('os').system('true') == 0", "stands where a name"),
        ("().__class__.__bases__[0] == 1", "stands where a name"),
        ("[x for x in tags] == 1", "stands where a name"),
        ("(lambda: 1)() == 1", "stands where a name"),
        ("hold_s == [1, [2]]", "stands where a name"),
        ("f'{hold_s}' == label", "stands where a name"),
        ("(x := 5) == hold_s", "stands where a name"),
        ("hold_s == 6; import os", "is no expression"),
        ("hold_s == \0", "is no expression"),
        ("(" * 300 + "hold_s", "is no expression"),
        ("hold_s == 6 " + "and hold_s == 6 " * MOST_CHARACTERS, f"at most {MOST_CHARACTERS} were expected"),
    ],
)
def test_what_is_no_expression_is_refused_in_one_line(text, message):
    with pytest.raises(InputError) as refused:
        read_test(text, KNOWN)
    assert message in str(refused.value)
    assert len(refused.value.faults) == 1
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "times"),
    [("foo == 1", 1), ("conditon == 'a'", 1), ("parameters.foo == 1", 0), ("parameters['f'] == 1", 0)],
)
def test_the_advice_on_quotes_is_given_once_and_not_on_a_parameter(text, times):
    with pytest.raises(InputError) as refused:
        read_test(text, KNOWN)
    assert str(refused.value).count("a text stands in quotes") == times


NAMES = {"condition": "loaded", "protocol": "friction", "duration": 72.5, "rows": 3600, "hold_s": 6, "label": "7"}
texts = st.sampled_from(["loaded", "friction", "7", "", "l"])
numbers = st.sampled_from([0, 6, 72.5, 3600, -1, 6.0])


def comparisons(name):
    values = texts if isinstance(NAMES[name], str) else numbers
    relations = st.sampled_from(["==", "!=", "<", "<=", ">", ">="])
    plain = st.builds(lambda relation, value: f"{name} {relation} {value!r}", relations, values)
    turned = st.builds(lambda relation, value: f"{value!r} {relation} {name}", relations, values)
    chained = st.builds(
        lambda one, value, other: f"{value!r} {one} {name} {other} {value!r}", relations, values, relations
    )
    member = st.builds(lambda some: f"{name} in {some!r}", st.lists(values, max_size=3))
    other = st.builds(lambda some: f"{name} not in {tuple(some)!r}", st.lists(values, max_size=3))
    return plain | turned | chained | member | other


expressions = st.recursive(
    st.sampled_from(sorted(NAMES)).flatmap(comparisons),
    lambda inner: (
        st.builds("({} and {})".format, inner, inner)
        | st.builds("({} or {})".format, inner, inner)
        | st.builds("not {}".format, inner)
    ),
    max_leaves=6,
)


@given(expressions)
def test_it_means_what_python_means(text):
    assert holds(text) == eval(text, {"__builtins__": {}}, dict(NAMES))


# of these a fuzzer makes what is nearly an expression
WORDS = "tags created == < in is not and or ( ) [ ] , 'a' like . : lambda * - 1e999 None '\\d' b'a' ..."
nearly = st.lists(st.sampled_from([*NAMES, *WORDS.split()]))


@given(st.text() | nearly.map(" ".join))
@example("'\ud800' in condition")
@example("like(file, '[')")
def test_any_text_is_a_test_or_refused_in_one_line(text):
    try:
        test = read_test(text, KNOWN)
    except InputError as refused:
        assert len(refused.faults) == 1
        assert "\n" not in refused.faults[0]
    else:
        assert test(RUN) in (True, False)
