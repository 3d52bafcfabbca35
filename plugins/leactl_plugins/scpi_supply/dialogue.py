"""Commands of an SCPI supply, as scripts: synchronise, switch off, set up, set levels, measure.

Every setting is read back, so that at most one command is pending and a refusal is noticed at once.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from leactl.driver.contract import Confirmation, TripAccuracy
from leactl.driver.conversation import Pause, Query, Script, ask
from leactl.driver.serial_supply import Regulation, SupplyReading, SwitchOffTrouble
from leactl.errors import DeviceError, DeviceFault
from leactl_plugins.scpi_supply import models, replies
from leactl_plugins.scpi_supply.dialects import (
    ABSOLUTE_TOLERANCE,
    DIALECTS,
    OVER_CURRENT,
    OVER_VOLTAGE,
    RELATIVE_TOLERANCE,
    Protection,
    SettingCommand,
)
from leactl_plugins.scpi_supply.replies import ErrorEntry, InstrumentIdentity
from leactl_plugins.scpi_supply.settings import ScpiSupplySettings

MOST_ERROR_ENTRIES = 32  # read from the error queue before it is given up; the queue of an E36xx holds 20
# by value of the condition register, which is the same in all families
MODES = {1: "constant current", 2: "constant voltage"}
SETTINGS_CHECK_INTERVAL_S = 1.0  # time between two readings of the settings, which a person may change at the panel
DRAIN_PAUSES = 5  # of about 10 ms each, for the last command to be sent: closing the line drops unsent bytes
IDENTIFY = Query("*IDN?", replies.parse_identity, patient=True)


class ProtectionBefore(NamedTuple):
    """State of a protection before it was changed."""

    protection: Protection
    level: float
    armed: bool


class CommandedLevels(NamedTuple):
    """Levels of the output, as commanded."""

    voltage: float
    current: float


class ScpiDialogue:
    """Dialogue with the supply of these settings."""

    def __init__(self, settings: ScpiSupplySettings) -> None:
        output = (settings.output or 0) if settings.model in models.OUTPUTS else 0
        self._settings, self._dialect = settings, DIALECTS[settings.dialect](settings.model, output)
        self._output = output
        self.reported_identity: InstrumentIdentity | None = None  # as last answered
        self.trips_at = settings.voltage_limit_V  # V, level to which the next `put` sets the over-voltage protection
        self._armed_at = settings.voltage_limit_V
        self._commanded = CommandedLevels(0.0, self._dialect.lowest_current)
        self._settings_read_at = 0.0  # time [s] at which the settings were read
        self._regulation = Regulation()
        self._panel_fault_text = ""  # empty unless the settings were changed at the panel
        self._earlier_protections: list[ProtectionBefore] = []  # protections before `set_up`, which `leave` restores
        voltage_rating, current_rating = models.highest_rating(settings.model, output)
        parse_reading = partial(replies.parse_reading, form=self._dialect.reading)
        self._voltage_query = Query(self._dialect.measure_voltage, partial(parse_reading, rating=voltage_rating))
        self._current_query = Query(self._dialect.measure_current, partial(parse_reading, rating=current_rating))

    @property
    def trip_accuracy(self) -> TripAccuracy:
        """Tolerance of the level of the over-voltage protection [V]."""
        return self._dialect.trip_accuracy

    @property
    def off(self) -> bytes:
        """Bytes that switch the output off from any state."""
        return self._dialect.off_bytes

    def synchronise(self) -> Script[InstrumentIdentity]:
        """Query the identity; replies before it belong to earlier queries and are dropped."""
        identity: InstrumentIdentity = yield from ask(IDENTIFY)
        return identity

    def output_off(self, off_trouble: SwitchOffTrouble) -> Script[Confirmation]:
        """Switch off repeatedly until the instrument reports it and no current flows.

        A half-sent earlier command, or a reply under way, may swallow the command; it is therefore repeated until the
        instrument confirms it.
        """
        while True:
            yield self._dialect.off_bytes
            self._check_identity((yield from self.synchronise()))
            # patient, as a late answer to an earlier host may be taken for the identity
            on = yield from ask(self._dialect.is_on._replace(patient=True))
            if on:
                off_trouble.text = "the output is still on"
                continue
            current = yield from ask(self._current_query)
            if abs(current) <= self._settings.off_current_A:
                return Confirmation(True, f"output off, {current:.3f} A")
            off_trouble.text = f"the instrument reports its output off, but {current:.3f} A flow"

    def _check_identity(self, identity: InstrumentIdentity) -> None:
        """Store the identity; raise DeviceError if another instrument answers."""
        settings, self.reported_identity = self._settings, identity
        if identity.model != settings.model:
            raise DeviceError(f"{identity.maker} {identity.model} answers; {settings.model} was expected")
        if settings.serial_number and identity.serial_number != settings.serial_number:
            raise DeviceError(f"serial number {identity.serial_number} answers; {settings.serial_number} was expected")

    def set_up(self, off_trouble: SwitchOffTrouble) -> Script[Sequence[str]]:
        """Switch off, set the levels to 0 and arm both protections at their limits.

        The result is the notices: errors from before, and protections that the instrument does not have.

        Raises
        ------
        DeviceError : another instrument, a setting that reads back differently, a protection that has tripped or is
            armed below its limit, or an output that cannot be switched off.
        """
        settings, dialect = self._settings, self._dialect
        self._earlier_protections, self._panel_fault_text = [], ""
        yield from self.output_off(off_trouble)
        earlier_errors = yield from self._read_errors()
        yield from self._check_required_answers()
        if settings.output_range:
            yield dialect.set_range.format(settings.output_range.upper())
        self._commanded = CommandedLevels(0.0, dialect.lowest_current)
        yield from self._write_level(dialect.voltage, 0.0)
        self._settings_read_at = yield from self._write_level(dialect.current, dialect.lowest_current)
        protections = [
            (dialect.over_voltage, "voltage_limit_V", settings.voltage_limit_V),
            (dialect.over_current, "current_limit_A", settings.current_limit_A),
        ]
        limits = [(protection, key, limit) for protection, key, limit in protections if protection is not None]
        self._earlier_protections = yield from self._read_protections(limits)
        for protection, _key, limit in limits:
            yield from self._arm(protection, limit)
        self.trips_at = self._armed_at = settings.voltage_limit_V
        new_errors = yield from self._read_errors()
        if new_errors:
            raise DeviceError("; ".join(f"error {number}, {text}" for number, text in new_errors))
        return [
            *(f"had an error from before: {number}, {text}" for number, text in earlier_errors),
            *(
                f"has no {name} that can be set; {key} only limits what is commanded"
                for name, (protection, key, _limit) in zip((OVER_VOLTAGE, OVER_CURRENT), protections, strict=True)
                if protection is None
            ),
        ]

    def _check_required_answers(self) -> Script[None]:
        """Check that the output can be used without acting on other outputs; raise DeviceError if it cannot."""
        for required in self._dialect.required_answers:
            if (yield from ask(required.question)) not in required.accepted:
                raise DeviceError(required.refusal)
        select = self._dialect.select
        if (
            select is not None
            and (selected := (yield from ask(Query(select.query, replies.parse_level)))) != self._output
        ):
            raise DeviceError(f"output {selected:g} is selected after {select.command}")

    def _read_protections(self, limits: Sequence[tuple[Protection, str, float]]) -> Script[list[ProtectionBefore]]:
        """Read the state of each protection.

        Parameters
        ----------
        limits : protection, key of its limit in the settings, and limit [V or A].

        Raises
        ------
        DeviceError : a protection is armed at a lower level than its limit. The driver does not raise a level that was
            set lower at the instrument.
        """
        protections = []
        for protection, key, limit in limits:
            level = yield from ask(Query(protection.level.query, replies.parse_level))
            armed = yield from _is_armed(protection)
            if armed and level < limit - _read_back_tolerance(limit):
                raise DeviceError(
                    f"{protection.name} is armed at {level:g}, below {key} of {limit:g}, and is not loosened: raise it"
                    " at the instrument, or lower the limit in the bench file"
                )
            protections.append(ProtectionBefore(protection, level, armed))
        return protections

    def put(self, voltage: float, current: float) -> Script[None]:
        """Set both levels [V, A], arm the over-voltage protection at its level, and read everything back.

        Levels that fall are set first, then the protection, then levels that rise. The protection therefore never trips
        on a level that is about to rise, and is never above the level meant for the present output. It takes effect one
        read-back after the levels that fall; if the output's voltage has not fallen below it by then, as without a load
        that discharges it, the protection switches the output off and this is reported as its trip.

        Raises
        ------
        DeviceError : a level reads back as another value.
        """
        dialect, earlier_levels = self._dialect, self._commanded
        target = CommandedLevels(voltage, max(current, dialect.lowest_current))
        self._settings_read_at, read_at = math.inf, 0.0  # no check of the settings while they change
        self._regulation.begin_anew()
        levels = (
            (dialect.current, target.current, earlier_levels.current),
            (dialect.voltage, target.voltage, earlier_levels.voltage),
        )
        for level, value, earlier_value in levels:
            if value <= earlier_value:
                read_at = yield from self._write_level(level, value)
        yield from self._move_over_voltage_level()
        for level, value, earlier_value in levels:
            if value > earlier_value:
                read_at = yield from self._write_level(level, value)
        self._commanded, self._settings_read_at, self._panel_fault_text = target, read_at, ""

    def _move_over_voltage_level(self) -> Script[None]:
        """Arm the over-voltage protection at `trips_at` if it is armed at another level."""
        level, protection = self.trips_at, self._dialect.over_voltage
        if protection is not None and level != self._armed_at:
            yield from self._arm(protection, level)
            self._armed_at = level

    def leave(self) -> Script[Sequence[str]]:
        """Restore all protections and release the front panel; return the names of the protections.

        Raises
        ------
        DeviceError : another instrument answers, or a protection reads back differently.
        """
        names = [before.protection.name for before in self._earlier_protections]
        if self._earlier_protections:
            self._check_identity((yield from self.synchronise()))
        while self._earlier_protections:
            protection, level, armed = self._earlier_protections[0]
            yield from self._write_level(protection.level, level)
            if protection.switch:
                yield protection.switch.command.format("ON" if armed else "OFF")
            if (yield from _is_armed(protection)) is not armed:
                raise DeviceError(
                    f"{protection.name} could not be switched {'on' if armed else 'off'} again, as it was before"
                )
            del self._earlier_protections[0]
        if self._dialect.local:
            yield self._dialect.local
            for _ in range(DRAIN_PAUSES):
                yield Pause()
        return names

    def switch(self, on: bool) -> Script[None]:
        """Switch the output and check its state.

        Raises
        ------
        DeviceFault : the instrument reports the other state.
        """
        self._regulation.begin_anew()
        yield self._dialect.switch.format("ON" if on else "OFF")
        if (yield from ask(self._dialect.is_on)) is not on:
            raise DeviceFault(f"the output does not switch {'on' if on else 'off'}")

    def measure(self) -> Script[SupplyReading]:
        """Measure voltage and current, and read output, condition, errors and protections.

        Every `SETTINGS_CHECK_INTERVAL_S`, also read the levels.
        """
        voltage = yield self._voltage_query
        current = yield self._current_query
        assert voltage is not None and current is not None
        on = yield from ask(self._dialect.is_on)
        condition = yield from ask(self._dialect.condition)
        errors = yield from self._read_errors()
        fault = yield from self._trip_fault()
        mode = MODES.get(condition, "") if on else ""
        if on and not mode and not fault:
            fault = f"out of regulation, condition {condition}"
        if current.seen - self._settings_read_at >= SETTINGS_CHECK_INTERVAL_S:
            self._settings_read_at = current.seen
            self._panel_fault_text = yield from self._read_panel_fault()
        fault = fault or self._panel_fault_text
        if on and not fault:
            fault = self._regulation_fault((voltage.value, current.value), mode, current.seen)
        notices = tuple(f"error {number}, {text}" for number, text in errors)
        return SupplyReading((voltage.asked + current.seen) / 2, voltage.value, current.value, on, mode, fault, notices)

    def _read_panel_fault(self) -> Script[str]:
        """Return a text that names levels other than the commanded ones; empty if both are as commanded."""
        volts: float = yield from ask(Query(self._dialect.voltage.query, replies.parse_level))
        amperes: float = yield from ask(Query(self._dialect.current.query, replies.parse_level))
        commanded = self._commanded
        if abs(volts - commanded.voltage) <= _read_back_tolerance(commanded.voltage) and (
            abs(amperes - commanded.current) <= _read_back_tolerance(commanded.current)
        ):
            return ""
        return f"its levels were changed to {_levels_text(volts, amperes)}; {_levels_text(*commanded)} were commanded"

    def _regulation_fault(self, measured: tuple[float, float], mode: str, moment: float) -> str:
        """Return a text if the output is not at the level that the instrument says it regulates; empty if it is."""
        if not self._regulation.is_lost(measured, self._commanded, mode == MODES[1], moment):
            return ""
        return f"out of regulation, {_levels_text(*measured)} at {mode}; {_levels_text(*self._commanded)} are set"

    def _trip_fault(self) -> Script[str]:
        """Return a text that names a tripped protection; empty if none has tripped."""
        for protection in (self._dialect.over_voltage, self._dialect.over_current):
            if protection is not None and (yield from ask(Query(protection.tripped_query, replies.parse_boolean))):
                return f"{protection.name} has tripped"
        return ""

    def _arm(self, protection: Protection, level: float) -> Script[None]:
        """Set the level [V or A] of a protection, arm it, and check that it is armed and has not tripped.

        Raises
        ------
        DeviceError : the level reads back differently, or the protection does not stay on.
        DeviceFault : the protection has tripped.
        """
        yield from self._write_level(protection.level, level)
        if protection.switch:
            yield protection.switch.command.format("ON")
        if not (yield from _is_armed(protection)):
            raise DeviceError(f"{protection.name} does not stay on")
        if (yield from ask(Query(protection.tripped_query, replies.parse_boolean))):
            raise DeviceFault(f"{protection.name} has tripped; find out why, then clear it at the instrument")

    def _write_level(self, level: SettingCommand, value: float) -> Script[float]:
        """Write a level [V or A], read it back, and return the time of the reading [s].

        Raises
        ------
        DeviceError : the level that is read back differs by more than `_read_back_tolerance`.
        """
        yield level.command.format(f"{value:.{self._dialect.decimals}f}")
        reply = yield Query(level.query, replies.parse_level)
        assert reply is not None
        if not abs(reply.value - value) <= _read_back_tolerance(value):
            raise DeviceError(f"{level.command.split()[0]} holds {reply.value:g} after {value:g} was written")
        return reply.seen

    def _read_errors(self) -> Script[tuple[ErrorEntry, ...]]:
        """Read the error queue until it is empty; raise DeviceError if it does not end."""
        errors: list[ErrorEntry] = []
        while (entry := (yield from ask(self._dialect.error))).number:
            errors.append(entry)
            if len(errors) > MOST_ERROR_ENTRIES:
                raise DeviceError(f"the error queue does not end; last error {entry.number}, {entry.text}")
        return tuple(errors)


def _is_armed(protection: Protection) -> Script[bool]:
    """Return whether a protection is armed; a protection without a switch always is."""
    if protection.switch is None:
        return True
    return bool((yield from ask(Query(protection.switch.query, replies.parse_boolean))))


def _levels_text(volts: float, amperes: float) -> str:
    """Return a voltage [V] and a current [A] as text."""
    return f"{volts:.3f} V and {amperes:.3f} A"


def _read_back_tolerance(value: float) -> float:
    """Return the largest difference [V or A] allowed between a written level and the level that is read back."""
    return RELATIVE_TOLERANCE * value + ABSOLUTE_TOLERANCE
