"""Names of an Elmo drive's faults (by code and by bit of MF) and of its interpreter's refusals.

After Elmo's published lists: the CAN implementation guides, and the SimplIQ Command Reference for MF and EC. Codes of
the Gold line that these lack are named as in nasa-jpl/jsd, a public driver of it. Bits of MF and codes of emergency
messages mean the same faults, so that each fault has one name here.
"""

# error codes of emergency messages (CiA 301, CiA 402 and the maker's own)
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
    0x7306: "commutation failed",  # jsd
    0x7380: "feedback loss",
    0x7381: "two Hall sensors changed at once",
    0x7382: "commutation at motor on failed",
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
    0xFF30: "modulo overflow",  # jsd
    0xFF34: "numeric overflow",  # jsd
    0xFF40: "gantry partner in fault",
}

# bits of MF (SimplIQ Command Reference, MF), by the code that an emergency message has for the same fault
_FAULT_BITS = {
    0x1: 0x7300,
    0x4: 0x7380,
    0x8: 0x8311,
    0x10: 0x5441,
    0x40: 0x7381,
    0x80: 0x8480,
    0x100: 0x8611,
    0x200: 0x6320,
    0x400: 0x5280,
    0x800: 0x8130,
    0x10000: 0x8380,
    0x20000: 0x8481,
    0x40000: 0x6180,
    0x80000: 0x6181,
    0x200000: 0x7121,
    0x400000: 0x8680,
    0x20000000: 0x5400,
}
_POWER_STAGE_MASK = 0xF000  # a field of four bits; bit 12 is set if the power stage has failed
_POWER_STAGE_FAULTS = {0x3000: 0x3120, 0x5000: 0x3310, 0xB000: 0x2340, 0xD000: 0x4310}

# Numbers of EC. Gold drives have taken over the list and given a few numbers another sense (45, 48): the number counts.
REFUSALS = {
    1: "do not update",
    2: "bad command",
    3: "bad index",
    5: "no command of two letters",
    6: "program is not running",
    7: "mode cannot be started, bad initial data",
    10: "not by PDO",
    11: "cannot write to flash memory",
    12: "not in this unit mode",
    16: "an index is expected",
    18: "empty assignment",
    19: "bad syntax",
    21: "out of range",
    22: "division by zero",
    23: "cannot be assigned",
    25: "not while moving",
    26: "profiler mode not in this unit mode",
    28: "out of limit",
    30: "no program to continue",
    32: "communication error: overrun, parity, noise or framing",
    33: "bad sensor setting",
    34: "conflict with another command",
    36: "commutation method or table does not fit the sensor",
    41: "not supported by this product",
    42: "no such label",
    43: "CiA 402 machine in fault",
    45: "error from a subroutine (SimplIQ), or write-only (Gold)",
    47: "program does not exist or is not compiled",
    48: "motor could not start, CD says why",
    50: "stack overflow",
    51: "inhibit or abort input active",
    54: "bad data base",
    57: "motor must be off",
    58: "motor must be on",
    60: "bad unit mode",
    61: "data base was reset",
    65: "disabled by software",
    66: "amplifier not ready",
    67: "recorder is busy",
    70: "recorded data are not valid",
    72: "range of the modulo must be even",
    74: "bad profile data base",
    82: "program is running",
    85: "safe torque off",
    90: "CiA 402 machine not ready",
    93: "wrong initial value",
    96: "user program took too long",
    97: "receive buffer of the serial line ran over",
    98: "cannot measure current offsets",
    101: "absolute encoder setting",
    110: "number is too long",
    121: "analogue sensor is still starting",
    127: "range of the modulo must be positive",
    134: "a local label cannot be executed",
    136: "not a number",
    162: "badly formed number",
    164: "no error yet",
    165: "flash memory is busy",
    166: "out of the modulo's range",
    168: "too fast to start the motor",
}


def motor_fault(fault_bits: int) -> str:
    """Return a text for a value of MF: the number in hexadecimal digits, and the names of all set bits."""
    codes = [code for fault_bit, code in _FAULT_BITS.items() if fault_bits & fault_bit]
    stage_fault = fault_bits & _POWER_STAGE_MASK
    names = [CODES[code] for code in codes]
    if stage_fault:
        names.append(CODES[_POWER_STAGE_FAULTS[stage_fault]] if stage_fault in _POWER_STAGE_FAULTS else "power stage")
    return f"MF 0x{fault_bits:X} ({', '.join(names) or ('unnamed' if fault_bits else 'no fault')})"


def bits_of(code: int) -> int:
    """Return the value of MF for an emergency code; that of "cannot start motor" if MF has no bit for the fault."""
    codes_by_bits = _POWER_STAGE_FAULTS | _FAULT_BITS
    return next((bits for bits, fault_code in codes_by_bits.items() if fault_code == code), 0x20000000)


def refusal(number: int) -> str:
    """Return a text for a number of EC: the number and its name."""
    return f"error {number} ({REFUSALS.get(number, 'unnamed')})"
