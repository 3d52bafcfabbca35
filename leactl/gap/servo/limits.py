"""What a servo's drive does to its reference and to its error: a limited profile, a dead band.

Where fits of them begin, when they are there at all, and how their parameters are told.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from leactl.gap.servo.fit import MeasuredServoRuns, cost
from leactl.gap.servo.profile import SLOWNESS, SLUGGISHNESS
from leactl.gap.servo.runs import ServoRuns
from leactl.gap.servo.simulation import FINEST, Parameters

Array = npt.NDArray[np.float64]
DRIVE = frozenset({"reference_rate_limit", "servo_dead_band"})
SPEEDS = (0.1, 0.2, 0.35, 0.6, 0.9, 1.3)  # of the highest speed of the axis, that limits are tried at
RAMPS = (0.01, 1.0, 3.0, 10.0, 30.0)  # times a third of the servo's own time to that speed, the same of accelerations
BANDS = (3.0, 6.0, 12.0, 25.0, 50.0)  # counts of the encoder, that dead bands are tried at
REACH, TOP = 4, 0.99  # samples that a speed is taken over, and the quantile that counts as the highest
MET = 0.8  # of the highest speed of the axis over a limit, from which on it met that
LONGER = 2.0  # samples that a set-point takes to the axis' highest speed, from which on its acceleration is limited
KEPT = 2  # of the first base's grid, one less of the next
WIDER = 2.0  # counts of the encoder, from which on a band is one: a controller counts its own error
SHOWN = 2.0  # standard errors, above which a ramp shows


def drive_starts(runs: ServoRuns, bases: Sequence[Parameters]) -> dict[str, list[Parameters]]:
    """Where fits of a limited profile and of a dead band begin: the best of a grid beside each of some bases.

    A start holds the base's parameters as well: a fit without the limit may have bent them to make up for it.
    """
    top = top_speed(runs)
    if top <= 0.0:
        return {}
    ramps = runs.sizes[SLUGGISHNESS] * np.array(RAMPS)
    profiles = [{SLOWNESS: 1.0 / (share * top), SLUGGISHNESS: float(ramp)} for share in SPEEDS for ramp in ramps]
    bands = [{"servo_dead_band.band": counts * max(runs.count, FINEST)} for counts in BANDS]
    asked = np.abs(np.diff(runs.reference, axis=1)) / runs.interval
    grids = {"servo_dead_band": bands} | (
        {"reference_rate_limit": profiles} if float(np.max(asked)) > MET * top else {}
    )
    against, starts = MeasuredServoRuns(runs), {}
    for effect, grid in grids.items():
        points = [base | point for base in bases for point in grid]
        costs = np.nan_to_num([cost(error) for error in against.of(points)], nan=np.inf).reshape(len(bases), -1)
        best = [place * len(grid) + k for place, own in enumerate(costs) for k in np.argsort(own)[: KEPT - place]]
        starts[effect] = [points[place] for place in best]
    return starts


def acts(effect: str, parameters: Parameters, runs: ServoRuns) -> bool:
    """Whether what a drive was found to do is there: a limit that the axis meets, a band wider than two counts."""
    if effect == "servo_dead_band":
        return parameters.get("servo_dead_band.band", 0.0) >= WIDER * runs.count
    if effect != "reference_rate_limit":
        return True
    top = top_speed(runs)
    slow, idle = parameters.get(SLOWNESS, 0.0), parameters.get(SLUGGISHNESS, 0.0)
    return slow * top > MET or idle * top > LONGER * runs.interval


def top_speed(runs: ServoRuns) -> float:
    """The highest speed [rad/s] of the axis but for what its encoder's counts make of it."""
    far = np.abs(runs.angle[:, REACH:] - runs.angle[:, :-REACH]) / (REACH * runs.interval)
    return float(np.quantile(far[runs.measured[:, REACH:] & runs.measured[:, :-REACH]], TOP))


def as_fitted(effect: str, told: Mapping[str, float]) -> dict[str, float]:
    """Parameters of an effect as a simulation has them; a limit of zero is none."""
    if effect != "reference_rate_limit":
        return dict(told)
    names = {"speed": "slowness", "acceleration": "sluggishness"}
    return {names[name]: 1.0 / value if value > 0.0 else 0.0 for name, value in told.items()}


def as_told(effect: str, fitted: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Parameters of an effect by the names of its definition, with standard errors, from those of a fit."""
    if effect != "reference_rate_limit":
        return dict(fitted)
    parameters = {}
    for name, (value, std) in {"speed": fitted["slowness"], "acceleration": fitted["sluggishness"]}.items():
        shows = value > SHOWN * std and math.isfinite(1.0 / max(value, 1e-300))
        parameters[name] = (1.0 / value, std / value**2) if shows else (0.0, 0.0)
    return parameters
