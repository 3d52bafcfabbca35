"""What the model that a run carries says: the parameters that its bench was set up with."""

from typing import Any

from leactl import yamlfile
from leactl.errors import NotIdentifiable
from leactl.runfile.reader import Run


def torque_constant_of_model(run: Run) -> float:
    """The torque constant in the model that a run carries [N*m/A]."""
    found = parameter_of_model(run, "torque_constant")
    if isinstance(found, int | float) and not isinstance(found, bool) and found > 0:
        return float(found)
    what = "no model" if run.source("model") is None else f"a model whose torque_constant is {found!r}"
    raise NotIdentifiable(f"{run.path}: found {what}; a torque constant is needed, give --torque-constant")


def parameter_of_model(run: Run, name: str) -> Any:
    """What the model that a run carries has under a name; None where it has nothing."""
    text = run.source("model")
    data = yamlfile.parse(text, f"{run.path}:/model/source").data if text is not None else None
    return data.get(name) if isinstance(data, dict) else None
