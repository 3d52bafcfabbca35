"""What a drive is asked and told by SDO before it may run: identity, fault, scales, dead-man, PDOs."""

from leactl.driver.contract import Identity
from leactl.errors import DeviceError, DeviceFault
from leactl_plugins.elmo_can import cia402, emergency
from leactl_plugins.elmo_can.cia402 import FAULTS
from leactl_plugins.elmo_can.sdo import Sdo
from leactl_plugins.elmo_can.settings import ElmoSettings

CLOCK_EVERY = 10  # SYNCs, at which a drive tells its clock: a hundredth of the bus at 1 kHz


class Commissioning:
    """The set-up of one drive; every method raises `DeviceError` where the drive is silent or refuses."""

    def __init__(self, name: str, settings: ElmoSettings, sdo: Sdo) -> None:
        self._name, self._settings, self._sdo = name, settings, sdo

    def check_identity(self) -> None:
        """Refuse a device of another maker."""
        expected = self._settings.vendor_id
        found = self._sdo.read(0x1018, 1, "u32")
        if expected is not None and found != expected:
            node = self._settings.node
            raise DeviceError(f"{self._name}: vendor 0x{found:08X} at node {node}, 0x{expected:08X} was expected")

    def identity(self) -> Identity:
        """Return name, serial number and software version; what the drive does not tell is left out."""
        name, hardware, software = (self._text(index) for index in (0x1008, 0x1009, 0x100A))
        model = f"{name}, hardware {hardware}" if name and hardware else name
        serial = self._number(0x1018, 4)
        if not model:
            kind, product, revision = self._number(0x1000, 0), self._number(0x1018, 2), self._number(0x1018, 3)
            model = f"CiA {kind & 0xFFFF} product 0x{product:08X}, revision 0x{revision:08X}" if product else ""
        return Identity(model, str(serial or ""), software)

    def _text(self, index: int) -> str:
        try:
            return self._sdo.read_text(index, 0)
        except DeviceError:
            return ""

    def _number(self, index: int, sub: int) -> int:
        """An object that a drive may lack; 0 where it does."""
        try:
            return self._sdo.read(index, sub, "u32")
        except DeviceError:
            return 0

    def disable_voltage(self) -> None:
        """Take the drive out of operation: whoever had it last may have left it in it."""
        self._sdo.write(0x6040, 0, "u16", cia402.DISABLE_VOLTAGE)

    def leave_fault(self) -> bool:
        """Reset a fault the drive is in where the settings allow it; True where there was one.

        Raises
        ------
        DeviceFault : in fault, and the settings say not to reset it, or it stays.
        """
        word = self._sdo.read(0x6041, 0, "u16")
        if cia402.state_of(word) not in FAULTS:
            return False
        if not self._settings.reset_fault_at_start:
            text = self._fault_text(word)
            raise DeviceFault(f"{self._name}: in fault at start, {text}; mend it, or set reset_fault_at_start: true")
        self.reset_fault()
        return True

    def reset_fault(self) -> None:
        """Reset a latched fault by the 0 -> 1 edge of bit 7 (CiA 402, transition 15: holding 0x80 never resets).

        Raises
        ------
        DeviceFault : the drive is still in fault afterwards, its cause is still there.
        """
        for word in (0x0000, cia402.FAULT_RESET, 0x0000):
            self._sdo.write(0x6040, 0, "u16", word)
        word = self._sdo.read(0x6041, 0, "u16")
        if cia402.state_of(word) in FAULTS:
            raise DeviceFault(f"{self._name}: still in fault after a reset, {self._fault_text(word)}")

    def read_scales(self) -> tuple[float, int]:
        """Read q-axis current of one per mille (A, signed as the bench turns) and the most per mille that may flow."""
        rated_current_ma = self._sdo.read(0x6075, 0, "u32")
        rated_torque = self._sdo.read(0x6076, 0, "u32")
        if rated_current_ma == 0:
            raise DeviceError(f"{self._name}: rated current 0x6075 is 0 mA; the drive has not been tuned to a motor")
        if rated_torque != rated_current_ma:
            raise DeviceError(
                f"{self._name}: rated torque 0x6076 is {rated_torque}, rated current 0x6075 {rated_current_ma}; equal"
                " numbers were expected, so that per mille of torque are per mille of current"
            )
        most = {index: self._sdo.read(index, 0, "u16") for index in (0x6072, 0x6073)}
        if not all(most.values()):
            raise DeviceError(
                f"{self._name}: most torque 0x6072 is {most[0x6072]}, most current 0x6073 {most[0x6073]} per mille of"
                " the rated one; with 0 the drive lets nothing flow"
            )
        q_per_mille = rated_current_ma * 1e-6 * self._settings.current_convention.to_q_axis
        return self._settings.sign * q_per_mille, min(0x7FFF, *most.values())

    def arm_dead_man(self) -> None:
        """Have the drive itself stop when the host falls silent, from its first heartbeat on (301IG, chapter 14).

        Raises
        ------
        DeviceError : the drive refuses, or holds something else afterwards; with what was written and what was read.
        """
        settings = self._settings
        consumer = settings.host_node << 16 | settings.consumer_heartbeat_ms
        for what, index, sub, kind, value in (
            ("abort option", 0x6007, 0, "i16", settings.abort_option),
            ("consumer heartbeat", 0x1016, 1, "u32", consumer),
        ):
            self._sdo.write(index, sub, kind, value)
            held = self._sdo.read(index, sub, kind)
            if held != value:
                raise DeviceError(
                    f"{self._name}: its dead-man cannot be armed: {what} 0x{index:04X}:{sub} was written as 0x{value:X}"
                    f" and read back as 0x{held:X}; it would not stop without the host"
                )

    def start_heartbeat(self) -> None:
        """Have the drive send its own sign of life."""
        self._sdo.write(0x1017, 0, "u16", self._settings.producer_heartbeat_ms)

    def map_pdos(self) -> None:
        """Put what every cycle exchanges into PDOs that act at the SYNC; the node has to be pre-operational."""
        node = self._settings.node
        self._map(0x1400, 0x1600, 0x200 + node, (0x60400010, 0x60710010, 0x60600008))
        self._map(0x1401, 0x1601, 0x300 + node, (0x607A0020, 0x60FF0020))
        self._map(0x1800, 0x1A00, 0x180 + node, (0x60410010, 0x60610008, 0x60770010, 0x60780010))
        self._map(0x1801, 0x1A01, 0x280 + node, (0x60640020, 0x606C0020))
        voltage = self._settings.q_axis_voltage
        if voltage is not None:
            bits = 16 if voltage.type == "i16" else 32
            self._map(0x1802, 0x1A02, 0x380 + node, (voltage.index << 16 | voltage.subindex << 8 | bits,))
        clock = self._settings.drive_clock
        if clock is not None:
            self._map(0x1803, 0x1A03, 0x480 + node, (clock.index << 16 | clock.subindex << 8 | 32,), CLOCK_EVERY)
        if self._settings.torque_slope_per_mille_s is not None:
            self._sdo.write_verified(0x6087, 0, "u32", self._settings.torque_slope_per_mille_s)

    def _map(self, communication: int, mapping: int, identifier: int, entries: tuple[int, ...], syncs: int = 1) -> None:
        """Remap one PDO in the order CiA 301 asks for: invalid, type, empty, entries, count, valid."""
        self._sdo.write(communication, 1, "u32", 0x80000000 | identifier)
        self._sdo.write(communication, 2, "u8", syncs)
        self._sdo.write(mapping, 0, "u8", 0)
        for number, entry in enumerate(entries, start=1):
            self._sdo.write(mapping, number, "u32", entry)
        self._sdo.write(mapping, 0, "u8", len(entries))
        self._sdo.write(communication, 1, "u32", identifier)

    def _fault_text(self, word: int) -> str:
        code = self._sdo.read(0x603F, 0, "u16")
        return f"statusword 0x{word:04X}, error 0x{code:04X} ({emergency.CODES.get(code, 'unnamed')})"
