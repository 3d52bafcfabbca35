"""Set up a drive by SDO before it may run: identity, faults, scales, monitoring of the host, PDOs."""

import math
from contextlib import suppress
from typing import NamedTuple

from leactl.driver.clock import Clock
from leactl.driver.contract import Identity
from leactl.errors import DeviceError, DeviceFault, InputError, NoAnswer
from leactl_plugins.elmo.fault_names import CODES
from leactl_plugins.elmo_can import cia402
from leactl_plugins.elmo_can.cia402 import FAULT_STATES
from leactl_plugins.elmo_can.sdo import Refused, Sdo
from leactl_plugins.elmo_can.settings import ElmoSettings

REVERSED_BITS = 0xC0  # of 0x607E: they reverse position and velocity
RANGE_OF_32_BITS = (-0x80000000, 0x80000000)  # lowest value, and highest plus one
ALL_MODES = 0xFFFFFFFF  # bits of 0x6502
RESET_S = 0.5  # time for a drive to leave its fault
MOST_INTERPOLATION_UNITS, FINEST_EXPONENT, COARSEST_EXPONENT = 255, -6, -2  # ranges of units and exponent of 0x60C2
ON_CHANGE_TYPE = 255  # transmission type of a TPDO that is sent when its content has changed
INHIBIT_TIME_100US = 100  # 10 ms between two such TPDOs, because bits of a statusword may toggle with every sample
INVALID_BIT, NO_REMOTE_FRAME_BIT = 1 << 31, 1 << 30  # of a PDO's COB-ID (CiA 301, tables 66 and 71)
PRODUCES_SYNC_BIT = 1 << 30  # of 0x1005
# abort codes of a drive that lacks an object: no object, subindex, resource or data (CiA 301, table 22)
ABSENT_CODES = (0x06020000, 0x06090011, 0x060A0023, 0x08000024)
MOST_DOUBLED_ANSWERS = 2  # answers that a bus may bring twice while about twenty are awaited
CLOCK_PERIOD_SYNCS = 10  # SYNCs between two frames with the drive's clock, which take a hundredth of the bus at 1 kHz


def interpolation_time(period: float) -> tuple[int, int]:
    """Return units and exponent of 0x60C2 for a time [s], rounded up: milliseconds if they express it, else the finest.

    Raises
    ------
    InputError : the time is longer than 0x60C2 can hold.
    """
    milliseconds = round(1e3 * period)
    if 1 <= milliseconds <= MOST_INTERPOLATION_UNITS and math.isclose(1e3 * period, milliseconds):
        return milliseconds, -3
    for exponent in range(FINEST_EXPONENT, COARSEST_EXPONENT + 1):
        units = math.ceil(period * 10**-exponent * (1 - 1e-9))
        if units <= MOST_INTERPOLATION_UNITS:
            return units, exponent
    raise InputError(
        f"a setpoint every {period:g} s is slower than a drive interpolates, {MOST_INTERPOLATION_UNITS / 100:g} s"
    )


def event_tpdo(settings: ElmoSettings) -> int | None:
    """Return the number, from 0, of the TPDO that reports changes of state at once; None if all four are in use."""
    free_numbers = [
        number
        for number, mapped_object in ((3, settings.drive_clock), (2, settings.q_axis_voltage))
        if mapped_object is None
    ]
    return free_numbers[0] if free_numbers else None


def read_optional(sdo: Sdo, index: int, sub: int, kind: str) -> int | None:
    """Return the value of an optional object; None if the node lacks it.

    Raises
    ------
    NoAnswer : the node does not answer.
    DeviceError : the node refuses the transfer for another reason.
    """
    try:
        return sdo.read(index, sub, kind)
    except Refused as refusal:
        if refusal.code in ABSENT_CODES:
            return None
        raise


def read_optional_u32(sdo: Sdo, index: int, sub: int) -> int | None:
    """Read an optional number of 32 bits; None if the node refuses for any reason, or answers another length.

    Raises
    ------
    NoAnswer : the node does not answer.
    """
    try:
        return sdo.read(index, sub, "u32")
    except NoAnswer:
        raise
    except DeviceError:
        return None


class SetpointTime(NamedTuple):
    """The drive's values of the time between two setpoints; None for an object that it lacks."""

    interpolation: tuple[int, int] | None  # units and exponent of 0x60C2
    sync_us: int | None  # 0x1006, the time between two SYNCs, 0 if it is not set; None also if the drive makes the SYNC


def identity_of(sdo: Sdo) -> Identity:
    """Return name, serial number and software version of a node; a field that it lacks is empty.

    Raises
    ------
    NoAnswer : the node does not answer.
    """
    name, hardware, software = (_text_or_empty(sdo, index) for index in (0x1008, 0x1009, 0x100A))
    model = f"{name}, hardware {hardware}" if name and hardware else name
    serial = read_optional_u32(sdo, 0x1018, 4)
    if not model:
        device_type, product, revision = (
            read_optional_u32(sdo, index, sub) or 0 for index, sub in ((0x1000, 0), (0x1018, 2), (0x1018, 3))
        )
        model = f"CiA {device_type & 0xFFFF} product 0x{product:08X}, revision 0x{revision:08X}" if product else ""
    return Identity(model, str(serial or ""), software)


def _text_or_empty(sdo: Sdo, index: int) -> str:
    """Return a text object; empty if it cannot be read."""
    try:
        return sdo.read_text(index, 0)
    except DeviceError:
        return ""


class Commissioning:
    """The set-up of one drive; every method raises `DeviceError` if the drive does not answer or refuses."""

    def __init__(self, name: str, settings: ElmoSettings, sdo: Sdo, clock: Clock) -> None:
        self._name, self._settings, self._sdo, self._clock = name, settings, sdo, clock

    def check_identity(self) -> None:
        """Raise DeviceError if the vendor differs from the one in the settings."""
        expected = self._settings.vendor_id
        vendor = self._sdo.read(0x1018, 1, "u32")
        if expected is not None and vendor != expected:
            node = self._settings.node
            raise DeviceError(f"{self._name}: vendor 0x{vendor:08X} at node {node}, 0x{expected:08X} was expected")

    def check_alone(self) -> None:
        """Raise DeviceError if two devices have the node number, so that every request was answered twice."""
        if self._sdo.surplus > MOST_DOUBLED_ANSWERS:
            raise DeviceError(
                f"{self._name}: two devices answer as node {self._settings.node}: connect one of them alone and"
                " give it another number"
            )

    def identity(self) -> Identity:
        """Return name, serial number and software version; a field that the drive lacks is empty."""
        return identity_of(self._sdo)

    def _read_or_zero(self, index: int, sub: int, kind: str = "u32") -> int:
        """Return the value of an optional object; 0 if the drive lacks it."""
        return read_optional(self._sdo, index, sub, kind) or 0

    def disable_voltage(self) -> None:
        """Take the drive out of operation, in which an earlier program may have left it."""
        self._sdo.write(0x6040, 0, "u16", cia402.DISABLE_VOLTAGE)

    def leave_fault(self) -> bool:
        """Reset a present fault if the settings allow it; return whether there was one.

        Raises
        ------
        DeviceFault : the drive is in fault and the settings forbid a reset, or the fault stays.
        """
        statusword = self._sdo.read(0x6041, 0, "u16")
        if cia402.state_of(statusword) not in FAULT_STATES:
            return False
        if not self._settings.reset_fault_at_start:
            text = self._fault_text(statusword)
            raise DeviceFault(f"{self._name}: in fault at start, {text}; mend it, or set reset_fault_at_start: true")
        self.reset_fault()
        return True

    def reset_fault(self) -> None:
        """Reset a latched fault by the 0 -> 1 edge of bit 7 (CiA 402, transition 15: holding 0x80 never resets).

        Raises
        ------
        DeviceFault : the drive is still in fault after the reset.
        """
        for controlword in (0x0000, cia402.FAULT_RESET, 0x0000):
            self._sdo.write(0x6040, 0, "u16", controlword)
        deadline = self._clock.now() + RESET_S
        while cia402.state_of(statusword := self._sdo.read(0x6041, 0, "u16")) in FAULT_STATES:
            if self._clock.now() >= deadline:
                raise DeviceFault(f"{self._name}: still in fault after a reset, {self._fault_text(statusword)}")
            self._clock.sleep_until(self._clock.now() + 0.01)

    def read_scales(self) -> tuple[float, int]:
        """Read the q-axis current of one per mille [A], with the sign of the settings, and the highest per mille.

        Raises
        ------
        DeviceError : the drive has no rated current, or lets no current flow, or scales torque differently.
        """
        rated_current_ma = self._sdo.read(0x6075, 0, "u32")
        rated_torque = self._sdo.read(0x6076, 0, "u32")
        if rated_current_ma == 0:
            raise DeviceError(f"{self._name}: rated current 0x6075 is 0 mA; the drive has not been tuned to a motor")
        if rated_torque != rated_current_ma:
            raise DeviceError(
                f"{self._name}: rated torque 0x6076 is {rated_torque}, rated current 0x6075 {rated_current_ma}; equal"
                " numbers were expected, so that per mille of torque are per mille of current"
            )
        limits = {index: self._sdo.read(index, 0, "u16") for index in (0x6072, 0x6073)}
        if not all(limits.values()):
            raise DeviceError(
                f"{self._name}: most torque 0x6072 is {limits[0x6072]}, most current 0x6073 {limits[0x6073]} per mille"
                " of the rated one; with 0 the drive lets nothing flow"
            )
        q_per_mille = rated_current_ma * 1e-6 * self._settings.current_convention.to_q_axis
        return self._settings.sign * q_per_mille, min(0x7FFF, *limits.values())

    def check_scales(self) -> None:
        """Check that the drive's positions are encoder counts with the sign and counts per turn of the bench file.

        A drive may lack any of these objects, which means no scaling (CiA 402, 6.2.12 and 6.5).

        Raises
        ------
        DeviceError : polarity, user units or counts per turn contradict the settings.
        """
        settings = self._settings
        polarity = self._read_or_zero(0x607E, 0, "u8")
        if polarity & REVERSED_BITS:
            raise DeviceError(
                f"{self._name}: its polarity 0x607E is 0x{polarity:02X}, so that position or velocity count against its"
                " current; 0x00 was expected: write that, and turn the sense by the setting `sign`"
            )
        ratios = {}
        for index in (0x608F, 0x6091, 0x6092):
            numerator, denominator = self._read_or_zero(index, 1), self._read_or_zero(index, 2)
            ratios[index] = numerator / denominator if numerator and denominator else 1.0
        units_per_count = ratios[0x6092] / (ratios[0x608F] * ratios[0x6091])
        if units_per_count != 1.0:
            raise DeviceError(
                f"{self._name}: its positions are user units, {units_per_count:.6g} of them a count (0x608F, 0x6091,"
                " 0x6092); counts were expected: set all of these to 1"
            )
        for source, counts_per_turn in (
            ("0x608F", ratios[0x608F]),
            ("CA[18], 0x3034:18", read_optional_u32(self._sdo, 0x3034, 18) or 0),
        ):
            if counts_per_turn > 1 and counts_per_turn != settings.counts_per_turn:
                raise DeviceError(
                    f"{self._name}: it counts {counts_per_turn:g} in a turn ({source}), the bench file says"
                    f" counts_per_turn: {settings.counts_per_turn}"
                )

    def clear_offsets(self) -> None:
        """Set offsets that another master left, and that are added to every demand, to 0 (0x60B0, 0x60B1, 0x60B2).

        Raises
        ------
        DeviceError : an offset reads back as another value.
        """
        for index, integer_type in ((0x60B0, "i32"), (0x60B1, "i32"), (0x60B2, "i16")):
            if read_optional(self._sdo, index, 0, integer_type):  # a firmware without the object adds nothing
                self._sdo.write_verified(index, 0, integer_type, 0)

    def position_range(self) -> tuple[int, int]:
        """Return the range of the drive's position [counts]: lowest, and highest plus one (CiA 402, 0x607B)."""
        low, high = (self._read_or_zero(0x607B, sub, "i32") for sub in (1, 2))
        return (low, high) if low < high else RANGE_OF_32_BITS

    def setpoint_time(self) -> SetpointTime:
        """Read the drive's values of the time between two setpoints (CiA 402, 0x60C2; CiA 301, 0x1006)."""
        units, exponent = read_optional(self._sdo, 0x60C2, 1, "u8"), read_optional(self._sdo, 0x60C2, 2, "i8")
        # a drive that makes the SYNC uses 0x1006 as its period
        makes_sync = (read_optional_u32(self._sdo, 0x1005, 0) or 0) & PRODUCES_SYNC_BIT
        return SetpointTime(
            None if units is None or exponent is None else (units, exponent),
            None if makes_sync else read_optional_u32(self._sdo, 0x1006, 0),
        )

    def expect_setpoints_every(self, period: float, drive_time: SetpointTime) -> None:
        """Set the time between two setpoints [s], over which the drive interpolates, in the objects that it has.

        A time that 0x60C2 cannot hold is rounded up, because an early setpoint does no harm.

        Raises
        ------
        DeviceError : a time reads back as another value.
        """
        self.set_setpoint_time(
            SetpointTime(
                drive_time.interpolation and interpolation_time(period),
                None if drive_time.sync_us is None else round(1e6 * period),
            )
        )

    def set_setpoint_time(self, time: SetpointTime) -> None:
        """Set the drive's values of the time between two setpoints; a drive may refuse to change the SYNC's period.

        Raises
        ------
        DeviceError : a time reads back as another value.
        """
        if time.interpolation is not None:
            units, exponent = time.interpolation
            self._sdo.write_verified(0x60C2, 2, "i8", exponent)
            self._sdo.write_verified(0x60C2, 1, "u8", units)
        if time.sync_us is not None:
            with suppress(Refused):
                self._sdo.write_verified(0x1006, 0, "u32", time.sync_us)

    def disarm_dead_man(self) -> None:
        """End the monitoring of the host, which a drive out of operation does not need."""
        self._sdo.write(0x1016, 1, "u32", 0)

    def supported_modes(self) -> int:
        """Return the bits of the supported modes (0x6502, bit 0 is mode 1); all bits if the drive lacks the object."""
        return read_optional_u32(self._sdo, 0x6502, 0) or ALL_MODES

    def arm_dead_man(self) -> None:
        """Make the drive stop by itself when the host's heartbeat stays away (301IG, chapter 14).

        Raises
        ------
        DeviceError : the drive refuses, or a value reads back differently.
        """
        settings = self._settings
        consumer = settings.host_node << 16 | settings.consumer_heartbeat_ms
        for name, index, sub, integer_type, value in (
            ("abort option", 0x6007, 0, "i16", settings.abort_option),
            ("consumer heartbeat", 0x1016, 1, "u32", consumer),
        ):
            self._sdo.write(index, sub, integer_type, value)
            read_back = self._sdo.read(index, sub, integer_type)
            if read_back != value:
                raise DeviceError(
                    f"{self._name}: its dead-man cannot be armed: {name} 0x{index:04X}:{sub} was written as 0x{value:X}"
                    f" and read back as 0x{read_back:X}; it would not stop without the host"
                )

    def start_heartbeat(self) -> None:
        """Make the drive send its own heartbeat."""
        self._sdo.write(0x1017, 0, "u16", self._settings.producer_heartbeat_ms)

    def map_pdos(self) -> None:
        """Map the exchange of a cycle to PDOs that act at the SYNC; the node has to be pre-operational.

        All other PDOs are made invalid: PDOs that another master has left would act on this drive or load the bus.
        """
        node = self._settings.node
        self._map_pdo(0x1400, 0x1600, 0x200 + node, (0x60400010, 0x60710010, 0x60600008))
        self._map_pdo(0x1401, 0x1601, 0x300 + node, (0x607A0020, 0x60FF0020))
        self._map_pdo(0x1800, 0x1A00, 0x180 + node, (0x60410010, 0x60610008, 0x60770010, 0x60780010))
        self._map_pdo(0x1801, 0x1A01, 0x280 + node, (0x60640020, 0x606C0020))
        voltage_object = self._settings.q_axis_voltage
        mapped_tpdos = set()
        if voltage_object is not None:
            mapped_tpdos.add(0x1802)
            bits = 16 if voltage_object.type == "i16" else 32
            self._map_pdo(
                0x1802, 0x1A02, 0x380 + node, (voltage_object.index << 16 | voltage_object.subindex << 8 | bits,)
            )
        clock_object = self._settings.drive_clock
        if clock_object is not None:
            mapped_tpdos.add(0x1803)
            self._map_pdo(
                0x1803,
                0x1A03,
                0x480 + node,
                (clock_object.index << 16 | clock_object.subindex << 8 | 32,),
                CLOCK_PERIOD_SYNCS,
            )
        event_number = event_tpdo(self._settings)
        if event_number is not None:
            mapped_tpdos.add(0x1800 + event_number)
            event_identifier, event_entries = 0x180 + 0x100 * event_number + node, (0x60410010,)
            self._map_pdo(
                0x1800 + event_number,
                0x1A00 + event_number,
                event_identifier,
                event_entries,
                ON_CHANGE_TYPE,
                INHIBIT_TIME_100US,
            )
        unused_pdos = {0x1402, 0x1403, 0x1802, 0x1803} - mapped_tpdos
        for communication in sorted(unused_pdos):
            identifier = read_optional(self._sdo, communication, 1, "u32")
            if identifier is not None and not identifier & INVALID_BIT:
                self._sdo.write(communication, 1, "u32", INVALID_BIT | identifier)
        if self._settings.torque_slope_per_mille_s is not None:
            self._sdo.write_verified(0x6087, 0, "u32", self._settings.torque_slope_per_mille_s)

    def _map_pdo(
        self,
        communication: int,
        mapping: int,
        identifier: int,
        entries: tuple[int, ...],
        transmission_type: int = 1,
        inhibit_time: int | None = None,
    ) -> None:
        """Remap one PDO in the order of CiA 301: invalid, type, inhibit time, empty, entries, count, valid.

        The bit that allows remote frames stays as it is: a drive without remote frames refuses a change.
        """
        identifier |= self._sdo.read(communication, 1, "u32") & NO_REMOTE_FRAME_BIT
        self._sdo.write(communication, 1, "u32", INVALID_BIT | identifier)
        self._sdo.write(communication, 2, "u8", transmission_type)
        if inhibit_time is not None:
            self._sdo.write(communication, 3, "u16", inhibit_time)
        self._sdo.write(mapping, 0, "u8", 0)
        for number, entry in enumerate(entries, start=1):
            self._sdo.write(mapping, number, "u32", entry)
        self._sdo.write(mapping, 0, "u8", len(entries))
        self._sdo.write(communication, 1, "u32", identifier)

    def _fault_text(self, statusword: int) -> str:
        """Return a text with a statusword and the drive's error code."""
        code = self._sdo.read(0x603F, 0, "u16")
        return f"statusword 0x{statusword:04X}, error 0x{code:04X} ({CODES.get(code, 'unnamed')})"
