"""What is said to a supply: to get in step with it, to take its output away, to set it up, to command it, to measure.

Every setting is read back, so that no more than one command is ever under way and what was refused is seen at once.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

from leactl.driver.contract import Confirmation
from leactl.driver.conversation import Question, Script
from leactl.driver.serial_supply import Progress, Reading
from leactl.errors import DeviceError, DeviceFault
from leactl_plugins.scpi_supply import answers, models
from leactl_plugins.scpi_supply.answers import Entry, Identity
from leactl_plugins.scpi_supply.dialects import DIALECTS, Protection
from leactl_plugins.scpi_supply.settings import ScpiSupplySettings

MOST_ERRORS = 32  # the queue of an E36xx holds 20
REGULATED = {1: "constant current", 2: "constant voltage"}  # STAT:QUES:COND?, the same in both families
IDENTIFY = Question("*IDN?", answers.identity, patient=True)
OUTPUT = Question("OUTP?", answers.truth)
FIRST = OUTPUT._replace(patient=True)  # after who it is: an answer to whoever asked before may be taken for that one
CONDITION = Question("STAT:QUES:COND?", answers.register)
ERROR = Question("SYST:ERR?", answers.entry)


class ScpiDialogue:
    """What is said to the supply of these settings."""

    def __init__(self, settings: ScpiSupplySettings) -> None:
        self._settings, self._dialect = settings, DIALECTS[settings.dialect]
        self.met: Identity | None = None  # who answered last
        volts, amperes = models.most(settings.model)
        reading = partial(answers.reading, form=self._dialect.reading)
        self._voltage = Question("MEAS:VOLT?", partial(reading, rating=volts))
        self._current = Question("MEAS:CURR?", partial(reading, rating=amperes))

    @property
    def off(self) -> bytes:
        """What switches the output off from any state."""
        return self._dialect.off

    def in_step(self) -> Script[Identity]:
        """Ask who answers: what comes before that answer was meant for an earlier question, and is dropped."""
        who: Identity = yield from _asked(IDENTIFY)
        return who

    def output_off(self, progress: Progress) -> Script[Confirmation]:
        """Switch off until the instrument says so and no current flows, however often that takes.

        The first command may be lost to a half-sent one or to an answer under way, so it is repeated.
        """
        while True:
            yield self._dialect.off
            self._check((yield from self.in_step()))
            on = yield from _asked(FIRST)
            if on:
                progress.said = "the output is still on"
                continue
            current = yield from _asked(self._current)
            if abs(current) <= self._settings.off_current_A:
                return Confirmation(True, f"output off, {current:.3f} A")
            progress.said = f"the output is said to be off and {current:.3f} A flow"

    def _check(self, who: Identity) -> None:
        """Refuse another instrument."""
        settings, self.met = self._settings, who
        if who.model != settings.model:
            raise DeviceError(f"{who.maker} {who.model} answers; {settings.model} was expected")
        if settings.serial_number and who.serial_number != settings.serial_number:
            raise DeviceError(f"serial number {who.serial_number} answers; {settings.serial_number} was expected")

    def set_up(self, progress: Progress) -> Script[Sequence[str]]:
        """Make off, then arm both protections at their limits, with nothing set; errors of whoever was there before.

        Raises
        ------
        DeviceError : another instrument, a setting that does not stick, a protection that has tripped, an output that
            cannot be switched off.
        """
        settings = self._settings
        yield from self.output_off(progress)
        before = yield from _errors()
        if settings.output_range:
            yield f"{self._dialect.set_range} {settings.output_range.upper()}"
        yield from _written("VOLT", "VOLT?", 0.0)
        yield from _written("CURR", "CURR?", 0.0)
        yield from _protect(self._dialect.voltage, settings.voltage_limit_V)
        yield from _protect(self._dialect.current, settings.current_limit_A)
        refused = yield from _errors()
        if refused:
            raise DeviceError("; ".join(f"error {number}, {text}" for number, text in refused))
        return [f"had an error from before: {number}, {text}" for number, text in before]

    def put(self, voltage: float, current: float) -> Script[None]:
        """Set both levels [V, A] and read them back.

        Raises
        ------
        DeviceError : one comes back as another.
        """
        yield from _written("CURR", "CURR?", current)
        yield from _written("VOLT", "VOLT?", voltage)

    def switched(self, on: bool) -> Script[None]:
        """Switch the output and see that it is.

        Raises
        ------
        DeviceFault : the instrument says that it is not.
        """
        yield f"OUTP {'ON' if on else 'OFF'}"
        if (yield from _asked(OUTPUT)) is not on:
            raise DeviceFault(f"the output does not switch {'on' if on else 'off'}")

    def measured(self) -> Script[Reading]:
        """Voltage, current, and how the instrument fares."""
        voltage = yield self._voltage
        current = yield self._current
        assert voltage is not None and current is not None
        on = yield from _asked(OUTPUT)
        condition = yield from _asked(CONDITION)
        found = yield from _errors()
        fault = yield from self._tripped()
        mode = REGULATED.get(condition, "") if on else ""
        if on and not mode and not fault:
            fault = f"out of regulation, condition {condition}"
        told = tuple(f"error {number}, {text}" for number, text in found)
        return Reading((voltage.asked + current.seen) / 2, voltage.value, current.value, on, mode, fault, told)

    def _tripped(self) -> Script[str]:
        """Which protection has tripped; empty where none has."""
        for protection in (self._dialect.voltage, self._dialect.current):
            if (yield from _asked(Question(protection.tripped, answers.truth))):
                return f"{protection.name} has tripped"
        return ""


def _protect(protection: Protection, level: float) -> Script[None]:
    yield from _written(protection.set_level, protection.level, level)
    yield protection.arm
    if not (yield from _asked(Question(protection.armed, answers.truth))):
        raise DeviceError(f"{protection.name} does not stay on")
    if (yield from _asked(Question(protection.tripped, answers.truth))):
        raise DeviceFault(f"{protection.name} has tripped; find out why, then clear it at the instrument")


def _written(command: str, query: str, value: float) -> Script[None]:
    """Write a level and read it back; more than 0.5 % and 10 m of its unit away it was refused."""
    yield f"{command} {value:.4f}"
    held = yield from _asked(Question(query, answers.number))
    if not abs(held - value) <= 0.005 * value + 0.01:
        raise DeviceError(f"{command} holds {held:g} after {value:g} was written")


def _errors() -> Script[tuple[Entry, ...]]:
    """Empty the error queue."""
    found: list[Entry] = []
    while (entry := (yield from _asked(ERROR))).number:
        found.append(entry)
        if len(found) > MOST_ERRORS:
            raise DeviceError(f"the error queue does not end; last error {entry.number}, {entry.text}")
    return tuple(found)


def _asked(question: Question) -> Script[Any]:
    """The value of an answer."""
    answer = yield question
    assert answer is not None
    return answer.value
