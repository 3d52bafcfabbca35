"""Definitions of faults of a set-up, read from the YAML files in `leactl/vocabulary/setup_faults`."""

from functools import cache
from importlib import resources

from pydantic import BaseModel

from leactl import yamlfile
from leactl.vocabulary.effect import STRICT


class FaultDefinition(BaseModel):
    """Definition of a fault of a set-up: its meaning, and what shows it by hand."""

    model_config = STRICT
    fault: str
    meaning: str
    shown_by: str


@cache
def setup_faults() -> dict[str, FaultDefinition]:
    """Return the definitions of all faults of a set-up by identifier, sorted."""
    folder = resources.files("leactl.vocabulary") / "setup_faults"
    texts = {
        entry.name: entry.read_text(encoding="utf-8") for entry in folder.iterdir() if entry.name.endswith(".yaml")
    }
    definitions = [yamlfile.parse(texts[name], name).validate(FaultDefinition) for name in sorted(texts)]
    return {definition.fault: definition for definition in definitions}
