"""Definitions of effects, read from YAML files.

Definitions of leactl lie in `leactl/vocabulary/effects`, those of another package beside the modules of its effects.
"""

import math
from functools import cache
from importlib import resources
from importlib.metadata import entry_points
from importlib.resources.abc import Traversable
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from leactl import yamlfile
from leactl.errors import InputError
from leactl.vocabulary.variable import Variable

GROUP = "leactl.effects"  # group of entry points, each a module with a subclass of `leactl.effects.contract.Effect`
STRICT = ConfigDict(frozen=True, extra="forbid")


class ParameterDefinition(BaseModel):
    """One number of an effect: its units as in run files, and the range in which it occurs."""

    model_config = STRICT
    units: str
    low: float
    high: float
    meaning: str
    default: float | None = None  # value of a shape parameter that may be left out


DIMENSIONLESS = ("1", "rad", "share of the limit")
"""Units of parameters whose range holds for a machine of any size."""
MACHINE_INDEPENDENT = (*DIMENSIONLESS, "K", "1/K")
"""Units in which a size means the same on every machine: temperature limits do not depend on how large it is."""


class Size(BaseModel):
    """A size of an effect in the unit that a diagnosis measures it in.

    A size whose unit has a dimension is a multiple of the machine's own unit (`leactl.gap.signals.scales`): a torque is
    given in multiples of the machine's Coulomb friction, a current in multiples of the current that makes this torque,
    a time in intervals between samples.
    """

    model_config = STRICT
    size: float = Field(gt=0.0)
    units: str


Rig = Literal["bench", "joint", "servo"]
"""Two actuators on a torque sensor's shaft, a joint that logs its own drive, and a joint behind a position servo."""


class EffectDefinition(BaseModel):
    """Definition of an effect; the fields are the keys of its file.

    `shown_on` names the kinds of rig whose runs can show the effect, `shows_in` describes the signature in the data,
    and `shown_by` the experiment that reveals it. `acts_over` is in order of preference: a picture of the effect is
    drawn over the first of these variables that the effect's part in a channel follows. `faint` is the smallest
    relevant size, given where the low end of the first parameter's range is not that size.
    """

    model_config = STRICT
    effect: str
    family: Literal["machine", "sensor", "drive", "thermal"]
    meaning: str
    parameters: dict[str, ParameterDefinition] = Field(min_length=1)
    acts_over: tuple[Variable, ...] = Field(min_length=1)
    shown_on: tuple[Rig, ...] = Field(min_length=1)
    shows_in: str
    confused_with: str
    shown_by: str
    faint: Size | None = None

    @model_validator(mode="after")
    def _states_size_worth_knowing(self) -> "EffectDefinition":
        """Raise ValueError if neither `faint` nor the first parameter's range gives a size for every machine."""
        name, first = next(iter(self.parameters.items()))
        if self.faint is None and not (first.units in MACHINE_INDEPENDENT and first.low > 0.0):
            raise ValueError(
                f"faint is missing, the smallest size worth knowing: {name} begins at {first.low:g} {first.units},"
                " which cannot stand for it on machines of every size;"
                " give faint: {size: ..., units: ...} in the machine's own unit"
            )
        return self

    @property
    def smallest_worth_knowing(self) -> Size:
        """The smallest size that a diagnosis should find, in the machine's own unit."""
        first = next(iter(self.parameters.values()))
        return self.faint or Size(size=first.low, units=first.units)

    @property
    def largest(self) -> float:
        """The largest size that occurs, in the unit of the first parameter; infinite if that unit has a dimension."""
        first = next(iter(self.parameters.values()))
        return first.high if first.units in DIMENSIONLESS else math.inf


@cache
def effect_names() -> tuple[str, ...]:
    """Return the identifiers of all effects, sorted."""
    return tuple(sorted({*shipped_effects(), *modules_of_others()}))


@cache
def shipped_effects() -> tuple[str, ...]:
    """Return the identifiers of the effects that leactl brings, sorted."""
    folder = resources.files("leactl.vocabulary") / "effects"
    return tuple(sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml")))


@cache
def modules_of_others() -> dict[str, str]:
    """Return the modules of effects that other packages bring, by identifier; none replaces a shipped effect."""
    return {point.name: point.module for point in entry_points(group=GROUP) if point.name not in shipped_effects()}


def definition_file(name: str) -> Traversable:
    """Return the file `NAME.yaml` that defines an effect, beside its module if another package brings it."""
    module = modules_of_others().get(name)
    folder = resources.files("leactl.vocabulary") / "effects" if module is None else resources.files(package_of(module))
    return folder / f"{name}.yaml"


def package_of(module: str) -> str:
    """Return the package that a module lies in; the module itself if it lies in none."""
    return module.rpartition(".")[0] or module


@cache
def effects_on(rig: Rig) -> tuple[str, ...]:
    """Return the identifiers of the effects that a kind of rig can show, sorted."""
    return tuple(name for name in effect_names() if rig in effect_definition(name).shown_on)


@cache
def effect_definition(name: str) -> EffectDefinition:
    """Return the definition of one effect.

    Raises
    ------
    InputError : the effect is not known, its file is missing, or the file has a fault.
    """
    if name not in effect_names():
        raise InputError(f"effect '{name}' is not known; known: {', '.join(effect_names())}")
    file = definition_file(name)
    if not file.is_file():
        raise InputError(f"{file}: is missing; it defines effect {name}, whose module is {modules_of_others()[name]}")
    return yamlfile.parse(file.read_text(encoding="utf-8"), f"{name}.yaml").validate(EffectDefinition)
