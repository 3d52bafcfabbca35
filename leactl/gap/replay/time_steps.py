"""Steps of replays, as multiples of a bench's or servo's times, so that similar machines have similar replays."""

import math

import numpy as np
import numpy.typing as npt

from leactl.model.nominal import BenchModel, Model

Array = npt.NDArray[np.float64]
SERVO_STEP = 0.1  # longest step of a servo's simulation, as a share of the servo's shortest time
SERVO_MEMORY = 6.0  # multiple of a servo's longest time after which its start has no influence
USUAL_INTERVAL_PERIODS = 0.45  # usual interval in periods of the fastest bandwidth: 6 % of a step remain after it
FEWEST_STEPS, MOST_STEPS = 4, 80  # fewest in a usual interval and in a sample, most in a sample
MOST_DELAY = 12  # usual intervals by which a drive may follow late
FILTER_MEMORY = 200  # usual intervals of the motion before a start that filters may remember


def usual_interval(bench: BenchModel, interval: float) -> float:
    """Return the interval [s] at which a log resolves the fastest loop or filter of a bench.

    interval : between the samples of a run [s], returned where a model has no loop and no filter.
    """
    named = (bench.current_loop_bandwidth, bench.velocity_filter_bandwidth, bench.torque_filter_bandwidth)
    bandwidths = [bandwidth for bandwidth in named if bandwidth is not None]
    return USUAL_INTERVAL_PERIODS / max(bandwidths) if bandwidths else interval


def samples(intervals: int, bench: BenchModel, interval: float) -> int:
    """Return the number of samples in so many usual intervals, at least one."""
    return max(1, round(intervals * usual_interval(bench, interval) / interval))


def steps_in_sample(bench: BenchModel, interval: float) -> int:
    """Return the number of steps of a replay from one sample to the next."""
    # a rounding error makes no further step
    steps = math.ceil(FEWEST_STEPS * interval / usual_interval(bench, interval) - 1e-6)
    return min(max(FEWEST_STEPS, steps), MOST_STEPS)


def servo_times(model: Model, gain: Array, lightest: float, heaviest: float) -> tuple[float, float]:
    """Return the shortest and the longest response time [s] of servos of a model.

    Three times count: that in which back-EMF and damping brake the axis, that of its swing on the gain as a spring, and
    that of its return to the reference against back-EMF and damping.
    """
    constant, resistance = model.torque_constant or 0.0, model.phase_resistance or math.inf
    rotor, drive = model.rotor_inertia or 0.0, model.drive
    holding = (constant * (constant + (drive.damping if drive else 0.0))) / resistance + (model.viscous_damping or 0.0)
    slowing = [(rotor + load) / holding if holding else math.inf for load in (lightest, heaviest)]
    stiff, soft = float(np.max(gain)), float(np.min(gain))
    swinging = math.sqrt((rotor + lightest) * resistance / (stiff * constant)) if stiff * constant else math.inf
    homing = holding * resistance / (soft * constant) if soft * constant else 0.0
    return min(slowing[0], swinging), max(slowing[1], homing)
