"""Object dictionary of the emulated Elmo Gold: types, access, mapping and ranges after Elmo's Gold EDS."""

from typing import NamedTuple

ABORT_READ_ONLY = 0x06010002
ABORT_NO_OBJECT = 0x06020000
ABORT_NOT_MAPPABLE = 0x06040041
ABORT_PDO_LENGTH = 0x06040042
ABORT_INCOMPATIBLE = 0x06040043
ABORT_LENGTH = 0x06070010
ABORT_NO_SUBINDEX = 0x06090011
ABORT_RANGE = 0x06090030

TEXTS = {(0x1008, 0): b"Gold DC Whistle", (0x1009, 0): b"1.0", (0x100A, 0): b"Whistle 01.01.16.00 08Mar2018G"}
SIZES = {"u8": 1, "i8": 1, "u16": 2, "i16": 2, "u32": 4, "i32": 4}


class Abort(Exception):
    """Refusal of an SDO transfer by the emulated drive, with the abort code of CiA 301."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


class ObjectEntry(NamedTuple):
    """One object: integer type, access, whether it can be mapped to a PDO, default and range."""

    kind: str  # integer type, a key of `SIZES`
    writable: bool = False
    mappable: bool = False
    default: int = 0
    low: int | None = None  # lowest value that can be written; None: that of the type
    high: int | None = None


def gold(node: int) -> dict[tuple[int, int], ObjectEntry]:
    """Return the objects of a Gold drive by index and subindex, with the PDO mappings that its EDS leaves out."""
    objects = {
        (0x1000, 0): ObjectEntry("u32", default=0x00020192),
        (0x1001, 0): ObjectEntry("u8"),
        (0x1003, 0): ObjectEntry("u8", writable=True, high=0),
        (0x1005, 0): ObjectEntry("u32", writable=True, default=0x80),
        (0x1006, 0): ObjectEntry("u32", writable=True),
        (0x100B, 0): ObjectEntry("u8", default=node),
        (0x1016, 1): ObjectEntry("u32", writable=True),
        (0x1016, 2): ObjectEntry("u32", writable=True),
        (0x1017, 0): ObjectEntry("u16", writable=True),
        (0x1018, 1): ObjectEntry("u32", default=0x9A),
        (0x1018, 2): ObjectEntry("u32", default=0x00030923),
        (0x1018, 3): ObjectEntry("u32", default=0x000103F6),
        (0x1018, 4): ObjectEntry("u32", default=node),
        (0x6007, 0): ObjectEntry("i16", writable=True, default=1, low=0, high=3),
        (0x603F, 0): ObjectEntry("u16"),
        (0x6040, 0): ObjectEntry("u16", writable=True, mappable=True),
        (0x6041, 0): ObjectEntry("u16", mappable=True),
        (0x6060, 0): ObjectEntry("i8", writable=True, mappable=True, low=-128, high=10),
        (0x6061, 0): ObjectEntry("i8", mappable=True),
        (0x6064, 0): ObjectEntry("i32", mappable=True),
        (0x606C, 0): ObjectEntry("i32", mappable=True),
        (0x6071, 0): ObjectEntry("i16", writable=True, mappable=True),
        (0x6072, 0): ObjectEntry("u16", writable=True, default=50000),
        (0x6073, 0): ObjectEntry("u16", writable=True, default=50000),
        (0x6075, 0): ObjectEntry("u32", writable=True),
        (0x6076, 0): ObjectEntry("u32", writable=True),
        (0x6077, 0): ObjectEntry("i16", mappable=True),
        (0x6078, 0): ObjectEntry("i16", mappable=True),
        (0x6079, 0): ObjectEntry("u32"),
        (0x607A, 0): ObjectEntry("i32", writable=True, mappable=True),
        (0x607B, 1): ObjectEntry("i32", writable=True, default=-1_000_000_000),
        (0x607B, 2): ObjectEntry("i32", writable=True, default=1_000_000_000),
        (0x607E, 0): ObjectEntry("u8", writable=True),
        (0x6087, 0): ObjectEntry("u32", writable=True, mappable=True, default=10_000_000),
        (0x608F, 1): ObjectEntry("u32", writable=True, default=1),
        (0x608F, 2): ObjectEntry("u32", writable=True, default=1),
        (0x6091, 1): ObjectEntry("u32", writable=True, default=1),
        (0x6091, 2): ObjectEntry("u32", writable=True, default=1),
        (0x6092, 1): ObjectEntry("u32", writable=True, default=1),
        (0x6092, 2): ObjectEntry("u32", writable=True, default=1),
        (0x60B0, 0): ObjectEntry("i32", writable=True, mappable=True),
        (0x60B1, 0): ObjectEntry("i32", writable=True, mappable=True),
        (0x60B2, 0): ObjectEntry("i16", writable=True, mappable=True),
        (0x60C2, 1): ObjectEntry("u8", writable=True, default=1, low=1),
        (0x60C2, 2): ObjectEntry("i8", writable=True, default=-3, low=-6, high=-2),
        (0x60FF, 0): ObjectEntry("i32", writable=True, mappable=True),
        (0x6502, 0): ObjectEntry("u32", default=0x3ED),
        (0x2086, 0): ObjectEntry("u32"),
        (0x22A2, 0): ObjectEntry("u16", mappable=True, default=35),
    }
    default_mappings = {0x1400: 0x60400010, 0x1800: 0x60410010}
    for number in range(4):
        for communication, mapping, first_identifier in ((0x1400, 0x1600, 0x200), (0x1800, 0x1A00, 0x180)):
            default_mapping = default_mappings.get(communication + number, 0)
            objects[communication + number, 1] = ObjectEntry(
                "u32", writable=True, default=first_identifier + 0x100 * number + node
            )
            objects[communication + number, 2] = ObjectEntry("u8", writable=True, default=255)
            objects[communication + number, 3] = ObjectEntry("u16", writable=True)
            objects[mapping + number, 0] = ObjectEntry("u8", writable=True, default=1 if default_mapping else 0, high=8)
            for slot in range(1, 9):
                objects[mapping + number, slot] = ObjectEntry(
                    "u32", writable=True, default=default_mapping if slot == 1 else 0
                )
    return objects
