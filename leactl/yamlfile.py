"""Read YAML that a person wrote as plain data, with the position of every value, so that a fault names line and column.

Stricter than YAML: one document, no anchors or tags, no duplicate keys, YAML 1.2 core scalars (`on` and `yes` are text,
`1e3` is a number). Nothing in a file is ever evaluated, and limits of size bound the time and memory of a reading.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml

from leactl.errors import InputError
from leactl.regular_files import file_bytes

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

    Model = TypeVar("Model", bound=BaseModel)

Location = tuple[str | int, ...]

MAX_BYTES = 1 << 20  # of a file
MAX_DEPTH = 30  # nested mappings and lists
TOO_DEEP = f"nested deeper than {MAX_DEPTH} levels"
MAX_NODES = 30_000  # values in a file; to report a fault in each of them takes 1.5 s and 150 MB
MAX_KEYS = 1000  # keys of one mapping: a file of 1 MiB may have 60,000 unknown keys, each of which is a fault
LONGEST_FAULT = 1000  # characters; a value in a fault may be as long as the file
LONGEST_VALUE = 80  # characters of a value in a fault
LONGEST_INT = 300  # characters of a whole number; the largest float has 309 digits

# libyaml if it is installed: Python alone takes 10 s for a file of 1 MiB
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_INT = re.compile(r"[-+]?[0-9]+\Z")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z")
_CORE_TAG = re.compile(r"tag:yaml\.org,2002:[a-z]+\Z")
_WORD_VALUES: dict[str, Any] = {"": None, "~": None, "null": None, "true": True, "false": False}
_INFINITE_OR_NAN = re.compile(r"[-+]?\.(inf|Inf|INF)\Z|\.(nan|NaN|NAN)\Z")


@dataclass
class Document:
    """The data of one YAML file, its text, and the position (line, column) of each value by its location."""

    name: str
    text: str
    data: Any = None
    places: dict[Location, tuple[int, int]] = field(default_factory=dict)

    def fault(self, location: Sequence[str | int], message: str) -> str:
        """Return a fault as one printable line: `file:line:column  path: message`.

        A location that the file lacks has the position of its nearest ancestor in the file.
        """
        ancestor = tuple(location)
        while ancestor and ancestor not in self.places:
            ancestor = ancestor[:-1]
        return self.fault_at(self.places.get(ancestor, (1, 1)), location, message)

    def fault_at(self, position: tuple[int, int], location: Sequence[str | int], message: str) -> str:
        """Return a fault at a position (line, column) as one printable line, cut to `LONGEST_FAULT` characters."""
        line_number, column = position
        key_path = dotted(location)
        line = f"{self.name}:{line_number}:{column}  {key_path + ': ' if key_path else ''}{message}"
        if len(line) > LONGEST_FAULT:
            line = f"{line[: LONGEST_FAULT // 2]} ... {line[-LONGEST_FAULT // 2 :]}"
        return printable(line)

    def validate(self, model: "type[Model]") -> "Model":
        """Build a model from the data.

        Raises
        ------
        InputError : the data does not fit the model; one line for each fault.
        """
        from pydantic import ValidationError

        try:
            return model.model_validate(self.data)
        except ValidationError as error:
            raise InputError(self.explain(error)) from None

    def explain(self, error: "ValidationError", under: Location = ()) -> list[str]:
        """Return the faults of a model as lines with positions, without faults that follow from other faults.

        `under` is the location of the model's data in the file.
        """
        items_by_location: dict[Location, list[Any]] = {}
        for item in error.errors(include_url=False):
            items_by_location.setdefault(under + self._location(under, item), []).append(item)
        ancestors = {location[:length] for location in items_by_location for length in range(len(under), len(location))}
        faults: dict[str, None] = {}
        for location, items in items_by_location.items():
            # with a faulty part, a list also counts as too short, and the other members of a union reject its kind
            causes = [item for item in items if location not in ancestors or item["type"] not in _KINDS_CAUSED_BY_PARTS]
            for message in _merged_messages(causes):
                faults[self.fault(location, message)] = None
        return list(faults)

    def _location(self, under: Location, item: Any) -> Location:
        """Return the location of an item in the file, without pydantic's names of the members of a union."""
        keys: list[str | int] = []
        for key in item["loc"]:
            if (*under, *keys, key) in self.places or isinstance(key, int):
                keys.append(key)
        if item["type"] == "missing":
            keys = [*(keys if keys[-1:] != [item["loc"][-1]] else keys[:-1]), item["loc"][-1]]
        elif item["type"] in ("union_tag_invalid", "union_tag_not_found"):
            keys.append(item["ctx"]["discriminator"].strip("'"))
        return tuple(keys)


def printable(line: str) -> str:
    """Return a line with unprintable characters escaped, so that no control character reaches a terminal."""
    return line if line.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in line)


def message_of_item(item: Any) -> str:
    """Return the message of one item of a validation error, in words that a person can act on."""
    error_type, context = item["type"], item.get("ctx", {})
    if error_type in ("value_error", "assertion_error"):
        message = str(context.get("error", item["msg"]))
        message = message[:1].lower() + message[1:]
    elif error_type in _WHAT_WAS_EXPECTED:
        message = _WHAT_WAS_EXPECTED[error_type].format_map(
            {name: f"{value:.10g}" if isinstance(value, float) else value for name, value in context.items()}
        )
    elif error_type in _KINDS_WITH_MESSAGE:
        message = item["msg"]
    else:
        message = "a value of another kind was expected"
    value = item["input"]
    if error_type in _KINDS_WITHOUT_VALUE or not isinstance(value, str | int | float | bool):
        return message
    return f"{shown(value)}: {message}"


def _merged_messages(items: Sequence[Any]) -> list[str]:
    """Return the messages of the items at one location; if all say what was expected, they are joined by "or"."""
    messages = list(dict.fromkeys(map(message_of_item, items)))
    if len(messages) < 2 or not all(message.endswith(_WAS_EXPECTED) for message in messages):
        return messages
    value = f"{shown(items[0]['input'])}: "
    expectations = [message.removeprefix(value).removesuffix(_WAS_EXPECTED) for message in messages]
    return [(value if messages[0].startswith(value) else "") + " or ".join(expectations) + _WAS_EXPECTED]


def shown(value: Any) -> str:
    """Return a value as a person would write it in a file, cut to `LONGEST_VALUE` characters."""
    text = repr(value) if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else str(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]} ..."


_WAS_EXPECTED = " was expected"
# types of errors that leactl adds to those of pydantic
UNKNOWN_KEY = "unknown_key"  # the message names the key that was probably meant
NOT_A_MAPPING = "not_a_mapping"
AT_ODDS = "at_odds"  # a value contradicts another value of the file
_KINDS_WITH_MESSAGE = (UNKNOWN_KEY, NOT_A_MAPPING, AT_ODDS)
_KINDS_WITHOUT_VALUE = ("missing", "extra_forbidden")
_KINDS_CAUSED_BY_PARTS = ("too_short", "string_type", "float_type", "int_type", "list_type", "tuple_type", "bool_type")
_NUMBER, _WHOLE_NUMBER, _TEXT = "a number was expected", "a whole number was expected", "a text was expected"
_MAPPING, _LIST = "a mapping was expected", "a list was expected"
# messages by pydantic's error type, since pydantic's own messages use Python's terms; braces name values of its context
_WHAT_WAS_EXPECTED = {
    "missing": "is required and missing",
    "extra_forbidden": "unknown key",
    "float_type": _NUMBER,
    "float_parsing": _NUMBER,
    "int_type": _WHOLE_NUMBER,
    "int_parsing": _WHOLE_NUMBER,
    "int_parsing_size": _WHOLE_NUMBER,
    "int_from_float": _WHOLE_NUMBER,
    "bool_type": "true or false was expected",
    "bool_parsing": "true or false was expected",
    "string_type": _TEXT,
    "string_too_short": _TEXT,
    "string_too_long": "a text of at most {max_length} characters was expected",
    "string_pattern_mismatch": "a text of the form {pattern} was expected",
    "list_type": _LIST,
    "tuple_type": _LIST,
    "set_type": _LIST,
    "too_short": "a list of {min_length} or more was expected",
    "too_long": "at most {max_length} were expected",
    "dict_type": _MAPPING,
    "mapping_type": _MAPPING,
    "model_type": _MAPPING,
    "model_attributes_type": _MAPPING,
    "dataclass_type": _MAPPING,
    "none_required": "nothing was expected",
    "finite_number": "a finite number was expected",
    "greater_than": "more than {gt} was expected",
    "greater_than_equal": "{ge} or more was expected",
    "less_than": "less than {lt} was expected",
    "less_than_equal": "at most {le} was expected",
    "multiple_of": "a multiple of {multiple_of} was expected",
    "literal_error": "{expected} was expected",
    "enum": "{expected} was expected",
    "union_tag_invalid": "{tag!r}: one of {expected_tags} was expected",
    "union_tag_not_found": "is required and missing",
    "path_type": "a path was expected",
    "date_type": "a date as 2026-01-31 was expected",
    "date_parsing": "a date as 2026-01-31 was expected",
    "date_from_datetime_parsing": "a date as 2026-01-31 was expected",
    "date_from_datetime_inexact": "a date as 2026-01-31 was expected",
}


def dotted(location: Sequence[str | int]) -> str:
    """Return a location as text: `("steps", 2, "hold")` as `steps[2].hold`."""
    text = ""
    for key in location:
        text += f"[{key}]" if isinstance(key, int) else (f".{key}" if text else str(key))
    return text


def load(path: Path) -> Document:
    """Read a YAML file.

    Raises
    ------
    InputError : the file is absent, no regular file, too large, not UTF-8, or not the YAML described above.
    """
    return decoded(file_bytes(path, count=MAX_BYTES + 1), str(path))


def decoded(raw: bytes, name: str) -> Document:
    """Read YAML bytes; `name` stands in messages where a file's name would.

    Raises
    ------
    InputError : more than `MAX_BYTES` bytes, or they are not UTF-8 or not the YAML described above.
    """
    if len(raw) > MAX_BYTES:
        raise InputError(f"{name}: a file of at most {MAX_BYTES} bytes was expected; this one is larger")
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: not UTF-8 at byte {error.start}") from None
    return parse(text, name)


def parse(text: str, name: str = "<text>") -> Document:
    """Read YAML text; `name` stands in messages where a file's name would.

    Raises
    ------
    InputError : the text is not the YAML described above.
    """
    document = Document(name, text)
    try:
        _Builder(document).run(yaml.parse(text, Loader=_LOADER))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        last_line = text.count("\n", 0, -1)  # counted from 0; libyaml reports the end of a file on the line after it
        if mark is None or mark.line <= last_line:
            position = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        else:
            position = (last_line + 1, len(text.splitlines()[-1]) + 1)
        problem = str(error.problem or error.context)
        if "nesting depth" in problem:  # PyYAML 6.0.4 reads so far ahead that it reaches its own limit first
            problem = TOO_DEEP
        raise InputError(document.fault_at(position, (), problem)) from None
    except (yaml.YAMLError, UnicodeEncodeError) as error:
        raise InputError(f"{name}  {str(error).splitlines()[0]}") from None
    return document


def scalar(text: str) -> Any:
    """Convert a plain scalar by the YAML 1.2 core schema; `--set name=value` is read in the same way."""
    if text in _WORD_VALUES:
        return _WORD_VALUES[text]
    if _INT.match(text):
        return int(text) if len(text) <= LONGEST_INT else text  # a longer one may exceed the largest float
    if _FLOAT.match(text):
        return float(text)
    if _INFINITE_OR_NAN.match(text):
        return float(text.replace(".", "", 1))
    return text


class _Builder:
    """Build a document's data from the parser's events in one pass, with the positions of values and the faults."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.faults: list[str] = []
        self.values = 0  # number of values so far
        self.anchor_reported = False  # reported once, since every alias follows from its anchor
        self.events: Iterator[Any] = iter(())

    def run(self, events: Iterator[Any]) -> None:
        """Build the data of the document.

        Raises
        ------
        InputError : the text has faults, or more than one document.
        """
        self.events = events
        for event in events:
            if isinstance(event, yaml.DocumentStartEvent):
                if self.values:
                    raise InputError(
                        self.document.fault_at(_position(event), (), "another document; one was expected in a file")
                    )
                self.document.data = self.build(next(events), ())
        if self.faults:
            raise InputError(self.faults)

    def add_fault(self, event: Any, location: Location, message: str) -> None:
        """Add a fault at the position of an event; the location has this position if it has none yet."""
        self.document.places.setdefault(location, _position(event))
        self.faults.append(self.document.fault_at(_position(event), location, message))

    def build(self, event: Any, location: Location) -> Any:
        """Return the data of the value that begins with an event, and store its position.

        Raises
        ------
        InputError : the document has too many values or is nested too deeply.
        """
        self.values += 1
        if self.values > MAX_NODES:
            raise InputError(f"{self.document.name}: more than {MAX_NODES} values")
        if len(location) > MAX_DEPTH:
            raise self.depth_error(event)
        self.document.places[location] = _position(event)
        if event.anchor is not None and not self.anchor_reported:
            self.anchor_reported = True
            self.add_fault(event, location, "anchors and aliases are not accepted; write the value out")
        if isinstance(event, yaml.AliasEvent):
            return None
        if event.tag is not None and not _CORE_TAG.match(event.tag):
            self.add_fault(event, location, f"tag {event.tag} is not accepted")
        if isinstance(event, yaml.MappingStartEvent):
            return self.mapping(location)
        if isinstance(event, yaml.SequenceStartEvent):
            items: list[Any] = []
            while not isinstance(child := next(self.events), yaml.SequenceEndEvent):
                items.append(self.build(child, (*location, len(items))))
            return items
        value = event.value if event.style else scalar(event.value)  # a quoted number is a text
        if isinstance(value, float) and not math.isfinite(value):
            self.add_fault(event, location, f"{event.value}: a finite number was expected")
        return value

    def mapping(self, location: Location) -> dict[str, Any]:
        """Return the mapping whose start event was read last; a repeated key is a fault, and its value is skipped.

        Raises
        ------
        InputError : a key is not plain text, or the mapping has too many keys.
        """
        mapping: dict[str, Any] = {}
        while not isinstance(key_event := next(self.events), yaml.MappingEndEvent):
            if not isinstance(key_event, yaml.ScalarEvent):
                self.add_fault(key_event, location, "a key must be plain text")
                raise InputError(self.faults)  # a mapping or list as key may be nested to any depth
            if len(mapping) == MAX_KEYS:
                raise InputError(
                    self.document.fault_at(_position(key_event), location, f"more than {MAX_KEYS} keys in one mapping")
                )
            key = key_event.value
            if key in mapping:
                self.add_fault(key_event, (*location, key), "this key stands twice")
                self.skip(next(self.events))
                continue
            value_event = next(self.events)
            mapping[key] = self.build(value_event, (*location, key))
            if isinstance(value_event, yaml.ScalarEvent) and value_event.value == "":
                self.document.places[*location, key] = _position(key_event)
        return mapping

    def skip(self, event: Any) -> None:
        """Skip the events of a value, including those of its parts.

        Raises
        ------
        InputError : the value is nested too deeply.
        """
        depth = 0
        while True:
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:
                raise self.depth_error(event)
            if not depth:
                return
            event = next(self.events)

    def depth_error(self, event: Any) -> InputError:
        """Return the error for a value that is nested too deeply."""
        return InputError(self.document.fault_at(_position(event), (), TOO_DEEP))


def _position(event: Any) -> tuple[int, int]:
    """Return line and column of an event, counted from 1."""
    return event.start_mark.line + 1, event.start_mark.column + 1
