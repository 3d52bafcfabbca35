"""Settings of one thermal camera: the columns or pixels of its regions, and facts that its files do not state."""
# ruff: noqa: N815 (a unit keeps its letter)

import math
from datetime import date, timedelta, timezone
from typing import Annotated, Literal, Self
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, field_validator, model_validator

from leactl.driver.contract import MeasurableRange
from leactl.driver.file_records import RecordSettings
from leactl.tables.number_format import DetectableFormat
from leactl.units import known_units

STRICT = ConfigDict(frozen=True, extra="forbid")
Heading = Annotated[str, StringConstraints(strict=True, strip_whitespace=True, min_length=1)]
Pixel = Annotated[int, Field(strict=True, ge=0, le=20_000)]
Size = Annotated[int, Field(strict=True, ge=1, le=20_000)]
QUANTITIES = ("winding_temperature", "housing_temperature", "ambient_temperature")


class CameraRegion(BaseModel):
    """A region on the actuator: a column of a table, or a rectangle of the frames."""

    model_config = STRICT
    quantity: Literal["winding_temperature", "housing_temperature", "ambient_temperature"]
    column: Heading | None = None
    rows: tuple[Pixel, Pixel] | None = None  # first and last, from 0 at the top
    columns: tuple[Pixel, Pixel] | None = None  # first and last, from 0 at the left
    statistic: Literal["mean", "max", "min"] = "mean"  # of the pixels of the rectangle; a column is a statistic already

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        pixels = self.rows is not None and self.columns is not None
        if pixels == (self.column is not None) or (self.rows is None) != (self.columns is None):
            raise ValueError("give either column, or rows and columns")
        for name, span in (("rows", self.rows), ("columns", self.columns)):
            if span is not None and span[0] > span[1]:
                raise ValueError(f"{name}: the first, {span[0]}, is above the last, {span[1]}")
        return self


class StampSettings(BaseModel):
    """Column and meaning of the stamps; a setting that is None is detected, and an ambiguous file is refused."""

    model_config = STRICT
    column: Heading | None = None
    date_column: Heading | None = None
    line: Heading | None = None  # of frames: name of the time or number in a line above each frame
    kind: Literal["wall", "elapsed", "frame"] | None = None
    units: Literal["s", "ms", "us", "min", "h"] | None = None  # of a plain number
    # the first two for stamps such as 010:15:30:33, the last two for stamps such as 10:15
    colons: Literal["days_first", "fraction_last", "hours_minutes", "minutes_seconds"] | None = None
    date_order: Literal["ymd", "dmy", "mdy"] | None = None
    date: Annotated[str, StringConstraints(strict=True, pattern=r"^\d{4}-\d\d-\d\d$")] | None = None  # of the first row
    year: Annotated[int, Field(strict=True, ge=1990, le=2100)] | None = None  # of a day of the year
    zone: str | None = None  # of a wall clock whose stamps have none: Europe/Berlin, +08:00
    frame_rate_Hz: Annotated[float, Field(strict=True, gt=0, le=10_000, allow_inf_nan=False)] | None = None
    backward: Literal["refuse", "leave_out"] = "refuse"  # treatment of rows whose stamps go back

    @field_validator("zone")
    @classmethod
    def _known_zone(cls, value: str | None) -> str | None:
        if value is not None:
            zone_of(value)
        return value

    @field_validator("date")
    @classmethod
    def _real_date(cls, value: str | None) -> str | None:
        if value is not None:
            date.fromisoformat(value)
        return value


class ThermalCsvSettings(DetectableFormat, RecordSettings):
    """One camera with the regions of its exports."""

    regions: Annotated[dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")], CameraRegion], Field(min_length=1)]
    time: StampSettings = StampSettings()
    unit: Literal["degC", "degF", "K"] | None = None
    skip_lines: Annotated[int, Field(strict=True, ge=0, le=1000)] = 0  # at the head of a file, which hold no pixels
    index_column: bool | None = None  # whether the first cell of a row is its number or the label of a frame
    frame_size: tuple[Size, Size] | None = None  # rows and columns

    @model_validator(mode="after")
    def _one_form_of_file(self) -> Self:
        if len({region.column is None for region in self.regions.values()}) > 1:
            raise ValueError("regions: some are columns and some are pixels; one file has one form")
        needed = "time.line" if self.matrix else "time.column"
        if (self.time.line if self.matrix else self.time.column) is None and self.time.frame_rate_Hz is None:
            raise ValueError(f"time: {needed} or time.frame_rate_Hz is needed")
        if not self.matrix and (self.skip_lines or self.index_column is not None or self.frame_size is not None):
            raise ValueError("skip_lines, index_column and frame_size are of frames; the regions are columns")
        return self

    def shown(self) -> list[MeasurableRange]:
        """Return every region with an infinite range, because a record that comes after the run cannot trip a limit."""
        return [
            MeasurableRange(("regions", name, "quantity"), region.quantity, -math.inf, math.inf)
            for name, region in self.regions.items()
        ]

    @property
    def matrix(self) -> bool:
        """Whether the files have frames of pixels instead of a table of regions."""
        return all(region.column is None for region in self.regions.values())


def zone_of(name: str) -> timezone | ZoneInfo:
    """Return a time zone by its name or its offset from UTC.

    Raises
    ------
    ValueError : no time zone has that name.
    """
    try:
        if name[:1] in "+-" and len(name) == 6 and name[3] == ":" and (name[1:3] + name[4:]).isdigit():
            sign = -1 if name[0] == "-" else 1
            return timezone(sign * timedelta(hours=int(name[1:3]), minutes=int(name[4:])))
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise ValueError(f"zone {name!r} is not known; a name such as Europe/Berlin or +01:00 was expected") from None


UNIT_NAMES = {
    "degC": ("°c", "º c", "ºc", "℃", "degc", "deg c", "c", "celsius", "degrees celsius", "摄氏度", "섭씨", "摂氏"),
    "degF": ("°f", "ºf", "℉", "degf", "deg f", "f", "fahrenheit", "degrees fahrenheit", "华氏度", "화씨", "華氏"),
    "K": ("k", "°k", "kelvin", "开尔文"),
}
assert set(UNIT_NAMES) == set(known_units("winding_temperature"))


def unit_named(text: str) -> str | None:
    """Return the temperature unit that a text names; None if it names none."""
    lower_text = text.strip().lower()
    return next((unit for unit, names in UNIT_NAMES.items() if lower_text in names), None)
