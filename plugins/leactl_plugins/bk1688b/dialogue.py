"""Commands of a supply that reports its measurements, but not whether its output is on.

Each command is answered by `OK`, and every setting is read back. The output counts as off while neither the voltage nor
the current at its terminals exceeds its `off_` setting. A reply to an earlier query is recognised by its form or its
value.
"""

from collections.abc import Callable, Sequence

from leactl.driver.contract import Confirmation
from leactl.driver.conversation import Query, Reply, Script, Unreadable, ask
from leactl.driver.serial_supply import Regulation, SupplyReading, SwitchOffTrouble
from leactl.errors import DeviceError, DeviceFault, NoAnswer
from leactl_plugins.bk1688b import replies
from leactl_plugins.bk1688b.replies import OK, Display, LevelCounts, parser_of_last_lines
from leactl_plugins.bk1688b.settings import HIGHEST_RATING, LOWEST_VOLTAGE_V, STEP_V, Bk1688bSettings, can_be_model

ON, OFF = "SOUT0", "SOUT1"  # by the manual: 0 switches on, 1 off
DISPLAY = Query("GETD", replies.parse_display, last=OK)
MOST_DISPLAY_READINGS = 40  # of about 40 ms each, in which a switched output has to rise or fall
MARK_COUNT = 10  # voltage settings from 1.0 V to 1.9 V; each attempt to switch off sets the next one
SETTINGS_CHECK_INTERVAL_S = 1.0  # time between two readings of the settings, which a person may change at the panel
HIGHEST_DISPLAY_OVER_LIMIT = 1.2  # highest credible display of voltage or current, over the supply's limit


class Bk1688bDialogue:
    """Dialogue with the supply of these settings."""

    off = f"\r{OFF}\r".encode("ascii")  # the first carriage return ends a command that was left incomplete

    def __init__(self, settings: Bk1688bSettings) -> None:
        self._settings, self._current_step = settings, settings.rating.current_step
        self._commanded = LevelCounts(round(LOWEST_VOLTAGE_V / STEP_V), 0)
        self._limits = HIGHEST_RATING  # V and A; those of any model until the supply reports its own
        self._last_mark = 0  # steps above the lowest voltage, set by the last attempt to switch off
        self._settings_read_at = 0.0  # time [s] at which the settings were read
        self._regulation = Regulation()
        self._panel_fault_text = ""  # empty unless the settings were changed at the panel

    def synchronise(self) -> Script[LevelCounts]:
        """Query the settings; replies before one of six digits belong to earlier queries and are dropped."""
        levels: LevelCounts = yield from ask(
            Query("GETS", parser_of_last_lines(2, replies.parse_levels), patient=True, last=OK)
        )
        return levels

    def output_off(self, off_trouble: SwitchOffTrouble) -> Script[Confirmation]:
        """Switch off repeatedly until no voltage and no current are measured at the terminals.

        Each attempt sets and reads back a voltage that the last nine attempts did not use. Any reply before that value
        is thereby known to be older, and an output that does not switch off is at least turned down.
        """
        while True:
            yield b"\r"
            yield from ask(Query(OFF, parser_of_last_lines(1, replies.parse_confirmation), patient=True, last=OK))
            self._last_mark = (self._last_mark + 1) % MARK_COUNT
            voltage_steps = round(LOWEST_VOLTAGE_V / STEP_V) + self._last_mark
            yield from ask(
                Query(
                    f"VOLT{voltage_steps:03d}",
                    parser_of_last_lines(1, replies.parse_confirmation),
                    patient=True,
                    last=OK,
                )
            )
            yield from ask(
                Query("GETS", parser_of_last_lines(2, _parser_of_levels_at(voltage_steps)), patient=True, last=OK)
            )
            display: Display = yield from ask(DISPLAY)
            if not self._is_on(display):
                return Confirmation(True, f"output off, {_display_text(display)}")
            off_trouble.text = f"the output is still on, {_display_text(display)}"

    def set_up(self, off_trouble: SwitchOffTrouble) -> Script[Sequence[str]]:
        """Switch off, check the model by its limits, and set the lowest levels.

        Raises
        ------
        DeviceError : another model, a setting that reads back differently, or an output that cannot be switched off.
        """
        rating, notices = self._settings.rating, []
        yield from self.output_off(off_trouble)
        off_trouble.text = ""
        try:
            reported_limits: LevelCounts = yield from ask(Query("GMAX", replies.parse_levels, last=OK))
        except NoAnswer:
            notices.append(f"does not tell its limits (GMAX); it is taken for a {self._settings.model}")
            yield from self.synchronise()
        else:
            voltage_limit, current_limit = (
                reported_limits.voltage_steps * STEP_V,
                reported_limits.current_steps * self._current_step,
            )
            if not can_be_model(reported_limits, rating):
                raise DeviceError(
                    f"limits of {voltage_limit:.1f} V and {current_limit:.1f} A answer; a {self._settings.model} with"
                    f" {rating.voltage:g} V and {rating.current:g} A was expected"
                )
            self._limits = voltage_limit, current_limit
        yield from self._put(LevelCounts(round(LOWEST_VOLTAGE_V / STEP_V), 0))
        return notices

    def leave(self) -> Script[Sequence[str]]:
        """Do nothing: the supply has no protections to restore."""
        yield from ()
        return ()

    def put(self, voltage: float, current: float) -> Script[None]:
        """Set both levels [V, A] and read them back.

        Raises
        ------
        DeviceError : a level reads back as another value.
        """
        yield from self._put(LevelCounts(round(voltage / STEP_V), round(current / self._current_step)))

    def _put(self, levels: LevelCounts) -> Script[None]:
        """Set both levels and read them back; raise DeviceError if they differ."""
        self._commanded = levels
        self._regulation.begin_anew()
        yield from ask(_command_query(f"CURR{levels.current_steps:03d}"))
        yield from ask(_command_query(f"VOLT{levels.voltage_steps:03d}"))
        read_back: LevelCounts = yield from ask(Query("GETS", replies.parse_levels, last=OK))
        if read_back != levels:
            raise DeviceError(
                f"{self._levels_text(read_back)} are set after {self._levels_text(levels)} were commanded"
            )

    def switch(self, on: bool) -> Script[None]:
        """Switch the output and check it by the measured voltage and current.

        Raises
        ------
        DeviceFault : the output is not in the demanded state.
        """
        self._regulation.begin_anew()
        yield from ask(_command_query(ON if on else OFF))
        for _ in range(MOST_DISPLAY_READINGS):
            display: Display = yield from ask(DISPLAY)
            if self._is_on(display) is on:
                return
        raise DeviceFault(f"the output does not switch {'on' if on else 'off'}, {_display_text(display)}")

    def measure(self) -> Script[SupplyReading]:
        """Measure voltage, current and regulation mode; every `SETTINGS_CHECK_INTERVAL_S`, also read the settings.

        Raises
        ------
        Unreadable : a display far beyond the supply's limits.
        """
        reply = yield DISPLAY
        assert reply is not None
        display: Display = reply.value
        voltage_limit, current_limit = self._limits
        if (
            display.voltage > HIGHEST_DISPLAY_OVER_LIMIT * voltage_limit
            or display.current > HIGHEST_DISPLAY_OVER_LIMIT * current_limit
        ):
            raise Unreadable(
                f"GETD was answered by {_display_text(display)} where no more than {voltage_limit:g} V and"
                f" {current_limit:g} A can be"
            )
        on = self._is_on(display)
        mode = ("constant current" if display.current_limited else "constant voltage") if on else ""
        if reply.seen - self._settings_read_at >= SETTINGS_CHECK_INTERVAL_S:
            self._settings_read_at = reply.seen
            levels = yield from self.synchronise()
            commanded = self._commanded
            self._panel_fault_text = (
                f"set to {self._levels_text(levels)} at its panel; {self._levels_text(commanded)} were commanded"
                if levels != commanded
                else ""
            )
        fault = self._panel_fault_text or (self._regulation_fault(display, reply) if on else "")
        return SupplyReading((reply.asked + reply.seen) / 2, display.voltage, display.current, on, mode, fault)

    def _regulation_fault(self, display: Display, reply: Reply) -> str:
        """Return a text if the output has lost its regulation; empty if it has not.

        This also detects a supply of another model, whose current has other steps, if it does not report its limits.
        """
        levels = self._commanded.voltage_steps * STEP_V, self._commanded.current_steps * self._current_step
        if not self._regulation.is_lost(
            (display.voltage, display.current), levels, display.current_limited, reply.seen
        ):
            return ""
        return f"out of regulation, {_display_text(display)}; {self._levels_text(self._commanded)} are set"

    def _is_on(self, display: Display) -> bool:
        """Return whether voltage or current at the terminals exceeds the value up to which the output counts as off."""
        return display.voltage > self._settings.off_voltage_V or display.current > self._settings.off_current_A

    def _levels_text(self, levels: LevelCounts) -> str:
        """Return levels in volts and amperes, as text."""
        return f"{levels.voltage_steps * STEP_V:.1f} V and {levels.current_steps * self._current_step:.2f} A"


def _parser_of_levels_at(voltage_steps: int) -> Callable[[bytes], LevelCounts]:
    """Return a parser of settings that raises Unreadable for any other voltage setting."""

    def parse(answer: bytes) -> LevelCounts:
        levels = replies.parse_levels(answer)
        if levels.voltage_steps != voltage_steps:
            raise Unreadable(f"{levels.voltage_steps} where {voltage_steps} was expected")
        return levels

    return parse


def _command_query(text: str) -> Query:
    """Return a query that sends a command and expects `OK`."""
    return Query(text, replies.parse_confirmation, last=OK)


def _display_text(display: Display) -> str:
    """Return the measured voltage and current as text."""
    return f"{display.voltage:.2f} V and {display.current:.2f} A"
