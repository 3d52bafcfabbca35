"""Read the results of a run's bisections from the parameters of the steps that ended them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from leactl.runfile.read.reader import Step


@dataclass(frozen=True)
class Searched:
    """Result of a finished bisection."""

    name: str
    outcome: str  # bracketed, not_identifiable
    lower: float | None  # None if both ends had the same outcome
    upper: float | None
    resolution: float
    unit: str

    def __str__(self) -> str:
        if self.lower is None or self.upper is None:
            return f"bisect {self.name}: {self.outcome.replace('_', ' ')}, both ends have the same outcome"
        return f"bisect {self.name}: {self.lower:g} to {self.upper:g} {self.unit}, resolution {self.resolution:g}"


def searches(steps: Sequence[Step]) -> Iterator[Searched]:
    """Yield the results of the finished bisections, in the order of the steps."""
    for step in steps:
        parameters = step.parameters
        key = next((key for key in parameters if key.startswith("resolution_")), "")
        unit = key.removeprefix("resolution_")
        lower, upper, resolution = (_number(parameters.get(name)) for name in (f"lower_{unit}", f"upper_{unit}", key))
        if isinstance(parameters.get("bisect"), str) and resolution is not None:
            yield Searched(step.name, parameters["bisect"], lower, upper, resolution, unit)


def _number(value: object) -> float | None:
    """Return the value as float; None if it is not a number."""
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
