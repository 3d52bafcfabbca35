"""Build the bench that a model describes, for simulation."""

from leactl.effects import library
from leactl.effects.plant import Plant, plant_without_effects
from leactl.errors import InputError
from leactl.model.nominal import EffectEntry, Model
from leactl.vocabulary.effect import effect_definition


def plant_of(model: Model) -> Plant:
    """Return the bench that a model describes, with its effects.

    Raises
    ------
    InputError : an effect lacks a parameter; one line for each.
    """
    if faults := [fault for entry in model.effects for fault in _missing_parameters(model, entry)]:
        raise InputError(faults)
    plant = plant_without_effects(model)
    for entry in model.effects:
        library()[entry.effect].act(entry.parameters, plant)
    return plant


def _missing_parameters(model: Model, entry: EffectEntry) -> list[str]:
    """Return one message for each parameter without a default that an effect of a model lacks."""
    missing = [
        name
        for name, definition in effect_definition(entry.effect).parameters.items()
        if name not in entry.parameters and definition.default is None
    ]
    return [
        f"model {model.name}: effect {entry.effect} has no '{name}'; `leactl gap effects {entry.effect}` explains it"
        for name in missing
    ]
