"""Effects that are not in the vocabulary, for cases whose correct answer is `unknown`; no diagnosis may name them.

Each file defines one subclass of `PlantEffect` with `drawn`, which makes one with a size between barely visible (0)
and obvious (1).
"""

import importlib
import pkgutil
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from leactl.emulation.plant.effects_outside_library.drawn import Unlisted


def unlisted_effects() -> "dict[str, type[Unlisted]]":
    """Map the name of each file of this package to its effect class."""
    from leactl.emulation.plant.effects_outside_library.drawn import Unlisted

    effects: dict[str, type[Unlisted]] = {}
    for entry in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{entry.name}")
        for member in vars(module).values():
            if isinstance(member, type) and issubclass(member, Unlisted) and member.__module__ == module.__name__:
                effects[entry.name] = member
    effects.pop("drawn")
    return effects
