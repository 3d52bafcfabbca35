"""Parameters of the nominal model that is stored in a run file."""

import math
import sys
from collections.abc import Mapping
from typing import Any, Final

from leactl import yamlfile
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Run

PAPER_WINDING_LIMIT: Final = 130.0  # degC, for a model that states no limit
LARGEST_SQUARABLE: Final = math.sqrt(sys.float_info.max)  # a number whose square is finite


def model_of(run: Run) -> dict[str, Any]:
    """Return the model in a run file as a mapping; empty if there is no model, or the model is no mapping.

    Raises
    ------
    InputError : the text of the model is no YAML.
    """
    text = run.source("model")
    document = yamlfile.parse(text, f"{run.path}:/model/source").data if text is not None else None
    return document if isinstance(document, dict) else {}


def rotor_inertia_of_model(run: Run) -> float:
    """Return the rotor inertia in a run's model [kg*m^2]; NaN if there is none."""
    return positive_number(model_of(run).get("rotor_inertia"))


def positive_number(entry: object) -> float:
    """Return the entry of a model as a number above zero.

    NaN if it is no such number, or if its square overflows or underflows.
    """
    if not isinstance(entry, int | float) or isinstance(entry, bool) or not 0 < entry <= LARGEST_SQUARABLE:
        return math.nan
    return float(entry) if entry**2 > 0 else math.nan


def winding_limit_of(model: Mapping[str, Any]) -> float:
    """Return the temperature limit of a model's winding [degC]; that of the paper if the model has none."""
    limits = model.get("limits")
    limit = limits.get("winding_temperature") if isinstance(limits, Mapping) else None
    return float(limit) if isinstance(limit, int | float) and not isinstance(limit, bool) else PAPER_WINDING_LIMIT


def torque_constant_of_model(run: Run) -> float:
    """Return the torque constant in a run's model [N*m/A].

    Raises
    ------
    NotIdentifiable : the run has no model, or its model has no torque constant above zero.
    """
    entry = model_of(run).get("torque_constant")
    value = positive_number(entry)
    if value > 0:
        return value
    source = "no model" if run.source("model") is None else f"a model whose torque_constant is {entry!r}"
    raise NotIdentifiable(f"{run.path}: found {source}; a torque constant is needed, give --torque-constant")
