"""What an emergency message says (CiA 301 object 0x80 + node; code names after Elmo's published error lists)."""

import struct

CODES = {
    0x0000: "error reset",
    0x2311: "over-current",
    0x2340: "short circuit",
    0x3120: "under-voltage",
    0x3130: "AC phase loss",
    0x3310: "over-voltage",
    0x4310: "drive over-temperature",
    0x5280: "bad ECAM or gantry",
    0x5281: "timing error",
    0x5400: "cannot start motor",
    0x5441: "inhibit, abort or limit switch",
    0x5442: "additional abort",
    0x6180: "stack overflow",
    0x6181: "CPU exception",
    0x6200: "user program aborted",
    0x6300: "a received PDO could not be executed",
    0x6320: "inconsistent data base",
    0x7121: "motor stuck",
    0x7300: "feedback error",
    0x7380: "feedback loss",
    0x7381: "two Hall sensors changed at once",
    0x7382: "commutation failed",
    0x8110: "CAN message lost",
    0x8130: "heartbeat lost",
    0x8140: "recovered from bus-off",
    0x8200: "protocol error",
    0x8210: "access to an unconfigured PDO",
    0x8311: "peak current exceeded",
    0x8380: "cannot find electrical zero",
    0x8381: "cannot tune current offset",
    0x8480: "speed tracking error",
    0x8481: "speed limit exceeded",
    0x8611: "position tracking error",
    0x8680: "position limit exceeded",
    0xFF01: "user program",
    0xFF02: "interpolation without new setpoints",
    0xFF10: "failed to start motor",
    0xFF20: "safe torque off in use",
    0xFF40: "gantry partner in fault",
}

CODE_RESET = 0x0000


def code_of(data: bytes | bytearray) -> int:
    """Error code of an emergency frame."""
    return int(struct.unpack_from("<H", data)[0])


def describe(data: bytes | bytearray) -> str:
    """One line for an emergency frame: code, its name, error register and the maker's own code."""
    code = code_of(data)
    register, own = data[2], data[3]
    return f"emergency 0x{code:04X} ({CODES.get(code, 'unnamed')}), register 0x{register:02X}, drive code {own}"
