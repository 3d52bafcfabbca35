"""What is said to a supply: to get in step with it, to take its output away, to set it up, to command it, to measure.

Every setting is read back, so that no more than one command is ever under way and what was refused is seen at once.
"""

from typing import Any, NamedTuple

from leactl.driver.contract import Confirmation
from leactl.errors import DeviceError, DeviceFault
from leactl_plugins.scpi_supply import answers
from leactl_plugins.scpi_supply.answers import Entry, Identity
from leactl_plugins.scpi_supply.dialects import Dialect, Protection
from leactl_plugins.scpi_supply.settings import ScpiSupplySettings
from leactl_plugins.scpi_supply.talk import Question, Script

MOST_ERRORS = 32  # the queue of an E36xx holds 20
REGULATED = {1: "constant current", 2: "constant voltage"}  # STAT:QUES:COND?, the same in both families
IDENTIFY = Question("*IDN?", answers.identity, patient=True)
OUTPUT = Question("OUTP?", answers.truth)
VOLTAGE = Question("MEAS:VOLT?", answers.number)
CURRENT = Question("MEAS:CURR?", answers.number)
CONDITION = Question("STAT:QUES:COND?", answers.register)
ERROR = Question("SYST:ERR?", answers.entry)


class Reading(NamedTuple):
    """One round of measuring."""

    time: float  # the middle between the first question and the last answer of voltage and current
    voltage: float
    current: float
    on: bool
    condition: int
    errors: tuple[Entry, ...]


class Progress:
    """What stands against an output that is off, for whoever has to say why it was not confirmed; empty before that."""

    said = ""


def in_step() -> Script[Identity]:
    """Ask who answers: what comes before that answer was meant for an earlier question, and is dropped."""
    who: Identity = yield from asked(IDENTIFY)
    return who


def output_off(dialect: Dialect, settings: ScpiSupplySettings, progress: Progress) -> Script[Confirmation]:
    """Switch off until the instrument says so and no current flows, however often that takes.

    The first command may be lost to a half-sent one or to an answer under way, so it is repeated.
    """
    while True:
        yield dialect.off
        check_identity((yield from in_step()), settings)
        on = yield from asked(OUTPUT)
        if on:
            progress.said = "the output is still on"
            continue
        current = yield from asked(CURRENT)
        if abs(current) <= settings.off_current_A:
            return Confirmation(True, f"output off, {current:.3f} A")
        progress.said = f"the output is said to be off and {current:.3f} A flow"


def check_identity(who: Identity, settings: ScpiSupplySettings) -> None:
    """Refuse another instrument.

    Raises
    ------
    DeviceError : model or serial number differ from those of the settings.
    """
    if who.model != settings.model:
        raise DeviceError(f"{who.maker} {who.model} answers; {settings.model} was expected")
    if settings.serial_number and who.serial_number != settings.serial_number:
        raise DeviceError(f"serial number {who.serial_number} answers; {settings.serial_number} was expected")


def set_up(dialect: Dialect, settings: ScpiSupplySettings, progress: Progress) -> Script[tuple[Entry, ...]]:
    """Make off, then arm both protections at their limits, with nothing set; errors of whoever was there before.

    Raises
    ------
    DeviceError : another instrument, a setting that does not stick, a protection that has tripped, an output that
        cannot be switched off.
    """
    yield from output_off(dialect, settings, progress)
    before = yield from errors()
    if settings.output_range:
        yield f"{dialect.set_range} {settings.output_range.upper()}"
    yield from written("VOLT", "VOLT?", 0.0)
    yield from written("CURR", "CURR?", 0.0)
    yield from _protect(dialect.voltage, settings.voltage_limit_V)
    yield from _protect(dialect.current, settings.current_limit_A)
    refused = yield from errors()
    if refused:
        raise DeviceError("; ".join(f"error {number}, {text}" for number, text in refused))
    return before


def _protect(protection: Protection, level: float) -> Script[None]:
    yield from written(protection.set_level, protection.level, level)
    yield protection.arm
    if not (yield from asked(Question(protection.armed, answers.truth))):
        raise DeviceError(f"{protection.name} does not stay on")
    if (yield from asked(Question(protection.tripped, answers.truth))):
        raise DeviceFault(f"{protection.name} has tripped; find out why, then clear it at the instrument")


def written(command: str, query: str, value: float) -> Script[None]:
    """Write a level and read it back.

    Raises
    ------
    DeviceError : it comes back as another one, more than 0.5 % and 10 m of its unit away.
    """
    yield f"{command} {value:.4f}"
    held = yield from asked(Question(query, answers.number))
    if not abs(held - value) <= 0.005 * value + 0.01:
        raise DeviceError(f"{command} holds {held:g} after {value:g} was written")


def switched(on: bool) -> Script[None]:
    """Switch the output and see that it is.

    Raises
    ------
    DeviceFault : the instrument says that it is not.
    """
    yield f"OUTP {'ON' if on else 'OFF'}"
    if (yield from asked(OUTPUT)) is not on:
        raise DeviceFault(f"the output does not switch {'on' if on else 'off'}")


def measured() -> Script[Reading]:
    """Voltage, current, and how the instrument fares."""
    voltage = yield VOLTAGE
    current = yield CURRENT
    assert voltage is not None and current is not None
    on = yield from asked(OUTPUT)
    condition = yield from asked(CONDITION)
    found = yield from errors()
    return Reading((voltage.asked + current.seen) / 2, voltage.value, current.value, on, condition, found)


def errors() -> Script[tuple[Entry, ...]]:
    """Empty the error queue.

    Raises
    ------
    DeviceError : it does not come to an end.
    """
    found: list[Entry] = []
    while (entry := (yield from asked(ERROR))).number:
        found.append(entry)
        if len(found) > MOST_ERRORS:
            raise DeviceError(f"the error queue does not end; last error {entry.number}, {entry.text}")
    return tuple(found)


def fault_of(protections: tuple[Protection, ...]) -> Script[str]:
    """Which protection has tripped; empty where none has."""
    for protection in protections:
        if (yield from asked(Question(protection.tripped, answers.truth))):
            return f"{protection.name} has tripped"
    return ""


def asked(question: Question) -> Script[Any]:
    """The value of an answer."""
    answer = yield question
    assert answer is not None
    return answer.value
