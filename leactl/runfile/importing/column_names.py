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
# spellings of units in headers, by the spelling in a mapping; `rps` is absent, since it may be rev/s or rad/s
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
    "us": ("us", "usec", "\u00b5s", "\u03bcs", "micros", "microseconds"),
    "ns": ("ns", "nsec", "nanoseconds"),
    "min": ("min", "mins", "minute", "minutes"),
    "h": ("h", "hr", "hrs", "hour", "hours"),
    "m": ("m", "meter", "meters"),
    "mm": ("mm",),
    "m/s": ("m/s", "meter per second", "meters per second"),
    "mm/s": ("mm/s",),
    "N": ("n", "newton"),
}
# after an underscore, these mean "measured", a count, a gain, the lowest one and a height, but of a time a unit
ONLY_IN_BRACKETS: Final = ("m", "N", "K", "min", "h")
AMBIGUOUS_UNITS: Final = ("1/s", "s^-1", "rps")  # ambiguous between rad/s and rev/s: the numbers may decide
EVERY_UNIT: Final = tuple(dict.fromkeys((*ALIASES, *(units for known in CONVERSIONS.values() for units in known))))
# unit by its spelling without `*`, for brackets at the end of a header
UNITS_BY_LETTERS: Final = {units.replace("*", ""): units for units in EVERY_UNIT if units not in ("1", "%")}
_AMPERES_OR_VOLTS: Final = re.compile(r"_m?[AV]\Z")
# `a` after a symbol of one letter is its index: `i_a` is a phase current, `iq_a` is in amperes
_LOWER_CASE_UNIT: Final = re.compile(r"(?i:cur\w*|i(?:q|d|bus|dc))_a\Z|(?i:volt\w*|[uv](?:q|d|bus|dc|in))_v\Z")
_PHASES: Final = ("abc", "uvw", "ABC", "UVW")
_UNIT_SIGN: Final = re.compile(r"[/^*·°%]")
_PREFIXED_UNIT: Final = re.compile(r"(?:[nu\u00b5\u03bcmcdkM])?(?:A|V|Nm|rad|deg|m|N)")
_RMS_OR_PEAK: Final = re.compile(r"[um\u00b5\u03bck]?[AV][ _.-]?(?:rms|eff|pk|peak|p|pp|pk-pk)", re.IGNORECASE)


class Meaning(NamedTuple):
    """Quantity, role and unit by a column's name; empty where the name does not contain them."""

    quantity: str
    role: str
    units: str
    why_not: str = ""  # reason why the column is not a channel
    doubt: str = ""  # text on a unit that does not fit the quantity


@cache
def word_table() -> dict[str, Any]:
    """Read `column_words.yaml`."""
    entry = resources.files("leactl.runfile.importing") / "column_words.yaml"
    words: dict[str, Any] = yamlfile.parse(entry.read_text(encoding="utf-8"), entry.name).data
    return words


def words_of(name: str) -> list[str]:
    """Split a name into its words in lower case: `motorSpeed_rpm` gives motor, speed, rpm."""
    return [word.lower() for word in _WORD.findall(name)]


def meaning_of(name: str, declared: str = "", siblings: Collection[str] = ()) -> Meaning:
    """Read the meaning of a column's name, from its part after the last dot or slash if that has a quantity.

    If no quantity fits the unit that the name has or the file declares, the meaning has a doubt, and values do not
    decide the unit. The A of `I_A` is a phase if `siblings` has an `I_B`, and else the ampere.

    Parameters
    ----------
    declared : unit that the file declares.
    siblings : names of the log's columns.
    """
    name_without_unit = name if is_one_of_phases(name, siblings) else without_unit(name)
    last_part = re.split(r"[./]", re.sub(r"\[[^\]]*\]$", "", name_without_unit))[-1]
    words = words_of(name_without_unit)
    if excluded_words := [word for word in words_of(last_part) if word in word_table()["none"]]:
        return Meaning("", "", "", f"its name says {excluded_words[0]}")
    if _RMS_OR_PEAK.fullmatch(unit_of(name)):
        return Meaning("", "", "", "its unit is that of an r.m.s. or peak value")
    units = declared if declared in EVERY_UNIT else units_of(name, list(EVERY_UNIT))
    rule = rule_of(words_of(last_part), name, units) or rule_of(words, name, units)
    if rule is not None and "left_out" in rule:
        return Meaning("", "", "", f"its name says {rule['left_out']}")
    quantity = str(rule["quantity"]) if rule is not None else ""
    if not quantity:
        quantity = next((kind for kind in ("angle", "velocity", "torque") if units_of(name, known_units(kind))), "")
    if not quantity:
        return Meaning("", "", units_of(name, list(SECONDS)), "its name says nothing known")
    doubt = "" if fits(name, units, quantity) else f"yet its unit is {units}"
    if not units and (text := unknown_unit(name)):
        doubt = f"yet its unit is {text}, which is not known"
    if any(word in word_table()["setpoint"] for word in words) and f"{quantity}_reference" in UNITS:
        quantity = f"{quantity}_reference"
    role = next((role for role in ("load", "bench") if any(word in word_table()[role] for word in words)), "")
    return Meaning(quantity, role, units_of(name, known_units(quantity)), doubt=doubt)


def rule_of(words: list[str], name: str, units: str) -> dict[str, Any] | None:
    """Return the first rule that the words satisfy, preferably one whose quantity has the unit, or None."""
    satisfied = [
        rule
        for rule in word_table()["rules"]
        if all(any(word in group for word in words) for group in rule["all"])
        and rule.get("begins", words[:1]) in (words[:1], *words[:1])
        and (not rule.get("only_with_unit") or (units and fits(name, units, rule["quantity"])))
    ]
    fitting = [rule for rule in satisfied if fits(name, units, rule.get("quantity", ""))]
    return next(iter(fitting or satisfied), None)


def fits(name: str, units: str, quantity: str) -> bool:
    """Return whether a column's unit, if it has any, is one of a quantity; `rads` stands for rad and for rad/s."""
    return not units or not quantity or units in known_units(quantity) or bool(units_of(name, known_units(quantity)))


def is_one_of_phases(name: str, siblings: Collection[str]) -> bool:
    """Return whether a name ends in the letter of a phase, and a sibling of the same name in that of another phase."""
    letters = next((letters for letters in _PHASES if name.endswith(tuple(letters))), "")
    return any(name[:-1] + letter in siblings for letter in letters if letter != name[-1])


def unknown_unit(name: str) -> str:
    """Return the text in brackets at the end of a name if it looks like an unknown unit; else empty."""
    unit = unit_of(name)
    looks_like_a_unit = _UNIT_SIGN.search(unit) or _PREFIXED_UNIT.fullmatch(unit)
    return unit if looks_like_a_unit and not units_in_brackets(name) and unit not in AMBIGUOUS_UNITS else ""


def without_unit(name: str) -> str:
    """Return a name without the unit at its end, so that the A of `motor_current_A` is not taken for a phase."""
    if units_in_brackets(name) or unknown_unit(name):
        return UNIT_IN_BRACKETS.sub("", name)
    return name[:-2] if _LOWER_CASE_UNIT.search(name) else _AMPERES_OR_VOLTS.sub("", name)


def units_in_brackets(name: str) -> str:
    """Return the unit in brackets at the end of a name; empty if the brackets contain no unit, such as an index."""
    units = unit_of(name)
    if any(units.lower() in aliases for aliases in ALIASES.values()):
        return units
    return UNITS_BY_LETTERS.get(re.sub(r"[*.· ]", "", units), "")


def units_of(name: str, candidates: list[str]) -> str:
    """Return the unit at the end of a name, in brackets or after an underscore, if it is a candidate; else empty."""
    bracketed = units_in_brackets(name)
    words = re.split(r"[./]", name)[-1].split("_")
    endings = [bracketed] if bracketed else ["_".join(words[-count:]) for count in (2, 1) if len(words) > count]
    if not bracketed and "." in name and len(words[-1]) > 1:
        endings.append(words[-1])  # `angle.deg`, where a letter alone is a name
    for ending in endings:
        for units, aliases in ALIASES.items():
            is_allowed = units not in ONLY_IN_BRACKETS or (units in SECONDS and is_time(name))
            is_unit = bracketed or (is_allowed and _case_fits(name, ending, units))
            if is_unit and ending.lower() in aliases and units in candidates:
                return units
    if bracketed in candidates:
        return bracketed
    return rpm_in_words(name) if rpm_in_words(name) in candidates else ""


def _case_fits(name: str, ending: str, units: str) -> bool:
    """Return whether an ending of one letter has the case of its unit, since `_v` and `_a` may be velocity and angle.

    After a word for a current or a voltage, the lower-case letter is the unit too.
    """
    follows_circuit_word = units == ending.upper() and _LOWER_CASE_UNIT.search(name) is not None
    return len(ending) > 1 or ending == units[-1] or follows_circuit_word


def rpm_in_words(name: str) -> str:
    """Return `rpm` if it is a word of the name at any position; else empty."""
    return "rpm" if "rpm" in words_of(name) and "erpm" not in name.lower() else ""


def units_named(text: str) -> str:
    """Return the unit that a text names, in the spelling of a mapping; empty if it names none."""
    return next((units for units, aliases in ALIASES.items() if text.strip().lower() in aliases), "")


def shaft_of(name: str) -> frozenset[str]:
    """Return the words of a name without those of quantity, setpoint and unit; they identify the shaft."""
    word_groups = [rule["all"] for rule in word_table()["rules"] if "left_out" not in rule]
    words_of_meaning = {word for groups in word_groups for group in groups for word in group}
    words_of_meaning |= {
        *word_table()["setpoint"],
        "value",
        "measured",
        "actual",
        *(alias for aliases in ALIASES.values() for alias in aliases),
    }
    return frozenset(words_of(name)) - words_of_meaning


def is_time(name: str) -> bool:
    """Return whether a name is that of a column of stamps."""
    words = words_of(re.split(r"[./]", name)[-1])
    return bool(words) and words[0] in TIME
