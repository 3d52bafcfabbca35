"""Korad KA3003P to KA6005P: switched off at `open` and `close`, confirmed by its state and the measured output."""

from collections.abc import Mapping
from typing import Any, ClassVar

from leactl.driver.clock import Clock
from leactl.driver.contract import Identity
from leactl.driver.far_end import Physics, SerialEmulator
from leactl.driver.serial_port import SerialPort
from leactl.driver.serial_supply import SupplyDriver, SupplyLine, refuse_between_steps
from leactl_plugins.korad_ka.dialogue import KoradDialogue
from leactl_plugins.korad_ka.probe import KoradProbe
from leactl_plugins.korad_ka.settings import STEP_A, STEP_V, KoradKaSettings

COMMANDS_PER_TRY = 6  # to switch off; the first command may have to wait for its turn as well
LAST_ANSWER_S = 0.1  # time for the last answer of an attempt, with the silence that ends it


class KoradKa(SupplyDriver):
    """One supply; its levels come in steps of 0.01 V and 0.001 A, its protections are left alone."""

    Settings = KoradKaSettings
    transport = "serial"
    summary = "DC supply over a serial line (Korad KA3003P to KA6005P; Velleman PS3005D, Tenma 72-2540, RND 320)"
    example: ClassVar[Mapping[str, Any]] = {
        "model": "KA3005P",
        "feeds": "leads",
        "voltage_limit_V": 10.0,
        "current_limit_A": 5.0,
    }
    probe = KoradProbe()
    open_s = 6.0

    def __init__(self, name: str, role: str, settings: KoradKaSettings, port: SerialPort, clock: Clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        port.line_end, port.rest_s = b"", settings.pace_s
        self._dialogue = KoradDialogue(settings, port)
        try_s = COMMANDS_PER_TRY * settings.pace_s + LAST_ANSWER_S
        self._line = SupplyLine(name, role, settings, port, self._dialogue, try_s)

    def identity(self) -> Identity:
        """Return name, serial number and firmware from `*IDN?`; older firmwares report no serial number."""
        return self._dialogue.identity()

    @classmethod
    def far_end(cls, settings: KoradKaSettings, role: str, physics: Physics) -> SerialEmulator:
        """Return an emulated supply of this model that feeds the bench."""
        from leactl_plugins.korad_ka.emulator import KoradEmulator

        return KoradEmulator(settings.model, physics.at_supply(settings.feeds, role))

    # -- commands, for the supervisor --------------------------------------------------------------------------------

    def supply(self, voltage: float, current: float) -> None:
        """Set the limits of voltage [V] and current [A] for the output while it is on; switches nothing.

        Raises
        ------
        InputError : a value is not finite, negative, above `most` or between the instrument's steps; nothing is sent.
        """
        refuse_between_steps(self.name, (voltage, current), (STEP_V, STEP_A))
        self._line.supply(voltage, current)
