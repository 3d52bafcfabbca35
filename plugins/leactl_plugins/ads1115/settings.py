"""Settings of one ADS1115 and of the sensors at its inputs."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from leactl.driver.contract import DriverSettings, MeasurableRange
from leactl.quantities import ROLES, UNITS

CONVERSION, CONFIG = 0x00, 0x01  # registers
START = 0x8000  # bit OS: written, it starts a conversion; read, it says that none is running
SINGLE_SHOT = 0x0100
COMPARATOR_OFF = 0x0003  # both bits of COMP_QUE
MUX = {"A0-A1": 0, "A0-A3": 1, "A1-A3": 2, "A2-A3": 3, "A0": 4, "A1": 5, "A2": 6, "A3": 7}
RANGES_V = {6.144: 0, 4.096: 1, 2.048: 2, 1.024: 3, 0.512: 4, 0.256: 5}
RATES_SPS = (8, 16, 32, 64, 128, 250, 475, 860)
TARE_SHARE = 0.05  # of the range: more than the drift of a zero, and less than a considerable load
Volts = Annotated[float, Field(strict=True, ge=-6.144, le=6.144)]


class AdcInput(BaseModel):
    """One input and the sensor behind it: value = sign x scale_per_V x (voltage - offset_V)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    quantity: str
    role: str
    location: str = ""
    pins: Literal["A0-A1", "A0-A3", "A1-A3", "A2-A3", "A0", "A1", "A2", "A3"]
    range_V: float = 4.096  # noqa: N815 (a unit keeps its letter)
    rate_sps: Literal[8, 16, 32, 64, 128, 250, 475, 860] = 860
    offset_V: Annotated[float, Field(strict=True, ge=-6.144, le=6.144)] = 0.0  # noqa: N815
    scale_per_V: Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]  # noqa: N815
    sign: Literal[-1, 1] = 1
    low_V: Volts | None = None  # noqa: N815 (below and above these the sensor is at its rail, and its reading a fault)
    high_V: Volts | None = None  # noqa: N815
    tare_limit_V: Annotated[float, Field(strict=True, gt=0, le=6.144)] | None = None  # noqa: N815

    @property
    def window_V(self) -> tuple[float, float]:  # noqa: N802
        """Lowest and highest valid voltage [V]: inside the range's end codes and the sensor's rails."""
        volts_per_count = self.range_V / 32768
        low, high = -self.range_V + volts_per_count, self.range_V - 2 * volts_per_count
        return (low if self.low_V is None else max(low, self.low_V)), (
            high if self.high_V is None else min(high, self.high_V)
        )

    @property
    def most_tare_V(self) -> float:  # noqa: N802
        """Largest distance of a tared zero from `offset_V` [V]."""
        return TARE_SHARE * self.range_V if self.tare_limit_V is None else self.tare_limit_V

    def value_of(self, volts: float) -> float:
        """Return the value of the sensor's quantity at a voltage [V]."""
        return self.sign * self.scale_per_V * (volts - self.offset_V)

    @model_validator(mode="after")
    def _zero_in_window(self) -> "AdcInput":
        low, high = self.window_V
        if not low < high:
            raise ValueError(f"low_V to high_V leave nothing of the range of +-{self.range_V:g} V")
        return self

    @field_validator("quantity")
    @classmethod
    def _known_quantity(cls, value: str) -> str:
        if value not in UNITS:
            raise ValueError(f"not a quantity of the vocabulary; known: {', '.join(sorted(UNITS))}")
        return value

    @field_validator("range_V")
    @classmethod
    def _known_range(cls, value: float) -> float:
        if value not in RANGES_V:
            raise ValueError(f"expected one of {', '.join(map(str, RANGES_V))} V")
        return value

    @field_validator("role")
    @classmethod
    def _known_role(cls, value: str) -> str:
        if value not in ROLES:
            raise ValueError(f"expected one of {', '.join(ROLES)}")
        return value


class Ads1115Settings(DriverSettings):
    """Address and inputs; several inputs are converted in turn."""

    address: Literal[0x48, 0x49, 0x4A, 0x4B] = 0x48
    inputs: Annotated[tuple[AdcInput, ...], Field(min_length=1, max_length=8)]

    @property
    def bus_address(self) -> int:
        """The I2C address."""
        return self.address

    def shown(self) -> list[MeasurableRange]:
        """Return the measurable range of each input."""
        ranges = []
        for index, adc_input in enumerate(self.inputs):
            low, high = sorted(adc_input.value_of(volts) for volts in adc_input.window_V)
            ranges.append(MeasurableRange(("inputs", index), adc_input.quantity, low, high))
        return ranges

    @field_validator("inputs")
    @classmethod
    def _names_differ(cls, value: tuple[AdcInput, ...]) -> tuple[AdcInput, ...]:
        names = [adc_input.name for adc_input in value]
        if len(set(names)) != len(names):
            raise ValueError(f"two inputs share a name among {', '.join(names)}")
        return value
