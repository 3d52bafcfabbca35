"""Times by which replays are stepped: multiples of a bench's own, so that benches of any size are alike."""

import math

from leactl.model.nominal import BenchModel

PERIOD = 0.45  # usual interval, in periods of the fastest bandwidth: 6 % of a step is left after it
STEPS, MOST_STEPS = 4, 80  # in a usual interval and in a sample at least, and in a sample at most
LATEST = 12  # usual intervals by which a drive may follow late
REMEMBERED = 200  # usual intervals of the motion before a start that filters may remember


def usual_interval(bench: BenchModel, interval: float) -> float:
    """Interval [s] at which a log shows what the fastest loop or filter of a bench does.

    interval : between the samples of a run [s], which counts where a model names no loop and no filter.
    """
    named = (bench.current_loop_bandwidth, bench.velocity_filter_bandwidth, bench.torque_filter_bandwidth)
    bandwidths = [bandwidth for bandwidth in named if bandwidth is not None]
    return PERIOD / max(bandwidths) if bandwidths else interval


def samples(intervals: int, bench: BenchModel, interval: float) -> int:
    """Samples in so many usual intervals, at least one."""
    return max(1, round(intervals * usual_interval(bench, interval) / interval))


def steps_in_sample(bench: BenchModel, interval: float) -> int:
    """Steps of a replay from one sample to the next."""
    # a rounding error makes no further step
    steps = math.ceil(STEPS * interval / usual_interval(bench, interval) - 1e-6)
    return min(max(STEPS, steps), MOST_STEPS)
