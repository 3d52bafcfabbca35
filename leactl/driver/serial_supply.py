"""A power supply on a serial line, independent of its command set.

Demands are repeated until they are confirmed, rounds of measuring run in between, and the output is switched off when
the supply is opened and closed.

A driver composes a `SupplyLine` with a `Dialogue` that knows the commands of its instrument; the methods of a
`SupplyDriver` are those of its line. Nothing waits within the control loop: each call of `take` continues the
conversation as far as possible.
"""

import math
from collections.abc import Sequence
from typing import ClassVar, NamedTuple, Protocol

from leactl.driver.contract import Confirmation, Driver, Row, StreamSpec
from leactl.driver.conversation import Pause, Script, Talk, Unreadable
from leactl.driver.serial_port import SerialPort
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer
from leactl.quantities import ChannelSpec

MOST_FAILURES = 3  # of rounds in sequence, or of attempts to restore the settings; the third raises
RESTORE_S = 2.0  # time to restore the settings, without the timeouts of lost answers
TRY_S = 0.1  # shortest time for one attempt to switch off
# an output may differ from its set level by this share of the level plus this many V or A, for this long
REGULATION_SHARE, REGULATION_V, REGULATION_A, REGULATION_S = 0.03, 0.1, 0.1, 1.0
STEP_TOLERANCE = 1e-6  # of a step: rounding error of a decimal number divided by the step
QUANTITIES = {"leads": ("line_voltage", "line_current"), "bus": ("bus_voltage", "bus_current")}


class SupplyReading(NamedTuple):
    """One round of measuring."""

    time: float  # s, middle between the first query and the last reply for voltage and current
    voltage: float
    current: float
    on: bool
    mode: str  # "constant voltage" or "constant current"; empty if the output is off
    fault: str = ""
    notices: tuple[str, ...] = ()


class SwitchOffTrouble:
    """Reason why an output is not confirmed off; a dialogue sets `text`, which is empty at first."""

    text = ""


class Regulation:
    """Watches whether an output that is on keeps its set levels, for an instrument that does not report it."""

    def __init__(self) -> None:
        self._off_level_since: float | None = None  # None: no measurement since the last command

    def begin_anew(self) -> None:
        """Allow `REGULATION_S` for the output to follow a command."""
        self._off_level_since = None

    def is_lost(self, measured: tuple[float, float], levels: tuple[float, float], limited: bool, moment: float) -> bool:
        """Return whether the output has been off its levels for `REGULATION_S`, up to this measurement.

        Parameters
        ----------
        measured, levels : voltage and current [V, A], measured and set.
        limited : whether the instrument regulates the current, otherwise the voltage; the quantity that it does not
            regulate may be below its level.
        moment : of the measurement [s].
        """
        (volts, amperes), (set_volts, set_amperes) = measured, levels
        tolerance_v = REGULATION_SHARE * set_volts + REGULATION_V
        tolerance_a = REGULATION_SHARE * set_amperes + REGULATION_A
        over_v, over_a = volts - set_volts, amperes - set_amperes
        reaches_level = over_a >= -tolerance_a if limited else over_v >= -tolerance_v
        if (reaches_level and over_v <= tolerance_v and over_a <= tolerance_a) or self._off_level_since is None:
            self._off_level_since = moment
        return moment - self._off_level_since >= REGULATION_S


def refuse_between_steps(name: str, levels: tuple[float, float], steps: tuple[float, float]) -> None:
    """Raise InputError if a level [V, A] is between two steps [V, A] of an instrument.

    name : of the supply, for the message.
    """
    for value, step, unit in zip(levels, steps, "VA", strict=True):
        count = value / step
        if math.isfinite(count) and abs(count - round(count)) > STEP_TOLERANCE:
            raise InputError(f"{name}: {value:g} {unit} asked of a supply with steps of {step:g} {unit}")


class Dialogue(Protocol):
    """The commands of one kind of instrument, as scripts for `Talk`."""

    @property
    def off(self) -> bytes:
        """Bytes that switch the output off from any state, sent without waiting for a reply."""

    def output_off(self, off_trouble: SwitchOffTrouble) -> Script[Confirmation]:
        """Switch off repeatedly until the output is measured or reported off."""

    def set_up(self, off_trouble: SwitchOffTrouble) -> Script[Sequence[str]]:
        """Switch off, check that it is the expected instrument, and configure it; return notices.

        Raises
        ------
        DeviceError : another instrument, or a setting that reads back differently.
        """

    def leave(self) -> Script[Sequence[str]]:
        """Restore the settings that `set_up` changed; return their names.

        After an error it is run again and restores the settings that are not confirmed yet.

        Raises
        ------
        DeviceError : a setting reads back differently.
        """

    def synchronise(self) -> Script[object]:
        """Drop replies to earlier queries."""

    def put(self, voltage: float, current: float) -> Script[None]:
        """Set voltage [V] and current [A] and read both back; switch nothing.

        Raises
        ------
        DeviceError : a level reads back differently.
        """

    def switch(self, on: bool) -> Script[None]:
        """Switch the output and check its state.

        Raises
        ------
        DeviceFault : the output is not in the demanded state.
        """

    def measure(self) -> Script[SupplyReading]:
        """Measure voltage and current, and read the state of the instrument."""


class SupplySettings(Protocol):
    """Settings that every supply's driver has."""

    @property
    def feeds(self) -> str:
        """What the output feeds, a key of `QUANTITIES`."""

    @property
    def voltage_limit_V(self) -> float:  # noqa: N802 (a unit keeps its letter)
        """Highest voltage that may be demanded [V]."""

    @property
    def current_limit_A(self) -> float:  # noqa: N802
        """Highest current that may be demanded [A]."""

    @property
    def answer_s(self) -> float:
        """Timeout of a reply [s]."""

    @property
    def period_s(self) -> float:
        """Time between rounds of measuring [s]."""


class SupplyLine:
    """The conversation with one supply; a driver's methods delegate to it."""

    def __init__(
        self, name: str, role: str, settings: SupplySettings, port: SerialPort, dialogue: Dialogue, try_s: float = TRY_S
    ) -> None:
        """`try_s` is the shortest time for an attempt of `output_off`, which may take half of the remaining time."""
        self._name, self._port, self._clock, self._dialogue = name, port, port.clock, dialogue
        self._answer_s, self._period_s, self._try_s = settings.answer_s, settings.period_s, try_s
        self.most = settings.voltage_limit_V, settings.current_limit_A
        channels = [ChannelSpec(q, q, role, name, f"{name} {q.replace('_', ' ')}") for q in QUANTITIES[settings.feeds]]
        self.stream = StreamSpec(name, tuple(channels))
        self.supplying = False
        self._is_open = False
        self._confirmed_off = False  # since the output was last switched on
        self._conversation_underway: Talk[None] | None = None
        self._demanded_levels: tuple[float, float] | None = None
        self._demanded_switch: bool | None = None
        self._expected_on = False  # the output, after the last command to switch it
        self._mode = ""
        self._rows: list[Row] = []
        self._notices: list[str] = []

    def make_safe(self, deadline_s: float) -> Confirmation:
        """Switch off and confirm it, from any state, over a new connection if needed; never raise."""
        self._forget_demands()
        self._confirmed_off = False
        deadline = self._clock.now() + deadline_s
        reason, off_trouble = "", SwitchOffTrouble()
        while self._clock.now() < deadline:
            try:
                if not self._port.connected:
                    self._port.reopen()
                self._port.discard()
                attempt_deadline = self._clock.now() + max(
                    0.5 * (deadline - self._clock.now()), min(self._try_s, 0.5 * deadline_s)
                )
                script = self._dialogue.output_off(off_trouble)
                confirmation = Talk(self._port, script, self._answer_s).finish(min(attempt_deadline, deadline))
            except DeviceError as error:
                # a missing answer replaces no other reason: the last attempt has little time for one
                if off_trouble.text or not (reason and isinstance(error, NoAnswer)):
                    reason = off_trouble.text or str(error)
                self._start_afresh(deadline)
                continue
            self.supplying, self._confirmed_off = False, True
            break
        else:
            confirmation = Confirmation(False, f"not confirmed within {deadline_s:g} s: {reason or 'no time was left'}")
        if not self._is_open:
            self._port.close()
        return confirmation

    def _start_afresh(self, deadline: float) -> None:
        """Connect anew; if that fails, wait for 20 ms, at most until the deadline, before the next attempt."""
        try:
            self._port.reopen()
        except DeviceError:
            self._clock.sleep_until(min(deadline, self._clock.now() + 0.02))

    def stop_now(self) -> None:
        """Send the command that switches the output off, without waiting; over a new connection if needed."""
        self._forget_demands()
        for _ in range(2):
            try:
                if not self._port.connected:
                    self._port.reopen()
                self._port.write(self._dialogue.off)
            except DeviceError:
                if not self._is_open:
                    return  # there is no line to the supply; `make_safe` returns that as its reason
                self._port.reopen()
            else:
                return

    def _forget_demands(self) -> None:
        """End the conversation and drop its demands; from now on the output is expected to be off."""
        self._conversation_underway = self._demanded_levels = self._demanded_switch = None
        self._expected_on = False

    def open(self, within_s: float) -> None:
        """Connect to the supply: identify it, switch it off, configure it.

        Raises
        ------
        DeviceError : it is absent, another one, refuses a setting, or cannot be switched off.
        """
        self._port.open()
        self._is_open = True
        self._port.discard()
        self._forget_demands()
        off_trouble = SwitchOffTrouble()
        script = self._dialogue.set_up(off_trouble)
        try:
            self._notices += Talk(self._port, script, self._answer_s).finish(self._clock.now() + within_s)
        except NoAnswer as error:
            if off_trouble.text:
                raise DeviceFault(f"{self._name}: {off_trouble.text}") from None
            raise NoAnswer(f"{self._name}: {error}") from None
        except DeviceError as error:
            raise type(error)(f"{self._name}: {error}") from None
        self.supplying, self._confirmed_off = False, True

    def close(self) -> None:
        """Restore the settings found at `open` if the output is off, and close the line.

        Raises
        ------
        DeviceError : a setting could not be restored; the line is closed all the same.
        """
        self._conversation_underway = None
        if not self._is_open:
            return
        self._is_open = False
        try:
            if self._confirmed_off:
                self._restore_settings()
        except DeviceError as error:
            raise type(error)(f"its protections were not put back as they were found: {error}") from None
        finally:
            self._port.close()

    def _restore_settings(self) -> None:
        """Restore the settings; after an error over a new connection, in `MOST_FAILURES` attempts at most."""
        deadline = self._clock.now() + RESTORE_S + MOST_FAILURES * self._answer_s
        for tries_left in reversed(range(MOST_FAILURES)):
            try:
                self._port.discard()
                Talk(self._port, self._dialogue.leave(), self._answer_s).finish(deadline)
            except DeviceError:
                if not tries_left or self._clock.now() >= deadline:
                    raise
                self._start_afresh(deadline)
            else:
                return

    # -- demands -----------------------------------------------------------------------------------------------------

    def supply(self, voltage: float, current: float, least: tuple[float, float] = (0.0, 0.0)) -> None:
        """Demand these levels [V, A]; one of the next calls of `take` sets them.

        Raises
        ------
        InputError : a value is not finite, below `least` or above `most`; nothing is sent.
        """
        for value, lowest, highest, unit in zip((voltage, current), least, self.most, "VA", strict=True):
            if not lowest <= value <= highest:
                raise InputError(
                    f"{self._name}: {value:g} {unit} asked of a supply that is good for {lowest:g} to"
                    f" {highest:g} {unit}"
                )
        self._demanded_levels = voltage, current

    def switch_on(self) -> None:
        """Begin to switch the output on."""
        self._demanded_switch, self._confirmed_off = True, False

    def switch_off(self) -> None:
        """Send the command to switch off at once, and repeat it in `take` until it is confirmed.

        Raises
        ------
        DeviceError : the line is gone.
        """
        self.stop_now()
        self._demanded_switch = False

    # -- the stream --------------------------------------------------------------------------------------------------

    def take(self) -> Sequence[Row]:
        """Continue the conversation without waiting; return the rows measured since the last call.

        Raises
        ------
        DeviceError : the line is gone, the instrument did not answer three times in sequence, or refuses a command.
        """
        if self._conversation_underway is None:
            self._conversation_underway = Talk(self._port, self._conversation(), self._answer_s)
        try:
            self._conversation_underway.step()
        except DeviceError as error:
            self._conversation_underway = None
            raise type(error)(f"{self._name}: {error}") from None
        if not self._rows:
            return ()
        rows, self._rows = self._rows, []
        return rows

    def notices(self) -> Sequence[str]:
        """Return the notices since the last call: the instrument's messages, lost rounds, changes of the mode."""
        notices, self._notices = self._notices, []
        return notices

    def _conversation(self) -> Script[None]:
        """Carry out demands and measure in between; a lost reply loses a round, and the third in sequence raises."""
        next_round, lost_rounds, is_synchronised = -math.inf, 0, False
        while True:
            try:
                if not is_synchronised:
                    yield from self._dialogue.synchronise()
                    is_synchronised = True
                yield from self._carry_out()
                if self._clock.now() < next_round:
                    yield Pause()
                    continue
                next_round = self._clock.now() + self._period_s
                self._record_reading((yield from self._dialogue.measure()))
                lost_rounds = 0
            except (NoAnswer, Unreadable) as error:
                lost_rounds, is_synchronised = lost_rounds + 1, False
                if lost_rounds >= MOST_FAILURES:
                    raise
                self._notices.append(f"a round was lost: {error}")

    def _carry_out(self) -> Script[None]:
        """Carry out demands in the order off, levels, on; each demand stays until it is confirmed."""
        if self._demanded_switch is False:
            yield from self._dialogue.switch(False)
            self.supplying = False
            self._demanded_switch = None if self._demanded_switch is False else self._demanded_switch
        if self._demanded_levels is not None:
            levels = self._demanded_levels
            yield from self._dialogue.put(*levels)
            self._demanded_levels = None if self._demanded_levels is levels else self._demanded_levels
        if self._demanded_switch is True:
            self._expected_on = True
            yield from self._dialogue.switch(True)
            self.supplying = True
            self._demanded_switch = None if self._demanded_switch is True else self._demanded_switch

    def _record_reading(self, reading: SupplyReading) -> None:
        """Store a reading as a row; it is a fault if the output is not in the commanded state."""
        self.supplying, fault = reading.on, reading.fault
        if reading.on is not self._expected_on and not fault:
            fault = f"the output is {'on' if reading.on else 'off'} by itself"
        if reading.mode and reading.mode != self._mode:
            self._notices.append(f"{reading.mode}: {reading.voltage:.3f} V, {reading.current:.3f} A")
        self._mode = reading.mode
        self._notices += reading.notices
        values = (math.nan, math.nan) if fault else (reading.voltage, reading.current)
        self._rows.append(Row(self._name, reading.time, values, f"{self._name}: {fault}" if fault else ""))


class SupplyDriver(Driver):
    """A driver whose methods are those of its `SupplyLine`; it adds what its instrument is and can."""

    _line: SupplyLine
    open_s: ClassVar[float]  # longest time that opening may take

    def safe_state(self, deadline_s: float) -> Confirmation:
        """Switch off and confirm it, from any state, over a new connection if needed; never raise."""
        return self._line.make_safe(deadline_s)

    def stop_now(self) -> None:
        """Send the command that switches the output off, without waiting; over a new connection if needed."""
        self._line.stop_now()

    def open(self) -> None:
        """Connect to the supply: identify it, switch it off, configure it.

        Raises
        ------
        DeviceError : it is absent, another one, refuses a setting, or cannot be switched off.
        """
        self._line.open(self.open_s)

    def close(self) -> None:
        """Close the line.

        Raises
        ------
        DeviceError : a setting could not be restored; the line is closed all the same.
        """
        self._line.close()

    @property
    def most(self) -> tuple[float, float]:
        """Highest voltage [V] and current [A] that `supply` accepts, by the settings."""
        return self._line.most

    @property
    def supplying(self) -> bool:
        """Whether the output is on, by the instrument's last report or measurement."""
        return self._line.supplying

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

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """Voltage and current at the terminals, one stamp for both."""
        return (self._line.stream,)

    def take(self) -> Sequence[Row]:
        """Continue the conversation without waiting; return the rows measured since the last call.

        Raises
        ------
        DeviceError : the line is gone, the instrument did not answer three times in sequence, or refuses a command.
        """
        return self._line.take()

    def notices(self) -> Sequence[str]:
        """Return the notices since the last call, those of `SupplyLine.notices`."""
        return self._line.notices()
