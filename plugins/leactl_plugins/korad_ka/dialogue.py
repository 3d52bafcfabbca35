"""Commands of a supply that confirms none of them and whose answers have no end mark: every setting is read back.

Silence ends an answer, so that too many bytes are noticed as well as too few. An answer does not identify its query;
before an output counts as off, a voltage must be read back that was not set recently.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from leactl.driver.contract import Confirmation, Identity
from leactl.driver.conversation import Pause, Query, Script, Unreadable, ask
from leactl.driver.serial_port import SerialPort
from leactl.driver.serial_supply import Regulation, SupplyReading, SwitchOffTrouble
from leactl.errors import DeviceError, DeviceFault, NoAnswer
from leactl_plugins.korad_ka import replies
from leactl_plugins.korad_ka.replies import KoradIdentity, SupplyStatus
from leactl_plugins.korad_ka.settings import RATINGS, SOLD_AS, STEP_A, STEP_V, TOO_SLOW, KoradKaSettings, model_of

ON, OFF = "OUT1", "OUT0"
ANSWER_END_S = 0.03  # silence that ends an answer; an adapter on USB holds bytes back for up to 16 ms
QUIET_S = 0.1  # silence after which no answer to an earlier query is expected any more
LONGEST_CHATTER_S = 0.5  # time until a line must be silent; a late answer has passed by then
LEAST_MARK, MARK_COUNT = 100, 100  # voltage settings from 1.00 V to 1.99 V; each try to switch off sets another
SET_TRIES = 3  # of setting the levels
MOST_STATE_READINGS = 10  # until a switched output has risen or fallen
SETTINGS_S = 1.0  # time between two readings of the settings
# sigrok's wiki: OVP1 and OCP1 switch off above the set voltage or current; no command sets or reads a level
UNPROTECTED_NOTICE = (
    "no protection with a level of its own (OVP, OCP): voltage_limit_V and current_limit_A bound nothing but what is"
    " commanded"
)
MOST_OVER_RATING = 1.2  # largest reading of a supply over its rating


def _query(text: str, parse: Callable[[bytes], Any]) -> Query:
    return Query(text, parse, silence_s=ANSWER_END_S)


SET_VOLTS, SET_AMPERES = _query("VSET1?", replies.parse_hundredths), _query("ISET1?", replies.parse_set_thousandths)
VOLTS, AMPERES = _query("VOUT1?", replies.parse_hundredths), _query("IOUT1?", replies.parse_thousandths)
STATUS, IDENTIFY = _query("STATUS?", replies.parse_status), _query("*IDN?", replies.parse_identity)


class Levels(NamedTuple):
    """Set levels, in steps of 0.01 V and 0.001 A."""

    volts: int
    amperes: int

    def __str__(self) -> str:
        return f"{self.volts * STEP_V:.2f} V and {self.amperes * STEP_A:.3f} A"


class OutputState(NamedTuple):
    """State of the output and measured values."""

    status: SupplyStatus
    voltage: float  # V
    current: float  # A
    time: float  # s, middle of the queries for voltage and current
    answer_time: float  # s, of the last answer

    def __str__(self) -> str:
        return f"{self.voltage:.2f} V and {self.current:.3f} A, its state {'on' if self.status.on else 'off'}"


class KoradDialogue:
    """Dialogue with the supply of these settings at this port."""

    off = OFF.encode("ascii")

    def __init__(self, settings: KoradKaSettings, port: SerialPort) -> None:
        self._settings, self._port = settings, port
        self._commanded = Levels(0, 0)
        self._mark = 0
        self._settings_read_at = 0.0
        self._regulation = Regulation()
        self._panel = ""  # fault text if the settings were changed at the panel
        self.reported_identity: KoradIdentity | None = None

    def synchronise(self) -> Script[None]:
        """Wait until nothing has arrived for `QUIET_S`.

        Raises
        ------
        NoAnswer : the line is not silent within `LONGEST_CHATTER_S`.
        """
        until = self._port.clock.now() + LONGEST_CHATTER_S
        while not self._port.silent_for(QUIET_S):
            if self._port.clock.now() >= until:
                raise NoAnswer(f"the line was never silent for {QUIET_S:g} s within {LONGEST_CHATTER_S:g} s")
            yield Pause()

    def output_off(self, off_trouble: SwitchOffTrouble) -> Script[Confirmation]:
        """Switch off repeatedly until the state is off and neither voltage nor current are measured.

        Each try sets and reads back a voltage that the last 99 tries did not use. All answers after that value are
        thereby known to be later than the command, and an output that does not switch off is at least turned down.
        """
        while True:
            yield OFF
            self._mark = (self._mark + 1) % MARK_COUNT
            mark = LEAST_MARK + self._mark
            yield f"VSET1:{mark * STEP_V:05.2f}"
            try:
                read_back: int = yield from ask(SET_VOLTS)
                if read_back != mark:
                    continue
                output = yield from self._read_output()
            except Unreadable:
                continue
            if not self._is_on(output):
                return Confirmation(True, f"output off, {output}")
            off_trouble.text = f"the output is still on, {output}"

    def set_up(self, off_trouble: SwitchOffTrouble) -> Script[Sequence[str]]:
        """Switch off, check the model by its name, and set both levels to 0.

        Raises
        ------
        DeviceError : another model, a firmware that is too slow, a setting that reads back differently, or an output
            that cannot be switched off.
        """
        self.reported_identity = None
        model, notices = self._settings.model, [UNPROTECTED_NOTICE]
        yield from self.output_off(off_trouble)
        off_trouble.text = ""
        try:
            reported: KoradIdentity = yield from ask(IDENTIFY)
        except NoAnswer:
            notices.append(f"does not tell its model (*IDN?); it is taken for a {model}")
        else:
            if (reported.name, reported.firmware) == TOO_SLOW:
                raise DeviceError(
                    f"{reported.name} with firmware {reported.firmware} answers, which needs too long for a command"
                )
            if model_of(reported.name) != model:
                names = " or ".join([f"KORAD{model}", *(name for name, sold in SOLD_AS.items() if sold == model)])
                raise DeviceError(f"{reported.name} answers; a {model}, which answers {names}, was expected")
            self.reported_identity = reported
        yield from self._put(Levels(0, 0))
        return notices

    def identity(self) -> Identity:
        """Name, serial number and firmware that the supply reported."""
        return identity_of(self.reported_identity) if self.reported_identity else Identity()

    def leave(self) -> Script[Sequence[str]]:
        """Do nothing: `set_up` does not change the protections, since OCP would end every current-regulated output."""
        yield from ()
        return ()

    def put(self, voltage: float, current: float) -> Script[None]:
        """Set both levels [V, A] and read them back.

        Raises
        ------
        DeviceError : three times, other levels read back.
        """
        yield from self._put(Levels(round(voltage / STEP_V), round(current / STEP_A)))

    def _put(self, levels: Levels) -> Script[None]:
        self._commanded = levels
        self._regulation.begin_anew()
        for _ in range(SET_TRIES):
            yield f"ISET1:{levels.amperes * STEP_A:.3f}"
            yield f"VSET1:{levels.volts * STEP_V:05.2f}"
            read_back = yield from self._read_levels()
            if read_back == levels:
                return
        raise DeviceError(f"{read_back} are set after {levels} were commanded")

    def switch(self, on: bool) -> Script[None]:
        """Switch the output and check its state; off is repeated, on is not, because a protection may have tripped.

        Raises
        ------
        DeviceFault : the output is not in the demanded state.
        """
        self._regulation.begin_anew()
        if on:
            yield ON
        for _ in range(MOST_STATE_READINGS):
            if not on:
                yield OFF
            output = yield from self._read_output()
            if (output.status.on if on else self._is_on(output)) is on:
                return
        raise DeviceFault(f"the output does not switch {'on' if on else 'off'}, {output}")

    def measure(self) -> Script[SupplyReading]:
        """Measure voltage and current and read the state; every `SETTINGS_S`, also read the settings.

        A round begins after a silence, in which late answers arrive and the instrument obeys `off` at once.

        Raises
        ------
        Unreadable : a value is far above the supply's rating.
        """
        yield from self.synchronise()
        output = yield from self._read_output()
        rating = self._settings.rating
        if output.voltage > MOST_OVER_RATING * rating.voltage or output.current > MOST_OVER_RATING * rating.current:
            raise Unreadable(f"{output}, where no more than {rating.voltage:g} V and {rating.current:g} A can be")
        on = self._is_on(output)
        mode = ("constant current" if output.status.limited else "constant voltage") if on else ""
        if output.answer_time - self._settings_read_at >= SETTINGS_S:
            self._settings_read_at = output.answer_time
            levels = yield from self._read_levels()
            differs = levels != self._commanded
            self._panel = f"set to {levels} by itself; {self._commanded} were commanded" if differs else ""
        fault = self._panel or (self._regulation_fault(output) if on else "")
        return SupplyReading(output.time, output.voltage, output.current, on, mode, fault)

    def _regulation_fault(self, output: OutputState) -> str:
        """Text if the output has lost its regulation; empty if it has not."""
        levels = self._commanded.volts * STEP_V, self._commanded.amperes * STEP_A
        measured = output.voltage, output.current
        if not self._regulation.is_lost(measured, levels, output.status.limited, output.answer_time):
            return ""
        return f"out of regulation, {output.voltage:.2f} V and {output.current:.3f} A; {self._commanded} are set"

    def _is_on(self, output: OutputState) -> bool:
        off_v, off_a = self._settings.off_voltage_V, self._settings.off_current_A
        return output.status.on or output.voltage > off_v or output.current > off_a

    def _read_levels(self) -> Script[Levels]:
        volts: int = yield from ask(SET_VOLTS)
        amperes: int = yield from ask(SET_AMPERES)
        return Levels(volts, amperes)

    def _read_output(self) -> Script[OutputState]:
        state: SupplyStatus = yield from ask(STATUS)
        volts = yield VOLTS
        amperes = yield AMPERES
        assert volts is not None
        assert amperes is not None
        middle = (volts.asked + amperes.seen) / 2
        return OutputState(state, volts.value * STEP_V, amperes.value * STEP_A, middle, amperes.seen)


def identity_of(reported: KoradIdentity) -> Identity:
    """Identity that a supply has reported."""
    return Identity(reported.name, reported.serial_number, reported.firmware)


def known_names() -> str:
    """Names of the models and of their sellers, as text."""
    return ", ".join((*RATINGS, *SOLD_AS))
