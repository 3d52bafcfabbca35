"""Print pip constraints that hold every package of pyproject.toml at the lowest version it declares."""

import tomllib
from pathlib import Path

project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
extras = project["optional-dependencies"].values()
requirements = {*project["dependencies"], *(requirement for extra in extras for requirement in extra)}
print("\n".join(sorted(requirement.replace(">=", "==") for requirement in requirements)))
