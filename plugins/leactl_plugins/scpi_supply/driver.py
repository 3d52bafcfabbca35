"""Programmable DC supply over a serial line or LAN, switched off at `open` and `close`; every setting is read back.

The instrument takes tens of milliseconds for an answer, and nothing waits for one within the loop.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

from leactl.driver.clock import Clock
from leactl.driver.contract import Identity, TripAccuracy
from leactl.driver.far_end import Physics, SerialEmulator
from leactl.driver.serial_port import SerialPort
from leactl.driver.serial_supply import SupplyDriver, SupplyLine
from leactl.errors import InputError
from leactl_plugins.scpi_supply.dialogue import ScpiDialogue
from leactl_plugins.scpi_supply.probe import ScpiProbe, identity_of
from leactl_plugins.scpi_supply.settings import ScpiSupplySettings


class ScpiSupply(SupplyDriver):
    """One output of a supply; its other outputs are left alone."""

    Settings = ScpiSupplySettings
    transport = "serial"
    further_transports = ("visa",)
    summary = "DC supply over a serial line or LAN (SCPI; Keysight E363xA, E36300, Rigol DP800, Siglent SPD3303X)"
    example: ClassVar[Mapping[str, Any]] = {
        "dialect": "e36xx",
        "model": "E3633A",
        "feeds": "leads",
        "voltage_limit_V": 8.0,
        "current_limit_A": 10.0,
    }
    probe = ScpiProbe()
    open_s = 8.0  # some forty exchanges at 9600 baud take 2.5 s

    def __init__(self, name: str, role: str, settings: ScpiSupplySettings, port: SerialPort, clock: Clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        self._dialogue = ScpiDialogue(settings)
        self._line = SupplyLine(name, role, settings, port, self._dialogue)

    def identity(self) -> Identity:
        """Return maker with model, serial number and revision from `*IDN?`; a field reported as 0 is empty."""
        return identity_of(self._dialogue.reported_identity) if self._dialogue.reported_identity else Identity()

    @classmethod
    def far_end(cls, settings: ScpiSupplySettings, role: str, physics: Physics) -> SerialEmulator:
        """Return an emulated supply of this dialect and model that feeds the bench."""
        from leactl_plugins.scpi_supply.emulator import ScpiSupplyEmulator

        load = physics.at_supply(settings.feeds, role)
        return ScpiSupplyEmulator(
            settings.dialect, settings.model, load, settings.serial_number or "0", settings.output
        )

    # -- commands, for the supervisor --------------------------------------------------------------------------------

    def supply(self, voltage: float, current: float) -> None:
        """Set the limits of voltage [V] and current [A] for the output while it is on; switches nothing.

        Raises
        ------
        InputError : a value is not finite, negative, or above the protection's level; nothing is passed on.
        """
        self._line.supply(voltage, current)

    @property
    def trip_accuracy(self) -> TripAccuracy:
        """Tolerance of the level of the over-voltage protection [V]."""
        return self._dialogue.trip_accuracy

    def protect(self, level: float) -> None:
        """Set the level [V] of the over-voltage protection; it takes effect with the next `supply`.

        Raises
        ------
        InputError : not above zero, or above `voltage_limit_V`; nothing is passed on.
        """
        highest_level = self.settings.voltage_limit_V
        if not 0.0 < level <= highest_level:
            raise InputError(
                f"{self.name}: a protection at {level:g} V; above 0 and at most {highest_level:g} V was expected"
            )
        self._dialogue.trips_at = level
