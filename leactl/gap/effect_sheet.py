"""Sheet of an effect: its equation, its channels, similar effects, the experiment that shows it, its parameters."""

import inspect
import sys
from typing import Any

from leactl.effects import library
from leactl.vocabulary.effect import effect_definition
from leactl.vocabulary.setup_fault import setup_faults
from leactl.vocabulary.variable import VARIABLES


def effect_sheet(name: str) -> dict[str, Any]:
    """Return the description of one effect, or of one fault of a set-up.

    Raises
    ------
    InputError : no such effect; the known ones are named.
    """
    if name in setup_faults():
        return {"effect": name, "family": "setup", **setup_faults()[name].model_dump(exclude={"fault"})}
    definition = effect_definition(name)
    return {
        "effect": name,
        "family": definition.family,
        "meaning": definition.meaning,
        "equation": equation(name),
        "acts_over": [VARIABLES[variable].label for variable in definition.acts_over],
        "shown_on": list(definition.shown_on),
        "shows_in": definition.shows_in,
        "confused_with": definition.confused_with,
        "shown_by": definition.shown_by,
        "parameters": [{"name": key, **item.model_dump()} for key, item in definition.parameters.items()],
    }


def equation(name: str) -> str:
    """Return the equation of an effect: the whole docstring of its module, on one line."""
    module = sys.modules[type(library()[name]).__module__]
    return " ".join((inspect.getdoc(module) or "").split())
