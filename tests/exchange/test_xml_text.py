"""Attributes changed in XML text: what is set is read, everything else stays byte for byte."""

import re
from xml.etree import ElementTree
from xml.sax.saxutils import escape, quoteattr

import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.errors import InputError
from leactl.exchange.xml_text import parse_xml

NAMES = st.sampled_from(["joint", "body", "geom", "a.b", "ns:tag", "_x-1"])
VALUES = st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Cs")), max_size=12)
BLANKS = st.sampled_from(["", " ", "\n  ", "\t"])
KEYS = st.sampled_from(["name", "damping", "kp", "damp", "name2"])


@st.composite
def tags(draw, depth=2):
    """Text of an element with attributes in either quotes, blanks anywhere, comments and text."""
    name, parts = draw(NAMES).replace("ns:", "ns-"), ""
    for key, value in draw(st.dictionaries(KEYS, VALUES, max_size=3)).items():
        quoted = draw(st.sampled_from([quoteattr(value), f"'{escape(value, {chr(39): '&apos;'})}'"]))
        parts += draw(st.sampled_from([" ", "\n    "])) + key + draw(BLANKS) + "=" + draw(BLANKS) + quoted
    end = draw(BLANKS)
    if not depth or draw(st.booleans()):
        return f"<{name}{parts}{end}/>"
    inner = "".join(
        draw(
            st.lists(
                st.one_of(tags(depth=depth - 1), VALUES.map(escape), st.just("<!-- joint name='>' -->")), max_size=3
            )
        )
    )
    return f"<{name}{parts}{end}>{inner}</{name}>"


@given(tags(), st.integers(0, 9), KEYS, st.one_of(st.none(), VALUES))
def test_an_attribute_that_is_set_is_read_and_the_rest_stays(text, pick, key, value):
    raw = text.encode()
    before = parse_xml(raw, "robot.xml")
    index = pick % len(before.elements)
    after = before.changed({index: {key: value}}, {})
    expected = [dict(element.attributes) for element in before.elements]
    if value is None:
        expected[index].pop(key, None)
    else:
        expected[index][key] = value
    again = parse_xml(after, "robot.xml")
    assert [element.attributes for element in again.elements] == expected
    assert ElementTree.fromstring(after).tag == again.root
    element = before.elements[index]
    assert after.startswith(raw[: element.begin])
    assert after.endswith(raw[element.end :])
    assert before.changed({}, {}) == raw


def test_a_new_first_child_is_indented_below_its_element():
    before = parse_xml(b"<robot>\n  <joint name='a'>\n    <limit/>\n  </joint>\n</robot>", "a.urdf")
    after = before.changed({}, {1: "<dynamics/>"})
    assert after == b"<robot>\n  <joint name='a'>\n    <dynamics/>\n    <limit/>\n  </joint>\n</robot>"


@given(st.binary(max_size=60))
def test_bytes_are_elements_or_one_clear_line(raw):
    try:
        assert parse_xml(raw, "robot.xml").elements
    except InputError as fault:
        assert re.match(r"robot\.xml:( not UTF-8 at byte \d+|\d+:\d+  )", str(fault))
        assert "\n" not in str(fault)


def test_entities_are_not_expanded():
    with pytest.raises(InputError, match="DOCTYPE"):
        parse_xml(b'<!DOCTYPE a [<!ENTITY b "bb"><!ENTITY c "&b;&b;">]><a>&c;</a>', "robot.xml")
