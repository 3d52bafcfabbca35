"""Rows of a foreign record in order of time: rows that came twice or went back, frames that never came.

Nothing is put in a gap and nothing is moved: a row is kept as it is or left out, and either is told.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError

Array = npt.NDArray[np.float64]
GAP = 1.5  # of the usual interval
FEWEST = 10  # rows or seconds that a rule is read from
COARSE = 0.2  # share of stamps that stand twice, above which the clock is coarser than the frames


class Ordered(NamedTuple):
    """Rows that increase strictly in time."""

    time: Array
    values: Array
    told: list[str]


def in_order(
    time: Array,
    values: Array,
    where: Callable[[int], str],
    backward: Literal["refuse", "leave_out"] = "refuse",
    resolution: float = 0.0,
    frame_rate: float | None = None,
) -> Ordered:
    """Rows in order of time, and what was found on the way.

    Parameters
    ----------
    time : (n,) s as read, not yet in order.
    values : (n, channels).
    where : says where a row stands.
    frame_rate : Hz, of a camera whose stamps are coarser than its frames.

    Raises
    ------
    InputError : a row without a stamp, stamps that go back, one stamp for several different rows.
    """
    lacking = np.flatnonzero(~np.isfinite(time))
    if len(lacking):
        raise InputError(f"{where(int(lacking[0]))}: no stamp ({len(lacking)} such rows)")
    told: list[str] = []
    ahead = np.maximum.accumulate(time)
    back = np.flatnonzero(time < ahead)
    if len(back) and backward == "refuse":
        row = int(back[0])
        step = time[row - 1] - time[row]
        half_day = "; a 12-hour clock without AM/PM?" if 11 * 3600 < step < 12.1 * 3600 else ""
        raise InputError(
            f"{where(row)}: the stamp goes back by {step:.6g} s ({len(back)} rows lie behind one before them){half_day}"
            "; time.backward: leave_out leaves them out"
        )
    if len(back):
        told.append(f"{len(back)} rows whose stamps go back, from {where(int(back[0]))}: left out")
        time, values = np.delete(time, back), np.delete(values, back, axis=0)
    same = np.diff(time) == 0
    if len(same) >= FEWEST and same.mean() > COARSE:
        time = spread(time, resolution, frame_rate, where)
        told.append(f"{int(same.sum())} rows share a stamp with the one before: placed at {frame_rate:g} Hz")
        same = np.zeros(len(same), bool)
    twice = np.flatnonzero(same) + 1
    alike = alike_rows(values)
    if len(twice):
        different = twice[~alike[twice - 1]]
        if len(different):
            hint = "are stamps coarser than frames? time.frame_rate_Hz places them"
            raise InputError(f"{where(int(different[0]))}: the stamp stands twice, over different values; {hint}")
        told.append(f"{len(twice)} rows doubled, the first at {where(int(twice[0]))}: left out")
        time, values, alike = np.delete(time, twice), np.delete(values, twice, axis=0), np.delete(alike, twice - 1)
    told += gaps(time)
    if values.shape[1] > 1 and alike.any():
        told.append(f"{int(alike.sum())} rows repeat the one before in every column")
    return Ordered(time, values, told)


def alike_rows(values: Array) -> npt.NDArray[np.bool_]:
    """Which rows, from the second on, hold what the one before holds; a row of nothing holds nothing."""
    before, after = values[:-1], values[1:]
    found: npt.NDArray[np.bool_] = ((before == after) | (np.isnan(before) & np.isnan(after))).all(axis=1)
    return found & np.isfinite(after).any(axis=1)


def spread(time: Array, resolution: float, frame_rate: float | None, where: Callable[[int], str]) -> Array:
    """Stamps that were cut to a coarse unit, placed by counting frames.

    Raises
    ------
    InputError : no frame rate is known, or counting from it leaves a stamp's own unit: frames are missing.
    """
    if frame_rate is None:
        raise InputError(f"{where(1)}: stamps are coarser than frames; time.frame_rate_Hz places them")
    count = np.arange(len(time), dtype=np.float64)
    turns = np.flatnonzero(np.diff(time) > 0) + 1  # the frame that comes first under a new stamp is the youngest there
    slope = 1.0 / frame_rate
    if len(turns) >= FEWEST:
        slope = float(np.polyfit(count[turns], time[turns], 1)[0])
    if not len(turns) or abs(slope * frame_rate - 1.0) > 0.01:
        raise InputError(f"{where(1)}: {1.0 / slope:.4g} rows a second; time.frame_rate_Hz says {frame_rate:g}")
    start = float(np.mean(time[turns] + 0.5 * slope - slope * count[turns]))
    placed: Array = start + slope * count
    beyond = np.flatnonzero(np.abs(placed - time - 0.5 * resolution) > 0.5 * resolution + 1.5 / frame_rate)
    if len(beyond):
        raise InputError(
            f"{where(int(beyond[0]))}: counting frames at {1.0 / slope:.4g} Hz leaves the stamps; frames are missing,"
            " and stamps this coarse do not tell which: export finer ones"
        )
    return placed


def gaps(time: Array) -> list[str]:
    """Where frames are missing."""
    if len(time) < 3:
        return []
    steps = np.diff(time)
    usual = float(np.median(steps))
    wide = np.flatnonzero(steps > GAP * usual)
    if not len(wide):
        return [f"one row each {usual:.4g} s"]
    missing = int(np.sum(np.round(steps[wide] / usual) - 1))
    longest = wide[int(np.argmax(steps[wide]))]
    told = f"the longest {steps[longest]:.4g} s, {time[longest] - time[0]:.6g} s after the first row"
    return [f"one row each {usual:.4g} s", f"{len(wide)} gaps, about {missing} frames missing, {told}"]
