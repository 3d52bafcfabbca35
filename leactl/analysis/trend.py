"""Trend of one result over many runs: each run is analysed by itself, in the order of creation."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leactl.analysis.analyze import (
    analyze_runs,
    experiment_of,
    identity_of,
    options_of,
    refuse_duplicates,
    results_of,
)
from leactl.analysis.estimate import Estimate, listed
from leactl.analysis.registry import load
from leactl.analysis.statistics.control_chart import ControlChart, control_chart
from leactl.errors import InputError
from leactl.processes import HERE, Workers
from leactl.runfile.read.reader import Run

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Point:
    """One run and its value of the result."""

    run: Path
    created: str  # time of creation, UTC
    value: Estimate


@dataclass(frozen=True)
class Trend:
    """Values of one result of one actuator under one condition."""

    result: str
    units: str
    actuator: str
    condition: str
    points: tuple[Point, ...]
    chart: ControlChart | None  # None if there are too few points
    left_out: tuple[str, ...]  # a line for each run whose analysis fails or gives no finite value

    def as_json(self) -> dict[str, Any]:
        """Return the trend as a JSON object."""
        return {
            "result": self.result,
            "units": self.units,
            "actuator": self.actuator,
            "condition": self.condition,
            "points": [
                {"run": str(point.run), "created": point.created, **point.value.as_json()} for point in self.points
            ],
            "chart": self.chart.as_json() if self.chart else None,
            "left_out": list(self.left_out),
        }


def trend(
    paths: Sequence[Path],
    result: str,
    actuator: str = "",
    condition: str = "",
    baseline: int | None = None,
    tell: Tell = lambda _: None,
    workers: Workers = HERE,
    **options: Any,
) -> Trend:
    """Collect the values of one result over runs of one actuator and condition, with their control chart.

    Parameters
    ----------
    actuator, condition : take only runs with this label; these runs must have one actuator and one condition.
    baseline : number of first values that the control limits are computed from; by default all.
    tell : function that is called with the name of each run's file before its value is awaited.
    workers : processes that analyse the runs; the trend does not depend on their number.
    options : of the analyses, as of `analyze_runs`.

    Raises
    ------
    InputError : a run is given twice, no run has the result, runs of several actuators or conditions have it, or no
        analysis takes an option.
    """
    group, runs = _runs_with(workers, paths, result, (actuator, condition))
    points, left_out = _points(workers, runs, result, options, tell)
    chart = control_chart(np.array([point.value.value for point in points]), baseline)
    return Trend(result, points[0].value.units, *group, tuple(points), chart, tuple(left_out))


def _runs_with(
    workers: Workers, paths: Sequence[Path], result: str, requested_group: tuple[str, str]
) -> tuple[tuple[str, str], list[tuple[str, Path, str]]]:
    """Return actuator and condition of the requested group, and time, path and experiment of its runs by creation.

    `requested_group` is actuator and condition; an empty text accepts every label.
    """
    runs_with_result: list[tuple[str, tuple[str, str], Path, str]] = []
    other_results: dict[str, None] = {}
    descriptions = [outcome.value() for outcome in workers.in_order(_description, [(path,) for path in paths])]
    refuse_duplicates((identity, path) for path, (identity, *_) in zip(paths, descriptions, strict=True))
    for path, (_, created, group, experiment) in zip(paths, descriptions, strict=True):
        units_of_results = results_of(experiment)
        if result not in units_of_results:
            other_results |= dict.fromkeys(units_of_results)
        else:
            runs_with_result.append((created, group, path, experiment))
    if not runs_with_result:
        raise InputError(f"no run has a result '{result}'; they have {listed(other_results, 12)}")
    selected = [
        (created, group, path, experiment)
        for created, group, path, experiment in runs_with_result
        if all(requested in ("", label) for requested, label in zip(requested_group, group, strict=True))
    ]
    groups = dict.fromkeys(group for _, group, _, _ in selected)
    if len(groups) != 1:
        available_groups = sorted(groups or dict.fromkeys(group for _, group, _, _ in runs_with_result))
        groups_text = listed(f"'{actuator}' under '{condition}'" for actuator, condition in available_groups)
        raise InputError(f"runs with '{result}' are of {groups_text}; choose one by --actuator and --condition")
    return next(iter(groups)), [(created, path, experiment) for created, _, path, experiment in sorted(selected)]


def _points(
    workers: Workers,
    runs: Sequence[tuple[str, Path, str]],
    result: str,
    options: Mapping[str, Any],
    tell: Tell,
) -> tuple[list[Point], list[str]]:
    """Return the points of all runs with a finite value, and a line for each run without such a value."""
    options_by_experiment = {experiment: options_of(load(experiment)) for *_, experiment in runs}
    if unused := [name for name in options if not any(name in names for names in options_by_experiment.values())]:
        raise InputError([f"--set {name}: none of {', '.join(options_by_experiment)} takes it" for name in unused])
    jobs = [
        (path, result, {name: value for name, value in options.items() if name in options_by_experiment[experiment]})
        for _, path, experiment in runs
    ]
    values = workers.in_order(_value, jobs)
    points: list[Point] = []
    left_out: list[str] = []
    for created, path, _ in runs:
        tell(path.name)
        outcome = next(values)
        if outcome.faults:
            left_out += outcome.faults
        elif math.isfinite((value := outcome.value()).value):
            points.append(Point(path, created, value))
        else:
            left_out.append(f"{path}: does not determine {result}")
    if not points:
        raise InputError(left_out)
    return points, left_out


def _description(path: Path) -> tuple[str, str, tuple[str, str], str]:
    """Return a run's identity, its time of creation, its actuator and condition, and its experiment."""
    with Run.open(path) as run:
        created, actuator, condition = (
            str(run.attributes.get(name, "")) for name in ("created", "actuator", "condition")
        )
        return identity_of(run), created, (actuator, condition), experiment_of(run)


def _value(path: Path, result: str, options: Mapping[str, Any]) -> Estimate:
    """Return the estimate of the result that the analysis of one run gives."""
    return analyze_runs([path], **options).find(result)
