"""Messages of any shape: a column is its numbers or one line, and what is listed can be asked for."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl.errors import InputError
from leactl.runfile.importing.sources.messages import Message, MessageSource, OpenLog, Topic
from leactl.runfile.importing.sources.source import MissingColumn, SourceRequest, WantedColumn

KEYS = st.sampled_from(["a", "b", "name", "header", "stamp", "sec", "nanosec", "position"])
LEAVES = st.none() | st.booleans() | st.integers(-(10**400), 10**400) | st.floats() | st.text(max_size=3)
TREES = st.recursive(LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=4))
DOCUMENTS = st.dictionaries(KEYS, TREES, max_size=4)
PATHS = ["a", "a.b", "a[0]", "a[x]", "b", "position", "position[a]", "header.stamp", "log_time", "name[0]", "a[0].b[1]"]


def source(tmp_path, documents, columns, stamps=None):
    stamps = stamps or [10**15 + 10**7 * row for row in range(len(documents))]
    topics = {"/t": Topic("/t", "any"), "/never": Topic("/never", "any")}

    def messages(wanted):
        for document, ns in zip(documents, stamps, strict=True):
            if "/t" in wanted:
                yield Message("/t", ns, ns + 5, partial(lambda it: it, document))

    wanted = None if columns is None else [WantedColumn(*column) for column in columns]
    return MessageSource(OpenLog(tmp_path, topics, messages), SourceRequest(wanted))


@settings(max_examples=300, deadline=None)
@given(documents=st.lists(DOCUMENTS, min_size=1, max_size=4), records=st.sampled_from(["/t", "/t[a]", None]))
def test_any_message_gives_a_column_or_one_line(tmp_path_factory, documents, records):
    columns = [(path if records else f"/t.{path}", records) for path in PATHS]
    opened = source(tmp_path_factory.getbasetemp(), documents, columns)
    for column in columns:
        try:
            values = opened.column(*column)
        except MissingColumn as lacking:
            assert "\n" not in str(lacking)
        else:
            assert len(values) <= len(documents)


@settings(max_examples=200, deadline=None)
@given(documents=st.lists(DOCUMENTS, min_size=1, max_size=4))
def test_what_is_listed_can_be_asked_for(tmp_path_factory, documents):
    here = tmp_path_factory.getbasetemp()
    for table in source(here, documents[:1], None).tables():
        joint = table.joints[0] if table.joints else ""
        columns = [(column.name, table.records.replace("{joint}", joint)) for column in (*table.columns, table.time)]
        opened = source(here, documents[:1], columns)
        for column in columns:
            try:
                assert len(opened.column(*column)) == 1
            except MissingColumn as lacking:
                assert "beyond any float" in str(lacking)


STATE = {"header": {"stamp": {"sec": 1_000_000, "nanosec": 5}}, "name": ["hip", "knee"], "position": [1.5, 2.5]}


@pytest.mark.parametrize(
    ("column", "value"),
    [
        (("position", "/t[knee]"), 2.5),
        (("position[knee]", "/t"), 2.5),
        (("/t.position[1]", None), 2.5),
        (("/t.position[7]", None), np.nan),
        (("/t.position[elbow]", None), np.nan),
        (("header.stamp", "/t[hip]"), 5e-9),
        (("header.stamp.sec", "/t"), 1e6),
        (("log_time", "/t"), 0.0),
        (("publish_time", "/t"), 5e-9),
    ],
)
def test_paths_into_a_message(tmp_path, column, value):
    np.testing.assert_array_equal(source(tmp_path, [STATE], [column]).column(*column), [value])


@pytest.mark.parametrize(
    ("document", "column", "told"),
    [
        (STATE | {"position": [1.0]}, ("position", "/t[hip]"), "/t message 0 has 1 values for 2 names"),
        (STATE | {"position": [None, 1]}, ("position", "/t[hip]"), "/t message 0 holds a NoneType where a number was"),
        (STATE | {"position": [10**400, 1]}, ("position", "/t[hip]"), "/t message 0 holds a number beyond any float"),
        ({"position": [1.0]}, ("position", "/t[hip]"), "/t message 0 has no list of names (name, names, joint_names)"),
        (STATE, ("/t", None), "'/t' is a topic; a field of it was expected"),
        (STATE, ("/never.x", None), "topic /never has no message"),
        (STATE, ("/other.x", None), "no topic begins '/other.x'; it has /never, /t"),
    ],
)
def test_what_a_message_lacks_is_told_with_its_number(tmp_path, document, column, told):
    with pytest.raises(MissingColumn) as caught:
        source(tmp_path, [document], [column]).column(*column)
    assert told in str(caught.value)


def test_rows_come_by_the_recorders_stamps_unless_its_clock_was_reset(tmp_path):
    documents = [{"a": row} for row in range(4)]
    column = ("a", "/t")
    late = source(tmp_path, documents, [column], [4 * 10**9, 5 * 10**9, 45 * 10**8, 6 * 10**9])
    np.testing.assert_array_equal(late.column(*column), [0, 2, 1, 3])
    reset = source(tmp_path, documents, [column], [4 * 10**9, 5 * 10**9, 10**9, 2 * 10**9])
    np.testing.assert_array_equal(reset.column(*column), [0, 1, 2, 3])


def test_a_message_that_cannot_be_decoded_is_told_with_its_number(tmp_path):
    def messages(wanted):
        yield Message("/t", 1, 1, lambda: {"a": 1})
        yield Message("/t", 2, 2, lambda: 1 / 0)

    with pytest.raises(InputError, match="/t message 1: cannot be decoded: division by zero"):
        MessageSource(OpenLog(tmp_path, {"/t": Topic("/t", "")}, messages), SourceRequest([WantedColumn("a", "/t")]))
