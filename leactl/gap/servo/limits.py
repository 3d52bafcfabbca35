"""Speed limit, acceleration limit and dead band of a servo's drive: starts of fits, tests, conversions."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from leactl.gap.servo.fit import MeasuredServoRuns, cost
from leactl.gap.servo.profile import SLOWNESS, SLUGGISHNESS
from leactl.gap.servo.runs import ServoRuns
from leactl.gap.servo.simulation import FINEST_RESOLUTION, Parameters

Array = npt.NDArray[np.float64]
DRIVE_EFFECTS = frozenset({"reference_rate_limit", "servo_dead_band"})
SPEED_LIMIT_SHARES = (0.1, 0.2, 0.35, 0.6, 0.9, 1.3)  # speed limits from which fits begin, over the top speed
ACCELERATION_GRID = (0.01, 1.0, 3.0, 10.0, 30.0)  # inverse accelerations, in `runs.scales[SLUGGISHNESS]` [s^2/rad]
DEAD_BAND_COUNTS = (3.0, 6.0, 12.0, 25.0, 50.0)  # widths in counts of the encoder, from which fits begin
SPEED_SPAN = 4  # samples over which a speed is taken, so that encoder counts hardly change it
TOP_QUANTILE = 0.99  # quantile of the speeds that counts as the top speed
LEAST_SPEED_RATIO = 0.8  # top speed over the speed limit, above which the limit acts
LEAST_REFERENCE_RATIO = 0.8  # fastest change of the reference over the top speed, above which limits are tried
LEAST_RAMP_SAMPLES = 2.0  # samples to the top speed at the acceleration limit, above which that limit acts
STARTS_OF_FIRST_BASE = 2  # best points of the first base's grid; one less for each further base
LEAST_BAND_COUNTS = 2.0  # encoder counts; a narrower dead band is the controller's own quantisation
LEAST_STDS = 2.0  # inverse limit over its standard error, below which there is no limit


def drive_starts(runs: ServoRuns, bases: Sequence[Parameters]) -> dict[str, list[Parameters]]:
    """Return the starts of fits of a limited profile and a dead band: the best points of a grid with each base.

    A start includes the base's parameters, which a fit without the limit may have changed to compensate for it.
    """
    top = top_speed(runs)
    if top <= 0.0:
        return {}
    inverse_accelerations = runs.scales[SLUGGISHNESS] * np.array(ACCELERATION_GRID)
    profiles = [
        {SLOWNESS: 1.0 / (share * top), SLUGGISHNESS: float(inverse_acceleration)}
        for share in SPEED_LIMIT_SHARES
        for inverse_acceleration in inverse_accelerations
    ]
    bands = [
        {"servo_dead_band.band": counts * max(runs.encoder_resolution, FINEST_RESOLUTION)}
        for counts in DEAD_BAND_COUNTS
    ]
    reference_speeds = np.abs(np.diff(runs.reference, axis=1)) / runs.interval
    grids = {"servo_dead_band": bands} | (
        {"reference_rate_limit": profiles} if float(np.max(reference_speeds)) > LEAST_REFERENCE_RATIO * top else {}
    )
    measured_runs, starts = MeasuredServoRuns(runs), {}
    for effect, grid in grids.items():
        points = [base | point for base in bases for point in grid]
        costs = np.nan_to_num([cost(error) for error in measured_runs.residuals(points)], nan=np.inf).reshape(
            len(bases), -1
        )
        starts[effect] = [
            points[base * len(grid) + k]
            for base, base_costs in enumerate(costs)
            for k in np.argsort(base_costs)[: max(STARTS_OF_FIRST_BASE - base, 0)]
        ]
    return starts


def acts(effect: str, parameters: Parameters, runs: ServoRuns) -> bool:
    """Return whether a fitted effect acts: the axis reaches the limit, or the dead band is wide enough to matter."""
    if effect == "servo_dead_band":
        return parameters.get("servo_dead_band.band", 0.0) >= LEAST_BAND_COUNTS * runs.encoder_resolution
    if effect != "reference_rate_limit":
        return True
    top = top_speed(runs)
    slowness, sluggishness = parameters.get(SLOWNESS, 0.0), parameters.get(SLUGGISHNESS, 0.0)
    return slowness * top > LEAST_SPEED_RATIO or sluggishness * top > LEAST_RAMP_SAMPLES * runs.interval


def top_speed(runs: ServoRuns) -> float:
    """Return the 99 % quantile of the axis' speed [rad/s], taken over four samples to suppress quantisation."""
    speeds = np.abs(runs.angle[:, SPEED_SPAN:] - runs.angle[:, :-SPEED_SPAN]) / (SPEED_SPAN * runs.interval)
    return float(np.quantile(speeds[runs.measured[:, SPEED_SPAN:] & runs.measured[:, :-SPEED_SPAN]], TOP_QUANTILE))


def to_fit_parameters(effect: str, defined: Mapping[str, float]) -> dict[str, float]:
    """Return an effect's parameters as the simulation has them: a limit as its inverse, and 0 (no limit) as 0."""
    if effect != "reference_rate_limit":
        return dict(defined)
    names = {"speed": "slowness", "acceleration": "sluggishness"}
    return {names[name]: 1.0 / value if value > 0.0 else 0.0 for name, value in defined.items()}


def to_effect_parameters(effect: str, fitted: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Return fitted parameters, each with its standard error, as the effect's definition names them.

    An inverse limit that is not significant becomes 0, no limit.
    """
    if effect != "reference_rate_limit":
        return dict(fitted)
    parameters = {}
    for name, (value, std) in {"speed": fitted["slowness"], "acceleration": fitted["sluggishness"]}.items():
        is_significant = value > LEAST_STDS * std and math.isfinite(1.0 / max(value, 1e-300))
        parameters[name] = (1.0 / value, std / value**2) if is_significant else (0.0, 0.0)
    return parameters
