"""Steps of replays as multiples of the response times of a bench or servo, so that similar machines replay alike."""

import math

import numpy as np
import numpy.typing as npt

from leactl.model.nominal import BenchModel, Model

Array = npt.NDArray[np.float64]
SERVO_STEP = 0.1  # longest step of a servo's simulation, as a share of the servo's shortest response time
SERVO_MEMORY = 6.0  # multiple of a servo's longest response time after which its start has no influence
USUAL_INTERVAL_PERIODS = 0.45  # usual interval in periods of the fastest bandwidth: 6 % of a step remain after it
FEWEST_STEPS, MOST_STEPS = 4, 80  # steps of a replay: fewest in a usual interval or in a sample, most in a sample
MOST_DELAY = 12  # usual intervals, longest delay with which a drive may follow its reference
FILTER_MEMORY = 200  # usual intervals of the motion before a start that filters may remember


def usual_interval(bench: BenchModel, interval: float) -> float:
    """Return the interval [s] at which a log resolves the fastest loop or filter of a bench.

    interval : interval between the samples of a run [s], returned where a model has no loop and no filter.
    """
    optional = (bench.current_loop_bandwidth, bench.velocity_filter_bandwidth, bench.torque_filter_bandwidth)
    bandwidths = [bandwidth for bandwidth in optional if bandwidth is not None]
    return USUAL_INTERVAL_PERIODS / max(bandwidths) if bandwidths else interval


def samples(intervals: int, bench: BenchModel, interval: float) -> int:
    """Return the number of samples in a number of usual intervals, at least one."""
    return max(1, round(intervals * usual_interval(bench, interval) / interval))


def steps_in_sample(bench: BenchModel, interval: float) -> int:
    """Return the number of steps of a replay from one sample to the next."""
    # a rounding error makes no further step
    steps = math.ceil(FEWEST_STEPS * interval / usual_interval(bench, interval) - 1e-6)
    return min(max(FEWEST_STEPS, steps), MOST_STEPS)


def servo_times(model: Model, gain: Array, lightest: float, heaviest: float) -> tuple[float, float]:
    """Return the shortest and the longest response time [s] of servos of a model.

    Three times count: the time in which back-EMF and damping brake the axis, the time of its swing on the gain as a
    spring, and the time of its return to the reference against back-EMF and damping.

    gain : V/rad, gains of the servos.
    lightest, heaviest : kg*m^2, smallest and largest inertia of the load.
    """
    torque_constant, resistance = model.torque_constant or 0.0, model.phase_resistance or math.inf
    rotor_inertia, drive = model.rotor_inertia or 0.0, model.drive
    braking = (torque_constant * (torque_constant + (drive.damping if drive else 0.0))) / resistance + (
        model.viscous_damping or 0.0
    )
    braking_times = [(rotor_inertia + load) / braking if braking else math.inf for load in (lightest, heaviest)]
    highest_gain, lowest_gain = float(np.max(gain)), float(np.min(gain))
    swing_time = (
        math.sqrt((rotor_inertia + lightest) * resistance / (highest_gain * torque_constant))
        if highest_gain * torque_constant
        else math.inf
    )
    return_time = braking * resistance / (lowest_gain * torque_constant) if lowest_gain * torque_constant else 0.0
    return min(braking_times[0], swing_time), max(braking_times[1], return_time)
