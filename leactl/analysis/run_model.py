"""What the model that a run carries says: the parameters that its bench was set up with."""

import math
import sys
from typing import Any, Final

from leactl import yamlfile
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Run

LARGEST: Final = math.sqrt(sys.float_info.max)


def model_of(run: Run) -> dict[str, Any]:
    """The model that a run carries; empty where it carries none.

    Raises
    ------
    InputError : a text that is no YAML.
    """
    text = run.source("model")
    data = yamlfile.parse(text, f"{run.path}:/model/source").data if text is not None else None
    return data if isinstance(data, dict) else {}


def rotor_inertia_of_model(run: Run) -> float:
    """The rotor inertia in the model that a run carries [kg*m^2]; NaN where there is none."""
    return positive(model_of(run).get("rotor_inertia"))


def positive(found: object) -> float:
    """A number above zero as it stands in a model; NaN where it is none, or none whose square is a number too."""
    if not isinstance(found, int | float) or isinstance(found, bool) or not 0 < found <= LARGEST:
        return math.nan
    return float(found) if found**2 > 0 else math.nan


def torque_constant_of_model(run: Run) -> float:
    """The torque constant in the model that a run carries [N*m/A].

    Raises
    ------
    NotIdentifiable : there is none.
    """
    found = model_of(run).get("torque_constant")
    value = positive(found)
    if value > 0:
        return value
    what = "no model" if run.source("model") is None else f"a model whose torque_constant is {found!r}"
    raise NotIdentifiable(f"{run.path}: found {what}; a torque constant is needed, give --torque-constant")
