"""Effects outside the vocabulary, for cases whose honest answer is `unknown`; no diagnosis may name them.

Each file defines one subclass of `PlantEffect` with `drawn`, which makes one of a size between hardly seen (0) and
plain to see (1).
"""

import importlib
import pkgutil
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from leactl.emulation.plant.effects_outside_library.drawn import Unlisted


def unlisted_effects() -> "dict[str, type[Unlisted]]":
    """Every effect of this room by the name of its file."""
    from leactl.emulation.plant.effects_outside_library.drawn import Unlisted

    effects: dict[str, type[Unlisted]] = {}
    for entry in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{entry.name}")
        for thing in vars(module).values():
            if isinstance(thing, type) and issubclass(thing, Unlisted) and thing.__module__ == module.__name__:
                effects[entry.name] = thing
    effects.pop("drawn")
    return effects
