"""Commands of a supply that reports its measurements, but not whether its output is on.

Each command is answered by `OK`, and every setting is read back. The output counts as off by voltage and current at the
terminals. Replies to earlier commands are recognised because each query expects a reply that only it can produce.
"""

from collections.abc import Callable, Sequence

from leactl.driver.contract import Confirmation
from leactl.driver.conversation import Query, Reply, Script, Unreadable, ask
from leactl.driver.serial_supply import Regulation, SupplyReading, SwitchOffTrouble
from leactl.errors import DeviceError, DeviceFault, NoAnswer
from leactl_plugins.bk1688b import replies
from leactl_plugins.bk1688b.replies import OK, Display, LevelCounts, parse_last_line
from leactl_plugins.bk1688b.settings import HIGHEST_RATING, LEAST_V, STEP_V, Bk1688bSettings, can_be_model

ON, OFF = "SOUT0", "SOUT1"  # by the manual: 0 switches on, 1 off
DISPLAY = Query("GETD", replies.parse_display, last=OK)
MOST_DISPLAY_READINGS = 40  # about 40 ms each, until a switched output has risen or fallen
MARK_COUNT = 10  # voltage settings from 1.0 V to 1.9 V; each try to switch off sets another
SETTINGS_S = 1.0  # time between two readings of the settings, which a person may change at the panel
MOST_OVER_LIMIT = 1.2  # largest display of a supply over its limits


class Bk1688bDialogue:
    """Dialogue with the supply of these settings."""

    off = f"\r{OFF}\r".encode("ascii")  # the first end closes what somebody has left half sent

    def __init__(self, settings: Bk1688bSettings) -> None:
        self._settings, self._step = settings, settings.rating.current_step
        self._commanded = LevelCounts(round(LEAST_V / STEP_V), 0)
        self._limits = HIGHEST_RATING  # V and A; it may be another model until it reports its limits
        self._mark = 0
        self._settings_read_at = 0.0  # time [s]
        self._regulation = Regulation()
        self._panel = ""  # fault text if the settings were changed at the panel

    def synchronise(self) -> Script[LevelCounts]:
        """Query the settings and drop all replies before six digits, which belong to earlier queries."""
        levels: LevelCounts = yield from ask(
            Query("GETS", parse_last_line(2, replies.parse_levels), patient=True, last=OK)
        )
        return levels

    def output_off(self, off_trouble: SwitchOffTrouble) -> Script[Confirmation]:
        """Switch off repeatedly until no voltage and no current are measured at the terminals.

        Each try sets and reads back a voltage that the last nine tries did not use. Any reply before that value is
        thereby known to be older, and an output that does not switch off is at least turned down.
        """
        while True:
            yield b"\r"
            yield from ask(Query(OFF, parse_last_line(1, replies.parse_done), patient=True, last=OK))
            self._mark = (self._mark + 1) % MARK_COUNT
            volts = round(LEAST_V / STEP_V) + self._mark
            yield from ask(Query(f"VOLT{volts:03d}", parse_last_line(1, replies.parse_done), patient=True, last=OK))
            yield from ask(Query("GETS", parse_last_line(2, _levels_with(volts)), patient=True, last=OK))
            shown: Display = yield from ask(DISPLAY)
            if not self._is_on(shown):
                return Confirmation(True, f"output off, {_display_text(shown)}")
            off_trouble.text = f"the output is still on, {_display_text(shown)}"

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
            most: LevelCounts = yield from ask(Query("GMAX", replies.parse_levels, last=OK))
        except NoAnswer:
            notices.append(f"does not tell its limits (GMAX); it is taken for a {self._settings.model}")
            yield from self.synchronise()
        else:
            volts, amperes = most.volts * STEP_V, most.amperes * self._step
            if not can_be_model(most, rating):
                raise DeviceError(
                    f"limits of {volts:.1f} V and {amperes:.1f} A answer; a {self._settings.model} with"
                    f" {rating.voltage:g} V and {rating.current:g} A was expected"
                )
            self._limits = volts, amperes
        yield from self._put(LevelCounts(round(LEAST_V / STEP_V), 0))
        return notices

    def leave(self) -> Script[Sequence[str]]:
        """Do nothing: the supply has no protections to restore."""
        yield from ()
        return ()

    def put(self, voltage: float, current: float) -> Script[None]:
        """Set both levels [V, A] and read them back.

        Raises
        ------
        DeviceError : other levels read back.
        """
        yield from self._put(LevelCounts(round(voltage / STEP_V), round(current / self._step)))

    def _put(self, levels: LevelCounts) -> Script[None]:
        self._commanded = levels
        self._regulation.begin_anew()
        yield from ask(_command(f"CURR{levels.amperes:03d}"))
        yield from ask(_command(f"VOLT{levels.volts:03d}"))
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
        yield from ask(_command(ON if on else OFF))
        for _ in range(MOST_DISPLAY_READINGS):
            shown: Display = yield from ask(DISPLAY)
            if self._is_on(shown) is on:
                return
        raise DeviceFault(f"the output does not switch {'on' if on else 'off'}, {_display_text(shown)}")

    def measure(self) -> Script[SupplyReading]:
        """Measure voltage, current and regulation mode; every `SETTINGS_S`, also read the settings.

        Raises
        ------
        Unreadable : a display far beyond the supply's limits.
        """
        answer = yield DISPLAY
        assert answer is not None
        shown: Display = answer.value
        volts, amperes = self._limits
        if shown.voltage > MOST_OVER_LIMIT * volts or shown.current > MOST_OVER_LIMIT * amperes:
            raise Unreadable(
                f"GETD was answered by {_display_text(shown)} where no more than {volts:g} V and {amperes:g} A can be"
            )
        on = self._is_on(shown)
        mode = ("constant current" if shown.limited else "constant voltage") if on else ""
        if answer.seen - self._settings_read_at >= SETTINGS_S:
            self._settings_read_at = answer.seen
            levels = yield from self.synchronise()
            commanded = self._commanded
            self._panel = (
                f"set to {self._levels_text(levels)} at its panel; {self._levels_text(commanded)} were commanded"
                if levels != commanded
                else ""
            )
        fault = self._panel or (self._regulation_fault(shown, answer) if on else "")
        return SupplyReading((answer.asked + answer.seen) / 2, shown.voltage, shown.current, on, mode, fault)

    def _regulation_fault(self, shown: Display, answer: Reply) -> str:
        """A fault if the output has lost its regulation; else empty.

        This also detects a supply of another model, whose current has other steps, if it does not report its limits.
        """
        levels = self._commanded.volts * STEP_V, self._commanded.amperes * self._step
        if not self._regulation.is_lost((shown.voltage, shown.current), levels, shown.limited, answer.seen):
            return ""
        return f"out of regulation, {_display_text(shown)}; {self._levels_text(self._commanded)} are set"

    def _is_on(self, shown: Display) -> bool:
        return shown.voltage > self._settings.off_voltage_V or shown.current > self._settings.off_current_A

    def _levels_text(self, levels: LevelCounts) -> str:
        return f"{levels.volts * STEP_V:.1f} V and {levels.amperes * self._step:.2f} A"


def _levels_with(volts: int) -> Callable[[bytes], LevelCounts]:
    """Parser of settings that refuses any other voltage."""

    def read(answer: bytes) -> LevelCounts:
        levels_set = replies.parse_levels(answer)
        if levels_set.volts != volts:
            raise Unreadable(f"{levels_set.volts} where {volts} was expected")
        return levels_set

    return read


def _command(text: str) -> Query:
    return Query(text, replies.parse_done, last=OK)


def _display_text(shown: Display) -> str:
    return f"{shown.voltage:.2f} V and {shown.current:.2f} A"
