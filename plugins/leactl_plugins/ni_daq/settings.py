"""Settings of one NI converter and of the line-to-line voltages at its inputs."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from leactl.driver.contract import DriverSettings, MeasurableRange
from leactl.driver.far_end import PAIRS

MOST_SAMPLES = 200_000_000  # of a finite acquisition, whose buffer holds all of them


class DaqInput(BaseModel):
    """One input and its sensor: value = sign x scale_per_V x voltage."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    quantity: Literal["phase_voltage_ab", "phase_voltage_bc", "phase_voltage_ca"]
    role: Literal["test", "load"] = "test"
    channel: Annotated[str, Field(pattern=r"^ai[0-9]{1,3}$")]
    terminals: Literal["differential", "rse", "nrse"] = "differential"
    range_V: Annotated[float, Field(strict=True, gt=0, le=100)] = 10.0  # noqa: N815 (the device takes the next that it has)
    scale_per_V: Annotated[float, Field(strict=True, gt=0, le=1e4)] = 1.0  # noqa: N815 (of a divider before the input)
    sign: Literal[-1, 1] = 1

    @property
    def pair(self) -> int:
        """Index of the quantity among the three pairs of leads."""
        return PAIRS.index(self.quantity)


class NiDaqSettings(DriverSettings):
    """Device, clock and inputs; all inputs are sampled by one clock, one after the other."""

    library: Literal["nidaqmx", "emulated"]  # NI's driver, or the emulated converter of an emulated bench
    device: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=60)] = "Dev1"
    product: Annotated[str, Field(max_length=40)] = ""  # if it is given, another product is refused
    rate_Hz: Annotated[float, Field(strict=True, gt=0, le=2e6, allow_inf_nan=False)] = 10_000.0  # noqa: N815 (of every input)
    # None: until the end of the run
    duration_s: Annotated[float, Field(strict=True, gt=0, le=86_400, allow_inf_nan=False)] | None = None
    # standard uncertainty of the device's scale
    scale_std_ppm: Annotated[float, Field(strict=True, ge=0, le=1e5)] = 0.0
    inputs: Annotated[tuple[DaqInput, ...], Field(min_length=1, max_length=6)]

    @property
    def samples(self) -> int | None:
        """Samples of each input in a finite acquisition; None if it has no end."""
        return None if self.duration_s is None else max(1, round(self.duration_s * self.rate_Hz))

    def shown(self) -> list[MeasurableRange]:
        """Return the measurable range of each input."""
        numbered_inputs = enumerate(self.inputs)
        range_ends = [
            (index, daq_input, daq_input.range_V * daq_input.scale_per_V) for index, daq_input in numbered_inputs
        ]
        return [
            MeasurableRange(("inputs", index), daq_input.quantity, -range_end, range_end)
            for index, daq_input, range_end in range_ends
        ]

    @field_validator("inputs")
    @classmethod
    def _all_differ(cls, value: tuple[DaqInput, ...]) -> tuple[DaqInput, ...]:
        for label, values in (
            ("name", [item.name for item in value]),
            ("channel", [item.channel for item in value]),
            ("quantity and role", [f"{item.quantity} of {item.role}" for item in value]),
        ):
            if len(set(values)) != len(values):
                raise ValueError(f"two inputs share a {label} among {', '.join(values)}")
        return value

    @model_validator(mode="after")
    def _fits_a_buffer(self) -> "NiDaqSettings":
        if (self.samples or 0) * len(self.inputs) > MOST_SAMPLES:
            raise ValueError(f"duration_s x rate_Hz x inputs is above {MOST_SAMPLES} samples; leave duration_s out")
        return self
