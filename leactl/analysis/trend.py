"""One result over many runs, each analysed by itself, in the order in which they were made."""

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
    refuse_the_same,
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
    """A run's value."""

    run: Path
    created: str  # UTC
    value: Estimate


@dataclass(frozen=True)
class Trend:
    """Values of one result of one actuator under one condition."""

    result: str
    units: str
    actuator: str
    condition: str
    points: tuple[Point, ...]
    chart: ControlChart | None  # None where there are too few
    left_out: tuple[str, ...]  # a line for each run that has the result and does not tell it

    def as_json(self) -> dict[str, Any]:
        """The trend for other programs."""
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
    """Follow a result from run to run.

    Parameters
    ----------
    actuator, condition : only runs with this label; there has to be one of each.
    baseline : how many of the first values the limits rest on; by default all.
    tell : is told each run as it is analysed.
    workers : who looks at the runs; the answer does not depend on it.
    options : for the analyses, as of `analyze_runs`.

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
    workers: Workers, paths: Sequence[Path], result: str, asked: tuple[str, str]
) -> tuple[tuple[str, str], list[tuple[str, Path, str]]]:
    """The actuator and condition that are asked for, and their runs in order: creation, file, experiment."""
    every: list[tuple[str, tuple[str, str], Path, str]] = []
    others: dict[str, None] = {}
    described = [done.value() for done in workers.in_order(_described, [(path,) for path in paths])]
    refuse_the_same((identity, path) for path, (identity, *_) in zip(paths, described, strict=True))
    for path, (_, created, group, experiment) in zip(paths, described, strict=True):
        known = results_of(experiment)
        if result not in known:
            others |= dict.fromkeys(known)
        else:
            every.append((created, group, path, experiment))
    if not every:
        raise InputError(f"no run has a result '{result}'; they have {listed(others, 12)}")
    fitting = [item for item in every if all(want in ("", own) for want, own in zip(asked, item[1], strict=True))]
    groups = dict.fromkeys(group for _, group, _, _ in fitting)
    if len(groups) != 1:
        there = sorted(groups or dict.fromkeys(item[1] for item in every))
        named = listed(f"'{one}' under '{other}'" for one, other in there)
        raise InputError(f"runs with '{result}' are of {named}; choose one by --actuator and --condition")
    return next(iter(groups)), [(created, path, experiment) for created, _, path, experiment in sorted(fitting)]


def _points(
    workers: Workers,
    runs: Sequence[tuple[str, Path, str]],
    result: str,
    options: Mapping[str, Any],
    tell: Tell,
) -> tuple[list[Point], list[str]]:
    """The values of the runs that tell the result, and a line for each other one."""
    takes = {experiment: options_of(load(experiment)) for *_, experiment in runs}
    if untaken := [name for name in options if not any(name in known for known in takes.values())]:
        raise InputError([f"--set {name}: none of {', '.join(takes)} takes it" for name in untaken])
    jobs = [
        (path, result, {name: value for name, value in options.items() if name in takes[experiment]})
        for _, path, experiment in runs
    ]
    values = workers.in_order(_value, jobs)
    points: list[Point] = []
    left_out: list[str] = []
    for created, path, _ in runs:
        tell(path.name)
        done = next(values)
        if done.faults:
            left_out += done.faults
        elif math.isfinite((value := done.value()).value):
            points.append(Point(path, created, value))
        else:
            left_out.append(f"{path}: does not tell {result}")
    if not points:
        raise InputError(left_out)
    return points, left_out


def _described(path: Path) -> tuple[str, str, tuple[str, str], str]:
    """What a run goes by, when it was made, its actuator and condition, and the experiment that it is of."""
    with Run.open(path) as run:
        created, actuator, condition = (
            str(run.attributes.get(name, "")) for name in ("created", "actuator", "condition")
        )
        return identity_of(run), created, (actuator, condition), experiment_of(run)


def _value(path: Path, result: str, options: Mapping[str, Any]) -> Estimate:
    """The result of one run."""
    return analyze_runs([path], **options).find(result)
