"""Definitions of faults of a set-up, read from the YAML files in `leactl/vocabulary/setup_faults`."""

from functools import cache
from importlib import resources

from pydantic import BaseModel

from leactl import yamlfile
from leactl.vocabulary.effect import STRICT


class FaultDefinition(BaseModel):
    """What a fault of a set-up is, and what shows it by hand."""

    model_config = STRICT
    fault: str
    meaning: str
    shown_by: str


@cache
def setup_faults() -> dict[str, FaultDefinition]:
    """Every fault of a set-up by its identifier, sorted."""
    folder = resources.files("leactl.vocabulary") / "setup_faults"
    texts = {
        entry.name: entry.read_text(encoding="utf-8") for entry in folder.iterdir() if entry.name.endswith(".yaml")
    }
    definitions = [yamlfile.parse(texts[name], name).validate(FaultDefinition) for name in sorted(texts)]
    return {one.fault: one for one in definitions}
