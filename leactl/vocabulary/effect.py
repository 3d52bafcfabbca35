"""Definitions of effects, read from the files beside this one."""

import math
from functools import cache
from importlib import resources
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from leactl import yamlfile
from leactl.errors import InputError
from leactl.vocabulary.variable import Variable

STRICT = ConfigDict(frozen=True, extra="forbid")


class ParameterDefinition(BaseModel):
    """One number of an effect: units as in run files, and the range in which it is met."""

    model_config = STRICT
    units: str
    low: float
    high: float
    meaning: str
    default: float | None = None  # of a shape that may be left out


Rig = Literal["bench", "servo"]
"""The bench and what is alike, whose drives follow a current or speed; a servo that keeps its position by itself."""
DIMENSIONLESS = ("1", "rad", "share of the limit")
"""Units of parameters whose range holds for a machine of any size."""


class Size(BaseModel):
    """A size of an effect in the unit that a diagnosis measures it in."""

    model_config = STRICT
    size: float
    units: str


class EffectDefinition(BaseModel):
    """What an effect is, where it shows, what it is taken for, and which experiment shows it."""

    model_config = STRICT
    effect: str
    family: Literal["machine", "sensor", "drive", "thermal"]
    rig: Rig = "bench"  # that can show it
    meaning: str
    parameters: dict[str, ParameterDefinition]
    acts_over: tuple[Variable, ...] = Field(min_length=1)  # of several, that which its own part in a channel follows
    shows_in: str
    confused_with: str
    shown_by: str
    faint: Size | None = None  # where the first parameter's `low` is not it

    @property
    def worth_knowing(self) -> Size:
        """The smallest size that a diagnosis is to find."""
        first = next(iter(self.parameters.values()))
        return self.faint or Size(size=first.low, units=first.units)

    @property
    def largest(self) -> float:
        """The largest size in which it is met, in units of its first parameter; infinite where that has a dimension."""
        first = next(iter(self.parameters.values()))
        return first.high if first.units in DIMENSIONLESS else math.inf


@cache
def effect_names() -> tuple[str, ...]:
    """Identifiers of all effects, sorted."""
    folder = resources.files("leactl.vocabulary") / "effects"
    return tuple(sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml")))


@cache
def effects_on(rig: Rig) -> tuple[str, ...]:
    """Identifiers of the effects that a rig can show, sorted."""
    return tuple(name for name in effect_names() if effect_definition(name).rig == rig)


@cache
def effect_definition(name: str) -> EffectDefinition:
    """The definition of one effect.

    Raises
    ------
    InputError : no such effect; the known ones are named.
    """
    if name not in effect_names():
        raise InputError(f"effect '{name}' is not known; known: {', '.join(effect_names())}")
    text = (resources.files("leactl.vocabulary") / "effects" / f"{name}.yaml").read_text(encoding="utf-8")
    return yamlfile.parse(text, f"{name}.yaml").validate(EffectDefinition)
