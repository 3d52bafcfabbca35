"""What an effect is: its equation, where it shows, what it is taken for, which experiment shows it, its parameters."""

import inspect
import sys
from typing import Any

from leactl.effects import library
from leactl.vocabulary.effect import effect_definition, effect_names


def explained(name: str) -> dict[str, Any]:
    """Everything that is known of one effect.

    Raises
    ------
    InputError : no such effect; the known ones are named.
    """
    definition = effect_definition(name)
    return {
        "effect": name,
        "meaning": definition.meaning,
        "equation": equation(name),
        "shows_in": definition.shows_in,
        "confused_with": definition.confused_with,
        "shown_by": definition.shown_by,
        "parameters": [{"name": key, **item.model_dump()} for key, item in definition.parameters.items()],
    }


def equation(name: str) -> str:
    """The form that diagnosis and simulation give an effect: the first words of its file."""
    module = sys.modules[type(library()[name]).__module__]
    return " ".join((inspect.getdoc(module) or "").split())


def as_text(name: str) -> str:
    """The same to read."""
    about = explained(name)
    keys = ("equation", "shows_in", "confused_with", "shown_by")
    rows = [(key.replace("_", " "), about[key]) for key in keys]
    for item in about["parameters"]:
        rest = f", by default {item['default']:g}" if item.get("default") is not None else ""
        units = "" if item["units"] == "1" else f" {item['units']}"
        rows.append((item["name"], f"{item['meaning']} [{item['low']:g} to {item['high']:g}{units}{rest}]"))
    width = max(len(title) for title, _ in rows)
    return "\n".join([f"{name}: {about['meaning']}", *(f"  {title:<{width}}  {text}" for title, text in rows)])


def overview() -> str:
    """Every effect in a line."""
    width = max(map(len, effect_names()))
    return "\n".join(f"{name:<{width}}  {effect_definition(name).meaning}" for name in effect_names())
