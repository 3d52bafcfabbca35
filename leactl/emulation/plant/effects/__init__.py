"""Effects the nominal plant does not have: each a module of this package, found by listing it.

A module defines one subclass of `PlantEffect`, a frozen dataclass whose numbers carry their range. Adding an effect
adds a file here and edits nothing else.
"""

import importlib
import pkgutil
from collections.abc import Mapping
from typing import Any

from leactl.emulation.plant.effects.contract import PlantEffect
from leactl.errors import InputError

__all__ = ["PlantEffect", "known_effects", "make_effect"]


def known_effects() -> dict[str, type[PlantEffect]]:
    """Every effect by the name of its module."""
    effects: dict[str, type[PlantEffect]] = {}
    for entry in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{entry.name}")
        for thing in vars(module).values():
            own = isinstance(thing, type) and thing.__module__ == module.__name__
            if own and issubclass(thing, PlantEffect) and thing is not PlantEffect:
                effects[entry.name] = thing
    return effects


def make_effect(name: str, parameters: Mapping[str, Any] | None = None) -> PlantEffect:
    """Make an effect by name.

    Raises
    ------
    InputError : no such effect (the known ones are named), or parameters it cannot take.
    """
    known = known_effects()
    if name not in known:
        raise InputError(f"effect {name!r} is unknown; known are {', '.join(sorted(known))}")
    try:
        return known[name].from_mapping(parameters or {})
    except InputError as error:
        raise InputError([f"effect {name}: {fault}" for fault in error.faults]) from error
