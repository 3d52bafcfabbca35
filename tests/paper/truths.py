"""What is true of the shipped emulated benches, by experiment and result: closed forms and other solvers."""

import math
from collections.abc import Mapping

import numpy as np

from leactl.analysis.estimate import Grid, Result
from leactl.bench import benchfile
from leactl.emulation.parameters import ActuatorParameters, BenchParameters
from tests.analysis.coupled import Truth
from tests.analysis.heated import Plant
from tests.coverage_of_intervals.__main__ import true_values
from tests.coverage_of_intervals.plant import current_loop_bandwidth, position_bandwidth
from tests.coverage_of_intervals.thermal import currents
from tests.loops import current_figures, figures, position_step

STEPS_RAD = (math.pi / 4, math.pi / 2, 3 * math.pi / 4)
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
            return position_steps(ActuatorParameters.from_mapping(file.emulated.conditions[condition]), loops)
        case "position-noise":
            return {"bandwidth": position_bandwidth(loops, condition, NOISE_RAD, 1)}
        case "thermal":
            return Plant().known | currents(Plant())
        case "efficiency":
            return efficiencies(result.grids)
    return true_values(condition)


def position_steps(motor: ActuatorParameters, loops: Mapping[str, float]) -> dict[str, float]:
    """Means over the three angles of steps from rest at zero with an empty integrator.

    Without the overshoot: a thousandth of the step, it depends on where friction stopped the trial before.
    """
    bench = BenchParameters.from_mapping(loops)
    found = []
    for angle in STEPS_RAD:
        time, turned = position_step(angle, motor, bench)
        found.append(figures(time, turned / turned[-1]))
    return {name: float(np.mean([getattr(one, name) for one in found])) for name in ("rise_time", "settling_time")}


def efficiencies(grids: tuple[Grid, ...]) -> dict[str, float]:
    """Closed form at the setpoints of the points that were held, powers at 25 degC."""
    found = {}
    for grid in grids:
        speeds, levels = grid.axes.values()
        held = np.isfinite(np.array(grid.values["efficiency_1"]))
        w, i = np.meshgrid(np.abs(speeds), np.abs(levels), indexing="ij")
        truth, driving = Truth(), grid.name.endswith("driving")
        own, electrical, mechanical = truth.driving(w, i) if driving else truth.driven(w, i)
        share = mechanical / electrical if driving else electrical / mechanical
        lost = electrical - mechanical if driving else mechanical - electrical
        found |= {
            f"{grid.name}_efficiency": float(share[held].mean()),
            f"{grid.name}_efficiency_highest": float(share[held].max()),
            f"{grid.name}_loss": float(lost[held].mean()),
            f"{grid.name}_loss_copper": float((truth.r * own**2)[held].mean()),
            f"{grid.name}_loss_friction": float((truth.drag(w) * w)[held].mean()),
        }
    return found
