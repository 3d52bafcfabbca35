"""A clock with fewer samples, for accelerations that an encoder's counts hide at the rate of a log."""

from dataclasses import replace

import numpy as np

from leactl.gap.signals.derived import averaged
from leactl.gap.signals.record import Clocked


def decimated(clock: Clocked, factor: int) -> Clocked:
    """Return a clock of every so manieth sample; what is left over at the end of the run is dropped.

    An angle keeps its instants. All else becomes a mean over the longer interval that ends at the stamp, setpoints
    among them. A sample is valid where all are that it stands for.
    """
    if factor == 1:
        return clock
    rows = len(clock.time) // factor * factor
    ends = slice(factor - 1, rows, factor)
    values, means = {}, set()
    for key, measured in clock.values.items():
        quantity, role = key
        if quantity == "angle" and key not in clock.means:
            values[key] = measured[ends]
        else:
            series = measured if quantity.endswith("_reference") else averaged(clock, quantity, role)
            assert series is not None
            values[key] = series[:rows].reshape(-1, factor).mean(axis=1)
            means.add(key)
    return replace(
        clock,
        time=clock.time[ends],
        interval=factor * clock.interval,
        values=values,
        valid={key: np.all(valid[:rows].reshape(-1, factor), axis=1) for key, valid in clock.valid.items()},
        means=means,
        fed=None if clock.fed is None else clock.fed[ends],
        decimation=factor * clock.decimation,
    )
