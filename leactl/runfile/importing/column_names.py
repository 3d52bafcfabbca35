"""Read quantity, role and unit from the name of a column, such as `motor_current_A` or `load.velocity [rpm]`."""

import re
from functools import cache
from importlib import resources
from typing import Any, Final, NamedTuple

from leactl import yamlfile
from leactl.quantities import UNITS
from leactl.tables.text_table import UNIT_IN_BRACKETS, unit_of
from leactl.units import SECONDS, known_units

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
TIME: Final = frozenset({"t", "time", "timestamp", "stamp", "seconds", "ms", "us", "clock"})
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


class Meaning(NamedTuple):
    """Quantity, role and unit that a name tells; a part that it does not tell is empty."""

    quantity: str
    role: str
    units: str
    why_not: str = ""  # why it is taken for no channel


@cache
def table() -> dict[str, Any]:
    """Content of `column_words.yaml`."""
    entry = resources.files("leactl.runfile.importing") / "column_words.yaml"
    words: dict[str, Any] = yamlfile.parse(entry.read_text(encoding="utf-8"), entry.name).data
    return words


def words_of(name: str) -> list[str]:
    """The words of a name in lower case: `motorSpeed_rpm` gives motor, speed, rpm."""
    return [word.lower() for word in _WORD.findall(name)]


def meaning_of(name: str) -> Meaning:
    """Meaning of a column's name: of its part after the last dot or slash if that has a quantity, else of the whole."""
    plain = UNIT_IN_BRACKETS.sub("", name) if units_in_brackets(name) else name
    last = re.split(r"[./]", re.sub(r"\[[^\]]*\]$", "", plain))[-1]
    whole = words_of(plain)
    if refused := [word for word in words_of(last) if word in table()["none"]]:
        return Meaning("", "", "", f"its name says {refused[0]}")
    quantity = quantity_of(words_of(last)) or quantity_of(whole)
    if not quantity:
        quantity = next((kind for kind in ("angle", "velocity", "torque") if units_of(name, known_units(kind))), "")
    if not quantity:
        return Meaning("", "", units_of(name, list(SECONDS)), "its name says nothing known")
    if any(word in table()["setpoint"] for word in whole) and f"{quantity}_reference" in UNITS:
        quantity = f"{quantity}_reference"
    role = next((role for role in ("load", "bench") if any(word in table()[role] for word in whole)), "")
    return Meaning(quantity, role, units_of(name, known_units(quantity)))


def quantity_of(words: list[str]) -> str:
    """Quantity of the first rule that the words satisfy; empty if there is none."""
    for rule in table()["rules"]:
        if all(any(word in group for word in words) for group in rule["all"]):
            return str(rule["quantity"])
    return ""


def units_in_brackets(name: str) -> str:
    """The unit in brackets at the end of a name; empty if the brackets hold no unit, such as an index."""
    units = unit_of(name)
    return units if any(units.lower() in known for known in ALIASES.values()) else ""


def units_of(name: str, known: list[str]) -> str:
    """The unit at the end of a name, in brackets or after an underscore, if it is one of `known`; else empty."""
    written = units_in_brackets(name)
    tail = re.split(r"[./]", name)[-1].split("_")
    endings = [written] if written else ["_".join(tail[-count:]) for count in (2, 1) if len(tail) > count]
    if not written and "." in name and len(tail[-1]) > 1:
        endings.append(tail[-1])  # `angle.deg`, where a letter alone is a name
    for ending in endings:
        for units, aliases in ALIASES.items():
            is_unit = written or (units not in ONLY_IN_BRACKETS and _case(ending, units))
            if is_unit and ending.lower() in aliases and units in known:
                return units
    return words_alone(name) if words_alone(name) in known else ""


def _case(ending: str, units: str) -> bool:
    """Whether a one-letter ending has the case of the unit; `_v` and `_a` also stand for velocity and angle."""
    return len(ending) > 1 or ending == units[-1]


def words_alone(name: str) -> str:
    """`rpm` if it is a word of the name, which is a unit anywhere in a name; else empty."""
    return "rpm" if "rpm" in words_of(name) and "erpm" not in name.lower() else ""


def units_named(text: str) -> str:
    """The unit that a text names, in the spelling of a mapping; empty if it names none."""
    return next((units for units, aliases in ALIASES.items() if text.strip().lower() in aliases), "")


def shaft_of(name: str) -> frozenset[str]:
    """The words of a name without those of quantity, setpoint and unit: they identify the shaft."""
    other_words = {word for rule in table()["rules"] for group in rule["all"] for word in group}
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
