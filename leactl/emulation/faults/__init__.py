"""Faults that an emulated bench rehearses: each a module of this package, found by listing it.

A module defines one subclass of `Fault` whose fields are its parameters. Adding a fault adds a file here and edits
nothing else.
"""

import importlib
import inspect
import pkgutil
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from leactl.errors import InputError

if TYPE_CHECKING:
    from leactl.bench.benchfile import BenchFile, CheckedDevice
    from leactl.emulation.faults.contract import Fault
    from leactl.yamlfile import Document


def known_faults() -> "dict[str, type[Fault]]":
    """Every fault by the name of its module."""
    from leactl.emulation.faults.contract import Fault

    faults: dict[str, type[Fault]] = {}
    for entry in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{entry.name}")
        for thing in vars(module).values():
            own = isinstance(thing, type) and thing.__module__ == module.__name__
            if own and issubclass(thing, Fault) and not inspect.isabstract(thing):
                faults[entry.name] = thing
    return faults


def find_fault(name: str) -> "type[Fault]":
    """One fault by name.

    Raises
    ------
    InputError : no such fault; the known ones are named.
    """
    known = known_faults()
    if name not in known:
        raise InputError(f"fault '{name}' is not known; known: {', '.join(sorted(known))}")
    return known[name]


def make_fault(entry: Mapping[str, Any]) -> "Fault":
    """Make a fault from its entry in a bench file.

    Raises
    ------
    InputError : no such fault, or none is named.
    ValidationError : its parameters are not what it takes.
    """
    if "fault" not in entry:
        raise InputError("is required and missing")
    return find_fault(str(entry.get("fault"))).model_validate(entry)


def check_faults(file: "BenchFile", devices: "Sequence[CheckedDevice]", document: "Document") -> None:
    """Check the faults of a bench file against the bench, which its own checks cannot: they know no emulator.

    Raises
    ------
    InputError : one line for each that cannot be rehearsed, with its place in the file.
    """
    if file.emulated is None or not file.emulated.faults:
        return
    from leactl.emulation.faults.contract import PlannedBench

    standing = PlannedBench(file, {device.name: device for device in devices})
    lines: list[str] = []
    for index, entry in enumerate(file.emulated.faults):
        place = ("emulated", "faults", index)
        try:
            misfits = make_fault(entry).misfits(standing)
        except InputError as error:
            misfits = {"fault": str(error)}
        except ValidationError as error:
            lines += document.explain(error, place)
            continue
        lines += [document.fault((*place, key), text) for key, text in misfits.items()]
    if lines:
        raise InputError(lines)
