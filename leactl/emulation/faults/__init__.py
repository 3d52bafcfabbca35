"""Faults that an emulated bench rehearses: the concrete subclasses of `Fault` in the modules of this package.

Each has the name that bench files give it, and fields for its parameters. To add a fault, add its class to the module
of its family, or a module of its own: the package is listed, and nothing else is edited.
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
    """Map the name of each fault to its class, in the order of the names."""
    from leactl.emulation.faults.contract import Fault

    faults: dict[str, type[Fault]] = {}
    for entry in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{entry.name}")
        for member in vars(module).values():
            is_defined_here = isinstance(member, type) and member.__module__ == module.__name__
            if is_defined_here and issubclass(member, Fault) and not inspect.isabstract(member):
                faults[member.fault_name] = member
    return dict(sorted(faults.items()))


def find_fault(name: str) -> "type[Fault]":
    """Find a fault class by name.

    Raises
    ------
    InputError : no such fault; the message names the known ones.
    """
    faults = known_faults()
    if name not in faults:
        raise InputError(f"fault '{name}' is not known; known: {', '.join(sorted(faults))}")
    return faults[name]


def make_fault(entry: Mapping[str, Any]) -> "Fault":
    """Make a fault from its entry in a bench file.

    Raises
    ------
    InputError : no such fault, or the entry names none.
    ValidationError : the parameters are not those of the fault.
    """
    if "fault" not in entry:
        raise InputError("is required and missing")
    return find_fault(str(entry.get("fault"))).model_validate(entry)


def check_faults(file: "BenchFile", devices: "Sequence[CheckedDevice]", document: "Document") -> None:
    """Check that each fault of a bench file fits the bench; the bench file's own checks cannot, without emulators.

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
        lines += [document.fault((*location, key), text) for key, text in misfits.items()]
    if lines:
        raise InputError(lines)
