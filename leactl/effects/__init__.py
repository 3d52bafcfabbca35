"""The effect library: what a nominal model may lack, as equations for diagnosis and simulation, one file per effect.

Adding an effect adds a file here and its definition in `leactl/vocabulary/effects`; nothing else is edited.
"""

import importlib
import pkgutil
from functools import cache

from leactl.effects.contract import Effect


@cache
def library() -> dict[str, Effect]:
    """Every effect by its name, sorted."""
    found: dict[str, Effect] = {}
    for entry in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{entry.name}")
        for thing in vars(module).values():
            own = isinstance(thing, type) and thing.__module__ == module.__name__
            if own and issubclass(thing, Effect) and hasattr(thing, "name"):
                found[thing.name] = thing()
    return dict(sorted(found.items()))
