"""A CiA 402 drive on canopen's `LocalNode`, whose SDO server, network management, heartbeat and PDO decoder it has.

The objects are those that Elmo's public list for Gold drives has and a master needs, written anew from CiA 301, CiA 402
and that list. What the node does with them, the state machine of CiA 402 and a motor without inertia, is below.
"""

import canopen
from canopen.objectdictionary import ODRecord, ODVariable, datatypes

RATED_MA, COUNTS = 10_000, 4096
MAKER = 0x9A
TYPES = {
    "u8": datatypes.UNSIGNED8,
    "i8": datatypes.INTEGER8,
    "u16": datatypes.UNSIGNED16,
    "i16": datatypes.INTEGER16,
    "u32": datatypes.UNSIGNED32,
    "i32": datatypes.INTEGER32,
    "text": datatypes.VISIBLE_STRING,
}
PLAIN = """
0x1000 Device type               u32  ro  0x00020192
0x1001 Error register            u8   ro  0
0x1008 Manufacturer device name  text ro  Gold Twitter of another hand
0x1009 Hardware version          text ro  7.3
0x100A Software version          text ro  Twitter 01.01.17.00
0x1017 Producer heartbeat time   u16  rw  0
0x6007 Abort connection option   i16  rw  1
0x603F Error code                u16  ro  0
0x6040 Controlword               u16  rw  0
0x6041 Statusword                u16  ro  0x0250
0x6060 Modes of operation        i8   rw  0
0x6061 Mode display              i8   ro  0
0x6064 Position actual value     i32  ro  0
0x606C Velocity actual value     i32  ro  0
0x6071 Target torque             i16  rw  0
0x6072 Max torque                u16  rw  2000
0x6073 Max current               u16  rw  2000
0x6075 Motor rated current       u32  rw  10000
0x6076 Motor rated torque        u32  rw  10000
0x6077 Torque actual value       i16  ro  0
0x6078 Current actual value      i16  ro  0
0x6079 DC link circuit voltage   u32  ro  48000
0x607A Target position           i32  rw  0
0x607E Polarity                  u8   rw  0
0x6087 Torque slope              u32  rw  10000
0x60B0 Position offset           i32  rw  5
0x60B1 Velocity offset           i32  rw  -7
0x60B2 Torque offset             i16  rw  9
0x60FF Target velocity           i32  rw  0
0x6502 Supported drive modes     u32  ro  0x3ED
"""
RECORDS = """
0x1018 Identity               u32 ro 0x9A 0x00030924 0x00010400 2718281
0x1016 Consumer heartbeat     u32 rw 0 0
0x607B Position range limit   i32 rw -1000000000 1000000000
0x608F Encoder resolution     u32 rw 4096 1
0x6091 Gear ratio             u32 rw 1 1
0x6092 Feed constant          u32 rw 4096 1
"""
INTERPOLATION = (0x60C2, (("Time units", "u8", 1), ("Time index", "i8", -3)))
QUICK_STOP, READY, ON, ENABLED, DISABLED, FAULT = 0x0217, 0x0231, 0x0233, 0x0237, 0x0250, 0x0218
NOT_VALID = 0x80000000


def variable(name, index, sub, kind, access, default):
    """One variable of the object dictionary."""
    made = ODVariable(name, index, sub)
    made.data_type, made.access_type = TYPES[kind], access
    made.default = default if kind == "text" else int(default, 0) if isinstance(default, str) else default
    return made


def dictionary(lacks=()):
    """Object dictionary of the drive, without the objects that it lacks."""
    objects = canopen.ObjectDictionary()
    for line in PLAIN.strip().splitlines():
        index = int(line[:6], 0)
        name, kind, access, default = line[7:33].strip(), *line[33:].split(maxsplit=2)
        objects.add_object(variable(name, index, 0, kind, access, default))
    for line in RECORDS.strip().splitlines():
        name, kind, access, *defaults = line[7:30].strip(), *line[30:].split()
        fill(objects, int(line[:6], 0), name, [(f"{name} {k}", kind, access, v) for k, v in enumerate(defaults, 1)])
    index, members = INTERPOLATION
    fill(objects, index, "Interpolation time", [(name, kind, "rw", value) for name, kind, value in members])
    for number in range(4):
        for communication, mapping, base in ((0x1400, 0x1600, 0x200), (0x1800, 0x1A00, 0x180)):
            identifier = NOT_VALID | base + 0x100 * number
            members = [("COB-ID", "u32", "rw", identifier), ("Type", "u8", "rw", 255), ("Inhibit time", "u16", "rw", 0)]
            fill(objects, communication + number, f"PDO {communication + number:X}", members)
            slots = [(f"Object {slot}", "u32", "rw", 0) for slot in range(1, 9)]
            fill(objects, mapping + number, f"Map {mapping + number:X}", slots, count="rw")
    for index in lacks:
        del objects[index]
    return objects


def fill(objects, index, name, members, count="ro"):
    """Add a record; one whose count may be written begins with none."""
    made = ODRecord(name, index)
    made.add_member(variable("Count", index, 0, "u8", count, len(members) if count == "ro" else 0))
    for sub, (member, kind, access, default) in enumerate(members, start=1):
        made.add_member(variable(member, index, sub, kind, access, default))
    objects.add_object(made)


class CanopenDrive:
    """The drive at a channel of python-can's virtual bus; it acts in the thread of canopen's network."""

    def __init__(self, channel, node=1, lacks=()):
        self.network = canopen.Network()
        self.network.connect(interface="virtual", channel=channel)
        self.node = self.network.create_node(node, dictionary(lacks))
        self.node.add_write_callback(self._written)
        self.network.subscribe(0x080, self._sync)
        self.reset()
        self.heard = []
        self.words = []  # controlwords, each as it changed

    def close(self):
        """Leave the bus."""
        self.node.nmt.stop_heartbeat()
        self.network.disconnect()

    def reset(self):
        """Boot, as after a loss of its supply."""
        self.status = DISABLED
        self.node.nmt.state = "RESET"
        self.node.nmt.state = "PRE-OPERATIONAL"

    def set(self, index, value, sub=0):
        """Have an object hold this value, whoever may write it."""
        objects = self.node.object_dictionary[index]
        member = objects if isinstance(objects, ODVariable) else objects[sub]
        self.node.data_store.setdefault(index, {})[sub] = member.encode_raw(value)

    def get(self, index, sub=0):
        """What an object holds."""
        objects = self.node.object_dictionary[index]
        member = objects if isinstance(objects, ODVariable) else objects[sub]
        return member.decode_raw(self.node.get_data(index, sub))

    def fail(self, code):
        """Enter fault, with the emergency that tells it."""
        self.status = FAULT
        self.set(0x603F, code)
        self.node.emcy.send(code, 0x03)

    def _written(self, index, subindex, od, data):
        if index == 0x6040:
            self._control(od.decode_raw(data))
        if 0x1400 <= index < 0x1C00 and subindex == 1:
            self.heard.clear()  # planned again at the next SYNC

    def _control(self, word):
        """Transitions 2 to 9 of the state machine by the controlword (CiA 402-2, 8.4)."""
        if not self.words or self.words[-1] != word:
            self.words.append(word)
        if self.status == FAULT:
            self.status = DISABLED if word & 0x80 else FAULT
        elif not word & 0x02:
            self.status = DISABLED
        elif not word & 0x04:
            self.status = QUICK_STOP if self.status == ENABLED else DISABLED
        elif word & 0x0F == 0x06:
            self.status = READY
        elif word & 0x0F == 0x07 and self.status in (READY, ENABLED):
            self.status = ON
        elif word & 0x0F == 0x0F and self.status in (ON, ENABLED):
            self.status = ENABLED

    def _sync(self, _identifier, _data, _timestamp):
        node = self.node
        if node.nmt.state != "OPERATIONAL":
            return
        if not self.heard:
            for pdos in (node.rpdo, node.tpdo):
                pdos.read()
            self.heard += [pdo for pdo in node.rpdo.values() if pdo.enabled]
        for pdo in self.heard:
            if pdo.is_received:
                pdo.is_received = False
                for item in pdo.map:
                    self.set(item.index, item.raw, item.subindex)
                    if item.index == 0x6040:
                        self._control(item.raw)
        self._measure()
        for pdo in node.tpdo.values():
            if pdo.enabled and pdo.trans_type == 1:
                for item in pdo.map:
                    item.raw = self.get(item.index, item.subindex)
                pdo.transmit()

    def _measure(self):
        flows = self.status == ENABLED and self.get(0x6060) == 10
        torque = self.get(0x6071) + self.get(0x60B2) if flows else 0
        for index, value in ((0x6077, torque), (0x6078, torque), (0x6041, self.status), (0x6061, self.get(0x6060))):
            self.set(index, value)
