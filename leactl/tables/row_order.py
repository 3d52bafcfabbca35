"""Put the rows of a record in order of time: doubled rows, backward stamps and missing frames.

No row is invented or moved: a row is kept or left out, and a remark says which.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError

Array = npt.NDArray[np.float64]
GAP = 1.5  # of the usual interval
FEWEST = 10  # rows or seconds that a rule is read from
COARSE = 0.2  # share of repeated stamps above which the stamps are taken to be coarser than the frames


class Ordered(NamedTuple):
    """Rows that increase strictly in time."""

    time: Array
    values: Array
    remarks: list[str]


def order_rows(
    time: Array,
    values: Array,
    where: Callable[[int], str],
    backward: Literal["refuse", "leave_out"] = "refuse",
    resolution: float = 0.0,
    frame_rate: float | None = None,
) -> Ordered:
    """Put rows in strictly increasing order of time, with remarks on what was left out.

    Parameters
    ----------
    time : (n,), s, as read.
    values : (n, channels).
    where : function of a row that returns file and line for messages.
    frame_rate : Hz, of a camera whose stamps are coarser than its frames.

    Raises
    ------
    InputError : a row without a stamp, a backward stamp, or one stamp for rows with different values.
    """
    without_stamp = np.flatnonzero(~np.isfinite(time))
    if len(without_stamp):
        raise InputError(f"{where(int(without_stamp[0]))}: no stamp ({len(without_stamp)} such rows)")
    remarks: list[str] = []
    latest = np.maximum.accumulate(time)
    backward_rows = np.flatnonzero(time < latest)
    if len(backward_rows) and backward == "refuse":
        row = int(backward_rows[0])
        step = time[row - 1] - time[row]
        half_day = "; a 12-hour clock without AM/PM?" if 11 * 3600 < step < 12.1 * 3600 else ""
        raise InputError(
            f"{where(row)}: the stamp goes back by {step:.6g} s"
            f" ({len(backward_rows)} rows lie behind one before them){half_day}"
            "; time.backward: leave_out leaves them out"
        )
    if len(backward_rows):
        remarks.append(f"{len(backward_rows)} rows whose stamps go back, from {where(int(backward_rows[0]))}: left out")
        time, values = np.delete(time, backward_rows), np.delete(values, backward_rows, axis=0)
    repeats = np.diff(time) == 0
    if len(repeats) >= FEWEST and repeats.mean() > COARSE:
        time = times_by_count(time, resolution, frame_rate, where)
        remarks.append(f"{int(repeats.sum())} rows share a stamp with the one before: placed at {frame_rate:g} Hz")
        repeats = np.zeros(len(repeats), bool)
    doubled = np.flatnonzero(repeats) + 1
    repeated_values = repeated_rows(values)
    if len(doubled):
        different = doubled[~repeated_values[doubled - 1]]
        if len(different):
            hint = "are stamps coarser than frames? time.frame_rate_Hz places them"
            raise InputError(f"{where(int(different[0]))}: the stamp stands twice, over different values; {hint}")
        remarks.append(f"{len(doubled)} rows doubled, the first at {where(int(doubled[0]))}: left out")
        time, values, repeated_values = (
            np.delete(time, doubled),
            np.delete(values, doubled, axis=0),
            np.delete(repeated_values, doubled - 1),
        )
    remarks += gap_remarks(time)
    if values.shape[1] > 1 and repeated_values.any():
        remarks.append(f"{int(repeated_values.sum())} rows repeat the one before in every column")
    return Ordered(time, values, remarks)


def repeated_rows(values: Array) -> npt.NDArray[np.bool_]:
    """Mask (n - 1,) of rows that equal the row before in every column; rows of only NaN do not count."""
    before, after = values[:-1], values[1:]
    equal: npt.NDArray[np.bool_] = ((before == after) | (np.isnan(before) & np.isnan(after))).all(axis=1)
    return equal & np.isfinite(after).any(axis=1)


def times_by_count(time: Array, resolution: float, frame_rate: float | None, where: Callable[[int], str]) -> Array:
    """Replace stamps of a coarse resolution by counting frames at a constant rate.

    Raises
    ------
    InputError : no frame rate is given, or the counted times leave the resolution of the stamps: frames are missing.
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


def gap_remarks(time: Array) -> list[str]:
    """Remarks on the usual interval, and on gaps with the estimated number of missing frames."""
    if len(time) < 3:
        return []
    steps = np.diff(time)
    usual = float(np.median(steps))
    wide = np.flatnonzero(steps > GAP * usual)
    if not len(wide):
        return [f"one row each {usual:.4g} s"]
    missing = int(np.sum(np.round(steps[wide] / usual) - 1))
    longest = wide[int(np.argmax(steps[wide]))]
    longest_gap = f"the longest {steps[longest]:.4g} s, {time[longest] - time[0]:.6g} s after the first row"
    return [f"one row each {usual:.4g} s", f"{len(wide)} gaps, about {missing} frames missing, {longest_gap}"]
