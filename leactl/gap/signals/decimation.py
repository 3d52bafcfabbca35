"""A clock with fewer samples, for accelerations that an encoder's counts hide at the rate of a log."""

from dataclasses import replace

import numpy as np

from leactl.gap.signals.derived import channel_means
from leactl.gap.signals.record import Clocked


def decimated(clock: Clocked, factor: int) -> Clocked:
    """Return a clock with one sample for each `factor` samples of this one; a rest at the end is dropped.

    Of an angle that is logged at instants the last of these samples is kept. Every other channel, setpoints among them,
    becomes a mean over the longer interval, which ends at the stamp. A sample is valid if all samples that it stands
    for are.
    """
    rows = len(clock.time) // factor * factor
    ends = slice(factor - 1, rows, factor)
    values, means = {}, set()
    for key, measured in clock.values.items():
        quantity, role = key
        if quantity == "angle" and key not in clock.means:
            values[key] = measured[ends]
        else:
            series = measured if quantity.endswith("_reference") else channel_means(clock, quantity, role)
            assert series is not None
            values[key] = series[:rows].reshape(-1, factor).mean(axis=1)
            means.add(key)
    return replace(
        clock,
        time=clock.time[ends],
        interval=factor * clock.interval,
        values=values,
        valid={key: np.all(valid[:rows].reshape(-1, factor), axis=1) for key, valid in clock.valid.items()},
        measured={key: np.all(valid[:rows].reshape(-1, factor), axis=1) for key, valid in clock.measured.items()},
        means=means,
        fed=None if clock.fed is None else clock.fed[ends],
        decimation=factor * clock.decimation,
    )
