"""Settings of one drive's recordings: columns of the signals, their units, and the sampling."""

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, PositiveInt, StringConstraints, model_validator

from leactl.driver.file_records import RecordSettings
from leactl.tables.number_format import DetectableFormat
from leactl.units import converter
from leactl_plugins.elmo.scales import CurrentConvention

STRICT = ConfigDict(frozen=True, extra="forbid")
Heading = Annotated[str, StringConstraints(strict=True, strip_whitespace=True, min_length=1)]
COUNTS = {
    "angle": ("counts", "count", "cnt"),
    "velocity": ("counts/s", "counts/sec", "count/s", "cnt/s", "cnt/sec"),
}
SHIPPED_RANGE = (-1_000_000_000, 1_000_000_000)  # counts, 0x607B as Elmo ships it (CANedsGoldV005_0)
CURRENTS = ("q_axis_current", "q_axis_current_reference", "d_axis_current")


class RecordedSignal(BaseModel):
    """One recorded signal."""

    model_config = STRICT
    column: Heading
    quantity: Literal[
        "q_axis_current",
        "q_axis_current_reference",
        "d_axis_current",
        "velocity",
        "velocity_reference",
        "angle",
        "angle_reference",
        "bus_voltage",
    ]
    units: str | None = None  # where the heading names none

    @model_validator(mode="after")
    def _known_units(self) -> Self:
        if self.units is not None and not self.takes(self.units):
            raise ValueError(f"units {self.units!r} do not measure {self.quantity}")
        return self

    @property
    def counted(self) -> tuple[str, ...]:
        """Names of units of encoder counts for this quantity; empty if it is not counted."""
        return COUNTS.get(self.quantity.removesuffix("_reference"), ())

    def takes(self, units: str) -> bool:
        """Return whether numbers in these units can be of this quantity."""
        return units in self.counted or converter(units, self.quantity) is not None


class ElmoRecorderCsvSettings(DetectableFormat, RecordSettings):
    """The recordings of one drive."""

    signals: Annotated[dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")], RecordedSignal], Field(min_length=1)]
    time_column: Heading | None = None
    time_units: Literal["s", "ms", "us"] | None = None  # where the heading names none
    # between rows, of files without stamps
    interval_s: Annotated[float, Field(strict=True, gt=0, le=10, allow_inf_nan=False)] | None = None
    current_convention: CurrentConvention = CurrentConvention.AMPLITUDE
    counts_per_turn: PositiveInt | None = None
    # counts, at whose ends the drive's position wraps; None: it does not wrap
    position_range: tuple[int, int] | None = SHIPPED_RANGE
    sign: Literal[-1, 1] = 1

    @model_validator(mode="after")
    def _has_time(self) -> Self:
        if (self.time_column is None) == (self.interval_s is None):
            raise ValueError("give either time_column or interval_s (the recorder's resolution times TS)")
        return self

    @model_validator(mode="after")
    def _has_a_range(self) -> Self:
        if self.position_range is not None and self.position_range[0] >= self.position_range[1]:
            low, high = self.position_range
            raise ValueError(f"position_range [{low}, {high}] counts: the lowest first, then the highest (0x607B)")
        return self
