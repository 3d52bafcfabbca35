"""Effects that the nominal plant does not have: the subclasses of `PlantEffect` in the modules of this package.

Each is a frozen dataclass whose fields have ranges; `PlantBusSag` is the effect `bus_sag`. To add an effect, add its
class to the module of its family or to a new module of this package: `known_effects` finds it.
"""

import importlib
import pkgutil
from collections.abc import Mapping
from typing import Any

from leactl.emulation.plant.effects.contract import PlantEffect
from leactl.errors import InputError

__all__ = ["PlantEffect", "known_effects", "make_effect"]


def known_effects() -> dict[str, type[PlantEffect]]:
    """Return the class of each effect by its name, in the order of the names."""
    effects: dict[str, type[PlantEffect]] = {}
    for module_info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{module_info.name}")
        for member in vars(module).values():
            is_defined_here = isinstance(member, type) and member.__module__ == module.__name__
            if is_defined_here and issubclass(member, PlantEffect) and member is not PlantEffect:
                effects[member.effect_name()] = member
    return dict(sorted(effects.items()))


def make_effect(name: str, parameters: Mapping[str, Any] | None = None) -> PlantEffect:
    """Make an effect by name.

    Raises
    ------
    InputError : no such effect (the message names the known ones), or parameters that it cannot take.
    """
    effects = known_effects()
    if name not in effects:
        raise InputError(f"effect {name!r} is unknown; known are {', '.join(sorted(effects))}")
    try:
        return effects[name].from_mapping(parameters or {})
    except InputError as error:
        raise InputError([f"effect {name}: {fault}" for fault in error.faults]) from error
