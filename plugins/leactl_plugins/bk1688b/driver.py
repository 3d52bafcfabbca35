"""BK Precision 1685B, 1687B or 1688B: switched off at `open` and `close`, confirmed by the measured output."""

from collections.abc import Mapping
from typing import Any, ClassVar

from leactl.driver.clock import Clock
from leactl.driver.far_end import Physics, SerialEmulator
from leactl.driver.serial_port import SerialPort
from leactl.driver.serial_supply import SupplyDriver, SupplyLine, refuse_between_steps
from leactl_plugins.bk1688b.dialogue import Bk1688bDialogue
from leactl_plugins.bk1688b.probe import Bk1688bProbe
from leactl_plugins.bk1688b.settings import LOWEST_VOLTAGE_V, STEP_V, Bk1688bSettings

# least current limit over `off_current_A`: an output that is on and regulates its current must not count as off
LEAST_LIMIT_OVER_OFF_CURRENT = 2.0


class Bk1688b(SupplyDriver):
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
    open_s = 5.0

    def __init__(self, name: str, role: str, settings: Bk1688bSettings, port: SerialPort, clock: Clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        port.line_end = b"\r"
        dialogue = Bk1688bDialogue(settings)
        self._line = SupplyLine(name, role, settings, port, dialogue)

    @classmethod
    def far_end(cls, settings: Bk1688bSettings, role: str, physics: Physics) -> SerialEmulator:
        """Return an emulated supply of this model that feeds the bench."""
        from leactl_plugins.bk1688b.emulator import Bk1688bEmulator

        return Bk1688bEmulator(settings.model, physics.at_supply(settings.feeds, role))

    # -- commands, for the supervisor --------------------------------------------------------------------------------

    def supply(self, voltage: float, current: float) -> None:
        """Set the limits of voltage [V] and current [A] for the output while it is on; switches nothing.

        Raises
        ------
        InputError : a value is not finite, above `most`, between the instrument's steps, or so low that an output that
            is on could not be distinguished from one that is off; nothing is sent.
        """
        rating = self.settings.rating
        refuse_between_steps(self.name, (voltage, current), (STEP_V, rating.current_step))
        lowest_current = max(LEAST_LIMIT_OVER_OFF_CURRENT * self.settings.off_current_A, rating.current_step)
        self._line.supply(voltage, current, (LOWEST_VOLTAGE_V, lowest_current))
