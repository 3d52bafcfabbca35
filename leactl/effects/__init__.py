"""The effect library: what a nominal model may lack, as equations for diagnosis and simulation, one file per effect.

Adding an effect adds a file here and its definition in `leactl/vocabulary/effects`; nothing else is edited. Another
package adds one by an entry point `leactl.effects` that names its module, with `NAME.yaml` beside that.
"""

import importlib
import pkgutil
from functools import cache

from leactl.effects.contract import Effect
from leactl.errors import InputError
from leactl.vocabulary.effect import definition_file, effect_names, modules_of_others


@cache
def library() -> dict[str, Effect]:
    """Return every effect by its name, sorted.

    Raises
    ------
    InputError : an effect has a form and no definition, or a definition and no form; the missing file is named.
    """
    effects: dict[str, Effect] = {}
    modules = [f"{__name__}.{entry.name}" for entry in pkgutil.iter_modules(__path__)]
    for name in (*modules, *modules_of_others().values()):
        module = importlib.import_module(name)
        for member in vars(module).values():
            defined_here = isinstance(member, type) and member.__module__ == module.__name__
            if defined_here and issubclass(member, Effect) and hasattr(member, "name"):
                effects[member.name] = member()
    defined_names = set(effect_names())
    without_definition = [
        f"{definition_file(name)}: is missing; it defines effect {name}" for name in set(effects) - defined_names
    ]
    module_files = {
        name: modules_of_others().get(name, f"leactl/effects/{name}.py") for name in defined_names - set(effects)
    }
    without_class = [f"{module_file}: no class of effect {name} is there" for name, module_file in module_files.items()]
    if without_definition or without_class:
        raise InputError(sorted(without_definition + without_class))
    return dict(sorted(effects.items()))
