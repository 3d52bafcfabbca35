"""A programmable DC supply over a serial line: off when met and when left, and whatever it says is asked for again.

The instrument takes tens of milliseconds for an answer. Nothing waits for one within the loop: each call of `take` goes
on with the conversation as far as it has come.
"""

import math
from collections.abc import Sequence

from leactl.driver.clock import Clock
from leactl.driver.contract import Confirmation, Driver, Row, StreamSpec
from leactl.driver.far_end import Physics, SerialEmulator
from leactl.driver.serial_port import SerialPort
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer
from leactl.quantities import ChannelSpec
from leactl_plugins.scpi_supply import scripts
from leactl_plugins.scpi_supply.answers import Unreadable
from leactl_plugins.scpi_supply.dialects import DIALECTS
from leactl_plugins.scpi_supply.scripts import Progress, Reading
from leactl_plugins.scpi_supply.settings import ScpiSupplySettings
from leactl_plugins.scpi_supply.talk import Pause, Script, Talk

OPEN_S = 8.0  # some forty exchanges at 9600 baud take 2.5 s
MOST_LOST = 3  # rounds in a row
QUANTITIES = {"leads": ("line_voltage", "line_current"), "bus": ("bus_voltage", "bus_current")}


class ScpiSupply(Driver):
    """One supply with one output."""

    Settings = ScpiSupplySettings
    transport = "serial"
    summary = "DC supply over a serial line (SCPI; Keysight E3632A to E3634A, Rigol DP811)"

    def __init__(self, name: str, role: str, settings: ScpiSupplySettings, port: SerialPort, clock: Clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        self._port, self._clock = port, clock
        self._dialect = DIALECTS[settings.dialect]
        self._opened = False
        self._talk: Talk[None] | None = None
        self._levels: tuple[float, float] | None = None  # to be set
        self._switch: bool | None = None  # to be switched
        self._asked_on = False  # what was switched last
        self._on = False
        self._mode = ""
        self._rows: list[Row] = []
        self._notices: list[str] = []

    def safe_state(self, deadline_s: float) -> Confirmation:
        """Switch off and see that it is, from any state, over a fresh connection if need be; never raises."""
        self._forget_demands()
        until = self._clock.now() + deadline_s
        trouble, progress = "", Progress()
        while self._clock.now() < until:
            try:
                if not self._port.connected:
                    self._port.reopen()
                self._port.discard()
                halfway = self._clock.now() + max(0.5 * (until - self._clock.now()), min(0.1, 0.5 * deadline_s))
                script = scripts.output_off(self._dialect, self.settings, progress)
                confirmed = Talk(self._port, script, self.settings.answer_s).finish(min(halfway, until))
            except DeviceError as error:
                if progress.said or not (trouble and isinstance(error, NoAnswer)):  # the last try has little time
                    trouble = progress.said or str(error)
                self._start_afresh(until)
                continue
            self._on = False
            break
        else:
            confirmed = Confirmation(False, f"not confirmed within {deadline_s:g} s: {trouble or 'no time was left'}")
        if not self._opened:
            self._port.close()
        return confirmed

    def _start_afresh(self, until: float) -> None:
        try:
            self._port.reopen()
        except DeviceError:
            self._clock.sleep_until(min(until, self._clock.now() + 0.02))

    def stop_now(self) -> None:
        """Send what switches the output off, and wait for nothing; over a fresh connection if need be."""
        self._forget_demands()
        for _ in range(2):
            try:
                if not self._port.connected:
                    self._port.reopen()
                self._port.write(self._dialect.off)
            except DeviceError:
                if not self._opened:
                    return  # no line to reach it by, which `safe_state` will tell
                self._port.reopen()
            else:
                return

    def _forget_demands(self) -> None:
        self._talk = self._levels = self._switch = None
        self._asked_on = False

    def open(self) -> None:
        """Meet the supply: see who it is, make it off, arm its protections.

        Raises
        ------
        DeviceError : it is absent, another one, refuses a setting, or cannot be made off; `DeviceFault` where a
            protection has tripped.
        """
        self._port.open()
        self._opened = True
        self._port.discard()
        self._forget_demands()
        progress = Progress()
        script = scripts.set_up(self._dialect, self.settings, progress)
        try:
            before = Talk(self._port, script, self.settings.answer_s).finish(self._clock.now() + OPEN_S)
        except NoAnswer as error:
            if progress.said:
                raise DeviceFault(f"{self.name}: {progress.said}") from None
            raise NoAnswer(f"{self.name}: {error}") from None
        except DeviceError as error:
            raise type(error)(f"{self.name}: {error}") from None
        self._notices += [f"had an error from before: {number}, {text}" for number, text in before]
        self._on = False

    def close(self) -> None:
        """Let the line go."""
        self._talk = None
        if self._opened:
            self._opened = False
            self._port.close()

    @classmethod
    def far_end(cls, settings: ScpiSupplySettings, role: str, physics: Physics) -> SerialEmulator:
        """A supply of this dialect and model that feeds the bench."""
        from leactl_plugins.scpi_supply.emulator import ScpiSupplyEmulator

        load = physics.at_supply(settings.feeds, role)
        return ScpiSupplyEmulator(settings.dialect, settings.model, load, settings.serial_number or "0")

    # -- commands, for the supervisor --------------------------------------------------------------------------------

    @property
    def most(self) -> tuple[float, float]:
        """Highest voltage [V] and current [A] that `supply` takes: the levels of the protections."""
        return self.settings.voltage_limit_V, self.settings.current_limit_A

    @property
    def supplying(self) -> bool:
        """True from when the instrument has reported its output on until it has reported it off."""
        return self._on

    def supply(self, voltage: float, current: float) -> None:
        """Put out no more than this voltage [V] and this current [A] while switched on; switches nothing.

        Raises
        ------
        InputError : a value is not finite, negative, or above the protection's level; nothing is passed on.
        """
        for value, most, unit in zip((voltage, current), self.most, "VA", strict=True):
            if not 0.0 <= value <= most:
                raise InputError(
                    f"{self.name}: {value:g} {unit} asked of a supply that is good for 0 to {most:g} {unit}"
                )
        self._levels = voltage, current

    def switch_on(self) -> None:
        """Begin to switch the output on."""
        self._switch = True

    def switch_off(self) -> None:
        """Begin to switch the output off: at once, and then until it is confirmed.

        Raises
        ------
        DeviceError : the line is gone.
        """
        self.stop_now()
        self._switch = False

    # -- the stream --------------------------------------------------------------------------------------------------

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """Voltage and current at the terminals, one stamp for both."""
        channels = tuple(
            ChannelSpec(quantity, quantity, self.role, self.name, f"{self.name} {quantity.replace('_', ' ')}")
            for quantity in QUANTITIES[self.settings.feeds]
        )
        return (StreamSpec(self.name, channels),)

    def take(self) -> Sequence[Row]:
        """Go on with the conversation; what has been measured since the last call; never waits.

        Raises
        ------
        DeviceError : the line is gone, the instrument has not answered three times in a row, or refuses a command.
        """
        if self._talk is None:
            self._talk = Talk(self._port, self._conversation(), self.settings.answer_s)
        try:
            self._talk.step()
        except DeviceError as error:
            self._talk = None
            raise type(error)(f"{self.name}: {error}") from None
        if not self._rows:
            return ()
        rows, self._rows = self._rows, []
        return rows

    def notices(self) -> Sequence[str]:
        """Errors of the instrument, answers that were lost, changes between constant voltage and constant current."""
        found, self._notices = self._notices, []
        return found

    def _conversation(self) -> Script[None]:
        """Carry out what was commanded and measure in between; a lost answer costs a round, the third in a row all."""
        due, lost, in_step = -math.inf, 0, False
        while True:
            try:
                if not in_step:
                    yield from scripts.in_step()
                    in_step = True
                yield from self._carry_out()
                if self._clock.now() < due:
                    yield Pause()
                    continue
                due = self._clock.now() + self.settings.period_s
                self._judge((yield from scripts.measured()), (yield from self._tripped()))
                lost = 0
            except (NoAnswer, Unreadable) as error:
                lost, in_step = lost + 1, False
                if lost >= MOST_LOST:
                    raise
                self._notices.append(f"a round was lost: {error}")

    def _carry_out(self) -> Script[None]:
        """Off before levels, levels before on; a demand stays until it has been confirmed."""
        if self._switch is False:
            yield from scripts.switched(False)
            self._on, self._switch = False, None if self._switch is False else self._switch
        if self._levels is not None:
            levels = self._levels
            yield from scripts.written("CURR", "CURR?", levels[1])
            yield from scripts.written("VOLT", "VOLT?", levels[0])
            self._levels = None if self._levels is levels else self._levels
        if self._switch is True:
            self._asked_on = True
            yield from scripts.switched(True)
            self._on, self._switch = True, None if self._switch is True else self._switch

    def _tripped(self) -> Script[str]:
        return (yield from scripts.fault_of((self._dialect.voltage, self._dialect.current)))

    def _judge(self, reading: Reading, fault: str) -> None:
        self._on = reading.on
        mode = scripts.REGULATED.get(reading.condition, "") if reading.on else ""
        if reading.on and not mode and not fault:
            fault = f"out of regulation, condition {reading.condition}"
        if reading.on is not self._asked_on and not fault:
            fault = f"the output is {'on' if reading.on else 'off'} by itself"
        if mode and mode != self._mode:
            self._notices.append(f"{mode}: {reading.voltage:.3f} V, {reading.current:.3f} A")
        self._mode = mode
        self._notices += [f"error {number}, {text}" for number, text in reading.errors]
        values = (math.nan, math.nan) if fault else (reading.voltage, reading.current)
        self._rows.append(Row(self.name, reading.time, values, f"{self.name}: {fault}" if fault else ""))
