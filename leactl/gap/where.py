"""Where the gap sits: channel by channel the distance of the model, and the smallest region that holds most of it."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from leactl.gap.diagnosis import Region, Where
from leactl.gap.record import Clocked, Record
from leactl.gap.replay.compared import Compared
from leactl.gap.smoothing import smooth
from leactl.quantities import UNITS

Array = npt.NDArray[np.float64]
MOST = 0.8  # of the squared residual that a region is to hold
BINS = 12
NARROW = 0.75  # of the data, above which a region says nothing
NEAR_FLOOR = 1.1
OTHER_UNITS = {"direction": "1", "frequency": "Hz", "time": "s", "time_since_reversal": "s"}


def where(records: Sequence[Record], channels: Sequence[Compared]) -> tuple[Where, ...]:
    """A line for each quantity, role and set-up, the largest gap over its floor first."""
    by_name = {record.name: record for record in records}
    grouped: dict[tuple[str, str, str], list[Compared]] = {}
    for one in channels:
        grouped.setdefault((one.quantity, one.role, one.mechanical), []).append(one)
    found = []
    for (quantity, role, mechanical), group in grouped.items():
        nominal, calibrated = (rms([one.squares(k) for one in group]) for k in (0, 1))
        floor = rms([one.floor_squares() for one in group])
        region, share = None, 0.0
        if calibrated > NEAR_FLOOR * floor:
            region, share = smallest_region([(by_name[one.run], one) for one in group])
        units = UNITS.get(quantity, "")
        found.append(Where(quantity, role, mechanical, units, nominal, calibrated, floor, region, share))
    return tuple(sorted(found, key=lambda item: -((item.calibrated_rms / max(item.floor_rms, 1e-300)) ** 2)))


def rms(squares: Sequence[Array]) -> float:
    """Root of the mean of several runs' squares."""
    return float(np.sqrt(np.mean(np.concatenate(list(squares)))))


def smallest_region(group: Sequence[tuple[Record, Compared]]) -> tuple[Region | None, float]:
    """Over all variables, the interval with the least data that holds most of the squared calibrated residual."""
    best: tuple[float, Region, float] | None = None
    for variable in variables(group):
        values, squares = [], []
        for record, one in group:
            series = variable_of(record, one, variable)
            if series is not None:
                values.append(series)
                squares.append(one.squares(1))
        if not values:
            continue
        interval = narrowest(np.concatenate(values), np.concatenate(squares))
        if interval is None:
            continue
        low, high, share, part = interval
        if part < NARROW and (best is None or part < best[0]):
            units = OTHER_UNITS.get(variable, UNITS.get(variable, ""))
            best = (part, Region(variable, low, high, units), share)
    return (None, 0.0) if best is None else (best[1], best[2])


def variables(group: Sequence[tuple[Record, Compared]]) -> list[str]:
    """What a region may be a stretch of in these runs."""
    found = ["time"]
    for record, _ in group:
        for clock in (record.fast, record.slow):
            if clock is not None:
                found += [quantity for quantity, role in clock.values if role == "test" and quantity not in found]
        if record.fast is not None and ("angle", "test") in record.fast.values:
            found += [name for name in ("direction", "time_since_reversal") if name not in found]
    return found


def variable_of(record: Record, one: Compared, variable: str) -> Array | None:
    """A variable at the samples of a compared channel."""
    if variable == "time":
        return one.time
    clock = record.fast
    if variable in ("direction", "time_since_reversal"):
        if clock is None or (speed := speed_of(clock)) is None:
            return None
        series = np.sign(speed) if variable == "direction" else since_reversal(speed, clock.interval)
        return np.interp(one.time, clock.time - clock.time[0], series)
    for at in (record.fast, record.slow):
        if at is not None and (values := at.get(variable)) is not None:
            return np.interp(one.time, at.time - at.time[0], values)
    return None


def speed_of(clock: Clocked) -> Array | None:
    """Speed from the angle."""
    angle = clock.get("angle")
    return smooth(np.diff(angle, prepend=angle[0]) / clock.interval, 4.0) if angle is not None else None


def since_reversal(speed: Array, interval: float) -> Array:
    """Time since the sign of the speed last changed."""
    turned = np.flatnonzero(np.diff(np.sign(speed), prepend=np.sign(speed[0])) != 0)
    last = np.zeros(len(speed), np.intp)
    last[turned] = turned
    return np.asarray((np.arange(len(speed)) - np.maximum.accumulate(last)) * interval, np.float64)


def narrowest(values: Array, squares: Array) -> tuple[float, float, float, float] | None:
    """Interval with the least data that holds most of the squares: low, high, share held and part of the data."""
    order = np.argsort(values, kind="stable")
    held = np.concatenate([[0.0], np.cumsum(squares[order])])
    if held[-1] <= 0.0 or values[order[0]] == values[order[-1]]:
        return None
    edges = np.linspace(0, len(order), BINS + 1).astype(np.intp)
    best: tuple[int, int] | None = None
    for first in range(BINS):
        for last in range(first + 1, BINS + 1):
            if held[edges[last]] - held[edges[first]] >= MOST * held[-1]:
                if best is None or last - first < best[1] - best[0]:
                    best = (first, last)
                break
    if best is None:
        return None
    first, last = best
    share = float((held[edges[last]] - held[edges[first]]) / held[-1])
    low, high = float(values[order[edges[first]]]), float(values[order[edges[last] - 1]])
    return low, high, share, (last - first) / BINS
