"""Decode emergency messages (CiA 301 object 0x80 + node; names after Elmo's published error lists)."""

import struct

from leactl_plugins.elmo.fault_names import CODES

CODE_RESET = 0x0000
LENGTH = 8


def code_of(data: bytes | bytearray) -> int:
    """Return the error code of an emergency frame of full length."""
    return int(struct.unpack_from("<H", data)[0])


def describe(data: bytes | bytearray) -> str:
    """Return a line with an emergency's code, its name, error register and the maker's code; or its wrong length."""
    if len(data) != LENGTH:
        return f"emergency of unknown code: {len(data)} bytes ({bytes(data).hex() or 'none'}), {LENGTH} were expected"
    code = code_of(data)
    register, drive_code = data[2], data[3]
    return f"emergency 0x{code:04X} ({CODES.get(code, 'unnamed')}), register 0x{register:02X}, drive code {drive_code}"
