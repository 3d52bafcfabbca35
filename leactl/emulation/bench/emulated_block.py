"""Make the parameters and effects of a bench file's `emulated:` block; report every fault with its position.

The check makes the same objects as a run does, so that both accept and refuse the same blocks.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from functools import partial
from typing import Any

from leactl.bench.benchfile import BenchFile, CheckedDevice
from leactl.emulation.faults import check_faults
from leactl.emulation.plant.effects import make_effect
from leactl.emulation.plant.effects.contract import PlantEffect
from leactl.emulation.plant.parameters import ActuatorParameters, BenchParameters
from leactl.errors import InputError
from leactl.model.motor import load_motor
from leactl.yamlfile import Document, Location


def actuator_of(file: BenchFile, role: str, changes: Mapping[str, Any]) -> ActuatorParameters:
    """Return the parameters of an emulated actuator: those of its motor file, with `changes` of the bench file.

    Raises
    ------
    InputError : a motor or a parameter is not known, or a parameter is out of its range.
    """
    motors = dict(file.motors)
    if file.emulated is not None:
        motors |= file.emulated.motors
    motor, _document = load_motor(motors["test"] if role == "test" else motors.get("load", motors["test"]))
    motor_parameters = motor.model_dump(include={parameter.name for parameter in fields(ActuatorParameters)})
    return ActuatorParameters.from_mapping(merge_parameters(motor_parameters, changes))


def merge_parameters(parameters: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters with `changes`; a nested mapping such as `thermal` keeps the values that are not changed."""
    merged_mappings = {
        name: {**parameters[name], **value}
        for name, value in changes.items()
        if isinstance(value, Mapping) and isinstance(parameters.get(name), Mapping)
    }
    return {**parameters, **changes, **merged_mappings}


def effect_of(entry: Mapping[str, Any]) -> PlantEffect:
    """Make an effect from its entry in a bench file, or from a model file's form `{effect: id, parameters: {...}}`.

    Raises
    ------
    InputError : an effect or a parameter is not known, or a value is out of its range.
    """
    if "effect" not in entry:
        return make_effect(str(entry.get("name")), {key: value for key, value in entry.items() if key != "name"})
    unknown_keys = [key for key in entry if key not in ("effect", "parameters")]
    if unknown_keys:
        raise InputError(f"{unknown_keys[0]}: unknown key; effect and parameters were expected")
    parameters = entry.get("parameters") or {}
    if not isinstance(parameters, Mapping):
        raise InputError(f"parameters: found {parameters!r}, expected values by name")
    return make_effect(str(entry["effect"]), parameters)


def check_emulated(file: BenchFile, devices: Sequence[CheckedDevice], document: Document) -> None:
    """Raise if no emulated bench can be made from the block, in any of its conditions.

    Raises
    ------
    InputError : one line for each fault, with file, line and column.
    """
    if file.emulated is None:
        return
    lines = list(_faults(file, document))
    try:
        check_faults(file, devices, document)
    except InputError as error:
        lines += error.faults
    if lines:
        raise InputError(lines)


def _faults(file: BenchFile, document: Document) -> Iterator[str]:
    """Yield the faults of actuators, conditions, bench and effects, each with its position."""
    emulated = file.emulated
    assert emulated is not None
    motor_faults = [
        fault
        for role, name in emulated.motors.items()
        for fault in _faults_of(document, ("emulated", "motors", role), partial(load_motor, name))
    ]
    if motor_faults:
        yield from motor_faults
        return
    for role, changes in (("test", emulated.test), ("load", emulated.load)):
        yield from _faults_of(document, ("emulated", role), partial(actuator_of, file, role, changes))
    for label, changes in emulated.conditions.items():
        yield from _faults_of(document, ("emulated", "conditions", label), partial(actuator_of, file, "test", changes))
    yield from _faults_of(document, ("emulated", "bench"), partial(BenchParameters.from_mapping, emulated.bench))
    for index, entry in enumerate(emulated.effects):
        yield from _faults_of(document, ("emulated", "effects", index), partial(effect_of, entry))


def _faults_of(document: Document, location: Location, make: Callable[[], object]) -> Iterator[str]:
    """Yield the faults that `make` raises, each at the key that the message names, if the document has that key."""
    try:
        make()
    except InputError as error:
        for text in error.faults:
            name, colon, message = text.partition(": ")
            path = (*location, *name.split("."))
            is_in_document = bool(colon) and path[: len(location) + 1] in document.places
            yield document.fault(path, message) if is_in_document else document.fault(location, text)
