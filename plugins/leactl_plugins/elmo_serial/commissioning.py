"""Set up a drive before it may run: identity, status, scales, limits, and the timeout of the host."""

from typing import NamedTuple

from leactl.driver.clock import Clock
from leactl.driver.contract import Identity
from leactl.errors import DeviceError, DeviceFault, NoAnswer
from leactl_plugins.elmo.fault_names import motor_fault
from leactl_plugins.elmo.scales import CountedPosition
from leactl_plugins.elmo_serial.interpreter import SPOIL_COMMAND, Interpreter
from leactl_plugins.elmo_serial.settings import ElmoSerialSettings
from leactl_plugins.elmo_serial.status import StatusRegister

COUNTS_OF_32_BITS = (-0x80000000, 0x80000000)  # lowest count, and highest plus one
READINGS = ("IQ", "VX", "PX", "SR")  # queries of current, velocity, position and status
TIMED_EXCHANGES = 3  # exchanges, the longest of which counts


class DriveLimits(NamedTuple):
    """Limits of the drive, in its own amperes and counts."""

    peak_current: float  # PL[1], A of the drive
    continuous_current: float  # CL[1], A of the drive; the limit after PL[2] s
    lowest_velocity: float  # VL[2], counts/s
    highest_velocity: float  # VH[2], counts/s


def identity_of(version: str, serial: str) -> Identity:
    """Return the identity of a drive by its answer to VR and its serial number, either of which may be empty."""
    model, _, firmware = version.partition(" ")
    return Identity(f"Elmo {model}" if model else "", serial, firmware)


class SerialCommissioning:
    """The set-up of one drive; every method raises `DeviceError` if the drive does not answer."""

    def __init__(self, name: str, settings: ElmoSerialSettings, interpreter: Interpreter, clock: Clock) -> None:
        self._name, self._settings, self._interpreter, self._clock = name, settings, interpreter, clock
        self._answer_s = settings.answer_timeout_s

    def echo_off(self) -> bool:
        """Switch motor and echo off, and answers to decimal numbers; return whether the echo was on.

        Raises
        ------
        NoAnswer : no Elmo interpreter answers at this baud rate.
        """
        echoed = False
        for _ in range(3):
            self._interpreter.begin(("MO=0", "EO=0", "HX=0"), prefix=SPOIL_COMMAND)
            if self._interpreter.collect(self._clock.now() + self._answer_s) is not None:
                return echoed
            echoed = True  # an echo does not have the form of an answer
        self._interpreter.give_up()
        raise NoAnswer(
            f"{self._name}: nothing answers as an Elmo's interpreter does in {3 * self._answer_s:g} s;"
            " cable, baud rate (PP[2] of the drive), supply?"
        )

    def identity(self) -> Identity:
        """Read model and firmware from the version (VR), and the serial number (SN[4])."""
        replies = self._interpreter.ask("VR", "SN[4]", within_s=self._answer_s)
        version = replies.text("VR") if "VR" in replies else ""
        return identity_of(version, replies.text("SN[4]") if "SN[4]" in replies else "")

    def check_status(self) -> StatusRegister:
        """Check that the drive is off, has no fault, and runs its program; return its status.

        Raises
        ------
        DeviceFault : a fault is latched, and the settings do not allow its reset.
        DeviceError : it is still on, or runs no program, which alone would stop it if the host fell silent.
        """
        replies = self._interpreter.ask("SR", "MF", within_s=self._answer_s)
        status, fault_bits = StatusRegister(replies.integer("SR")), replies.integer("MF")
        if status.motor_on:
            raise DeviceError(f"{self._name}: is not off after MO=0: {status}")
        if status.is_fault_latched and not self._settings.reset_fault_at_start:
            raise DeviceFault(
                f"{self._name}: in fault at start, {motor_fault(fault_bits)}; mend it, or set reset_fault_at_start:"
                " true"
            )
        if not status.has_program:
            raise DeviceError(
                f"{self._name}: no program runs in it (bit 12 of SR 0x{status.register:X}), and RS-232 has no dead-man"
                " of its own: it would go on without the host; load and start the program of the driver's page"
            )
        return status

    def arm_dead_man(self) -> None:
        """Set the timeout of the host in the drive's program.

        Raises
        ------
        DeviceError : the variable reads back as another value.
        """
        variable, timeout_ms = self._settings.silence_variable, self._settings.silence_ms
        replies = self._interpreter.ask(f"{variable}={timeout_ms}", variable, within_s=self._answer_s)
        if replies.integer(variable) != timeout_ms:
            raise DeviceError(
                f"{self._name}: its dead-man cannot be armed: {variable} was set to {timeout_ms} and reads"
                f" {replies.integer(variable)}"
            )

    def limits(self) -> DriveLimits:
        """Read the drive's limits of current and velocity.

        Raises
        ------
        DeviceError : a current limit is 0, or the counts per turn contradict the bench file.
        """
        replies = self._interpreter.ask("PL[1]", "CL[1]", "VL[2]", "VH[2]", "CA[18]", within_s=self._answer_s)
        limits = DriveLimits(
            replies.number("PL[1]"),
            replies.number("CL[1]"),
            replies.number("VL[2]") if "VL[2]" in replies else COUNTS_OF_32_BITS[0],
            replies.number("VH[2]") if "VH[2]" in replies else COUNTS_OF_32_BITS[1] - 1,
        )
        if limits.peak_current <= 0.0 or limits.continuous_current <= 0.0:
            raise DeviceError(
                f"{self._name}: PL[1] is {limits.peak_current:g} A, CL[1] {limits.continuous_current:g} A; with 0 the"
                " drive lets nothing flow: it has not been tuned to a motor"
            )
        counts_per_turn = replies.integer("CA[18]") if "CA[18]" in replies else 0
        if counts_per_turn > 1 and counts_per_turn != self._settings.counts_per_turn:
            raise DeviceError(
                f"{self._name}: it counts {counts_per_turn} in a turn (CA[18]), the bench file says"
                f" counts_per_turn: {self._settings.counts_per_turn}"
            )
        return limits

    def position(self) -> CountedPosition:
        """Return a position that is unwrapped over the drive's range (XM[1] to XM[2] - 1, or 32 bits)."""
        replies = self._interpreter.ask("XM[1]", "XM[2]", within_s=self._answer_s)
        low, high = (replies.integer(name) if name in replies else 0 for name in ("XM[1]", "XM[2]"))
        return CountedPosition(*((low, high) if low < high else COUNTS_OF_32_BITS))

    def exchange_s(self) -> float:
        """Measure how long the longest exchange of a cycle takes on this line [s].

        Raises
        ------
        DeviceError : the drive refuses one of the queries.
        """
        settings, voltage_command = self._settings, self._settings.bus_voltage_command
        demand = f"{settings.silence_variable}={settings.silence_ms}"  # as long as a demand, and changes nothing
        commands = (*READINGS, demand, "TC", *(() if voltage_command is None else (voltage_command,)))
        longest = 0.0
        for _ in range(TIMED_EXCHANGES):
            replies = self._interpreter.ask(*commands, within_s=self._answer_s)
            longest = max(longest, self._interpreter.answered_at - self._interpreter.asked_at)
            for command in READINGS:
                replies.text(command)
            if voltage_command is not None and voltage_command not in replies:
                raise DeviceError(f"{self._name}: {voltage_command} of bus_voltage_command is refused")
        return longest
