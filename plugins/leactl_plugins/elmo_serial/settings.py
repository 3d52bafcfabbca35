"""Settings of one Elmo drive on a serial line; scales and limits come from the drive itself."""

from typing import Annotated, Literal

from pydantic import Field

from leactl.driver.contract import SAFE_STATE_S, DriverSettings
from leactl_plugins.elmo.scales import CurrentConvention

VARIABLES = 24  # UI[1] to UI[24]
PROGRAM_TICK_MS = 10  # time between two checks of the host's counter by the drive's program
Current = Annotated[float, Field(strict=True, gt=0, le=1000, allow_inf_nan=False)]


class ElmoSerialSettings(DriverSettings):
    """Everything that differs from drive to drive."""

    counts_per_turn: Annotated[int, Field(strict=True, ge=4, le=2**28)]
    sign: Literal[-1, 1] = 1
    current_convention: CurrentConvention = CurrentConvention.AMPLITUDE
    dead_man_ms: Annotated[int, Field(strict=True, ge=100, le=round(SAFE_STATE_S * 1000))] = 300
    # index of the first of three UI variables: the host's counter, its longest time without a change, an exchange's tag
    first_variable: Annotated[int, Field(strict=True, ge=1, le=VARIABLES - 2)] = 1
    bus_voltage_command: Annotated[str, Field(pattern=r"^[A-Z]{2}(\[[0-9]{1,3}\])?$")] | None = "AN[6]"
    bus_voltage_period_s: Annotated[float, Field(strict=True, ge=0.05, le=60)] = 0.2
    answer_timeout_s: Annotated[float, Field(strict=True, ge=0.02, le=0.5 * SAFE_STATE_S)] = 0.3
    reset_fault_at_start: bool = False
    # PL[1] and CL[1] of the emulated drive; a real drive's own are read from it
    emulated_peak_current_A: Current = 40.0  # noqa: N815 (a unit keeps its letter)
    emulated_continuous_current_A: Current = 40.0  # noqa: N815

    @property
    def host_silence_s(self) -> float:
        """Time for which the drive's program lets it run without the host [s]."""
        return 1e-3 * self.dead_man_ms

    @property
    def life_variable(self) -> str:
        """Variable that the drive's program monitors."""
        return f"UI[{self.first_variable}]"

    @property
    def silence_variable(self) -> str:
        """Variable that holds the time for which the host's counter may stay unchanged [ms]."""
        return f"UI[{self.first_variable + 1}]"

    @property
    def tag_variable(self) -> str:
        """Variable for the tag of an exchange that does not count as a heartbeat."""
        return f"UI[{self.first_variable + 2}]"

    @property
    def silence_ms(self) -> int:
        """Value of the silence variable [ms]: two ticks less, one for the check per tick and one for a late tick."""
        return self.dead_man_ms - 2 * PROGRAM_TICK_MS
