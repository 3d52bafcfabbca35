"""The YAML door: what a person may write, what is refused, and where a fault is said to stand."""

import math
import re
from typing import Literal

import pytest
import yaml as pyyaml
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field

from leactl import yamlfile
from leactl.errors import InputError

# texts that a writer of YAML 1.1 leaves without quotes and that are numbers in 1.2
NUMBERS_SINCE_1_2 = re.compile(r"[-+]?(0[0-9]+[0-9.eE+-]*|[0-9.]+[eE][-+]?[0-9]+)")
plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**15), 10**15)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(codec="ascii", categories=["L", "N", "P", "Zs"])).filter(
        lambda text: not NUMBERS_SINCE_1_2.fullmatch(text)
    ),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("abcdef", min_size=1), inner, max_size=4),
    max_leaves=12,
)


@given(plain)
def test_what_a_yaml_writer_dumps_comes_back(value):
    text = pyyaml.safe_dump(value, allow_unicode=True)
    result = yamlfile.parse(text).data
    assert result == value or (isinstance(value, float) and math.isclose(result, value))


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused_in_order(text):
    try:
        yamlfile.parse(text)
    except InputError as error:
        assert error.faults


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e3", 1000.0),
        ("on", "on"),
        ("no", "no"),
        ("-4.9", -4.9),
        ("0x10", "0x10"),
        ("true", True),
        ("~", None),
        ("'1'", "1"),
    ],
)
def test_scalars_follow_the_core_schema(text, value):
    assert yamlfile.parse(f"key: {text}").data == {"key": value}


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("a: 1\nb: 2\na: 3\n", "f.yaml:3:1", "stands twice"),
        ("a: &x [1]\nb: *x\n", "f.yaml:1:4", "aliases"),
        ("a: &x [*x]\n", "f.yaml:1:4", "aliases"),
        ("a: !!python/object:os.system 1\n", "f.yaml:1:4", "tag"),
        ("a: .inf\n", "f.yaml:1:4", "finite"),
        ("a: [1\n", "f.yaml:1:6", "expected"),
        ("a: 1\n---\nb: 2\n", "f.yaml:2:1", "another document"),
    ],
)
def test_what_is_refused_names_its_place(text, place, words):
    with pytest.raises(InputError) as caught:
        yamlfile.parse(text, "f.yaml")
    assert any(fault.startswith(place) and words in fault for fault in caught.value.faults), caught.value.faults


def test_deep_nesting_is_refused():
    for depth in (50, 5000):
        with pytest.raises(InputError, match="nested"):
            yamlfile.parse("[" * depth + "]" * depth)


def test_a_large_file_is_refused_unread(tmp_path):
    path = tmp_path / "big.yaml"
    path.write_text("a: " + "x" * yamlfile.MAX_BYTES)
    with pytest.raises(InputError, match="at most"):
        yamlfile.load(path)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "latin.yaml"
    path.write_bytes(b"name: caf\xe9\n")
    with pytest.raises(InputError, match="UTF-8 at byte 9"):
        yamlfile.load(path)


class Inner(BaseModel):
    model_config = ConfigDict(extra="forbid")
    current_A: float = Field(gt=0)  # noqa: N815 (the unit is the name)


class Outer(BaseModel):
    model_config = ConfigDict(extra="forbid")
    steps: list[Inner]


def test_all_faults_come_at_once_with_line_and_column():
    document = yamlfile.parse("steps:\n  - current_A: -3\n  - current_a: 2\n", "p.yaml")
    with pytest.raises(InputError) as caught:
        document.validate(Outer)
    assert caught.value.faults == [
        "p.yaml:2:16  steps[0].current_A: -3: more than 0 was expected",
        "p.yaml:3:5  steps[1].current_A: is required and missing",
        "p.yaml:3:16  steps[1].current_a: unknown key",
    ]


class Choice(BaseModel):
    model_config = ConfigDict(extra="forbid")
    size: float | Inner | None = None
    sizes: tuple[Inner, ...] = Field(default=(), min_length=1, max_length=2)
    kind: Literal["a", "b"] = "a"
    name: str = Field("a", pattern="^a$", max_length=3)
    count: int = Field(1, multiple_of=2, lt=9)
    on: bool = False


# pydantic's words: they speak of Python's types, and of inputs
NOT_OURS = ("input", "valid", "instance", "tuple", "dictionary", "string", "should", "pydantic", "boolean", "type=")


@given(plain.filter(lambda value: value is not None), st.sampled_from(sorted(Choice.model_fields)))
def test_no_word_of_the_library_stands_in_a_fault(value, key):
    document = yamlfile.parse(pyyaml.safe_dump({key: value}), "f.yaml")
    document.data = {key: value}
    try:
        document.validate(Choice)
    except InputError as error:
        for fault in error.faults:
            words = fault.partition("  ")[2].rpartition(": ")[2]
            assert not [word for word in NOT_OURS if word in words], fault


def test_several_kinds_that_may_stand_in_a_place_are_one_fault():
    with pytest.raises(InputError) as caught:
        yamlfile.parse("size: large\n", "f.yaml").validate(Choice)
    assert caught.value.faults == ["f.yaml:1:7  size: 'large': a number or a mapping was expected"]


def test_a_faulty_item_is_no_short_list_besides():
    with pytest.raises(InputError) as caught:
        yamlfile.parse("sizes: [{current_A: 0}]\n", "f.yaml").validate(Choice)
    assert caught.value.faults == ["f.yaml:1:21  sizes[0].current_A: 0: more than 0 was expected"]
