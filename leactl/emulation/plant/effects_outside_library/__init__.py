"""Effects that are not in the vocabulary, for cases whose correct answer is `unknown`; no diagnosis may name them.

Each is a subclass of `Unlisted`, whose method `drawn` makes one with a size between barely visible (0) and obvious (1).
"""

import importlib
import pkgutil
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from leactl.emulation.plant.effects_outside_library.drawn import Unlisted


def unlisted_effects() -> "dict[str, type[Unlisted]]":
    """Return the class of each effect by its name, in the order of the names."""
    from leactl.emulation.plant.effects_outside_library.drawn import Unlisted

    effects: dict[str, type[Unlisted]] = {}
    for module_info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{module_info.name}")
        for member in vars(module).values():
            if isinstance(member, type) and issubclass(member, Unlisted) and member.__module__ == module.__name__:
                effects[member.effect_name()] = member
    effects.pop(Unlisted.effect_name())
    return dict(sorted(effects.items()))
