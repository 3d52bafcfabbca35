"""Faults that an emulated bench rehearses: the concrete subclasses of `Fault` in the modules of this package.

Each has the name that bench files give it, and fields for its parameters. To add a fault, add its class to the module
of its family or to a new module of this package: `known_faults` finds it.
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
    """Return the class of each fault by its name, in the order of the names."""
    from leactl.emulation.faults.contract import Fault

    faults: dict[str, type[Fault]] = {}
    for module_info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{module_info.name}")
        for member in vars(module).values():
            is_defined_here = isinstance(member, type) and member.__module__ == module.__name__
            if is_defined_here and issubclass(member, Fault) and not inspect.isabstract(member):
                faults[member.fault_name] = member
    return dict(sorted(faults.items()))


def find_fault(name: str) -> "type[Fault]":
    """Return the class of a fault.

    Raises
    ------
    InputError : no fault has this name.
    """
    faults = known_faults()
    if name not in faults:
        raise InputError(f"fault '{name}' is not known; known: {', '.join(sorted(faults))}")
    return faults[name]


def make_fault(entry: Mapping[str, Any]) -> "Fault":
    """Make a fault from its entry in a bench file.

    Raises
    ------
    InputError : the entry has no name of a fault, or no fault has its name.
    ValidationError : the entry's parameters are not those of the fault.
    """
    if "fault" not in entry:
        raise InputError("is required and missing")
    return find_fault(str(entry.get("fault"))).model_validate(entry)


def check_faults(file: "BenchFile", devices: "Sequence[CheckedDevice]", document: "Document") -> None:
    """Raise if a fault of a bench file does not fit the bench; the file's own checks have no emulators to know.

    Raises
    ------
    InputError : one line for each fault that cannot be rehearsed, with its position in the file.
    """
    if file.emulated is None or not file.emulated.faults:
        return
    from leactl.emulation.faults.contract import PlannedBench

    planned_bench = PlannedBench(file, {device.name: device for device in devices})
    lines: list[str] = []
    for index, entry in enumerate(file.emulated.faults):
        location = ("emulated", "faults", index)
        try:
            misfits = make_fault(entry).misfits(planned_bench)
        except InputError as error:
            misfits = {"fault": str(error)}
        except ValidationError as error:
            lines += document.explain(error, location)
            continue
        lines += [document.fault((*location, key), reason) for key, reason in misfits.items()]
    if lines:
        raise InputError(lines)
