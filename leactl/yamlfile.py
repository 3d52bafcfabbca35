"""YAML that a person wrote: plain data out, with the place of every value kept, so that a fault names line and column.

Stricter than YAML: one document, no anchors or tags, no duplicate keys, YAML 1.2 core scalars (`on` and `yes` are text,
`1e3` is a number). Nothing in a file is ever evaluated.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml

from leactl.errors import InputError

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

    Model = TypeVar("Model", bound=BaseModel)

Location = tuple[str | int, ...]

MAX_BYTES = 1 << 20
MAX_DEPTH = 30
MAX_NODES = 100_000

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
        """One line for a fault: `file:line:column  path: message`.

        A location that the file lacks takes the place of its nearest parent there.
        """
        known = tuple(location)
        while known and known not in self.places:
            known = known[:-1]
        line, column = self.places.get(known, (1, 1))
        path = dotted(location)
        return f"{self.name}:{line}:{column}  {path}: {message}" if path else f"{self.name}:{line}:{column}  {message}"

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
        """Turn a model's validation error into lines with places."""
        faults: list[str] = []
        for item in error.errors(include_url=False):
            location = under + self._existing(under, item["loc"])
            found = item["input"]
            message = item["msg"].removeprefix("Value error, ")
            shown = ""
            if item["type"] not in ("missing", "extra_forbidden") and isinstance(found, str | int | float | bool):
                shown = f"{found!r}: "
            elif item["type"] == "extra_forbidden":
                message = "unknown key"
            elif item["type"] == "missing":
                message = "is required and missing"
            line = self.fault(location, shown + message[0].lower() + message[1:])
            if line not in faults:
                faults.append(line)
        return faults

    def _existing(self, under: Location, loc: Sequence[str | int]) -> Location:
        """Drop the parts of a model's location that name a union's member rather than a key of the file."""
        kept: list[str | int] = []
        for position, part in enumerate(loc):
            last = position == len(loc) - 1
            if (
                (*under, *kept, part) in self.places
                or (last and not isinstance(part, str))
                or (last and "[" not in str(part))
            ):
                kept.append(part)
        return tuple(kept)


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
    InputError : the file is absent, too large, not UTF-8, or not the YAML described above.
    """
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise InputError(f"{path}: {size} bytes; a file of at most {MAX_BYTES} bytes was expected")
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 at byte {error.start}") from None
    return parse(text, str(path))


def parse(text: str, name: str = "<text>") -> Document:
    """Read YAML text; `name` stands in messages where a file's name would.

    Raises
    ------
    InputError : the text is not the YAML described above.
    """
    document = Document(name, text)
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        raise InputError(f"{name}{place}  {error.problem or error.context}") from None
    except (yaml.YAMLError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else str(error).splitlines()[0]
        raise InputError(f"{name}  {reason}") from None
    if node is not None:
        _Builder(document).run(node)
    return document


def scalar(text: str) -> Any:
    """A plain scalar by the YAML 1.2 core schema, as `--set name=value` reads it too."""
    if text in _WORDS:
        return _WORDS[text]
    if _INT.match(text):
        return int(text) if len(text) <= 4000 else text
    if _FLOAT.match(text):
        return float(text)
    if _INFINITE.match(text):
        return float(text.replace(".", "", 1))
    return text


class _Builder:
    """Walk the node tree once: data, places and faults."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.faults: list[str] = []
        self.seen: set[int] = set()

    def run(self, node: yaml.Node) -> None:
        self.document.data = self.build(node, ())
        if self.faults:
            raise InputError(self.faults)

    def complain(self, node: yaml.Node, location: Location, message: str) -> None:
        self.document.places.setdefault(location, _place(node))
        mark = _place(node)
        path = dotted(location)
        self.faults.append(f"{self.document.name}:{mark[0]}:{mark[1]}  {path + ': ' if path else ''}{message}")

    def build(self, node: yaml.Node, location: Location) -> Any:
        if id(node) in self.seen:
            self.complain(node, location, "anchors and aliases are not accepted; write the value out")
            return None
        self.seen.add(id(node))
        if len(self.seen) > MAX_NODES:
            raise InputError(f"{self.document.name}: more than {MAX_NODES} values")
        if len(location) > MAX_DEPTH:
            raise InputError(f"{self.document.name}: nested deeper than {MAX_DEPTH} levels")
        self.document.places[location] = _place(node)
        if isinstance(node, yaml.MappingNode):
            return self.mapping(node, location)
        if isinstance(node, yaml.SequenceNode):
            return [self.build(child, (*location, index)) for index, child in enumerate(node.value)]
        if not _CORE_TAG.match(node.tag):
            self.complain(node, location, f"tag {node.tag} is not accepted")
            return None
        assert isinstance(node, yaml.ScalarNode)
        if node.style is not None:
            return node.value
        value = scalar(node.value)
        if isinstance(value, float) and not math.isfinite(value):
            self.complain(node, location, f"{node.value}: a finite number was expected")
        return value

    def mapping(self, node: yaml.MappingNode, location: Location) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self.complain(key_node, location, "a key must be plain text")
                continue
            key = key_node.value
            if key in result:
                self.complain(key_node, (*location, key), "this key stands twice")
                continue
            result[key] = self.build(value_node, (*location, key))
            if not isinstance(value_node, yaml.MappingNode | yaml.SequenceNode) and value_node.value == "":
                self.document.places[*location, key] = _place(key_node)
        return result


def _place(node: yaml.Node) -> tuple[int, int]:
    return node.start_mark.line + 1, node.start_mark.column + 1
