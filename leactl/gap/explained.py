"""What an effect is: its equation, where it shows, what it is taken for, which experiment shows it, its parameters."""

import inspect
import sys
from typing import Any

from leactl.effects import library
from leactl.vocabulary.effect import effect_definition


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
