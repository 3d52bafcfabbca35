"""Convert stamps of a camera's export to seconds: time of day, elapsed time or frame numbers, in all usual formats.

An ambiguous stamp, such as 01/02/2026, is refused with the name of the setting that decides.
"""

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
RowLocator = Callable[[int], str]
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

    time: Array  # s, shape (rows,); since the first day's midnight if the stamps are times of day
    midnight: datetime | None  # UTC moment of time zero; None if day or zone is unknown
    day: date | None  # of that midnight; None if unknown
    resolution: float  # s
    description: str  # how the stamps were understood


class StampParts(NamedTuple):
    """Parts of a stamp, without its fraction of a second."""

    day: tuple[int, int, int] | None  # in the order of the stamp
    fields: tuple[int, ...]  # of the time of day or elapsed time, between colons
    half_day: str  # "", "am" or "pm"
    zone: str


def looks_plain(text: str) -> bool:
    """Return whether a stamp is a plain number: elapsed time or a frame number."""
    return PLAIN.fullmatch(text.strip()) is not None


def read_stamps(texts: Sequence[str], settings: StampSettings, where: RowLocator) -> RowTimes:
    """Convert stamps with colons to seconds.

    Raises
    ------
    InputError : a stamp is invalid or ambiguous, or contradicts the settings.
    """
    if settings.colons == "fraction_last":
        texts = [".".join(text.rsplit(":", 1)) if text.count(":") == 3 else text for text in texts]
    stamp_texts, fractions, digits = without_fractions(texts)
    first_row_by_text = {stamp_text: row for row, stamp_text in reversed(list(enumerate(stamp_texts)))}
    stamps = {
        stamp_text: parse_stamp("".join(stamp_text), where(first_row_by_text[stamp_text]))
        for stamp_text in dict.fromkeys(stamp_texts)
    }
    date_by_day, order_text = read_days(stamps, settings, lambda stamp_text: where(first_row_by_text[stamp_text]))
    kind = kind_of(stamps, settings, where)
    base_date = base_day(set(date_by_day.values()), next(iter(stamps.values())), settings, kind)
    days_first = digits > 0 or settings.colons == "days_first"
    hours_first = two_fields_are_hours(stamps, settings, kind, digits, where)
    seconds = {}
    for stamp_text, stamp in stamps.items():
        stamp_date = date_by_day[stamp.day]
        days_since_base = (stamp_date - base_date).days if stamp_date is not None and base_date is not None else 0
        seconds[stamp_text] = days_since_base * DAY_S + clock_seconds(
            stamp, days_first, hours_first, where(first_row_by_text[stamp_text]), kind
        )
    time_s = np.array([seconds[stamp_text] for stamp_text in stamp_texts]) + fractions
    description = {"wall": "time of day", "elapsed": "elapsed time"}.get(kind, "time of day or elapsed time")
    if kind == "wall" and None in date_by_day.values():
        step = np.diff(time_s, prepend=time_s[0])
        # a row that is out of order may go back over midnight
        midnight_crossings = (step < -0.5 * DAY_S).astype(int) - (step > 0.5 * DAY_S)
        midnights_passed = np.cumsum(midnight_crossings)
        time_s = time_s + DAY_S * midnights_passed
        description += f", {int(midnights_passed[-1])} midnights passed"
    field_resolution = 60.0 if hours_first and all(len(stamp.fields) == 2 for stamp in stamps.values()) else 1.0
    resolution = 10.0**-digits if digits else field_resolution
    midnight, zone_text = midnight_of(base_date, {stamp.zone for stamp in stamps.values()}, settings, time_s, where)
    descriptions = [description, order_text, zone_text if kind == "wall" else "", f"resolved to {resolution:g} s"]
    is_wall_clock = kind == "wall"
    return RowTimes(
        time_s,
        midnight if is_wall_clock else None,
        base_date if is_wall_clock else None,
        resolution,
        ", ".join(filter(None, descriptions)),
    )


def without_fractions(texts: Sequence[str]) -> tuple[list[tuple[str, str]], Array, int]:
    """Split each stamp at its fraction; return texts before and after, fractions (n,) [s], and the most digits.

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
    InputError : the text is not a known form of date and time.
    """
    match = STAMP.fullmatch(text.strip())
    if match is None or (match["early"] and match["late"]):
        raise InputError(f"{where}: {text!r} is no date and time that is known")
    half_day = (match["early"] or match["late"] or "").lower().replace(".", "")
    half_day = {"上午": "am", "下午": "pm"}.get(half_day, half_day)
    day = (int(match["a"]), int(match["b"]), int(match["c"])) if match["a"] else None
    return StampParts(day, tuple(int(part) for part in match["clock"].split(":")), half_day, match["zone"] or "")


def read_days(
    stamps: dict[tuple[str, str], StampParts], settings: StampSettings, where: Callable[[tuple[str, str]], str]
) -> tuple[dict[tuple[int, int, int] | None, date | None], str]:
    """Convert days to dates by the only order of year, month and day that fits all; return them and the order as text.

    Raises
    ------
    InputError : no order fits, or several orders give different dates.
    """
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
    """Return the date of three numbers in an order; None if it is not a date from 1990 to 2100."""
    year, month, day_of_month = (day[index] for index in ORDERS[order])
    if year < 100:
        year += 2000
    try:
        return date(year, month, day_of_month) if 1990 <= year <= 2100 else None
    except ValueError:
        return None


def kind_of(stamps: dict[tuple[str, str], StampParts], settings: StampSettings, where: RowLocator) -> str:
    """Return the kind of the stamps: "wall", "elapsed", or "" if either is possible.

    Raises
    ------
    InputError : only some stamps have a date, or the stamps contradict the settings.
    """
    is_dated = any(stamp.day is not None or stamp.half_day for stamp in stamps.values())
    exceeds_a_day = any(len(stamp.fields) == 3 and stamp.fields[0] > 23 for stamp in stamps.values())
    if is_dated:
        if any((stamp.day is None) != (first_day(stamps) is None) for stamp in stamps.values()):
            raise InputError(f"{where(0)}: some stamps have a date and some have none")
        if settings.kind not in (None, "wall"):
            raise InputError(f"{where(0)}: a date or AM/PM stands there; time.kind says {settings.kind}")
        return "wall"
    if exceeds_a_day and settings.kind == "wall":
        raise InputError(f"{where(0)}: hours go past 23; time.kind says wall")
    return settings.kind or ("elapsed" if exceeds_a_day else "wall" if settings.date else "")


def first_day(stamps: dict[tuple[str, str], StampParts]) -> tuple[int, int, int] | None:
    """Return the day in the first stamp; None if it has none."""
    return next(iter(stamps.values())).day


def base_day(days: set[date | None], first: StampParts, settings: StampSettings, kind: str) -> date | None:
    """Return the date whose midnight is time zero; None if unknown."""
    known_days = [day for day in days if day is not None]
    if known_days:
        return min(known_days)
    if settings.date is not None and kind == "wall":
        return date.fromisoformat(settings.date)
    if len(first.fields) == 4 and settings.year is not None and kind == "wall":
        return date(settings.year, 1, 1) - timedelta(days=1)  # the first of January is day 1
    return None


def two_fields_are_hours(
    stamps: dict[tuple[str, str], StampParts], settings: StampSettings, kind: str, digits: int, where: RowLocator
) -> bool:
    """Return whether stamps such as 10:15 are hours and minutes instead of minutes and seconds.

    Raises
    ------
    InputError : both are possible, or the stamps contradict the settings.
    """
    two_field_stamp = next((stamp for stamp in stamps.values() if len(stamp.fields) == 2), None)
    if two_field_stamp is None:
        return False
    dated = any(stamp.day is not None or stamp.half_day for stamp in stamps.values())
    has_more_fields = any(len(stamp.fields) > 2 for stamp in stamps.values())  # such as 1:00:00 after 59:59
    text = ":".join(f"{part:02d}" for part in two_field_stamp.fields)
    if settings.colons in ("hours_minutes", "minutes_seconds"):
        are_hours = settings.colons == "hours_minutes"
    elif digits or has_more_fields or dated:
        are_hours = dated and not digits
    else:
        raise InputError(f"{where(0)}: {text} is hours and minutes or minutes and seconds; time.colons decides")
    if are_hours and digits:
        raise InputError(f"{where(0)}: {text} has a fraction of a second, which hours and minutes have not")
    if kind == "wall" and not are_hours:
        raise InputError(f"{where(0)}: {text} is minutes and seconds, which tell no time of day")
    return are_hours


def clock_seconds(stamp: StampParts, days_first: bool, hours_first: bool, where: str, kind: str) -> float:
    """Return seconds since midnight or since the start, without the fraction.

    Raises
    ------
    InputError : the stamp is not a time, or may begin with days or end with a fraction.
    """
    fields, days = stamp.fields, 0
    if len(fields) == 4 and not days_first:
        text = ":".join(f"{part:02d}" for part in fields)
        raise InputError(f"{where}: {text} begins with days or ends with a fraction; time.colons decides")
    if len(fields) == 4:
        days, fields = fields[0], fields[1:]
    if len(fields) == 2:
        fields = (*fields, 0) if hours_first else (0, *fields)
    hours, minutes, seconds = fields
    if stamp.half_day:
        if not 1 <= hours <= 12:
            raise InputError(f"{where}: hour {hours} with {stamp.half_day.upper()}; 1 to 12 was expected")
        hours = hours % 12 + (12 if stamp.half_day == "pm" else 0)
    if (minutes > 59 and (hours_first or len(stamp.fields) > 2)) or seconds > 59 or (kind == "wall" and hours > 23):
        raise InputError(f"{where}: {':'.join(map(str, stamp.fields))} is no time")
    return days * DAY_S + hours * 3600 + minutes * 60 + seconds


def midnight_of(
    base_date: date | None, zones: set[str], settings: StampSettings, time_s: Array, where: RowLocator
) -> tuple[datetime | None, str]:
    """Return time zero as a UTC moment (None if date or zone is unknown), and a description of the zone.

    Raises
    ------
    InputError : there are several zones, the zone is not known, or its clocks change within the record.
    """
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
    if base_date is None:
        return None, "no date"
    midnight = datetime.combine(base_date, time())
    if name is None:
        return None, "no zone"
    try:
        zone = zone_of(name)
    except ValueError as error:
        raise InputError(f"{where(0)}: {error}") from None
    moments = [midnight + timedelta(seconds=float(seconds)) for seconds in (time_s.min(), time_s.max())]
    offsets = {moment.replace(tzinfo=zone, fold=fold).utcoffset() for moment in moments for fold in (0, 1)}
    if len(offsets) > 1:
        message = f"the clocks of {name} change within the record; give time.zone as hours, such as +01:00"
        raise InputError(f"{where(0)}: {message}")
    offset = offsets.pop() or timedelta()
    return (midnight - offset).replace(tzinfo=UTC), f"zone {name}"


def read_plain(values: Array, heading_unit: str, settings: StampSettings, heading: str, where: RowLocator) -> RowTimes:
    """Convert plain numbers to seconds: elapsed time in a unit, or frame numbers.

    Raises
    ------
    InputError : neither the heading nor a setting says which, or they contradict each other.
    """
    stated_unit = heading_unit if heading_unit in SECONDS else None
    unit = settings.units or stated_unit
    if stated_unit is not None and stated_unit != unit:
        raise InputError(f"{where(0)}: elapsed time in {stated_unit}; time.units says {unit}")
    if settings.kind == "wall":
        raise InputError(f"{where(0)}: a plain number; time.kind says wall")
    if settings.kind != "frame" and unit is not None:
        steps = np.diff(np.unique(values[np.isfinite(values)]))
        resolution = SECONDS[unit] * float(steps.min()) if len(steps) else SECONDS[unit]
        return RowTimes(values * SECONDS[unit], None, None, min(resolution, 1.0), f"elapsed time in {unit}")
    if settings.kind == "elapsed":
        raise InputError(f"{where(0)}: elapsed time in no unit that {heading!r} names; time.units decides")
    if settings.kind != "frame":
        message = f"a plain number under {heading!r} may be elapsed time or a frame's number"
        raise InputError(f"{where(0)}: {message}; time.kind and time.units decide")
    return read_frames(values, settings, where)


def read_frames(values: Array, settings: StampSettings, where: RowLocator) -> RowTimes:
    """Convert frame numbers to seconds by the frame rate.

    Raises
    ------
    InputError : the settings have no frame rate, or a value is not a whole number.
    """
    if settings.frame_rate_Hz is None:
        raise InputError(f"{where(0)}: frames by number; time.frame_rate_Hz is needed")
    fractional_rows = np.flatnonzero(np.isfinite(values) & (values != np.round(values)))
    if len(fractional_rows):
        raise InputError(f"{where(int(fractional_rows[0]))}: {values[fractional_rows[0]]:g} is no frame number")
    frame_rate = settings.frame_rate_Hz
    return RowTimes(values / frame_rate, None, None, 1.0 / frame_rate, f"frame numbers at {frame_rate:g} Hz")
