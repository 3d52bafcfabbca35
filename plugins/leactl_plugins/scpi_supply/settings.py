"""Settings of one power supply: its model, its output, its load, and the limits of that output."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from leactl.driver.contract import DriverSettings
from leactl_plugins.scpi_supply.models import Dialect, dialect_of, models_of, output_trouble


class ScpiSupplySettings(DriverSettings):
    """One output of a supply at the end of a serial line or a socket."""

    dialect: Dialect
    model: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_./ -]*$", max_length=40)]  # 2nd field of *IDN?
    serial_number: Annotated[str, Field(max_length=40)] = ""  # 3rd field of *IDN?; the E36xx series leaves it 0
    output: Annotated[int, Field(strict=True, ge=1, le=9)] | None = None  # number, of a model with several outputs
    feeds: Literal["leads", "bus"]  # two leads of the role's motor, or the drives' DC link
    voltage_limit_V: Annotated[float, Field(strict=True, gt=0, le=1000, allow_inf_nan=False)]  # noqa: N815 (a unit keeps its letter)
    current_limit_A: Annotated[float, Field(strict=True, gt=0, le=1000, allow_inf_nan=False)]  # noqa: N815
    output_range: Literal["low", "high"] | None = None  # of supplies with two; None: as set at the instrument
    off_current_A: Annotated[float, Field(strict=True, gt=0, le=1, allow_inf_nan=False)] = 0.1  # noqa: N815
    period_s: Annotated[float, Field(strict=True, ge=0.2, le=60, allow_inf_nan=False)] = 1.0
    answer_s: Annotated[float, Field(strict=True, ge=0.05, le=5, allow_inf_nan=False)] = 0.3

    @model_validator(mode="after")
    def _has_ranges(self) -> "ScpiSupplySettings":
        if self.output_range is not None and self.dialect != "e36xx":
            raise ValueError(f"output_range is known of e36xx alone; with {self.dialect} set it at the instrument")
        return self

    @model_validator(mode="after")
    def _output_exists(self) -> "ScpiSupplySettings":
        known_dialect = dialect_of(self.model)
        if known_dialect not in (None, self.dialect):
            raise ValueError(f"{self.model} speaks {known_dialect}; {self.dialect} was given as its dialect")
        if known_dialect is None and self.dialect in ("e36300", "spd3303"):
            raise ValueError(
                f"{self.model} is no known model of {self.dialect}; {', '.join(models_of(self.dialect))} are"
            )
        if trouble := output_trouble(self.model, self.output):
            raise ValueError(trouble)
        return self
