"""Check the order of a record's rows in time: find doubled rows, stamps that go back, and missing frames.

No row is added or moved. A row is kept or left out, and a remark says which rows are left out.
"""

from collections.abc import Callable
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError

Array = npt.NDArray[np.float64]
GAP_FACTOR = 1.5  # an interval longer than this multiple of the median interval is a gap
FEWEST_STAMP_STEPS = 10  # steps between stamps, from which the share of repeats or the frame rate is estimated
COARSE_REPEAT_SHARE = 0.2  # share of repeated stamps above which the stamps count as coarser than the frames


class Ordered(NamedTuple):
    """Rows whose times increase strictly."""

    time: Array  # (n,), s
    values: Array  # (n, channels)
    remarks: list[str]


def order_rows(
    time: Array,
    values: Array,
    location_of: Callable[[int], str],
    backward: Literal["refuse", "leave_out"] = "refuse",
    resolution: float = 0.0,
    frame_rate: float | None = None,
) -> Ordered:
    """Return the rows whose times increase strictly, with remarks on rows that are left out and on gaps.

    Parameters
    ----------
    time : (n,), s, stamps as they were read.
    values : (n, channels).
    location_of : returns file and line of a row, for messages.
    backward : whether a stamp that goes back is a fault, or its row is left out.
    resolution : s, smallest step of the stamps.
    frame_rate : Hz, of a camera whose stamps are coarser than its frames.

    Raises
    ------
    InputError : a row has no stamp, a stamp goes back, or rows with different values share a stamp.
    """
    rows_without_stamp = np.flatnonzero(~np.isfinite(time))
    if len(rows_without_stamp):
        raise InputError(f"{location_of(int(rows_without_stamp[0]))}: no stamp ({len(rows_without_stamp)} such rows)")
    remarks: list[str] = []
    latest = np.maximum.accumulate(time)
    backward_rows = np.flatnonzero(time < latest)
    if len(backward_rows) and backward == "refuse":
        row = int(backward_rows[0])
        step = time[row - 1] - time[row]
        hint = "; a 12-hour clock without AM/PM?" if 11 * 3600 < step < 12.1 * 3600 else ""
        raise InputError(
            f"{location_of(row)}: the stamp goes back by {step:.6g} s"
            f" ({len(backward_rows)} rows lie behind one before them){hint}"
            "; time.backward: leave_out leaves them out"
        )
    if len(backward_rows):
        remarks.append(
            f"{len(backward_rows)} rows whose stamps go back, from {location_of(int(backward_rows[0]))}: left out"
        )
        kept_rows = np.delete(np.arange(len(time)), backward_rows)
        time, values = time[kept_rows], values[kept_rows]
        location_of = partial(_where_kept, location_of, kept_rows)
    repeats = np.diff(time) == 0
    if len(repeats) >= FEWEST_STAMP_STEPS and repeats.mean() > COARSE_REPEAT_SHARE:
        time = times_by_count(time, resolution, frame_rate, location_of)
        remarks.append(f"{int(repeats.sum())} rows share a stamp with the one before: placed at {frame_rate:g} Hz")
        repeats = np.zeros(len(repeats), bool)
    doubled_rows = np.flatnonzero(repeats) + 1
    repeated_values = repeated_rows(values)
    if len(doubled_rows):
        without_reading = np.asarray(~np.isfinite(values).any(axis=1))  # two such rows do not conflict
        rows_before = doubled_rows - 1
        conflicting_rows = doubled_rows[
            ~(repeated_values[rows_before] | (without_reading[doubled_rows] & without_reading[rows_before]))
        ]
        if len(conflicting_rows):
            hint = "are stamps coarser than frames? time.frame_rate_Hz places them"
            raise InputError(
                f"{location_of(int(conflicting_rows[0]))}: the stamp stands twice, over different values; {hint}"
            )
        remarks.append(f"{len(doubled_rows)} rows doubled, the first at {location_of(int(doubled_rows[0]))}: left out")
        time, values, repeated_values = (
            np.delete(time, doubled_rows),
            np.delete(values, doubled_rows, axis=0),
            np.delete(repeated_values, doubled_rows - 1),
        )
    remarks += gap_remarks(time)
    if values.shape[1] > 1 and repeated_values.any():
        remarks.append(f"{int(repeated_values.sum())} rows repeat the one before in every column")
    return Ordered(time, values, remarks)


def _where_kept(location_of: Callable[[int], str], kept_rows: npt.NDArray[np.intp], row: int) -> str:
    """Return file and line of a row, by its index among the kept rows."""
    return location_of(int(kept_rows[row]))


def repeated_rows(values: Array) -> npt.NDArray[np.bool_]:
    """Return a mask (n - 1,) of the rows that equal the one before in every column; rows of NaN alone do not count."""
    earlier, later = values[:-1], values[1:]
    equal: npt.NDArray[np.bool_] = ((earlier == later) | (np.isnan(earlier) & np.isnan(later))).all(axis=1)
    return equal & np.isfinite(later).any(axis=1)


def times_by_count(
    time: Array, resolution: float, frame_rate: float | None, location_of: Callable[[int], str]
) -> Array:
    """Return times by counting frames at a constant rate, for stamps that are coarser than the frames.

    Raises
    ------
    InputError : no frame rate is given, the rows do not come at that rate, or the counted times differ from the stamps
        by more than their resolution: frames are missing.
    """
    if frame_rate is None:
        raise InputError(f"{location_of(1)}: stamps are coarser than frames; time.frame_rate_Hz places them")
    frame_numbers = np.arange(len(time), dtype=np.float64)
    # the first row of each stamp is closest to the moment at which the stamp changed
    first_rows = np.flatnonzero(np.diff(time) > 0) + 1
    frame_interval = 1.0 / frame_rate
    if len(first_rows) >= FEWEST_STAMP_STEPS:
        frame_interval = float(np.polyfit(frame_numbers[first_rows], time[first_rows], 1)[0])
    if not len(first_rows):
        raise InputError(f"{location_of(1)}: all {len(time)} rows have one stamp; stamps that go on were expected")
    if abs(frame_interval * frame_rate - 1.0) > 0.01:
        raise InputError(
            f"{location_of(1)}: {1.0 / frame_interval:.4g} rows a second; time.frame_rate_Hz says {frame_rate:g}"
        )
    start = float(np.mean(time[first_rows] + 0.5 * frame_interval - frame_interval * frame_numbers[first_rows]))
    times: Array = start + frame_interval * frame_numbers
    rows_off_stamp = np.flatnonzero(np.abs(times - time - 0.5 * resolution) > 0.5 * resolution + 1.5 / frame_rate)
    if len(rows_off_stamp):
        raise InputError(
            f"{location_of(int(rows_off_stamp[0]))}: counting frames at {1.0 / frame_interval:.4g} Hz leaves the"
            " stamps; frames are missing, and stamps this coarse do not tell which: export finer ones"
        )
    return times


def gap_remarks(time: Array) -> list[str]:
    """Return remarks on the median interval, and on gaps with the estimated number of missing frames."""
    if len(time) < 3:
        return []
    steps = np.diff(time)
    median_step = float(np.median(steps))
    gaps = np.flatnonzero(steps > GAP_FACTOR * median_step)
    if not len(gaps):
        return [f"one row each {median_step:.4g} s"]
    missing_frames = int(np.sum(np.round(steps[gaps] / median_step) - 1))
    longest = gaps[int(np.argmax(steps[gaps]))]
    longest_gap = f"the longest {steps[longest]:.4g} s, {time[longest] - time[0]:.6g} s after the first row"
    return [
        f"one row each {median_step:.4g} s",
        f"{len(gaps)} gaps, about {missing_frames} frames missing, {longest_gap}",
    ]
