"""What is true of the shipped emulated benches, by experiment and result: closed forms and other solvers."""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from leactl.analysis.estimate import Result
from leactl.bench import benchfile
from leactl.emulation.plant.parameters import ActuatorParameters, BenchParameters
from leactl.runfile.read.reader import Run
from tests.analysis.coupled import Truth
from tests.analysis.heated import Plant
from tests.coverage_of_intervals import efficiency as efficiencies
from tests.coverage_of_intervals.__main__ import true_values
from tests.coverage_of_intervals.plant import STEADY_S, current_loop_bandwidth, position_bandwidth
from tests.coverage_of_intervals.thermal import currents
from tests.loops import StepFigures, current_figures, figures, position_step

NOISE_RAD = 0.06  # standard deviation, on which the position's bandwidth depends


def truths(experiment: str, condition: str, result: Result) -> Mapping[str, float]:
    """True values of an experiment under a condition; of the efficiency over the points that its runs held."""
    file, _, _ = benchfile.load("emulated")
    assert file.emulated is not None
    loops = dict(file.emulated.bench)
    match experiment:
        case "current-step":
            loop = (loops[name] for name in ("current_loop_bandwidth", "setpoint_lead", "setpoint_lead_time"))
            return vars(current_figures(*loop)) | {"steady_state_error": 0.0}
        case "current-noise":
            return {"bandwidth": current_loop_bandwidth(loops)}
        case "position-step":
            return position_steps(ActuatorParameters.from_mapping(file.emulated.conditions[condition]), loops, result)
        case "position-noise":
            return {"bandwidth": position_bandwidth(loops, condition, NOISE_RAD, 1)}
        case "thermal":
            return Plant().known | currents(Plant()) | {"rmse": camera_noise()}
        case "efficiency":
            motor = file.emulated.conditions[condition]
            drag = motor["viscous_damping"], motor["coulomb_friction"]
            return efficiencies.true_values(
                Truth(b=drag[0], f=drag[1]), [grid for grid in result.grids if grid.condition == condition]
            )
    return true_values(condition)


def camera_noise() -> float:
    """What a fit without fault leaves of the camera's noise [K]: means of three places, windings two thirds active."""
    file, _, _ = benchfile.load("emulated-heated")
    assert file.emulated is not None
    places = file.emulated.temperature_noise_K / math.sqrt(3.0)
    return math.sqrt(0.5 * (places**2 * (4 / 9 + 1 / 9) + places**2))


def position_steps(motor: ActuatorParameters, loops: Mapping[str, float], result: Result) -> dict[str, float]:
    """Means over the trials, each from where friction stopped the one before, as the encoder has it.

    That moves the overshoot, a thousandth of a step, by a tenth of itself.
    """
    bench = BenchParameters.from_mapping(loops)
    by_level: dict[float, list[StepFigures]] = {}
    for jump, start, rest in trials(result):
        time, turned = position_step(jump, motor, bench, start=start, rest=rest)
        made = turned[time > STEADY_S].mean() - start  # friction may let go of it within the steady part
        by_level.setdefault(jump, []).append(figures(time, (turned - start) / made))
    names = ("rise_time", "overshoot", "settling_time")
    levels = [[np.mean([getattr(item, name) for item in found]) for name in names] for found in by_level.values()]
    return dict(zip(names, np.mean(levels, axis=0).tolist(), strict=True))


def trials(result: Result) -> Iterator[tuple[float, float, float]]:
    """Of each trial the angle asked for, the angle it began at, and for how long it had been asked for zero."""
    for path in result.runs:
        with Run.open(path) as run:
            angle = run.channel("angle", role="test")
            for step in run.steps:
                if step.name == "step":
                    rest = float(step.parameters["at_s"])
                    resting = (angle.time > step.start) & (angle.time < step.start + rest)
                    yield float(step.parameters["to_angle_rad"]), float(np.median(angle.values[resting])), rest
