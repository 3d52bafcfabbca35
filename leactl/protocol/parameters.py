"""Resolve the parameters of a protocol from defaults, a condition and the command line, and replace `$name` by them.

`--set` overrides the condition, and the condition overrides the default. A value has the kind of its default (number,
text, list of either) and replaces `$name` as a whole; nothing is computed.
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
RESERVED_NAMES = {"seed": "`--set seed=N` is that of an emulated bench"}
LITERAL_KEYS = ("name", "parameters", "conditions")  # keys of the file whose values keep `$name` as it is
UNKNOWN_TEXT = "is no parameter"
EXPECTED_VALUES = "a finite number, a text that is no $name, or a list of one of these was expected"


@dataclass
class Resolved:
    """Values of parameters, and the origin of each value."""

    values: dict[str, Any] = field(default_factory=dict)
    origins: dict[str, str] = field(default_factory=dict)

    def set_value(self, name: str, value: Any, origin: str) -> None:
        """Set a value, overriding an earlier one."""
        self.values[name], self.origins[name] = value, origin

    def changed(self, name: str) -> bool:
        """Return whether the value comes from a condition or the command line, not from the default."""
        return not self.origins[name].startswith("line ")


@dataclass
class Substituted(Document):
    """A protocol file with its parameters replaced; a fault at a replaced value names the parameter and its origin."""

    uses: dict[Location, str] = field(default_factory=dict)  # text on the parameter and its origin, by location
    changed: set[Location] = field(default_factory=set)  # locations whose value is not the default
    changed_below: dict[Location, list[str]] = field(default_factory=dict)  # changed parameters below a location

    def record_use(self, location: Location, text: str, changed: bool) -> None:
        """Record that a value at this location comes from a parameter; `text` names it and its origin."""
        self.uses[location] = text
        if changed:
            self.changed.add(location)
            for length in range(2, len(location)):
                self.changed_below.setdefault(location[:length], []).append(text)

    def fault(self, location: Sequence[str | int], message: str) -> str:
        """Return the line for a fault, with the parameter from which the value comes."""
        keys = tuple(location)
        ancestors = [keys[:length] for length in range(len(keys), 0, -1)]
        parameters = next(
            ([self.uses[ancestor]] for ancestor in ancestors if ancestor in self.uses), self.changed_below.get(keys, [])
        )
        line = super().fault(location, message)
        return line + printable(f" ({', '.join(dict.fromkeys(parameters))})" if parameters else "")

    def explain(self, error: "ValidationError", under: Location = ()) -> list[str]:
        """Return the faults of a model, without those at a `$name` that is already reported as unknown."""
        return [line for line in super().explain(error, under) if not line.endswith(f"{UNKNOWN_TEXT})")]


def resolve(document: Document, overrides: Mapping[str, str], condition: str, faults: list[str]) -> Resolved | None:
    """Resolve defaults, condition and overrides, and add faults; None if `parameters` is not a mapping.

    Parameters
    ----------
    overrides : texts by parameter, from the command line.
    condition : label of the condition whose values apply; the values of all conditions are checked.
    """
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
        elif name in RESERVED_NAMES:
            faults.append(document.fault(("parameters", name), f"another name was expected: {RESERVED_NAMES[name]}"))
        elif _kind(value) is None:
            faults.append(document.fault(("parameters", name), f"{shown(value)}: {EXPECTED_VALUES}"))
        resolved.set_value(name, value, f"line {document.places['parameters', name][0]}")
    default_values = dict(resolved.values)
    if not isinstance(conditions, Mapping | None):
        faults.append(document.fault(("conditions",), "a mapping of labels to parameters was expected"))
        conditions = None
    for label, values in (conditions or {}).items():
        _apply_condition(document, label, values, default_values, resolved if label == condition else None, faults)
    for name, text in overrides.items():
        _apply_override(name, text, default_values, resolved, faults)
    return resolved


def _apply_condition(
    document: Document,
    label: str,
    values: Any,
    defaults: Mapping[str, Any],
    resolved: Resolved | None,
    faults: list[str],
) -> None:
    """Check the values of a condition against the defaults; if `resolved` is not None, set them there."""
    keys = ("conditions", label)
    if not isinstance(values, Mapping):
        faults.append(document.fault(keys, "a mapping of parameters to values was expected"))
        return
    for name, value in values.items():
        message = _reason_against(name, value, defaults)
        if message:
            faults.append(document.fault((*keys, name), message))
        elif resolved is not None:
            resolved.set_value(name, value, f"condition {label}, line {document.places[*keys, name][0]}")


def _apply_override(name: str, text: str, defaults: Mapping[str, Any], resolved: Resolved, faults: list[str]) -> None:
    """Check a value of the command line against its default and set it; if it does not fit, add a fault."""
    origin = f"--set {name}={text}"
    try:
        value = yamlfile.parse(text, f"--set {name}").data if text.startswith("[") else yamlfile.scalar(text)
    except InputError as error:
        faults.extend(error.faults)
        return
    message = _reason_against(name, value, defaults)
    if message:
        faults.append(f"{origin}: {message}")
    else:
        resolved.set_value(name, value, origin)


def _reason_against(name: str, value: Any, defaults: Mapping[str, Any]) -> str:
    """Return the reason why a value cannot override a default; empty if it can."""
    if name not in defaults:
        return f"no such parameter; known: {', '.join(defaults) or 'none'}"
    actual_kind, expected_kind = _kind(value), _kind(defaults[name])
    if expected_kind is None:
        return ""  # the fault of the default is already reported
    if actual_kind != expected_kind:
        return f"{shown(value)}: a {expected_kind} was expected, as in the default {shown(defaults[name])}"
    return ""


def _kind(value: Any) -> str | None:
    """Return the kind of a parameter's value, as in messages; None if no parameter may have such a value."""
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
    """Replace every `$name` of a document; an unknown name is a fault at its location."""
    filled = Substituted(document.name, document.text, None, dict(document.places))

    def substituted(value: Any, keys: Location) -> Any:
        """Return a value with every `$name` in it replaced."""
        if isinstance(value, dict):
            return {key: substituted(item, (*keys, key)) for key, item in value.items()}
        if isinstance(value, list):
            return [substituted(item, (*keys, index)) for index, item in enumerate(value)]
        reference = REFERENCE.match(value) if isinstance(value, str) else None
        if reference is None or resolved is None:
            return value
        name = reference[1]
        if name not in resolved.values:
            known_text = ", ".join(f"${parameter}" for parameter in resolved.values) or "none"
            faults.append(document.fault(keys, f"{value}: no such parameter; known: {known_text}"))
            filled.record_use(keys, f"{value} {UNKNOWN_TEXT}", changed=False)
            return value
        filled.record_use(keys, f"{value} from {resolved.origins[name]}", resolved.changed(name))
        return resolved.values[name]

    filled.data = {
        key: value if key in LITERAL_KEYS else substituted(value, (key,)) for key, value in document.data.items()
    }
    return filled


def unused(document: Document) -> list[str]:
    """Return a line for each parameter that a protocol file defines and does not use."""

    def references_in(value: Any) -> set[str]:
        """Return the names of the parameters that a value refers to."""
        if isinstance(value, dict | list):
            items = value.values() if isinstance(value, dict) else value
            return {name for item in items for name in references_in(item)}
        reference = REFERENCE.match(value) if isinstance(value, str) else None
        return {reference[1]} if reference else set()

    used_names = references_in({key: value for key, value in document.data.items() if key not in LITERAL_KEYS})
    return [
        document.fault(("parameters", name), f"${name} stands nowhere in the file: to set it changes nothing")
        for name in document.data.get("parameters") or ()
        if name not in used_names
    ]
