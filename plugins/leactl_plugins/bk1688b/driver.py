"""BK Precision 1685B, 1687B or 1688B: switched off at `open` and `close`, confirmed by the measured output."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from leactl.driver.clock import Clock
from leactl.driver.contract import Confirmation, Driver, Row, StreamSpec
from leactl.driver.far_end import Physics, SerialEmulator
from leactl.driver.serial_port import SerialPort
from leactl.driver.serial_supply import SupplyLine
from leactl.errors import InputError
from leactl_plugins.bk1688b.dialogue import Bk1688bDialogue
from leactl_plugins.bk1688b.models import LEAST_V, STEP_V
from leactl_plugins.bk1688b.probe import Bk1688bProbe
from leactl_plugins.bk1688b.settings import Bk1688bSettings

OPEN_S = 5.0
WHOLE = 1e-6  # of a step, by which a number that is written in decimals may miss it
FLOWS = 2.0  # times `off_current_A`, from which a current that flows can be told from none


class Bk1688b(Driver):
    """One supply; its levels come in steps of 0.1 V and 0.1 A (1685B: 0.01 A)."""

    Settings = Bk1688bSettings
    transport = "serial"
    summary = "DC supply over a serial line (BK Precision 1685B, 1687B, 1688B)"
    example: ClassVar[Mapping[str, Any]] = {
        "model": "1688B",
        "feeds": "leads",
        "voltage_limit_V": 10.0,
        "current_limit_A": 10.0,
    }
    probe = Bk1688bProbe()

    def __init__(self, name: str, role: str, settings: Bk1688bSettings, port: SerialPort, clock: Clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        port.line_end = b"\r"
        dialogue = Bk1688bDialogue(settings)
        self._line = SupplyLine(name, role, settings.feeds, port, dialogue, settings.answer_s, settings.period_s)

    def safe_state(self, deadline_s: float) -> Confirmation:
        """Switch off and confirm by measurement, from any state, over a new connection if needed; never raises."""
        return self._line.make_safe(deadline_s)

    def stop_now(self) -> None:
        """Send the command that switches the output off, without waiting; over a new connection if needed."""
        self._line.stop_now()

    def open(self) -> None:
        """Connect to the supply: switch it off and check the model by its limits.

        Raises
        ------
        DeviceError : it is absent, another model, refuses a setting, or cannot be switched off.
        """
        self._line.open(OPEN_S)

    def close(self) -> None:
        """Close the line."""
        self._line.close()

    @classmethod
    def far_end(cls, settings: Bk1688bSettings, role: str, physics: Physics) -> SerialEmulator:
        """A supply of this model that feeds the bench."""
        from leactl_plugins.bk1688b.emulator import Bk1688bEmulator

        return Bk1688bEmulator(settings.model, physics.at_supply(settings.feeds, role))

    # -- commands, for the supervisor --------------------------------------------------------------------------------

    @property
    def most(self) -> tuple[float, float]:
        """Highest voltage [V] and current [A] that `supply` takes."""
        return self.settings.voltage_limit_V, self.settings.current_limit_A

    @property
    def supplying(self) -> bool:
        """Whether the output is on, by the last measurement of voltage and current."""
        return self._line.supplying

    def supply(self, voltage: float, current: float) -> None:
        """Set the limits of voltage [V] and current [A] for the output while it is on; switches nothing.

        Raises
        ------
        InputError : a value is not finite, above `most`, between the instrument's steps, or so low that an output that
            is on could not be distinguished from one that is off; nothing is sent.
        """
        rating = self.settings.rating
        for value, step, unit in ((voltage, STEP_V, "V"), (current, rating.step_A, "A")):
            steps = value / step
            if math.isfinite(steps) and abs(steps - round(steps)) > WHOLE:
                raise InputError(f"{self.name}: {value:g} {unit} asked of a supply with steps of {step:g} {unit}")
        least = max(FLOWS * self.settings.off_current_A, rating.step_A)
        self._line.supply(voltage, current, self.most, (LEAST_V, least))

    def switch_on(self) -> None:
        """Begin to switch the output on."""
        self._line.switch_on()

    def switch_off(self) -> None:
        """Send the command to switch off at once, and repeat it in `take` until it is confirmed.

        Raises
        ------
        DeviceError : the line is gone.
        """
        self._line.switch_off()

    # -- the stream --------------------------------------------------------------------------------------------------

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """Voltage and current at the terminals, one stamp for both."""
        return (self._line.stream,)

    def take(self) -> Sequence[Row]:
        """Continue the conversation without waiting; returns the rows measured since the last call.

        Raises
        ------
        DeviceError : the line is gone, the instrument did not answer three times in sequence, or refuses a command.
        """
        return self._line.take()

    def notices(self) -> Sequence[str]:
        """Notices: lost rounds, and changes between constant voltage and constant current."""
        return self._line.notices()
