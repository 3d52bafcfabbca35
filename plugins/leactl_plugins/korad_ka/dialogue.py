"""Commands of a supply that confirms none of them and whose answers have no end mark: every setting is read back.

Silence ends an answer, so that too many bytes are noticed as well as too few. An answer does not identify its query.
Before an output counts as off, a voltage has to be read back that none of the last 99 attempts has set.
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
from leactl_plugins.korad_ka.settings import (
    RATINGS,
    SOLD_AS,
    STEP_A,
    STEP_V,
    TOO_SLOW_FIRMWARE,
    KoradKaSettings,
    model_of,
)

ON, OFF = "OUT1", "OUT0"
ANSWER_END_S = 0.03  # silence that ends an answer; an adapter on USB holds bytes back for up to 16 ms
QUIET_S = 0.1  # silence after which no answer to an earlier query is expected any more
LONGEST_CHATTER_S = 0.5  # time within which a line must become silent; late answers have passed by then
FIRST_MARK, MARK_COUNT = 100, 100  # voltages of 1.00 V to 1.99 V; each attempt to switch off sets the next one
SET_TRIES = 3  # attempts to set the levels
MOST_STATE_READINGS = 10  # in which a switched output has to rise or fall
SETTINGS_CHECK_INTERVAL_S = 1.0  # time between two readings of the settings, which a person may change at the panel
# sigrok's wiki: OVP1 and OCP1 switch off above the set voltage or current; no command sets or reads a level
UNPROTECTED_NOTICE = (
    "no protection with a level of its own (OVP, OCP): voltage_limit_V and current_limit_A bound nothing but what is"
    " commanded"
)
HIGHEST_READING_OVER_RATING = 1.2  # highest credible voltage or current, over the rating of the model


def _query(text: str, parse: Callable[[bytes], Any]) -> Query:
    """Return a query whose answer ends with a silence."""
    return Query(text, parse, silence_s=ANSWER_END_S)


SET_VOLTAGE_QUERY, SET_CURRENT_QUERY = (
    _query("VSET1?", replies.parse_hundredths),
    _query("ISET1?", replies.parse_set_thousandths),
)
VOLTAGE_QUERY, CURRENT_QUERY = _query("VOUT1?", replies.parse_hundredths), _query("IOUT1?", replies.parse_thousandths)
STATUS, IDENTIFY = _query("STATUS?", replies.parse_status), _query("*IDN?", replies.parse_identity)


class Levels(NamedTuple):
    """Set levels, in whole steps."""

    voltage_steps: int  # of 0.01 V
    current_steps: int  # of 0.001 A

    def __str__(self) -> str:
        return f"{self.voltage_steps * STEP_V:.2f} V and {self.current_steps * STEP_A:.3f} A"


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
        self._last_mark = 0  # steps above `FIRST_MARK`, set by the last attempt to switch off
        self._settings_read_at = 0.0  # time [s] at which the settings were read
        self._regulation = Regulation()
        self._panel_fault_text = ""  # empty unless the settings were changed at the panel
        self.reported_identity: KoradIdentity | None = None  # of the last `set_up`

    def synchronise(self) -> Script[None]:
        """Wait until nothing has arrived for `QUIET_S`.

        Raises
        ------
        NoAnswer : the line is not silent within `LONGEST_CHATTER_S`.
        """
        deadline = self._port.clock.now() + LONGEST_CHATTER_S
        while not self._port.silent_for(QUIET_S):
            if self._port.clock.now() >= deadline:
                raise NoAnswer(f"the line was never silent for {QUIET_S:g} s within {LONGEST_CHATTER_S:g} s")
            yield Pause()

    def output_off(self, off_trouble: SwitchOffTrouble) -> Script[Confirmation]:
        """Switch off repeatedly until the state is off and neither voltage nor current are measured.

        Each attempt sets and reads back a voltage that the last 99 attempts did not use. All answers after that value
        are thereby known to be later than the command, and an output that does not switch off is at least turned down.
        """
        while True:
            yield OFF
            self._last_mark = (self._last_mark + 1) % MARK_COUNT
            mark_steps = FIRST_MARK + self._last_mark
            yield f"VSET1:{mark_steps * STEP_V:05.2f}"
            try:
                read_back: int = yield from ask(SET_VOLTAGE_QUERY)
                if read_back != mark_steps:
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
            if (reported.name, reported.firmware) == TOO_SLOW_FIRMWARE:
                raise DeviceError(
                    f"{reported.name} with firmware {reported.firmware} answers, which needs too long for a command"
                )
            if model_of(reported.name) != model:
                names = " or ".join(
                    [f"KORAD{model}", *(name for name, sold_model in SOLD_AS.items() if sold_model == model)]
                )
                raise DeviceError(f"{reported.name} answers; a {model}, which answers {names}, was expected")
            self.reported_identity = reported
        yield from self._put(Levels(0, 0))
        return notices

    def identity(self) -> Identity:
        """Return the name, serial number and firmware that the supply has reported; a field is empty if it has not."""
        return identity_of(self.reported_identity) if self.reported_identity else Identity()

    def leave(self) -> Script[Sequence[str]]:
        """Do nothing: `set_up` does not change the protections, since OCP would end every current-regulated output."""
        yield from ()
        return ()

    def put(self, voltage: float, current: float) -> Script[None]:
        """Set both levels [V, A] and read them back.

        Raises
        ------
        DeviceError : other levels read back after each of `SET_TRIES` attempts.
        """
        yield from self._put(Levels(round(voltage / STEP_V), round(current / STEP_A)))

    def _put(self, levels: Levels) -> Script[None]:
        """Set both levels and read them back, repeatedly if needed; raise DeviceError if they differ in the end."""
        self._commanded = levels
        self._regulation.begin_anew()
        for _ in range(SET_TRIES):
            yield f"ISET1:{levels.current_steps * STEP_A:.3f}"
            yield f"VSET1:{levels.voltage_steps * STEP_V:05.2f}"
            read_back = yield from self._read_levels()
            if read_back == levels:
                return
        raise DeviceError(f"{read_back} are set after {levels} were commanded")

    def switch(self, on: bool) -> Script[None]:
        """Switch the output and check its state.

        The command to switch off is repeated. The command to switch on is not, because a protection may have tripped.

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
        """Measure voltage and current and read the state; every `SETTINGS_CHECK_INTERVAL_S`, also read the settings.

        A round begins after a silence, in which late answers arrive and the instrument would obey `off` at once.

        Raises
        ------
        Unreadable : a value is far above the supply's rating.
        """
        yield from self.synchronise()
        output = yield from self._read_output()
        rating = self._settings.rating
        if (
            output.voltage > HIGHEST_READING_OVER_RATING * rating.voltage
            or output.current > HIGHEST_READING_OVER_RATING * rating.current
        ):
            raise Unreadable(f"{output}, where no more than {rating.voltage:g} V and {rating.current:g} A can be")
        on = self._is_on(output)
        mode = ("constant current" if output.status.current_limited else "constant voltage") if on else ""
        if output.answer_time - self._settings_read_at >= SETTINGS_CHECK_INTERVAL_S:
            self._settings_read_at = output.answer_time
            levels = yield from self._read_levels()
            levels_differ = levels != self._commanded
            self._panel_fault_text = (
                f"set to {levels} by itself; {self._commanded} were commanded" if levels_differ else ""
            )
        fault = self._panel_fault_text or (self._regulation_fault(output) if on else "")
        return SupplyReading(output.time, output.voltage, output.current, on, mode, fault)

    def _regulation_fault(self, output: OutputState) -> str:
        """Return a text if the output has lost its regulation; empty if it has not."""
        levels = self._commanded.voltage_steps * STEP_V, self._commanded.current_steps * STEP_A
        measured = output.voltage, output.current
        if not self._regulation.is_lost(measured, levels, output.status.current_limited, output.answer_time):
            return ""
        return f"out of regulation, {output.voltage:.2f} V and {output.current:.3f} A; {self._commanded} are set"

    def _is_on(self, output: OutputState) -> bool:
        """Return whether the output reports to be on, or its voltage or current exceeds its `off_` setting."""
        off_voltage, off_current = self._settings.off_voltage_V, self._settings.off_current_A
        return output.status.on or output.voltage > off_voltage or output.current > off_current

    def _read_levels(self) -> Script[Levels]:
        """Read the set levels."""
        voltage_steps: int = yield from ask(SET_VOLTAGE_QUERY)
        current_steps: int = yield from ask(SET_CURRENT_QUERY)
        return Levels(voltage_steps, current_steps)

    def _read_output(self) -> Script[OutputState]:
        """Read the state of the output, its voltage and its current."""
        status: SupplyStatus = yield from ask(STATUS)
        voltage = yield VOLTAGE_QUERY
        current = yield CURRENT_QUERY
        assert voltage is not None
        assert current is not None
        middle_time = (voltage.asked + current.seen) / 2
        return OutputState(status, voltage.value * STEP_V, current.value * STEP_A, middle_time, current.seen)


def identity_of(reported: KoradIdentity) -> Identity:
    """Return what a supply has reported as the identity of a device."""
    return Identity(reported.name, reported.serial_number, reported.firmware)


def known_names() -> str:
    """Return the names by which the models and their resold versions are known, as text."""
    return ", ".join((*RATINGS, *SOLD_AS))
