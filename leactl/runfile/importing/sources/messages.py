"""Source for logs of messages by topic, such as MCAP: columns are collected in one pass and no message is kept.

A column is a path below its topic, `/drive/state.motor.current[2]`, or below `records: /drive/state`. `[NAME]` in place
of an index takes the element that the message's own list of names gives it (`name` of a JointState, `joint_names` of
controllers). A topic with `[NAME]` as records has the messages that name it alone, each list cut to that element.

A `builtin_interfaces/Time` counts as seconds; `log_time` and `publish_time` are those of the recorder where a message
has no such field. All three count from the first message of the log, so that nanoseconds survive.
"""

import math
import re
from array import array
from collections.abc import Callable, Collection, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.runfile.importing.mapping import as_label
from leactl.runfile.importing.sources.source import (
    ListedColumn,
    ListedTable,
    MissingColumn,
    SourceRequest,
    WantedColumn,
    as_float,
    reason_text,
)

Array = npt.NDArray[np.float64]
NAMES: Final = ("name", "names", "joint_names")  # sensor_msgs/JointState, control_msgs of both generations
STAMP_PARTS: Final = ("nanosec", "nanosecs", "nsec", "nsecs")  # ROS 2, ROS 1, and Foxglove's JSON
SECONDS_PARTS: Final = ("sec", "secs")
RECORDER: Final = (("log_time",), ("publish_time",))  # paths of the recorder's stamps
MOST_LISTED_ELEMENTS: Final = 64  # of a list whose elements are listed; a longer one is an image or a point cloud
MOST_FIELD_LEVELS: Final = 8  # of nested fields that are listed
MOST_SURVEYED_MESSAGES: Final = 50  # messages of a topic from which its fields and joints are listed
_KNOWN_FIELDS: dict[type[Any], tuple[str, ...]] = {}  # cache, since every message needs them
NUMBERS = bool | int | float | np.number | np.bool_
# largest delay of a message in the recorder's buffers; a stamp that is earlier by more means a clock that was set back
RESET_NS: Final = 10**9
EARLIEST_NS: Final = 946_684_800 * 10**9  # 2000; clocks that start with their computer show less
LATEST_NS: Final = 4_102_444_800 * 10**9  # 2100
_STEP = re.compile(r"\.?([^.\[\]]+)|\[([^\[\]]+)\]")


Names = list[str] | None  # a message's list of names; None if it has none


class Topic(NamedTuple):
    """Declaration of a topic by its log."""

    name: str
    kind: str  # type of the messages
    unreadable: str = ""  # reason why the messages cannot be decoded
    only: str = ""  # name of the field of a topic with a single field; paths may leave it out
    units: str = ""  # units of the only field, as the log declares


class Message(NamedTuple):
    """One message, decoded on demand."""

    topic: str
    log_ns: int
    publish_ns: int
    decode: Callable[[], Any]


class OpenLog(NamedTuple):
    """A log that is open."""

    path: Path
    topics: dict[str, Topic]
    # returns the messages of given topics, in any order; raises InputError
    messages: Callable[[Collection[str]], Iterator[Message]]


class ColumnPath(NamedTuple):
    """Path of a column: topic, joint and fields below the message."""

    topic: str
    joint: str | None  # selects the messages that name it, and its element of each list
    steps: tuple[str | int, ...]


class MessageSource:
    """Source over a log of messages."""

    remarks: Sequence[str] = ()

    def __init__(self, log: OpenLog, request: SourceRequest) -> None:
        self.path, self._log = log.path, log
        self.began: datetime | None = None
        self._first_ns: int | None = None
        self._columns: dict[ColumnPath, _CollectedColumn] = {}
        self._counts = dict.fromkeys(log.topics, 0)
        self._samples: dict[str, list[Any]] = {}
        if request.columns is None:
            self._survey()
            return
        for wanted in (*request.columns, *request.labels):
            try:
                path = self._path(wanted)
            except MissingColumn:
                continue  # reported when the column is read
            self._columns.setdefault(path, _CollectedColumn())
        self._read()

    def column(self, name: str | int, records: str | None) -> Array | list[str]:
        """Return a column by its path, in the order of the recorder's stamps."""
        path = self._path(WantedColumn(name, records))
        column = self._columns[path]
        if not column.rows:
            raise MissingColumn(f"{self.path}: {self._empty_column_text(path)}")
        if column.error or not column.known:
            raise MissingColumn(column.error or column.lack)
        order = column.order()
        if column.texts:
            return [column.texts[row] for row in order]
        return np.frombuffer(column.values, np.float64)[order]

    def labels(self, name: str | int, records: str | None) -> list[str]:
        """Return a column by its path, as labels."""
        return [as_label(value) for value in self.column(name, records)]

    def field(self, name: str | int) -> float | str:
        """Return the value of a column that never changes."""
        values = self.column(name, None)
        texts_or_numbers = values if isinstance(values, list) else values[np.isfinite(values)].tolist()
        distinct_values = set(texts_or_numbers) - {""}
        if len(distinct_values) != 1:
            raise MissingColumn(f"{self.path}: {name!r} holds {len(distinct_values)} values where one was expected")
        value = distinct_values.pop()
        return value if isinstance(value, str) else float(value)

    def location(self, name: str | int, row: int) -> str:
        """Return file, column and number of a logged message (from 0), for error messages."""
        return f"{self.path}: {name!r} message {row}"

    def tables(self) -> list[ListedTable]:
        """Return a table for each topic that can be read, and for lists by joint."""
        return [table for name, samples in self._samples.items() for table in _tables(self._log.topics[name], samples)]

    def _survey(self) -> None:
        """Keep the first messages of each readable topic, from which its fields and joints are listed."""
        readable = {name for name, topic in self._log.topics.items() if not topic.unreadable}
        for message in self._log.messages(readable):
            samples = self._samples.setdefault(message.topic, [])
            if len(samples) < MOST_SURVEYED_MESSAGES:
                samples.append(self._decoded(message))

    def _read(self) -> None:
        """Collect the requested columns in one pass through the log, and note when the recording began."""
        by_topic: dict[str, list[tuple[ColumnPath, _CollectedColumn]]] = {}
        for path, column in self._columns.items():
            by_topic.setdefault(path.topic, []).append((path, column))
        earliest_ns: int | None = None
        for message in self._log.messages(by_topic):
            earliest_ns = message.log_ns if earliest_ns is None else min(earliest_ns, message.log_ns)
            if self._first_ns is None:
                self._first_ns = message.log_ns
            tree = self._decoded(message)
            names = _names(tree)
            self._counts[message.topic] += 1
            for path, column in by_topic[message.topic]:
                self._put_value(column, path, message, tree, names)
        if earliest_ns is not None and EARLIEST_NS < earliest_ns < LATEST_NS:
            self.began = datetime.fromtimestamp(earliest_ns * 1e-9, UTC)

    def _decoded(self, message: Message) -> Any:
        """Decode a message.

        Raises
        ------
        InputError : the message is damaged.
        """
        try:
            return message.decode()
        except Exception as error:  # noqa: BLE001 (decoders raise any exception for damaged bytes)
            number = self._counts[message.topic]
            raise InputError(
                f"{self.path}: {message.topic} message {number}: cannot be decoded: {reason_text(error)}"
            ) from None

    def _put_value(
        self, column: "_CollectedColumn", path: ColumnPath, message: Message, tree: Any, names: Names
    ) -> None:
        """Add the value at a path in a message to its column; another kind of value becomes the column's error."""
        if column.error:
            return
        try:
            if path.joint is not None:
                index = _index_of(path.joint, names)
                if index is None:
                    return
                value = _element_of_joint(self._value(tree, path, message, names), index, len(names or ()))
            else:
                value = self._value(tree, path, message, names)
            column.put(value, message.log_ns)
        except _NoValue as lack:
            column.put_missing(f"{self._location(message)} {lack}", message.log_ns)
        except MissingColumn as error:
            column.error, column.rows = f"{self._location(message)} {error}", column.rows + 1

    def _location(self, message: Message) -> str:
        """Return file, topic and number of the latest message of a topic."""
        return f"{self.path}: {message.topic} message {self._counts[message.topic] - 1}"

    def _value(self, tree: Any, path: ColumnPath, message: Message, names: Names) -> Any:
        """Return the value at a path in a message; stamps become seconds since the first message of the log.

        Raises
        ------
        _NoValue : the message lacks a field of the path, or the field is null.
        """
        assert self._first_ns is not None
        if path.steps in RECORDER and _child(tree, path.steps[0]) is None:
            return ((message.log_ns if path.steps == RECORDER[0] else message.publish_ns) - self._first_ns) * 1e-9
        node, path_so_far = tree, ""
        for step in path.steps:
            is_list = not isinstance(node, str | dict) and isinstance(node, Sequence | np.ndarray)
            child = _element(node, step, names) if is_list else _child(node, step)
            if child is None:
                fields = ", ".join(_fields(node)) or f"a value of {type(node).__name__}"
                raise _NoValue(f"has no {step!r} in {path_so_far or 'it'}, which has {fields}")
            node, path_so_far = child, f"{path_so_far}.{step}".strip(".")
        stamp = _nanoseconds(node)
        return node if stamp is None else as_float(stamp - self._first_ns) * 1e-9

    def _path(self, wanted: WantedColumn) -> ColumnPath:
        """Parse the path of a column.

        Raises
        ------
        MissingColumn : no topic of the log begins its path, or the topic cannot be decoded.
        """
        if wanted.records is None:
            text, joint = str(wanted.name), None
            topic = self._topic(text)
            field_path = text[len(topic) :]
        else:
            topic = self._topic(wanted.records)
            joint_match = _STEP.fullmatch(wanted.records[len(topic) :])
            joint, field_path = joint_match[2] if joint_match else None, str(wanted.name)
        if reason := self._log.topics[topic].unreadable:
            raise MissingColumn(f"{self.path}: {topic} {reason}")
        steps = tuple(_step(match) for match in _STEP.finditer(field_path))
        only = self._log.topics[topic].only
        if only and (not steps or isinstance(steps[0], int)):
            steps = (only, *steps)
        if not steps:
            raise MissingColumn(f"{self.path}: {wanted.name!r} is a topic; a field of it was expected")
        return ColumnPath(topic, joint, steps)

    def _topic(self, text: str) -> str:
        """Return the longest name of a topic with which a path begins.

        Raises
        ------
        MissingColumn : the log has no such topic.
        """
        matches = [name for name in self._log.topics if text == name or text.startswith((f"{name}.", f"{name}["))]
        if not matches:
            topics_text = ", ".join(sorted(self._log.topics)) or "none"
            raise MissingColumn(f"{self.path}: no topic begins {text!r}; it has {topics_text}")
        return max(matches, key=len)

    def _empty_column_text(self, path: ColumnPath) -> str:
        """Return the reason why a column has no row."""
        if path.joint is not None and self._counts[path.topic]:
            return f"no message of {path.topic} names {path.joint!r}"
        return f"topic {path.topic} has no message"


class _NoValue(MissingColumn):
    """A message has no value at a path; another message may have one."""


class _CollectedColumn:
    """Values of one column in the order of reading, with the recorder's stamps."""

    def __init__(self) -> None:
        self.values, self.log_ns = array("d"), array("Q")
        self.texts: list[str] = []
        self.rows, self.error = 0, ""
        self.known, self.lack = 0, ""  # number of rows with a value, and what the first message without one lacks
        self._latest_ns, self._was_reset = 0, False

    def put(self, value: Any, log_ns: int) -> None:
        """Add a row; the value is NaN if a list has no such element.

        Raises
        ------
        MissingColumn : the value is neither a number nor, like all values before it, a text.
        """
        if isinstance(value, str) and (self.texts or not self.known):
            self.texts = self.texts or [""] * self.rows
            self.texts.append(value)
        elif isinstance(value, NUMBERS) and not self.texts:
            self.values.append(as_float(value))
        else:
            raise MissingColumn(f"holds {_described(value)} where a number was expected")
        self.known += 1
        self._put_stamp(log_ns)

    def put_missing(self, lack: str, log_ns: int) -> None:
        """Add a row without a value: NaN in a column of numbers, an empty text in one of texts."""
        self.lack = self.lack or lack
        if self.texts:
            self.texts.append("")
        else:
            self.values.append(math.nan)
        self._put_stamp(log_ns)

    def _put_stamp(self, log_ns: int) -> None:
        """Add the recorder's stamp of a row."""
        self.log_ns.append(log_ns)
        self.rows += 1
        self._was_reset |= log_ns < self._latest_ns - RESET_NS
        self._latest_ns = max(self._latest_ns, log_ns)

    def order(self) -> npt.NDArray[np.intp]:
        """Return the order of the rows by the recorder's stamps, or as written if its clock was set back."""
        stamps = np.frombuffer(self.log_ns, np.uint64)
        return np.arange(len(stamps)) if self._was_reset else np.argsort(stamps, kind="stable")


def _step(match: re.Match[str]) -> str | int:
    """Return one step of a path: a field's name, an index, or a name in brackets."""
    bracketed = match[2]
    return match[1] if bracketed is None else int(bracketed) if bracketed.isdigit() else bracketed


def _fields(node: Any) -> Sequence[str]:
    """Return the names of a message's fields."""
    return [str(name) for name in node] if isinstance(node, dict) else _fields_of(type(node))


def _fields_of(kind: type[Any]) -> tuple[str, ...]:
    """Return the names of the fields of a message type; cached."""
    if kind not in _KNOWN_FIELDS:
        _KNOWN_FIELDS[kind] = tuple(name for name in getattr(kind, "__dataclass_fields__", ()) if name != "__msgtype__")
    return _KNOWN_FIELDS[kind]


def _child(node: Any, name: str | int) -> Any:
    """Return a field of a message; None if it has none of that name."""
    if isinstance(node, dict):
        return node.get(name)
    return getattr(node, str(name)) if name in _fields_of(type(node)) else None


def _element(node: Any, step: str | int, names: Names) -> Any:
    """Return an element of a list by index or name; NaN if the list has no such element."""
    index = step if isinstance(step, int) else _index_of(step, names)
    return node[index] if index is not None and index < len(node) else np.nan


def _names(tree: Any) -> Names:
    """Return a message's list of names, by which elements of its other lists are addressed; None if it has none."""
    for field in NAMES:
        names = _child(tree, field)
        if isinstance(names, list) and all(isinstance(text, str) for text in names):
            return names
    return None


def _index_of(joint: str, names: Names) -> int | None:
    """Return the index of a joint in a message's list of names; None if the list lacks it.

    Raises
    ------
    MissingColumn : the message has no list of names.
    """
    if names is None:
        raise MissingColumn(f"has no list of names ({', '.join(NAMES)}) that could have {joint!r}")
    return names.index(joint) if joint in names else None


def _element_of_joint(value: Any, index: int, length: int) -> Any:
    """Return the element at `index` of a list with `length` elements; NaN of an empty list, as JointState allows.

    A value that is not a list is returned unchanged.
    """
    if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray):
        return value
    if len(value) not in (0, length):
        raise MissingColumn(f"has {len(value)} values for {length} names")
    return value[index] if len(value) else np.nan


def _nanoseconds(node: Any) -> int | None:
    """Return a stamp of seconds and nanoseconds in nanoseconds; None for any other value."""
    if isinstance(node, float | int | np.number):
        return None
    fields = _fields(node)
    if len(fields) == 2 and fields[0] in SECONDS_PARTS and fields[1] in STAMP_PARTS:
        seconds, nanoseconds = (_child(node, name) for name in fields)
        if isinstance(seconds, int | np.integer) and isinstance(nanoseconds, int | np.integer):
            return int(seconds) * 1_000_000_000 + int(nanoseconds)
    return None


def _described(value: Any) -> str:
    """Describe a value that is no number, for a message."""
    if isinstance(value, str):
        return f"the text {value[:40]!r}"
    if isinstance(value, Sequence | np.ndarray):
        return f"a list of {len(value)}"
    return f"a group of {', '.join(_fields(value))}" if _fields(value) else f"a {type(value).__name__}"


def _tables(topic: Topic, samples: list[Any]) -> Iterator[ListedTable]:
    """Yield the tables of a topic: one by joint for lists with an element for each name, one for all other numbers."""
    joints = list(dict.fromkeys(name for tree in samples for name in _names(tree) or ()))
    tree = samples[0]
    has_stamp = any(path == "header.stamp" for path, _ in _leaves(tree, "", 0))
    time = ListedColumn(
        "header.stamp" if has_stamp else "log_time", "s", "a stamp of ROS" if has_stamp else "the recorder"
    )
    plain_columns, joint_columns = [], []
    for path, value in _leaves(tree, "", 0):
        if isinstance(value, Sequence | np.ndarray):
            if joints and len(value) == len(_names(tree) or ()):
                joint_columns.append(ListedColumn(path))
            elif not joints and len(value) <= MOST_LISTED_ELEMENTS:
                plain_columns += [ListedColumn(f"{path}[{index}]") for index in range(len(value))]
        elif not path.startswith("header."):
            plain_columns.append(ListedColumn(path, topic.units, f"what {topic.name} declares" if topic.units else ""))
    if joint_columns:
        yield ListedTable(f"{topic.name}[{{joint}}]", tuple(joint_columns), topic.kind, time, tuple(joints))
    if plain_columns:
        yield ListedTable(topic.name, tuple(plain_columns), topic.kind, time)


def _leaves(node: Any, path: str, depth: int) -> Iterator[tuple[str, Any]]:
    """Yield the path and value of the numbers, stamps and lists of numbers in a message."""
    for name in _fields(node):
        field_path, value = f"{path}.{name}" if path else name, _child(node, name)
        if _nanoseconds(value) is not None or isinstance(value, NUMBERS | np.ndarray) or _are_numbers(value):
            yield field_path, value
        elif depth < MOST_FIELD_LEVELS and _fields(value):
            yield from _leaves(value, field_path, depth + 1)


def _are_numbers(value: Any) -> bool:
    """Return whether a value is a non-empty list whose first elements are numbers."""
    return (
        isinstance(value, list)
        and bool(value)
        and all(isinstance(item, NUMBERS) for item in value[:MOST_LISTED_ELEMENTS])
    )
