"""What an analysis answers: estimates with 95 % intervals, notes a reader must know, and the points behind a plot."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from leactl.errors import InputError

Value = TypeVar("Value", covariant=True)
Item = TypeVar("Item")
NAN = math.nan
FORMAT, VERSION = "leactl-analysis", 1  # of an answer as JSON


@dataclass(frozen=True)
class Estimate:
    """One number with its standard uncertainty and its 95 % interval; NaN where it has none."""

    name: str
    value: float
    std: float
    low: float
    high: float
    units: str
    actuator: str = ""
    condition: str = ""

    def as_json(self, with_group: bool = False) -> dict[str, Any]:
        """The row as JSON takes it: what is not finite becomes null."""
        numbers = {"value": self.value, "std": self.std, "low": self.low, "high": self.high}
        row: dict[str, Any] = {"name": self.name}
        row |= {key: float(number) if math.isfinite(number) else None for key, number in numbers.items()}
        row["units"] = self.units
        return row | {"actuator": self.actuator, "condition": self.condition} if with_group else row


@dataclass(frozen=True)
class Noted(Generic[Value]):
    """A value and the notes that its reader must know, in the order in which they are printed."""

    value: Value
    notes: tuple[str, ...] = ()


def joined(parts: Iterable[Noted[Sequence[Item]]]) -> Noted[list[Item]]:
    """Put the items of several sequences into one list, and their notes into one tuple."""
    every = list(parts)
    return Noted([item for part in every for item in part.value], tuple(note for part in every for note in part.notes))


@dataclass(frozen=True)
class Series:
    """Points of one kind."""

    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True)
class Band:
    """The part of a map whose values lie between two levels, as polygons of (x, y) corners."""

    label: str
    polygons: tuple[tuple[tuple[float, float], ...], ...]


@dataclass(frozen=True)
class Plot:
    """Points of an experiment and the fitted lines through them, each from end to end."""

    x_label: str
    y_label: str
    points: tuple[Series, ...]
    lines: tuple[Series, ...]
    actuator: str = ""
    condition: str = ""
    x_log: bool = False  # x spans decades, as a frequency does
    bands: tuple[Band, ...] = ()  # of a map, lowest first, empty ones among them


def plotted(count: int, most: int) -> slice:
    """Return the slice that takes every n-th of `count` points, the smallest n that leaves `most` or fewer."""
    return slice(None, None, max(1, math.ceil(count / most)))


@dataclass(frozen=True)
class Covariance:
    """Joint covariance of estimates, in their units; NaN where one has none."""

    names: tuple[str, ...]
    values: tuple[tuple[float, ...], ...]
    actuator: str = ""
    condition: str = ""

    def as_json(self) -> dict[str, Any]:
        """Names and rows as JSON takes them."""
        rows = [[value if math.isfinite(value) else None for value in row] for row in self.values]
        return {"names": list(self.names), "rows": rows, "actuator": self.actuator, "condition": self.condition}


@dataclass(frozen=True)
class Grid:
    """Values over the setpoints of two axes; NaN where the experiment did not get."""

    name: str
    axes: Mapping[str, tuple[float, ...]]  # by name with unit, the outer one first
    values: Mapping[str, tuple[tuple[float, ...], ...]]  # by name with unit: a row for each setpoint of the outer axis
    actuator: str = ""
    condition: str = ""

    def as_json(self) -> dict[str, Any]:
        """Axes and rows as JSON takes them: what is not finite becomes null."""
        rows = {
            name: [[value if math.isfinite(value) else None for value in row] for row in table]
            for name, table in self.values.items()
        }
        axes = {name: list(setpoints) for name, setpoints in self.axes.items()}
        return {"name": self.name, "axes": axes, "values": rows, "actuator": self.actuator, "condition": self.condition}


@dataclass(frozen=True)
class Result:
    """Answer of one experiment, from one run or several."""

    experiment: str
    runs: tuple[str, ...]  # paths as they were given
    results: tuple[Estimate, ...]
    notes: tuple[str, ...] = ()
    plots: tuple[Plot, ...] = ()
    covariances: tuple[Covariance, ...] = ()
    grids: tuple[Grid, ...] = ()

    @property
    def groups(self) -> list[tuple[str, str]]:
        """Every (actuator, condition) with results, in order."""
        return list(dict.fromkeys((item.actuator, item.condition) for item in self.results))

    def find(self, name: str, actuator: str | None = None, condition: str | None = None) -> Estimate:
        """The one estimate of this name, of an actuator and under a condition where there are several.

        Raises
        ------
        InputError : there is none, or there are several.
        """
        found = [
            item
            for item in self.results
            if item.name == name and actuator in (None, item.actuator) and condition in (None, item.condition)
        ]
        if not found:
            raise InputError(f"{self.experiment} has no result '{name}'{self._asked(actuator, condition)}")
        if len(found) > 1:
            groups = ", ".join(f"{item.actuator}/{item.condition}" for item in found)
            raise InputError(f"{self.experiment} has '{name}' {len(found)} times: {groups}; ask for one of them")
        return found[0]

    def as_json(self) -> dict[str, Any]:
        """The answer as `--json` prints it; rows carry actuator and condition where there is more than one group."""
        several = len(self.groups) > 1
        told: dict[str, Any] = {
            "format": FORMAT,
            "format_version": VERSION,
            "experiment": self.experiment,
            "runs": list(self.runs),
            "results": [item.as_json(several) for item in self.results],
            "notes": list(self.notes),
        }
        told |= {"covariances": [one.as_json() for one in self.covariances]} if self.covariances else {}
        return told | ({"grids": [one.as_json() for one in self.grids]} if self.grids else {})

    def _asked(self, actuator: str | None, condition: str | None) -> str:
        asked = " of ".join(repr(part) for part in (condition, actuator) if part is not None)
        known = dict.fromkeys(item.name for item in self.results)
        return f"{' for ' + asked if asked else ''}; it has {', '.join(known)}"


def listed(items: Iterable[object], most: int = 4) -> str:
    """A list short enough for one line."""
    every = [str(item) for item in items]
    return ", ".join(every[:most]) + (f" and {len(every) - most} more" if len(every) > most else "")


def tally(reasons: Mapping[str, list[str]], place: str) -> list[str]:
    """One note for each reason why something was left out, with how often and where."""
    return [f"{place}: left out {len(what)}: {reason} ({listed(what)})" for reason, what in reasons.items()]
