"""Emulator of an Elmo Gold drive: SDO server, PDOs on SYNC, NMT, heartbeats, emergencies, CiA 402 state machine.

Frames in, frames out; no transport, no threads. It shares only the numbers of the standards with the driver.
"""

import math
import struct
from typing import NamedTuple

from leactl.driver.far_end import Frame, Machine
from leactl_plugins.elmo_can.dictionary import (
    ABORT_INCOMPATIBLE,
    ABORT_LENGTH,
    ABORT_NO_OBJECT,
    ABORT_NO_SUBINDEX,
    ABORT_NOT_MAPPABLE,
    ABORT_PDO_LENGTH,
    ABORT_RANGE,
    ABORT_READ_ONLY,
    SIZES,
    TEXTS,
    Abort,
    ObjectEntry,
    gold,
)

PRE_OPERATIONAL, OPERATIONAL, STOPPED = 0x7F, 0x05, 0x04
_FOLLOWED_QUANTITIES = {4: "current", 8: "angle", 9: "velocity", 10: "current"}
_STATUSWORDS = {"disabled": 0x0240, "ready": 0x0231, "on": 0x0233, "enabled": 0x0637, "quick": 0x0617, "fault": 0x0218}
_INTERNAL_LIMIT = 0x0800
_POSITION_TURNED, _VELOCITY_TURNED = 0x80, 0x40  # bits of 0x607E (CiA 402, polarity)
# objects that are read without sampling the machine
_COMMUNICATION_OBJECTS = {0x1005, 0x1006, *range(0x1400, 0x1404), *range(0x1800, 0x1804)}
_UNMEASURED_OBJECTS = _COMMUNICATION_OBJECTS | {
    0x607B,
    0x607E,
    0x608F,
    0x6091,
    0x6092,
    0x60B0,
    0x60B1,
    0x60B2,
    0x60C2,
    0x6502,
}
_ON_CHANGE_TYPE = 254  # lowest transmission type of a TPDO that is sent on a change
_ABORT_BAD_COMMAND = 0x05040001
_COB_IDENTIFIER_MASK = 0x7FF
_CONTROLWORD = (0x6040, 0)
_STRUCT_CODES = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i"}


class _Pdo(NamedTuple):
    """A PDO with its present mapping and transmission type."""

    identifier: int
    kind: int  # transmission type
    objects: list[tuple[int, int]]
    layout: struct.Struct


class ElmoEmulator:
    """One Gold drive at a node, which turns a motor."""

    def __init__(
        self,
        node: int,
        machine: Machine,
        *,
        rated_current_ma: int,
        counts_per_turn: int,
        q_axis_per_ampere: float = math.sqrt(1.5),
        voltage_object: tuple[int, int, str, float] | None = None,
        clock_object: tuple[int, int] | None = None,
    ) -> None:
        self.node = node
        self._machine = machine
        self._q_per_mille = rated_current_ma * 1e-6 * q_axis_per_ampere
        self._counts_per_rad = counts_per_turn / (2 * math.pi)
        self._entries: dict[tuple[int, int], ObjectEntry] = gold(node)
        self._voltage_object = voltage_object
        if voltage_object is not None:
            self._entries[voltage_object[0], voltage_object[1]] = ObjectEntry(voltage_object[2], mappable=True)
        self._clock_object, self._syncs = clock_object, 0
        if clock_object is not None:
            self._entries[clock_object] = ObjectEntry("u32", mappable=True)
        self._values = {key: entry.default for key, entry in self._entries.items()}
        self._values[0x6075, 0] = self._values[0x6076, 0] = rated_current_ma
        self.nmt = PRE_OPERATIONAL
        self.state = "disabled"
        self._limiting = False  # whether it limits the demanded current
        self.frozen = False  # whether it has stopped answering
        self._pending_demands: dict[int, bytes] = {}
        self._text: bytes | None = None  # part of a text that is not sent yet
        self._receive_pdos: list[_Pdo] = []
        self._transmit_pdos: list[_Pdo] = []
        self._next_heartbeat = math.inf
        self._host_deadline = math.inf
        self._booted = False
        self._emergencies: list[Frame] = []
        self._is_change_unreported = False  # whether a TPDO that is sent on change still has to report the state
        self._plan_pdos()

    @property
    def due(self) -> float:
        """Time [s] of the next heartbeat or of the host's timeout; -inf if frames are waiting."""
        if self.frozen:
            return math.inf
        if not self._booted or self._emergencies or self._is_change_unreported:
            return -math.inf
        return min(self._next_heartbeat, self._host_deadline)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Receive one frame from the bus; return the answers."""
        if self.frozen:
            return []
        if not self._booted:
            return [*self.tick(now), *self.receive(frame, now)]  # no answer before it has booted
        answers = self._answer(frame, now)
        return answers + self._report_changes() if self._is_change_unreported else answers

    def _answer(self, frame: Frame, now: float) -> list[Frame]:
        """Return the answers to a frame, without the TPDOs that report a change."""
        identifier, data = frame
        if identifier == 0x080 and self.nmt == OPERATIONAL:
            return self._sync(now)
        if identifier == 0x000 and len(data) == 2 and data[1] in (0, self.node):
            return self._obey_network_command(data[0], now)
        if identifier == 0x600 + self.node and self.nmt != STOPPED and len(data) == 8:
            return [Frame(0x580 + self.node, self._serve(data, now)), *self._take_emergencies()]
        if self.nmt == OPERATIONAL and (identifier & 0x7F) == self.node and 0x200 <= identifier < 0x580:
            return self._demand(identifier, data)
        if 0x700 <= identifier < 0x780:
            self._hear_heartbeat(identifier - 0x700, now)
        return []

    def tick(self, now: float) -> list[Frame]:
        """Boot, send the heartbeat that is due, and react to a missing heartbeat of the host; return the frames."""
        frames = [] if self._booted else [Frame(0x700 + self.node, b"\x00")]
        self._booted = True
        if now >= self._host_deadline:
            self._host_deadline = math.inf
            self._lose_host()
        if now >= self._next_heartbeat:
            frames.append(Frame(0x700 + self.node, bytes((self.nmt,))))
            period = self._values[0x1017, 0] * 1e-3
            self._next_heartbeat = max(self._next_heartbeat + period, now)
        return frames + self._take_emergencies() + self._report_changes()

    def is_sign_of_life(self, frame: Frame) -> bool:
        """Return whether a frame is a heartbeat (CiA 301: function code 1110b)."""
        return frame.identifier == 0x700 + self.node

    def freeze(self, frozen: bool) -> None:
        """Stop answering and keep the last demand (`frozen` True), or return to normal."""
        self.frozen = frozen

    def fault(self, code: int, drive_code: int = 0, register: int = 0x01) -> None:
        """Enter fault with an emergency message, as after a short circuit or an over-voltage."""
        self._go("fault")
        self._values[0x603F, 0] = code
        self._values[0x1001, 0] = register
        data = struct.pack("<HBB4x", code, register, drive_code)
        self._emergencies.append(Frame(0x080 + self.node, data))

    # -- network -----------------------------------------------------------------------------------------------------

    def _take_emergencies(self) -> list[Frame]:
        """Return the emergency messages that are not sent yet."""
        frames, self._emergencies = self._emergencies, []
        return frames

    def _obey_network_command(self, command: int, now: float) -> list[Frame]:
        """Obey a command of network management (CiA 301, 7.2.8); return the frames of a reboot."""
        if command == 0x01:
            self.nmt = OPERATIONAL
        elif command == 0x02:
            self.nmt = STOPPED
        elif command == 0x80:
            self.nmt = PRE_OPERATIONAL
        elif command in (0x81, 0x82):
            self._go("disabled")
            self.nmt, self._booted = PRE_OPERATIONAL, False
            return self.tick(now)
        return []

    def _hear_heartbeat(self, node: int, now: float) -> None:
        """Restart the timeout of the host; monitoring starts at its first heartbeat (301IG, chapter 14)."""
        for sub in (1, 2):
            consumer_entry = self._values[0x1016, sub]
            if consumer_entry >> 16 & 0x7F == node and consumer_entry & 0xFFFF:
                self._host_deadline = now + (consumer_entry & 0xFFFF) * 1e-3

    def _lose_host(self) -> None:
        """React by the abort option (0x6007) to the missing heartbeat of the host."""
        option = self._values[0x6007, 0]
        if option == 1:
            self.fault(0x8130, register=0x11)
            return
        self._emergencies.append(Frame(0x080 + self.node, struct.pack("<HBB4x", 0x8130, 0x11, 0)))
        if option in (2, 3):
            self._go("disabled")

    # -- SDO ---------------------------------------------------------------------------------------------------------

    def _serve(self, data: bytes, now: float) -> bytes:
        """Return the answer to an SDO request."""
        command, index, sub = struct.unpack_from("<BHB", data)
        try:
            if command & 0xEF == 0x60 and self._text is not None:
                return self._text_segment(command & 0x10)
            self._text = None
            if command == 0x40 and (index, sub) in TEXTS:
                self._text = TEXTS[index, sub]
                return struct.pack("<BHBI", 0x41, index, sub, len(self._text))
            if command == 0x40:
                return self._upload(index, sub)
            if command & 0xF3 == 0x23:
                size = 4 - (command >> 2 & 3)
                self._download(index, sub, data[4 : 4 + size], now)
                return struct.pack("<BHB4x", 0x60, index, sub)
            raise Abort(_ABORT_BAD_COMMAND)  # noqa: TRY301 (one place turns every refusal into a frame)
        except Abort as abort:
            return struct.pack("<BHBI", 0x80, index, sub, abort.code)

    def _text_segment(self, toggle: int) -> bytes:
        """Return the frame with the next seven bytes of a text, and whether they are the last (CiA 301, 7.2.4.3.6)."""
        assert self._text is not None
        segment, self._text = self._text[:7], self._text[7:] or None
        return bytes([toggle | (7 - len(segment)) << 1 | (self._text is None)]) + segment.ljust(7, b"\0")

    @property
    def serial_number(self) -> str:
        """Value of 0x1018:4 as text."""
        return str(self._values[0x1018, 4])

    @serial_number.setter
    def serial_number(self, text: str) -> None:
        if text.isdecimal() and int(text) <= 0xFFFFFFFF:  # the object cannot hold another text
            self._values[0x1018, 4] = int(text)

    def _entry(self, index: int, sub: int) -> ObjectEntry:
        """Return an object; raise Abort if there is none."""
        entry = self._entries.get((index, sub))
        if entry is None:
            has_index = any(key[0] == index for key in self._entries)
            raise Abort(ABORT_NO_SUBINDEX if has_index else ABORT_NO_OBJECT)
        return entry

    def _upload(self, index: int, sub: int) -> bytes:
        """Return the frame with the value of an object; raise Abort if there is none."""
        kind = self._entry(index, sub).kind
        size = SIZES[kind]
        if index not in _UNMEASURED_OBJECTS:
            self._sample()
        raw = self._values[index, sub].to_bytes(size, "little", signed=kind[0] == "i")
        return struct.pack("<BHB", 0x43 | (4 - size) << 2, index, sub) + raw.ljust(4, b"\0")

    def _download(self, index: int, sub: int, raw: bytes, now: float) -> None:
        """Write an object and react to its new value; raise Abort if the drive refuses it."""
        entry = self._entry(index, sub)
        if not entry.writable:
            raise Abort(ABORT_READ_ONLY)
        if len(raw) != SIZES[entry.kind]:
            raise Abort(ABORT_LENGTH)
        value = int.from_bytes(raw, "little", signed=entry.kind[0] == "i")
        if (entry.low is not None and value < entry.low) or (entry.high is not None and value > entry.high):
            raise Abort(ABORT_RANGE)
        self._check_special(index, sub, value)
        previous = self._values[index, sub]
        self._values[index, sub] = value
        if index == 0x6040:
            self._control(previous, value)
        elif index == 0x1017:
            self._next_heartbeat = now + value * 1e-3 if value else math.inf
        elif index == 0x1016:
            self._host_deadline = math.inf
        elif 0x1400 <= index < 0x1C00:
            self._plan_pdos()

    def _check_special(self, index: int, sub: int, value: int) -> None:
        """Raise Abort if a PDO's identifier or mapping, or a heartbeat consumer, cannot take a value."""
        if 0x1400 <= index <= 0x1403 or 0x1800 <= index <= 0x1803:
            base = 0x200 if index < 0x1800 else 0x180
            identifier = base + 0x100 * (index & 3) + self.node
            if sub == 1 and value & _COB_IDENTIFIER_MASK != identifier:
                raise Abort(ABORT_RANGE)
        elif 0x1600 <= index <= 0x1603 or 0x1A00 <= index <= 0x1A03:
            communication = index - 0x200
            if not self._values[communication, 1] & 0x80000000:
                raise Abort(ABORT_INCOMPATIBLE)
            entries = [value] if sub and value else []
            if sub == 0:
                entries = [self._values[index, slot] for slot in range(1, value + 1)]
            if not all(self._is_mappable(entry) for entry in entries):
                raise Abort(ABORT_NOT_MAPPABLE)
            if sum(entry & 0xFF for entry in entries) > 64:
                raise Abort(ABORT_PDO_LENGTH)
        elif index == 0x1016 and value & 0xFFFF:
            other_entry = self._values[0x1016, 3 - sub]
            if other_entry & 0xFFFF and other_entry >> 16 == value >> 16:
                raise Abort(ABORT_INCOMPATIBLE)

    def _is_mappable(self, entry: int) -> bool:
        mapped_object = self._entries.get((entry >> 16, entry >> 8 & 0xFF))
        return mapped_object is not None and mapped_object.mappable and SIZES[mapped_object.kind] * 8 == entry & 0xFF

    # -- PDO ---------------------------------------------------------------------------------------------------------

    def _plan_pdos(self) -> None:
        """Read the mappings of all PDOs, and drop demands that wait for a SYNC."""
        self._receive_pdos = self._mapped_pdos(0x1400, 0x1600)
        self._transmit_pdos = self._mapped_pdos(0x1800, 0x1A00)
        self._pending_demands.clear()

    def _mapped_pdos(self, communication: int, mapping: int) -> list[_Pdo]:
        """Return the valid PDOs of a direction by the first index of their communication and mapping objects."""
        pdos = []
        for number in range(4):
            identifier = self._values[communication + number, 1]
            count = self._values[mapping + number, 0]
            if identifier & 0x80000000 or not count:
                continue
            entries = [self._values[mapping + number, slot] for slot in range(1, count + 1)]
            objects = [(entry >> 16, entry >> 8 & 0xFF) for entry in entries]
            layout = struct.Struct("<" + "".join(_STRUCT_CODES[self._entries[key].kind] for key in objects))
            pdos.append(_Pdo(identifier & 0x7FF, self._values[communication + number, 2], objects, layout))
        return pdos

    def _demand(self, identifier: int, data: bytes) -> list[Frame]:
        """Receive a PDO: apply it at once, or keep it until the SYNC, by its transmission type."""
        for pdo in self._receive_pdos:
            if pdo.identifier == identifier:
                if len(data) < pdo.layout.size:
                    self._emergencies.append(Frame(0x080 + self.node, struct.pack("<HBB4x", 0x8210, 0x21, 0)))
                elif pdo.kind >= 254:
                    self._apply(pdo, data)
                    self._follow()
                else:
                    self._pending_demands[identifier] = data
        return self._take_emergencies()

    def _apply(self, pdo: _Pdo, data: bytes) -> None:
        for key, value in zip(pdo.objects, pdo.layout.unpack_from(data), strict=True):
            previous, self._values[key] = self._values[key], value
            if key == _CONTROLWORD:
                self._control(previous, value)

    def _sync(self, now: float) -> list[Frame]:
        """Apply the demands that wait for the SYNC, sample, and return the PDOs that answer it."""
        if self._pending_demands:
            for pdo in self._receive_pdos:
                data = self._pending_demands.pop(pdo.identifier, None)
                if data is not None:
                    self._apply(pdo, data)
            self._follow()
        self._sample()
        values = self._values
        if self._clock_object is not None:
            values[self._clock_object] = round(now * 1e6) & 0xFFFFFFFF
        self._syncs += 1
        frames = []
        for identifier, kind, objects, layout in self._transmit_pdos:
            if kind <= 1 or (kind <= 240 and self._syncs % kind == 0):
                frames.append(Frame(identifier, layout.pack(*[values[key] for key in objects])))
        return frames + self._take_emergencies() if self._emergencies else frames

    # -- machine -----------------------------------------------------------------------------------------------------

    def _sample(self) -> None:
        """Store what the machine and the state machine show now in their objects."""
        current, velocity, angle = self._machine.read()
        values = self._values
        per_mille = max(-0x8000, min(0x7FFF, round(current / self._q_per_mille)))
        values[0x6077, 0] = values[0x6078, 0] = per_mille
        polarity = values.get((0x607E, 0), 0)
        counts = round(angle * self._counts_per_rad) * (-1 if polarity & _POSITION_TURNED else 1)
        low, high = values.get((0x607B, 1), 0), values.get((0x607B, 2), 0)
        if low >= high:
            low, high = -0x80000000, 0x80000000  # its 32 bits
        values[0x6064, 0] = (counts - low) % (high - low) + low
        speed = round(velocity * self._counts_per_rad) * (-1 if polarity & _VELOCITY_TURNED else 1)
        values[0x606C, 0] = max(-0x80000000, min(0x7FFFFFFF, speed))
        values[0x6041, 0] = self._statusword
        values[0x6061, 0] = self._shown_mode
        values[0x6079, 0] = max(0, round(self._machine.bus_voltage * 1e3))
        if self._voltage_object is not None:
            index, sub, kind, scale = self._voltage_object
            limit = (1 << 8 * SIZES[kind] - 1) - 1
            values[index, sub] = max(-limit - 1, min(limit, round(self._machine.voltage / scale)))

    @property
    def _statusword(self) -> int:
        return _STATUSWORDS[self.state] | (_INTERNAL_LIMIT if self._limiting else 0)

    @property
    def _shown_mode(self) -> int:
        return self._values[0x6060, 0]

    def _report_changes(self) -> list[Frame]:
        """Return the TPDOs that are sent on a change instead of at a SYNC (types 254 and 255)."""
        is_changed, self._is_change_unreported = self._is_change_unreported, False
        if not is_changed or self.nmt != OPERATIONAL:
            return []
        self._values[0x6041, 0] = self._statusword
        return [
            Frame(identifier, layout.pack(*[self._values[key] for key in objects]))
            for identifier, kind, objects, layout in self._transmit_pdos
            if kind >= _ON_CHANGE_TYPE
        ]

    def _control(self, previous: int, controlword: int) -> None:
        """Make one transition of the state machine (402IG, controlword decode); an illegal word changes nothing."""
        state = self.state
        if state == "fault":
            if controlword & 0x80 and not previous & 0x80:
                self._values[0x603F, 0] = self._values[0x1001, 0] = 0
                self._go("disabled")
                self._emergencies.append(Frame(0x080 + self.node, bytes(8)))
            return
        if not controlword & 0x02:
            self._go("disabled")
        elif not controlword & 0x04:
            self._go("quick" if state == "enabled" else "disabled")
        elif not controlword & 0x01:
            if state != "quick":
                self._go("ready")
        elif not controlword & 0x08:
            self._go({"ready": "on", "enabled": "on"}.get(state, state))
        elif state in ("on", "quick"):
            self._go("enabled")
        elif state == "ready":
            self._go("on")  # bit 3 already set: transition 3 alone
        self._follow()

    def _go(self, state: str) -> None:
        """Change to a state; only an enabled drive moves the motor."""
        self._is_change_unreported = self._is_change_unreported or state != self.state
        self.state = state
        self._limiting = False
        if state != "enabled":
            self._machine.command("off", 0.0)

    def _follow(self) -> None:
        """Let the motor follow the demand of the mode if operation is enabled."""
        if self.state != "enabled":
            return
        values = self._values
        mode = _FOLLOWED_QUANTITIES.get(self._shown_mode)
        offset_index = {"current": 0x60B2, "velocity": 0x60B1, "angle": 0x60B0}.get(mode or "")
        offset = values.get((offset_index, 0), 0) if offset_index else 0  # set by any master (CiA 402, 6.3.2 and 6.4)
        if mode is None:
            self._machine.command("off", 0.0)
        elif mode == "current":
            demanded, highest = values[0x6071, 0] + offset, min(values[0x6072, 0], values[0x6073, 0])
            self._limiting = abs(demanded) > highest
            self._machine.command("current", max(-highest, min(highest, demanded)) * self._q_per_mille)
        else:
            target = values[0x607A, 0] if mode == "angle" else values[0x60FF, 0]
            self._machine.command(mode, (target + offset) / self._counts_per_rad)
