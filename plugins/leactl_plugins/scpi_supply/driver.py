"""Programmable DC supply over a serial line or LAN: off at `open` and `close`, every setting is read back.

The instrument takes tens of milliseconds for an answer, and nothing waits for one within the loop.
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from leactl.driver.clock import Clock
from leactl.driver.contract import Confirmation, Driver, Identity, Row, StreamSpec, TripAccuracy
from leactl.driver.far_end import Physics, SerialEmulator
from leactl.driver.serial_port import SerialPort
from leactl.driver.serial_supply import SupplyLine
from leactl.errors import InputError
from leactl_plugins.scpi_supply.dialogue import ScpiDialogue
from leactl_plugins.scpi_supply.probe import ScpiProbe, identity_of
from leactl_plugins.scpi_supply.settings import ScpiSupplySettings

OPEN_S = 8.0  # some forty exchanges at 9600 baud take 2.5 s


class ScpiSupply(Driver):
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

    def __init__(self, name: str, role: str, settings: ScpiSupplySettings, port: SerialPort, clock: Clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        self._dialogue = ScpiDialogue(settings)
        self._line = SupplyLine(name, role, settings.feeds, port, self._dialogue, settings.answer_s, settings.period_s)

    def safe_state(self, deadline_s: float) -> Confirmation:
        """Switch off and confirm it, from any state, over a new connection if needed; never raises."""
        return self._line.make_safe(deadline_s)

    def stop_now(self) -> None:
        """Send the command that switches the output off, without waiting; over a new connection if needed."""
        self._line.stop_now()

    def open(self) -> None:
        """Connect to the supply: identify it, switch it off, arm its protections.

        Raises
        ------
        DeviceError : it is absent, another one, refuses a setting, or cannot be made off; `DeviceFault` where a
            protection has tripped.
        """
        self._line.open(OPEN_S)

    def identity(self) -> Identity:
        """Maker with model, serial number and revision from `*IDN?`, in which 0 means that there is none."""
        return identity_of(self._dialogue.met) if self._dialogue.met else Identity()

    def close(self) -> None:
        """Close the line."""
        self._line.close()

    @classmethod
    def far_end(cls, settings: ScpiSupplySettings, role: str, physics: Physics) -> SerialEmulator:
        """A supply of this dialect and model that feeds the bench."""
        from leactl_plugins.scpi_supply.emulator import ScpiSupplyEmulator

        load = physics.at_supply(settings.feeds, role)
        return ScpiSupplyEmulator(
            settings.dialect, settings.model, load, settings.serial_number or "0", settings.output
        )

    # -- commands, for the supervisor --------------------------------------------------------------------------------

    @property
    def most(self) -> tuple[float, float]:
        """Highest voltage [V] and current [A] that `supply` accepts: the levels of the protections."""
        return self.settings.voltage_limit_V, self.settings.current_limit_A

    @property
    def supplying(self) -> bool:
        """Whether the output is on, by the instrument's last report."""
        return self._line.supplying

    def supply(self, voltage: float, current: float) -> None:
        """Set the limits of voltage [V] and current [A] for the output while it is on; switches nothing.

        Raises
        ------
        InputError : a value is not finite, negative, or above the protection's level; nothing is passed on.
        """
        self._line.supply(voltage, current, self.most)

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
        most = self.settings.voltage_limit_V
        if not 0.0 < level <= most:
            raise InputError(f"{self.name}: a protection at {level:g} V; above 0 and at most {most:g} V was expected")
        self._dialogue.trips_at = level

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
        DeviceError : the line is gone, the instrument has not answered three times in a row, or refuses a command.
        """
        return self._line.take()

    def notices(self) -> Sequence[str]:
        """Notices: errors of the instrument, lost rounds, changes between constant voltage and constant current."""
        return self._line.notices()
