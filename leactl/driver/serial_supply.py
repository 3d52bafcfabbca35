"""A power supply at the end of a serial line, whatever it speaks: demands that stay until they are confirmed, rounds of
measuring in between, and an output that is off when it is met and when it is left.

A driver composes a `SupplyLine` and tells it by `Dialogue` what is said to its instrument. Nothing waits within the
control loop: each call of `take` goes on with the conversation as far as it has come.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from leactl.driver.contract import Confirmation, Row, StreamSpec
from leactl.driver.conversation import Pause, Script, Talk, Unreadable
from leactl.driver.serial_port import SerialPort
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer
from leactl.quantities import ChannelSpec

MOST_LOST = 3  # rounds in a row
LEAVE_S = 2.0
QUANTITIES = {"leads": ("line_voltage", "line_current"), "bus": ("bus_voltage", "bus_current")}


class SupplyReading(NamedTuple):
    """One round of measuring."""

    time: float  # the middle between the first question and the last answer of voltage and current
    voltage: float
    current: float
    on: bool
    mode: str  # what it regulates, in words; empty where it is off
    fault: str = ""
    notices: tuple[str, ...] = ()


class SwitchOffTrouble:
    """What stands against an output that is off, for whoever has to say why it was not confirmed; empty before that."""

    said = ""


class Dialogue(Protocol):
    """What is said to one kind of instrument."""

    @property
    def off(self) -> bytes:
        """What switches the output off from any state, to be sent without waiting for an answer."""

    def output_off(self, progress: SwitchOffTrouble) -> Script[Confirmation]:
        """Switch off until it is seen that the output is, however often that takes."""

    def set_up(self, progress: SwitchOffTrouble) -> Script[Sequence[str]]:
        """Make off, check that it is the instrument expected, and configure it; what a reader of the run should know.

        Raises
        ------
        DeviceError : another instrument, or a setting that does not stick.
        """

    def leave(self) -> Script[Sequence[str]]:
        """Put back what `set_up` has changed and somebody else may count on; what that was.

        Raises
        ------
        DeviceError : it does not stick.
        """

    def in_step(self) -> Script[object]:
        """Drop answers that were meant for earlier questions."""

    def put(self, voltage: float, current: float) -> Script[None]:
        """Set both levels and see that they are; switches nothing.

        Raises
        ------
        DeviceError : they do not stick.
        """

    def switched(self, on: bool) -> Script[None]:
        """Switch the output and see that it is.

        Raises
        ------
        DeviceFault : it is not.
        """

    def measured(self) -> Script[SupplyReading]:
        """Voltage, current, and how the instrument fares."""


class SupplyLine:
    """The conversation with one supply; what a driver's own methods pass their calls on to."""

    def __init__(
        self, name: str, role: str, feeds: str, port: SerialPort, dialogue: Dialogue, answer_s: float, period_s: float
    ) -> None:
        """Answers may take `answer_s`, a round begins every `period_s` [s]; `feeds` is a key of `QUANTITIES`."""
        self._name, self._port, self._clock, self._dialogue = name, port, port.clock, dialogue
        self._answer_s, self._period_s = answer_s, period_s
        channels = [ChannelSpec(q, q, role, name, f"{name} {q.replace('_', ' ')}") for q in QUANTITIES[feeds]]
        self.stream = StreamSpec(name, tuple(channels))
        self.supplying = False
        self._opened = False
        self._seen_off = False  # since it was last switched on
        self._talk: Talk[None] | None = None
        self._levels: tuple[float, float] | None = None  # to be set
        self._switch: bool | None = None  # to be switched
        self._asked_on = False  # what was switched last
        self._mode = ""
        self._rows: list[Row] = []
        self._notices: list[str] = []

    def make_safe(self, deadline_s: float) -> Confirmation:
        """Switch off and see that it is, from any state, over a fresh connection if need be; never raises."""
        self._forget_demands()
        self._seen_off = False
        until = self._clock.now() + deadline_s
        trouble, progress = "", SwitchOffTrouble()
        while self._clock.now() < until:
            try:
                if not self._port.connected:
                    self._port.reopen()
                self._port.discard()
                halfway = self._clock.now() + max(0.5 * (until - self._clock.now()), min(0.1, 0.5 * deadline_s))
                script = self._dialogue.output_off(progress)
                confirmed = Talk(self._port, script, self._answer_s).finish(min(halfway, until))
            except DeviceError as error:
                if progress.said or not (trouble and isinstance(error, NoAnswer)):  # the last try has little time
                    trouble = progress.said or str(error)
                self._start_afresh(until)
                continue
            self.supplying, self._seen_off = False, True
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
                self._port.write(self._dialogue.off)
            except DeviceError:
                if not self._opened:
                    return  # no line to reach it by, which `make_safe` will tell
                self._port.reopen()
            else:
                return

    def _forget_demands(self) -> None:
        self._talk = self._levels = self._switch = None
        self._asked_on = False

    def open(self, within_s: float) -> None:
        """Meet the supply: see who it is, make it off, configure it.

        Raises
        ------
        DeviceError : it is absent, another one, refuses a setting, or cannot be made off.
        """
        self._port.open()
        self._opened = True
        self._port.discard()
        self._forget_demands()
        progress = SwitchOffTrouble()
        script = self._dialogue.set_up(progress)
        try:
            self._notices += Talk(self._port, script, self._answer_s).finish(self._clock.now() + within_s)
        except NoAnswer as error:
            if progress.said:
                raise DeviceFault(f"{self._name}: {progress.said}") from None
            raise NoAnswer(f"{self._name}: {error}") from None
        except DeviceError as error:
            raise type(error)(f"{self._name}: {error}") from None
        self.supplying, self._seen_off = False, True

    def close(self) -> None:
        """Put back what was found, where the output is off, and let the line go.

        Raises
        ------
        DeviceError : it could not be put back; the line is let go all the same.
        """
        self._talk = None
        if not self._opened:
            return
        self._opened = False
        try:
            if self._seen_off:
                self._port.discard()
                Talk(self._port, self._dialogue.leave(), self._answer_s).finish(self._clock.now() + LEAVE_S)
        except DeviceError as error:
            raise type(error)(f"its protections were not put back as they were found: {error}") from None
        finally:
            self._port.close()

    # -- demands -----------------------------------------------------------------------------------------------------

    def supply(
        self, voltage: float, current: float, most: tuple[float, float], least: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Have these levels set [V, A], in one of the next calls of `take`.

        Raises
        ------
        InputError : a value is not finite, below the least or above the most; nothing is passed on.
        """
        for value, low, top, unit in zip((voltage, current), least, most, "VA", strict=True):
            if not low <= value <= top:
                raise InputError(
                    f"{self._name}: {value:g} {unit} asked of a supply that is good for {low:g} to {top:g} {unit}"
                )
        self._levels = voltage, current

    def switch_on(self) -> None:
        """Begin to switch the output on."""
        self._switch, self._seen_off = True, False

    def switch_off(self) -> None:
        """Begin to switch the output off: at once, and then until it is confirmed.

        Raises
        ------
        DeviceError : the line is gone.
        """
        self.stop_now()
        self._switch = False

    # -- the stream --------------------------------------------------------------------------------------------------

    def take(self) -> Sequence[Row]:
        """Go on with the conversation; what has been measured since the last call; never waits.

        Raises
        ------
        DeviceError : the line is gone, the instrument has not answered three times in a row, or refuses a command.
        """
        if self._talk is None:
            self._talk = Talk(self._port, self._conversation(), self._answer_s)
        try:
            self._talk.step()
        except DeviceError as error:
            self._talk = None
            raise type(error)(f"{self._name}: {error}") from None
        if not self._rows:
            return ()
        rows, self._rows = self._rows, []
        return rows

    def notices(self) -> Sequence[str]:
        """What the instrument has told, answers that were lost, changes of what it regulates."""
        found, self._notices = self._notices, []
        return found

    def _conversation(self) -> Script[None]:
        """Carry out what was commanded and measure in between; a lost answer costs a round, the third in a row all."""
        due, lost, in_step = -math.inf, 0, False
        while True:
            try:
                if not in_step:
                    yield from self._dialogue.in_step()
                    in_step = True
                yield from self._carry_out()
                if self._clock.now() < due:
                    yield Pause()
                    continue
                due = self._clock.now() + self._period_s
                self._judge((yield from self._dialogue.measured()))
                lost = 0
            except (NoAnswer, Unreadable) as error:
                lost, in_step = lost + 1, False
                if lost >= MOST_LOST:
                    raise
                self._notices.append(f"a round was lost: {error}")

    def _carry_out(self) -> Script[None]:
        """Off before levels, levels before on; a demand stays until it has been confirmed."""
        if self._switch is False:
            yield from self._dialogue.switched(False)
            self.supplying, self._switch = False, None if self._switch is False else self._switch
        if self._levels is not None:
            levels = self._levels
            yield from self._dialogue.put(*levels)
            self._levels = None if self._levels is levels else self._levels
        if self._switch is True:
            self._asked_on = True
            yield from self._dialogue.switched(True)
            self.supplying, self._switch = True, None if self._switch is True else self._switch

    def _judge(self, reading: SupplyReading) -> None:
        self.supplying, fault = reading.on, reading.fault
        if reading.on is not self._asked_on and not fault:
            fault = f"the output is {'on' if reading.on else 'off'} by itself"
        if reading.mode and reading.mode != self._mode:
            self._notices.append(f"{reading.mode}: {reading.voltage:.3f} V, {reading.current:.3f} A")
        self._mode = reading.mode
        self._notices += reading.notices
        values = (math.nan, math.nan) if fault else (reading.voltage, reading.current)
        self._rows.append(Row(self._name, reading.time, values, f"{self._name}: {fault}" if fault else ""))
