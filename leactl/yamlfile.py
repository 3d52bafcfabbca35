"""YAML that a person wrote: plain data out, with the place of every value kept, so that a fault names line and column.

Stricter than YAML: one document, no anchors or tags, no duplicate keys, YAML 1.2 core scalars (`on` and `yes` are text,
`1e3` is a number). Nothing in a file is ever evaluated, and what would take long or much memory is refused unread.
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

MAX_BYTES = 1 << 20
MAX_DEPTH = 30
TOO_DEEP = f"nested deeper than {MAX_DEPTH} levels"
MAX_NODES = 30_000  # values; a fault in each takes 1.5 s and 150 MB to tell
MAX_KEYS = 1000  # of one mapping: 60,000 unknown ones would be as many faults
LONGEST_LINE = 1000  # characters of a fault: a value may be as long as the file
LONGEST_VALUE = 80  # characters of a value in a fault
LONGEST_INT = 300  # digits: a float holds 308

# libyaml where it is there: in Python alone a file of 1 MiB takes 10 s
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_INT = re.compile(r"[-+]?[0-9]+\Z")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z")
_CORE_TAG = re.compile(r"tag:yaml\.org,2002:[a-z]+\Z")
_WORDS: dict[str, Any] = {"": None, "~": None, "null": None, "true": True, "false": False}
_INFINITE = re.compile(r"[-+]?\.(inf|Inf|INF)\Z|\.(nan|NaN|NAN)\Z")


@dataclass
class Document:
    """The data of one YAML file, its text byte for byte, and where each value stands."""

    name: str
    text: str
    data: Any = None
    places: dict[Location, tuple[int, int]] = field(default_factory=dict)

    def fault(self, location: Sequence[str | int], message: str) -> str:
        """One printable line for a fault: `file:line:column  path: message`.

        A location that the file lacks takes the place of its nearest parent there.
        """
        known = tuple(location)
        while known and known not in self.places:
            known = known[:-1]
        return self.fault_at(self.places.get(known, (1, 1)), location, message)

    def fault_at(self, place: tuple[int, int], location: Sequence[str | int], message: str) -> str:
        """One printable line for a fault at a line and column."""
        path = dotted(location)
        line = f"{self.name}:{place[0]}:{place[1]}  {path + ': ' if path else ''}{message}"
        if len(line) > LONGEST_LINE:
            line = f"{line[: LONGEST_LINE // 2]} ... {line[-LONGEST_LINE // 2 :]}"
        return printable(line)

    def validate(self, model: "type[Model]") -> "Model":
        """Build the model from the data.

        Raises
        ------
        InputError : one line a fault, all of them at once.
        """
        from pydantic import ValidationError

        try:
            return model.model_validate(self.data)
        except ValidationError as error:
            raise InputError(self.explain(error)) from None

    def explain(self, error: "ValidationError", under: Location = ()) -> list[str]:
        """Turn a model's validation error into lines with places, without those that follow from another."""
        items: dict[Location, list[Any]] = {}
        for item in error.errors(include_url=False):
            items.setdefault(under + self._location(under, item), []).append(item)
        around = {location[:length] for location in items for length in range(len(under), len(location))}
        faults: dict[str, None] = {}
        for location, several in items.items():
            # what stands there is of another kind for one member of a union, or too short, since a part of it is faulty
            own = [item for item in several if location not in around or item["type"] not in _ABOUT_THE_WHOLE]
            for message in _either(own):
                faults[self.fault(location, message)] = None
        return list(faults)

    def _location(self, under: Location, item: Any) -> Location:
        """Where an item stands, without the parts that name a union's member rather than a key of the file."""
        kept: list[str | int] = []
        for part in item["loc"]:
            if (*under, *kept, part) in self.places or isinstance(part, int):
                kept.append(part)
        if item["type"] == "missing":
            kept = [*(kept if kept[-1:] != [item["loc"][-1]] else kept[:-1]), item["loc"][-1]]
        elif item["type"] in ("union_tag_invalid", "union_tag_not_found"):
            kept.append(item["ctx"]["discriminator"].strip("'"))
        return tuple(kept)


def printable(line: str) -> str:
    """The line with every control character written out, so that none reaches a terminal."""
    return line if line.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in line)


def plainly(item: Any) -> str:
    """What one item of a validation error says, in words that a person can act on."""
    kind, context = item["type"], item.get("ctx", {})
    if kind in ("value_error", "assertion_error"):
        message = str(context.get("error", item["msg"]))
        message = message[:1].lower() + message[1:]
    elif kind in _WHAT_WAS_EXPECTED:
        message = _WHAT_WAS_EXPECTED[kind].format_map(
            {name: f"{value:.10g}" if isinstance(value, float) else value for name, value in context.items()}
        )
    elif kind in _OWN_KINDS:
        message = item["msg"]
    else:
        message = "a value of another kind was expected"
    value = item["input"]
    if kind in _WITHOUT_VALUE or not isinstance(value, str | int | float | bool):
        return message
    return f"{shown(value)}: {message}"


def _either(items: Sequence[Any]) -> list[str]:
    """What the items of one place say; what several members of a union expect there is one message."""
    messages = list(dict.fromkeys(map(plainly, items)))
    if len(messages) < 2 or not all(message.endswith(_WAS_EXPECTED) for message in messages):
        return messages
    value = f"{shown(items[0]['input'])}: "
    wanted = [message.removeprefix(value).removesuffix(_WAS_EXPECTED) for message in messages]
    return [(value if messages[0].startswith(value) else "") + " or ".join(wanted) + _WAS_EXPECTED]


def shown(value: Any) -> str:
    """A value as it stands in a file, cut short where it is long."""
    text = repr(value) if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else str(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]} ..."


_WAS_EXPECTED = " was expected"
UNKNOWN_KEY = "unknown_key"  # kind of an error that names the key which was probably meant
NOT_A_MAPPING = "not_a_mapping"
AT_ODDS = "at_odds"  # with what stands elsewhere in the file
_OWN_KINDS = (UNKNOWN_KEY, NOT_A_MAPPING, AT_ODDS)
_WITHOUT_VALUE = ("missing", "extra_forbidden")
_ABOUT_THE_WHOLE = ("too_short", "string_type", "float_type", "int_type", "list_type", "tuple_type", "bool_type")
_NUMBER, _WHOLE, _TEXT = "a number was expected", "a whole number was expected", "a text was expected"
_MAPPING, _LIST = "a mapping was expected", "a list was expected"
# by pydantic's names of its errors, whose words speak of Python; its numbers and names stand in braces
_WHAT_WAS_EXPECTED = {
    "missing": "is required and missing",
    "extra_forbidden": "unknown key",
    "float_type": _NUMBER,
    "float_parsing": _NUMBER,
    "int_type": _WHOLE,
    "int_parsing": _WHOLE,
    "int_parsing_size": _WHOLE,
    "int_from_float": _WHOLE,
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
    """`("steps", 2, "hold")` as `steps[2].hold`."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else str(part))
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
    InputError : there are too many, they are not UTF-8, or not the YAML described above.
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
        last = text.count("\n", 0, -1)  # libyaml puts the end of a file behind its last line
        if mark is None or mark.line <= last:
            place = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        else:
            place = (last + 1, len(text.splitlines()[-1]) + 1)
        problem = str(error.problem or error.context)
        if "nesting depth" in problem:  # PyYAML 6.0.4 looks so far ahead that it meets its own limit first
            problem = TOO_DEEP
        raise InputError(document.fault_at(place, (), problem)) from None
    except (yaml.YAMLError, UnicodeEncodeError) as error:
        raise InputError(f"{name}  {str(error).splitlines()[0]}") from None
    return document


def scalar(text: str) -> Any:
    """A plain scalar by the YAML 1.2 core schema, as `--set name=value` reads it too."""
    if text in _WORDS:
        return _WORDS[text]
    if _INT.match(text):
        return int(text) if len(text) <= LONGEST_INT else text  # a longer one is no float either
    if _FLOAT.match(text):
        return float(text)
    if _INFINITE.match(text):
        return float(text.replace(".", "", 1))
    return text


class _Builder:
    """Go through the parser's events once: data, places and faults."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.faults: list[str] = []
        self.values = 0
        self.anchored = False  # said once: every alias of an anchor follows from it
        self.events: Iterator[Any] = iter(())

    def run(self, events: Iterator[Any]) -> None:
        self.events = events
        for event in events:
            if isinstance(event, yaml.DocumentStartEvent):
                if self.values:
                    raise InputError(
                        self.document.fault_at(_place(event), (), "another document; one was expected in a file")
                    )
                self.document.data = self.build(next(events), ())
        if self.faults:
            raise InputError(self.faults)

    def complain(self, event: Any, location: Location, message: str) -> None:
        self.document.places.setdefault(location, _place(event))
        self.faults.append(self.document.fault_at(_place(event), location, message))

    def build(self, event: Any, location: Location) -> Any:
        self.values += 1
        if self.values > MAX_NODES:
            raise InputError(f"{self.document.name}: more than {MAX_NODES} values")
        if len(location) > MAX_DEPTH:
            raise self.too_deep(event)
        self.document.places[location] = _place(event)
        if event.anchor is not None and not self.anchored:
            self.anchored = True
            self.complain(event, location, "anchors and aliases are not accepted; write the value out")
        if isinstance(event, yaml.AliasEvent):
            return None
        if event.tag is not None and not _CORE_TAG.match(event.tag):
            self.complain(event, location, f"tag {event.tag} is not accepted")
        if isinstance(event, yaml.MappingStartEvent):
            return self.mapping(location)
        if isinstance(event, yaml.SequenceStartEvent):
            items: list[Any] = []
            while not isinstance(child := next(self.events), yaml.SequenceEndEvent):
                items.append(self.build(child, (*location, len(items))))
            return items
        value = event.value if event.style else scalar(event.value)  # a quoted number is a text
        if isinstance(value, float) and not math.isfinite(value):
            self.complain(event, location, f"{event.value}: a finite number was expected")
        return value

    def mapping(self, location: Location) -> dict[str, Any]:
        result: dict[str, Any] = {}
        while not isinstance(key_event := next(self.events), yaml.MappingEndEvent):
            if not isinstance(key_event, yaml.ScalarEvent):
                self.complain(key_event, location, "a key must be plain text")
                raise InputError(self.faults)  # it may hold anything, to any depth
            if len(result) == MAX_KEYS:
                raise InputError(
                    self.document.fault_at(_place(key_event), location, f"more than {MAX_KEYS} keys in one mapping")
                )
            key = key_event.value
            if key in result:
                self.complain(key_event, (*location, key), "this key stands twice")
                self.skip(next(self.events))
                continue
            value_event = next(self.events)
            result[key] = self.build(value_event, (*location, key))
            if isinstance(value_event, yaml.ScalarEvent) and value_event.value == "":
                self.document.places[*location, key] = _place(key_event)
        return result

    def skip(self, event: Any) -> None:
        """Leave out a value with all that is in it."""
        depth = 0
        while True:
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:
                raise self.too_deep(event)
            if not depth:
                return
            event = next(self.events)

    def too_deep(self, event: Any) -> InputError:
        return InputError(self.document.fault_at(_place(event), (), TOO_DEEP))


def _place(event: Any) -> tuple[int, int]:
    return event.start_mark.line + 1, event.start_mark.column + 1
