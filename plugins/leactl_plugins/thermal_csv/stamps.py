"""Convert stamps of a camera's export to seconds: time of day, elapsed time or frame numbers, in all usual formats.

An ambiguous stamp, such as 01/02/2026, is refused with the name of the setting that decides.
"""

import math
import re
from collections.abc import Callable, Sequence
from datetime import UTC, date, datetime, time, timedelta
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.units import SECONDS
from leactl_plugins.thermal_csv.settings import StampSettings, zone_of

Array = npt.NDArray[np.float64]
Where = Callable[[int], str]
DAY_S = 86400.0
PLAIN = re.compile(r"[+-]?[0-9][0-9.,' ]*(?:[eE][+-]?[0-9]+)?")
FRACTION = re.compile(r"(.*:[0-9]{2})[.,]([0-9]{1,9})(.*)", re.DOTALL)
STAMP = re.compile(
    r"(?:(?P<a>[0-9]{1,4})[-/.年](?P<b>[0-9]{1,2})[-/.月](?P<c>[0-9]{1,4})日?[T ]*)?"
    r"(?P<early>上午|下午|[AaPp]\.?[Mm]\.?)?\s*"
    r"(?P<clock>[0-9]{1,3}(?::[0-9]{1,3}){1,3})"
    r"\s*(?P<late>上午|下午|[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|UTC|[+-][0-9]{2}:?[0-9]{2})?"
)
ORDERS = {"ymd": (0, 1, 2), "dmy": (2, 1, 0), "mdy": (2, 0, 1)}


class RowTimes(NamedTuple):
    """Times of the rows of one file."""

    time: Array  # s; of the first day's midnight where the clock is a wall clock
    midnight: datetime | None  # UTC moment of time zero, where day and zone are known
    day: date | None  # of that midnight, if it is known
    resolution: float  # s
    description: str


class StampParts(NamedTuple):
    """Parts of a stamp, without its fraction of a second."""

    day: tuple[int, int, int] | None  # in the order of the stamp
    fields: tuple[int, ...]  # of the time, between colons
    half: str  # "", "am" or "pm"
    zone: str


def looks_plain(text: str) -> bool:
    """Return whether a stamp is a plain number: elapsed time or a frame number."""
    return PLAIN.fullmatch(text.strip()) is not None


def read_stamps(texts: Sequence[str], settings: StampSettings, where: Where) -> RowTimes:
    """Convert stamps with colons to seconds.

    Raises
    ------
    InputError : a stamp is invalid or ambiguous.
    """
    if settings.colons == "fraction_last":
        texts = [".".join(text.rsplit(":", 1)) if text.count(":") == 3 else text for text in texts]
    stamp_texts, fractions, digits = without_fractions(texts)
    first_rows = {key: row for row, key in reversed(list(enumerate(stamp_texts)))}
    stamps = {key: parse_stamp("".join(key), where(first_rows[key])) for key in dict.fromkeys(stamp_texts)}
    day_of, order_text = read_days(stamps, settings, lambda key: where(first_rows[key]))
    kind = kind_of(stamps, settings, where)
    base = base_day(set(day_of.values()), next(iter(stamps.values())), settings, kind)
    days_first = digits > 0 or settings.colons == "days_first"
    hours_first = two_fields_are_hours(stamps, settings, kind, digits, where)
    seconds = {}
    for key, stamp in stamps.items():
        day = day_of[stamp.day]
        days = (day - base).days if day is not None and base is not None else 0
        seconds[key] = days * DAY_S + clock_seconds(stamp, days_first, hours_first, where(first_rows[key]), kind)
    time_s = np.array([seconds[key] for key in stamp_texts]) + fractions
    description = {"wall": "time of day", "elapsed": "elapsed time"}.get(kind, "time of day or elapsed time")
    if kind == "wall" and None in day_of.values():
        step = np.diff(time_s, prepend=time_s[0])
        over = (step < -0.5 * DAY_S).astype(int) - (step > 0.5 * DAY_S)  # a row out of order goes back over midnight
        passed = np.cumsum(over)
        time_s = time_s + DAY_S * passed
        description += f", {int(passed[-1])} midnights passed"
    field_resolution = 60.0 if hours_first and all(len(stamp.fields) == 2 for stamp in stamps.values()) else 1.0
    resolution = 10.0**-digits if digits else field_resolution
    midnight, zone_text = midnight_of(base, {stamp.zone for stamp in stamps.values()}, settings, time_s, where)
    descriptions = [description, order_text, zone_text if kind == "wall" else "", f"resolved to {resolution:g} s"]
    wall = kind == "wall"
    return RowTimes(
        time_s, midnight if wall else None, base if wall else None, resolution, ", ".join(filter(None, descriptions))
    )


def without_fractions(texts: Sequence[str]) -> tuple[list[tuple[str, str]], Array, int]:
    """Split each stamp at its fraction; returns texts before and after, fractions (n,) [s], and the most digits.

    Few stamps of a long record differ in more than their fraction; only those are parsed.
    """
    stamp_texts: list[tuple[str, str]] = []
    fractions = np.zeros(len(texts))
    digits = 0
    for row, text in enumerate(texts):
        match = FRACTION.fullmatch(text)
        stamp_texts.append((match[1], match[3]) if match else (text, ""))
        if match:
            digits = max(digits, len(match[2]))
            fractions[row] = int(match[2]) * 10.0 ** -len(match[2])
    return stamp_texts, fractions, digits


def parse_stamp(text: str, where: str) -> StampParts:
    """Parse one stamp.

    Raises
    ------
    InputError : it is no date and time.
    """
    match = STAMP.fullmatch(text.strip())
    if match is None or (match["early"] and match["late"]):
        raise InputError(f"{where}: {text!r} is no date and time that is known")
    half = (match["early"] or match["late"] or "").lower().replace(".", "")
    half = {"上午": "am", "下午": "pm"}.get(half, half)
    day = (int(match["a"]), int(match["b"]), int(match["c"])) if match["a"] else None
    return StampParts(day, tuple(int(part) for part in match["clock"].split(":")), half, match["zone"] or "")


def read_days(
    stamps: dict[tuple[str, str], StampParts], settings: StampSettings, where: Callable[[tuple[str, str]], str]
) -> tuple[dict[tuple[int, int, int] | None, date | None], str]:
    """Convert days to dates by the only order of year, month and day that fits all; also returns the order as text."""
    days = {stamp.day: key for key, stamp in stamps.items()}
    readings: dict[str, dict[tuple[int, int, int] | None, date | None]] = {}
    for order in ORDERS if settings.date_order is None else (settings.date_order,):
        dates = {day: None if day is None else date_in(order, day) for day in days}
        if all(day_read is not None for day, day_read in dates.items() if day is not None):
            readings[order] = dates
    if not readings:
        first = next(day for day in days if day is not None)
        stated_order = f" in the order {settings.date_order}" if settings.date_order else ""
        raise InputError(f"{where(days[first])}: {'/'.join(map(str, first))} is no date{stated_order}")
    (order, dates), *other_readings = readings.items()
    for other_order, other_dates in other_readings:
        for day in days:
            if dates[day] != other_dates[day]:
                day_text = "/".join(map(str, day or ()))
                message = f"{day_text} reads {dates[day]} ({order}) or {other_dates[day]} ({other_order})"
                raise InputError(f"{where(days[day])}: {message}; time.date_order decides")
    return dates, f"dates as {order}" if any(day is not None for day in days) else ""


def date_in(order: str, day: tuple[int, int, int]) -> date | None:
    """A date from three numbers in an order; None if it is no date from 1990 to 2100."""
    year, month, number = (day[index] for index in ORDERS[order])
    if year < 100:
        year += 2000
    try:
        return date(year, month, number) if 1990 <= year <= 2100 else None
    except ValueError:
        return None


def kind_of(stamps: dict[tuple[str, str], StampParts], settings: StampSettings, where: Where) -> str:
    """Kind of the stamps: "wall", "elapsed", or "" if either is possible."""
    dated = any(stamp.day is not None or stamp.half for stamp in stamps.values())
    past_a_day = any(len(stamp.fields) == 3 and stamp.fields[0] > 23 for stamp in stamps.values())
    if dated:
        if any((stamp.day is None) != (first_day(stamps) is None) for stamp in stamps.values()):
            raise InputError(f"{where(0)}: some stamps have a date and some have none")
        if settings.kind not in (None, "wall"):
            raise InputError(f"{where(0)}: a date or AM/PM stands there; time.kind says {settings.kind}")
        return "wall"
    if past_a_day and settings.kind == "wall":
        raise InputError(f"{where(0)}: hours go past 23; time.kind says wall")
    return settings.kind or ("elapsed" if past_a_day else "wall" if settings.date else "")


def first_day(stamps: dict[tuple[str, str], StampParts]) -> tuple[int, int, int] | None:
    """The day in the first stamp; None if it has none."""
    return next(iter(stamps.values())).day


def base_day(days: set[date | None], first: StampParts, settings: StampSettings, kind: str) -> date | None:
    """The date whose midnight is time zero; None if unknown."""
    dated = [day for day in days if day is not None]
    if dated:
        return min(dated)
    if settings.date is not None and kind == "wall":
        return date.fromisoformat(settings.date)
    if len(first.fields) == 4 and settings.year is not None and kind == "wall":
        return date(settings.year, 1, 1) - timedelta(days=1)  # the first of January is day 1
    return None


def two_fields_are_hours(
    stamps: dict[tuple[str, str], StampParts], settings: StampSettings, kind: str, digits: int, where: Where
) -> bool:
    """Return whether stamps such as 10:15 are hours and minutes instead of minutes and seconds.

    Raises
    ------
    InputError : both are possible, or they are minutes and seconds although a time of day is needed.
    """
    short = next((stamp for stamp in stamps.values() if len(stamp.fields) == 2), None)
    if short is None:
        return False
    dated = any(stamp.day is not None or stamp.half for stamp in stamps.values())
    whole_hours = any(len(stamp.fields) > 2 for stamp in stamps.values())  # 59:59 and then 1:00:00
    text = ":".join(f"{part:02d}" for part in short.fields)
    if settings.colons in ("hours_minutes", "minutes_seconds"):
        hours = settings.colons == "hours_minutes"
    elif digits or whole_hours or dated:
        hours = dated and not digits
    else:
        raise InputError(f"{where(0)}: {text} is hours and minutes or minutes and seconds; time.colons decides")
    if hours and digits:
        raise InputError(f"{where(0)}: {text} has a fraction of a second, which hours and minutes have not")
    if kind == "wall" and not hours:
        raise InputError(f"{where(0)}: {text} is minutes and seconds, which tell no time of day")
    return hours


def clock_seconds(stamp: StampParts, days_first: bool, hours_first: bool, where: str, kind: str) -> float:
    """Seconds since midnight or since the start, without the fraction."""
    fields, days = stamp.fields, 0
    if len(fields) == 4 and not days_first:
        text = ":".join(f"{part:02d}" for part in fields)
        raise InputError(f"{where}: {text} begins with days or ends with a fraction; time.colons decides")
    if len(fields) == 4:
        days, fields = fields[0], fields[1:]
    if len(fields) == 2:
        fields = (*fields, 0) if hours_first else (0, *fields)
    hours, minutes, seconds = fields
    if stamp.half:
        if not 1 <= hours <= 12:
            raise InputError(f"{where}: hour {hours} with {stamp.half.upper()}; 1 to 12 was expected")
        hours = hours % 12 + (12 if stamp.half == "pm" else 0)
    if (minutes > 59 and (hours_first or len(stamp.fields) > 2)) or seconds > 59 or (kind == "wall" and hours > 23):
        raise InputError(f"{where}: {':'.join(map(str, stamp.fields))} is no time")
    return days * DAY_S + hours * 3600 + minutes * 60 + seconds


def midnight_of(
    base: date | None, zones: set[str], settings: StampSettings, time_s: Array, where: Where
) -> tuple[datetime | None, str]:
    """Time zero as a UTC moment (None without date or zone), and a description of the zone."""
    if len(zones) > 1:
        raise InputError(f"{where(0)}: stamps of several zones: {', '.join(sorted(zones))}")
    zone_in_stamp = next(iter(zones))
    name = (
        zone_in_stamp
        if zone_in_stamp[:1] in ("+", "-") and zone_in_stamp
        else "+00:00"
        if zone_in_stamp
        else settings.zone
    )
    name = f"{name[:3]}:{name[3:]}" if name and name[0] in "+-" and ":" not in name else name
    if base is None:
        return None, "no date"
    midnight = datetime.combine(base, time())
    if name is None:
        return None, "no zone"
    try:
        zone = zone_of(name)
    except ValueError as error:
        raise InputError(f"{where(0)}: {error}") from None
    moments = [midnight + timedelta(seconds=float(at)) for at in (time_s.min(), time_s.max())]
    offsets = {moment.replace(tzinfo=zone, fold=fold).utcoffset() for moment in moments for fold in (0, 1)}
    if len(offsets) > 1:
        message = f"the clocks of {name} change within the record; give time.zone as hours, such as +01:00"
        raise InputError(f"{where(0)}: {message}")
    offset = offsets.pop() or timedelta()
    return (midnight - offset).replace(tzinfo=UTC), f"zone {name}"


def read_plain(values: Array, heading_unit: str, settings: StampSettings, heading: str, where: Where) -> RowTimes:
    """Convert plain numbers to seconds: elapsed time in a unit, or frame numbers.

    Raises
    ------
    InputError : neither the heading nor a setting says which, or they contradict.
    """
    named = heading_unit if heading_unit in SECONDS else None
    unit = settings.units or named
    if named is not None and named != unit:
        raise InputError(f"{where(0)}: elapsed time in {named}; time.units says {unit}")
    if settings.kind == "wall":
        raise InputError(f"{where(0)}: a plain number; time.kind says wall")
    if settings.kind != "frame" and unit is not None:
        spread = np.diff(np.unique(values[np.isfinite(values)]))
        resolution = SECONDS[unit] * float(spread.min()) if len(spread) else SECONDS[unit]
        return RowTimes(values * SECONDS[unit], None, None, min(resolution, 1.0), f"elapsed time in {unit}")
    if settings.kind == "elapsed":
        raise InputError(f"{where(0)}: elapsed time in no unit that {heading!r} names; time.units decides")
    if settings.kind != "frame":
        message = f"a plain number under {heading!r} may be elapsed time or a frame's number"
        raise InputError(f"{where(0)}: {message}; time.kind and time.units decide")
    return read_frames(values, settings, where)


def read_frames(values: Array, settings: StampSettings, where: Where) -> RowTimes:
    """Convert frame numbers to seconds by the frame rate."""
    if settings.frame_rate_Hz is None:
        raise InputError(f"{where(0)}: frames by number; time.frame_rate_Hz is needed")
    wrong = np.flatnonzero(values != np.round(values))
    if len(wrong) and math.isfinite(values[wrong[0]]):
        raise InputError(f"{where(int(wrong[0]))}: {values[wrong[0]]:g} is no frame number")
    rate = settings.frame_rate_Hz
    return RowTimes(values / rate, None, None, 1.0 / rate, f"frame numbers at {rate:g} Hz")
