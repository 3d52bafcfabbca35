"""Parameters of a protocol: defaults, values under a condition, values from the command line, and `$name` where used.

`--set` goes over the condition and the condition over the default. A value keeps the kind of its default (number, text,
list of either) and is put in whole; nothing is computed.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from leactl import yamlfile
from leactl.errors import InputError
from leactl.yamlfile import Document, Location, printable, shown

if TYPE_CHECKING:
    from pydantic import ValidationError

NAME = re.compile(r"[a-z][A-Za-z0-9_]*\Z")
REFERENCE = re.compile(r"\$([a-z][A-Za-z0-9_]*)\Z")
KEPT = ("name", "parameters", "conditions")  # keys of the file in which nothing is put in
UNKNOWN = "is no parameter"
EXPECTED = "a finite number, a text that is no $name, or a list of one of these was expected"


@dataclass
class Resolved:
    """Parameters with their values, and where each value comes from."""

    values: dict[str, Any] = field(default_factory=dict)
    origins: dict[str, str] = field(default_factory=dict)

    def take(self, name: str, value: Any, origin: str) -> None:
        """Let a value go over the one before."""
        self.values[name], self.origins[name] = value, origin

    def changed(self, name: str) -> bool:
        """Whether a condition or the command line went over the default."""
        return not self.origins[name].startswith("line ")


@dataclass
class Substituted(Document):
    """A protocol file with its parameters put in; a fault at a place where one was names it and its origin."""

    uses: dict[Location, str] = field(default_factory=dict)  # the parameter that stands there, and its origin
    changed: set[Location] = field(default_factory=set)  # places where the value is not the default
    below: dict[Location, list[str]] = field(default_factory=dict)  # what is changed anywhere below a place

    def put_in(self, location: Location, text: str, changed: bool) -> None:
        """Remember that a parameter stands at this place."""
        self.uses[location] = text
        if changed:
            self.changed.add(location)
            for length in range(2, len(location)):
                self.below.setdefault(location[:length], []).append(text)

    def fault(self, location: Sequence[str | int], message: str) -> str:
        """The line for a fault, and the parameter that brought the value there."""
        found = tuple(location)
        ancestors = [found[:length] for length in range(len(found), 0, -1)]
        used = next(([self.uses[place]] for place in ancestors if place in self.uses), self.below.get(found, []))
        line = super().fault(location, message)
        return line + printable(f" ({', '.join(dict.fromkeys(used))})" if used else "")

    def explain(self, error: "ValidationError", under: Location = ()) -> list[str]:
        """A model's faults, without those of a `$name` that is already said to be unknown."""
        return [line for line in super().explain(error, under) if not line.endswith(f"{UNKNOWN})")]


def resolve(document: Document, overrides: Mapping[str, str], condition: str, faults: list[str]) -> Resolved | None:
    """Read defaults, conditions and overrides, and add to the faults; None where `parameters` is no mapping at all."""
    defaults = document.data.get("parameters")
    conditions = document.data.get("conditions")
    if not isinstance(defaults, Mapping | None):
        faults.append(document.fault(("parameters",), "a mapping of names to defaults was expected"))
        return None
    resolved = Resolved()
    for name, value in (defaults or {}).items():
        if not NAME.match(name):
            faults.append(
                document.fault(("parameters", name), "a name of a letter a-z, then letters, digits, _ was expected")
            )
        elif _kind(value) is None:
            faults.append(document.fault(("parameters", name), f"{shown(value)}: {EXPECTED}"))
        resolved.take(name, value, f"line {document.places['parameters', name][0]}")
    known = dict(resolved.values)
    if not isinstance(conditions, Mapping | None):
        faults.append(document.fault(("conditions",), "a mapping of labels to parameters was expected"))
        conditions = None
    for label, values in (conditions or {}).items():
        _take_condition(document, label, values, known, resolved if label == condition else None, faults)
    for name, text in overrides.items():
        _take_override(name, text, known, resolved, faults)
    return resolved


def _take_condition(
    document: Document, label: str, values: Any, known: Mapping[str, Any], into: Resolved | None, faults: list[str]
) -> None:
    place = ("conditions", label)
    if not isinstance(values, Mapping):
        faults.append(document.fault(place, "a mapping of parameters to values was expected"))
        return
    for name, value in values.items():
        message = _misfit(name, value, known)
        if message:
            faults.append(document.fault((*place, name), message))
        elif into is not None:
            into.take(name, value, f"condition {label}, line {document.places[*place, name][0]}")


def _take_override(name: str, text: str, known: Mapping[str, Any], resolved: Resolved, faults: list[str]) -> None:
    origin = f"--set {name}={text}"
    try:
        value = yamlfile.parse(text, f"--set {name}").data if text.startswith("[") else yamlfile.scalar(text)
    except InputError as error:
        faults.extend(error.faults)
        return
    message = _misfit(name, value, known)
    if message:
        faults.append(f"{origin}: {message}")
    else:
        resolved.take(name, value, origin)


def _misfit(name: str, value: Any, known: Mapping[str, Any]) -> str:
    """Why a value cannot go over a default; empty when it can."""
    if name not in known:
        return f"no such parameter; known: {', '.join(known) or 'none'}"
    kind, expected = _kind(value), _kind(known[name])
    if expected is None:
        return ""  # the default itself is at fault, and said to be
    if kind != expected:
        return f"{shown(value)}: a {expected} was expected, as in the default {shown(known[name])}"
    return ""


def _kind(value: Any) -> str | None:
    if isinstance(value, list):
        kinds = {_kind(item) for item in value}
        kind = kinds.pop() if len(kinds) == 1 else None
        return f"list of {kind}s" if kind in ("finite number", "text") else None
    if isinstance(value, str):
        return None if REFERENCE.match(value) else "text"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return "finite number" if abs(value) < 1e300 else None  # NaN compares false


def substitute(document: Document, resolved: Resolved | None, faults: list[str]) -> Substituted:
    """The document with every `$name` replaced; a name that is no parameter is a fault at its place."""
    result = Substituted(document.name, document.text, None, dict(document.places))

    def put_in(value: Any, place: Location) -> Any:
        if isinstance(value, dict):
            return {key: put_in(item, (*place, key)) for key, item in value.items()}
        if isinstance(value, list):
            return [put_in(item, (*place, index)) for index, item in enumerate(value)]
        reference = REFERENCE.match(value) if isinstance(value, str) else None
        if reference is None or resolved is None:
            return value
        name = reference[1]
        if name not in resolved.values:
            known = ", ".join(f"${known}" for known in resolved.values) or "none"
            faults.append(document.fault(place, f"{value}: no such parameter; known: {known}"))
            result.put_in(place, f"{value} {UNKNOWN}", changed=False)
            return value
        result.put_in(place, f"{value} from {resolved.origins[name]}", resolved.changed(name))
        return resolved.values[name]

    result.data = {k: v if k in KEPT else put_in(v, (k,)) for k, v in document.data.items()}
    return result


def unused(document: Document) -> list[str]:
    """A line for each parameter that stands nowhere in a protocol file, at its default."""

    def standing(value: Any) -> set[str]:
        if isinstance(value, dict | list):
            items = value.values() if isinstance(value, dict) else value
            return {name for item in items for name in standing(item)}
        reference = REFERENCE.match(value) if isinstance(value, str) else None
        return {reference[1]} if reference else set()

    stand = standing({key: value for key, value in document.data.items() if key not in KEPT})
    return [
        document.fault(("parameters", name), f"${name} stands nowhere in the file: to set it changes nothing")
        for name in document.data.get("parameters") or ()
        if name not in stand
    ]
