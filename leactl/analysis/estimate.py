"""Result of an analysis: estimates with 95 % intervals, notes, plots, covariances and grids."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from leactl.errors import InputError

Value = TypeVar("Value", covariant=True)
Item = TypeVar("Item")
NAN = math.nan
FORMAT, VERSION = "leactl-analysis", 1  # of a result as JSON


@dataclass(frozen=True)
class Estimate:
    """One number with its standard uncertainty and its 95 % interval; NaN for each that is not known."""

    name: str
    value: float
    std: float
    low: float
    high: float
    units: str
    actuator: str = ""
    condition: str = ""

    def as_json(self, with_group: bool = False) -> dict[str, Any]:
        """Return the estimate as a JSON object; numbers that are not finite become null.

        `with_group` adds actuator and condition.
        """
        numbers = {"value": self.value, "std": self.std, "low": self.low, "high": self.high}
        row: dict[str, Any] = {"name": self.name}
        row |= {key: float(number) if math.isfinite(number) else None for key, number in numbers.items()}
        row["units"] = self.units
        return row | {"actuator": self.actuator, "condition": self.condition} if with_group else row


@dataclass(frozen=True)
class Noted(Generic[Value]):
    """A value and the notes on it that a reader must see, in the order in which they are printed."""

    value: Value
    notes: tuple[str, ...] = ()


def joined(sequences: Iterable[Noted[Sequence[Item]]]) -> Noted[list[Item]]:
    """Return the items of several sequences as one list, with all their notes."""
    noted_sequences = list(sequences)
    return Noted(
        [item for sequence in noted_sequences for item in sequence.value],
        tuple(note for sequence in noted_sequences for note in sequence.notes),
    )


@dataclass(frozen=True)
class Series:
    """Points (x, y) that share a label in a plot."""

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
    bands: tuple[Band, ...] = ()  # of a map, lowest first; some may have no polygons


def plot_slice(count: int, most_points: int) -> slice:
    """Return the slice that takes every n-th of `count` points, n the smallest that leaves at most `most_points`."""
    return slice(None, None, max(1, math.ceil(count / most_points)))


@dataclass(frozen=True)
class Covariance:
    """Joint covariance of estimates, in products of their units; NaN for estimates without an uncertainty."""

    names: tuple[str, ...]
    values: tuple[tuple[float, ...], ...]
    actuator: str = ""
    condition: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return names and rows as a JSON object; numbers that are not finite become null."""
        rows = [[value if math.isfinite(value) else None for value in row] for row in self.values]
        return {"names": list(self.names), "rows": rows, "actuator": self.actuator, "condition": self.condition}


@dataclass(frozen=True)
class Grid:
    """Values over the setpoints of two axes; NaN at setpoints that the experiment did not reach."""

    name: str
    axes: Mapping[str, tuple[float, ...]]  # by name with unit, the outer one first
    values: Mapping[str, tuple[tuple[float, ...], ...]]  # by name with unit: a row for each setpoint of the outer axis
    actuator: str = ""
    condition: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return axes and rows as a JSON object; values that are not finite become null."""
        rows = {
            name: [[value if math.isfinite(value) else None for value in row] for row in table]
            for name, table in self.values.items()
        }
        axes = {name: list(setpoints) for name, setpoints in self.axes.items()}
        return {"name": self.name, "axes": axes, "values": rows, "actuator": self.actuator, "condition": self.condition}


@dataclass(frozen=True)
class Result:
    """Result of one experiment, from one run or several."""

    experiment: str
    runs: tuple[str, ...]  # paths as they were given
    results: tuple[Estimate, ...]
    notes: tuple[str, ...] = ()
    plots: tuple[Plot, ...] = ()
    covariances: tuple[Covariance, ...] = ()
    grids: tuple[Grid, ...] = ()

    @property
    def groups(self) -> list[tuple[str, str]]:
        """Every pair of actuator and condition that has results, in order."""
        return list(dict.fromkeys((item.actuator, item.condition) for item in self.results))

    def find(self, name: str, actuator: str | None = None, condition: str | None = None) -> Estimate:
        """Return the only estimate of this name.

        `actuator` and `condition` select among several groups; None accepts every actuator or condition.

        Raises
        ------
        InputError : no estimate matches, or several do.
        """
        matches = [
            estimate
            for estimate in self.results
            if estimate.name == name
            and actuator in (None, estimate.actuator)
            and condition in (None, estimate.condition)
        ]
        if not matches:
            raise InputError(f"{self.experiment} has no result '{name}'{self._group_and_names(actuator, condition)}")
        if len(matches) > 1:
            groups = ", ".join(f"{estimate.actuator}/{estimate.condition}" for estimate in matches)
            raise InputError(f"{self.experiment} has '{name}' {len(matches)} times: {groups}; ask for one of them")
        return matches[0]

    def as_json(self) -> dict[str, Any]:
        """Return the result as `--json` prints it; rows have actuator and condition where there are several groups."""
        several = len(self.groups) > 1
        document: dict[str, Any] = {
            "format": FORMAT,
            "format_version": VERSION,
            "experiment": self.experiment,
            "runs": list(self.runs),
            "results": [item.as_json(several) for item in self.results],
            "notes": list(self.notes),
        }
        document |= {"covariances": [item.as_json() for item in self.covariances]} if self.covariances else {}
        return document | ({"grids": [item.as_json() for item in self.grids]} if self.grids else {})

    def _group_and_names(self, actuator: str | None, condition: str | None) -> str:
        """Return the end of an error message: the group that was searched, and the names of all results."""
        group = " of ".join(repr(label) for label in (condition, actuator) if label is not None)
        names = dict.fromkeys(item.name for item in self.results)
        return f"{' for ' + group if group else ''}; it has {', '.join(names)}"


def listed(items: Iterable[object], most: int = 4) -> str:
    """Return the items separated by commas; those beyond the first `most` are only counted."""
    texts = [str(item) for item in items]
    return ", ".join(texts[:most]) + (f" and {len(texts) - most} more" if len(texts) > most else "")


def tally(reasons: Mapping[str, list[str]], prefix: str) -> list[str]:
    """Return a note for each reason to leave items out, with their number and names; `prefix` opens each note.

    `reasons` maps each reason to the names of the items that it applies to.
    """
    return [f"{prefix}: left out {len(items)}: {reason} ({listed(items)})" for reason, items in reasons.items()]
