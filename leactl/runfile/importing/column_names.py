"""Read quantity, role and unit from the name of a column, such as `motor_current_A` or `load.velocity [rpm]`."""

import re
from collections.abc import Collection
from functools import cache
from importlib import resources
from typing import Any, Final, NamedTuple

from leactl import yamlfile
from leactl.quantities import UNITS
from leactl.tables.text_table import UNIT_IN_BRACKETS, unit_of
from leactl.units import CONVERSIONS, SECONDS, known_units

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
TIME: Final = frozenset(
    {"t", "ts", "time", "times", "timestamp", "timestamps", "stamp", "stamps", "seconds", "ms", "us", "clock"}
)
# how a mapping writes units, and how headers do; `rps` is not among them, which is rev/s to some and rad/s to others
ALIASES: Final = {
    "N*m": ("nm", "n.m", "n·m", "n m", "n*m", "newton-meter"),
    "mN*m": ("mnm", "mn.m", "mn·m"),
    "rad": ("rad", "rads", "radian", "radians"),
    "mrad": ("mrad",),
    "deg": ("deg", "degs", "degree", "degrees", "°"),
    "turn": ("turn", "turns", "rev", "revs", "rotation", "rotations"),
    "rad/s": ("rad/s", "rads", "rad_s", "radps", "rad_per_s", "rad/sec", "rad s", "radians/s"),
    "deg/s": ("deg/s", "deg_s", "degps", "dps", "deg_per_s", "°/s", "deg/sec"),
    "rpm": ("rpm", "rev/min", "1/min", "r/min", "min^-1"),
    "turn/s": (
        "turn/s",
        "rotation per second",
        "rotations per second",
        "turns/s",
        "rev/s",
        "turn_s",
        "rev_s",
        "revs/s",
        "rotations/s",
    ),
    "A": ("a", "amp", "amps", "ampere"),
    "mA": ("ma", "milliamp"),
    "V": ("v", "volt", "volts"),
    "mV": ("mv", "millivolt"),
    "degC": ("degc", "°c", "c", "celsius", "deg_c"),
    "degF": ("degf", "°f", "fahrenheit"),
    "K": ("k", "kelvin"),
    "%": ("%", "percent"),
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "millis", "milliseconds"),
    "us": ("us", "usec", "µs", "micros", "microseconds"),
    "ns": ("ns", "nsec", "nanoseconds"),
    "m": ("m", "meter", "meters"),
    "mm": ("mm",),
    "m/s": ("m/s", "meter per second", "meters per second"),
    "mm/s": ("mm/s",),
    "N": ("n", "newton"),
}
OF_ANY_SHAFT: Final = ("value", "measured", "actual", "estimate", "state", "log")
ONLY_IN_BRACKETS: Final = ("m", "N", "K")  # behind an underscore they are "measured", a count, a gain
UNITS_OF_TWO: Final = ("1/s", "s^-1", "rps")  # rad/s to some and rev/s to others: the numbers may decide
EVERY_UNIT: Final = tuple(dict.fromkeys((*ALIASES, *(units for known in CONVERSIONS.values() for units in known))))
BY_LETTERS: Final = {units.replace("*", ""): units for units in EVERY_UNIT if units not in ("1", "%")}  # in brackets
_AMPERES_OR_VOLTS: Final = re.compile(r"_m?[AV]\Z")
# `a` behind a symbol of one letter is its index: `i_a` is a phase, `iq_a` is in amperes
_LOWER_CASE: Final = re.compile(r"(?i:cur\w*|i(?:q|d|bus|dc))_a\Z|(?i:volt\w*|[uv](?:q|d|bus|dc|in))_v\Z")
_PHASES: Final = ("abc", "uvw", "ABC", "UVW")
_UNIT_SIGN: Final = re.compile(r"[/^*·°%]")


class Meaning(NamedTuple):
    """Quantity, role and unit that a name tells; a part that it does not tell is empty."""

    quantity: str
    role: str
    units: str
    why_not: str = ""  # why it is taken for no channel
    doubt: str = ""  # the unit that does not fit the quantity


@cache
def table() -> dict[str, Any]:
    """Content of `column_words.yaml`."""
    entry = resources.files("leactl.runfile.importing") / "column_words.yaml"
    words: dict[str, Any] = yamlfile.parse(entry.read_text(encoding="utf-8"), entry.name).data
    return words


def words_of(name: str) -> list[str]:
    """The words of a name in lower case: `motorSpeed_rpm` gives motor, speed, rpm."""
    return [word.lower() for word in _WORD.findall(name)]


def meaning_of(name: str, declared: str = "", siblings: Collection[str] = ()) -> Meaning:
    """Meaning of a column's name: of its part after the last dot or slash if that has a quantity, else of the whole.

    A quantity fits the unit in the name, or the one that the file declares, if any does; otherwise the meaning has a
    doubt, and no number decides what the column is. The A of `I_A` is a phase beside an `I_B` among the siblings, the
    names of the log's columns, and the ampere without one.
    """
    plain = name if is_one_of_a_set(name, siblings) else without_unit(name)
    last = re.split(r"[./]", re.sub(r"\[[^\]]*\]$", "", plain))[-1]
    whole = words_of(plain)
    if refused := [word for word in words_of(last) if word in table()["none"]]:
        return Meaning("", "", "", f"its name says {refused[0]}")
    said = declared if declared in EVERY_UNIT else units_of(name, list(EVERY_UNIT))
    rule = rule_of(words_of(last), name, said) or rule_of(whole, name, said)
    if rule is not None and "left_out" in rule:
        return Meaning("", "", "", f"its name says {rule['left_out']}")
    quantity = str(rule["quantity"]) if rule is not None else ""
    if not quantity:
        quantity = next((kind for kind in ("angle", "velocity", "torque") if units_of(name, known_units(kind))), "")
    if not quantity:
        return Meaning("", "", units_of(name, list(SECONDS)), "its name says nothing known")
    doubt = "" if fits(name, said, quantity) else f"yet its unit is {said}"
    if not said and (text := unknown_unit(name)):
        doubt = f"yet its unit is {text}, which is not known"
    if any(word in table()["setpoint"] for word in whole) and f"{quantity}_reference" in UNITS:
        quantity = f"{quantity}_reference"
    role = next((role for role in ("load", "bench") if any(word in table()[role] for word in whole)), "")
    return Meaning(quantity, role, units_of(name, known_units(quantity)), doubt=doubt)


def rule_of(words: list[str], name: str, said: str) -> dict[str, Any] | None:
    """The first rule that the words satisfy, if possible of a quantity that the unit fits; None if there is none."""
    satisfied = [
        rule
        for rule in table()["rules"]
        if all(any(word in group for word in words) for group in rule["all"])
        and rule.get("begins", words[:1]) in (words[:1], *words[:1])
        and (not rule.get("only_with_unit") or (said and fits(name, said, rule["quantity"])))
    ]
    fitting = [rule for rule in satisfied if fits(name, said, rule.get("quantity", ""))]
    return next(iter(fitting or satisfied), None)


def fits(name: str, said: str, quantity: str) -> bool:
    """Whether the unit of a column, if it has any, is one of a quantity; `rads` stands for rad and for rad/s."""
    return not said or not quantity or said in known_units(quantity) or bool(units_of(name, known_units(quantity)))


def is_one_of_a_set(name: str, siblings: Collection[str]) -> bool:
    """Whether a name ends in the letter of a phase and a sibling in that of another: phases come as a set."""
    letters = next((letters for letters in _PHASES if name.endswith(tuple(letters))), "")
    return any(name[:-1] + letter in siblings for letter in letters if letter != name[-1])


def unknown_unit(name: str) -> str:
    """The text in brackets at the end of a name that has a sign of units and is none that is known; else empty."""
    text = unit_of(name)
    return text if _UNIT_SIGN.search(text) and not units_in_brackets(name) and text not in UNITS_OF_TWO else ""


def without_unit(name: str) -> str:
    """A name without the unit at its end, so that the A of `motor_current_A` is not taken for a phase."""
    if units_in_brackets(name) or unknown_unit(name):
        return UNIT_IN_BRACKETS.sub("", name)
    return name[:-2] if _LOWER_CASE.search(name) else _AMPERES_OR_VOLTS.sub("", name)


def units_in_brackets(name: str) -> str:
    """The unit in brackets at the end of a name; empty if the brackets hold no unit, such as an index."""
    units = unit_of(name)
    if any(units.lower() in known for known in ALIASES.values()):
        return units
    return BY_LETTERS.get(re.sub(r"[*.· ]", "", units), "")


def units_of(name: str, known: list[str]) -> str:
    """The unit at the end of a name, in brackets or after an underscore, if it is one of `known`; else empty."""
    written = units_in_brackets(name)
    tail = re.split(r"[./]", name)[-1].split("_")
    endings = [written] if written else ["_".join(tail[-count:]) for count in (2, 1) if len(tail) > count]
    if not written and "." in name and len(tail[-1]) > 1:
        endings.append(tail[-1])  # `angle.deg`, where a letter alone is a name
    for ending in endings:
        for units, aliases in ALIASES.items():
            is_unit = written or (units not in ONLY_IN_BRACKETS and _case(name, ending, units))
            if is_unit and ending.lower() in aliases and units in known:
                return units
    if written in known:
        return written
    return words_alone(name) if words_alone(name) in known else ""


def _case(name: str, ending: str, units: str) -> bool:
    """Whether an ending of one letter has the case of its unit, since `_v` and `_a` also stand for velocity and angle.

    Behind a word for a current or a voltage they do not.
    """
    of_circuit = units == ending.upper() and _LOWER_CASE.search(name) is not None
    return len(ending) > 1 or ending == units[-1] or of_circuit


def words_alone(name: str) -> str:
    """`rpm` if it is a word of the name, which is a unit anywhere in a name; else empty."""
    return "rpm" if "rpm" in words_of(name) and "erpm" not in name.lower() else ""


def units_named(text: str) -> str:
    """The unit that a text names, in the spelling of a mapping; empty if it names none."""
    return next((units for units, aliases in ALIASES.items() if text.strip().lower() in aliases), "")


def shaft_of(name: str) -> frozenset[str]:
    """The words of a name without those of quantity, setpoint and unit: they identify the shaft."""
    kinds = [rule["all"] for rule in table()["rules"] if "left_out" not in rule]
    other_words = {word for groups in kinds for group in groups for word in group}
    other_words |= {
        *table()["setpoint"],
        "value",
        "measured",
        "actual",
        *(alias for known in ALIASES.values() for alias in known),
    }
    return frozenset(words_of(name)) - other_words


def is_time(name: str) -> bool:
    """Whether a name is that of a column of stamps."""
    words = words_of(re.split(r"[./]", name)[-1])
    return bool(words) and words[0] in TIME
